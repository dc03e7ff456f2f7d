"""The delay that was put in comes out, with an interval that covers it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from align.align_cases import make_series, smooth
from trueup.align import estimate_delay
from trueup.errors import DataError, NameMismatch, NotIdentifiable


@given(st.integers(0, 999), st.floats(0.0, 0.15), st.sampled_from([20.0, 50.0, 97.0, 400.0]))
def test_exact_recovery_with_two_clocks_and_jitter(seed, delay_s, rate_hz):
    rng = np.random.default_rng(seed)
    move = smooth(rng, joints=2)
    sent = np.arange(0.0, 10.0, 0.01) + rng.uniform(-0.003, 0.003, 1000)
    seen = np.arange(0.07, 9.8, 1.0 / rate_hz)
    seen = seen + rng.uniform(0.0, 0.2 / rate_hz, seen.size)
    found = estimate_delay(
        make_series(seen, ("a", "b"), position=move(seen - delay_s)),
        make_series(sent, ("b", "a"), position=move(sent)[:, ::-1]),
        max_delay_s=0.3,
    )
    assert abs(found.delay_s - delay_s) < 0.1 / min(rate_hz, 100.0)
    assert found.low_s <= delay_s + 1e-3
    assert found.high_s >= delay_s - 1e-3
    assert found.correlation > 0.99
    assert set(found.per_joint) == {"a", "b"}


@pytest.mark.parametrize("noise", [0.02, 0.1])
def test_interval_covers_the_truth_at_its_rate(noise):
    inside, widths, errors = 0, [], []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        move, delay_s = smooth(rng, joints=2), rng.uniform(0.01, 0.15)
        time_s = np.arange(0.0, 12.0, 0.02)
        robot = move(time_s - delay_s) + noise * rng.normal(size=(time_s.size, 2))
        found = estimate_delay(
            make_series(time_s, ("a", "b"), position=robot),
            make_series(time_s, ("a", "b"), position=move(time_s)),
            max_delay_s=0.3,
        )
        inside += found.low_s <= delay_s <= found.high_s
        widths.append(found.high_s - found.low_s)
        errors.append(found.delay_s - delay_s)
    assert inside >= 85
    # An interval that always covers by being wide says nothing.
    assert np.mean(widths) < 12 * np.std(errors) + 0.002


def test_held_commands_are_not_counted_as_delay():
    offsets = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        move, delay_s = smooth(rng), rng.uniform(0.005, 0.15)
        sent = np.arange(0.0, 10.0, 0.02)
        seen = np.arange(0.2, 9.9, 0.002)
        robot = move(sent)[np.searchsorted(sent, seen - delay_s, side="right") - 1]
        command = make_series(sent, position=move(sent))
        held = estimate_delay(make_series(seen, position=robot), command, max_delay_s=0.3, hold=True)
        smooth_ = estimate_delay(make_series(seen, position=robot), command, max_delay_s=0.3)
        offsets.append((held.delay_s - delay_s, smooth_.delay_s - delay_s))
    assert np.abs(np.array(offsets)[:, 0]).max() < 0.0015
    assert abs(np.mean(np.array(offsets)[:, 0])) < 0.0003
    np.testing.assert_allclose(np.array(offsets)[:, 1], 0.01, atol=0.0015)


def test_sparse_steps_need_hold():
    sent = np.array([0.0, 1.0, 2.5, 3.1, 4.4, 6.0, 7.7, 9.0])
    seen = np.arange(0.0, 9.5, 0.005)
    levels = np.array([0.0, 1.0, -1.0, 0.5, 0.0, 1.0, 0.2, 0.9])
    robot = levels[np.maximum(np.searchsorted(sent, seen - 0.08, side="right") - 1, 0)]
    found = estimate_delay(
        make_series(seen, position=robot), make_series(sent, position=levels), max_delay_s=0.3, hold=True
    )
    assert found.delay_s == pytest.approx(0.08, abs=0.01)


def test_torque_against_torque():
    rng = np.random.default_rng(5)
    move = smooth(rng)
    time_s = np.arange(0.0, 8.0, 0.002)
    found = estimate_delay(
        make_series(time_s, torque=move(time_s - 0.014)),
        make_series(time_s, torque=move(time_s)),
        max_delay_s=0.1,
        signal="torque",
    )
    assert found.delay_s == pytest.approx(0.014, abs=2e-4)


@pytest.mark.parametrize("delay_s", [0.35, -0.1])
def test_outside_the_search_range_is_flagged(delay_s):
    move = smooth(np.random.default_rng(6), high_hz=0.6)
    time_s = np.arange(0.0, 20.0, 0.02)
    found = estimate_delay(
        make_series(time_s, position=move(time_s - delay_s)),
        make_series(time_s, position=move(time_s)),
        max_delay_s=0.2,
    )
    assert found.at_limit
    inside = estimate_delay(
        make_series(time_s, position=move(time_s - 0.1)), make_series(time_s, position=move(time_s)), max_delay_s=0.2
    )
    assert not inside.at_limit


def test_joints_that_say_nothing_are_left_out():
    move = smooth(np.random.default_rng(7))
    time_s = np.arange(0.0, 8.0, 0.02)
    asked, done = move(time_s)[:, 0], move(time_s - 0.05)[:, 0]
    zero = np.zeros(time_s.size)
    found = estimate_delay(
        make_series(time_s, ("a", "b", "c"), position=np.stack([done, zero, done], axis=1)),
        make_series(time_s, ("a", "b", "c"), position=np.stack([asked, asked, zero], axis=1)),
        max_delay_s=0.2,
    )
    assert set(found.per_joint) == {"a"}
    assert found.delay_s == pytest.approx(0.05, abs=1e-3)
    with pytest.raises(NotIdentifiable, match="command is constant"):
        estimate_delay(make_series(time_s, position=done), make_series(time_s, position=zero), max_delay_s=0.2)
    with pytest.raises(NotIdentifiable, match="moves"):
        estimate_delay(make_series(time_s, position=zero), make_series(time_s, position=asked), max_delay_s=0.2)


def test_missing_samples_are_bridged():
    move = smooth(np.random.default_rng(8))
    time_s = np.arange(0.0, 8.0, 0.02)
    done = move(time_s - 0.05)
    done[100:105] = np.nan
    found = estimate_delay(
        make_series(time_s, position=done), make_series(time_s, position=move(time_s)), max_delay_s=0.2
    )
    assert found.delay_s == pytest.approx(0.05, abs=2e-3)


def test_same_seed_same_interval_and_bad_input():
    rng = np.random.default_rng(9)
    move = smooth(rng)
    time_s = np.arange(0.0, 8.0, 0.02)
    robot = make_series(time_s, position=move(time_s - 0.05) + 0.05 * rng.normal(size=(time_s.size, 1)))
    command = make_series(time_s, position=move(time_s))
    assert estimate_delay(robot, command, max_delay_s=0.2) == estimate_delay(robot, command, max_delay_s=0.2)
    with pytest.raises(DataError, match="too short"):
        estimate_delay(robot, command, max_delay_s=3.0)
    with pytest.raises(DataError, match="max_delay_s"):
        estimate_delay(robot, command, max_delay_s=0.0)
    with pytest.raises(DataError, match="two samples"):
        estimate_delay(robot.rows(slice(0, 1)), command, max_delay_s=0.2)
    with pytest.raises(NameMismatch):
        estimate_delay(robot, make_series(time_s, ("z",), position=move(time_s)), max_delay_s=0.2)
