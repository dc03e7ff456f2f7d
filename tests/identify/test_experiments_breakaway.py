"""Breakaway: known thresholds come back, with honest intervals; what is no breakaway is said to be none."""

from dataclasses import replace

import numpy as np
import pytest

from identify.experiment_robots import Friction, SlidingRobot, log, recordings
from trueup.core.episode import Episode
from trueup.core.timeseries import TimeSeries
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter
from trueup.errors import DataError, MissingSignal, NotIdentifiable
from trueup.identify.experiments import (
    Limits,
    PoseHold,
    RampPlan,
    RunSettings,
    estimate_breakaway,
    run_breakaway,
)

FRICTION = Friction(static=(0.65, 0.62), kinetic=(0.5, 0.5), offset=0.1)
LIMITS = Limits({"joint1": 1.5})
AT_200 = RunSettings(rate_hz=200.0)


def ramps(friction, *, rate_hz=200.0, slope=0.4, seeds=(0,), sign=1, rest_s=0.5, top=1.2, **options):
    """Open-loop ramps that do not stop when the joint moves: torque, positions, velocities."""
    time_s = np.arange(int((rest_s + top / slope) * rate_hz)) / rate_hz
    torque = sign * slope * np.maximum(time_s - rest_s, 0.0)
    return torque, *recordings(friction, torque, rate_hz, seeds, substeps=max(1, round(500 / rate_hz)), **options)


def both_ways(friction, rate_hz=200.0, repetitions=3, **options):
    """Recorded ramps of both signs as episodes."""
    episodes = []
    for sign, word in ((1, "positive"), (-1, "negative")):
        torque, position, velocity = ramps(friction, sign=sign, seeds=range(repetitions), rate_hz=rate_hz, **options)
        episodes += [
            log(f"joint1_ramp-{word}-{n + 1:02d}", rate_hz, torque, position[n], velocity[n])
            for n in range(repetitions)
        ]
    return episodes


def value(result, quantity, joint="joint1"):
    return result.finding(joint, quantity).estimate


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_robot_gives_its_thresholds(seed):
    own = SlidingRobot({"joint1": FRICTION}, position_noise=1e-4, velocity_noise=0.01, seed=seed, dt=0.001)
    plan = RampPlan(ramp_nm_per_s=0.5, repetitions=3, rest_s=0.3)
    result = estimate_breakaway(run_breakaway(own, own, limits=LIMITS, plan=plan, settings=AT_200))
    # An offset of +0.1 helps the positive direction and hinders the negative one.
    assert value(result, "positive").value == pytest.approx(0.55, abs=0.015)
    assert value(result, "negative").value == pytest.approx(-0.72, abs=0.015)
    assert value(result, "static_friction").value == pytest.approx(0.635, abs=0.01)
    assert value(result, "midpoint").value == pytest.approx(0.015 - 0.1, abs=0.01)
    assert not result.problems
    for quantity in ("positive", "negative"):
        found = value(result, quantity)
        assert found.low < found.value < found.high
        assert found.unit == "Nm"
    assert "Starts to move in positive direction at 0.5" in result.finding("joint1", "positive").sentence


@pytest.mark.parametrize(
    ("options", "channels"),
    [
        ({"position_noise": 1e-4, "velocity_noise": 0.01}, "both"),
        ({"position_noise": 1e-3, "velocity_noise": 0.05}, "both"),
        ({"velocity_noise": 0.02}, "velocity"),
        ({"step": 0.0015, "position_noise": 1e-6}, "position"),
    ],
)
def test_intervals_cover_the_truth(options, channels):
    rate, repetitions, cases = 200.0, 4, 40
    scatter = 1.0 + 0.04 * np.random.default_rng(7).standard_normal(cases * repetitions)
    torque, position, velocity = ramps(FRICTION, seeds=range(cases * repetitions), scale=scatter, **options)
    covered = 0
    for case in range(cases):
        rows = range(case * repetitions, (case + 1) * repetitions)
        episodes = [
            log(
                f"joint1_{row}",
                rate,
                torque,
                None if channels == "velocity" else position[row],
                None if channels == "position" else velocity[row],
            )
            for row in rows
        ]
        found = value(estimate_breakaway(episodes), "positive")
        covered += found.low <= 0.55 <= found.high
        assert found.high - found.low < 0.2  # an interval that covers because it is useless is none
    assert covered >= 0.85 * cases


