"""A virtual robot driven by servos: without effects it is the simulator, with them it is not; closed chains stay closed."""

from dataclasses import replace

import numpy as np
import pytest

from trueup.core.protocols import RolloutRequest
from trueup.errors import ConfigError, MissingSignal
from trueup.lab import LabSpec, VirtualRobot, draw_truth, load_lab
from trueup.lab.simulated_robot import Sensors
from trueup.lab.spec import Controller, Friction, Readings, Saturation, Warming, Winding
from trueup.robots import find_model, load_robot
from trueup.sim import MujocoSimulator

SERVO = Controller(kind="servo", stiffness=(55.2,), damping=(0.0,))
ONE = dict.fromkeys(("breakaway_positive", "breakaway_negative", "viscous", "motor", "sigmoid_level"), (0.05,))


def lab(robot, *effects, **changes):
    spec = LabSpec(
        robot=robot,
        controller=SERVO,
        friction=Friction(**ONE, sigmoid_slope=(5.0,), sigmoid_shift=(0.0,)),
        saturation=Saturation(torque_nm=(4.1,)),
        warming=Warming(copper_w_per_nm2=(0.1,)),
        payload_limit_kg=0.0,
        **changes,
    )
    return spec.only(*effects)


def wave(steps, joints=12, size=0.15):
    time_s = np.arange(steps) * 1e-3
    rise = np.minimum(1, time_s / 0.5)[:, None]
    return size * rise * np.sin(2 * np.pi * 0.7 * time_s[:, None] + np.arange(joints))


@pytest.mark.parametrize("name", ["kickbot_a", "kickbot_b"])
def test_without_effects_it_is_the_simulator(name):
    """The same servo in two engines: the lab's own loop, and MuJoCo's actuators."""
    command = wave(1500)
    robot = VirtualRobot(draw_truth(lab(name)))
    found = robot.execute({"position": command}).measured
    assert set(found.signals) == {"position", "velocity", "current", "voltage"}
    description = load_robot(name)
    simulator = MujocoSimulator.from_robot(description, find_model(description))
    for joint in description.joint_names:  # the lab has friction of its own
        dof = simulator.model.joint(joint).dofadr[0]
        simulator.model.dof_frictionloss[dof] = simulator.model.dof_damping[dof] = 0.0
    zero = np.zeros((1, 12))
    expected = simulator.rollout(RolloutRequest(zero, zero, {"position": command[None]}))
    np.testing.assert_allclose(found["position"], expected.position[0], atol=4e-3)
    np.testing.assert_allclose(found["current"][100:], expected.further["current"][0][99:-1], atol=0.08)


def test_it_stalls_at_its_voltage():
    robot = VirtualRobot(draw_truth(lab("kickbot_a")))
    measured = robot.execute({"position": wave(400, size=2.0)}).measured
    assert np.abs(measured["voltage"]).max() == pytest.approx(12.0)
    assert np.abs(measured["current"]).max() < 2 * 12.0 / 5.217


def test_motors_differ_from_unit_to_unit_and_joint_to_joint():
    one, other = (draw_truth(lab("kickbot_a", "winding"), unit=unit).joints for unit in (1, 2))
    for name in ("resistance_ohm", "torque_constant_nm_a", "back_emf_v_s_rad"):
        values = np.array([[getattr(joint, name) for joint in unit.values()] for unit in (one, other)])
        assert np.unique(values).size == values.size
        assert 0.02 < np.log(values).std() < 0.2
    assert len({joint.voltage_limit for joint in one.values()}) == 1
    plain = draw_truth(lab("kickbot_a")).joints["left_knee"]
    assert (plain.resistance_ohm, plain.voltage_limit) == (5.217, 12.0)


def test_other_effects_are_drawn_as_before():
    """Motors have draws of their own."""
    spec = lab("kickbot_a", "inertia", "friction", "winding")
    for unit in (1, 5):
        one, other = draw_truth(spec, unit=unit), draw_truth(spec.without("winding"), unit=unit)
        assert one.bodies == other.bodies
        for name, joint in one.joints.items():
            assert joint.static_nm == other.joints[name].static_nm


def test_sensors_of_servos():
    readings = Readings(sensors=Sensors(position_step_rad=2 * np.pi / 4096, current_step_a=0.00269, voltage_step_v=0.1))
    robot = VirtualRobot(draw_truth(lab("kickbot_a", "readings", readings=readings)))
    done = robot.execute({"position": wave(300)})
    for signal, step in (("position", 2 * np.pi / 4096), ("current", 0.00269), ("voltage", 0.1)):
        steps = done.measured[signal] / step
        np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
        assert np.abs(done.measured[signal] - done.truth[signal]).max() <= step / 2 + 1e-9


def test_closed_chains_stay_closed_while_it_squats():
    robot = VirtualRobot(draw_truth(lab("dancebot", "friction", "winding")))
    depth = 0.2 * (1 - np.cos(2 * np.pi * 0.5 * np.arange(2000) * 1e-3))[:, None]
    command = np.zeros((2000, 12))
    for number, joint in enumerate(robot.joints):
        command[:, number] = depth[:, 0] * {"hip_pitch": -1, "knee_crank": 1}.get(joint.partition("_")[2], 0)
    done = robot.execute({"position": command})
    data = robot._plant.data
    assert np.abs(data.efc_pos[: data.ne]).max() < 2e-3
    assert np.abs(done.truth["position"] - command[[0, *range(2000)]]).max() < 0.12
    with pytest.raises(ConfigError, match="opens a closed chain"):
        VirtualRobot(draw_truth(lab("dancebot")), position=np.full(12, 0.3))


def test_what_makes_no_servo_is_refused():
    with pytest.raises(ConfigError, match="needs the motor"):
        draw_truth(replace(lab("kickbot_a"), robot="panda"))
    robot = VirtualRobot(draw_truth(lab("kickbot_a")))
    with pytest.raises(MissingSignal, match="velocity"):
        robot.write({"position": np.zeros(12), "velocity": np.zeros(12)})
    with pytest.raises(ConfigError, match="winding"):
        lab("kickbot_a", winding=Winding(resistance=-1.0))


def test_a_shipped_lab_serves_any_robot_with_servos():
    for name in ("kickbot_a", "dancebot"):
        spec = load_lab("xm430", robot=name)
        assert (spec.robot, spec.controller.kind) == (name, "servo")
        robot = VirtualRobot(draw_truth(spec, unit=1))
        done = robot.execute({"position": np.zeros((200, 12))}, every=4)
        assert set(done.measured.signals) == {"position", "velocity", "current", "voltage"}
        assert np.abs(np.degrees(done.measured["position"])).max() < 5  # it stands
    with pytest.raises(ConfigError, match=r"no lab 'xm540'.*available: upper_body, xm430"):
        load_lab("xm540")


def test_a_file_that_names_its_robot_is_of_that_one(tmp_path):
    (tmp_path / "own.yaml").write_text("robot: dancebot\n")
    assert load_lab(tmp_path / "own.yaml", robot="kickbot_a").robot == "dancebot"
