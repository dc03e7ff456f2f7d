"""A humanoid on a floating base, of which only an arm is logged: refused, or held, and the same robot for every command.

The truth is plain MuJoCo with the arm alone on a fixed base.
"""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from conftest import shared_folder
from trueup.cli.main import main
from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.protocols import RolloutRequest
from trueup.core.timeseries import TimeSeries, same_units
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter
from trueup.errors import ConfigError
from trueup.identify import IdentifyConfig, Nominal
from trueup.identify.config import SolverChoice
from trueup.robots import load_robot
from trueup.robots.model import load_spec
from trueup.sim import MujocoSimulator, make_simulator
from trueup.sim.perturbation import Perturbation, perturbed
from trueup.sim.transitions import Transitions
from trueup.stages import gap, replay
from trueup.stages.identifying import FITTED, fit

JOINTS = ("shoulder", "elbow")
CONTROL_S = 0.01
BODY = """<mujoco model="humanoid"><compiler angle="radian"/>
<option integrator="implicitfast"><flag contact="disable"/></option>
<worldbody><body name="pelvis" pos="0 0 1" euler="0.1 0 0">{free}<geom type="box" size=".1 .1 .1" mass="8"/>
  <body name="leg" pos="0 .1 -.1">{leg}<geom type="capsule" fromto="0 0 0 0 0 -.4" size=".04" mass="4"/></body>
  <body name="torso" pos="0 0 .2" {turned}>{waist}<geom type="capsule" fromto="0 0 0 0 0 .3" size=".1" mass="9"/>
    <body name="upper" pos="0 .2 .3"><joint name="shoulder" axis="0 1 0" damping="{damping}"/>
      <geom type="capsule" fromto="0 0 0 .3 0 0" size=".03" mass="1.5"/>
      <body name="lower" pos=".3 0 0"><joint name="elbow" axis="0 1 0" damping="{damping}"/>
        <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass=".8"/>
        <body name="finger" pos=".3 {slid} 0">{finger}<geom size=".02" mass=".1"/></body>
        <site name="hand" pos=".3 0 0"/></body></body></body></body>{cube}</worldbody>
{rest}</mujoco>"""
FLOATING = BODY.format(
    free='<freejoint name="root"/>',
    leg='<joint name="hip" axis="0 1 0"/>',
    waist='<joint name="waist" axis="0 0 1"/>',
    finger='<joint name="finger" type="slide" axis="0 1 0"/>',
    cube='<body name="cube" pos="1 0 1"><freejoint/><geom type="box" size=".1 .1 .1" mass="1"/></body>',
    turned="",
    slid="0",
    damping="0.3",
    rest="""<actuator><position name="hip" joint="hip" kp="50"/><position name="waist" joint="waist" kp="50"/></actuator>
      <sensor><jointpos joint="hip"/><framepos objtype="body" objname="pelvis"/></sensor>
      <keyframe><key name="home" qpos="0 0 .9 1 0 0 0  .2 .4 .5 .6 .03  1 0 1 1 0 0 0" ctrl=".2 .4"/></keyframe>""",
)
# The same by hand: what does not move in it, where the keyframe has it, and the pelvis where the model has it.
TRUTH = BODY.format(
    free="", leg="", waist="", finger="", cube="", turned='euler="0 0 0.4"', slid="0.03", damping="{damping}", rest=""
)
YAML = """schema: trueup.robot/1
name: humanoid
model: floating.xml
joints:
  - {{name: shoulder, torque_limit: 40, position_limits: [-2, 2]}}
  - {{name: elbow, torque_limit: 40, position_limits: [-2, 2]}}
controller: {{kind: position, kp: 60, kv: 2}}
simulation: {{timestep_s: 0.002}}
{more}
"""