@pytest.mark.parametrize("inertia", [0.02, 0.2, 1.0])
@pytest.mark.parametrize("static", [(0.5, 0.5), (0.65, 0.62)])  # with and without a drop to the kinetic friction
def test_what_the_ramp_gains_until_the_motion_is_seen_is_taken_off(inertia, static):
    friction = replace(FRICTION, inertia=inertia, static=static, offset=0.0)
    result = estimate_breakaway(both_ways(friction))
    found = value(result, "positive")
    assert found.low <= static[0] <= found.high
    correction = np.mean([run["correction"] for run in result.runs])
    seen = np.mean([run["seen_after_s"] for run in result.runs])
    assert correction == pytest.approx(0.4 * seen, rel=0.2)
    assert abs(found.value - static[0]) < 0.2 * correction + 0.003


def test_a_steeper_ramp_finds_the_same_threshold():
    slow, fast = (value(estimate_breakaway(both_ways(FRICTION, slope=slope)), "positive") for slope in (0.2, 1.0))
    assert fast.value == pytest.approx(slow.value, abs=0.01)
    assert fast.high - fast.low > slow.high - slow.low


def test_mirrored_recordings_swap_the_thresholds_exactly():
    episodes = both_ways(FRICTION, position_noise=1e-4)
    mirrored = [
        log(item.id, 200.0, *(-values[:, 0] for values in (item.commanded()["torque"], item.measured["position"])))
        for item in episodes
    ]
    plain = [
        log(item.id, 200.0, item.commanded()["torque"][:, 0], item.measured["position"][:, 0]) for item in episodes
    ]
    ours, theirs = estimate_breakaway(plain), estimate_breakaway(mirrored)
    assert value(ours, "positive").value == pytest.approx(-value(theirs, "negative").value, abs=1e-12)
    assert value(ours, "negative").low == pytest.approx(-value(theirs, "positive").high, abs=1e-12)
    assert value(ours, "midpoint").value == pytest.approx(-value(theirs, "midpoint").value, abs=1e-12)
    assert value(ours, "static_friction").value == pytest.approx(value(theirs, "static_friction").value, abs=1e-12)


def test_a_robot_built_the_other_way_round_has_swapped_thresholds():
    found = []
    for mirror, friction in ((1, FRICTION), (-1, FRICTION.mirrored())):
        own = SlidingRobot({"joint1": friction}, position_noise=1e-4, velocity_noise=0.01, mirror=mirror, dt=0.005)
        plan = RampPlan(ramp_nm_per_s=0.5, repetitions=2, rest_s=0.3)
        found.append(estimate_breakaway(run_breakaway(own, own, limits=LIMITS, plan=plan, settings=AT_200)))
    assert value(found[0], "positive").value == pytest.approx(-value(found[1], "negative").value, abs=0.01)
    assert value(found[0], "negative").value == pytest.approx(-value(found[1], "positive").value, abs=0.01)


def test_stored_episodes_give_the_same_result(tmp_path):
    own = SlidingRobot({"joint1": FRICTION}, velocity_noise=0.01, dt=0.005)
    plan = RampPlan(ramp_nm_per_s=0.5, repetitions=2, rest_s=0.3)
    episodes = list(run_breakaway(own, own, limits=LIMITS, plan=plan, settings=AT_200))
    with DatasetWriter.create(tmp_path / "ramps", DatasetInfo(robot="one")) as writer:
        for episode in episodes:
            writer.append(episode)
    assert estimate_breakaway(Dataset(tmp_path / "ramps")).to_json() == estimate_breakaway(episodes).to_json()


