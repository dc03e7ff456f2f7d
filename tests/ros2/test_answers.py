"""Message in, message out: the numbers are those of `Stream` and `Compensator`."""

import math
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.networks import inputs_of, outputs_of, real_time

from deploy.compensation_cases import compensation
from ros2.ros2_cases import JOINTS, state
from trueup.deploy import Compensator, Limits, Status, Stream, StreamSettings, Why
from trueup.errors import ConfigError, MissingSignal
from trueup.ros2 import Augmented, Compensated, Float64MultiArray, JointState
from trueup.ros2.answers import UNTOUCHED, Heard
from trueup.ros2.joints import JointColumns

RATE_HZ = 100.0
FIELD = {"position": "position", "velocity": "velocity", "torque": "effort"}
LIMITS = Limits((-3.0, -3.0), (3.0, 3.0))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("network")
    real_time(
        folder, hidden=(8, 5), rate_hz=RATE_HZ, joints=JOINTS, inputs=inputs_of(JOINTS), outputs=outputs_of(JOINTS)
    )
    return folder


@pytest.fixture(scope="module")
def compensated(tmp_path_factory):
    folder = tmp_path_factory.mktemp("compensation")
    compensation(folder, JOINTS, rate_hz=RATE_HZ)
    return folder


def stream(folder, **settings):
    return Stream.load(folder, rate_hz=RATE_HZ, joints=JOINTS, settings=StreamSettings(**settings))


def values(message, joints=JOINTS):
    """Signal -> values of a message, joints in this order."""
    columns = [list(message.name).index(joint) for joint in joints]
    return {signal: np.array(getattr(message, field))[columns] for signal, field in FIELD.items()}


def test_it_is_the_stream(folder):
    bridge, alone = Augmented(stream(folder)), stream(folder)
    changed = 0.0
    for number in range(60):
        message = state(number / RATE_HZ)
        answer = bridge.to(message)
        step = alone.step(values(message), time_s=number / RATE_HZ)
        for signal, field in FIELD.items():
            np.testing.assert_array_equal(getattr(answer, field), step[signal])
        assert (answer.header, answer.name) == (message.header, message.name)
        changed = max(changed, np.abs(values(answer)["position"] - values(message)["position"]).max())
    assert changed > 0.01
    assert bridge.counts == {"warming": alone.card.warmup_steps, "ok": 60 - alone.card.warmup_steps}


def test_joints_in_any_order_and_among_others(folder):
    plain, mixed = Augmented(stream(folder)), Augmented(stream(folder))
    for number in range(30):
        expected = values(plain.to(state(number / RATE_HZ)))
        message = state(number / RATE_HZ, names=("finger", "b", "wheel", "a"))
        answer = mixed.to(message)
        assert list(answer.name) == list(message.name)
        for signal, field in FIELD.items():
            np.testing.assert_array_equal(values(answer)[signal], expected[signal])
            for other in (0, 2):  # of no concern to the network
                assert getattr(answer, field)[other] == getattr(message, field)[other]


@pytest.mark.parametrize(
    "message",
    [
        state(0.5, names=("finger",)),
        state(0.5, names=("a",)),
        state(0.5, names=("a", "b", "a")),
        state(0.5, names=()),
        replace(state(0.5), position=[1.0]),
        replace(state(0.5), effort=[1.0, 2.0, 3.0]),
    ],
)
def test_what_is_of_other_joints_or_broken_is_passed_on_as_it_is(folder, message):
    bridge = Augmented(stream(folder))
    bridge.to(state(0.0))
    assert bridge.to(message) is message
    assert bridge.counts[UNTOUCHED] == 1
    # And does not disturb the others.
    alone = stream(folder)
    alone.step(values(state(0.0)), time_s=0.0)
    step = alone.step(values(state(0.01)), time_s=0.01)
    np.testing.assert_array_equal(bridge.to(state(0.01)).position, step["position"])