def truth(damping):
    """The arm alone, with the same servos."""
    spec = mujoco.MjSpec.from_string(TRUTH.replace("{damping}", str(damping)))
    for name in JOINTS:
        actuator = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        actuator.gainprm[0], actuator.biastype = 60.0, mujoco.mjtBias.mjBIAS_AFFINE
        actuator.biasprm[:3] = [0.0, -60.0, -2.0]
        actuator.forcelimited, actuator.forcerange = mujoco.mjtLimited.mjLIMITED_TRUE, [-40.0, 40.0]
    spec.option.timestep = 0.002
    return spec.compile()


def motion(model, seed, seconds=3.0):
    """Stamps, commands, positions and velocities of a motion, from rest in its first command."""
    rng, time_s = np.random.default_rng(seed), np.arange(0.0, seconds, CONTROL_S)
    waves = np.sin(2 * np.pi * rng.uniform(0.3, 1.5, 2) * time_s[:, None] + rng.uniform(0, 6, 2))
    command = 0.6 * np.minimum(time_s, 1.0)[:, None] * waves
    data, states = mujoco.MjData(model), []
    data.qpos[:] = command[0]
    for row in command:
        states.append(np.concatenate([data.qpos, data.qvel]))
        data.ctrl[:] = row
        mujoco.mj_step(model, data, round(CONTROL_S / 0.002))
    position, velocity = np.split(np.array(states), 2, axis=1)
    return time_s, command, position, velocity


def stored(folder, model):
    with DatasetWriter.create(folder, DatasetInfo(robot="humanoid")) as writer:
        for seed, split in enumerate(("train", "train", "val", "test")):
            time_s, command, position, velocity = motion(model, seed)
            units = same_units({"position": "rad", "velocity": "rad/s"}, JOINTS)
            measured = TimeSeries(time_s, JOINTS, {"position": position, "velocity": velocity}, units)
            asked = TimeSeries(time_s, JOINTS, {"position": command}, same_units({"position": "rad"}, JOINTS))
            writer.append(Episode(EpisodeMeta(f"m{seed}", split=split), measured, asked))
    return Dataset(folder)


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "floating.xml").write_text(FLOATING)
    for name, more in (("floating", ""), ("held", "base: held"), ("free", "base: held\nunlisted: free")):
        (tmp_path / f"{name}.yaml").write_text(YAML.format(more=more))
    stored(tmp_path / "data", truth(0.3))
    return tmp_path


def run(capsys, *arguments):
    """Exit code of a command, and what it says beside its results."""
    with pytest.raises(SystemExit) as left:
        main([str(argument) for argument in arguments])
    return left.value.code, " ".join(capsys.readouterr().err.split())


def test_a_floating_base_is_refused_before_anything_is_simulated(folder, capsys):
    robot = folder / "floating.yaml"
    for command, *more in (["replay"], ["identify", "--out", folder / "fit"], ["close", "--out", folder / "close"]):
        code, said = run(capsys, command, folder / "data", "--robot", robot, *more)
        assert code == 2
        assert "floats" in said
        assert "`base: held`" in said
    assert Dataset(folder / "data").runs == ()


def test_a_held_robot_is_the_one_made_by_hand_and_what_is_held_is_said(folder, capsys):
    data = Dataset(folder / "data")
    code, said = run(capsys, "replay", data.path, "--robot", folder / "held.yaml")
    assert code == 0
    assert "the base floats in the model and is held where the model has it: 'pelvis'" in said
    assert "bodies with a free joint that carry no joint of the robot are held at keyframe 'home': cube" in said
    assert (
        "3 joints of the model that robot.yaml does not name are locked at keyframe 'home': hip, waist, finger" in said
    )
    data.reload()
    assert len(data.run_info("mujoco/stock")["notes"]) == 3
    for name in data.ids:
        episode = data.episode(name, runs=["mujoco/stock"])
        simulated = episode.simulated["mujoco/stock"]
        assert np.abs(simulated["position"] - episode.measured["position"]).max() < 1e-9
    warnings = gap(data).gap.settings["warnings"]
    assert [line for line in warnings if "pelvis" in line and "(mujoco/stock)" in line]
    assert "The base floats in the model" in run(capsys, "gap", data.path)[1]