def test_one_log_may_hold_many_ramps_of_many_joints_in_other_units():
    blocks = both_ways(FRICTION, repetitions=2)
    rows = [(item.commanded()["torque"][:, 0], item.measured["position"][:, 0]) for item in blocks]
    quiet = np.zeros(200)
    torque = np.concatenate([part for own, _ in rows for part in (own, quiet)])
    still, jumps = [], 0.0
    for _, position in rows:  # each ramp starts where the last one ended
        still.append(np.concatenate([position - position[0] + jumps, np.full(200, position[-1] - position[0] + jumps)]))
        jumps += position[-1] - position[0]
    position = np.concatenate(still)
    clock = np.arange(torque.size) / 200.0
    joints = ("a", "b")
    both = np.concatenate([np.stack([torque, 0 * torque], 1), np.stack([0 * torque, torque], 1)])
    moved = np.concatenate(
        [np.stack([position, 0 * position], 1), np.stack([0 * position + position[-1], position], 1)]
    )
    clock = np.arange(len(both)) / 200.0
    measured = TimeSeries(clock, joints, {"position": np.rad2deg(moved)}, {"position": ("deg", "deg")})
    command = TimeSeries(clock, joints, {"torque": 1e3 * both}, {"torque": ("mNm", "mNm")})
    result = estimate_breakaway([Episode(replace(blocks[0].meta, id="session"), measured, command)])
    assert set(result.joints) == {"a", "b"}
    for joint in joints:
        assert value(result, "positive", joint).value == pytest.approx(0.55, abs=0.01)
        assert value(result, "negative", joint).value == pytest.approx(-0.72, abs=0.01)


def test_a_stated_delay_is_taken_off():
    episodes = both_ways(FRICTION, slope=0.5)
    late = [replace(item, measured=replace(item.measured, time_s=item.measured.time_s + 0.1)) for item in episodes]
    plain, stated = estimate_breakaway(late), estimate_breakaway(late, delay_s=0.1)
    assert value(plain, "positive").value - value(stated, "positive").value == pytest.approx(0.05, abs=0.003)
    assert value(stated, "positive").value == pytest.approx(0.55, abs=0.01)


def test_a_joint_that_does_not_move_gives_a_bound_and_no_number():
    own = SlidingRobot({"joint1": Friction(static=(9.0, 0.4))}, dt=0.005)
    plan = RampPlan(ramp_nm_per_s=1.0, repetitions=2, rest_s=0.3)
    result = estimate_breakaway(run_breakaway(own, own, limits=LIMITS, plan=plan, settings=AT_200))
    positive = result.finding("joint1", "positive")
    assert positive.status == "no_motion"
    assert np.isnan(positive.estimate.value)
    assert positive.estimate.low == pytest.approx(1.5, abs=0.01)
    assert positive.estimate.high is None
    assert "No motion up to 1.5 Nm" in positive.sentence
    assert result.finding("joint1", "negative").status == "ok"
    assert result.finding("joint1", "midpoint").status == "no_motion"
    assert np.isnan(value(result, "midpoint").value)
    assert any("No motion up to" in sentence for sentence in result.problems)


def test_ramps_that_sometimes_end_too_early_are_censored():
    episodes = both_ways(FRICTION)
    short = episodes[0].commanded()["torque"][:, 0].copy()
    short[np.abs(short) > 0.4] = 0.0
    stuck = log("joint1_short", 200.0, short, 1e-5 * np.random.default_rng(3).standard_normal(short.size))
    result = estimate_breakaway([*episodes, stuck])
    assert result.finding("joint1", "positive").status == "censored"
    assert "too small" in result.finding("joint1", "positive").sentence


def test_a_joint_that_falls_has_no_threshold():
    own = SlidingRobot({"joint1": Friction(offset=0.6)}, dt=0.005)
    plan = RampPlan(repetitions=1, rest_s=0.3)
    episodes = list(run_breakaway(own, own, limits=LIMITS, plan=plan, settings=AT_200))
    assert not np.any([item.commanded()["torque"] for item in episodes[:1]])  # nothing is applied to a falling joint
    result = estimate_breakaway(episodes)
    for quantity in ("positive", "negative", "midpoint"):
        assert result.finding("joint1", quantity).status == "moves_without_torque"
        assert np.isnan(value(result, quantity).value)


def test_a_joint_that_moves_against_its_ramp_is_no_threshold():
    episodes = [
        log(item.id, 200.0, -item.commanded()["torque"][:, 0], item.measured["position"][:, 0])
        for item in both_ways(FRICTION)
    ]
    with pytest.raises(NotIdentifiable, match="against the ramp"):
        estimate_breakaway(episodes)


