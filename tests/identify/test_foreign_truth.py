"""Truths for benchmarks are independent of the package, whole, the same for a seed, and physics, not one engine's."""

import ast
import json
import sys
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from benchmarks.foreign_cases import CASES
from benchmarks.foreign_motions import cause_of, simulate, true_model
from benchmarks.foreign_plants import FINE_S, Gear
from benchmarks.foreign_robots import ROBOTS, foreign_folder
from benchmarks.foreign_truth import Truth, make, numbers

from trueup.identify.candidate import Nominal
from trueup.identify.config import IdentifyConfig, make_parameters
from trueup.identify.quantities import quantity
from trueup.robots import load_robot

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
BY_NAME = {case.name: case for case in CASES}
ARM = replace(
    BY_NAME["demo_arm"], engine="mujoco", motions=2, duration_s=3.0
)  # the project's own: needs no shared data


def short(name):
    case = BY_NAME[name]
    if not (ROBOTS[case.robot].own or foreign_folder().is_dir()):
        pytest.skip("models of other people's robots not found: set TRUEUP_SHARED, or put `shared` beside the project")
    return replace(case, motions=2, duration_s=3.0)


def setup(case, folder):
    """Nominal model, true numbers and typical torques of a case."""
    path = folder / "model.xml"
    path.write_text(ROBOTS[case.robot].nominal(case.drive).to_xml())
    _, true, typical = numbers(case, mujoco.MjModel.from_xml_path(str(path)), 0)
    return path, true, typical


def run(case, folder, *, cause=None, settle_s=0.3, **changed):
    path, true, typical = setup(case, folder)
    model = mujoco.MjModel.from_xml_path(str(path))
    true = replace(true, **changed)
    cause = cause_of(case, model, true, typical) if cause is None else cause
    return simulate(case, path, true, 0, cause=cause, settle_s=settle_s)


