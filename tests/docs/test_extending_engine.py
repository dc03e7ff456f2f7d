"""docs/extending.md, an engine: the one in Python, and the one that is put into a copy of the package for `--engine`."""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import trueup
from docs.snippets import with_snippets
from trueup.dataset import Dataset

ROOT = Path(__file__).parent.parent.parent
PAGE = with_snippets((ROOT / "docs" / "extending.md").read_text()).partition("\n## An engine\n")[2]
FROM_PYTHON, WHOLE_FILE = re.findall(r"^```python\n(.*?)^```$", PAGE, re.M | re.S)
FILE, TABLE = "src/trueup/sim/explicit_engine.py", "src/trueup/sim/engines.py"
CHANGES = re.findall(r"^```diff\n(.*?)^```$", PAGE, re.M | re.S)
COMMANDS = [shlex.split(line)[1:] for line in re.findall(r"^trueup .*$", PAGE, re.M)]
# In the copy, whose table of engines is another than that of this process.
SCRIPT = """
import sys
from dataclasses import replace
import numpy as np
from trueup.cli.main import main
from trueup.core.protocols import RolloutRequest, Simulator
from trueup.errors import ConfigError
from trueup.robots import JointFriction, find_model, load_robot
from trueup.sim import make_simulator

for line in sys.argv[1:]:
    try:
        main(line.split())
    except SystemExit as left:
        assert left.code == 0, line
robot = load_robot("demo_arm")
command = {"position": np.linspace([0.0, -0.6, 1.0], [0.4, -0.2, 0.6], 400)[None]}
ask = RolloutRequest(command["position"][:, 0], np.zeros((1, 3)), command)
for timestep_s in (0.002, 0.0002):
    own = replace(robot, simulation=replace(robot.simulation, timestep_s=timestep_s))
    every = round(0.002 / timestep_s)
    held = {"position": np.repeat(command["position"], every, axis=1)}
    both = [make_simulator(name, own, find_model(own)) for name in ("mujoco", "explicit")]
    assert all(isinstance(item, Simulator) for item in both)
    ends = [item.rollout(replace(ask, command=held)).position[0, ::every] for item in both]
    print("apart", np.abs(ends[0] - ends[1]).max())
again = both[1].clone()
again.reset(ask.position, ask.velocity)
steps = [again.step({"position": held["position"][:, row]})["position"][0] for row in range(100)]
print("stepped", np.abs(both[1].rollout(replace(ask, command=held)).position[0, 1:101] - steps).max())
try:
    make_simulator("explicit", replace(robot, friction={"yaw": JointFriction(stribeck=0.1)}), find_model(robot))
except ConfigError as refused:
    print("refused", refused.summary)
"""


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """The dataset of the page, in a folder to begin in."""
    folder = tmp_path_factory.mktemp("arm")
    data = Dataset(trueup.demo_dataset(folder / "runs" / "arm" / "dataset"))
    trueup.replay(data, trueup.load_robot("demo_arm"))
    return folder


@pytest.fixture(scope="module")
def done(arm, tmp_path_factory):
    folder = tmp_path_factory.mktemp("extended")
    shutil.copytree(arm / "runs", folder / "runs")
    shutil.copytree(ROOT / "src", folder / "src", ignore=shutil.ignore_patterns("__pycache__", "*.onnx"))
    assert not (folder / FILE).exists()
    (folder / FILE).write_text(WHOLE_FILE)
    table = (folder / TABLE).read_text()
    for change in CHANGES:
        before, after = (
            "".join(f"{line[1:]}\n" for line in change.splitlines() if line[0] in kept) for kept in (" -", " +")
        )
        assert table.count(before) == 1, before
        table = table.replace(before, after)
    (folder / TABLE).write_text(table)
    ran = subprocess.run(
        [sys.executable, "-c", SCRIPT, *map(shlex.join, COMMANDS)],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder / "src")},
        capture_output=True,
        text=True,
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
    said = [line.partition(" ") for line in ran.stdout.splitlines()]
    return folder, {
        word: [rest for first, _, rest in said if first == word] for word in ("apart", "stepped", "refused")
    }


def test_it_takes_one_file_and_three_lines():
    assert PAGE.count(f"`{FILE}`") == PAGE.count(f"`{TABLE}`") == 1
    added = [line for change in CHANGES for line in change.splitlines() if line.startswith("+")]
    assert len(added) == 3


@pytest.mark.long
def test_its_run_is_stored_measured_and_as_near_to_mujocos_as_the_page_says(done):
    folder, _ = done
    data = Dataset(folder / "runs" / "arm" / "dataset")
    (said,) = re.findall(r"within (\d+) mrad of each other", PAGE)
    furthest = 0.0
    for name in data.ids:
        episode = data.episode(name, runs=["mujoco/stock", "explicit/stock"])
        theirs, own = (episode.run(run)["position"] for run in ("mujoco/stock", "explicit/stock"))
        furthest = max(furthest, float(np.abs(theirs - own).max()))
    assert 0.5e-3 * int(said) < furthest <= 1e-3 * int(said)
    runs = json.loads((folder / "runs" / "engines" / "gap.json").read_text())["runs"]
    assert {"mujoco/stock", "explicit/stock"} <= set(runs)


def test_both_come_together_as_steps_get_smaller(done):
    coarse, fine = map(float, done[1]["apart"])
    assert 1e-5 < fine < 0.15 * coarse


def test_it_steps_as_it_rolls_out(done):
    assert float(done[1]["stepped"][0]) < 1e-12


@pytest.mark.long
def test_what_it_does_not_know_it_refuses_by_name(done):
    assert "friction laws" in done[1]["refused"][0]


def test_the_one_in_python_is_compared_with_mujoco(arm, tmp_path, monkeypatch, capsys):
    shutil.copytree(arm / "runs", tmp_path / "runs")
    monkeypatch.chdir(tmp_path)
    exec(compile(FROM_PYTHON, "extending.md", "exec"), {})
    assert "springs/4Hz against mujoco/stock: " in capsys.readouterr().out
    run = trueup.Dataset("runs/arm/dataset").run_info("springs/4Hz")
    assert run["engine"] == "springs"
