"""The section "Four algorithms" of docs/policy-transfer.md, from `python -m benchmarks policy_algorithms`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from benchmarks.pages import curves_figure
from benchmarks.pages.markdown import table

TITLES = {"tqc": "TQC", "sac": "SAC", "td3": "TD3", "ddpg": "DDPG"}
NAME = "policy-algorithms.svg"
ABOUT = "Reward while learning, by algorithm"
SHARES = (0.1, 0.2, 0.4, 0.6, 0.8, 1.0)
TEXT = """## Four algorithms

TQC, SAC, TD3 and DDPG with the laptop's numbers, {steps:,} control steps and as many updates each, {seeds} seeds, in
the simulator as it comes (ES thesis, Fig. 2.6, at the scale that fits two cores). Deterministic policies explore by
normal noise, and count one reward at a time: with three of them they learned nothing here in two minutes.

```sh
python -m benchmarks policy_algorithms
```

{totals}

![{about}]({name})

Mean reward of a control step on the way, mean over seeds (least and largest):

{curves}

{words}
"""


def part(result: Mapping[str, Any]) -> str:
    """The section as Markdown."""
    found = result["algorithms"]
    return TEXT.format(
        steps=result["steps"],
        seeds=len(found["tqc"]["by_seed"]),
        totals=_totals(found),
        about=ABOUT,
        name=NAME,
        curves=_curves(found),
        words=_words(found),
    )


def figures(result: Mapping[str, Any]) -> dict[str, str]:
    """The curves, as in Fig. 2.6."""
    found = result["algorithms"]
    panel = {
        title: [[(point[0], point[2]) for point in curve] for curve in found[name]["curves"]]
        for name, title in TITLES.items()
    }
    return {NAME: curves_figure.figure(ABOUT, {"2.6: four algorithms": panel})}


def _totals(found: Mapping[str, Any]) -> str:
    heads = [
        "",
        "distance [cm], seeds",
        "reward of a control step",
        "TQC minus this: over goals",
        "over goals and seeds",
        "min of one core",
    ]
    rows = []
    for name, title in TITLES.items():
        own = found[name]
        seeds = ", ".join(f"{100 * value:.1f}" for value in own["by_seed"])
        minus = [_signed(own[key]) if key in own else "" for key in ("tqc_minus", "tqc_minus_seeds")]
        rows.append(
            [
                title,
                f"{100 * own['median']:.1f} ({seeds})",
                f"{own['reward']:.3f}".replace("-", "\N{MINUS SIGN}"),
                *minus,
                f"{own['minutes']:.1f}",
            ]
        )
    return table(heads, rows)


def _signed(values: list[float]) -> str:
    value, low, high = values
    return f"{value:+.3f} [{low:+.3f}, {high:+.3f}]".replace("-", "\N{MINUS SIGN}")


def _curves(found: Mapping[str, Any]) -> str:
    rows = []
    for name, title in TITLES.items():
        rewards = np.array([[point[2] for point in curve] for curve in found[name]["curves"]])
        cells = []
        for share in SHARES:
            own = rewards[:, max(0, round(share * rewards.shape[1]) - 1)]
            cells.append(f"{own.mean():.2f} ({own.min():.2f}, {own.max():.2f})".replace("-", "\N{MINUS SIGN}"))
        rows.append([title, *cells])
    return table(["", *(f"{100 * share:.0f} %" for share in SHARES)], rows)


def _words(found: Mapping[str, Any]) -> str:
    """Which of the others TQC is better than, as intervals say."""
    said = {"better than": [], "worse than": [], "not to be told from": []}  # type: dict[str, list[str]]
    for name, own in found.items():
        if "tqc_minus_seeds" in own:
            _, low, high = own["tqc_minus_seeds"]
            key = "better than" if low > 0 else "worse than" if high < 0 else "not to be told from"
            said[key].append(TITLES[name])
    parts = [f"{key} {' and '.join(names)}" for key, names in said.items() if names]
    return (
        f"By reward, over goals and seeds, TQC is {'; '.join(parts)} at this budget; an update of it takes longest. In "
        "the thesis it leads all."
    )