def test_a_signal_that_never_comes_is_refused_by_name(folder):
    bridge = Augmented(stream(folder))
    bridge.to(state(0.0, names=("finger",)))
    with pytest.raises(MissingSignal, match="torque"):
        bridge.to(state(0.0, signals=("position", "velocity")))


def test_between_the_networks_samples_its_correction_is_held(folder):
    """Ten messages for each of the network's samples; one of them is lost."""
    bridge, alone = Augmented(stream(folder, missed_periods=2.5), message_hz=1000.0), stream(folder)
    correction = {}
    for number in range(600):
        if number in (203, 410):  # one between the samples, and one that would have been a sample
            continue
        message = state(number / 1000.0)
        answer = values(bridge.to(message))
        if number % 10 == 0 or number == 411:
            step = alone.step(values(message), time_s=number / 1000.0)
            correction = {signal: step[signal] - values(message)[signal] for signal in FIELD}
            for signal in FIELD:
                np.testing.assert_array_equal(answer[signal], step[signal])
        else:
            for signal in FIELD:
                np.testing.assert_allclose(answer[signal], values(message)[signal] + correction[signal], atol=1e-15)
    assert bridge.counts.total() == 598
    assert bridge.counts["ok"] > 500


def test_what_is_not_a_number_holds_the_answer_before(folder):
    bridge, alone = Augmented(stream(folder)), stream(folder)
    for number in range(20):
        before = bridge.to(state(number / RATE_HZ))
        alone.step(values(state(number / RATE_HZ)), time_s=number / RATE_HZ)
    broken = replace(state(0.2), velocity=[math.nan, 0.0])
    answer = bridge.to(broken)
    assert answer.position == before.position
    assert answer.header == broken.header
    assert bridge.counts["held"] == 1
    alone.step(values(broken), time_s=0.2)
    np.testing.assert_array_equal(
        bridge.to(state(0.21)).position, alone.step(values(state(0.21)), time_s=0.21)["position"]
    )


def test_at_a_higher_rate_nothing_is_added_to_what_is_held(folder):
    bridge = Augmented(stream(folder), message_hz=1000.0)
    for number in range(300):
        message = state(number / 1000.0)
        before = bridge.to(message)
    held = bridge.to(replace(state(0.3), velocity=[math.nan, 0.0]))
    assert held.position != before.position or bridge.counts["held"] == 1
    between = bridge.to(state(0.301))
    assert between.position == held.position


def test_a_clock_that_is_set_back_begins_anew(folder):
    bridge = Augmented(stream(folder))
    first = [bridge.to(state(number / RATE_HZ)) for number in range(50)]
    again = [bridge.to(state(number / RATE_HZ)) for number in range(50)]  # a simulation that was started again
    # The stream's stamps go on from the bag's first; what it says of the same motion is the same again.
    assert [list(message.position) for message in first] == [list(message.position) for message in again]


@pytest.mark.parametrize("jump_s", [-3600.0, -0.02, 0.05, 3600.0])
def test_whatever_the_clock_does_there_is_an_answer_of_numbers(folder, jump_s):
    bridge = Augmented(stream(folder))
    for number in range(30):
        bridge.to(state(number / RATE_HZ))
    for number in range(30):
        message = state(0.3 + number / RATE_HZ)
        stamp_ns = message.header.stamp.ns + round(jump_s * 1e9)
        message.header.stamp = type(message.header.stamp).of_ns(stamp_ns)
        answer = bridge.to(message)
        assert np.isfinite(answer.position).all()
        assert answer.header.stamp.ns == stamp_ns
    assert bridge.counts["ok"] >= 30  # the network is heard again after a while


