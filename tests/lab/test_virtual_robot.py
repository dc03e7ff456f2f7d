"""The virtual robot as a device: two faces with one motion, seeds and units, delay, faults, time, bad input."""

import dataclasses
import time

import numpy as np
import pytest

from trueup.core.protocols import Clock, RobotIO
from trueup.errors import ConfigError, DataError, MissingSignal, RobotStopped
from trueup.lab import Fault, LabSpec, Truth, VirtualRobot, draw_truth, load_lab
from trueup.lab.spec import EFFECTS, Controller, Delay, Elasticity, Friction, Gravity, Ripple, Saturation, Warming

HOME = np.array([0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4])
TICK = 0.001


def wave(count=600, size=0.3):
    """A smooth motion away from home and back, and its velocity."""
    time_s = np.arange(count)[:, None] * TICK
    rate = 2 * np.pi / (count * TICK)
    reach = size * np.array([1.0, -0.6, 0.8, 0.7, -1.0, 0.9, 1.2])
    return HOME + reach * (1 - np.cos(rate * time_s)), reach * rate * np.sin(rate * time_s)


def written(robot, signals):
    """Readings before and after every row, written one by one."""
    start, readings = robot.now_s(), [robot.read()]
    for row in range(len(next(iter(signals.values())))):
        robot.write({name: values[row] for name, values in signals.items()})
        robot.wait_until_s(start + (row + 1) * TICK)
        readings.append(robot.read())
    return {name: np.stack([reading[name] for reading in readings]) for name in readings[0]}


def same(one, other):
    return all(np.array_equal(one[name], other[name]) for name in ("position", "velocity", "torque"))


def test_it_is_a_robot_and_its_clock():
    robot = VirtualRobot()
    assert isinstance(robot, RobotIO)
    assert isinstance(robot, Clock)
    assert robot.joints == tuple(f"joint{number}" for number in range(1, 8))
    assert set(robot.read()) == {"position", "velocity", "torque"}


@pytest.mark.parametrize("with_velocity", [False, True])
def test_both_faces_make_the_same_motion_bit_for_bit(with_velocity):
    position, velocity = wave()
    command = {"position": position, "velocity": velocity} if with_velocity else {"position": position}
    faults = (Fault("drop", at_s=0.1, duration_s=0.2, share=0.5), Fault("stall", 0.4, 0.05, joint="joint4"))
    whole = VirtualRobot(seed=3, payload_kg=1.0, faults=faults).execute(command).measured
    single = written(VirtualRobot(seed=3, payload_kg=1.0, faults=faults), command)
    assert same(whole, single)
    parted = VirtualRobot(seed=3, payload_kg=1.0, faults=faults)
    pieces = [
        parted.execute({name: v[rows] for name, v in command.items()}).measured
        for rows in (slice(0, 217), slice(217, None))
    ]
    for name in single:
        np.testing.assert_array_equal(np.concatenate([pieces[0][name], pieces[1][name][1:]]), single[name])


def test_held_commands_and_every_so_many_samples():
    position, _ = wave(200)
    held = np.repeat(position[::10], 10, axis=0)
    whole = VirtualRobot().execute({"position": held}, every=10).measured
    robot, readings = VirtualRobot(), []
    for row in range(20):
        readings.append(robot.read()["position"])
        robot.write({"position": position[10 * row]})
        robot.wait_until_s((row + 1) * 0.01)
    np.testing.assert_array_equal(whole["position"][:-1], readings)
    np.testing.assert_allclose(whole.time_s, np.arange(21) * 0.01)


def test_seed_and_unit_decide_everything():
    command = {"position": wave(200)[0]}
    first = VirtualRobot(draw_truth(unit=1), seed=1).execute(command).measured
    assert same(first, VirtualRobot(draw_truth(unit=1), seed=1).execute(command).measured)
    assert not same(first, VirtualRobot(draw_truth(unit=1), seed=2).execute(command).measured)
    truths = [VirtualRobot(draw_truth(unit=unit), seed=1).execute(command).truth for unit in (1, 2)]
    assert not np.allclose(truths[0]["torque"], truths[1]["torque"], atol=0.05)


def test_units_differ_and_switching_an_effect_off_leaves_the_others_as_they_are():
    one, again, other = draw_truth(unit=1), draw_truth(unit=1), draw_truth(unit=2)
    assert one == again
    assert one.joints != other.joints
    assert one.bodies != other.bodies
    without = draw_truth(LabSpec().without("ripple", "inertia"), unit=1)
    for name, joint in without.joints.items():
        assert joint.ripple_nm == 0
        assert joint.static_nm == one.joints[name].static_nm
        assert joint.stiffness == one.joints[name].stiffness
    assert without.bodies != one.bodies


def test_the_truth_is_a_file_of_its_own(tmp_path):
    truth = draw_truth(LabSpec().without("ripple"), unit=7)
    truth.save(tmp_path / "apart" / "truth.json")
    assert Truth.load(tmp_path / "apart" / "truth.json") == truth
    (tmp_path / "old.json").write_text((tmp_path / "apart" / "truth.json").read_text().replace("truth/1", "truth/0"))
    with pytest.raises(ConfigError, match="another release"):
        Truth.load(tmp_path / "old.json")


