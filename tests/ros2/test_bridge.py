"""A bridge on real topics: everything that comes is answered, whoever leaves and comes back."""

import itertools
import time
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest
from benchmarks.networks import inputs_of, outputs_of, real_time
from cyclonedds.qos import Policy
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from ros2.ros2_cases import JOINTS, Bridge, arrays, asking, network, received, send_all, state, wait_for
from trueup.dataset import Dataset
from trueup.deploy import Stream
from trueup.errors import ConfigError, MissingSignal
from trueup.ros2 import Augmented, Float64MultiArray, JointState, Node, run_bridge
from trueup.ros2.bridge import BridgeReport, _answer_all
from trueup.ros2.messages import TYPE_HASHES, Header
from trueup.ros2.node import Inbox, Outbox
from trueup.stages import import_logs

RATE_HZ = 100.0
TYPE = "sensor_msgs/msg/JointState"
STORE = get_typestore(Stores.ROS2_HUMBLE)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("network")
    real_time(
        folder, hidden=(8, 5), rate_hz=RATE_HZ, joints=JOINTS, inputs=inputs_of(JOINTS), outputs=outputs_of(JOINTS)
    )
    return folder


def augmented(folder):
    return Augmented(Stream.load(folder, rate_hz=RATE_HZ, joints=JOINTS))


def through(where, folder, messages, *, others=0):
    """What a bridge of its own answers to messages that are published as fast as can be; so many hear each topic, too."""
    with Bridge(where, augmented(folder)) as bridge, Node(where) as node:
        source, answers = node.publish("/joint_states", JointState), node.listen("/corrected", JointState)
        wait_for(lambda: source.readers > others and answers.writers and bridge.outbox.readers > others)
        send_all(source, messages, every_s=0.001)
        return received(answers, node, len(messages))


@pytest.mark.long
def test_every_message_is_answered_once_and_in_order(folder):
    messages = [state(number / RATE_HZ, names=("x", "b", "a")) for number in range(500)]
    answers = through(network(), folder, messages)
    alone = augmented(folder)
    expected = [alone.to(message) for message in messages]
    assert [answer.header for answer in answers] == [message.header for message in messages]
    np.testing.assert_array_equal(arrays(answers), arrays(expected))
    np.testing.assert_array_equal(arrays(answers, "effort"), arrays(expected, "effort"))


@pytest.mark.long
def test_what_it_counts(folder):
    where = network()
    with Bridge(where, augmented(folder)) as bridge, Node(where) as node:
        source, answers = node.publish("/joint_states", JointState), node.listen("/corrected", JointState)
        wait_for(lambda: source.readers and bridge.outbox.readers)
        send_all(source, [state(number / RATE_HZ) for number in range(40)], every_s=0.002)
        send_all(source, [state(1.0, names=("finger",))])
        assert len(received(answers, node, 41)) == 41
    report = bridge.report
    assert (report.received, report.sent) == (41, 41)
    assert sum(report.counts.values()) == 41
    assert (report.concerned, report.others) == (40, ("finger",))
    assert len(report.added) == 41
    assert 0 < report.added.percentile_us(50.0) <= report.added.percentile_us(99.0) <= report.added.max_us
    assert 1 <= report.most_waiting <= 41
    tree = report.to_json()
    assert tree["added"]["count"] == 41
    assert sum(count for *_, count in tree["way"]["bins"]) == len(report.way) > 0