def test_messages_without_a_stamp_are_timed_when_they_come(folder, monkeypatch):
    now = iter(range(0, 10**12, 10_000_000))
    monkeypatch.setattr("trueup.ros2.answers.time.monotonic_ns", lambda: next(now))
    bridge = Augmented(stream(folder))
    for number in range(20):
        message = state(number / RATE_HZ)
        message.header.stamp = type(message.header.stamp)()
        bridge.to(message)
    assert bridge.counts["ok"] == 20 - stream(folder).card.warmup_steps


def test_networks_of_commands_correct_no_states(compensated):
    with pytest.raises(ConfigError, match="corrects no joint states"):
        Augmented(stream(compensated))


@pytest.mark.parametrize("message_hz", [50.0, 130.0, math.inf, -100.0])
def test_rates_that_do_not_fit(folder, message_hz):
    with pytest.raises(ConfigError, match="rate"):
        Augmented(stream(folder), message_hz=message_hz)


def test_a_network_that_reads_commands_holds_until_there_is_one(tmp_path):
    real_time(
        tmp_path,
        hidden=(8, 5),
        rate_hz=RATE_HZ,
        joints=JOINTS,
        inputs=inputs_of(JOINTS, command=True),
        outputs=outputs_of(JOINTS),
    )
    bridge, alone = Augmented(stream(tmp_path)), stream(tmp_path)
    bridge.to(state(0.0))
    assert bridge.counts == {"held": 1}
    bridge.command.hear(state(7.0, names=("finger",)))  # says nothing of these joints
    bridge.command.hear(state(7.0, names=("b", "a")))
    alone.step(values(state(0.0)), {"position": np.full(2, np.nan)}, time_s=0.0)
    command = values(state(7.0))
    for number in range(1, 30):
        step = alone.step(values(state(number / RATE_HZ)), command, time_s=number / RATE_HZ)
        np.testing.assert_array_equal(bridge.to(state(number / RATE_HZ)).position, step["position"])
    assert bridge.counts["ok"]


@pytest.mark.parametrize("message_hz", [RATE_HZ, 1000.0])
def test_until_a_first_answer_the_simulators_own_values_go_on(tmp_path, message_hz):
    """A network that reads commands which nobody has said: no NaN goes out that has not come in."""
    channels = {"inputs": inputs_of(JOINTS, command=True), "outputs": outputs_of(JOINTS)}
    real_time(tmp_path, hidden=(8, 5), rate_hz=RATE_HZ, joints=JOINTS, **channels)
    bridge = Augmented(stream(tmp_path), message_hz=message_hz)
    for number in range(25):
        message = state(number / message_hz, names=("x", "b", "a"))
        if number == 7:
            message.velocity[1] = math.nan
        answer = bridge.to(message)
        for field in FIELD.values():
            np.testing.assert_array_equal(getattr(answer, field), getattr(message, field))
    assert bridge.counts == {"held": 25}
    assert bridge.flags == {int(Why.NAN): 25}


def test_what_is_wrong_is_counted_by_reason(folder):
    bridge = Augmented(stream(folder))
    for number in range(300):
        bridge.to(state(number / 1000.0))  # ten times as often as was said
    assert bridge.counts["fallback"] > 200
    assert bridge.flags[int(Why.OFF_RATE)] == bridge.counts["fallback"]
    assert bridge.rate_hz == pytest.approx(1000.0)
    bridge.to(state(100.0))  # after a pause, and after a clock that was set back, a rate is that of what comes then
    for number in range(100):
        bridge.to(state(50.0 + number / RATE_HZ))
    assert bridge.rate_hz == pytest.approx(RATE_HZ)


def test_what_else_is_heard_counts_what_it_ignores():
    heard = Heard(JOINTS, ("position",))
    heard.hear(state(0.0, names=("finger", "thumb")))
    heard.hear(state(0.0))
    heard.hear(replace(state(0.0), position=[], velocity=[], effort=[]))
    assert (heard.heard, heard.ignored, heard.others) == (1, 2, ("finger", "thumb"))