def imports(module):
    tree = ast.parse((BENCHMARKS / f"{module}.py").read_text())
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (name.name for name in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0
            yield node.module


def test_a_truth_uses_nothing_of_the_package():
    left, seen, others = ["foreign_truth"], set(), set()
    while left:
        module = left.pop()
        seen.add(module)
        for name in imports(module):
            root, _, rest = name.partition(".")
            if root == "benchmarks":
                left += [rest] if rest not in seen else []
            elif root not in sys.stdlib_module_names:
                others.add(root)
    assert {"foreign_truth", "foreign_robots", "foreign_plants", "foreign_dart", "foreign_motions"} <= seen
    assert others == {"numpy", "mujoco", "dartpy"}
    for module in seen:
        assert "__import__" not in (BENCHMARKS / f"{module}.py").read_text()


def test_the_cases_are_of_many_kinds():
    a, b = ([case for case in CASES if case.group == group] for group in "AB")
    assert len(BY_NAME) == len(CASES)
    assert {ROBOTS[case.robot].file.removesuffix(".xml") for case in a} >= {
        *("ur5e", "iiwa14", "vx300s", "h1", "g1", "gr1", "allegro", "tidybot"),
        *("panda", "demo_arm"),
    }
    assert {case.drive for case in a} == {"position", "torque", "velocity"}
    assert {case.commands for case in a} == {"fast", "held"}
    assert sum(case.engine == "dart" for case in a) >= 3
    assert {case.cause for case in b} == {"late-feedback", "integral", "backlash", "elastic", "payload", "sign"}
    assert len({ROBOTS[case.robot].file for case in b}) >= 4
    assert not any(case.cause for case in a)
    for case in CASES:
        assert 3 <= len(case.joints) == len(case.home) == len(case.amplitude) <= 16
        assert set(case.at) | set(case.offsets) <= set(case.joints)
        assert (case.commands == "held") == (case.command_hz == case.log_hz)


@pytest.mark.parametrize("name", BY_NAME)
def test_the_nominal_model_is_what_a_user_has(name, tmp_path):
    case = short(name)
    setup(case, tmp_path)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))
    assert model.opt.timestep == 0.002
    assert {model.joint(i).name for i in range(model.njnt)} == set(case.joints)
    assert model.nv == model.nq == model.nu == len(case.joints)
    for i in range(model.nu):
        assert model.joint(model.actuator_trnid[i, 0]).name == model.actuator(i).name
        if case.drive == "position" and model.actuator_ctrllimited[i]:
            index = case.joints.index(model.actuator(i).name)
            low, high = model.actuator_ctrlrange[i]
            assert low < case.home[index] - case.amplitude[index] < case.home[index] + case.amplitude[index] < high
        assert case.drive != "velocity" or not model.actuator_ctrllimited[i]
    data = mujoco.MjData(model)
    whole = mujoco.MjModel.from_xml_path(str(ROBOTS[case.robot].path()))
    there = mujoco.MjData(whole)
    for joint, at in zip(case.joints, case.home, strict=True):
        data.qpos[model.joint(joint).qposadr] = at
        there.qpos[whole.joint(joint).qposadr] = at
    mujoco.mj_forward(model, data)
    mujoco.mj_forward(whole, there)
    for joint in case.joints:  # what hangs at a joint pulls as in the original, so nothing that moves was cut off
        ours, theirs = model.joint(joint).dofadr[0], whole.joint(joint).dofadr[0]
        np.testing.assert_allclose(data.qfrc_bias[ours], there.qfrc_bias[theirs], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("name", ["ur5e", "gr1_arm", "h1_leg"])
def test_a_truth_is_whole(name, tmp_path):
    case = short(name)
    truth = make(case, 0, tmp_path)
    assert Truth(**json.loads((tmp_path / "truth.json").read_text()) | {"joints": truth.joints}) is not None
    written = json.loads((tmp_path / "truth.json").read_text())
    assert set(written) == set(Truth.__dataclass_fields__)
    assert written["parameters"] == truth.parameters
    assert set(truth.parameters) == set(truth.nominal)

    robot = load_robot(tmp_path / "robot.yaml")
    nominal = Nominal(robot, tmp_path / "model.xml")
    config = IdentifyConfig().resolved(nominal)
    for item in make_parameters(config.fit, nominal, ("m00", "m01")):
        name, target = item.name.rstrip("]").split("[")
        assert truth.nominal[item.name] == pytest.approx(quantity(name).read(nominal, target), rel=1e-5, abs=1e-5)
    for joint in case.joints:
        assert truth.parameters[f"frictionloss[{joint}]"] > 0
        assert 0.004 <= truth.parameters[f"delay_s[{joint}]"] <= 0.025
    for body in case.heavier:
        assert truth.parameters[f"mass[{body}]"] != truth.nominal[f"mass[{body}]"]
    if case.drive == "position":
        for joint in case.joints:
            both = truth.parameters[f"kv[{joint}]"] + truth.parameters[f"damping[{joint}]"]
            assert truth.sums[f"kv+damping[{joint}]"] == pytest.approx(both)

    with np.load(tmp_path / "logs" / "m01.npz") as log:
        assert log["joints"].tolist() == list(case.joints)
        assert log["measured.position"].shape == (case.duration_s * case.measured_hz, len(case.joints))
        assert log[f"command.{case.drive}"].shape == (case.duration_s * case.log_hz, len(case.joints))
        assert ("measured.velocity" in log) == case.velocity
        assert log["measured.position"].std(axis=0).min() > 0.02  # every joint moves


@pytest.mark.long
def test_a_seed_gives_the_same_bytes_and_another_does_not(tmp_path):
    for folder, seed in (("a", 1), ("b", 1), ("c", 2)):
        make(ARM, seed, tmp_path / folder)
    files = sorted(path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*") if path.is_file())
    assert [str(path) for path in files] == ["logs/m00.npz", "logs/m01.npz", "model.xml", "robot.yaml", "truth.json"]
    for file in files:
        one, same, other = ((tmp_path / folder / file).read_bytes() for folder in "abc")
        assert one == same
        assert (one == other) == (file.name in {"model.xml", "robot.yaml"})


@pytest.mark.long
@pytest.mark.parametrize("name", ["g1_arm", "tidybot"])
def test_dart_and_mujoco_agree(name, tmp_path):
    pytest.importorskip("dartpy")
    case = replace(short(name), motions=1)
    none = np.zeros(len(case.joints))
    smooth = [run(replace(case, engine=engine), tmp_path, frictionloss=none) for engine in ("mujoco", "dart")]
    np.testing.assert_allclose(smooth[0].position, smooth[1].position, atol=1e-6)
    rough = [run(replace(case, engine=engine), tmp_path) for engine in ("mujoco", "dart")]
    np.testing.assert_allclose(rough[0].position, rough[1].position, atol=2e-3)
    assert np.abs(rough[0].position - smooth[0].position).max() > 1e-2


def test_a_stiff_gear_without_play_is_none(tmp_path):
    plain = run(ARM, tmp_path, cause={})
    stiff = run(replace(ARM, cause="elastic", amount=1e-5), tmp_path)
    np.testing.assert_allclose(stiff.position, plain.position, atol=2e-3)


def test_a_motor_moves_within_the_play_and_the_link_does_not():
    class Link:
        def __init__(self):
            self.q, self.v = np.zeros((1, 1)), np.zeros((1, 1))

        def step(self, torque):
            self.v = self.v + FINE_S * torque / 0.1
            self.q = self.q + FINE_S * self.v

    link, one = Link(), np.ones(1)
    gear = Gear(1e4 * one, 5.0 * one, 0.02 * one, 0.05 * one, 0.0 * one, 0.0 * one)
    gear.attach(link)
    while gear.q[0, 0] < 0.0099:
        gear.step(np.full((1, 1), 0.5))
        assert link.q[0, 0] == 0.0
    for _ in range(2000):
        gear.step(np.full((1, 1), 0.5))
    assert link.q[0, 0] > 0.05
    assert gear.q[0, 0] - link.q[0, 0] == pytest.approx(0.01, abs=1e-3)
    momentum = 0.1 * link.v[0, 0] + 0.05 * gear.v[0, 0]
    assert link.v[0, 0] == pytest.approx(gear.v[0, 0], rel=0.1)
    assert momentum > 0.2


def test_an_integral_takes_away_what_gravity_leaves(tmp_path):
    none = np.zeros(3)
    case = replace(ARM, cause="integral", amount=3.0)
    errors = [
        abs(one.position[0] - one.command[0]).max()
        for one in (
            run(ARM, tmp_path, cause={}, settle_s=2.0, frictionloss=none),
            run(case, tmp_path, settle_s=2.0, frictionloss=none),
        )
    ]
    assert errors[0] > 0.01
    assert errors[1] < 0.05 * errors[0]


@pytest.mark.long
def test_late_feedback_and_payload_change_the_motion(tmp_path):
    _, true, _ = setup(ARM, tmp_path)
    plain, late, loaded, unloaded = (
        run(replace(ARM, cause=kind, amount=amount), tmp_path, armature=true.armature)
        for kind, amount in ((None, 0.0), ("late-feedback", 0.006), ("payload", 0.3), ("payload", 1e-9))
    )
    assert 1e-3 < np.abs(late.position - plain.position).max() < 0.2
    np.testing.assert_allclose(late.position[0], plain.position[0], atol=5e-3)  # at rest, late is as good as not
    np.testing.assert_allclose(unloaded.position, plain.position, atol=1e-6)
    assert (loaded.position[0] - plain.position[0])[:, 1].min() > 0.01  # the shoulder counts downward


def test_a_payload_is_where_the_truth_says(tmp_path):
    path, true, typical = setup(ARM, tmp_path)
    case = replace(ARM, cause="payload", amount=0.3)
    cause = cause_of(case, mujoco.MjModel.from_xml_path(str(path)), true, typical)
    data = []
    for own in (case, ARM):
        model = true_model(path, own, true, cause)
        data.append((model, mujoco.MjData(model)))
        mujoco.mj_forward(*data[-1])
    (loaded, there), (bare, alone) = data
    body = bare.body(cause["body"]).id
    at = alone.xpos[body] + alone.xmat[body].reshape(3, 3) @ cause["position_m"]
    moment = loaded.body_mass @ there.xipos - bare.body_mass @ alone.xipos
    np.testing.assert_allclose(moment, 0.3 * at, atol=1e-9)


@pytest.mark.parametrize("both", [False, True])
def test_a_wrong_sign_is_in_the_log_alone(both, tmp_path):
    make(ARM, 0, tmp_path / "right")
    make(replace(ARM, cause="sign", at=("elbow",), amount=float(both)), 0, tmp_path / "wrong")
    with np.load(tmp_path / "right/logs/m00.npz") as right, np.load(tmp_path / "wrong/logs/m00.npz") as wrong:
        turned = np.array([1, 1, -1])
        np.testing.assert_array_equal(wrong["measured.position"], right["measured.position"] * turned)
        np.testing.assert_array_equal(wrong["command.position"], right["command.position"] * (turned if both else 1))
