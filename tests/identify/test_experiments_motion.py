"""Constant torques and coasting: offset, asymmetry, friction and inertia come back with honest intervals."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from identify.experiment_robots import Friction, SlidingRobot, log, recordings
from trueup.core.timeseries import TimeSeries
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter
from trueup.errors import ConfigError, DataError, MissingSignal, NotIdentifiable
from trueup.identify.experiments import (
    ExperimentResult,
    Limits,
    PoseHold,
    PulsePlan,
    RampPlan,
    RunSettings,
    SlideSettings,
    estimate_breakaway,
    estimate_coast,
    estimate_constant_torque,
    run_breakaway,
    run_coast,
    run_constant_torque,
)
from trueup.lab.simulated_robot import Sensors, SimulatedRobot
from trueup.robots import ControllerSpec, JointSpec, RobotSpec
from trueup.sim import MujocoSimulator

# Gravity pushes with 0.1 Nm; Coulomb friction is 0.1 Nm larger in positive direction.
FRICTION = Friction(inertia=0.1, static=(0.5, 0.5), kinetic=(0.4, 0.3), viscous=(0.2, 0.2), offset=0.1)
MIRROR = -0.1 + 0.05  # -o + (Fc+ - Fc-) / 2
TORQUES = (1.0, -1.0, 1.5, -1.5)


def pulses(
    friction=FRICTION, *, torques=TORQUES, rate_hz=500.0, excite_s=0.5, coast_s=0.4, seeds=(0,), scatter=0.0, **options
):
    """Recorded pulses: one list of episodes per seed, both channels."""
    time_s = np.arange(int((0.1 + excite_s + coast_s) * rate_hz)) / rate_hz
    sets = [[] for _ in seeds]
    for number, size in enumerate(torques):
        torque = np.where((time_s >= 0.1) & (time_s < 0.1 + excite_s), size, 0.0)
        drawn = np.random.default_rng([number, 5])
        start = drawn.uniform(-0.01, 0.01, len(seeds))  # so that an encoder rounds differently in each case
        scale = 1.0 + scatter * drawn.standard_normal(len(seeds))
        position, velocity = recordings(friction, torque, rate_hz, seeds, start=start, scale=scale, **options)
        for case, episodes in enumerate(sets):
            episodes.append(log(f"joint1_torque{size}", rate_hz, torque, position[case], velocity[case]))
    return sets


def without(episodes, channel):
    """The same logs without one channel."""
    kept = {"position": "velocity", "velocity": "position"}[channel]
    return [
        replace(
            item,
            measured=replace(
                item.measured, signals={kept: item.measured[kept]}, units={kept: item.measured.units[kept]}
            ),
        )
        for item in episodes
    ]


def value(result, quantity, joint="joint1"):
    return result.finding(joint, quantity).estimate


def covers(found, truth):
    return found.low <= truth <= found.high


def test_a_robot_gives_its_offset_friction_and_inertia():
    own = SlidingRobot({"joint1": FRICTION}, position_noise=1e-4, dt=0.002)
    settings = RunSettings(rate_hz=500.0)
    limits = Limits({"joint1": 2.0})
    result = estimate_constant_torque(
        run_constant_torque(own, own, {"joint1": TORQUES}, limits=limits, settings=settings)
    )
    assert value(result, "mirror_offset").value == pytest.approx(MIRROR, abs=0.002)
    assert value(result, "coulomb_friction").value == pytest.approx(0.35, abs=0.005)
    assert value(result, "viscous_positive").value == pytest.approx(0.2, abs=0.01)
    assert value(result, "effective_inertia").value == pytest.approx(0.1, abs=0.001)
    assert value(result, "effective_inertia").unit == "kg m^2"
    assert value(result, "viscous_negative").unit == "Nm s/rad"
    assert "makes both directions mirror images" in result.finding("joint1", "mirror_offset").sentence
    assert [run["episode"] for run in result.runs] == [f"joint1_torque{torque}" for torque in TORQUES]


@pytest.mark.long
@pytest.mark.parametrize(
    ("options", "signal"),
    [
        ({"position_noise": 1e-4}, "position"),
        # Damped strongly, the noise that the integrated velocity carries into the regressors matters most.
        ({"velocity_noise": 0.02, "friction": replace(FRICTION, viscous=(0.8, 0.8))}, "velocity"),
        ({"step": 0.0015, "position_noise": 1e-6}, "position"),
        (
            {"position_noise": 1e-4, "scatter": 0.03, "torques": (0.9, -0.9, 1.0, -1.0, 1.5, -1.5)},
            "position",
        ),
    ],
)
def test_intervals_cover_the_truth(options, signal):
    cases = 40
    hits = dict.fromkeys(("mirror_offset", "coulomb_friction", "effective_inertia", "coast"), 0)
    for episodes in pulses(seeds=range(cases), rate_hz=250.0, **options):
        own = without(episodes, "velocity" if signal == "position" else "position")
        result = estimate_constant_torque(own)
        hits["mirror_offset"] += covers(value(result, "mirror_offset"), MIRROR)
        hits["coulomb_friction"] += covers(value(result, "coulomb_friction"), 0.35)
        hits["effective_inertia"] += covers(value(result, "effective_inertia"), 0.1)
        hits["coast"] += covers(value(estimate_coast(own), "coulomb_rate"), 3.5)
        width = value(result, "mirror_offset").high - value(result, "mirror_offset").low
        assert width < (0.15 if "scatter" in options else 0.01)
    assert min(hits.values()) >= 0.85 * cases, hits


def test_what_was_found_makes_both_directions_mirror_images():
    (episodes,) = pulses()
    offset = value(estimate_constant_torque(episodes), "mirror_offset").value
    corrected = replace(FRICTION, offset=FRICTION.offset + offset)  # adding to commands is adding to the joint
    for size in (1.0, 1.5):
        travel = [
            recordings(corrected, np.full(250, sign * size), 500.0, (0,), position_noise=0.0)[0][0, -1]
            for sign in (1, -1)
        ]
        before = [
            recordings(FRICTION, np.full(250, sign * size), 500.0, (0,), position_noise=0.0)[0][0, -1]
            for sign in (1, -1)
        ]
        assert abs(travel[0] + travel[1]) < 0.03 * abs(before[0] + before[1])


def test_mirrored_recordings_change_the_sign_of_the_offset_and_swap_directions():
    friction = replace(FRICTION, viscous=(0.3, 0.15))
    (episodes,) = pulses(friction, position_noise=1e-4)
    mirrored = [
        log(item.id, 500.0, *(-values[:, 0] for values in (item.commanded()["torque"], item.measured["position"], item.measured["velocity"])))
        for item in episodes
    ]  # fmt: skip
    ours, theirs = estimate_constant_torque(episodes), estimate_constant_torque(mirrored)
    for quantity in (
        "mirror_offset",
        "viscous_asymmetry",
        "gravity_offset_if_symmetric",
        "coulomb_asymmetry_if_balanced",
    ):
        assert value(ours, quantity).value == pytest.approx(-value(theirs, quantity).value, rel=1e-6)
    assert value(ours, "viscous_positive").value == pytest.approx(value(theirs, "viscous_negative").value, rel=1e-6)
    coast, tsaoc = estimate_coast(episodes), estimate_coast(mirrored)
    assert value(coast, "coulomb_rate_positive").low == pytest.approx(
        value(tsaoc, "coulomb_rate_negative").low, rel=1e-6
    )


def test_viscous_asymmetry_is_seen_and_the_offset_is_that_of_the_mean_speed():
    friction = replace(FRICTION, viscous=(0.3, 0.15))
    (episodes,) = pulses(friction, position_noise=1e-4)
    result = estimate_constant_torque(episodes)
    assert covers(value(result, "viscous_asymmetry"), 0.15)
    speed = value(result, "mirror_speed").value
    assert value(result, "mirror_offset").value == pytest.approx(MIRROR + 0.075 * speed, abs=0.002)
    assert value(result, "gravity_offset_if_symmetric").value == pytest.approx(-MIRROR, abs=0.005)
    assert any("no constant offset mirrors" in note for note in result.notes["joint1"])


def test_an_offset_and_a_coulomb_asymmetry_of_the_same_size_look_the_same():
    (offset,) = pulses(replace(FRICTION, kinetic=(0.35, 0.35), offset=0.05))
    (asymmetry,) = pulses(replace(FRICTION, kinetic=(0.3, 0.4), offset=0.0))
    one, other = (estimate_constant_torque(episodes) for episodes in (offset, asymmetry))
    for quantity in ("mirror_offset", "gravity_offset_if_symmetric", "coulomb_asymmetry_if_balanced"):
        assert value(one, quantity).value == pytest.approx(value(other, quantity).value, abs=1e-3)
    assert value(one, "gravity_offset_if_symmetric").value == pytest.approx(0.05, abs=1e-3)
    assert value(other, "coulomb_asymmetry_if_balanced").value == pytest.approx(-0.1, abs=2e-3)
    assert "cannot tell" in one.finding("joint1", "gravity_offset_if_symmetric").sentence


def test_a_breakaway_experiment_splits_offset_and_asymmetry():
    # Static friction is the same in both directions, which is what the split assumes.
    own = SlidingRobot({"joint1": FRICTION}, position_noise=1e-5, dt=0.002)
    settings = RunSettings(rate_hz=500.0)
    limits = Limits({"joint1": 2.0})
    plan = RampPlan(ramp_nm_per_s=0.5, repetitions=3, rest_s=0.3)
    breakaway = estimate_breakaway(run_breakaway(own, own, limits=limits, plan=plan, settings=settings))
    episodes = list(run_constant_torque(own, own, {"joint1": TORQUES}, limits=limits, settings=settings))
    result = estimate_constant_torque(episodes, breakaway=breakaway)
    assert covers(value(result, "gravity_offset_from_breakaway"), 0.1)
    assert covers(value(result, "coulomb_asymmetry_from_breakaway"), 0.1)
    assert value(result, "gravity_offset_from_breakaway").value == pytest.approx(0.1, abs=0.01)
    assert value(result, "coulomb_asymmetry_from_breakaway").value == pytest.approx(0.1, abs=0.02)


def test_viscous_friction_splits_them_if_all_friction_scales_by_one_factor():
    friction = replace(FRICTION, kinetic=(0.4, 0.3), viscous=(0.4, 0.3))
    (episodes,) = pulses(friction)
    result = estimate_constant_torque(episodes)
    assert value(result, "gravity_offset_from_viscous").value == pytest.approx(0.1, abs=0.003)
    assert value(result, "coulomb_asymmetry_from_viscous").value == pytest.approx(0.1, abs=0.006)


def test_gravity_that_changes_with_the_position_is_told_from_the_offset():
    friction = replace(FRICTION, slope=-0.5)
    (episodes,) = pulses(friction, substeps=4)
    result = estimate_constant_torque(episodes)
    start = value(result, "reference_position").value
    assert value(result, "position_slope").value == pytest.approx(-0.5, abs=0.01)
    assert value(result, "mirror_offset").value == pytest.approx(MIRROR + 0.5 * start, abs=0.002)
    blind = estimate_constant_torque(episodes, position_slope=False)
    assert abs(value(blind, "coulomb_friction").value - 0.35) > 3 * abs(value(result, "coulomb_friction").value - 0.35)
    assert any("times the noise" in note for note in blind.notes["joint1"])


def test_velocity_alone_says_the_same_as_position_alone():
    (episodes,) = pulses(position_noise=1e-5, velocity_noise=1e-3)
    by_position = estimate_constant_torque(without(episodes, "velocity"))
    by_velocity = estimate_constant_torque(without(episodes, "position"))
    chosen = estimate_constant_torque(episodes, settings=SlideSettings(signal="velocity"))
    assert value(by_velocity, "mirror_offset").value == pytest.approx(
        value(by_position, "mirror_offset").value, abs=1e-3
    )
    assert value(chosen, "mirror_offset") == value(by_velocity, "mirror_offset")


def test_a_delay_of_the_torque_is_found_and_does_no_harm():
    (episodes,) = pulses(position_noise=1e-5)
    late = [replace(item, measured=replace(item.measured, time_s=item.measured.time_s + 0.006)) for item in episodes]
    result = estimate_constant_torque(late)
    assert value(result, "torque_delay").value == pytest.approx(0.006, abs=0.001)
    assert value(result, "viscous_positive").value == pytest.approx(0.2, abs=0.006)
    stated = estimate_constant_torque(late, settings=SlideSettings(delay_s=0.006))
    assert value(stated, "torque_delay").value == pytest.approx(0.0, abs=0.001)


def test_one_size_of_torque_without_coasting_needs_the_inertia():
    (episodes,) = pulses(torques=(1.0, -1.0), coast_s=0.0)
    result = estimate_constant_torque(episodes)
    offset = result.finding("joint1", "mirror_offset")
    assert offset.status == "not_identifiable"
    assert np.isnan(offset.estimate.value)
    assert "inertia" in offset.sentence
    assert set(result.joints["joint1"]) == {"mirror_offset"}
    known = estimate_constant_torque(episodes, inertia_kgm2={"joint1": 0.1})
    assert value(known, "mirror_offset").value == pytest.approx(MIRROR, abs=0.003)
    assert any("too few recordings" in note for note in known.notes["joint1"])


def test_a_direction_without_motion_is_said_with_the_torques_that_were_tried():
    # Joint 6 of the thesis: no motion at -0.45 Nm, motion at +0.45 Nm.
    stuck = Friction(inertia=0.05, static=(0.35, 0.35), kinetic=(0.25, 0.25), offset=0.15)
    (episodes,) = pulses(stuck, torques=(0.45, -0.45))
    result = estimate_constant_torque(episodes)
    offset = result.finding("joint1", "mirror_offset")
    assert offset.status == "no_motion"
    assert "No motion in negative direction under -0.45 Nm" in offset.sentence
    assert any("No motion in negative" in problem for problem in result.problems)


def test_a_frozen_joint_gives_no_number():
    own = SlidingRobot({"joint1": FRICTION}, dt=0.002, frozen=("joint1",))
    limits = Limits({"joint1": 2.0})
    episodes = list(run_coast(own, own, {"joint1": TORQUES}, limits=limits, settings=RunSettings(rate_hz=500.0)))
    offset = estimate_constant_torque(episodes).finding("joint1", "mirror_offset")
    assert offset.status == "no_motion"
    assert "under -1.5, -1 Nm" in offset.sentence
    rate = estimate_coast(episodes).finding("joint1", "coulomb_rate")
    assert rate.status == "no_motion"
    assert np.isnan(rate.estimate.value)


def test_a_rebound_from_an_end_stop_is_left_out_or_can_be():
    (episodes,) = pulses(position_noise=1e-5, coast_s=0.1)
    stopped = []
    for item in episodes:
        position = item.measured["position"][:, 0]
        beyond = np.abs(position) > 0.5
        bounced = np.where(beyond, np.sign(position) * (0.5 - 0.3 * (np.abs(position) - 0.5)), position)
        stopped.append(log(item.id, 500.0, item.commanded()["torque"][:, 0], np.clip(bounced, -0.5, 0.5)))
    plain = estimate_constant_torque(stopped)
    assert any("against their torque" in note for note in plain.notes["joint1"])
    limited = estimate_constant_torque(stopped, settings=SlideSettings(position_rad={"joint1": (-0.5, 0.5)}))
    assert value(limited, "mirror_offset").value == pytest.approx(MIRROR, abs=0.01)
    near = estimate_constant_torque(stopped, settings=SlideSettings(max_travel_rad=0.4))
    assert value(near, "mirror_offset").value == pytest.approx(MIRROR, abs=0.01)


def test_a_saturated_drive_is_said_and_its_own_torque_can_be_used():
    size = 1.2  # what the drive delivers at most
    asked = pulses(torques=(1.0, -1.0, 3.0, -3.0))[0]
    given = pulses(torques=(1.0, -1.0, size, -size))[0]
    episodes = []
    for command, motion in zip(asked, given, strict=True):
        signals = {**motion.measured.signals, "torque": motion.commanded()["torque"]}
        units = {**motion.measured.units, "torque": ("Nm",)}
        episodes.append(replace(command, measured=replace(motion.measured, signals=signals, units=units)))
    result = estimate_constant_torque(episodes)
    assert any("did not deliver" in note for note in result.notes["joint1"])
    assert any("times the noise" in note for note in result.notes["joint1"])
    own = estimate_constant_torque(episodes, settings=SlideSettings(torque="measured"))
    assert value(own, "mirror_offset").value == pytest.approx(MIRROR, abs=0.002)
    assert value(own, "effective_inertia").value == pytest.approx(0.1, abs=0.001)


def test_bad_recordings_are_refused_with_the_reason():
    (episodes,) = pulses()
    with pytest.raises(DataError, match="no episodes"):
        estimate_constant_torque([])
    silent = [log("joint1_torque0", 500.0, np.zeros(300), np.zeros(300))]
    for estimate in (estimate_constant_torque, estimate_coast):
        with pytest.raises(NotIdentifiable, match="torque is zero throughout"):
            estimate(silent)
    with pytest.raises(NotIdentifiable, match="no velocity"):
        estimate_constant_torque(without(episodes, "velocity"), settings=SlideSettings(signal="velocity"))
    with pytest.raises(MissingSignal):
        estimate_coast([replace(episodes[0], command=None, meta=replace(episodes[0].meta, id="x"))])
    with pytest.raises(ConfigError):
        SlideSettings(min_speed=-1.0)
    with pytest.raises(ConfigError):
        SlideSettings(delay_s=-0.1)


def test_coasting_alone_gives_friction_over_inertia():
    friction = replace(FRICTION, viscous=(0.3, 0.15))
    (episodes,) = pulses(friction, position_noise=1e-5)
    result = estimate_coast(episodes)
    assert value(result, "viscous_rate_positive").value == pytest.approx(3.0, abs=0.1)
    assert value(result, "viscous_rate_negative").value == pytest.approx(1.5, abs=0.1)
    assert value(result, "coulomb_rate_positive").value == pytest.approx((0.4 - 0.1) / 0.1, abs=0.1)
    assert value(result, "coulomb_rate_negative").value == pytest.approx((0.3 + 0.1) / 0.1, abs=0.1)
    assert value(result, "coulomb_rate").value == pytest.approx(3.5, abs=0.1)
    assert value(result, "coulomb_rate").unit == "rad/s^2"
    assert value(result, "coulomb_friction").value == pytest.approx(0.35, abs=0.01)
    stated = estimate_coast(episodes, inertia_kgm2={"joint1": 0.2})
    assert value(stated, "coulomb_friction").value == pytest.approx(0.7, abs=0.02)
    assert value(stated, "coulomb_rate") == value(result, "coulomb_rate")


def test_one_direction_and_no_coasting_are_said():
    (episodes,) = pulses(position_noise=1e-5)
    one = estimate_coast(episodes[::2])
    assert "one direction only" in one.finding("joint1", "coulomb_rate").sentence
    assert "coulomb_rate_negative" not in one.joints["joint1"]
    (cut,) = pulses(coast_s=0.0)
    none = estimate_coast(cut).finding("joint1", "coulomb_rate")
    assert none.status == "no_motion"
    assert "no coasting" in none.sentence


def test_stored_episodes_and_results_read_back_the_same(tmp_path):
    own = SlidingRobot({"joint1": FRICTION}, position_noise=1e-4, dt=0.002)
    limits = Limits({"joint1": 2.0})
    episodes = list(run_coast(own, own, {"joint1": TORQUES}, limits=limits, settings=RunSettings(rate_hz=500.0)))
    with DatasetWriter.create(tmp_path / "coast", DatasetInfo(robot="one")) as writer:
        for episode in episodes:
            writer.append(episode)
    stored = Dataset(tmp_path / "coast")
    for estimate in (estimate_constant_torque, estimate_coast):
        result = estimate(episodes)
        assert estimate(stored).to_json() == result.to_json()
        result.save(tmp_path / "result.json")
        assert ExperimentResult.load(tmp_path / "result.json").to_json() == result.to_json()


@pytest.fixture(scope="module")
def spring_joint():
    """A joint in MuJoCo with Coulomb and viscous friction, and a spring as the error of the gravity compensation."""
    xml = """<mujoco><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/><worldbody><body>
      <inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>
      <joint name="joint1" axis="0 0 1" frictionloss="0.4" damping="0.2" stiffness="0.3" springref="0.5"/>
    </body></worldbody></mujoco>"""
    robot = RobotSpec("one", (JointSpec("joint1"),), "one.xml", controller=ControllerSpec(kind="torque"))
    return MujocoSimulator.from_spec(mujoco.MjSpec.from_string(xml), robot, origin=Path("one.xml"))


def test_a_mujoco_joint_gives_what_its_model_says(spring_joint):
    sensors = Sensors(position_noise_rad=1e-4, velocity_noise_rad_s=0.01, torque_noise_nm=0.01)
    own = SimulatedRobot(spring_joint, sensors=sensors, seed=3)
    hold = PoseHold({"joint1": 60.0}, {"joint1": 5.0})
    settings = RunSettings(rate_hz=500.0, hold=hold)
    limits = Limits({"joint1": 2.0})
    plan = RampPlan(ramp_nm_per_s=0.5, repetitions=3, rest_s=0.3)
    breakaway = estimate_breakaway(run_breakaway(own, own, limits=limits, plan=plan, settings=settings))
    assert value(breakaway, "positive").value == pytest.approx(0.4 - 0.15, abs=0.03)
    assert value(breakaway, "negative").value == pytest.approx(-0.4 - 0.15, abs=0.03)
    episodes = list(
        run_constant_torque(
            own, own, {"joint1": TORQUES}, limits=limits, plan=PulsePlan(max_travel_rad=0.4), settings=settings
        )
    )
    result = estimate_constant_torque(episodes, breakaway=breakaway)
    start = value(result, "reference_position").value
    assert value(result, "mirror_offset").value == pytest.approx(-0.3 * (0.5 - start), abs=0.003)
    assert value(result, "coulomb_friction").value == pytest.approx(0.4, abs=0.005)
    assert value(result, "viscous_positive").value == pytest.approx(0.2, abs=0.01)
    assert value(result, "effective_inertia").value == pytest.approx(0.1, abs=0.002)
    assert value(result, "position_slope").value == pytest.approx(-0.3, abs=0.03)
    assert covers(value(result, "gravity_offset_from_breakaway"), 0.15)
    assert value(estimate_coast(episodes), "coulomb_friction").value == pytest.approx(0.4, abs=0.01)


# --- motions that do not isolate anything ---


def driven(torque, *, rate_hz=500.0, friction=FRICTION, name="joint1_path"):
    """One joint that is driven along a path of torques."""
    position, velocity = recordings(friction, torque, rate_hz, (0,))
    return log(name, rate_hz, torque, position[0], velocity[0])


def test_a_torque_that_passes_through_zero_is_no_end_of_it():
    time_s = np.arange(5000) / 500.0
    free = Friction(inertia=0.1, static=(0.05, 0.05), kinetic=(0.04, 0.04), viscous=(0.1, 0.1))
    waves = [
        driven(1.5 * np.sin(2 * np.pi * hz * time_s), friction=free, name=f"joint1_{hz}") for hz in (0.2, 0.3, 0.5)
    ]
    with pytest.raises(NotIdentifiable, match="passes through zero and does not stay there") as caught:
        estimate_coast(waves)
    assert "Record this joint alone" in str(caught.value)
    assert caught.value.exit_code == 3
    # One that is over before anything can be seen of it says as much.
    quick = driven(1.5 * np.sin(2 * np.pi * 2.0 * time_s), friction=free)
    assert estimate_coast([quick]).finding("joint1", "coulomb_rate").status == "no_motion"
    # Among motions that do coast, they are left out with the reason.
    (good,) = pulses()
    mixed = estimate_coast([*good, *waves])
    assert [item.episode for item in mixed.rejected] == [wave.id for wave in waves]
    assert value(mixed, "coulomb_rate") == value(estimate_coast(good), "coulomb_rate")


def test_a_torque_that_keeps_changing_is_not_constant():
    time_s = np.arange(5000) / 500.0
    wave = driven(1.5 * np.sin(2 * np.pi * 0.5 * time_s))
    with pytest.raises(NotIdentifiable, match="keeps changing") as caught:
        estimate_constant_torque([wave])
    assert "several constant torques" in str(caught.value)
    # A command at 20 Hz changes with each of its own rows, however fast the log is.
    slow = replace(wave, command=wave.command.rows(slice(None, None, 25)))
    with pytest.raises(NotIdentifiable, match="keeps changing"):
        estimate_constant_torque([slow])
    with pytest.raises(NotIdentifiable, match="no ramp"):
        estimate_breakaway([wave])
    (good,) = pulses()
    stairs = driven(np.concatenate([np.full(400, size) for size in (0.0, 1.0, 1.5, 0.0, -1.0, -1.5, 0.0)]))
    assert estimate_constant_torque([*good, stairs]).rejected == ()


@pytest.mark.parametrize("estimate", [estimate_coast, estimate_constant_torque])
def test_motions_of_several_joints_isolate_none(estimate):
    (episodes,) = pulses()

    def beside(episode, size):
        measured = episode.measured
        position = np.hstack([measured["position"], size * np.sin(4 * measured.time_s)[:, None]])
        two = TimeSeries(measured.time_s, ("joint1", "joint2"), {"position": position}, {"position": ("rad", "rad")})
        return replace(episode, measured=two)

    with pytest.raises(NotIdentifiable, match=r"joint2 moved by .* while joint1 slid"):
        estimate([beside(episode, 0.5) for episode in episodes])
    assert estimate([beside(episode, 0.01) for episode in episodes]).rejected == ()


def test_what_is_pushed_while_it_coasts_has_no_friction():
    # 0.8 Nm that nobody commanded push in the direction of the motion, more than friction takes.
    def pushed(size):
        time_s = np.arange(500) / 500.0
        torque = np.where(time_s < 0.5, size, 0.0)
        position, velocity = recordings(
            FRICTION, torque + np.where(time_s < 0.5, 0.0, 0.8 * np.sign(size)), 500.0, (0,)
        )
        return log(f"joint1_torque{size}", 500.0, torque, position[0], velocity[0])

    found = estimate_coast([pushed(size) for size in TORQUES])
    assert list(found.joints["joint1"]) == ["coulomb_rate"]
    rate = found.finding("joint1", "coulomb_rate")
    assert rate.status == "implausible"
    assert np.isnan(rate.estimate.value)
    assert rate.estimate.low is rate.estimate.high is None
    assert "Not found in these motions" in rate.sentence
    assert "Record this joint alone" in rate.sentence


@pytest.mark.parametrize("seed", range(5))
def test_no_friction_is_reported_below_zero(seed):
    # Hardly any friction: what is fitted is as often negative as not.
    smooth = Friction(inertia=0.1, static=(0.002, 0.002), kinetic=(0.001, 0.001), viscous=(0.0, 0.0))
    (episodes,) = pulses(smooth, torques=(0.05, -0.05), seeds=(seed,), position_noise=3e-3)
    found = estimate_coast(episodes).joints["joint1"]
    for name in ("viscous_rate_positive", "viscous_rate_negative", "viscous_rate", "coulomb_rate"):
        estimate = found[name].estimate if name in found else None
        if estimate is not None and not np.isnan(estimate.value):
            assert 0.0 <= estimate.low <= estimate.value <= estimate.high
