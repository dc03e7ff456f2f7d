"""The section "Going on after identification" of docs/policy-transfer.md, from `benchmarks policy_going_on`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.pages.markdown import table
from benchmarks.pages.policy_transfer import DRAWS, SIMULATORS, mean_minutes, minus_stock_reward
from benchmarks.policy_going_on import table as tabulated

PLACES = {
    "stock": "MuJoCo, as it comes",
    "identified": "MuJoCo, identified",
    "dart": "DART, identified",
    "own robot": "its robot",
    "other robots": "robots {strangers}",
}
_SIMULATORS = {"stock": "in the simulator as it comes", "identified": "in the one that was identified"}
MINUTES = (1, 2, 3, 4, 6, 8, 10)
TEXT = """## Going on after identification

From nothing, policies differ more by their seed than by their simulator. But a policy is rarely trained once: the first
one is there before anything is identified, and what it does on the robot is what can be identified from best. So here
each of robots {robots} has a seed. Its first policy is trained as the simulator comes (`--config laptop`), and drives
it to {driven} goals (`trueup deploy run --out`); from these logs the robot is identified, all within a few minutes; and
the policy goes on from where it was (`trueup policy train --start`, as many control steps again, {minutes:.0f} min of
one core),
{where}.
Judged on 100 goals that were drawn anew.

```sh
python -m benchmarks policy_going_on
```

Mean distance from the goal at the end [cm], the median, the worst, and how many of a hundred end within 5 cm:

{distances}

The same against policies that went on in the simulator as it comes, without randomization: mean over goals of the
difference [cm], paired by goal and robot. Below zero is nearer. The first interval (95 %) is over goals: of these
policies on these robots. The second is over goals and robots, each of which has a seed and a first policy of its own:
of such robots and trainings.

{differences}

On their robots, how they get there:

{manners}

{words}

### The curve

The trainings of `--config laptop` that all go on from: median distance [cm] of 64 goals in the simulator as it comes,
after minutes of one core.

{curve}

{bar}
"""


def part(result: Mapping[str, Any]) -> str:
    """The section as Markdown."""
    found, config = tabulated(result["policies"]), result["provenance"]["config"]
    heads = [name.format(strangers=_range(config["strangers"])) for name in PLACES.values()]
    return TEXT.format(
        robots=_range([int(unit) for unit in result["before"]]),
        driven=config["driven"],
        minutes=mean_minutes(result["policies"]),
        where=_where(found),
        distances=_each(found, heads, _distance),
        differences=_each(found, heads, _difference, but=("stock", "none")),
        manners=_manners(found),
        words=_words(found),
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
    return "; or ".join(said)


def _range(numbers: Sequence[int]) -> str:
    return f"{numbers[0]} to {numbers[-1]}"


def _each(found: Mapping[str, Any], heads: Sequence[str], cell: Any, but: tuple[str, str] | None = None) -> str:
    rows = [
        [SIMULATORS[simulator], DRAWS[draws], *(cell(own[place]) for place in PLACES)]
        for simulator, by_draws in found.items()
        for draws, own in by_draws.items()
        if (simulator, draws) != but
    ]
    return table(["went on in", "randomized", *heads], rows, left=2)


def _distance(own: Mapping[str, Any]) -> str:
    median, worst = 100 * own["median"], 100 * own["worst"]
    return f"**{100 * own['mean']:.2f}**<br>{median:.2f}, {worst:.0f}<br>{100 * own['success']:.1f} %"


def _difference(own: Mapping[str, Any]) -> str:
    value, low, high = (100 * item for item in own["minus_stock"])
    _, least, most = (100 * item for item in own["minus_stock_robots"])
    said = f"{value:+.2f}<br>[{low:+.2f}, {high:+.2f}]<br>[{least:+.2f}, {most:+.2f}]"
    return said.replace("-", "\N{MINUS SIGN}")


def _manners(found: Mapping[str, Any]) -> str:
    heads = [
        "went on in",
        "randomized",
        "reward of a control step",
        "minus stock",
        "overshoot [cm]",
        "smoothness",
        "too fast [%]",
    ]
    rows = []
    for simulator, by_draws in found.items():
        for draws, own in by_draws.items():
            item = own["own robot"]
            rows.append(
                [
                    SIMULATORS[simulator],
                    DRAWS[draws],
                    f"{item['reward']:.3f}".replace("-", "\N{MINUS SIGN}"),
                    "" if (simulator, draws) == ("stock", "none") else minus_stock_reward(item),
                    f"{100 * item['overshoot']:.1f}",
                    f"{item['smoothness']:.3f}",
                    f"{100 * item['velocity_violation']:.1f}",
                ]
            )
    return table(heads, rows, left=2)


def _words(found: Mapping[str, Any]) -> str:
    """The bars, as they came out."""
    own = found["identified"]["posterior"]["own robot"]
    value, low, high = (f"{100 * item:+.2f}".replace("-", "\N{MINUS SIGN}") for item in own["minus_stock"])
    least, most = (f"{100 * item:+.2f}".replace("-", "\N{MINUS SIGN}") for item in own["minus_stock_robots"][1:])
    said = "beat" if own["minus_stock"][2] < 0 else "are worse than" if own["minus_stock"][1] > 0 else "do not beat"
    return (
        f"Policies that went on in the identified simulator, with draws from its posterior, {said} those that went on "
        f"in it as it came: {value} cm [{low}, {high}] on their robots, over goals, and within "
        f"[{least}, {most}] over goals and robots. They bring them within {100 * own['median']:.1f} cm (median)."
    )


def _at(curve: Sequence[Sequence[float]], minutes: float) -> float | None:
    """Distance in the last round that was done by then [m]."""
    done = [point[3] for point in curve if point[1] <= 60 * minutes]
    return done[-1] if done else None


def _curve(before: Mapping[str, Any]) -> str:
    rows = []
    for seed, own in enumerate(before.values()):
        curve = own["curve"]
        cells = [_at(curve, minutes) for minutes in MINUTES]
        rows.append(
            [f"seed {seed}", *("" if one is None else f"{100 * one:.1f}" for one in cells), f"{100 * curve[-1][3]:.1f}"]
        )
    return table(["", *(f"{minutes} min" for minutes in MINUTES), "end"], rows)


def _bar(before: Mapping[str, Any]) -> str:
    ends, reached = [], []
    for own in before.values():
        curve = own["curve"]
        ends.append(curve[-1][1] / 60)
        reached += [next((point[1] for point in curve if point[3] <= 0.05), None)]
    if any(seconds is None for seconds in reached):
        return "Not all of them come within 5 cm."
    said = ", ".join(f"{seconds:.0f}" for seconds in reached)
    return (
        f"All come within 5 cm: after {said} s of one core (of {max(ends):.1f} min at most; the bar is 60 min on two)."
    )