@pytest.mark.long
def test_many_that_had_to_wait_are_taken_a_few_at_a_time_and_all_counted_from_the_first(folder, monkeypatch):
    where, taken = network(), []
    with Node(where) as node, Node(where) as other:
        inbox, outbox = node.listen("/joint_states", JointState), node.publish("/corrected", JointState)
        source, answers = other.publish("/joint_states", JointState), other.listen("/corrected", JointState)
        wait_for(lambda: source.readers and answers.writers and outbox.readers)
        send_all(source, [state(number / RATE_HZ) for number in range(300)])
        take = inbox.take
        monkeypatch.setattr(inbox, "take", lambda most: taken.append(got := take(most)) or got)
        ticks = itertools.count(step=1000)
        clock = SimpleNamespace(perf_counter_ns=lambda: next(ticks), time_ns=time.time_ns, monotonic=time.monotonic)
        monkeypatch.setattr("trueup.ros2.bridge.time", clock)
        report = run_bridge(node, inbox, outbox, augmented(folder), seconds=0.5)
        assert len(received(answers, other, 300)) == 300
    assert max(map(len, taken)) == 64
    assert report.most_waiting == report.received == report.sent == 300
    assert report.added.max_us == 300.0  # a tick for each


@pytest.mark.long
def test_a_simulator_that_leaves_and_comes_back_is_heard_again(folder):
    where = network()
    with Bridge(where, augmented(folder)) as bridge, Node(where) as listener:
        answers = listener.listen("/corrected", JointState)
        for start_s in (0.0, 100.0, 0.0):  # it goes on later, or begins anew
            with Node(where) as node:
                source = node.publish("/joint_states", JointState)
                wait_for(lambda: source.readers and bridge.outbox.readers)  # noqa: B023 - it is over before the next
                send_all(source, [state(start_s + number / RATE_HZ) for number in range(30)], every_s=0.002)
                got = received(answers, listener, 30)
            assert len(got) == 30
            alone = augmented(folder)
            expected = [alone.to(state(start_s + number / RATE_HZ)) for number in range(30)]
            # As if there had been nobody before: the network's state is started anew after a gap.
            np.testing.assert_array_equal(arrays(got), arrays(expected))
            wait_for(lambda: not bridge.inbox.writers)
    assert bridge.report.counts["ok"] > 60


def test_a_listener_that_comes_late_gets_what_comes_then(folder):
    where = network()
    with Bridge(where, augmented(folder)) as bridge, Node(where) as node:
        source, early = node.publish("/joint_states", JointState), node.listen("/corrected", JointState)
        wait_for(lambda: source.readers and bridge.outbox.readers)
        send_all(source, [state(number / RATE_HZ) for number in range(20)], every_s=0.002)
        assert len(received(early, node, 20)) == 20  # nothing is under way when the other comes
        answers = node.listen("/corrected", JointState)
        wait_for(lambda: answers.writers and bridge.outbox.readers == 2)
        send_all(source, [state(number / RATE_HZ) for number in range(20, 30)], every_s=0.002)
        got = received(answers, node, 10)
    stamps = [message.header.stamp.ns for message in got]
    assert stamps == [state(number / RATE_HZ).header.stamp.ns for number in range(20, 30)]


def test_a_listener_that_asks_for_reliable_messages_hears_a_reliable_bridge_only(folder):
    for reliable in (False, True):
        where = network(reliable=reliable)
        with Node(where) as offering, Node(where) as other:
            outbox = offering.publish("/corrected", JointState)
            plain, reader = other.listen("/corrected", JointState), asking(other, "/corrected")
            wait_for(lambda: plain.writers)  # noqa: B023 - it is over before the next
            wait_for(lambda: outbox.readers == 2 if reliable else outbox.refused)  # noqa: B023 - likewise
            assert bool(reader.get_matched_publications()) == reliable
            assert outbox.readers == 1 + reliable
            assert outbox.refused == (None if reliable else "reliability")


def test_other_topics_are_heard_beside(folder, tmp_path):
    real_time(
        tmp_path,
        hidden=(8, 5),
        rate_hz=RATE_HZ,
        joints=JOINTS,
        inputs=inputs_of(JOINTS, command=True),
        outputs=outputs_of(JOINTS),
    )
    where, answer = network(), augmented(tmp_path)
    beside = [("/commands", answer.command.hear)]
    with Bridge(where, answer, beside=beside) as bridge, Node(where) as node:
        source, commands = node.publish("/joint_states", JointState), node.publish("/commands", JointState)
        answers = node.listen("/corrected", JointState)
        wait_for(lambda: source.readers and commands.readers and bridge.outbox.readers)
        commands.send(state(3.0))
        wait_for(lambda: np.isfinite(answer.command.values["position"]).all())
        send_all(source, [state(number / RATE_HZ) for number in range(20)], every_s=0.002)
        assert len(received(answers, node, 20)) == 20
    assert bridge.report.counts["ok"]


