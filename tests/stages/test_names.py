"""Names are names: joints and bodies may be called anything that a model allows."""

from xml.sax.saxutils import quoteattr

import mujoco
import numpy as np
import pytest

from trueup.cli.options import names_among, unit_choices
from trueup.core.parameters import split_name
from trueup.dataset import Dataset
from trueup.identify import IdentifyConfig, Nominal
from trueup.identify.config import DataChoice, SolverChoice, make_parameters
from trueup.identify.quantities import motion_target, split_motion_target
from trueup.robots import ControllerSpec, JointSpec, RobotSpec, load_robot
from trueup.stages import identifying, import_logs

NAMES = ("a:b", "b", "c=d", "x[y]", "my joint, left", "/ns/arm/j.position", "ü<&'>")
QUICK = SolverChoice(max_iterations=1, tolerance=0.5)


def write_model(folder):
    """A chain of links, bodies and joints of these names."""
    body = ""
    for name in reversed(NAMES):
        body = (
            f"<body name={quoteattr(name)} pos='0 0 -.1'><joint name={quoteattr(name)} axis='0 1 0' damping='.2' "
            f"armature='.01'/><geom type='capsule' fromto='0 0 0 0 0 -.1' size='.01' mass='.1'/>{body}</body>"
        )
    path = folder / "chain.xml"
    path.write_text(
        f"<mujoco><option timestep='0.002' integrator='implicitfast'/><worldbody>{body}</worldbody></mujoco>"
    )
    return path


def write_logs(folder, path, *, signal):
    folder.mkdir()
    model = mujoco.MjModel.from_xml_path(str(path))
    phase = np.arange(len(NAMES))
    for number in range(3):
        data, rows = mujoco.MjData(model), []
        for step in range(1000):
            now = step * model.opt.timestep
            asked = (0.2 if signal == "position" else 0.05) * np.sin((2 + number) * now + phase)
            push = asked if signal == "torque" else 8.0 * (asked - data.qpos) - 0.3 * data.qvel
            rows.append(np.concatenate([[now], data.qpos, data.qvel, asked]))
            data.qfrc_applied[:] = push
            mujoco.mj_step(model, data)
        table = np.array(rows)[::5]
        time_s, position, velocity, asked = np.split(table, [1, 1 + len(NAMES), 1 + 2 * len(NAMES)], axis=1)
        np.savez(
            folder / f"m{number}.npz",
            **{
                "joints": np.array(NAMES),
                "measured.time_s": time_s[:, 0],
                "measured.position": position,
                "measured.velocity": velocity,
                "command.time_s": time_s[:, 0],
                f"command.{signal}": asked,
            },
        )
    return folder


def robot_of(path, controller):
    return RobotSpec("chain", tuple(map(JointSpec, NAMES)), path.name, controller=controller)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["position", pytest.param("torque", marks=pytest.mark.slow)])
def test_strange_names_are_explained_and_identified(tmp_path, kind):
    path = write_model(tmp_path)
    import_logs(write_logs(tmp_path / "logs", path, signal=kind), tmp_path / "data", format="npz")
    dataset = Dataset(tmp_path / "data")
    gains = {"kp": 8.0, "kv": 0.3} if kind == "position" else {}
    robot = robot_of(path, ControllerSpec(kind=kind, **gains))
    config = IdentifyConfig(models={}, data=DataChoice(budget_s=3.0), solver=QUICK)
    found = identifying.explain(dataset, robot, model=path, config=config)
    assert found.statements is not None
    done = identifying.fit(dataset, robot, tmp_path / "fit", model=path, config=config)
    assert {name for item in done.fit.parameters if (name := split_name(item.name)[1]) in NAMES}
    if kind == "torque":
        recordings = done.fit.data["encoder_zeros"]
        assert {split_motion_target(target)[1] for target in recordings} <= set(NAMES)
        assert recordings
    again = load_robot(tmp_path / "fit" / "robot.fitted.yaml")
    assert again.joint_names == NAMES
    fitted = Nominal(again, tmp_path / "fit" / "model.fitted.xml")
    assert set(fitted.bodies) == set(NAMES)


def test_parameters_of_strange_names_are_told_apart(tmp_path):
    path = write_model(tmp_path)
    nominal = Nominal(robot_of(path, ControllerSpec(kind="torque")), path)
    motions = ("m1", "run/m-2.x")
    found = make_parameters({"damping": "all", "mass": "all", "encoder_zero": "all"}, nominal, motions)
    assert {item.target for item in found if item.quantity in ("damping", "mass")} == set(NAMES)
    zeros = [split_motion_target(item.target) for item in found if item.quantity == "encoder_zero"]
    assert zeros == [(motion, joint) for motion in motions for joint in NAMES]
    assert all(motion_target(*pair) in {item.target for item in found} for pair in zeros)


def test_lists_on_the_command_line_know_names_with_commas_and_equals_signs():
    assert names_among("a:b, my joint, left,b", NAMES) == ["a:b", "my joint, left", "b"]
    assert names_among("b,unknown,,c=d", NAMES) == ["b", "unknown", "c=d"]
    assert unit_choices(["position.c=d=1", "velocity=rad/s"]) == {"position.c=d": "1", "velocity": "rad/s"}


@pytest.mark.long
def test_the_case_of_colons(model_cases, tmp_path):
    case = model_cases.parent / "attack" / "colon"
    if not case.is_dir():
        pytest.skip("cases/attack/colon not found")
    import_logs(case / "logs", tmp_path / "data", format="npz")
    robot, dataset = load_robot(case / "r.yaml"), Dataset(tmp_path / "data")
    config = IdentifyConfig(models={}, data=DataChoice(budget_s=3.0), solver=QUICK)
    identifying.explain(dataset, robot, config=config)
    done = identifying.fit(dataset, robot, tmp_path / "fit", config=config)
    assert done.fit.parameters
