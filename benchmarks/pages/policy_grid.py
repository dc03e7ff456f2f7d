"""The section "What their numbers do" of docs/policy-transfer.md, from `python -m benchmarks policy_grid`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.pages import curves_figure

NAME = "policy-grid.svg"
ABOUT = "Reward while learning, by noise, discount and learning rate"
TITLES = {
    "ddpg-noise": "DDPG, noise of actions",
    "sac-gamma": "SAC, discount",
    "td3-gamma": "TD3, discount",
    "tqc-rate": "TQC, learning rate",
    "tqc-gamma": "TQC, discount",
    "tqc-tau": "TQC, following of the target networks",
}
# What the thesis says of its figures.
THESIS = {
    "ddpg-noise": "normal and Ornstein-Uhlenbeck noise alike; noise is essential",
    "sac-gamma": "0.95 inferior to 0.99",
    "td3-gamma": "hardly learns; worse below 0.99",
    "tqc-rate": "0.0001 and 0.001 alike; 0.01 worse",
    "tqc-gamma": "0.95 no worse than 0.99, 0.9 a little better",
    "tqc-tau": "0.9 in its list of the best; 0.9 and more poor, in its text (2.3.1)",
}
TEXT = """## What their numbers do

One number at a time ([grid search](policies.md#grid-search)), {steps:,} control steps, {seeds} seeds. Differences
smaller than the ranges say nothing.

```sh
python -m benchmarks policy_grid
```

![{about}]({name})

Best round: reward of a control step, mean over seeds (least, largest):

{rows}
"""


def part(result: Mapping[str, Any]) -> str:
    """The section as Markdown."""
    rows = []
    for question in result["questions"]:
        key = _key(question)
        ends = (f"{_value(group['value'])}: {_best(group['curves'])}" for group in question["groups"])
        rows.append(f"- {TITLES[key]}. {'; '.join(ends)}. Thesis: {THESIS[key]}.")
    return TEXT.format(steps=result["steps"], seeds=result["seeds"], about=ABOUT, name=NAME, rows="\n".join(rows))


def figures(result: Mapping[str, Any]) -> dict[str, str]:
    """The curves."""
    panels = {
        f"{question['figure']}: {TITLES[_key(question)]}": {
            _value(group["value"]): [[(point[0], point[1]) for point in curve] for curve in group["curves"]]
            for group in question["groups"]
        }
        for question in result["questions"]
    }
    return {NAME: curves_figure.figure(ABOUT, panels)}


def _key(question: Mapping[str, Any]) -> str:
    return f"{question['algorithm']}-{question['name']}"


def _value(value: Any) -> str:
    return {"ou": "Ornstein-Uhlenbeck"}.get(value, value) if isinstance(value, str) else f"{value:g}"


def _best(curves: Sequence[Sequence[Sequence[float]]]) -> str:
    reward = np.array([max(point[1] for point in curve) for curve in curves])
    return f"{reward.mean():.3f} ({reward.min():.3f}, {reward.max():.3f})".replace("-", "\N{MINUS SIGN}")