def test_sizes_come_from_yaml(tmp_path):
    path = tmp_path / "lab.yaml"
    path.write_text("delay: {delay_s: 0.01}\nripple: {enabled: false}\nfriction: {breakaway_positive: [0.5]}\n")
    spec = load_lab(path)
    assert spec.delay.delay_s == 0.01
    assert not spec.ripple.enabled
    assert spec.friction.breakaway_positive == (0.5,)
    path.write_text("dealy: {}\n")
    with pytest.raises(ConfigError, match="dealy"):
        load_lab(path)


@pytest.mark.parametrize("delay_s", [0.0, 0.004, 0.0125])
def test_delay_is_causal_and_as_long_as_it_says(delay_s):
    spec = dataclasses.replace(LabSpec().only("delay"), delay=Delay(delay_s=delay_s, jitter_s=0.0))
    calm = np.tile(HOME, (100, 1))
    other = calm.copy()
    other[50:] += 0.05
    motions = [VirtualRobot(draw_truth(spec)).execute({"position": c}).truth["position"] for c in (calm, other)]
    changed = np.abs(motions[0] - motions[1]).max(axis=1) > 0
    # The command of row 50 is written at 50 ms and works in the control step that begins when it has arrived.
    assert np.argmax(changed) == 51 + np.ceil(delay_s / TICK - 1e-9)


def test_jitter_delays_between_its_bounds_and_keeps_the_order():
    spec = dataclasses.replace(
        LabSpec().only("delay"), delay=Delay(delay_s=0.002, jitter_s=0.006), controller=Controller(kind="torque")
    )
    pushes = np.zeros((400, 7))
    pushes[:, 6] = 0.01 * np.arange(400)
    drive = VirtualRobot(draw_truth(spec), position=HOME).execute({"torque": pushes}).truth["motor_torque"][1:, 6]
    weight = drive[0]
    age = np.arange(400) - np.round((drive - weight) / 0.01)
    assert set(np.unique(age[20:-1])) <= set(range(2, 9))
    assert len(np.unique(age[20:])) > 2
    assert (np.diff(drive) >= -0.005).all()


def test_a_stop_closes_the_brakes_ends_the_trajectory_and_is_recovered_from():
    position, _ = wave()
    robot = VirtualRobot(faults=[Fault("stop", at_s=0.2)])
    done = robot.execute({"position": position})
    assert done.stopped_s == pytest.approx(0.2)
    assert len(done.measured) == 201
    assert robot.stopped
    for command in (lambda: robot.write({"position": HOME}), lambda: robot.execute({"position": position})):
        with pytest.raises(RobotStopped, match="has stopped"):
            command()
    robot.wait_until_s(2.0)  # the arm swings on its springs for a while
    resting = robot.read()
    assert np.abs(resting["velocity"]).max() < 0.02
    robot.wait_until_s(2.2)
    np.testing.assert_allclose(robot.read()["position"], resting["position"], atol=1e-3)
    robot.recover()
    robot.wait_until_s(2.6)
    np.testing.assert_allclose(robot.read()["position"], resting["position"], atol=5e-3)
    robot.write({"position": robot.read()["position"]})
    robot.stop()
    assert robot.stopped


@pytest.mark.parametrize("elastic", [True, False])
def test_a_stalled_joint_stands_still_while_the_others_move(elastic):
    spec = LabSpec() if elastic else LabSpec().without("elasticity")
    position = np.concatenate([wave(2000, size=0.2)[0], np.tile(HOME, (2000, 1))])
    robot = VirtualRobot(draw_truth(spec), faults=[Fault("stall", at_s=0.0, duration_s=1.5, joint="joint1")])
    seen = robot.execute({"position": position}).truth["position"]
    assert np.abs(seen[:1500, 0] - seen[0, 0]).max() < 0.02
    assert np.abs(seen[:1500, 1] - seen[0, 1]).max() > 0.1
    assert np.abs(seen[-1] - position[-1]).max() < 0.02


def test_a_lost_reading_is_the_one_before_it():
    position, _ = wave(300)
    faults = [Fault("drop", at_s=0.1, duration_s=0.1, share=1.0)]
    whole, lossy = (
        VirtualRobot().execute({"position": position}),
        VirtualRobot(faults=faults).execute({"position": position}),
    )
    np.testing.assert_array_equal(whole.truth["position"], lossy.truth["position"])
    np.testing.assert_array_equal(lossy.measured["position"][:100], whole.measured["position"][:100])
    assert (lossy.measured["position"][100:200] == whole.measured["position"][99]).all()
    np.testing.assert_array_equal(lossy.measured["position"][200:], whole.measured["position"][200:])


