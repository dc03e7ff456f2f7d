"""The section "Going on after identification" of docs/policy-transfer.md, from `benchmarks policy_going_on`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.pages.markdown import table
from benchmarks.pages.policy_transfer import DRAWS, SIMULATORS, mean_minutes, minus_stock_reward
from benchmarks.policy_going_on import table as tabulated

PLACES = {
    "own robot": "its robot",
    "other robots": "robots {strangers}",
}
_SIMULATORS = {"stock": "in the stock simulator", "identified": "in the identified one"}
TEXT = """## Going on after identification

Each of robots {robots} has a seed and a first policy from the stock simulator (`--config laptop`). It drives the robot
to {driven} goals, the robot is identified from these runs, and the policy goes on (`--start`, as many control steps
again, {minutes:.0f} min of one core) {where}.

```sh
python -m benchmarks policy_going_on
```

Distance from 100 new goals at the end [cm]: mean (median, worst), and the share within 5 cm; on its robot, mean
difference with 95 % intervals over goals, and over goals and robots.

{table}

{words}

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
                    f"{SIMULATORS[simulator]}{'' if draws == 'none' else f', {DRAWS[draws]}'}",
                    *(_distance(own[place]) for place in PLACES),
                    "" if (simulator, draws) == ("stock", "none") else _difference(said),
                    f"{said['smoothness']:.2f}",
                ]
            )
    return table(["went on in", *places, "difference", "smoothness"], rows)


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
        f"Policies that went on in the identified simulator {said} those that went on in the stock one; their "
        f"reward differs by {minus_stock_reward(own)}. The price is less smooth torques."
    )


def _bar(before: Mapping[str, Any]) -> str:
    ends, reached = [], []
    for own in before.values():
        curve = own["curve"]
        ends.append(curve[-1][1] / 60)
        reached += [point[1] for point in curve if point[3] <= 0.05][:1]
    if len(reached) < len(before):
        return "Not all first policies come within 5 cm in the stock simulator."
    times = f"{min(reached):.0f} to {max(reached):.0f} s"
    return f"First policies come within 5 cm in {times}, of {max(ends):.1f} min at most."