def test_what_compensates_simulates_the_robot_that_replay_does(folder):
    pytest.importorskip("torch")
    from trueup.compensate.plants import Plants
    from trueup.stages import prepare

    robot, data = load_robot(folder / "held.yaml"), Dataset(folder / "data")
    replay(data, robot)
    plants = Plants(robot, folder / "floating.xml", CONTROL_S)
    simulator = plants(0.0).simulator
    assert data.run_info("mujoco/stock")["inputs"]["model_sha256"] == simulator.fingerprint
    prepared = prepare(data, robot, jobs=1)
    assert any("pelvis" in note for note in prepared.notes)
    for name in ("m0", "m2"):
        episode = data.episode(name, runs=["mujoco/stock"])
        state = np.concatenate([episode.measured["position"][:1], np.zeros((1, 2))], axis=1)
        command = episode.command["position"]
        states = [state]
        for row in command[:-1]:
            states.append(plants(0.0).next(states[-1], row[None], row[None]))
        whole = np.concatenate(states)[:, :2]
        assert np.abs(whole - episode.simulated["mujoco/stock"]["position"]).max() < 1e-12


def test_joints_that_swing_are_said_and_not_compensated(folder):
    robot, data = load_robot(folder / "free.yaml"), Dataset(folder / "data")
    done = replay(data, robot)
    assert any("free to swing" in note and "hip, waist, finger, the free joint of cube" in note for note in done.notes)
    simulator = MujocoSimulator.from_robot(robot, folder / "floating.xml")
    assert simulator.model.nv == 2 + 3 + 6
    with pytest.raises(ConfigError, match=r"depends on others.*hip"):
        Transitions(simulator, CONTROL_S)


@pytest.mark.long
def test_a_fit_keeps_the_whole_model_and_its_own_simulation(folder):
    data = stored(folder / "other", truth(0.9))
    robot = load_robot(folder / "held.yaml")
    config = IdentifyConfig(fit={"damping": "all"}, models={}, solver=SolverChoice(max_iterations=8, tolerance=1e-2))
    found = fit(data, robot, folder / "fit", model=folder / "floating.xml", config=config, jobs=1)
    for joint in JOINTS:
        assert found.fit.values[f"damping[{joint}]"] == pytest.approx(0.9, rel=0.02)
    # For others, the model floats and has its keyframe, sensors and joints as before.
    whole, before = (
        mujoco.MjModel.from_xml_path(str(path))
        for path in (folder / "fit" / "model.fitted.xml", folder / "floating.xml")
    )
    assert [whole.joint(row).name for row in range(whole.njnt)] == [
        before.joint(row).name for row in range(before.njnt)
    ]
    assert whole.nsensor == before.nsensor
    assert np.allclose(whole.key("home").qpos, before.key("home").qpos)
    # The fitted robot holds it once more, and moves as the fit has simulated it.
    fitted = load_robot(folder / "fit" / "robot.fitted.yaml")
    assert fitted.base == robot.base
    simulator = MujocoSimulator.from_robot(fitted, folder / "fit" / "model.fitted.xml")
    assert simulator.model.nv == 2
    candidate = Nominal(robot, folder / "floating.xml").candidate()
    for joint in JOINTS:
        candidate.spec.joint(joint).damping[0] = found.fit.values[f"damping[{joint}]"]
    own = MujocoSimulator(candidate.compile(), candidate.nominal.robot, candidate.nominal.simulator.channels)
    command = np.random.default_rng(0).uniform(-0.5, 0.5, (1, 200, 2))
    request = RolloutRequest(command[:, 0], np.zeros((1, 2)), {"position": command})
    assert np.abs(simulator.rollout(request).position - own.rollout(request).position).max() < 1e-5
    assert found.fit.errors["fitted"]["test"].value < 1e-3
    data.reload()
    assert data.run_info(FITTED)["notes"] == data.run_info("mujoco/stock")["notes"]
    assert any("pelvis" in note for note in found.notes)


