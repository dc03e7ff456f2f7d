"""A fitted model is the model that was fitted, wherever its files lie and whatever its robot's options are."""

import struct
import zlib
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from trueup.dataset import Dataset
from trueup.errors import ConfigError
from trueup.identify import IdentifyConfig, Nominal, rehearse
from trueup.identify.config import SolverChoice
from trueup.identify.export import fitted_robot, save_model
from trueup.robots import (
    ControllerSpec,
    JointFriction,
    JointGains,
    JointSpec,
    MotorSpec,
    PayloadSpec,
    ReplaySpec,
    RobotSpec,
    Setup,
    SimulationSpec,
    load_robot,
)
from trueup.robots.spec import COMMAND_SIGNAL
from trueup.robots.written import robot_yaml
from trueup.sim import MujocoSimulator
from trueup.stages import identifying, import_logs

BODY = """<body name="l"><joint name="j" axis="0 1 0" damping=".1"/>
  <inertial pos="0 0 -.1" mass=".5" diaginertia=".01 .01 .01"/>{geoms}</body>"""
MESH = '<geom type="mesh" mesh="a" material="t"/>'
ASSETS = '<mesh file="{0}a.obj"/><texture name="t" type="2d" file="{0}t.png"/><material name="t" texture="t"/>'


def write_obj(path):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")


def write_png(path):
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    path.parent.mkdir(parents=True, exist_ok=True)
    rows = b"".join(b"\0" + b"\x80\x40\x20" * 6 for _ in range(6))
    head = struct.pack(">IIBBBBB", 6, 6, 8, 2, 0, 0, 0)
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    )


def write_skin(path):
    points = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]], np.float32)
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32)
    bone = b"l".ljust(40, b"\0") + np.zeros(3, np.float32).tobytes() + np.array([1, 0, 0, 0], np.float32).tobytes()
    weights = struct.pack("<i", 4) + np.arange(4, dtype=np.int32).tobytes() + np.ones(4, np.float32).tobytes()
    path.write_bytes(struct.pack("<4i", 4, 0, 4, 1) + points.tobytes() + faces.tobytes() + bone + weights)


def write_model(folder, *, compiler="", assets="", geoms="", more=""):
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "arm.xml"
    path.write_text(
        f"<mujoco>{compiler}<asset>{assets}</asset>{more}<worldbody>{BODY.format(geoms=geoms)}</worldbody></mujoco>"
    )
    return path


def beside(folder):
    write_obj(folder / "meshes/a.obj")
    write_png(folder / "meshes/t.png")
    return write_model(folder, assets=ASSETS.format("meshes/"), geoms=MESH)


def in_two_folders(folder):
    write_obj(folder / "my meshes/x/a.obj")
    write_png(folder / "tex/t.png")
    compiler = '<compiler meshdir="my meshes/x" texturedir="tex"/>'
    return write_model(folder, compiler=compiler, assets=ASSETS.format(""), geoms=MESH)


def in_one_folder(folder):
    write_obj(folder / "assets/sub/a.obj")
    write_png(folder / "assets/sub/t.png")
    return write_model(folder, compiler='<compiler assetdir="assets"/>', assets=ASSETS.format("sub/"), geoms=MESH)


def above(folder):
    write_obj(folder / "meshes/a.obj")
    write_png(folder / "meshes/t.png")
    compiler = '<compiler assetdir="../meshes"/>'
    return write_model(folder / "mjcf", compiler=compiler, assets=ASSETS.format(""), geoms=MESH)


def stripped(folder):
    write_obj(folder / "assets/a.obj")
    write_png(folder / "assets/t.png")
    compiler = '<compiler assetdir="assets" strippath="true"/>'
    return write_model(folder, compiler=compiler, assets=ASSETS.format("C:/drawings/"), geoms=MESH)


def absolute(folder):
    write_obj(folder / "far/a.obj")
    write_png(folder / "far/t.png")
    compiler = '<compiler meshdir="not-there"/>'
    return write_model(folder, compiler=compiler, assets=ASSETS.format(f"{folder}/far/"), geoms=MESH)


def included(folder):
    write_obj(folder / "as/a.obj")
    write_png(folder / "as/t.png")
    (folder / "sub").mkdir()
    (folder / "sub/assets.xml").write_text(f"<mujoco><asset>{ASSETS.format('')}</asset></mujoco>")
    more = '<include file="sub/assets.xml"/>'
    return write_model(folder, compiler='<compiler assetdir="as"/>', geoms=MESH, more=more)