def compensator(folder):
    return Compensator.load(folder, joints=JOINTS, limits=LIMITS, payload_kg=1.0)


def test_it_is_the_compensator(compensated):
    bridge, alone = Compensated(compensator(compensated)), compensator(compensated)
    for number in range(80):
        seen, target = state(number / RATE_HZ), state(number / RATE_HZ + 0.1, signals=("position",))
        bridge.states.hear(seen)
        answer = bridge.to(target)
        said = values(seen)
        expected = alone.step(said["position"], said["velocity"], np.array(target.position), time_s=number / RATE_HZ)
        np.testing.assert_array_equal(answer.position, expected.target)
        assert (list(answer.name), answer.header) == (list(JOINTS), target.header)
    assert bridge.counts["ok"] > 50
    assert np.abs(alone.latest.delta).max() > 0.005


def test_commands_as_an_array_are_in_the_robots_order(compensated):
    bridge, plain = Compensated(compensator(compensated), form=Float64MultiArray), Compensated(compensator(compensated))
    for number in range(20):
        for one in (bridge, plain):
            one.states.hear(state(number / RATE_HZ))
        target = state(number / RATE_HZ, names=("b", "a"), signals=("position",))
        answer, expected = bridge.to(target), plain.to(target)
        assert isinstance(answer, Float64MultiArray)
        assert list(answer.data) == [expected.position[1], expected.position[0]]


def test_targets_of_other_joints_become_no_command(compensated):
    bridge = Compensated(compensator(compensated))
    bridge.states.hear(state(0.0))
    assert bridge.to(state(0.0, names=("finger",))) is None
    assert bridge.to(replace(state(0.0), position=[])) is None
    assert bridge.counts == {UNTOUCHED: 2}


def test_where_nobody_knows_where_the_robot_is_the_correction_fades_out(compensated, monkeypatch):
    bridge = Compensated(compensator(compensated))
    now = [0.0]
    monkeypatch.setattr("trueup.ros2.answers.time.monotonic", lambda: now[0])
    target = state(0.3, signals=("position",))

    def asked(number, *, hears):
        now[0] = number / RATE_HZ
        if hears:
            bridge.states.hear(state(number / RATE_HZ))
        message = state(number / RATE_HZ, signals=("position",))
        message.position = list(target.position)
        return np.array(bridge.to(message).position) - target.position

    deltas = [asked(number, hears=number < 60) for number in range(160)]
    assert np.abs(deltas[59]).max() > 0.005
    np.testing.assert_allclose(deltas[-1], 0.0, atol=1e-12)
    assert bridge.counts[Status.HELD.value] > 50
    jumps = np.abs(np.diff(deltas, axis=0)).max(axis=0)
    assert (jumps <= compensator(compensated).largest * 10.0 / RATE_HZ + 1e-12).all()  # no step of the command, either


def test_before_anything_is_known_nothing_is_commanded(compensated):
    bridge = Compensated(compensator(compensated))
    message = state(0.0, signals=("position",))
    message.position = [math.nan, 0.1]
    assert bridge.to(message) is None


def test_columns_follow_publishers_that_change_their_mind():
    columns = JointColumns(("a", "b"))
    for names in (("a", "b"), ("b", "a"), ("x", "a", "y", "b"), ("b",), ("b", "a")):
        read = columns.read(state(0.0, names=names))
        if set(JOINTS) <= set(names):
            np.testing.assert_array_equal(read["position"], values(state(0.0))["position"])
        else:
            assert read is None


def test_a_field_that_was_not_there_is_unknown_for_other_joints():
    columns = JointColumns(("a", "b"))
    message = state(0.0, names=("x", "b", "a"), signals=("position",))
    columns.read(message)
    written = columns.written(message, {"torque": np.array([1.0, 2.0])})
    np.testing.assert_array_equal(written.effort, [math.nan, 2.0, 1.0])
    assert isinstance(written, JointState)
    assert written.position == message.position