def test_another_engine_a_plan_and_a_perturbed_robot_hold_the_same(folder):
    from trueup.record.scene import Scene

    robot, path = load_robot(folder / "held.yaml"), folder / "floating.xml"
    simulator = MujocoSimulator.from_robot(robot, path)
    command = np.random.default_rng(1).uniform(-0.5, 0.5, (1, 100, 2))
    request = RolloutRequest(command[:, 0], np.zeros((1, 2)), {"position": command})
    moved = simulator.rollout(request).position
    other, spec = perturbed(robot, path, Perturbation(mass=0.2), seed=1)
    assert MujocoSimulator.from_spec(spec, other, origin=path).model.nv == 2
    pose = np.array([0.3, -0.4])
    scene = Scene(robot, model=path, velocity=dict.fromkeys(JOINTS, 1.0), acceleration=dict.fromkeys(JOINTS, 1.0))
    data = mujoco.MjData(simulator.model)
    data.qpos[:] = pose
    mujoco.mj_kinematics(simulator.model, data)
    assert scene.pose(pose)[0] == pytest.approx(data.site("hand").xpos, abs=1e-12)
    pytest.importorskip("dartpy")
    assert np.abs(make_simulator("dart", robot, path).rollout(request).position - moved).max() < 1e-6


def test_a_virtual_robot_is_held_as_its_simulation_is(folder):
    from trueup.lab import LabSpec, VirtualRobot, draw_truth
    from trueup.lab.spec import Controller, Saturation

    one = {"controller": Controller(stiffness=(60.0,), damping=(2.0,)), "saturation": Saturation(torque_nm=(40.0,))}
    warming = replace(LabSpec().warming, copper_w_per_nm2=(0.01,))
    spec = replace(LabSpec().only("inertia"), robot=str(folder / "held.yaml"), warming=warming, **one)
    own = draw_truth(spec, unit=1)
    assert tuple(own.bodies) == ("upper", "lower", "finger")
    model, _ = VirtualRobot(own).engine
    assert [model.joint(row).name for row in range(model.njnt)] == list(JOINTS)
    assert model.body("pelvis").pos == pytest.approx([0.0, 0.0, 1.0])
    with pytest.raises(ConfigError, match="floats"):
        draw_truth(replace(spec, robot=str(folder / "floating.yaml")), unit=1)


@pytest.mark.parametrize(
    ("model", "joints", "nv", "said"),
    [
        ("g1", ("left_shoulder_pitch_joint", "left_elbow_joint"), 2, "pelvis"),
        ("h1", ("left_shoulder_pitch", "left_elbow"), 2, "pelvis"),
        ("gr1", None, None, ""),
        ("vx300s", None, None, ""),
        ("tidybot", None, None, ""),
    ],
)
def test_published_models_hold_still(model, joints, nv, said, tmp_path):
    shared = shared_folder()
    path = Path(shared or "nowhere") / "data" / "foreign" / f"{model}.xml"
    if not path.is_file():
        pytest.skip("the foreign models are not here")
    robot = load_robot(_described(path, joints, tmp_path))
    spec = load_spec(path)
    whole = spec.compile()
    simulator = MujocoSimulator.from_robot(robot, path)
    assert nv is None or simulator.model.nv == nv
    assert set(robot.joint_names) <= {simulator.model.joint(row).name for row in range(simulator.model.njnt)}
    assert simulator.model.nbody == whole.nbody
    assert simulator.holding.notes
    assert said in " ".join(simulator.holding.notes)
    assert not (simulator.model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).any()


def _described(path, joints, folder):
    """A robot of these joints of a model, or of the first four hinges that have an actuator or limits."""
    model = load_spec(path).compile()
    hinges = [model.joint(row).name for row in range(model.njnt) if model.jnt_type[row] == mujoco.mjtJoint.mjJNT_HINGE]
    own = ", ".join(f"{{name: {name}}}" for name in joints or hinges[:4])
    text = YAML.format(more="base: held")
    text = f"{text.partition('joints:')[0]}joints: [{own}]\ncontroller{text.partition('controller')[2]}"
    (folder / "robot.yaml").write_text(text.replace("floating.xml", path.name))
    return folder / "robot.yaml"
