"""The section "From simulators to robots" of docs/policy-transfer.md, from `python -m benchmarks policy_transfer`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.pages.markdown import table

SIMULATORS = {
    "stock": "stock",
    "identified": "identified",
    "augmented": "identified + network",
    "thesis": "friction in actions",
}
DRAWS = {"none": "none", "thesis": "thesis", "posterior": "posterior"}
HEADS = ("trained in, randomized by", "distance [cm] (reached)", "difference [cm]")
TEXT = """## From simulators to robots

Policies of `--config laptop --steps {steps}`, trained in {rows} simulators ({seeds}), reach for 100 goals on virtual
robots. `panda_torque` was identified from 54 motions of robots 1 to 3. Only robots have stiction, load-dependent
friction, elastic joints, torque ripple, delays with jitter, noise, and errors of gravity compensation of up to 0.8 Nm.

```sh
python -m benchmarks policy_transfer
```

On robots 1 to 3: median distance at the end, goals reached within 5 cm, and mean difference to *stock* with 95 %
intervals over goals, and over goals and seeds. On the held-out robots 4 to 6, medians differ by up to {away:.1f} cm.
{long:,} steps take {minutes:.0f} min of one core. `benchmarks/results/policy_transfer.json` has more.

{table}

{words}

The [network](compensation.md#robots-that-take-torques) does not improve this simulator: off by 5.1 mrad after half a
second, 5.0 without.
"""


def part(result: Mapping[str, Any]) -> str:
    """The section as Markdown."""
    found, config = result["table"], result["provenance"]["config"]
    return TEXT.format(
        rows={1: "one", 2: "two", 3: "three", 4: "four"}[len(found)],
        steps=config["steps"],
        seeds=_seeds(result["policies"]),
        table=table(HEADS, [*_rows(found), *_rows(result["long_table"], f", {config['long']:,} steps")]),
        words=_words(result),
        away=max(
            100 * abs(own["recorded robots"]["median"] - own["other robots"]["median"])
            for by_draws in found.values()
            for own in by_draws.values()
        ),
        long=config["long"],
        minutes=mean_minutes(result["long"]),
    )


def mean_minutes(policies: Mapping[str, Any]) -> float:
    """Minutes of one core that a training took."""
    trainings = [
        own["training"] for by_draws in policies.values() for cell in by_draws.values() for own in cell.values()
    ]
    return sum(training["cpu_minutes"] for training in trainings) / len(trainings)


def _seeds(policies: Mapping[str, Any]) -> str:
    """How many seeds there are of each simulator."""
    counts: dict[int, list[str]] = {}
    for name, by_draws in policies.items():
        counts.setdefault(max(len(by_seed) for by_seed in by_draws.values()), []).append(SIMULATORS[name])
    return ", ".join(f"{count} seed{'s' * (count > 1)} of {' and '.join(names)}" for count, names in counts.items())


def _rows(found: Mapping[str, Any], more: str = "") -> list[list[str]]:
    """Where policies end, and what that is against the simulator as it comes."""
    rows = []
    for simulator, by_draws in found.items():
        for draws, own in by_draws.items():
            said = own["recorded robots"]
            rows.append(
                [
                    f"{SIMULATORS[simulator]}{'' if draws == 'none' else f', {DRAWS[draws]}'}{more}",
                    f"{100 * said['median']:.1f} ({100 * said['success']:.0f} %)",
                    "" if (simulator, draws) == ("stock", "none") else _difference(said),
                ]
            )
    return rows


def _difference(own: Mapping[str, Any]) -> str:
    value, low, high = (100 * item for item in own["minus_stock"])
    _, least, most = (100 * item for item in own["minus_stock_seeds"])
    said = f"{value:+.2f} [{low:+.2f}, {high:+.2f}]"
    # One training says nothing of another.
    if len(own["by_seed"]) > 1:
        said += f" [{least:+.2f}, {most:+.2f}]"
    return said.replace("-", "\N{MINUS SIGN}")


def minus_stock_reward(own: Mapping[str, Any]) -> str:
    """The difference in reward, with its interval over goals."""
    return "{:+.3f} [{:+.3f}, {:+.3f}]".format(*own["minus_stock_reward"]).replace("-", "\N{MINUS SIGN}")


def _words(result: Mapping[str, Any]) -> str:
    """The bar, as it came out."""
    found = result["table"]
    own = found["identified"]["posterior"]["recorded robots"]
    base = found["stock"]["none"]
    home, away = (100 * item["median"] for item in (base["stock"], found["identified"]["posterior"]["identified"]))
    return (
        "Policies from the identified simulator with its posterior are "
        f"{_verdict(own['minus_stock'])} than those from the stock simulator over goals, "
        f"{_verdict(own['minus_stock_seeds'])} over goals and seeds. They end {away:.1f} cm from the goal in their own "
        f"simulator, the others {home:.1f} cm in theirs. Their reward differs by {minus_stock_reward(own)}. "
        f"{_missed(result)}"
    )


def _missed(result: Mapping[str, Any]) -> str:
    """The bar, that they come nearer, with both numbers of steps."""
    tables = (result["table"], result["long_table"])
    highs = [own["identified"]["posterior"]["recorded robots"]["minus_stock"][2] for own in tables]
    missed = sum(high > 0 for high in highs)
    if not missed:
        return "Bar: nearer, over goals; kept."
    return f"Bar: nearer, over goals; **missed** with {missed} of {len(highs)} numbers of steps."


def _verdict(difference: Sequence[float]) -> str:
    """Whether an interval of a difference in distance excludes zero, and on which side."""
    _, low, high = difference
    return "nearer" if high < 0 else "farther away" if low > 0 else "neither for sure"
