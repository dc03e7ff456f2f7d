"""docs/compensation-online.md: its Python runs, and its tables hold every setting and flag of a compensator."""

import re
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from compensate.test_compensated_env import Reach
from deploy.compensation_cases import compensation
from trueup.deploy import Compensator, CompensatorSettings, Limits, Status, Why
from trueup.lab import VirtualRobot, draw_truth, load_lab

TEXT = (Path(__file__).parent.parent.parent / "docs" / "compensation-online.md").read_text()
OWN = {"LIMITED", "TARGET", "PAYLOAD", "NO_PAYLOAD"}


@pytest.mark.long
def test_the_python_of_the_page_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    robot = VirtualRobot(draw_truth(load_lab("upper_body"), unit=1), payload_kg=2.0)
    compensation(Path("models/delta"), robot.joints, size=0.02)
    compensation(Path("models/simulated"), direction="simulator")
    here = np.clip(robot.read()["position"], -1.4, 1.4)
    motion = here - 0.1 * np.sign(here) * (1 - np.cos(np.arange(60) * 0.1))[:, None]
    log = VirtualRobot(robot.truth, payload_kg=2.0).execute({"position": np.repeat(motion, 20, axis=0)}, every=10)
    simulated = Compensator.load("models/simulated", joints=("a", "b"), limits=Limits((-2.0, -2.0), (2.0, 2.0)))
    names = {"robot": robot, "motion": motion, "log": log.measured, "Reach": Reach, "simulated": simulated}
    for block in re.findall(r"^```python\n(.*?)^```$", TEXT, re.M | re.S):
        exec(compile(block, "compensation-online.md", "exec"), names)
    names["env"].reset(seed=0)
    assert names["driven"].latest.status is Status.OK
    assert names["fast"].every == 20
    assert 0.5 < names["found"].payload_kg < 3.5
    assert len(capsys.readouterr().out.splitlines()) == 2


def rows(head):
    table = TEXT.split(f"| {head} |")[1].split("\n\n")[0]
    return dict(re.findall(r"^\| `(\w+)` \| ([^|]+) \|", table, re.M))


def test_every_setting_and_flag_is_explained():
    assert set(rows("setting")) == {item.name for item in fields(CompensatorSettings)}
    assert rows("setting")["outside"].strip() == CompensatorSettings().outside
    assert set(rows("`why`")) == OWN
    assert {flag.name for flag in Why} > OWN


@pytest.mark.parametrize("sentence", ["a tenth of the range", "ten times the largest"])
def test_defaults_are_those_of_the_page(sentence, tmp_path):
    assert sentence in TEXT
    compensation(tmp_path, relative=False)
    made = Compensator.load(tmp_path, joints=("a", "b"), limits=Limits((-2.0, -2.0), (2.0, 2.0)))
    largest, rate = CompensatorSettings().sizes(made.card)
    np.testing.assert_allclose(largest, 0.1 * 6.0)
    np.testing.assert_allclose(rate, 10 * largest)
