"""The section "Going on after identification" of docs/policy-transfer.md, from `benchmarks policy_going_on`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.pages.markdown import table
from benchmarks.pages.policy_transfer import DRAWS, SIMULATORS, mean_minutes, minus_stock_reward
from benchmarks.policy_going_on import table as tabulated

PLACES = {
    "stock": "stock",
    "identified": "identified",
    "own robot": "its robot",
    "other robots": "robots {strangers}",
}
_SIMULATORS = {"stock": "in the stock simulator", "identified": "in the identified one"}
MINUTES = (1, 2, 4, 6, 8)
TEXT = """## Going on after identification

Each of robots {robots} has a seed and a first policy from the stock simulator (`--config laptop`). It drives the robot
to {driven} goals, the robot is identified from these runs, and the policy goes on (`--start`, as many control steps
again, {minutes:.0f} min of one core) {where}.

```sh
python -m benchmarks policy_going_on
```

Distance from 100 new goals at the end [cm]: mean (median, worst), and the share within 5 cm. On its robot: mean
difference with 95 % intervals over goals, and over goals and robots (with their seeds).

{table}

{words}

### The curve

The first policies in the stock simulator: median distance [cm] by minutes of one core, median of {count} seeds (best,
worst).

{curve}

{bar}
"""


def part(result: Mapping[str, Any]) -> str:
    """The section as Markdown."""
    found, config = tabulated(result["policies"]), result["provenance"]["config"]
    return TEXT.format(
        robots=_range([int(unit) for unit in result["before"]]),
        driven=config["driven"],
        minutes=mean_minutes(result["policies"]),
        where=_where(found),
        table=_table(found, [name.format(strangers=_range(config["strangers"])) for name in PLACES.values()]),
        words=_words(found),
        count=len(result["before"]),
        curve=_curve(result["before"]),
        bar=_bar(result["before"]),
    )


_WORDS = {"none": "without randomization", "thesis": "with the thesis's", "posterior": "with draws from its posterior"}


def _where(found: Mapping[str, Any]) -> str:
    """In which simulators policies went on, and what was drawn there: what was measured, nothing else."""
    said = []
    for simulator, by_draws in found.items():
        draws = " or ".join(_WORDS[name] for name in by_draws)
        said.append(f"{_SIMULATORS[simulator]} {draws}")
    return ", or ".join(said)


def _range(numbers: Sequence[int]) -> str:
    return f"{numbers[0]} to {numbers[-1]}"


def _table(found: Mapping[str, Any], places: Sequence[str]) -> str:
    """Where policies end, what that is against the simulator as it comes, and how they get there."""
    rows = []
    for simulator, by_draws in found.items():
        for draws, own in by_draws.items():
            said = own["own robot"]
            rows.append(
                [
                    SIMULATORS[simulator],
                    DRAWS[draws],
                    *(_distance(own[place]) for place in PLACES),
                    "" if (simulator, draws) == ("stock", "none") else _difference(said),
                    f"{said['smoothness']:.2f}",
                ]
            )
    return table(["went on in", "randomized", *places, "difference", "smoothness"], rows, left=2)


def _distance(own: Mapping[str, Any]) -> str:
    median, worst = 100 * own["median"], 100 * own["worst"]
    return f"{100 * own['mean']:.2f} ({median:.2f}, {worst:.0f}), {100 * own['success']:.1f} %"


def _difference(own: Mapping[str, Any]) -> str:
    value, low, high = (100 * item for item in own["minus_stock"])
    _, least, most = (100 * item for item in own["minus_stock_robots"])
    said = f"{value:+.2f} [{low:+.2f}, {high:+.2f}] [{least:+.2f}, {most:+.2f}]"
    return said.replace("-", "\N{MINUS SIGN}")


def _words(found: Mapping[str, Any]) -> str:
    """The bars, as they came out."""
    own = found["identified"]["posterior"]["own robot"]
    said = "beat" if own["minus_stock"][2] < 0 else "are worse than" if own["minus_stock"][1] > 0 else "do not beat"
    return (
        f"On their robots, policies that went on in the identified simulator {said} those that went on in the stock "
        f"simulator; their reward differs by {minus_stock_reward(own)}. The price is less smooth torques."
    )


def _at(curve: Sequence[Sequence[float]], minutes: float) -> float | None:
    """Distance in the last round that was done by then [m]."""
    done = [point[3] for point in curve if point[1] <= 60 * minutes]
    return done[-1] if done else None


def _curve(before: Mapping[str, Any]) -> str:
    curves = [own["curve"] for own in before.values()]
    columns = {f"{minutes} min": [_at(curve, minutes) for curve in curves] for minutes in MINUTES}
    columns["end"] = [curve[-1][3] for curve in curves]
    return table([*columns], [[*map(_of_seeds, columns.values())]], left=0)


def _of_seeds(distances: Sequence[float | None]) -> str:
    """Median, least and largest; nothing where a seed has no round yet."""
    found = [100 * one for one in distances if one is not None]
    if len(found) < len(distances):
        return ""
    return f"{np.median(found):.1f} ({min(found):.1f}, {max(found):.1f})"


def _bar(before: Mapping[str, Any]) -> str:
    ends, reached = [], []
    for own in before.values():
        curve = own["curve"]
        ends.append(curve[-1][1] / 60)
        reached += [point[1] for point in curve if point[3] <= 0.05][:1]
    if len(reached) < len(before):
        return "Not all of them come within 5 cm."
    return f"All come within 5 cm in {min(reached):.0f} to {max(reached):.0f} s, of {max(ends):.1f} min at most."
