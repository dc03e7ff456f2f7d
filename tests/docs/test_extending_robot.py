"""docs/extending.md, a robot and a friction law: its files, put into a copy of the package, do what the page says."""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

from trueup.core.results import GapResult
from trueup.robots import JointFriction
from trueup.sim import install_friction, set_friction

ROOT = Path(__file__).parent.parent.parent
PAGE = (ROOT / "docs" / "extending.md").read_text().partition("\n## A robot\n")[2].partition("\n## An engine\n")[0]
FILES = dict(
    re.findall(r"`([\w/.]+\.(?:py|yaml|xml))`[^`\n]*:\n\n```(?:python|yaml|xml)\n(.*?)^```$", PAGE, re.M | re.S)
)
COMMANDS = [shlex.split(line)[1:] for line in re.findall(r"^trueup .*$", PAGE, re.M)]
LAWS = "src/trueup/robots/friction/laws.py"
(CHANGE,) = re.findall(r"^```diff\n(.*?)^```$", PAGE, re.M | re.S)
# What is done in the copy, whose table of laws is another than that of this process.
SCRIPT = """
import json, runpy, sys
from dataclasses import asdict, replace
import mujoco
import numpy as np
from trueup.cli.main import main
from trueup.core.protocols import RolloutRequest
from trueup.robots import find_model, load_robot
from trueup.sim import DartSimulator, MujocoSimulator, friction_of, install_friction

if __name__ == "__main__":
    for line in json.loads(sys.argv[1]):
        try:
            main(line)
        except SystemExit as left:
            assert left.code == 0, line
    for file in json.loads(sys.argv[2]):
        for name, item in runpy.run_path(file).items():
            if name.startswith("test_"):
                item()
    law = friction_of(mujoco.MjSpec.from_file("runs/worn/model.fitted.xml"), "pan")
    old = mujoco.MjModel.from_xml_path("old.xml")
    install_friction()
    data = mujoco.MjData(old)
    data.qvel[:] = 2.0
    mujoco.mj_step(old, data, 100)
    worn = load_robot("worn.yaml")
    command = {"position": np.full((1, 300, 2), 0.8)}
    ask = RolloutRequest(np.zeros((1, 2)), np.zeros((1, 2)), command)
    engines = [MujocoSimulator.from_robot(robot, find_model(robot)) for robot in (worn, replace(worn, friction={}))]
    engines.append(DartSimulator.from_robot(worn, find_model(worn)))
    pan = [engine.rollout(ask).position[0, :, 0].tolist() for engine in engines]
    said = asdict(friction_of(mujoco.MjSpec.from_file("old.xml"), "a"))
    print(json.dumps({"fitted": asdict(law), "old": said, "moved": data.qpos.tolist(), "pan": pan}))
"""
OLD = """
<mujoco>
  <worldbody><body>
    <joint name="a" axis="0 1 0"/><inertial pos="0 0 -0.2" mass="1" diaginertia="0.01 0.01 0.001"/>
    <body pos="0 0 -0.4">
      <joint name="b" axis="0 1 0"/><inertial pos="0 0 -0.15" mass="0.5" diaginertia="0.004 0.004 0.001"/>
    </body>
  </body></worldbody>
</mujoco>
"""
OLD_LAW = JointFriction(stribeck=0.3, tanh_coulomb=0.2, sigmoid_level=0.1)


def old_model(path):
    """A model file of before the page's law was there, and how far it moves."""
    before = mujoco.get_mjcb_control(), mujoco.get_mjcb_passive()
    spec = mujoco.MjSpec.from_string(OLD)
    set_friction(spec, "a", OLD_LAW)
    spec.compile()
    path.write_text(spec.to_xml())
    install_friction()
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qvel[:] = 2.0
    mujoco.mj_step(model, data, 100)
    mujoco.set_mjcb_control(before[0])
    mujoco.set_mjcb_passive(before[1])
    return data.qpos


def changed():
    """The lines of the table around the change, before and after it."""
    lines = CHANGE.splitlines(keepends=True)
    return "".join(line[1:] for line in lines if line[0] == " "), "".join(line[1:] for line in lines)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    folder = tmp_path_factory.mktemp("extended")
    shutil.copytree(ROOT / "src", folder / "src", ignore=shutil.ignore_patterns("__pycache__", "*.onnx"))
    for name, text in FILES.items():
        path = folder / name
        assert not path.exists(), name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    table, before, after = (folder / LAWS).read_text(), *changed()
    assert table.count(before) == 1
    (folder / LAWS).write_text(table.replace(before, after))
    moved = old_model(folder / "old.xml")
    tests = [name for name in FILES if name.startswith("tests/")]
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT, json.dumps(COMMANDS), json.dumps(tests)],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder / "src")},
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stdout + run.stderr
    return folder, json.loads(run.stdout.splitlines()[-1]), moved


def test_a_robot_takes_no_code_and_a_law_one_file_and_one_line():
    inside = [name for name in FILES if name.startswith("src/")]
    robot, law = ([name for name in inside if ("friction" in name) == is_law] for is_law in (False, True))
    assert {Path(name).suffix for name in robot} == {".yaml", ".xml"}
    assert len(law) == 1
    assert [line[0] for line in CHANGE.splitlines() if line[0] != " "] == ["+"]


def test_the_robot_is_recorded_replayed_and_measured_by_its_name(done):
    runs = GapResult.load(done[0] / "runs/head/gap.json").runs
    error = {run: runs[run]["val"]["position"]["rmse"].total.value for run in ("command", "mujoco/stock")}
    assert error["mujoco/stock"] < 1e-5 < 1e-2 < error["command"]


@pytest.mark.long
def test_the_fit_recovers_the_numbers_of_the_law_within_their_intervals(done):
    fit = json.loads((done[0] / "runs/worn/fit.json").read_text())
    found = {item["name"]: item for item in fit["parameters"]}
    assert fit["status"] == "ok"
    for name, true in {"frictionloss[pan]": 0.06, "runout[pan]": 0.05, "runout_phase[pan]": -0.5}.items():
        low, high = found[name]["interval"]
        assert low <= true <= high, found[name]
        assert high - low < 0.1 * abs(true), found[name]
    assert (found["runout[pan]"]["unit"], found["runout[pan]"]["cause"]) == ("Nm", "friction")
    assert found["runout[pan]"]["label"] in (done[0] / "runs/worn/report.html").read_text()


def test_the_model_file_holds_the_law(done):
    folder, said, _ = done
    fit = {
        item["name"]: item["value"] for item in json.loads((folder / "runs/worn/fit.json").read_text())["parameters"]
    }
    for name in ("runout", "runout_phase"):
        assert said["fitted"][name] == pytest.approx(fit[f"{name}[pan]"], rel=1e-5)


def test_model_files_of_before_mean_what_they_meant(done):
    _, said, moved = done
    assert said["old"] == {**vars(OLD_LAW), "runout": 0.0, "runout_phase": 0.0}
    assert said["moved"] == moved.tolist()


@pytest.mark.long
def test_both_engines_carry_the_law_out(done):
    mujoco_, without, dart = np.array(done[1]["pan"])
    assert np.abs(mujoco_ - without).max() > 1e-3
    assert np.abs(mujoco_ - dart).max() < 1e-4
