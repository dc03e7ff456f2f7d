"""docs/extending.md, a format, a metric, a network: its files and lines are put into a copy of the package, its commands run there."""

import json
import math
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import trueup
from docs.snippets import with_snippets
from trueup.lab import record_demo

PAGE = (Path(__file__).parent.parent.parent / "docs" / "extending.md").read_text()
TEXT = with_snippets(PAGE).partition("\n## A robot\n")[0]
FILES = dict(re.findall(r"whole file,\s`(src/trueup/[\w/]+\.py)`:\n\n```python\n(.*?)^```$", TEXT, re.M | re.S))
LINES = re.findall(r"^The line, in `(src/trueup/[\w/]+\.py)`[^\n]*\n\n```diff\n(.*?)^```$", TEXT, re.M | re.S)
COMMANDS = [shlex.split(line)[1:] for line in re.findall(r"^(trueup .*)$", TEXT, re.M)]
# What a user of the page would see, in one process: torch takes its time to load.
RUN = """
import json, sys
from pathlib import Path
import numpy as np
from trueup.cli.main import main
from trueup.augment.trained import Trained
from trueup.deploy import Predictor, StreamSettings

codes = []
for line in json.loads(sys.argv[1]):
    try:
        main(line)
    except SystemExit as left:
        codes.append(left.code)
trained = Trained.load("models/tcn")
card = trained.card
rng = np.random.default_rng(0)
low, high = (np.array([getattr(item, end) for item in card.inputs]) for end in ("low", "high"))
x = (low + (high - low) * (0.5 + 0.3 * np.sin(np.outer(np.arange(80) / 9, 1 + rng.random(low.size))))).astype(np.float32)
whole = Predictor.load("models/tcn").run(x[:, None])[:, 0]
settings = StreamSettings(correct_while_warming=True)
stream = trained.stream(rate_hz=card.rate_hz, joints=card.joints, settings=settings)
steps = np.stack([stream.step_vector(row).values.copy() for row in x])
Path("answer.json").write_text(json.dumps({
    "codes": codes,
    "stream": float(np.abs(steps - whole).max()),
    "corrected": float(np.abs(whole - x[:, [output.base for output in card.outputs]]).max()),
}))
"""


def logs(folder):
    """Motions of the demo arm as drives log them: in degrees, each joint a little later than the one before."""
    for episode in record_demo():
        (folder / episode.id).mkdir(parents=True)
        for number, joint in enumerate(episode.measured.joints):
            rows = ["axislog;deg", "time_us;actual;target"]
            for row, time_s in enumerate(episode.measured.time_s):
                angles = (math.degrees(side["position"][row, number]) for side in (episode.measured, episode.command))
                rows.append(f"{round(1e6 * time_s) + 300 * number};" + ";".join(f"{angle:.5f}" for angle in angles))
            (folder / episode.id / f"{joint}.csv").write_text("\n".join(rows) + "\n")


@pytest.fixture(scope="module")
def answer(tmp_path_factory):
    folder = tmp_path_factory.mktemp("extended")
    package = Path(trueup.__file__).parent
    shutil.copytree(package, folder / "src" / "trueup", ignore=shutil.ignore_patterns("__pycache__"))
    for path, text in FILES.items():
        assert not (folder / path).exists()
        (folder / path).write_text(text)
    for path, diff in LINES:
        before, after = (
            "".join(f"{line[1:]}\n" for line in diff.splitlines() if line[0] in kept) for kept in (" ", " +")
        )
        table = (folder / path).read_text()
        assert table.count(before) == 1, path
        (folder / path).write_text(table.replace(before, after))
    logs(folder / "logs" / "axislog")
    environment = {**os.environ, "PYTHONPATH": str(folder / "src"), "COLUMNS": "200"}
    ran = subprocess.run(
        [sys.executable, "-c", RUN, json.dumps(COMMANDS)], cwd=folder, env=environment, capture_output=True, text=True
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return {**json.loads((folder / "answer.json").read_text()), "folder": folder, "out": ran.stdout, "err": ran.stderr}


def test_each_takes_one_file_and_one_line():
    assert len(FILES) == len(LINES) == 3
    assert all(len([line for line in diff.splitlines() if line.startswith("+")]) == 1 for _, diff in LINES)


def test_every_command_does_what_the_page_says(answer):
    assert answer["codes"] == [3 if "--fail-above" in command else 0 for command in COMMANDS], answer["err"]


@pytest.mark.long
def test_the_format_is_detected_and_read(answer):
    assert "12 episodes imported (axislog)" in answer["out"]
    info = json.loads((answer["folder"] / "data" / "axislog" / "dataset.json").read_text())
    assert info["provenance"]["config"]["format"] == "axislog"


@pytest.mark.long
def test_the_metric_is_measured_shown_and_held_to_its_bar(answer):
    runs = json.loads((answer["folder"] / "runs" / "p95" / "gap.json").read_text())["runs"]
    p95, rmse = (runs["mujoco/stock"]["splits"]["all"]["position"][name] for name in ("p95", "rmse"))
    assert p95["unit"] == "rad"
    assert rmse["value"] < p95["value"] < 4 * rmse["value"]
    assert p95["low"] < p95["value"] < p95["high"]
    assert "position.p95 of mujoco/stock (all)" in answer["err"]
    assert "95th percentile of the error" in (answer["folder"] / "runs" / "p95" / "report.html").read_text()


def test_the_network_is_trained_exported_and_streamed(answer):
    card = json.loads((answer["folder"] / "models" / "tcn" / "model.json").read_text())
    assert card["method"] == "tcn"
    assert card["provenance"]["config"]["network"]["kernel"] == 3
    assert len(card["provenance"]["training"]["history"]) == 2
    assert answer["corrected"] > 1e-3
    assert answer["stream"] < 1e-5
