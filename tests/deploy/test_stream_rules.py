"""When a stream holds, falls back and starts anew: each rule by itself, then all of them against the careful way."""

import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from benchmarks.networks import JOINTS, changed, inputs_of, motion, real_time, window
from hypothesis import given
from hypothesis import strategies as st
from onnx import helper, numpy_helper

from trueup.core.model_card import Output
from trueup.deploy import Network, Predictor, Status, Stream, StreamSettings, Why

WARMUP = 5  # of the networks
PERIOD_S = 1e-3


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return real_time(tmp_path_factory.mktemp("rt"), hidden=(8, 5))


@pytest.fixture
def x(made):
    return motion(made.card, 60)[:, 0].astype(np.float64)


@pytest.fixture
def stream(made):
    return Stream.load(made.folder, rate_hz=1000.0, joints=JOINTS)


def warm(stream, x, steps=20, *, timed=True):
    for t in range(steps):
        step = stream.step_vector(x[t], time_s=t * PERIOD_S if timed else None)
    assert step.status is Status.OK
    assert step.why == Why.NONE
    return step


def offline(made, rows):
    return Predictor.load(made.folder).run(np.asarray(rows, np.float32)[:, None])[:, 0]


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("timed", [True, False])
def test_a_sample_that_is_not_finite_is_held_and_does_not_touch_the_state(made, stream, x, value, timed):
    last = warm(stream, x, timed=timed).values.copy()
    bad = x[20].copy()
    bad[[3, 17]] = value
    step = stream.step_vector(bad, time_s=20 * PERIOD_S if timed else None)
    assert (step.status, step.why) == (Status.HELD, Why.NAN)
    assert step.channels() == ("simulated.position.joint4", "simulated.torque.joint4")
    assert step.age_s == pytest.approx(PERIOD_S)
    np.testing.assert_array_equal(step.values, last)
    after = stream.step_vector(x[21], time_s=21 * PERIOD_S if timed else None)
    assert (after.status, after.why, after.age_s) == (Status.OK, Why.NONE, 0.0)
    np.testing.assert_allclose(after.values, offline(made, [*x[:20], x[21]])[-1], atol=1e-5 * 50)


def test_before_any_good_sample_there_is_no_number_that_could_be_taken_for_the_robot(stream, x):
    for t in range(3):
        step = stream.step_vector(np.full(21, np.nan), time_s=t * PERIOD_S)
        assert (step.status, step.why, step.age_s) == (Status.HELD, Why.NAN, np.inf)
        assert np.isnan(step.values).all()
    step = stream.step_vector(x[0], time_s=3 * PERIOD_S)
    assert step.status is Status.WARMING
    np.testing.assert_array_equal(step.values, x[0])


@pytest.mark.parametrize("timed", [True, False])
def test_after_too_many_bad_samples_it_warms_up_again(made, stream, x, timed):
    """Five periods without a usable sample are too long; four are not."""
    time = [t * PERIOD_S if timed else None for t in range(60)]
    for bad, begins_anew in ((4, False), (6, True)):
        stream.reset()
        warm(stream, x, timed=timed)
        for t in range(20, 20 + bad):
            assert stream.step_vector(np.full(21, np.nan), time_s=time[t]).status is Status.HELD
        statuses = [stream.step_vector(x[t], time_s=time[t]).status for t in range(20 + bad, 60)]
        assert statuses[:WARMUP] == [Status.WARMING if begins_anew else Status.OK] * WARMUP
        assert set(statuses[WARMUP:]) == {Status.OK}
        kept = [] if begins_anew else [*x[:20]]
        np.testing.assert_allclose(stream.latest.values, offline(made, [*kept, *x[20 + bad :]])[-1], atol=1e-5 * 50)


def test_one_missed_sample_is_said_once(stream, x):
    warm(stream, x)
    step = stream.step_vector(x[21], time_s=21 * PERIOD_S)
    assert (step.status, step.why) == (Status.OK, Why.MISSED)
    step = stream.step_vector(x[22], time_s=22 * PERIOD_S)
    assert (step.status, step.why) == (Status.OK, Why.NONE)


def test_jitter_below_half_a_period_is_no_miss(stream, x):
    rng = np.random.default_rng(0)
    for t in range(60):
        step = stream.step_vector(x[t], time_s=(t + 0.2 * rng.uniform(-1, 1)) * PERIOD_S)
        assert step.why == Why.NONE
    assert step.status is Status.OK


