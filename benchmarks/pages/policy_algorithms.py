"""The section "Four algorithms" of docs/policy-transfer.md, from `python -m benchmarks policy_algorithms`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.pages import curves_figure
from benchmarks.pages.markdown import table

TITLES = {"tqc": "TQC", "sac": "SAC", "td3": "TD3", "ddpg": "DDPG"}
NAME = "policy-algorithms.svg"
ABOUT = "Reward while learning, by algorithm"
SHARES = (0.1, 0.2, 0.4, 0.6, 0.8, 1.0)
TEXT = """## Four algorithms

{steps:,} control steps and as many updates, {seeds} seeds, in the stock simulator (ES thesis,
Fig. 2.6). Intervals are over goals and seeds.

```sh
python -m benchmarks policy_algorithms
```

{totals}

![{about}]({name})

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
        "reward, TQC minus this",
        "min of one core",
    ]
    rows = []
    for name, title in TITLES.items():
        own = found[name]
        seeds = ", ".join(f"{100 * value:.1f}" for value in own["by_seed"])
        minus = _signed(own["tqc_minus_seeds"]) if "tqc_minus_seeds" in own else ""
        rows.append(
            [
                title,
                f"{100 * own['median']:.1f} ({seeds})",
                minus,
                f"{own['minutes']:.1f}",
            ]
        )
    return table(heads, rows)


def _signed(values: list[float]) -> str:
    value, low, high = values
    return f"{value:+.3f} [{low:+.3f}, {high:+.3f}]".replace("-", "\N{MINUS SIGN}")


def _words(found: Mapping[str, Any]) -> str:
    """Which of the others TQC is better than, as intervals say."""
    said = {"better than": [], "worse than": [], "not surely better or worse than": []}  # type: dict[str, list[str]]
    for name, own in found.items():
        if "tqc_minus_seeds" in own:
            _, low, high = own["tqc_minus_seeds"]
            key = "better than" if low > 0 else "worse than" if high < 0 else "not surely better or worse than"
            said[key].append(TITLES[name])
    parts = [f"{key} {' and '.join(names)}" for key, names in said.items() if names]
    return f"By reward, TQC is {'; '.join(parts)}, and its updates take longest. In the thesis it leads all."
