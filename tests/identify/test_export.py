"""What a fit leaves for others is the model that was fitted."""

import mujoco
import numpy as np
import pytest
import yaml

from identify.recovery_cases import ARM, SERVO, TORQUE, Truth, nominal_of
from trueup.core.fit_result import FitResult
from trueup.errors import DataError, FormatError
from trueup.identify import IdentifyConfig, Nominal, identify, save_identification
from trueup.identify.config import SolverChoice
from trueup.identify.export import _leave_room_for_rounding, isaac_yaml
from trueup.robots import ControllerSpec, JointSpec, RobotSpec, load_robot
from trueup.sim import MujocoSimulator, ReplaySettings, install_friction, replay_episode

FILES = ("fit.json", "model.fitted.xml", "robot.fitted.yaml", "isaac.actuators.yaml", "fit.samples.npz")


def identified(folder, controller, values, fit, **log):
    robot, nominal = nominal_of(folder, controller)
    truth = Truth(robot, nominal, values)
    logs = {"train": [truth.log(1, name="a", **log)], "val": [truth.log(2, name="b", **log)]}
    config = IdentifyConfig(fit=fit, models={}, solver=SolverChoice(max_iterations=8))
    found = identify(logs, robot, folder / "arm.xml", config=config)
    out = folder / "out"
    out.mkdir()
    save_identification(found, out)
    assert all((out / name).is_file() for name in FILES)
    return found, out, logs["val"][0]