def test_a_long_gap_starts_anew(made, stream, x):
    warm(stream, x)
    step = stream.step_vector(x[30], time_s=26 * PERIOD_S)
    assert (step.status, step.why) == (Status.WARMING, Why.MISSED)
    np.testing.assert_array_equal(step.values, x[30])
    statuses = [stream.step_vector(x[t], time_s=(t - 4) * PERIOD_S).status for t in range(31, 40)]
    assert statuses == [Status.WARMING] * (WARMUP - 1) + [Status.OK] * 5
    np.testing.assert_allclose(stream.latest.values, offline(made, x[30:40])[-1], atol=1e-5 * 50)


@pytest.mark.parametrize("back", [0, 1, 3])
def test_a_time_that_does_not_go_on_is_held(made, stream, x, back):
    last = warm(stream, x).values.copy()
    step = stream.step_vector(x[20], time_s=(19 - back) * PERIOD_S)
    assert (step.status, step.why, step.age_s) == (Status.HELD, Why.STALLED, PERIOD_S)
    np.testing.assert_array_equal(step.values, last)
    step = stream.step_vector(x[21], time_s=20 * PERIOD_S)
    assert step.status is Status.OK
    np.testing.assert_allclose(step.values, offline(made, [*x[:20], x[21]])[-1], atol=1e-5 * 50)


def test_a_clock_that_was_set_back_is_a_new_start_and_not_the_end(made, stream, x):
    """The simulator was reset to time 0: the stream must not hold until its old time comes around again."""
    warm(stream, x, 60)
    stream.step_vector(np.full(21, np.nan), time_s=0.0)
    statuses = [stream.step_vector(x[t], time_s=(t + 1) * PERIOD_S).status for t in range(20)]
    assert statuses == [Status.WARMING] * WARMUP + [Status.OK] * (20 - WARMUP)
    np.testing.assert_allclose(stream.latest.values, offline(made, x[:20])[-1], atol=1e-5 * 50)


def test_a_time_that_is_not_a_number_is_held(stream, x):
    last = warm(stream, x).values.copy()
    for time_s in (np.nan, np.inf):
        step = stream.step_vector(x[20], time_s=float(time_s))
        assert (step.status, step.why) == (Status.HELD, Why.NAN)
        np.testing.assert_array_equal(step.values, last)
    assert stream.step_vector(x[20], time_s=20 * PERIOD_S).status is Status.OK


@pytest.mark.parametrize("timed", [True, False])
def test_an_input_that_repeats_while_it_moves_has_stalled(made, stream, x, timed):
    warm(stream, x, timed=timed)
    steps = [stream.step_vector(x[19], time_s=t * PERIOD_S if timed else None) for t in range(20, 23)]
    assert {(step.status, step.why) for step in steps} == {(Status.OK, Why.NONE)}
    last = stream.latest.values.copy()
    step = stream.step_vector(x[19], time_s=23 * PERIOD_S if timed else None)
    assert (step.status, step.why) == (Status.HELD, Why.STALLED)
    np.testing.assert_array_equal(step.values, last)
    step = stream.step_vector(x[20], time_s=24 * PERIOD_S if timed else None)
    assert step.status is Status.OK
    np.testing.assert_allclose(step.values, offline(made, [*x[:20], *[x[19]] * 3, x[20]])[-1], atol=1e-5 * 50)


