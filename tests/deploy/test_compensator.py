"""The compensator: what the network says, within limits, at any rate of the loop, whatever it is given."""

import inspect
import math

import numpy as np
import pytest
from benchmarks.networks import inputs_of, outputs_of, real_time
from hypothesis import given, settings
from hypothesis import strategies as st

from deploy.compensation_cases import asked, compensation
from trueup.deploy import Compensator, CompensatorSettings, Limits, Status, Stream, Why
from trueup.errors import ConfigError, DataError

JOINTS = ("a", "b")
WIDE = Limits((-3.0, -3.0), (3.0, 3.0))
FREE = CompensatorSettings(largest=10.0, rate=1e4)
PERIOD_S = 0.02


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return compensation(tmp_path_factory.mktemp("models") / "robot")


@pytest.fixture(scope="module")
def folder(made, tmp_path_factory):
    return next(tmp_path_factory.getbasetemp().glob("models*/robot"))


def motion(samples, seed=0):
    """Positions and velocities, and targets near them."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(samples)[:, None] * PERIOD_S
    phase, rate = rng.uniform(0, 6, 2), rng.uniform(1, 3, 2)
    position, velocity = np.sin(rate * time_s + phase), rate * np.cos(rate * time_s + phase)
    return position, velocity, position + 0.05 * velocity


def load(folder, **options):
    return Compensator.load(folder, **{"joints": JOINTS, "limits": WIDE, "payload_kg": 1.5, **options})


def run(compensator, position, velocity, target, *, time=True):
    period_s = PERIOD_S / compensator.every
    out, flags, status = [], [], []
    for k, row in enumerate(zip(position, velocity, target, strict=True)):
        answer = compensator.step(*row, time_s=k * period_s if time else None)
        out.append(answer.target.copy())
        flags.append(answer.why)
        status.append(answer.status)
    return np.array(out), flags, status


def test_without_limits_that_matter_it_is_what_the_network_says(made, folder):
    position, velocity, target = motion(60)
    out, flags, status = run(load(folder, settings=FREE), position, velocity, target)
    wanted = asked(made, np.concatenate([position, velocity], axis=1), target, 1.5)
    np.testing.assert_allclose(out, wanted, atol=1e-6)
    assert np.abs(out - target).max() > 0.01  # else this shows nothing
    assert set(flags) == {Why.NONE}
    assert set(status) == {Status.OK}


def test_the_payload_matters_and_may_change(made, folder):
    position, velocity, target = motion(60)
    state = np.concatenate([position, velocity], axis=1)
    compensator = load(folder, settings=FREE, payload_kg=0.5)
    first, _, _ = run(compensator, position[:30], velocity[:30], target[:30], time=False)
    compensator.carry(2.5)
    second, _, _ = run(compensator, position[30:], velocity[30:], target[30:], time=False)
    np.testing.assert_allclose(first, asked(made, state, target, 0.5)[:30], atol=1e-6)
    # The payload of the history is that of its own time.
    np.testing.assert_allclose(second[4:], asked(made, state, target, 2.5)[34:], atol=1e-6)


def test_corrections_are_as_large_and_as_fast_as_allowed(folder):
    position, velocity, target = motion(60)
    free, _, _ = run(load(folder, settings=FREE), position, velocity, target)
    tight = CompensatorSettings(largest=(0.02, 0.01), rate=0.2)
    out, flags, _ = run(load(folder, settings=tight), position, velocity, target)
    delta = out - target
    assert (np.abs(delta) <= np.array([0.02, 0.01]) + 1e-12).all()
    assert (np.abs(np.diff(delta, axis=0, prepend=0)) <= 0.2 * PERIOD_S + 1e-12).all()
    assert Why.LIMITED in flags
    assert np.abs(free - target).max() > 0.02
    assert np.corrcoef(delta.ravel(), (free - target).ravel())[0, 1] > 0.5  # it does what it may


def test_sizes_come_from_training_where_nothing_is_said(made, folder, tmp_path):
    assert load(folder).largest.tolist() == [0.4, 0.4]  # how far commands were from positions
    compensation(tmp_path / "plain", relative=False)
    np.testing.assert_allclose(load(tmp_path / "plain").largest, 0.1 * 6.0)


@pytest.mark.parametrize("every", [4, 20])
def test_a_faster_loop_goes_straight_from_one_answer_to_the_next(folder, every):
    position, velocity, target = motion(40)
    slow = load(folder, settings=FREE)
    deltas = run(slow, position, velocity, target)[0] - target
    fast = load(folder, settings=FREE, loop_hz=50.0 * every)
    assert fast.every == every
    rows = [np.repeat(values, every, axis=0) for values in (position, velocity, target)]
    out, flags, status = run(fast, *rows)
    np.testing.assert_allclose((out - rows[2])[every - 1 :: every], deltas, atol=1e-9)
    steps = np.diff(out - rows[2], axis=0, prepend=0).reshape(40, every, 2)
    np.testing.assert_allclose(steps, np.broadcast_to(steps[:, :1], steps.shape), atol=1e-9)
    assert set(flags) == {Why.NONE}
    assert set(status) == {Status.OK}


@pytest.mark.parametrize("loop_hz", [20.0, 75.0, 52.0, 0.0, math.nan, math.inf, -50.0])
def test_other_rates_are_refused(folder, loop_hz):
    with pytest.raises(ConfigError, match="a whole multiple of 50 Hz"):
        load(folder, loop_hz=loop_hz)


def test_a_loop_that_runs_at_another_rate_than_it_said_fades_out(folder):
    position, velocity, target = motion(400)
    compensator = load(folder)
    for k, row in enumerate(zip(position, velocity, target, strict=True)):
        answer = compensator.step(*row, time_s=k * PERIOD_S * 0.8)
    assert Why.OFF_RATE in answer.why
    assert answer.status is Status.FALLBACK
    np.testing.assert_array_equal(answer.target, target[-1])


def test_a_hole_fades_out_and_in_again_without_a_jump(folder):
    position, velocity, target = motion(120)
    holed = position.copy()
    holed[40:80, 1] = np.nan
    compensator = load(folder, settings=CompensatorSettings(largest=0.1, rate=0.5))
    out, flags, status = run(compensator, holed, velocity, target)
    delta = out - target
    assert np.isfinite(out).all()
    assert (np.abs(np.diff(delta, axis=0)) <= 0.5 * PERIOD_S + 1e-12).all()
    assert all(Why.NAN in why for why in flags[40:80])
    assert set(status[40:80]) == {Status.HELD}
    np.testing.assert_array_equal(delta[60:80], 0.0)
    assert np.abs(delta[100:]).max() > 0.01
    assert status[-1] is Status.OK


def test_without_a_payload_nothing_is_corrected_until_it_is_known(made, folder):
    position, velocity, target = motion(60)
    compensator = load(folder, payload_kg=None, settings=FREE)
    out, flags, status = run(compensator, position[:30], velocity[:30], target[:30], time=False)
    np.testing.assert_array_equal(out, target[:30])
    assert set(flags) == {Why.NO_PAYLOAD}
    assert set(status) == {Status.FALLBACK}
    compensator.carry(2.0)
    out, flags, status = run(compensator, position[30:], velocity[30:], target[30:], time=False)
    assert set(flags) == {Why.NONE}
    assert np.abs(out - target[30:]).max() > 0.01


@pytest.mark.parametrize(("outside", "as_if"), [("clamp", 3.0), ("keep", 3.5), ("off", None)])
def test_a_payload_that_training_did_not_cover(made, folder, outside, as_if):
    position, velocity, target = motion(30)
    settings = CompensatorSettings(largest=10.0, rate=1e4, outside=outside)
    out, flags, status = run(load(folder, payload_kg=3.5, settings=settings), position, velocity, target)
    wanted = target if as_if is None else asked(made, np.concatenate([position, velocity], axis=1), target, as_if)
    np.testing.assert_allclose(out, wanted, atol=1e-6)
    assert set(flags) == {Why.PAYLOAD}
    assert set(status) == {Status.FALLBACK if as_if is None else Status.OK}


def test_a_payload_beyond_the_networks_margin_is_not_corrected_when_it_is_kept(folder):
    position, velocity, target = motion(5)
    compensator = load(folder, payload_kg=9.0, settings=CompensatorSettings(outside="keep"))
    out, flags, _ = run(compensator, position, velocity, target)
    np.testing.assert_array_equal(out, target)
    assert set(flags) == {Why.PAYLOAD | Why.OUT_OF_RANGE}


def test_what_is_no_payload_is_refused(folder):
    for wrong in (-1.0, math.nan, math.inf):
        with pytest.raises(DataError, match="payload"):
            load(folder, payload_kg=wrong)


def test_targets_outside_are_cut_and_said(folder):
    limits = Limits((-0.5, -0.5), (0.5, 0.5))
    position, velocity, target = motion(60)
    target[30:, 0] = 2.0
    out, flags, _ = run(load(folder, limits=limits, settings=FREE), position, velocity, target)
    assert (np.abs(out) <= 0.5).all()
    assert all(Why.TARGET in why for why in flags[30:])


def test_wrong_arrays_and_other_models_are_refused(folder, made, tmp_path):
    compensator = load(folder)
    two = np.zeros(2)
    step = inspect.unwrap(Compensator.step)  # without the tests' own look at shapes
    for arrays, what in (
        ((two, two, np.zeros(3)), "target"),
        ((np.zeros(1), two, two), "position"),
        ((two, two, ["a", "b"]), "target"),
        ((two, np.zeros(3), two), "velocity"),
    ):
        with pytest.raises(DataError, match=what):
            step(compensator, *arrays)
    with pytest.raises(ConfigError, match="limits of another robot"):
        load(folder, limits=Limits((-1.0,), (1.0,)))
    with pytest.raises(ConfigError, match="low below high"):
        Limits((1.0,), (1.0,))
    with pytest.raises(ConfigError, match="low below high"):
        Limits((math.nan,), (1.0,))
    with pytest.raises(ConfigError, match="rate"):
        Limits((0.0,), (1.0,), (0.0,))
    with pytest.raises(ConfigError, match="largest"):
        CompensatorSettings(largest=-1.0)
    with pytest.raises(ConfigError, match="3 numbers"):
        load(folder, settings=CompensatorSettings(rate=(1.0, 1.0, 1.0)))


def test_only_networks_that_correct_commands(tmp_path):
    other = real_time(tmp_path / "other", inputs=inputs_of(JOINTS), outputs=outputs_of(JOINTS), joints=JOINTS)
    stream = Stream.load(other.folder, rate_hz=other.card.rate_hz, joints=JOINTS)
    with pytest.raises(ConfigError, match="corrects no commands"):
        Compensator(stream, limits=WIDE)


def test_reset_is_a_new_beginning(folder):
    rows = motion(30)
    compensator = load(folder)
    first, _, _ = run(compensator, *rows)
    compensator.reset()
    again, _, _ = run(compensator, *rows)
    np.testing.assert_array_equal(again, first)


NUMBERS = st.one_of(
    st.floats(-1.5, 1.5), st.floats(-1.5, 1.5), st.sampled_from([math.nan, math.inf, -math.inf, 1e308, -1e308, 3.2])
)
TWO = st.tuples(NUMBERS, NUMBERS)
STAMPS = st.one_of(st.none(), st.just(1.0), st.just(1.0), st.sampled_from([0.0, -1.0, 0.7, 30.0, math.nan, math.inf]))
ROWS = st.lists(
    st.tuples(TWO, TWO, TWO, STAMPS, st.sampled_from([None, None, None, 0.0, 2.0, 50.0])), min_size=1, max_size=40
)


@pytest.mark.long
@settings(max_examples=40, deadline=None)
@given(
    rows=ROWS,
    every=st.sampled_from([1, 3, 20]),
    largest=st.floats(1e-3, 2.0),
    rate=st.floats(1e-2, 100.0),
    command_rate=st.one_of(st.none(), st.floats(0.1, 20.0)),
    outside=st.sampled_from(["clamp", "keep", "off"]),
    ends=st.tuples(st.floats(-3.0, 0.5), st.floats(0.01, 3.0)),
    payload=st.one_of(st.none(), st.floats(0.0, 6.0)),
)
def test_whatever_comes_no_command_leaves_the_limits(
    folder, rows, every, largest, rate, command_rate, outside, ends, payload
):
    low, high = ends[0], ends[0] + ends[1]
    limits = Limits((low, -3.0), (high, math.inf), None if command_rate is None else (command_rate, command_rate))
    compensator = load(
        folder,
        limits=limits,
        loop_hz=50.0 * every,
        payload_kg=payload,
        settings=CompensatorSettings(largest=largest, rate=rate, outside=outside),
    )
    period_s, time_s = PERIOD_S / every, 0.0
    smallest, greatest = np.array(limits.low), np.array(limits.high)
    tiny = 1e-9
    nominal = before = np.full(2, np.nan)
    delta = np.zeros(2)
    for position, velocity, target, stamp, carried in rows:
        if carried is not None:
            compensator.carry(carried)
        if stamp is not None:
            time_s += stamp * period_s if math.isfinite(stamp) else 0.0
        answer = compensator.step(
            np.array(position),
            np.array(velocity),
            np.array(target),
            time_s=None if stamp is None else time_s if math.isfinite(stamp) else stamp,
        )
        out, target = answer.target.copy(), np.array(target)
        finite = np.isfinite(target)
        assert np.isfinite(out[finite]).all()
        known = np.isfinite(out)
        assert ((out >= smallest) & (out <= greatest))[known].all()
        # By hand: the target as the robot may be commanded it, the one before where it is none.
        wanted = np.clip(np.where(finite, target, nominal), smallest, greatest)
        if command_rate is not None:
            step = command_rate * period_s
            wanted = np.fmin(np.fmax(wanted, nominal - step), nominal + step)
            assert (np.abs(out - before) <= step + tiny)[np.isfinite(before)].all()
        nominal = np.where(np.isfinite(wanted), wanted, out - answer.delta)
        assert (np.abs(out - nominal) <= largest * (1 + tiny) + tiny * np.abs(nominal))[known].all()
        assert (np.abs(answer.delta - delta) <= rate * period_s + tiny).all()
        assert (Why.TARGET in answer.why) == bool((nominal != target).any())
        # A target that is none is another matter: the one before stands in for it, and that is said above.
        if not (np.isfinite(position).all() and np.isfinite(velocity).all()) and every == 1:
            assert answer.status is not Status.OK
        before, delta = out, answer.delta.copy()
