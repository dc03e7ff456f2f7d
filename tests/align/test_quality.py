"""Every check on a case that must fire and on one that must not."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from align.align_cases import Servo, make_episode, make_series, sine, smooth
from trueup.align import QualityConfig, check_quality, failed_execution, position_mse, robust_threshold
from trueup.core.episode import Flag
from trueup.errors import DataError, MissingSignal


def kinds(episode, **options):
    return {flag.kind for flag in check_quality(episode, **options)}


def the(episode, kind, **options):
    found = [flag for flag in check_quality(episode, **options) if flag.kind == kind]
    assert len(found) == 1, found
    return found[0]


def moving(rng, count=1000, rate=100.0, joints=("a",)):
    time_s = np.arange(count) / rate
    move = smooth(rng, joints=len(joints))
    return make_series(time_s, joints, position=move(time_s)), make_series(time_s, joints, position=move(time_s))


@given(st.integers(0, 999), st.sampled_from([50.0, 200.0, 1000.0]), st.sampled_from([0.0, 0.0015, 0.01]))
def test_a_good_recording_has_no_flags(seed, rate, step):
    rng = np.random.default_rng(seed)
    time_s = np.arange(0.0, 8.0, 1.0 / rate)
    move = smooth(rng, joints=2)
    rest = np.clip(np.minimum(time_s - 1.0, 7.0 - time_s), 0.0, 1.0)[:, None]
    asked, done = rest * move(time_s), rest * move(time_s - 0.05) + 5e-4 * rng.normal(size=(time_s.size, 2))
    done = np.round(done / step) * step if step else done
    torque = np.round(np.abs(3.0 * asked + 0.05 * rng.normal(size=asked.shape)) / 0.02) * 0.02
    measured = make_series(time_s, ("a", "b"), position=done, velocity=np.gradient(done, time_s, axis=0), torque=torque)
    assert check_quality(make_episode(measured, make_series(time_s, ("a", "b"), position=asked))) == ()


# Clocks


def test_gap_note_and_warning():
    measured, command = moving(np.random.default_rng(0))
    few = np.delete(np.arange(1000), [500, 501, 502])
    flag = the(make_episode(measured.rows(few), command), "gap")
    assert flag.severity == "note"
    assert flag.start_s == pytest.approx(4.99)
    assert flag.end_s == pytest.approx(5.03)
    many = np.delete(np.arange(1000), np.arange(500, 515))  # 0.15 s, but only 1.5 % of the recording
    assert the(make_episode(measured.rows(many), command), "gap").severity == "warning"
    often = np.array([row for row in range(1000) if row % 100 not in (50, 51, 52)])
    assert the(make_episode(measured.rows(often), command), "gap").severity == "note"  # nothing turns in 40 ms
    broken = the(make_episode(measured.rows(many), command), "gap")
    assert "a can have moved by" in broken.detail
    assert (broken.broken, flag.broken) == (True, False)


@pytest.mark.parametrize("size", [0.1, 0.5, 5.0])
def test_a_gap_is_as_bad_as_the_motion_in_it_is_unknown(size):
    # One second is lost while the joint rests, while it turns round, and while it goes on at one speed.
    time_s = np.arange(0.0, 14.0, 0.01)
    path = size * np.interp(time_s, [0.0, 2.5, 4.0, 5.5, 9.5, 14.0], [0.0, 0.0, 1.0, 0.0, 1.0, 1.0])
    for first_s, severity in ((0.5, "note"), (3.5, "warning"), (7.0, "note"), (11.5, "note")):
        kept = (time_s < first_s) | (time_s >= first_s + 1.0)
        flag = the(make_episode(make_series(time_s[kept], position=path[kept])), "gap")
        assert flag.severity == severity, (size, first_s)


@pytest.mark.parametrize("step", [0.0, 0.0015])
@pytest.mark.parametrize(("rate", "speed"), [(1000.0, 12.0), (500.0, 6.0), (100.0, 3.0)])
def test_late_stamps_of_fast_motion_are_no_gaps(rate, speed, step):
    # Read when the operating system got round to it, up to 6 ms late, and stamped then.
    rng = np.random.default_rng(3)
    time_s = np.arange(0.0, 10.0, 1.0 / rate)
    time_s = np.sort(time_s + np.where(rng.uniform(size=time_s.size) < 0.1, rng.uniform(0.0, 0.006, time_s.size), 0.0))
    time_s = np.unique(np.round(time_s, 6))
    position = np.sin(speed * time_s)
    position = np.round(position / step) * step if step else position
    flags = check_quality(make_episode(make_series(time_s, position=position, velocity=speed * np.cos(speed * time_s))))
    assert {(flag.kind, flag.severity) for flag in flags} == {("jittering_stamps", "note")}


def test_samples_that_come_in_bursts_are_no_broken_measurement():
    time_s = np.sort(np.concatenate([0.02 * np.arange(500) + late for late in (0.0, 1e-4, 2e-4, 3e-4)]))
    flags = check_quality(make_episode(make_series(time_s, position=np.sin(5 * time_s))))
    assert not any(flag.severity == "warning" for flag in flags)
    quick = np.sort(np.concatenate([0.01 * np.arange(500) + late for late in (0.0, 1e-4, 2e-4, 3e-4)]))
    assert "gap" not in kinds(make_episode(make_series(quick, position=np.sin(5 * quick))))


def test_without_positions_a_long_gap_is_a_warning():
    time_s = np.delete(np.arange(0.0, 10.0, 0.01), slice(500, 520))
    assert the(make_episode(make_series(time_s, torque=np.sin(time_s))), "gap").severity == "warning"


def test_jitter_is_a_note_and_not_a_gap():
    rng = np.random.default_rng(1)
    steps = np.full(999, 0.002)
    steps[rng.integers(0, 999, 10)] = 0.0035
    time_s = np.concatenate([[0.0], np.cumsum(steps)])
    flags = check_quality(make_episode(make_series(time_s, position=np.sin(5 * time_s))))
    assert [(flag.kind, flag.severity) for flag in flags] == [("jittering_stamps", "note")]
    mild = 0.01 * np.arange(1000) + rng.uniform(-0.001, 0.001, 1000)
    assert check_quality(make_episode(make_series(mild, position=np.sin(mild)))) == ()


def test_two_clocks_for_the_same_rows():
    measured, command = moving(np.random.default_rng(2))
    slow = make_series(command.time_s * 1.1, position=command["position"])
    assert the(make_episode(measured, slow), "clock_mismatch").severity == "warning"
    fewer = slow.rows(slice(0, 900))
    assert "clock_mismatch" not in kinds(make_episode(measured, fewer))


# Repeated samples


@given(st.integers(0, 999), st.sampled_from([100.0, 250.0, 300.0, 500.0]), st.sampled_from([0.0, 1e-4]))
def test_slow_feed_is_found_with_its_rate(seed, source_hz, step):
    move = smooth(np.random.default_rng(seed), joints=3)
    time_s = np.arange(0.0, 4.0, 0.001)
    values = move(np.floor(time_s * source_hz + 1e-6) / source_hz)
    values = np.round(values / step) * step if step else values
    flag = the(make_episode(make_series(time_s, ("a", "b", "c"), position=values)), "repeated_samples")
    assert flag.severity == "warning"
    rate = float(flag.detail.split("about ")[1].split(" ")[0])
    assert rate == pytest.approx(source_hz, rel=0.05)


@given(st.integers(0, 999), st.floats(0.0005, 0.01))
def test_slow_robot_with_a_coarse_encoder_repeats_honestly(seed, step):
    # Up to many samples for one encoder step, and rests: rows repeat, but nothing is fed slowly.
    rng = np.random.default_rng(seed)
    time_s = np.arange(0.0, 6.0, 0.001)
    rest = np.clip(np.minimum(time_s - 1.0, 5.0 - time_s), 0.0, 1.0)[:, None]
    values = rest * 0.3 * smooth(rng, joints=2, low_hz=0.05, high_hz=0.6)(time_s)
    values = np.round(values / step) * step
    assert np.mean(np.all(np.diff(values, axis=0) == 0.0, axis=1)) > 0.3
    assert "repeated_samples" not in kinds(make_episode(make_series(time_s, ("a", "b"), position=values)))


def test_repeated_torque_alone_is_a_note():
    move = smooth(np.random.default_rng(3))
    time_s = np.arange(0.0, 4.0, 0.001)
    series = make_series(time_s, position=move(time_s), torque=move(np.floor(time_s * 200 + 1e-6) / 200))
    flag = the(make_episode(series), "repeated_samples")
    assert (flag.signal, flag.severity) == ("torque", "note")


# Values


def test_nan_and_infinity_are_counted_per_signal_and_joint():
    measured, command = moving(np.random.default_rng(4), joints=("a", "b"))
    measured["position"][10, 0] = np.nan
    measured["position"][20, 0] = np.inf
    command["position"][100:150, 1] = np.nan
    flags = [flag for flag in check_quality(make_episode(measured, command)) if flag.kind == "nan"]
    assert [(f.series, f.signal, f.joint, f.severity) for f in flags] == [
        ("measured", "position", "a", "note"),
        ("command", "position", "b", "warning"),
    ]
    assert flags[0].detail.startswith("2 of 1000")
    assert (flags[0].start_s, flags[0].end_s) == (pytest.approx(0.1), pytest.approx(0.2))


def test_a_column_of_nan_does_not_stop_the_rest():
    measured, command = moving(np.random.default_rng(5), joints=("a", "b"))
    measured["position"][:, 0] = np.nan
    assert kinds(make_episode(measured, command)) == {"nan"}


@pytest.mark.parametrize("width", [1, 2, 3])
def test_spike_is_found_and_a_step_is_not(width):
    measured, command = moving(np.random.default_rng(6))
    measured["position"][500 : 500 + width, 0] += 0.4
    flag = the(make_episode(measured, command), "spike")
    assert flag.severity == "warning"
    assert flag.start_s == pytest.approx(5.0)
    assert "1 spikes" in flag.detail
    step = 0.4 * (np.arange(1000) >= 500)
    assert "spike" not in kinds(make_episode(make_series(measured.time_s, position=step)))
    overshoot = step - 0.15 * (np.arange(1000) >= 501)
    assert "spike" not in kinds(make_episode(make_series(measured.time_s, position=overshoot)))
    long, _ = moving(np.random.default_rng(6))
    long["position"][500:504, 0] += 0.4
    assert "spike" not in kinds(make_episode(long, command))


def test_fast_motion_and_noise_are_no_spikes():
    time_s = np.arange(0.0, 20.0, 0.02)
    chirp = 0.15 * np.sin(2 * np.pi * (0.1 + 0.15 * time_s) * time_s)
    noisy = chirp + 0.01 * np.random.default_rng(7).normal(size=time_s.size)
    assert "spike" not in kinds(make_episode(make_series(time_s, position=noisy)))


def test_frozen_encoder_by_command_and_by_velocity():
    measured, command = moving(np.random.default_rng(8))
    measured["position"][300:500, 0] = measured["position"][300, 0]
    flag = the(make_episode(measured, command), "frozen")
    assert flag.severity == "warning"
    assert flag.start_s == pytest.approx(3.0, abs=0.02)
    assert flag.end_s == pytest.approx(4.99, abs=0.02)
    velocity = np.gradient(command["position"][:, 0], command.time_s)
    torque_driven = make_series(measured.time_s, position=measured["position"], velocity=velocity)
    assert "frozen" in kinds(make_episode(torque_driven, make_series(command.time_s, torque=velocity)))
    assert "frozen" not in kinds(make_episode(make_series(measured.time_s, position=measured["position"])))


def test_what_friction_holds_is_not_frozen():
    """A soft servo sticks until its command is half a radian away, and goes on from there."""
    time_s = np.arange(0.0, 12.0, 0.01)
    asked = 0.8 * np.sin(0.6 * time_s)
    stuck, done = 0.0, []
    for target in asked:
        error = target - stuck
        stuck += 0.02 * (error - 0.5 * np.sign(error)) if abs(error) > 0.5 else 0.0
        done.append(round(stuck / 1.5e-3) * 1.5e-3)
    sticking = make_series(time_s, position=np.array(done))
    assert np.diff(np.flatnonzero(np.diff(done))).max() > 50  # samples without a change
    told = make_series(time_s, position=asked)
    assert "frozen" not in kinds(make_episode(sticking, told))
    # An encoder that dies in motion is, and so is one that comes back elsewhere.
    dead, gone = np.array(asked), np.array(asked)
    dead[450:], gone[300:500] = dead[450], gone[300]
    for broken in (dead, gone):
        assert "frozen" in kinds(make_episode(make_series(time_s, position=broken), told))


def test_resting_and_late_joints_are_not_frozen():
    time_s = np.arange(0.0, 6.0, 0.02)
    asked = 0.5 * (time_s > 3.0)
    done = 0.5 * (time_s > 3.15)
    assert "frozen" not in kinds(make_episode(make_series(time_s, position=done), make_series(time_s, position=asked)))
    held = np.zeros(time_s.size)
    assert kinds(make_episode(make_series(time_s, position=held), make_series(time_s, position=held))) == set()


def test_torque_at_its_limit():
    time_s = np.arange(0.0, 10.0, 0.01)
    clipped = np.clip(4.0 * np.sin(time_s), -3.0, 3.0)
    episode = make_episode(make_series(time_s, position=np.sin(time_s), torque=clipped))
    assert the(episode, "saturation", torque_limits={"a": 3.0}).severity == "warning"
    assert "saturation" not in kinds(episode, torque_limits={"a": 4.0})
    assert "saturation" not in kinds(episode)
    spiky = np.where(np.arange(1000) % 50 == 0, 3.5, 0.5)
    assert "saturation" not in kinds(
        make_episode(make_series(time_s, position=np.sin(time_s), torque=spiky)), torque_limits={"a": 3.0}
    )
    short = np.where((time_s > 5.0) & (time_s < 5.08), 0.0, 0.5)
    short[500:512] = 3.0
    note = make_episode(make_series(np.arange(2000) * 0.01, position=np.zeros(2000), torque=np.tile(short, 2)[:2000]))
    assert (
        the(note, "saturation", torque_limits={"a": 3.0}, config=QualityConfig(saturated_warning_share=0.02)).severity
        == "note"
    )


def test_plateau_below_the_commanded_torque():
    time_s = np.arange(0.0, 10.0, 0.01)
    asked = 4.0 * np.sin(time_s)
    torque = np.clip(asked, -3.0, 3.0)
    command = make_series(time_s, torque=asked)
    assert "saturation" in kinds(make_episode(make_series(time_s, position=np.sin(time_s), torque=torque), command))
    square = 2.0 * np.sign(np.sin(time_s))
    follows = make_episode(
        make_series(time_s, position=np.sin(time_s), torque=square), make_series(time_s, torque=square)
    )
    assert "saturation" not in kinds(follows)


def test_known_position_limits():
    time_s = np.arange(0.0, 10.0, 0.02)
    asked = 1.3 * np.sin(time_s)
    stopped = np.clip(asked, -1.0, 1.0)
    pushed = make_episode(make_series(time_s, position=stopped), make_series(time_s, position=asked))
    flag = the(pushed, "position_limit", limits={"a": (-1.0, 1.0)})
    assert flag.severity == "warning"
    touched = make_episode(make_series(time_s, position=stopped), make_series(time_s, position=stopped))
    assert the(touched, "position_limit", limits={"a": (-1.0, 1.0)}).severity == "note"
    assert "beyond" in the(touched, "position_limit", limits={"a": (-0.8, 0.8)}).detail
    assert "position_limit" not in kinds(touched, limits={"a": (-1.2, 1.2)})
    assert "position_limit" not in kinds(touched, limits={"a": None})


# Joints that stop following


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("command", "servo"),
    [
        (sine(1.2, 0.1), Servo(stop_rad=0.9)),
        (sine(1.2, 0.5), Servo(stop_rad=0.8)),
        (sine(1.2, 0.1), Servo(stop_rad=0.9, stiction_nm=0.8, noise_nm=0.1)),
        (sine(1.2, 0.1), Servo(stop_rad=0.9, gravity_nm=0.8, signed=True)),
        (sine(1.2, 0.1), Servo(stop_rad=0.9, noise_rad=0.0005)),
        (sine(1.2, 0.1), Servo(stop_rad=0.9, step_rad=0.0)),
        (np.concatenate([sine(0.6, 0.2), np.clip(np.arange(600) / 200, 0, 1.2), np.zeros(200)]), Servo(stop_rad=0.8)),
    ],
)
def test_hard_stop_is_found_without_its_position(command, servo, seed):
    flags = [flag for flag in check_quality(servo.run(command, seed)) if flag.severity == "warning"]
    assert [flag.kind for flag in flags] == ["limit_hit"]
    assert flags[0].joint == "a"
    assert float(flags[0].detail.split("at ")[1].split(" rad")[0]) == pytest.approx(servo.stop_rad, abs=0.02)


def test_stop_in_the_middle_of_the_travel_is_an_obstacle():
    episode = Servo(stop_rad=0.8).run(np.concatenate([sine(0.3, 0.2), sine(0.3, 0.2)]))
    free = Servo().run(sine(1.2, 0.1))
    joined = np.concatenate([free.measured["position"], Servo(stop_rad=0.8).run(sine(1.2, 0.1)).measured["position"]])
    loads = np.concatenate([free.measured["torque"], Servo(stop_rad=0.8).run(sine(1.2, 0.1)).measured["torque"]])
    time_s = 0.02 * np.arange(joined.size)
    both = make_episode(
        make_series(time_s, position=joined, torque=loads), make_series(time_s, position=np.tile(sine(1.2, 0.1), 2))
    )
    assert [flag.kind for flag in check_quality(both)] == ["blocked"]
    assert check_quality(episode) == ()


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    ("command", "servo"),
    [
        (sine(0.8, 0.1), Servo(stiction_nm=1.4)),
        (sine(0.05, 0.1), Servo(stiction_nm=1.4)),
        (sine(0.5, 0.1, center=1.0), Servo(stiction_nm=0.5, gravity_nm=2.0)),
        (sine(1.5, 0.05), Servo(stiction_nm=0.2, gravity_nm=1.5)),
        (sine(0.3, 2.0), Servo()),
        (sine(0.15, 4.0), Servo(stiction_nm=0.6)),
        (np.repeat([0.0, 0.3, 0.9, 0.2, 0.0], 150), Servo(stiction_nm=0.8)),
        (np.concatenate([np.zeros(500), np.linspace(0, 1.5, 100), np.full(150, 1.5)]), Servo(gravity_nm=1.5)),
        (sine(0.9, 0.1), Servo(stop_rad=0.9)),
    ],
    ids=["stiction", "stiction-small", "sag+stiction", "sag", "lag", "fast", "steps", "lift", "touch"],
)
def test_stiction_sag_and_lag_are_no_hits(command, servo, seed):
    warnings = [flag for flag in check_quality(servo.run(command, seed)) if flag.severity == "warning"]
    assert [flag for flag in warnings if flag.kind != "failed_execution"] == []


def test_without_a_load_the_error_must_be_larger():
    assert "limit_hit" in kinds(Servo(stop_rad=0.8).run(sine(1.2, 0.1), with_load=False))
    assert "limit_hit" not in kinds(Servo(stop_rad=1.0).run(sine(1.2, 0.1), with_load=False))


def test_held_command_out_of_reach_is_a_note_until_far():
    # The command jumps to beyond the stop and stays: a limit, or a load too heavy to lift.
    steps = lambda top: np.concatenate([sine(0.3, 0.5, seconds=10), np.full(100, top), np.zeros(100)])  # noqa: E731
    near = the(Servo(stop_rad=0.5).run(steps(0.7)), "limit_hit")
    assert near.severity == "note"
    assert "too weak" in near.detail
    assert the(Servo(stop_rad=0.5).run(steps(0.95)), "limit_hit").severity == "warning"


def test_degrees_and_metres_see_the_same():
    episode = Servo(stop_rad=0.8).run(sine(1.2, 0.1))
    expected = the(episode, "limit_hit")
    for unit, factor in (("deg", 180 / np.pi), ("m", 0.1), ("mm", 100.0), ("1", 0.5)):
        units = {"position": (unit,)}
        scaled = make_episode(
            make_series(
                episode.measured.time_s,
                units=units,
                position=factor * episode.measured["position"],
                torque=episode.measured["torque"],
            ),
            make_series(episode.measured.time_s, units=units, position=factor * episode.commanded()["position"]),
        )
        flag = the(scaled, "limit_hit")
        assert (flag.start_s, flag.end_s, flag.severity) == (expected.start_s, expected.end_s, "warning")


def test_goal_beside_torques_is_not_followed():
    time_s = np.arange(0.0, 10.0, 0.01)
    swing = make_series(time_s, position=0.3 * np.sin(5 * time_s), torque=np.cos(5 * time_s))
    goal = make_series(time_s, position=np.full(1000, np.pi), torque=np.cos(5 * time_s))
    assert check_quality(make_episode(swing, goal)) == ()
    servo = make_series(time_s, position=np.full(1000, np.pi))
    assert kinds(make_episode(swing, servo)) == {"failed_execution"}


# Failed executions


def test_position_error_by_hand():
    measured = make_series([0.0, 1.0], ("a", "b"), position=[[0.0, 1.0], [2.0, 1.0]])
    command = make_series([0.0, 0.5], ("b", "a"), position=[[1.0, 0.0], [0.0, 1.0]])
    # Held at 1 s: a is 2 - 1, b is 1 - 0.
    assert position_mse(make_episode(measured, command)) == pytest.approx((0 + 0 + 1 + 1) / 4)


def test_a_robot_that_did_not_move_failed():
    time_s = np.arange(0.0, 10.0, 0.01)
    asked = 0.5 * np.sin(time_s)
    command = make_series(time_s, position=asked)
    flag = failed_execution(make_episode(make_series(time_s, position=1e-4 * asked), command), QualityConfig())
    assert flag is not None
    assert flag.severity == "warning"
    assert failed_execution(make_episode(make_series(time_s, position=0.8 * asked), command), QualityConfig()) is None
    small = make_series(time_s, position=0.1 * asked)
    assert failed_execution(make_episode(make_series(time_s, position=0.0 * asked), small), QualityConfig()) is None


def test_position_error_against_a_simulated_run():
    from dataclasses import replace

    time_s = np.arange(0.0, 10.0, 0.01)
    move = np.sin(time_s)
    good = make_series(time_s[::2], position=move[::2] + 0.01)
    episode = replace(make_episode(make_series(time_s, position=move)), simulated={"good": good})
    assert position_mse(episode, run="good") == pytest.approx(1e-4, rel=0.01)
    with pytest.raises(MissingSignal):
        position_mse(episode, run="other")
    with pytest.raises(MissingSignal):
        position_mse(episode)


def test_threshold_from_the_data_keeps_the_good_and_drops_the_bad():
    rng = np.random.default_rng(10)
    good = 1e-4 * np.exp(0.5 * rng.normal(size=100))
    threshold = robust_threshold([*good, *np.full(40, 0.3)])
    assert good.max() < threshold < 0.3
    assert robust_threshold([1e-4] * 10) == pytest.approx(4e-4)
    with pytest.raises(DataError):
        robust_threshold([1.0] * 4)
    with pytest.raises(DataError):
        robust_threshold([1.0] * 9 + [np.nan])


# Flags together


def test_importers_flags_stay_and_own_ones_are_not_doubled():
    measured, command = moving(np.random.default_rng(11))
    imported = Flag(kind="repeated_stamps", detail="3 rows dropped")
    episode = make_episode(measured.rows(np.delete(np.arange(1000), range(500, 520))), command, flags=(imported,))
    once = check_quality(episode)
    assert [flag.kind for flag in once] == ["repeated_stamps", "gap"]
    assert check_quality(episode.with_flags(once)) == once


def test_one_sample_and_no_position():
    assert check_quality(make_episode(make_series([0.0], position=[0.0]), make_series([0.0], position=[0.0]))) == ()
    assert check_quality(make_episode(make_series([0.0, 1.0], torque=[0.0, 1.0]))) == ()