def test_a_simulator_at_half_the_rate_has_not_stalled(stream, x):
    for t in range(60):
        step = stream.step_vector(x[t // 2], time_s=t * PERIOD_S)
        assert step.why == Why.NONE
    assert step.status is Status.OK


def test_a_robot_at_rest_has_not_stalled(stream, x):
    warm(stream, x)
    still = x[19].copy()
    still[7:14] = 0.009  # below `moving_speed`
    for t in range(20, 60):
        step = stream.step_vector(still, time_s=t * PERIOD_S)
        assert (step.status, step.why) == (Status.OK, Why.NONE)


def reading(signals, *, command, mixed=False):
    """What a card says of a network that reads these simulated signals, perhaps the commanded position between them."""
    inputs = [c for c in inputs_of(command=command) if c.series == "command" or c.signal in signals]
    if mixed:
        inputs.sort(key=lambda channel: channel.joint)
    outputs = [Output(c.signal, c.joint, c.unit, base=k) for k, c in enumerate(inputs) if c.series == "simulated"]
    return {"inputs": tuple(inputs), "outputs": tuple(outputs)}


ALL, NO_SPEED = ("position", "velocity", "torque"), ("position", "torque")
CARDS = {
    "plain": reading(ALL, command=False),
    "command": reading(ALL, command=True),
    "command between": reading(ALL, command=True, mixed=True),
    "no speed, command": reading(NO_SPEED, command=True),
    "no speed, command between": reading(NO_SPEED, command=True, mixed=True),
    "no speed": reading(NO_SPEED, command=False),
}


@cache
def opened(make, card):
    folder = Path(tempfile.mkdtemp(prefix="trueup-rules-"))
    return Network.load(make(folder, hidden=(6,), **CARDS[card]).folder)


def frozen(network, *, resting=False, commanded=True):
    """Answers of a stream whose simulator stops at sample 20 while the command goes on; or both stop."""
    channels = network.card.inputs
    x = motion(network.card, 320)[:, 0].astype(np.float64)
    simulated = [number for number, channel in enumerate(channels) if channel.series == "simulated"]
    x[20:, simulated] = x[19, simulated]
    if resting:
        x[20:, [number for number in simulated if channels[number].signal == "velocity"]] = 0.0
    if not commanded:
        x[20:] = x[20]
    stream = Stream(network, rate_hz=1000.0, joints=JOINTS)
    steps = [stream.step_vector(row, time_s=t * PERIOD_S) for t, row in enumerate(x[:20])]
    assert steps[-1].status is Status.OK
    return [
        (step.status, step.why)
        for t in range(20, 320)
        for step in [stream.step_vector(x[t], time_s=t * PERIOD_S)]
    ]  # fmt: skip


HELD, OK = (Status.HELD, Why.STALLED), (Status.OK, Why.NONE)


@pytest.mark.parametrize("make", [real_time, window])
@pytest.mark.parametrize("card", ["command", "command between"])
def test_a_command_that_goes_on_does_not_hide_a_simulator_that_does_not(make, card):
    assert frozen(opened(make, card)) == [OK] * 3 + [HELD] * 297
    # At rest, the first sample has another velocity than the one before.
    assert frozen(opened(make, card), resting=True) == [OK] * 300


@pytest.mark.parametrize("card", ["no speed, command", "no speed, command between"])
def test_without_a_velocity_a_command_that_changes_says_that_it_moves(card):
    assert frozen(opened(real_time, card)) == [OK] * 3 + [HELD] * 297
    # The command changes with the first sample that repeats, and then no more: one step of it.
    assert frozen(opened(real_time, card), commanded=False) == [OK] * 3 + [HELD] * 297


@pytest.mark.parametrize("card", ["no speed, command", "no speed, command between"])
def test_without_a_velocity_a_command_that_stays_is_rest(card):
    network = opened(real_time, card)
    x = motion(network.card, 60)[:, 0].astype(np.float64)
    x[20:] = x[19]
    stream = Stream(network, rate_hz=1000.0, joints=JOINTS)
    for t in range(60):
        step = stream.step_vector(x[t], time_s=t * PERIOD_S)
    assert (step.status, step.why) == OK


@pytest.mark.parametrize("card", ["no speed, command", "no speed, command between"])
def test_what_a_command_did_before_the_simulator_rested_is_no_stall(card):
    """A repeat with a new command, a sample that moves, and then rest: the repeat is forgotten."""
    network = opened(real_time, card)
    x = motion(network.card, 22)[:, 0].astype(np.float64)
    simulated = [number for number, channel in enumerate(network.card.inputs) if channel.series == "simulated"]
    x[20, simulated] = x[19, simulated]
    stream = Stream(network, rate_hz=1000.0, joints=JOINTS)
    warm(stream, x)
    for t in range(20, 60):
        step = stream.step_vector(x[min(t, 21)], time_s=t * PERIOD_S)
        assert (step.status, step.why) == OK


def test_without_velocity_and_command_nothing_tells_a_stall_from_rest():
    assert frozen(opened(real_time, "no speed")) == [OK] * 300


def test_a_stream_has_no_more_attributes_than_python_finds_quickly(stream):
    """CPython up to 3.13 shares the keys of thirty (SHARED_KEYS_MAX_SIZE)."""
    assert len(vars(stream)) <= 30


def test_polling_says_when_the_input_died(stream, x):
    assert stream.poll(3.0).status is Status.HELD
    last = warm(stream, x).values.copy()  # the last sample came at 19 ms
    assert (stream.poll(0.0204).status, stream.poll(0.0204).why) == (Status.OK, Why.NONE)
    step = stream.poll(0.021)
    assert (step.status, step.why) == (Status.HELD, Why.MISSED)
    assert step.age_s == pytest.approx(0.002)
    step = stream.poll(0.030)
    assert (step.status, step.why) == (Status.HELD, Why.MISSED | Why.STALLED)
    np.testing.assert_array_equal(step.values, last)
    assert stream.step_vector(x[20], time_s=0.031).status is Status.WARMING


def test_polling_does_not_disturb(made, stream, x):
    for t in range(20):
        stream.poll(t * PERIOD_S + 0.0001)
        stream.step_vector(x[t], time_s=t * PERIOD_S)
    stream.poll(0.021)
    step = stream.step_vector(x[20], time_s=0.0211)
    assert (step.status, step.why) == (Status.OK, Why.MISSED)
    np.testing.assert_allclose(step.values, offline(made, x[:21])[-1], atol=1e-5 * 50)


@pytest.mark.parametrize("time_s", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("timed", [True, False])
def test_polling_at_a_time_that_is_not_a_number_is_held(stream, x, time_s, timed):
    last = warm(stream, x, timed=timed).values.copy()
    step = stream.poll(float(time_s))
    assert (step.status, step.why) == (Status.HELD, Why.NAN)
    assert step.age_s == pytest.approx(PERIOD_S)
    np.testing.assert_array_equal(step.values, last)
    after = stream.step_vector(x[20], time_s=20 * PERIOD_S if timed else None)
    assert (after.status, after.why) == (Status.OK, Why.NONE)


def test_polling_without_times_knows_nothing(stream, x):
    warm(stream, x, timed=False)
    assert stream.poll(100.0).status is Status.OK


def test_outside_of_the_training_range_it_is_the_simulator(made, stream, x):
    """Torque of joint 1 was trained on -50 to 50 Nm; with a margin of a tenth of that range, 60 Nm is the end."""
    warm(stream, x)
    near = x[20].copy()
    near[14] = 59.9
    assert stream.step_vector(near).status is Status.OK
    far = x[21].copy()
    far[[14, 20]] = [80.0, -1e6]
    step = stream.step_vector(far)
    assert (step.status, step.why) == (Status.FALLBACK, Why.OUT_OF_RANGE)
    assert step.channels() == ("simulated.torque.joint1", "simulated.torque.joint7")
    np.testing.assert_array_equal(step.values, far)
    # The state goes on with the clipped input; corrections come back after a warm-up.
    clipped = far.copy()
    clipped[[14, 20]] = [60.0, -60.0]
    statuses = []
    for t in range(22, 40):
        statuses.append(stream.step_vector(x[t]).status)
        if statuses[-1] is Status.WARMING:
            np.testing.assert_array_equal(stream.latest.values, x[t])
    assert statuses == [Status.WARMING] * WARMUP + [Status.OK] * (18 - WARMUP)
    assert stream.latest.channels() == ()
    np.testing.assert_allclose(
        stream.latest.values, offline(made, [*x[:20], near, clipped, *x[22:40]])[-1], atol=2e-5 * 50
    )


def test_the_margin_is_the_cards_or_the_callers(made, x):
    tight = Stream.load(made.folder, rate_hz=1000.0, joints=JOINTS, settings=StreamSettings(margin=0.0))
    wide = Stream.load(made.folder, rate_hz=1000.0, joints=JOINTS, settings=StreamSettings(margin=1.0))
    beyond = x[0].copy()
    beyond[14] = 50.01
    assert tight.step_vector(beyond).status is Status.FALLBACK
    beyond[14] = 149.0
    assert wide.step_vector(beyond).status is Status.WARMING


def test_out_of_range_from_the_start_on(stream, x):
    far = x[0].copy()
    far[0] = 100.0
    step = stream.step_vector(far)
    assert step.status is Status.FALLBACK
    np.testing.assert_array_equal(step.values, far)


@pytest.mark.parametrize("factor", [0.5, 0.8, 1.3, 2.0, 10.0])
def test_another_rate_than_declared_is_found_out(stream, x, factor):
    """A loop at 2 kHz, 800 Hz, 100 Hz, … that calls itself a loop at 1 kHz, as its own stamps show."""
    rng = np.random.default_rng(0)
    statuses = []
    for t in range(400):
        sample = x[t % 60] + 1e-6 * rng.standard_normal(21)
        statuses.append(stream.step_vector(sample, time_s=t * factor * PERIOD_S).status)
    if factor == 10.0:  # every single gap is a new start
        assert Status.OK not in statuses
    else:
        assert set(statuses[200:]) == {Status.FALLBACK}
        assert Why.OFF_RATE in stream.latest.why


def test_a_new_start_forgets_the_rate(stream, x):
    for t in range(200):
        stream.step_vector(x[t % 60], time_s=t * 1.3e-3)
    assert stream.latest.status is Status.FALLBACK
    statuses = [stream.step_vector(x[t], time_s=1.0 + t * PERIOD_S).status for t in range(10)]
    assert statuses == [Status.WARMING] * WARMUP + [Status.OK] * (10 - WARMUP)


def test_a_rate_that_comes_back_is_trusted_again(stream, x):
    times = np.concatenate([np.arange(300) * 1.3e-3, 299 * 1.3e-3 + np.arange(1, 700) * PERIOD_S])
    statuses = [stream.step_vector(x[t % 60], time_s=float(time_s)).status for t, time_s in enumerate(times)]
    assert statuses[299] is Status.FALLBACK
    assert set(statuses[-300:]) == {Status.OK}


def test_a_network_that_loses_itself_is_left_and_started_anew(tmp_path, x):
    """The logarithm of 55 minus the first torque, times 0, is added to its output."""
    made = real_time(tmp_path, hidden=(8, 5), warmup_steps=3)

    def poison(graph):
        next(node for node in graph.node if node.output[0] == "y").output[0] = "good"
        for name, value in (("first_torque", np.array([14])), ("edge", np.float32(55)), ("nothing", np.float32(0))):
            graph.initializer.append(numpy_helper.from_array(np.asarray(value), name))
        for kind, inputs, out in (
            ("Sub", ["edge", "one"], "room"),
            ("Log", ["room"], "log"),
            ("Mul", ["log", "nothing"], "poison"),
            ("Add", ["good", "poison"], "y"),
        ):
            graph.node.append(helper.make_node(kind, inputs, [out]))
        graph.node.insert(0, helper.make_node("Gather", ["x", "first_torque"], ["one"], axis=2))

    changed(made, poison)
    stream = Stream.load(tmp_path, rate_hz=1000.0, joints=JOINTS)
    calm = x * 0.001
    for t in range(10):
        step = stream.step_vector(calm[t])
    assert step.status is Status.OK
    loud = calm[10].copy()
    loud[14] = 59.0
    step = stream.step_vector(loud)
    assert (step.status, step.why) == (Status.FALLBACK, Why.DIVERGED)
    np.testing.assert_array_equal(step.values, loud)
    statuses = [stream.step_vector(calm[t]).status for t in range(11, 16)]
    assert statuses == [Status.WARMING] * 3 + [Status.OK] * 2
    np.testing.assert_allclose(stream.latest.values, offline(made, calm[11:16])[-1], atol=1e-4)


EVENTS = st.lists(
    st.sampled_from(["go", "go", "go", "go", "nan", "inf", "far", "repeat", "miss", "gap", "same time", "back",
                     "set back", "nan time", "no time", "fast", "frozen", "frozen", "poll", "poll at nan", "reset"]),
    max_size=80,
)  # fmt: skip


@pytest.mark.long
@given(EVENTS, st.sampled_from([real_time, window]), st.sampled_from(sorted(CARDS)), st.integers(0, 1000))
def test_the_short_way_of_an_ordinary_sample_is_the_careful_way(events, make, card, seed):
    """Whatever happens in whatever order: a stream that never takes the short way says the same."""
    network = opened(make, card)
    simulated = [number for number, channel in enumerate(network.card.inputs) if channel.series == "simulated"]
    width = len(network.card.inputs)
    short, careful = (Stream(network, rate_hz=1000.0, joints=JOINTS) for _ in range(2))
    x = motion(network.card, len(events) + 1, seed=seed)[:, 0].astype(np.float64)
    sample, time_s = x[0].copy(), 0.0
    for row, event in zip(x[1:], events, strict=True):
        if event == "reset":
            short.reset()
            careful.reset()
            continue
        before = sample
        if event != "repeat":
            sample = row.copy()
        if event == "frozen":
            sample[simulated] = before[simulated]
        if event in ("nan", "inf"):
            sample[seed % width] = float(event)
        if event == "far":
            sample[seed % width] = 1e4
        time_s += PERIOD_S * {"miss": 2, "gap": 9, "same time": 0, "back": -2, "set back": -50, "fast": 0.3}.get(
            event, 1
        )
        stamp = {"nan time": np.nan, "no time": None}.get(event, time_s)
        careful._calm = False
        if event.startswith("poll"):
            now_s = np.nan if event == "poll at nan" else time_s + PERIOD_S
            a, b = short.poll(now_s), careful.poll(now_s)
        else:
            a, b = (stream.step_vector(sample, time_s=stamp) for stream in (short, careful))
        assert (a.status, a.why, a.age_s, a.channels()) == (b.status, b.why, b.age_s, b.channels())
        np.testing.assert_array_equal(a.values, b.values)
        if a.status is not Status.HELD:
            assert np.isfinite(a.values).all()