def test_what_the_first_message_lacks_ends_it(folder):
    where = network()

    def lacking():
        with Node(where) as node, Bridge(where, augmented(folder)) as bridge:
            source = node.publish("/joint_states", JointState)
            wait_for(lambda: source.readers)
            source.send(state(0.0, signals=("position", "velocity")))
            wait_for(lambda: not bridge._thread.is_alive())

    with pytest.raises(MissingSignal, match="torque"):
        lacking()


class Raw(JointState, typename=JointState.__idl_typename__):
    """A message with bytes in the place of its frame's letters."""

    def serialize(self, **how):
        """As C++ sends what nobody has looked at."""
        return super().serialize(**how).replace(b"frame", b"\xff\xfe\xc3\x28\x80")


def test_texts_that_are_none_are_dropped_and_counted_and_the_others_answered(folder):
    where, messages = network(), [state(number / RATE_HZ) for number in range(30)]
    with Bridge(where, augmented(folder)) as bridge, Node(where) as node:
        source, answers = node.publish("/joint_states", JointState), node.listen("/corrected", JointState)
        wait_for(lambda: source.readers and answers.writers and bridge.outbox.readers)
        for message in messages:
            source.send(Raw(Header(message.header.stamp, "frame"), message.name, message.position))
            source.send(message)
        got = received(answers, node, len(messages))
    assert [answer.header for answer in got] == [message.header for message in messages]
    assert bridge.report.unreadable == bridge.report.to_json()["unreadable"] == len(messages)
    assert bridge.report.received == len(messages)


def test_topics_say_the_hash_of_their_type():
    """As ROS 2 looks for it since Iron; without one, nodes on rmw_cyclonedds log a warning for each topic."""
    where = network()
    with Node(where) as one, Node(where) as other:
        for type_, topic in ((JointState, "/states"), (Float64MultiArray, "/commands")):
            outbox, inbox = one.publish(topic, type_), other.listen(topic, type_)
            wait_for(lambda: outbox.readers and inbox.writers)  # noqa: B023 - it is over before the next
            (reader,), (writer,) = (
                outbox._writer.get_matched_subscriptions(),
                inbox._reader.get_matched_publications(),
            )
            said = f"typehash={TYPE_HASHES[type_.__idl_typename__]};".encode()
            for endpoint in (
                outbox._writer.get_matched_subscription_data(reader),
                inbox._reader.get_matched_publication_data(writer),
            ):
                assert endpoint.qos[Policy.Userdata].data == said


@pytest.mark.long
def test_it_ends_when_its_time_is_over(folder):
    with Node(network()) as node:
        inbox, outbox = node.listen("/joint_states", JointState), node.publish("/corrected", JointState)
        seen = []
        report = run_bridge(
            node,
            inbox,
            outbox,
            augmented(folder),
            seconds=0.3,
            on_progress=lambda so_far: seen.append(so_far.received),
        )
    assert report.received == 0
    assert 0.3 <= report.seconds < 5.0
    assert seen == [0]


def test_a_domain_has_one_reach_in_a_process():
    where = network()
    with Node(where):
        pass
    with pytest.raises(ConfigError, match="another reach"):
        Node(type(where)(where.number, localhost=False))


class Recorder:
    """Joint states as they came off DDS, as `ros2 bag record` hears them."""

    def __init__(self, where, topic):
        self._node = Node(where)
        self._inbox = self._node.listen(topic, JointState)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._node.close()

    def taken(self, count):
        """So many messages."""
        return received(self._inbox, self._node, count)