@pytest.mark.parametrize(
    ("torque", "reason"),
    [
        (np.full(400, 0.5), "no ramp"),
        (np.zeros(400), "zero throughout"),
        (np.linspace(0.0, 1.0, 400), "no rest"),
        (np.sin(np.arange(400) / 20.0), "no ramp"),
    ],
)
def test_commands_that_are_no_ramp_after_a_rest_are_refused_with_the_reason(torque, reason):
    position = 1e-5 * np.random.default_rng(0).standard_normal(400)
    with pytest.raises(NotIdentifiable, match=reason):
        estimate_breakaway([log("joint1_x", 200.0, torque, position)])


def test_missing_signals_and_missing_data_are_refused():
    good = both_ways(FRICTION, repetitions=1)[0]
    with pytest.raises(DataError, match="no episodes"):
        estimate_breakaway([])
    with pytest.raises(MissingSignal, match="no command"):
        estimate_breakaway([replace(good, command=None, meta=replace(good.meta, id="x"))])
    blind = log(good.id, 200.0, good.commanded()["torque"][:, 0], np.full(len(good.measured), np.nan))
    with pytest.raises(NotIdentifiable, match="no usable position"):
        estimate_breakaway([blind])


def test_one_broken_episode_does_not_spoil_the_others():
    episodes = both_ways(FRICTION)
    broken = log("joint1_broken", 200.0, np.full(300, 0.3), np.zeros(300))
    result = estimate_breakaway([broken, *episodes])
    assert value(result, "positive").value == pytest.approx(0.55, abs=0.01)
    assert [item.episode for item in result.rejected] == ["joint1_broken"]
    assert any("joint1_broken" in problem for problem in result.problems)


def test_a_saturated_drive_is_said():
    episodes = []
    for item in both_ways(FRICTION):
        asked = item.commanded()["torque"]
        signals = {**item.measured.signals, "torque": np.clip(asked, -0.3, 0.3)}
        units = {**item.measured.units, "torque": ("Nm",)}
        episodes.append(replace(item, measured=replace(item.measured, signals=signals, units=units)))
    result = estimate_breakaway(episodes)
    assert any("did not deliver" in note for note in result.notes["joint1"])


def test_another_joint_that_moves_is_said():
    frictions = {"joint1": FRICTION, "joint2": Friction(offset=0.6)}
    own = SlidingRobot(frictions, dt=0.005)
    limits = Limits({"joint1": 1.5, "joint2": 1.5})
    plan = RampPlan(ramp_nm_per_s=0.5, repetitions=2, rest_s=0.3)
    result = estimate_breakaway(run_breakaway(own, own, limits=limits, joints=["joint1"], plan=plan, settings=AT_200))
    assert any("joint2 moved" in note for note in result.notes["joint1"])


def test_one_repetition_has_a_value_but_no_interval():
    found = value(estimate_breakaway(both_ways(FRICTION, repetitions=1)), "positive")
    assert found.value == pytest.approx(0.55, abs=0.01)
    assert found.low is None
    assert found.high is None


def test_an_encoder_glitch_is_no_breakaway():
    episodes = both_ways(FRICTION)
    position = episodes[0].measured["position"][:, 0].copy()
    position[150] += 0.2
    glitched = log(episodes[0].id, 200.0, episodes[0].commanded()["torque"][:, 0], position)
    assert value(estimate_breakaway([glitched, *episodes[1:]]), "positive").value == pytest.approx(0.55, abs=0.01)


def test_holding_and_returning_gives_the_same_thresholds():
    own = SlidingRobot({"joint1": FRICTION, "joint2": Friction(offset=0.6)}, velocity_noise=1e-3, dt=0.005)
    hold = PoseHold({"joint1": 80.0, "joint2": 80.0}, {"joint1": 5.0, "joint2": 5.0})
    settings = RunSettings(rate_hz=200.0, hold=hold)
    limits = Limits({"joint1": 1.5, "joint2": 3.0})
    plan = RampPlan(ramp_nm_per_s=0.5, repetitions=3, rest_s=0.3)
    episodes = list(run_breakaway(own, own, limits=limits, joints=["joint1"], plan=plan, settings=settings))
    result = estimate_breakaway(episodes)
    assert set(result.joints) == {"joint1"}  # although joint2 is commanded as well
    assert value(result, "positive").value == pytest.approx(0.55, abs=0.02)
    assert all(abs(episode.measured["position"][0, 0]) < 0.02 for episode in episodes)