def plain_positions(path, episode, delays, names=("shoulder", "elbow")):
    """The rollout of the fitted file by MuJoCo alone, commands held between their stamps, step by step."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    clock = episode.measured.time_s
    signal = next(iter(episode.command.signals))
    data.qpos[:] = episode.measured["position"][0]
    steps = round((clock[-1] - clock[0]) / model.opt.timestep)
    rows = [data.qpos.copy()]
    for step in range(steps):
        now = clock[0] + step * model.opt.timestep
        for joint, delay in enumerate(delays):
            held = np.searchsorted(episode.command.time_s, now - delay + 1e-9, side="right") - 1
            data.ctrl[joint] = episode.command[signal][max(held, 0), joint]
        mujoco.mj_step(model, data)
        rows.append(data.qpos.copy())
    at = np.rint((clock - clock[0]) / model.opt.timestep).astype(int)
    assert [model.joint(joint).name for joint in range(model.njnt)] == list(names)
    return np.array(rows)[at]


@pytest.mark.long
def test_plain_mujoco_moves_like_the_fit(tmp_path):
    fit = {
        "damping": "all",
        "frictionloss": "all",
        "kp": "all",
        "armature": "all",
        "joint_offset": ["elbow"],
        "mass": ["lower"],
    }
    values = {"damping[shoulder]": 0.9, "kp[elbow]": 60.0, "mass[lower]": 0.8, "joint_offset[elbow]": 0.03}
    found, out, log = identified(tmp_path, SERVO, values, fit, rate_hz=125.0, seconds=4.0)
    robot = load_robot(out / "robot.fitted.yaml")
    simulator = MujocoSimulator.from_robot(robot, out / "model.fitted.xml")
    ours = replay_episode(log, simulator, ReplaySettings.of(robot))
    plain = plain_positions(out / "model.fitted.xml", log, robot.delay_s)
    np.testing.assert_allclose(ours["position"], plain, atol=1e-6)
    memory = found.candidate().compile()
    same = MujocoSimulator(memory, found.nominal.robot, found.nominal.simulator.channels)
    in_memory = replay_episode(log, same, ReplaySettings.of(robot))
    np.testing.assert_allclose(ours["position"], in_memory["position"], atol=2e-5)  # six digits of MJCF


@pytest.mark.long
def test_friction_laws_travel_in_the_file(tmp_path):
    fit = {"stribeck": "all", "stribeck_velocity": "all", "delay_s": "all"}
    values = {"stribeck[shoulder]": 0.4, "stribeck_velocity[shoulder]": 0.2, "delay_s[elbow]": 0.016}
    _, out, log = identified(tmp_path, SERVO, values, fit, rate_hz=125.0, seconds=4.0)
    robot = load_robot(out / "robot.fitted.yaml")
    assert robot.delay_s[1] == pytest.approx(0.016, abs=2e-3)
    simulator = MujocoSimulator.from_robot(robot, out / "model.fitted.xml")
    whole = ReplaySettings(delay_s=tuple(round(delay / 0.004) * 0.004 for delay in robot.delay_s))
    ours = replay_episode(log, simulator, whole)
    install_friction()
    try:
        plain = plain_positions(out / "model.fitted.xml", log, whole.delay_s)
    finally:
        mujoco.set_mjcb_control(None)
    np.testing.assert_allclose(ours["position"], plain, atol=1e-6)
    without = plain_positions(out / "model.fitted.xml", log, whole.delay_s)
    assert np.abs(without - plain).max() > 1e-3, "the file alone has no Stribeck friction"


@pytest.mark.long
def test_isaac_names_and_samples(tmp_path):
    fit = {"damping": "all", "torque_offset": "all"}
    found, out, _ = identified(tmp_path, TORQUE, {"damping[elbow]": 0.5}, fit, size=6.0, seconds=3.0)
    text = (out / "isaac.actuators.yaml").read_text()
    actuators = yaml.safe_load(text)["actuators"]
    assert set(actuators) == {"shoulder", "elbow"}
    assert set(actuators["elbow"]) >= {"stiffness", "damping", "armature", "friction", "viscous_friction", "delay_s"}
    assert actuators["elbow"]["viscous_friction"] == found.result["damping[elbow]"].value
    samples = np.load(out / "fit.samples.npz", allow_pickle=False)
    assert set(samples.files) == set(found.result.values)
    low, high = found.result["damping[elbow]"].interval
    inside = np.mean((samples["damping[elbow]"] > low) & (samples["damping[elbow]"] < high))
    assert inside == pytest.approx(0.95, abs=0.03)


def settings_of(nominal):
    """What Isaac is told of a model as it came, and the text of it."""
    text = isaac_yaml(nominal.candidate())
    return yaml.safe_load(text)["actuators"], text


def test_isaac_is_told_what_a_geared_drive_does_at_the_joint(tmp_path):
    path = tmp_path / "arm.xml"
    drives = (
        '<actuator><position name="s" joint="shoulder" kp="10" kv="0.2" gear="5" forcerange="-2 2"/>'
        '<velocity name="e" joint="elbow" kv="3" gear="-2"/></actuator>'
    )
    path.write_text(ARM.replace("</mujoco>", f"{drives}</mujoco>"))
    actuators, text = {}, ""
    for joint, command in (("shoulder", "position"), ("elbow", "velocity")):
        controller = ControllerSpec(kind="model", command=command)
        own, said = settings_of(Nominal(RobotSpec("arm", (JointSpec(joint),), "arm.xml", controller=controller), path))
        actuators |= own
        text += said
    model = mujoco.MjModel.from_xml_path(str(path))

    def torque(position=(0.0, 0.0), velocity=(0.0, 0.0)):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = position, velocity
        mujoco.mj_forward(model, data)
        return data.qfrc_actuator.copy()

    assert actuators["shoulder"]["stiffness"] == pytest.approx(torque((-1e-3, 0))[0] / 1e-3) == 250.0
    assert actuators["shoulder"]["damping"] == pytest.approx(torque(velocity=(-1e-3, 0))[0] / 1e-3) == 5.0
    assert actuators["shoulder"]["effort_limit"] == pytest.approx(torque((-1.0, 0))[0]) == 10.0
    assert actuators["elbow"]["stiffness"] == 0.0
    assert actuators["elbow"]["damping"] == pytest.approx(torque(velocity=(0, -1e-3))[1] / 1e-3) == 12.0
    assert "effort_limit" not in actuators["elbow"]
    assert "-0.0" not in text


@pytest.mark.parametrize("kind", ["position", "pd", "pid"])
def test_isaac_is_told_the_limit_that_stands_on_the_joint(tmp_path, kind):
    robot, _ = nominal_of(tmp_path, ControllerSpec(kind=kind, kp=40.0, kv=1.0, ki=5.0 if kind == "pid" else 0.0))
    limited = RobotSpec(
        "arm",
        tuple(JointSpec(joint.name, torque_limit=87.0) for joint in robot.joints),
        "arm.xml",
        controller=robot.controller,
    )
    actuators, text = settings_of(Nominal(limited, tmp_path / "arm.xml"))
    assert actuators["elbow"]["effort_limit"] == 87.0
    assert actuators["elbow"]["stiffness"] == 40.0
    assert actuators["elbow"]["damping"] == 1.0
    assert ("integral gain of 5" in text) == (kind == "pid")
    assert "-0.0" not in text


@pytest.mark.long
def test_a_fitted_limit_wins_over_that_of_the_description(tmp_path):
    robot, _ = nominal_of(tmp_path)
    limited = RobotSpec(
        "arm", tuple(JointSpec(joint.name, torque_limit=20.0) for joint in robot.joints), "arm.xml", controller=SERVO
    )
    log = Truth(robot, Nominal(limited, tmp_path / "arm.xml"), {}).log(1, seconds=3.0)
    fit = {"damping": "all", "torque_limit": {"start": 30.0, "frozen": True}}
    config = IdentifyConfig(fit=fit, models={}, solver=SolverChoice(max_iterations=2))
    found = identify({"train": [log]}, limited, tmp_path / "arm.xml", config=config)
    save_identification(found, tmp_path)
    again = load_robot(tmp_path / "robot.fitted.yaml")
    assert MujocoSimulator.from_robot(again, tmp_path / "model.fitted.xml").torque_limits == {
        "shoulder": 30.0,
        "elbow": 30.0,
    }


@pytest.mark.long
def test_a_fitted_pid_travels_in_the_file(tmp_path):
    pid = ControllerSpec(kind="pid", kp=50.0, kv=2.0, ki=30.0)
    _, out, log = identified(tmp_path, pid, {"kp[elbow]": 80.0}, {"kp": "all"}, rate_hz=125.0, seconds=3.0)
    robot = load_robot(out / "robot.fitted.yaml")
    ours = replay_episode(log, MujocoSimulator.from_robot(robot, out / "model.fitted.xml"), ReplaySettings.of(robot))
    plain = plain_positions(out / "model.fitted.xml", log, robot.delay_s)
    np.testing.assert_allclose(ours["position"], plain, atol=1e-6)
    assert np.sqrt(np.mean((plain - log.measured["position"])[50:] ** 2)) < 2e-3


@pytest.mark.long
def test_fit_json_comes_back_and_broken_ones_are_refused(tmp_path):
    found, out, _ = identified(tmp_path, SERVO, {"damping[elbow]": 0.5}, {"damping": "all"}, seconds=3.0)
    read = FitResult.load(out / "fit.json")
    assert read.values == found.result.values
    assert read["damping[elbow]"].interval == found.result["damping[elbow]"].interval
    tree = read.to_json()
    with pytest.raises(FormatError, match="holds no fit"):
        FitResult.from_json({**tree, "schema": "trueup.gap/1"})
    with pytest.raises(DataError, match="broken"):
        FitResult.from_json({**tree, "status": "splendid"})
    del tree["parameters"]
    with pytest.raises(DataError, match="broken"):
        FitResult.from_json(tree)


@pytest.mark.parametrize("kind", ["diaginertia", "fullinertia"])
def test_flat_bodies_are_written_so_that_mujoco_takes_them(tmp_path, kind):
    """One moment is the sum of the others; with six digits, every fifth such body was refused."""
    rng = np.random.default_rng(3)
    for _ in range(30):
        a, b = rng.uniform(0.001, 0.1, 2)
        moments = " ".join(f"{value:.17g}" for value in (a, a + b, b)) + (" 0 0 0" if kind == "fullinertia" else "")
        body = f'<body name="link"><joint name="j"/><inertial pos="0 0 0" mass="1" {kind}="{moments}"/></body>'
        spec = mujoco.MjSpec.from_string(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
        before = np.sort(spec.compile().body("link").inertia)
        _leave_room_for_rounding(spec, spec.compile())
        spec.compile()
        written = mujoco.MjModel.from_xml_string(spec.to_xml())
        np.testing.assert_allclose(np.sort(written.body("link").inertia), before, rtol=0, atol=4e-5 * before[2])
