"""What keeps a bridge from correcting anything is said, once, with what to do."""

import pytest
from benchmarks.networks import inputs_of, outputs_of, real_time

from deploy.compensation_cases import compensation
from ros2.ros2_cases import JOINTS, network, state, wait_for
from trueup.deploy import Compensator, Limits, Stream
from trueup.ros2 import Augmented, Compensated, JointState, Node
from trueup.ros2.bridge import BridgeReport
from trueup.ros2.speakers import Speakers

RATE_HZ = 100.0
OTHERS = ("finger", "thumb")
LIMITS = Limits((-3.0, -3.0), (3.0, 3.0))


class Watched:
    """A bridge's answers, looked at once a second of their own time; no message goes through DDS."""

    def __init__(self, node, answer, stream, beside=()):
        self.answer, self.told = answer, []
        self.inbox = node.listen("/asked", JointState)
        beside = [(node.listen(topic, JointState), heard) for topic, heard in beside]
        self.speakers = Speakers(
            self.inbox, beside, answer, stream, message_hz=RATE_HZ, tell=lambda *said: self.told.append(said)
        )
        self.report = BridgeReport()

    def answered(self, messages, *, rate_hz=RATE_HZ):
        """These messages, and what was told until then."""
        for message in messages:
            self.answer.to(message)
            self.report.received += 1
            if self.report.received % rate_hz == 0:
                self.report.note(self.report.received / rate_hz, self.answer, self.inbox)
                self.speakers.look(self.report)
        return self.told


@pytest.fixture
def node():
    with Node(network()) as node:
        yield node


def augmented(folder, *, command=False):
    channels = {"inputs": inputs_of(JOINTS, command=command), "outputs": outputs_of(JOINTS)}
    real_time(folder, hidden=(8, 5), rate_hz=RATE_HZ, joints=JOINTS, **channels)
    stream = Stream.load(folder, rate_hz=RATE_HZ, joints=JOINTS)
    return Augmented(stream), stream


def compensated(folder):
    compensation(folder, JOINTS, rate_hz=RATE_HZ)
    stream = Stream.load(folder, rate_hz=RATE_HZ, joints=JOINTS)
    return Compensated(Compensator(stream, limits=LIMITS, payload_kg=1.0)), stream


def test_where_all_is_well_nothing_is_said(node, tmp_path):
    watched = Watched(node, *augmented(tmp_path))
    assert watched.answered(state(number / RATE_HZ, names=("x", *JOINTS)) for number in range(500)) == []


def test_names_of_other_joints_are_both_listed(node, tmp_path):
    watched = Watched(node, *augmented(tmp_path))
    messages = [state(number / RATE_HZ, names=OTHERS) for number in range(600)]
    assert watched.answered(messages[:200]) == []
    ((message, hint),) = watched.answered(messages[200:])
    assert message == (
        "messages on /asked are of other joints: the network needs [a, b], published are [finger, thumb]"
    )
    assert "these names" in hint
    assert (watched.report.concerned, watched.report.others) == (0, OTHERS)


def test_arrays_that_do_not_fit_are_not_called_other_joints(node, tmp_path):
    watched = Watched(node, *augmented(tmp_path))
    messages = [state(number / RATE_HZ) for number in range(400)]
    for message in messages:
        message.position = [1.0]
    ((message, _),) = watched.answered(messages)
    assert message == "messages on /asked say nothing of their joints"


def test_a_rate_that_was_not_said_is_measured(node, tmp_path):
    watched = Watched(node, *augmented(tmp_path))
    ((message, hint),) = watched.answered((state(number / 1000.0) for number in range(6000)), rate_hz=1000.0)
    assert message == "nothing is corrected (OFF_RATE): messages come at 1000 Hz by their stamps, not at 100 Hz"
    assert "--hz" in hint
    assert watched.report.to_json()["reasons"]["OFF_RATE"] == watched.report.counts["fallback"]


@pytest.mark.long
def test_a_robot_without_velocities_and_one_of_other_joints(node, tmp_path):
    answer, stream = compensated(tmp_path)
    watched = Watched(node, answer, stream, [("/joint_states", answer.states)])
    targets = [state(number / RATE_HZ, signals=("position",)) for number in range(1200)]
    answer.states.hear(state(0.0, names=OTHERS))
    told = watched.answered(targets[:400])
    assert [message for message, _ in told] == [
        "messages on /joint_states are of other joints: the network needs [a, b], published are [finger, thumb]",
        told[1][0],
    ]
    assert "no number" in told[1][0]
    assert "nobody publishes /joint_states" in told[1][0]

    watched.told.clear()
    watched.speakers._told.clear()
    with Node(node.network) as robot:
        states = robot.publish("/joint_states", JointState)
        wait_for(lambda: states.readers)
        for target in targets[400:]:
            answer.states.hear(state(0.0, signals=("position",)))
            watched.answered([target])
    ((message, _),) = watched.told
    assert "velocity" in message
    assert "nobody" not in message


def test_commands_that_nobody_publishes(node, tmp_path):
    answer, stream = augmented(tmp_path, command=True)
    watched = Watched(node, answer, stream, [("/commands", answer.command)])
    ((message, hint),) = watched.answered(state(number / RATE_HZ) for number in range(500))
    assert message.startswith("nothing is corrected (NAN): what it reads is no number: ")
    assert message.endswith("; nobody publishes /commands")
    assert "--commands" in hint