def beside_what_is_included(folder):
    write_obj(folder / "sub/a.obj")
    write_png(folder / "sub/t.png")
    (folder / "sub/assets.xml").write_text(f"<mujoco><asset>{ASSETS.format('')}</asset></mujoco>")
    return write_model(folder, geoms=MESH, more='<include file="sub/assets.xml"/>')


def attached(folder):
    write_obj(folder / "m0/a.obj")
    write_obj(folder / "sub/mm/b.obj")
    write_png(folder / "sub/t.png")
    (folder / "sub/hand.xml").write_text(
        '<mujoco><compiler meshdir="mm"/><asset><mesh name="b" file="b.obj"/>'
        '<texture name="t" type="2d" file="t.png"/><material name="t" texture="t"/></asset>'
        '<worldbody><body name="x"><geom type="mesh" mesh="b" material="t"/></body></worldbody></mujoco>'
    )
    assets = '<mesh file="a.obj"/><model name="hand" file="sub/hand.xml"/>'
    geoms = '<geom type="mesh" mesh="a"/><attach model="hand" body="x" prefix="hand_"/>'
    return write_model(folder, compiler='<compiler meshdir="m0"/>', assets=assets, geoms=geoms)


def cube_height_and_skin(folder):
    write_png(folder / "tex/side.png")
    write_png(folder / "hill.png")
    folder.mkdir(exist_ok=True)
    (folder / "hill.bin").write_bytes(struct.pack("<ii", 2, 2) + np.zeros(4, np.float32).tobytes())
    write_skin(folder / "s.skn")
    sides = " ".join(f'file{side}="side.png"' for side in ("right", "left", "up", "down", "front", "back"))
    assets = (
        f'<texture name="sky" type="skybox" {sides}/><hfield name="h" file="hill.bin" size="1 1 1 .1"/>'
        '<hfield name="g" file="hill.png" size="1 1 1 .1"/><skin name="s" file="s.skn"/>'
        '<mesh name="ball" builtin="sphere" params="1"/><mesh name="v" vertex="0 0 0 .1 0 0 0 .1 0 0 0 .1"/>'
    )
    geoms = '<geom type="hfield" hfield="h"/><geom type="mesh" mesh="ball"/><geom type="mesh" mesh="v"/>'
    return write_model(folder, compiler='<compiler texturedir="tex"/>', assets=assets, geoms=geoms)


LAYOUTS = (
    *(beside, in_two_folders, in_one_folder, above, stripped, absolute),
    *(included, beside_what_is_included, attached, cube_height_and_skin),
)
SHAPES = ("nbody", "ngeom", "nmesh", "nmeshvert", "ntex", "ntexdata", "nmat", "nhfield", "nhfielddata", "nskin")


def one_joint(path, **more):
    controller = more.pop("controller", ControllerSpec(kind="torque"))
    return RobotSpec("arm", (JointSpec("j"),), path.name, controller=controller, **more)


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.__name__)
def test_a_fitted_model_finds_its_files_from_another_folder(tmp_path, layout, monkeypatch):
    path = layout(tmp_path / "given")
    plain = mujoco.MjModel.from_xml_path(str(path))
    monkeypatch.chdir(tmp_path)
    given = path.relative_to(tmp_path)  # as people give it on the command line
    rehearse(one_joint(path), given)
    out = tmp_path / "results" / "fit"
    out.mkdir(parents=True)
    save_model(Nominal(one_joint(path), given).candidate(), out / "model.fitted.xml")
    monkeypatch.chdir("/")
    found = mujoco.MjModel.from_xml_path(str(out / "model.fitted.xml"))
    assert {name: getattr(found, name) for name in SHAPES} == {name: getattr(plain, name) for name in SHAPES}
    np.testing.assert_allclose(found.body_mass, plain.body_mass)


def test_what_is_not_there_is_left_out_and_nothing_else(tmp_path):
    write_obj(tmp_path / "m/b.obj")
    assets = (
        '<mesh file="b.obj"/><mesh name="g" file="gone.obj"/><skin name="s" file="gone.skn"/>'
        '<texture name="t" type="2d" file="gone.png"/><material name="t" texture="t"/>'
        '<hfield name="h" file="gone.png" size="1 1 1 .1"/>'
    )
    shown = (
        '<geom type="mesh" mesh="g"/><geom type="box" size=".1 .1 .1" material="t"/>'
        '<geom type="mesh" mesh="b"/><geom type="hfield" hfield="h"/>'
    )
    path = write_model(tmp_path, compiler='<compiler meshdir="m"/>', assets=assets, geoms=shown)
    rehearse(one_joint(path), path)
    model = Nominal(one_joint(path), path).model
    assert [int(number) for number in model.geom_type] == [
        int(mujoco.mjtGeom.mjGEOM_BOX),
        int(mujoco.mjtGeom.mjGEOM_MESH),
    ]
    assert (model.nmesh, model.ntex, model.nmat, model.nskin, model.nhfield) == (1, 0, 1, 0, 0)


