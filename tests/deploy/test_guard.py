"""What a guard lets through: never more than the limits, never faster, and after a stop nothing but brakes."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from trueup.deploy.guard import Guard, GuardSettings
from trueup.errors import ConfigError

TICK_S = 0.001
SETTINGS = GuardSettings(
    torque_nm=(2.0, 1.0),
    torque_rate=(500.0, 1000.0),
    low=(-1.0, -2.0),
    high=(1.0, 2.0),
    velocity=(2.0, 2.5),
    workspace_m=((-1.0, -1.0, 0.0), (1.0, 1.0, 1.0)),
)
MOST, RATE = np.array(SETTINGS.torque_nm), np.array(SETTINGS.torque_rate)
PLACE, REST = np.array([0.2, 0.0, 0.5]), np.zeros(2)
NUMBERS = st.floats(-50, 50) | st.sampled_from([np.nan, np.inf, -np.inf, 0.0])


def ticked(guard, count, said=REST, position=REST, velocity=REST, place=PLACE, **options):
    rng = np.random.default_rng(0)
    return np.array(
        [
            guard.tick(said, position + 1e-9 * rng.normal(size=2), velocity, place, **options).copy()
            for _ in range(count)
        ]
    )


@settings(max_examples=60, deadline=None)
@given(
    said=arrays(float, (40, 2), elements=NUMBERS),
    position=arrays(float, (40, 2), elements=st.floats(-3, 3) | st.just(np.nan)),
    velocity=arrays(float, (40, 2), elements=st.floats(-5, 5) | st.just(np.nan)),
    stop=st.integers(0, 60),
)
def test_whatever_comes_torques_are_within_their_limits_and_change_no_faster(said, position, velocity, stop):
    guard = Guard(SETTINGS, TICK_S)
    before = np.zeros(2)
    for tick, row in enumerate(zip(said, position, velocity, strict=True)):
        if tick == stop:
            guard.stop("test")
        sent = guard.tick(*row, PLACE)
        assert np.isfinite(sent).all()
        assert (np.abs(sent) <= MOST).all()
        assert (np.abs(sent - before) <= RATE * TICK_S * (1 + 1e-12)).all()
        before = sent.copy()


@settings(max_examples=60, deadline=None)
@given(velocity=arrays(float, 2, elements=st.floats(-2, 2)), said=arrays(float, 2, elements=st.floats(-2, 2)))
def test_brakes_take_energy_out_and_never_put_any_in(velocity, said):
    guard = Guard(SETTINGS, TICK_S)
    ticked(guard, 20, said=said)
    guard.stop("test")
    # As soon as torques have had the time to turn around.
    sent = ticked(guard, 20, said=said, velocity=velocity)[-1]
    assert (sent * velocity <= 0).all()
    expected = -MOST * np.clip(velocity / SETTINGS.braking_rad_s, -1, 1)
    if np.abs(velocity).max() >= SETTINGS.rest_rad_s:
        np.testing.assert_allclose(sent, expected, atol=1e-12)


def test_torques_of_a_policy_pass_unchanged_where_nothing_limits_them():
    guard = Guard(SETTINGS, TICK_S)
    said = np.array([0.4, -0.3])
    assert (ticked(guard, 3, said=said) == said).all()
    assert guard.shares == {"torque": 0.0, "rate": 0.0, "position": 0.0, "velocity": 0.0}
    assert guard.phase == "running"


@pytest.mark.parametrize(("side", "joint"), [(1.0, 0), (-1.0, 1)])
def test_near_its_end_a_joint_is_pushed_no_further_and_at_the_end_it_is_pushed_back(side, joint):
    end = (SETTINGS.high if side > 0 else SETTINGS.low)[joint]
    outward = side * MOST * (np.arange(2) == joint)
    for share, expected in ((0.0, 1.0), (0.25, 0.5), (0.5, 0.0), (1.0, -1.0)):
        guard = Guard(SETTINGS, TICK_S)
        position = np.zeros(2)
        position[joint] = end - side * SETTINGS.margin_rad * (1 - share)
        sent = ticked(guard, 10, said=outward, position=position)[-1]
        np.testing.assert_allclose(sent[joint] * side, expected * MOST[joint], atol=1e-6)
        inward = ticked(Guard(SETTINGS, TICK_S), 10, said=-outward, position=position)[-1]
        np.testing.assert_allclose(inward, -outward)
        if share:
            assert guard.shares["position"] > 0


def test_a_fast_joint_is_driven_no_faster_and_may_be_braked():
    for speed, expected in ((1.5, 1.0), (1.8, 0.0), (2.0, -1.0)):
        guard = Guard(SETTINGS, TICK_S)
        sent = ticked(guard, 10, said=MOST, velocity=np.array([speed, 0.0]))[-1]
        np.testing.assert_allclose(sent[0], expected * MOST[0], atol=1e-9)
        back = ticked(Guard(SETTINGS, TICK_S), 10, said=-MOST, velocity=np.array([speed, 0.0]))[-1]
        np.testing.assert_allclose(back, -MOST)


REASONS = {
    "workspace": ({"place": np.array([0.2, 0.0, -0.01])}, "left its workspace"),
    "end": ({"position": np.array([1.03, 0.0])}, "joint 1 is 0.030 beyond its end"),
    "speed": ({"velocity": np.array([0.0, -3.1])}, "joint 2 is too fast: 3.10 of 2.50"),
    "policy": ({"sound": False}, "has said no number"),
    "late": ({"late_s": 0.03}, "30.0 ms late"),
    "position": ({"position": np.array([np.nan, 0.0])}, "no numbers"),
    "velocity": ({"velocity": np.array([0.0, np.inf])}, "no numbers"),
}


@pytest.mark.parametrize(("given", "reason"), REASONS.values(), ids=REASONS)
def test_what_stops_an_arm_for_good(given, reason):
    guard = Guard(SETTINGS, TICK_S)
    ticked(guard, 1000, said=0.2 * MOST, **given)
    assert reason in guard.reason
    assert guard.phase in ("stopping", "stopped")
    # It stays so, whatever comes then.
    sent = ticked(guard, 50, said=MOST)
    assert guard.phase == "stopped"
    assert (sent[-1] == 0).all()
    guard.stop("another reason")
    assert reason in guard.reason


def test_a_policy_may_be_silent_for_a_moment_and_readings_may_stand_still_where_nothing_is_sent():
    guard = Guard(SETTINGS, TICK_S)
    for _ in range(5):
        ticked(guard, 150, sound=False)
        ticked(guard, 1)
    for _ in range(2000):
        guard.tick(REST, REST, REST, PLACE)
    assert guard.phase == "running"


def test_frozen_readings_stop_an_arm_that_is_driven():
    guard = Guard(SETTINGS, TICK_S)
    for _ in range(600):
        guard.tick(0.5 * MOST, REST, REST, PLACE)
    assert "readings have not changed for 0.50 s" in guard.reason


def test_an_arm_stops_within_the_time_that_its_brakes_take():
    """A joint of 0.5 kg m2 at 2 rad/s, braked by 2 Nm: half a second, and a tail of a few time constants."""
    guard = Guard(replace(SETTINGS, velocity=(10.0, 10.0)), TICK_S)
    inertia, velocity, ticks = np.array([0.5, 0.1]), np.array([2.0, -2.0]), 0
    guard.stop("test")
    energy = [float(inertia @ velocity**2)]
    while guard.phase != "stopped":
        velocity = velocity + TICK_S * guard.tick(MOST, REST, velocity, PLACE) / inertia
        energy.append(float(inertia @ velocity**2))
        ticks += 1
        assert ticks < 1000
    assert ticks > 400
    assert (np.diff(energy[5:]) <= 0).all()


def test_settings_that_protect_nothing_are_refused():
    wrong = (
        {"torque_nm": (1.0, -1.0)},
        {"torque_rate": (1.0,)},
        {"velocity": (np.inf, 1.0)},
        {"low": (0.9, -2.0)},
        {"margin_rad": 0.0},
        {"deaf_s": np.nan},
        {"workspace_m": ((0.0, 0.0, 0.0), (1.0, 0.0, 1.0))},
    )
    for changes in wrong:
        with pytest.raises(ConfigError, match="guard"):
            replace(SETTINGS, **changes)
    with pytest.raises(ConfigError, match="tick"):
        Guard(SETTINGS, 0.0)
