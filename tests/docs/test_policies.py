"""docs/policies.md: its Python runs, and its lists hold every field."""

import re
from dataclasses import fields
from pathlib import Path

import pytest

from trueup.policy import ReachConfig, Reward
from trueup.policy.config import LearnerConfig, PolicyConfig
from trueup.policy.evaluation import UNITS
from trueup.policy.grid import NAMES, THESIS
from trueup.policy.randomization import RandomizationConfig

TEXT = (Path(__file__).parent.parent.parent / "docs" / "policies.md").read_text()


@pytest.mark.long
def test_the_python_of_the_page_runs(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {}
    for block in re.findall(r"^```python\n(.*?)^```$", TEXT, re.M | re.S):
        exec(compile(block, "policies.md", "exec"), names)
    assert "m from the goal" in capsys.readouterr().out
    assert names["said"].sound
    assert names["seen"].shape == (24,)
    assert abs(names["seen"]).max() <= 1


def keys(head):
    """What the list below a line that ends so explains."""
    (listed,) = re.findall(rf"{re.escape(head)}:\n\n((?:- .*\n(?:  .*\n)*)+)", TEXT)
    return {name for line in re.findall(r"^- (.*?):", listed, re.M) for name in re.findall(r"`(\w+)`", line)}


def test_every_field_is_explained():
    assert keys("(`ReachConfig`)") == {item.name for item in fields(ReachConfig)}
    assert keys("Keys of `randomization`") == {item.name for item in fields(RandomizationConfig)}
    assert keys("`PolicyConfig`") == {item.name for item in fields(PolicyConfig)}
    assert keys("(`LearnerConfig`)") == {item.name for item in fields(LearnerConfig)}
    assert keys("Metrics") == set(UNITS)
    assert all(f"`{item.name}`" in TEXT for item in fields(Reward))


def test_the_thesis_grids_are_those_of_the_page():
    (said,) = re.findall(r"it is the thesis's grid: (.*?) \(values", TEXT, re.S)
    points = {
        name: int(number)
        for number, names in re.findall(r"\b(\d+)(?: points)? for (.*?)(?=, \d|$)", said)
        for name in re.findall(r"`(\w+)`", names)
    }
    assert points == {algorithm: len(grid) for algorithm, grid in THESIS.items()}
    assert all(f"`{name}`" in TEXT for name in NAMES if not name.startswith("learner."))


def test_defaults_are_those_of_the_page():
    learner, config = LearnerConfig(), PolicyConfig()
    for name, value in (
        ("rate", "0.001"),
        ("gamma", "0.97"),
        ("batch", "256"),
        ("buffer", "500000"),
        ("starts", "5000"),
    ):
        assert f"- `{name}` ({value}):" in TEXT
        assert float(value) == getattr(learner, name)
    for name, value in (("arms", 16), ("steps", 400000), ("rounds", 20)):
        assert f"- `{name}` ({value}):" in TEXT
        assert getattr(config, name) == value