def test_a_model_that_cannot_be_written_is_refused_before_the_search(tmp_path, monkeypatch):
    path = beside(tmp_path)
    real = mujoco.MjSpec.to_xml
    monkeypatch.setattr("mujoco.MjSpec.to_xml", lambda spec: real(spec).replace("<mesh", "<nonsense"))
    with pytest.raises(ConfigError, match="cannot be written: MuJoCo refuses it"):
        rehearse(one_joint(path), path)
    monkeypatch.setattr("mujoco.MjSpec.to_xml", lambda spec: real(spec).replace('mass="0.5"', 'mass="0.7"'))
    with pytest.raises(ConfigError, match="another model: got other body_mass"):
        rehearse(one_joint(path), path)


TWO = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.002"/>
  <worldbody>
    <body name="a"><joint name="j" axis="0 1 0" damping=".1" frictionloss=".05"/>
      <inertial pos="0 0 -.2" mass="1" diaginertia=".01 .01 .01"/>
      <body name="b" pos="0 0 -.3"><joint name="k" type="slide" axis="0 0 1" armature=".1"/>
        <inertial pos="0 0 -.1" mass=".5" diaginertia=".001 .001 .001"/><site name="payload" pos="0 0 -.1"/>
      </body></body>
  </worldbody>
  <actuator>{actuators}</actuator>