def test_real_time_takes_as_long_as_it_says():
    robot = VirtualRobot(real_time=True)
    started = time.monotonic()
    robot.wait_until_s(robot.now_s() + 0.05)
    robot.wait_until_s(0.12)
    assert time.monotonic() - started >= 0.1


def test_time_passes_in_whole_control_steps_and_never_back():
    robot = VirtualRobot()
    robot.wait_until_s(0.0051)
    assert robot.now_s() == pytest.approx(0.006)
    robot.wait_until_s(0.001)
    assert robot.now_s() == pytest.approx(0.006)


def test_another_payload_keeps_pose_clock_and_warmth():
    robot = VirtualRobot()
    robot.execute({"position": wave(500)[0]})
    pose, now = robot.read()["position"], robot.now_s()
    before = robot.read()["torque"]
    robot.load(3.0)
    assert robot.now_s() == now
    np.testing.assert_allclose(robot.read()["position"], pose, atol=1e-3)
    assert np.abs(robot.read()["torque"] - before).max() > 5.0
    with pytest.raises(ConfigError, match="payload is out of range"):
        robot.load(3.1)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: LabSpec().only("magnetism"), "no effect 'magnetism'"),
        (lambda: draw_truth(unit=-1), "negative"),
        (lambda: LabSpec(delay=Delay(delay_s=-0.001)), "delay.delay_s"),
        (lambda: LabSpec(friction=Friction(spread=1e5)), "friction.spread is a relative spread"),
        (lambda: LabSpec(friction=Friction(presliding_rad=1e-300)), "presliding_rad is no size of a robot's"),
        (lambda: LabSpec(friction=Friction(sliding=1e308)), "sliding is no size of a robot's"),
        (lambda: LabSpec(physics_step_s=0.0007), "whole number"),
        (lambda: LabSpec(friction=Friction(presliding_rad=0.0)), "presliding_rad must be positive"),
        (lambda: draw_truth(LabSpec(friction=Friction(viscous=(1.0, 2.0)))), "one number, or one per joint"),
        (lambda: VirtualRobot(draw_truth(LabSpec(elasticity=Elasticity(stiffness=(1e6,))))), "too stiff"),
        (lambda: VirtualRobot(faults=[Fault("stall", 0.0, joint="elbow")]), "'elbow'"),
        (lambda: Fault("stall", 0.0), "needs a joint"),
        (lambda: Fault("drop", -1.0), "at_s >= 0"),
    ],
)
def test_what_makes_no_robot_is_refused(make, message):
    with pytest.raises(ConfigError, match=message):
        make()


def test_bad_commands_are_refused_and_change_nothing():
    robot = VirtualRobot()
    with pytest.raises(MissingSignal, match="torque"):
        robot.write({"torque": np.zeros(7)})
    with pytest.raises(DataError, match="finite"):
        robot.write({"position": np.full(7, np.nan)})
    with pytest.raises(DataError, match="one finite value"):
        robot.write({"position": HOME[:3]})
    with pytest.raises(MissingSignal, match="needs 'position'"):
        robot.execute({"velocity": np.zeros((5, 7))})
    with pytest.raises(DataError, match="every"):
        robot.execute({"position": np.tile(HOME, (5, 1))}, every=0)
    with pytest.raises(DataError, match="pose"):
        robot.place(np.full(7, np.nan))
    assert robot.now_s() == 0.0
    calm = VirtualRobot()
    for own in (robot, calm):
        own.wait_until_s(0.1)
    assert same(robot.read(), calm.read())


def test_every_effect_has_a_switch():
    spec = LabSpec().only()
    assert not any(getattr(spec, name).enabled for name in EFFECTS)
    assert all(getattr(LabSpec(), name).enabled for name in EFFECTS)


def test_another_arm_needs_one_number_for_all_its_joints():
    spec = LabSpec(
        robot="demo_arm",
        friction=Friction(
            breakaway_positive=(0.1,),
            breakaway_negative=(0.12,),
            viscous=(0.05,),
            sigmoid_level=(0.05,),
            sigmoid_slope=(9.0,),
            sigmoid_shift=(0.0,),
            motor=(0.01,),
        ),
        gravity=Gravity(offset_nm=(0.02,)),
        elasticity=Elasticity(stiffness=(500.0,), damping=(0.1,)),
        ripple=Ripple(amplitude_nm=(0.02,)),
        saturation=Saturation(torque_nm=(20.0,)),
        warming=Warming(copper_w_per_nm2=(0.1,)),
        controller=Controller(stiffness=(100.0,), damping=(3.0,)),
    )
    robot = VirtualRobot(draw_truth(spec))
    pose = robot.read()["position"]
    target = pose + 0.1 * (1 - np.cos(np.pi * np.minimum(np.arange(1500), 1000) / 1000))[:, None]
    done = robot.execute({"position": target})
    np.testing.assert_allclose(done.truth["position"][-1], target[-1], atol=0.02)
    with pytest.raises(ConfigError, match="one per joint of 'demo_arm'"):
        draw_truth(LabSpec(robot="demo_arm"))
