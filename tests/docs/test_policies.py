"""docs/policies.md: its Python runs, and its tables hold every field."""

import re
from dataclasses import fields
from pathlib import Path

import pytest
from benchmarks.figures import stored

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
    assert names["vector"].num_envs == 16
    assert names["seen"].shape == (24,)
    assert abs(names["seen"]).max() <= 1
    assert len({model.dof_damping[0] for _ in range(3) for model, _ in [names["drawn"](names["vector"]._rng)]}) == 3


def rows(head):
    table = TEXT.split(f"| {head} |")[1].split("\n\n")[0]
    return {name for cell in re.findall(r"^\| ([^|]+) \|", table, re.M) for name in re.findall(r"`(\w+)`", cell)}


def test_every_field_is_explained():
    assert rows("`ReachConfig`") == {item.name for item in fields(ReachConfig)}
    assert rows("`RandomizationConfig`") == {item.name for item in fields(RandomizationConfig)}
    assert rows("`PolicyConfig`") == {item.name for item in fields(PolicyConfig)}
    assert rows("`LearnerConfig`") == {item.name for item in fields(LearnerConfig)}
    assert rows("metric") == set(UNITS)
    assert all(f"`{item.name}`" in TEXT for item in fields(Reward))


def test_the_thesis_grids_are_those_of_the_page():
    for algorithm, grid in THESIS.items():
        (row,) = re.findall(rf"^\| [^|]*`{algorithm}`[^|]* \|(.*)\| (\d+) \|$", TEXT, re.M)
        assert int(row[1]) == len(grid)
        said = {float(number) for number in re.findall(r"\d\.\d+", row[0])}
        tried = {value for axis in grid.axes for values in axis.rows for value in values if not isinstance(value, str)}
        assert said == tried
    assert all(f"`{name}`" in TEXT for name in NAMES if not name.startswith("learner."))


def test_figures_of_speed_are_about_those_of_the_benchmarks():
    rows = {row["name"]: row["value"] for name in ("policy_env", "policy_loop") for row in stored()[name]["rows"]}
    said = " ".join(TEXT.split())
    one, many, threads = re.search(
        r"one arm has (.+?) of their speed, 16 arms (.+?), and two threads take (.+?) t", said
    ).groups()
    assert float(one) == pytest.approx(rows["one arm: environment over bare stepping"], rel=0.1)
    assert float(many) == pytest.approx(rows["16 arms, 1 thread: environment over bare stepping"], rel=0.1)
    assert float(threads) == pytest.approx(rows["two threads over one"], rel=0.1)
    guard, asked, tick = re.search(r"(\d+) us for the guard, (\d+) us where .+ up to (\d+) us in 99 of", said).groups()
    assert float(guard) == pytest.approx(rows["guard: p50"], rel=0.3)
    assert float(asked) == pytest.approx(rows["policy: p50"], rel=0.3)
    assert float(tick) == pytest.approx(rows["in real time: a tick, p99"], rel=0.5)


def test_defaults_are_those_of_the_page():
    learner, config = LearnerConfig(), PolicyConfig()
    for name, value in (
        ("rate", "0.001"),
        ("gamma", "0.97"),
        ("batch", "256"),
        ("buffer", "500000"),
        ("starts", "5000"),
    ):
        assert f"| `{name}` | {value} |" in TEXT
        assert float(value) == getattr(learner, name)
    for name, value in (("arms", 16), ("steps", 400000), ("rounds", 20)):
        assert f"| `{name}` | {value} |" in TEXT
        assert getattr(config, name) == value