</mujoco>
"""
GAINS = {
    "position": {"kp": 10.0, "kv": 1.0},
    "pd": {"kp": 10.0, "kv": 1.0},
    "pid": {"kp": 10.0, "kv": 1.0, "ki": 2.0, "integral_limit": 3.0},
    "servo": {"kp": 10.0, "kv": 1.0, "ki": 2.0, "integral_limit": 3.0},
    "torque": {},
    "velocity": {"kv": 2.0},
    "velocity-integrator": {"kp": 10.0, "kv": 1.0},
}
CONTROLLERS = [
    *(ControllerSpec(kind=kind, delay_s=0.01, **gains) for kind, gains in GAINS.items()),
    ControllerSpec(kind="servo", kp=10.0, kv=1.0),
    ControllerSpec(kind="torque", source="measured"),
    ControllerSpec(kind="position", kp=10.0, per_joint={"k": JointGains(kp=5.0, kv=0.5, delay_s=0.02)}),
    ControllerSpec(kind="model", command="position"),
    ControllerSpec(kind="model", command="torque", source="measured"),
]
OWN = {
    "position": '<position name="j" joint="j" kp="10" kv="1"/><position name="k" joint="k" kp="10" kv="1"/>',
    "torque": '<motor name="j" joint="j"/><motor name="k" joint="k"/>',
}
SIMULATIONS = {
    "as-it-is": SimulationSpec(),
    "load": SimulationSpec(load=True),
    "bodies": SimulationSpec(bodies=("a", "b"), load=True),
    "light": SimulationSpec(gravity_compensation=True, timestep_s=0.001),
    "contacts": SimulationSpec(contacts=True),
}


def described(controller, simulation, path):
    return RobotSpec(
        "two",
        (JointSpec("j", log="J", sign=-1, scale=2.0, offset=0.1, torque_limit=5.0), JointSpec("k", log_unit="m")),
        path.name,
        scored=("j",),
        ignore=("x",),
        controller=controller,
        simulation=simulation,
        replay=ReplaySpec(window_s=0.5, initial_velocity="measured", settle_s=0.1),
        friction={"j": JointFriction(stribeck=0.1)},
        motor=MotorSpec(1.0, 1.0, 1.0, 12.0),
        payload=PayloadSpec(("payload",)),
    )


@pytest.mark.parametrize("simulation", SIMULATIONS)
@pytest.mark.parametrize("controller", CONTROLLERS, ids=lambda item: f"{item.kind}-{item.source}")
def test_a_fitted_robot_of_any_kind_is_read_back_as_it_was(tmp_path, controller, simulation):
    path = tmp_path / "two.xml"
    path.write_text(TWO.format(actuators=OWN.get(controller.command, "")))
    robot = described(controller, SIMULATIONS[simulation], path)
    rehearse(robot, path)
    candidate = Nominal(robot, path).candidate()
    candidate.delay_s["k"] = 0.03
    save_model(candidate, tmp_path / "model.fitted.xml")
    (tmp_path / "robot.fitted.yaml").write_text(robot_yaml(fitted_robot(candidate)))
    found = load_robot(tmp_path / "robot.fitted.yaml")
    assert found.joint_rules() == robot.joint_rules(), "logs are read as before"
    assert found.controller.signal == (controller.command or COMMAND_SIGNAL[controller.kind])
    assert found.controller.source == controller.source
    assert found.delay_s == (robot.delay_s[0], 0.03)
    assert not found.friction, "it is in the model"
    same = ("simulation", "replay", "motor", "payload", "scored", "ignore", "joint_names")
    assert {name: getattr(found, name) for name in same} == {name: getattr(robot, name) for name in same}
    simulator = MujocoSimulator.from_robot(found, tmp_path / "model.fitted.xml", setup=Setup(0.5))
    assert simulator.torque_limits["j"] == 5.0
    assert simulator.command_signals == MujocoSimulator.from_robot(robot, path).command_signals


def test_a_law_of_friction_that_is_fitted_is_not_undone_by_the_robot_that_it_came_from(tmp_path):
    path = tmp_path / "two.xml"
    path.write_text(TWO.format(actuators=OWN["position"]))
    robot = described(ControllerSpec(command="position"), SimulationSpec(), path)
    candidate = Nominal(robot, path).candidate()
    from trueup.sim import friction_of, set_friction

    set_friction(candidate.spec, "j", JointFriction(stribeck=0.4))
    save_model(candidate, tmp_path / "model.fitted.xml")
    again = Nominal(replace(fitted_robot(candidate), folder=tmp_path), tmp_path / "model.fitted.xml")
    assert friction_of(again.spec, "j").stribeck == pytest.approx(0.4)


def made_logs(folder, *, name="j"):
    folder.mkdir()
    time_s = np.arange(0, 4, 0.01)
    for number in range(3):
        there = 0.5 * np.sin((number + 1) * time_s)[:, None]
        arrays = {"measured.time_s": time_s, "measured.position": np.roll(there, 5, axis=0)}
        arrays |= {"measured.torque": 0.2 * there, "command.time_s": time_s, "command.position": there}
        arrays["command.torque"] = 0 * there
        np.savez(folder / f"m{number}.npz", joints=np.array([name]), **arrays)
    return folder


@pytest.mark.long
@pytest.mark.parametrize("kind", ["torque", "model"])
def test_a_fit_to_measured_torques_comes_to_its_end(tmp_path, kind):
    model = write_model(tmp_path / "m")
    motor = '</worldbody><actuator><motor name="m" joint="j"/></actuator>'
    model.write_text(model.read_text().replace("</worldbody>", motor))
    import_logs(made_logs(tmp_path / "logs"), tmp_path / "data", format="npz")
    robot = one_joint(model, controller=ControllerSpec(kind=kind, command="torque", source="measured"))
    config = IdentifyConfig(fit={"damping": "all"}, models={}, solver=SolverChoice(max_iterations=2))
    out = tmp_path / "fit"
    done = identifying.fit(Dataset(tmp_path / "data"), robot, out, model=model, config=config)
    assert done.measurement.gap.runs.keys() >= {"mujoco/stock", "mujoco/fitted"}
    assert load_robot(out / "robot.fitted.yaml").controller.source == "measured"


@pytest.mark.long
@pytest.mark.parametrize("name", ["a", "b"])
def test_the_cases_of_textures_and_meshes(model_cases, tmp_path, name):
    import_logs(made_logs(tmp_path / "logs"), tmp_path / "data", format="npz")
    config = IdentifyConfig(fit={"damping": "all"}, models={}, solver=SolverChoice(max_iterations=1))
    robot = load_robot(model_cases / "export" / "m" / f"{name}.yaml")
    identifying.fit(Dataset(tmp_path / "data"), robot, tmp_path / "fit", config=config)
    found = mujoco.MjModel.from_xml_path(str(tmp_path / "fit" / "model.fitted.xml"))
    assert (found.nmesh, found.ntex) == (1, 1 if name == "a" else 0)