def written(path, messages):
    """What a recorder has taken, in a bag."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/joint_states", TYPE, typestore=STORE)
        for message in messages:
            writer.write(connection, message.header.stamp.ns, message.serialize(use_version_2=False))
    return path


def played(path):
    """The messages of a bag."""
    with Reader(path) as reader:
        return [JointState.deserialize(bytes(raw)) for _, _, raw in reader.messages()]


@pytest.mark.long
def test_a_bag_of_a_run_plays_back_to_the_same_result(folder, tmp_path):
    """What came off DDS goes into a bag; played into another bridge, faster and on another day, it is answered the same."""
    messages, where = [state(number / RATE_HZ, names=("b", "gripper", "a")) for number in range(200)], network()
    with Recorder(where, "/joint_states") as states, Recorder(where, "/corrected") as answers:
        live = through(where, folder, messages, others=1)
        came, answered = states.taken(len(messages)), answers.taken(len(messages))
    assert len(came) == len(answered) == len(messages)
    bag = written(tmp_path / "states", came)
    again = through(network(), folder, played(bag))
    assert [answer.serialize(use_version_2=False) for answer in again] == [
        answer.serialize(use_version_2=False) for answer in live
    ]
    # And a bag of the answers is data like any other.
    written(tmp_path / "answers", answered)
    import_logs(tmp_path / "answers", tmp_path / "data")
    (episode,) = Dataset(tmp_path / "data")
    order = [list(live[0].name).index(joint) for joint in episode.measured.joints]
    np.testing.assert_array_equal(episode.measured["position"], arrays(live)[:, order])


def test_arrays_are_another_type(folder):
    """Who listens for joint states does not hear arrays on the same topic."""
    where = network()
    with Node(where) as one, Node(where) as other:
        outbox = one.publish("/commands", Float64MultiArray)
        states, numbers = other.listen("/commands", JointState), other.listen("/commands", Float64MultiArray)
        wait_for(lambda: numbers.writers)
        outbox.send(Float64MultiArray(data=[1.0, 2.0]))
        assert [list(message.data) for message in received(numbers, other, 1)] == [[1.0, 2.0]]
        assert not states.writers
        assert not states.take()


class Queue(Inbox):
    """Messages that wait, without a network."""

    def __init__(self, count):
        sample = SimpleNamespace(source_timestamp=time.time_ns())
        self.waiting = [SimpleNamespace(number=number, sample_info=sample) for number in range(count)]

    def take(self, most):
        taken, self.waiting = self.waiting[:most], self.waiting[most:]
        return taken


class Nowhere(Outbox):
    """Takes all."""

    def __init__(self):
        pass

    def send(self, message):
        """Nothing."""


@pytest.mark.parametrize(
    ("waited_s", "each_s", "first", "dropped"),
    [
        (0.0, 0.0, 0, 0),  # nobody was late
        (2.0, 0.0, 936, 936),  # the process had stood still
        (0.0, 0.005, 0, 1000 - 4 * 64 - 64),  # answers take longer than messages do
    ],
)
def test_what_has_waited_for_too_long_gives_way_to_what_is_new(monkeypatch, waited_s, each_s, first, dropped):
    now = [100.0]
    clock = SimpleNamespace(monotonic=lambda: now[0], time_ns=time.time_ns, perf_counter_ns=time.perf_counter_ns)
    monkeypatch.setattr("trueup.ros2.bridge.time", clock)
    answered, report = [], BridgeReport()

    def to(message):
        answered.append(message.number)
        now[0] += each_s
        return message

    queue, empty_at = Queue(1000), now[0] - waited_s
    answer = SimpleNamespace(to=to, counts=Counter(), flags=Counter(), others=(), rate_hz=np.nan)
    while queue.waiting:
        empty_at = _answer_all(report, queue, Nowhere(), answer, empty_at)
    assert (answered[0], answered[-1]) == (first, 999)
    assert answered == sorted(answered)
    assert report.dropped == dropped
    assert len(answered) == report.received == 1000 - dropped
    assert report.to_json()["dropped"] == dropped
