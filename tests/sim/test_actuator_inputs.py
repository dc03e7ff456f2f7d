"""Commands reach a model's own actuators so that the joint does what it is told, or they are refused."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.protocols import RolloutRequest
from trueup.core.timeseries import TimeSeries, same_units
from trueup.dataset import Dataset
from trueup.errors import ConfigError
from trueup.identify import IdentifyConfig, Nominal, Problem, identify
from trueup.identify.config import SolverChoice, make_parameters
from trueup.identify.export import fitted_robot, robot_yaml, save_model
from trueup.identify.start import _with_torques
from trueup.robots import ControllerSpec, JointSpec, RobotSpec, find_model, load_robot
from trueup.sim import DartSimulator, MujocoSimulator, make_simulator
from trueup.stages import import_logs, replay

LINK = """
<mujoco>
  <extension><plugin plugin="mujoco.pid"/></extension>
  <option timestep="0.002" integrator="implicitfast" gravity="0 0 0"/>
  <worldbody><body name="l"><joint name="j" axis="0 1 0" armature="0.01" damping="0.1" {joint}/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5"/></body></worldbody>
  <actuator>{actuator}</actuator>
</mujoco>
"""

# What follows a position: how many of its inputs make a radian.
POSITION = {
    '<position name="s" joint="j" kp="5" kv="0.5"/>': 1,
    '<position name="s" joint="j" kp="0.5" kv="0.02" gear="10"/>': 10,
    '<position name="s" joint="j" kp="0.5" kv="0.02" gear="-10"/>': -10,
    '<position name="s" joint="j" kp="5" dampratio="1" gear="2"/>': 2,
    '<position name="s" joint="j" kp="5" kv="0.5" timeconst="0.05" gear="2"/>': 2,
    '<position name="s" jointinparent="j" kp="5" kv="0.5" gear="2"/>': 2,
    '<general name="s" joint="j" gainprm="2" biastype="affine" biasprm="0 -10 -1"/>': 5,
    '<general name="s" joint="j" gainprm="-2" biastype="affine" biasprm="0 -10 -1" gear="3"/>': -15,
    '<plugin name="s" joint="j" plugin="mujoco.pid" gear="3"><config key="kp" value="5"/><config key="kd" value="1"/>'
    "</plugin>": 3,
    '<pid name="s" joint="j" kp="5" kv="0.2" gear="3"/>': 3,
    '<pid name="s" joint="j" kp="5" kv="0.2" input="pos" gear="3"/>': 3,
    '<dcmotor name="s" joint="j" input="pos" motorconst=".5 .5" resistance="2" controller="100 0 5" gear="3"/>': 3,
    '<position joint="j" kp="5" kv="0.5" gear="2"/>': 2,  # without a name
}
VELOCITY = {
    '<velocity name="s" joint="j" kv="2"/>': 1,
    '<velocity name="s" joint="j" kv="1" gear="10"/>': 10,
    '<general name="s" joint="j" gainprm="10" biastype="affine" biasprm="0 0 -2" gear="10"/>': 2,
    '<intvelocity name="s" joint="j" kp="20" kv="1" gear="10" actrange="-100 100"/>': 10,
    '<pid name="s" joint="j" kp="0" kv="2" input="vel" gear="3"/>': 3,
}
TORQUE = {
    '<motor name="s" joint="j"/>': 1.0,
    '<motor name="s" joint="j" gear="10"/>': 10.0,
    '<general name="s" joint="j" gainprm="3" gear="2"/>': 6.0,
    '<general name="s" joint="j" gainprm="1" biastype="affine" biasprm="0 0 -0.05"/>': 1.0,
    '<general name="s" joint="j" gainprm="1" biastype="affine" biasprm="0 -3 0"/>': 1.0,
    '<motor joint="j"/>': 1.0,
}
OTHERS = {
    '<muscle name="s" joint="j" lengthrange="-1 1"/>': "muscle",
    '<dcmotor name="s" joint="j" motorconst=".05 .05" resistance="2"/>': "voltage",
    '<damper name="s" joint="j" kv="1" ctrlrange="0 1"/>': "damper",
    '<motor name="s" joint="j" gear="0"/>': "gear is 0",
    '<general name="s" joint="j" gainprm="0" biastype="affine" biasprm="0 -5 -1"/>': "gain is 0",
    '<general name="s" joint="j" dyntype="integrator"/>': "integrates its input",
    '<pid name="s" joint="j" kp="5" kv="1" input="vel"/>': "holds position 0",
    '<pid name="s" joint="j" kp="5" kv="1" input="ff"/>': "neither",
}


def robot_with(folder, actuator, command, *, joint="", **controller):
    path = folder / "link.xml"
    path.write_text(LINK.format(actuator=actuator, joint=joint))
    controller = ControllerSpec(kind="model", command=command, **controller)
    return RobotSpec("link", (JointSpec("j"),), path.name, controller=controller), path


def held(simulator, signal, value, *, steps=3000, start=0.0):
    """Position and velocity at the end of a constant command."""
    request = RolloutRequest(
        np.full((1, 1), start), np.zeros((1, 1)), {signal: np.full((1, steps, 1), value, np.float64)}
    )
    done = simulator.rollout(request)
    return done.position[0, :, 0], done.velocity[0, :, 0], done.torque[0, :, 0]


@pytest.mark.parametrize("actuator", POSITION)
def test_a_joint_goes_where_it_is_told(tmp_path, actuator):
    robot, path = robot_with(tmp_path, actuator, "position")
    simulator = MujocoSimulator.from_robot(robot, path)
    position, _, _ = held(simulator, "position", 0.4)
    assert position[-1] == pytest.approx(0.4, abs=1e-3)
    control = simulator.control_of({"position": np.full((1, 1, 1), 0.4)})
    assert control[0, 0, 0] == pytest.approx(0.4 * POSITION[actuator])
    assert bool(simulator.notes) == (POSITION[actuator] != 1)
    if simulator.notes:
        assert f"times {POSITION[actuator]:g}" in simulator.notes[0]


@pytest.mark.parametrize("actuator", POSITION)
def test_a_joint_that_is_where_it_is_told_to_be_stays_there(tmp_path, actuator):
    if "ki" in actuator:
        pytest.skip("an integral has its own start")
    simulator = MujocoSimulator.from_robot(*robot_with(tmp_path, actuator, "position"))
    position, _, _ = held(simulator, "position", 0.4, steps=50, start=0.4)
    np.testing.assert_allclose(position, 0.4, atol=1e-9)


def test_a_reference_position_is_no_offset_of_the_command(tmp_path):
    actuator = '<position name="s" joint="j" kp="0.5" kv="0.02" gear="10"/>'
    robot, path = robot_with(tmp_path, actuator, "position", joint='ref="20"')
    position, _, _ = held(MujocoSimulator.from_robot(robot, path), "position", 0.4)
    assert position[-1] == pytest.approx(0.4, abs=1e-3)


@pytest.mark.parametrize("actuator", VELOCITY)
def test_a_joint_goes_as_fast_as_it_is_told(tmp_path, actuator):
    robot, path = robot_with(tmp_path, actuator, "velocity")
    simulator = MujocoSimulator.from_robot(robot, path)
    _, velocity, _ = held(simulator, "velocity", 0.4)
    # The joint's own damping stands against a servo without integral.
    assert velocity[-1] == pytest.approx(0.4, rel=0.06)
    control = simulator.control_of({"velocity": np.full((1, 1, 1), 0.4)})
    assert control[0, 0, 0] == pytest.approx(0.4 * VELOCITY[actuator])


@pytest.mark.parametrize("actuator", TORQUE)
def test_a_commanded_torque_is_the_motors_which_is_said_where_that_matters(tmp_path, actuator):
    robot, path = robot_with(tmp_path, actuator, "torque")
    simulator = MujocoSimulator.from_robot(robot, path)
    _, _, torque = held(simulator, "torque", 0.2, steps=1)
    assert torque[0] == pytest.approx(0.2 * TORQUE[actuator])
    assert bool(simulator.notes) == (TORQUE[actuator] != 1.0)
    if simulator.notes:
        assert f"{TORQUE[actuator]:g} times as much" in simulator.notes[0]
        assert "{kind: torque}" in simulator.notes[0]


@pytest.mark.parametrize("actuator", ['<motor name="s" joint="j" gear="10"/>', '<motor name="s" joint="j"/>'])
def test_a_measured_torque_is_the_joints(tmp_path, actuator):
    robot, path = robot_with(tmp_path, actuator, "torque", source="measured")
    _, _, torque = held(MujocoSimulator.from_robot(robot, path), "torque", 0.2, steps=1)
    assert torque[0] == pytest.approx(0.2)
    nominal = Nominal(robot, path)
    parameters = make_parameters({"torque_gain": "all"}, nominal)
    assert parameters["torque_gain[j]"].value == pytest.approx(1.0)
    candidate = Problem(nominal, parameters, ()).candidate({"torque_gain[j]": 1.2})
    save_model(candidate, tmp_path / "model.fitted.xml")
    (tmp_path / "robot.fitted.yaml").write_text(robot_yaml(fitted_robot(candidate)))
    again = MujocoSimulator.from_robot(load_robot(tmp_path / "robot.fitted.yaml"), tmp_path / "model.fitted.xml")
    _, _, torque = held(again, "torque", 0.2, steps=1)
    assert torque[0] == pytest.approx(0.24)


WRONG = [
    *((actuator, signal) for actuator in POSITION if "general" not in actuator for signal in ("velocity", "torque")),
    *((actuator, signal) for actuator in VELOCITY if "general" not in actuator for signal in ("position", "torque")),
    *((actuator, signal) for actuator in TORQUE if "general" not in actuator for signal in ("position", "velocity")),
    *((actuator, signal) for actuator in OTHERS for signal in ("position", "velocity", "torque")),
]


@pytest.mark.parametrize(("actuator", "signal"), WRONG)
def test_what_does_not_follow_a_command_is_refused_with_what_to_write(tmp_path, actuator, signal):
    robot, path = robot_with(tmp_path, actuator, signal)
    with pytest.raises(ConfigError, match=f"is told a {signal}") as caught:
        MujocoSimulator.from_robot(robot, path)
    said = str(caught.value)
    assert "controller: {kind: " + signal in said
    for own, inputs in (("position", POSITION), ("velocity", VELOCITY), ("torque", TORQUE)):
        assert (f"command: {own}" in said) == (actuator in inputs), said
    if actuator in OTHERS:
        assert OTHERS[actuator] in said
    # What it says works.
    gains = {"position": {"kp": 20.0}, "velocity": {"kv": 1.0}, "torque": {}}[signal]
    other = replace(robot, controller=ControllerSpec(kind=signal, **gains))
    assert MujocoSimulator.from_robot(other, path).command_signals == (signal,)


@pytest.mark.parametrize("actuator", [name for name in POSITION if "gear" in name and "position name" in name])
def test_both_engines_take_commands_alike(tmp_path, actuator):
    if "timeconst" in actuator or "jointinparent" in actuator:
        pytest.skip("DART has no filters, and takes joints alone")
    robot, path = robot_with(tmp_path, actuator, "position")
    ours = held(MujocoSimulator.from_robot(robot, path), "position", 0.4, steps=500)[0]
    dart = held(DartSimulator.from_robot(robot, path), "position", 0.4, steps=500)[0]
    np.testing.assert_allclose(dart, ours, atol=1e-6)


def test_both_engines_begin_an_integrated_velocity_alike(tmp_path):
    actuator = '<intvelocity name="s" joint="j" kp="20" kv="1" gear="10" actrange="-100 100"/>'
    robot, path = robot_with(tmp_path, actuator.replace(' actrange="-100 100"', ' actlimited="false"'), "velocity")
    ours = held(MujocoSimulator.from_robot(robot, path), "velocity", 0.0, steps=50, start=0.3)[0]
    dart = held(DartSimulator.from_robot(robot, path), "velocity", 0.0, steps=50, start=0.3)[0]
    np.testing.assert_allclose(ours, 0.3, atol=1e-9)
    np.testing.assert_allclose(dart, 0.3, atol=1e-9)


def logs_of(path, drive, *, joints=("j",), signal, count=3, seconds=4.0):
    """Motions of the model in plain MuJoCo; `drive` makes inputs of commands."""
    model = mujoco.MjModel.from_xml_path(str(path))
    episodes = []
    for number in range(count):
        data, rows = mujoco.MjData(model), []
        for step in range(round(seconds / model.opt.timestep)):
            now = step * model.opt.timestep
            if step % 5 == 0:
                asked = 0.5 * np.sin((2.0 + number) * now) + 0.2 * np.sin((7.3 + number) * now)
            rows.append([now, data.qpos[0], data.qvel[0], asked])
            data.ctrl[0] = drive(asked)
            mujoco.mj_step(model, data)
        table = np.array(rows)[::5]
        measured = {"position": table[:, 1:2], "velocity": table[:, 2:3]}
        units = {"position": "rad", "velocity": "rad/s", "torque": "Nm"}
        episodes.append(
            Episode(
                meta=EpisodeMeta(id=f"m{number}", robot="link"),
                measured=TimeSeries(
                    table[:, 0], joints, measured, same_units({name: units[name] for name in measured}, joints)
                ),
                command=TimeSeries(
                    table[:, 0], joints, {signal: table[:, 3:4]}, same_units({signal: units[signal]}, joints)
                ),
            )
        )
    return episodes


@pytest.mark.long
def test_the_gains_of_a_geared_servo_are_found_from_commands_of_the_joint(tmp_path):
    real = tmp_path / "real.xml"
    real.write_text(LINK.format(actuator='<position name="s" joint="j" kp="0.3" kv="0.02" gear="10"/>', joint=""))
    logs = logs_of(real, lambda asked: 10 * asked, signal="position")
    robot, path = robot_with(tmp_path, '<position name="s" joint="j" kp="0.2" kv="0.02" gear="10"/>', "position")
    config = IdentifyConfig(fit={"kp": "all"}, models={}, solver=SolverChoice(max_iterations=8))
    found = identify({"train": logs[:2], "val": logs[2:]}, robot, path, config=config)
    assert found.result["kp[j]"].nominal == pytest.approx(20.0)
    assert found.result["kp[j]"].value == pytest.approx(30.0, rel=0.02)


def test_the_start_of_a_geared_motor_is_regressed_on_what_reaches_the_joint():
    clock = np.arange(3) / 10.0
    units = same_units({"torque": "Nm"}, ("a", "b"))
    command = TimeSeries(clock, ("a", "b"), {"torque": np.ones((3, 2))}, units)
    episode = Episode(meta=EpisodeMeta(id="m"), measured=command, command=command)
    found = _with_torques(episode, {"a": 10.0, "b": 1.0})
    np.testing.assert_array_equal(found.commanded()["torque"], [[10.0, 1.0]] * 3)
    assert _with_torques(episode, {"a": 1.0}) is episode


def test_the_limit_of_a_geared_motor_is_that_of_its_command(tmp_path):
    robot, path = robot_with(tmp_path, '<motor name="s" joint="j" gear="10" forcerange="-2 2"/>', "torque")
    nominal = Nominal(robot, path)
    assert nominal.simulator.torque_limits == {"j": 20.0}
    assert nominal.commanded_limits == {"j": 2.0}


def test_a_replay_says_what_it_does_with_commands_and_forgets_no_run_for_it(tmp_path):
    robot, path = robot_with(tmp_path, '<motor name="s" joint="j" gear="10"/>', "torque")
    logs = tmp_path / "logs"
    logs.mkdir()
    for episode in logs_of(path, lambda asked: asked, signal="torque", count=2):
        arrays = {"measured.time_s": episode.measured.time_s, "command.time_s": episode.measured.time_s}
        arrays |= {"measured.position": episode.measured["position"], "command.torque": episode.commanded()["torque"]}
        np.savez(logs / f"{episode.id}.npz", joints=np.array(["j"]), **arrays)
    import_logs(logs, tmp_path / "data", format="npz")
    done = replay(Dataset(tmp_path / "data"), robot, model=path, window_s=0.5)
    assert any("10 times as much" in line for line in done.notes)


def test_a_scale_of_commands_is_part_of_what_made_a_run(tmp_path):
    plain, path = robot_with(tmp_path, '<motor name="s" joint="j" gear="10"/>', "torque")
    measured = replace(plain, controller=replace(plain.controller, source="measured"))
    prints = {MujocoSimulator.from_robot(robot, path).fingerprint for robot in (plain, measured)}
    assert len(prints) == 2


@pytest.mark.parametrize(("name", "signal"), [("g", "position"), ("m", "torque")])
def test_the_cases_of_gears(model_cases, name, signal):
    robot = load_robot(model_cases / "gear" / f"{name}.yaml")
    simulator = make_simulator("mujoco", robot, find_model(robot))
    assert any("10" in line for line in simulator.notes)
    if signal == "position":
        assert held(simulator, "position", 0.5)[0][-1] == pytest.approx(0.5, abs=0.03)


def test_the_case_of_a_dc_motor_that_is_told_positions(model_cases):
    robot = load_robot(model_cases / "dcm.yaml")
    with pytest.raises(ConfigError, match="a DC motor"):
        make_simulator("mujoco", robot, Path(find_model(robot)))
