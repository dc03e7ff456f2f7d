"""docs/policies.md: its Python runs, and its tables hold every field."""

import re
from dataclasses import fields
from pathlib import Path

from trueup.policy import ReachConfig, Reward
from trueup.policy.randomization import RandomizationConfig

TEXT = (Path(__file__).parent.parent.parent / "docs" / "policies.md").read_text()


def test_the_python_of_the_page_runs(capsys):
    names = {}
    for block in re.findall(r"^```python\n(.*?)^```$", TEXT, re.M | re.S):
        exec(compile(block, "policies.md", "exec"), names)
    assert "m from the goal" in capsys.readouterr().out
    assert names["vector"].num_envs == 16
    for _ in range(5):
        seen, reward, terminated, _, _ = names["real"].step(names["real"].action_space.high)
        assert -10 < reward < 0
        assert not terminated
        assert abs(seen).max() <= 1
    assert len({model.dof_damping[0] for _ in range(3) for model, _ in [names["drawn"](names["vector"]._rng)]}) == 3


def rows(head):
    table = TEXT.split(f"| {head} |")[1].split("\n\n")[0]
    return {name for cell in re.findall(r"^\| ([^|]+) \|", table, re.M) for name in re.findall(r"`(\w+)`", cell)}


def test_every_field_is_explained():
    assert rows("`ReachConfig`") == {item.name for item in fields(ReachConfig)}
    assert rows("`RandomizationConfig`") == {item.name for item in fields(RandomizationConfig)}
    assert all(f"`{item.name}`" in TEXT for item in fields(Reward))
