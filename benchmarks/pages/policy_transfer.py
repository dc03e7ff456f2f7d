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
PLACES = {
    "stock": "stock",
    "identified": "identified",
    "recorded robots": "robots 1 to 3",
    "other robots": "robots 4 to 6",
}
TEXT = """## From simulators to robots

Policies of `--config laptop --steps {steps}`, trained in {rows} simulators ({seeds}), reach for 100 goals in simulators
and on virtual robots. `panda_torque` was identified from 54 motions of robots 1 to 3; 4 to 6 are held out. Only robots
have stiction, load-dependent friction, elastic joints, torque ripple, delays with jitter, noise, and errors of gravity
compensation of up to 0.8 Nm.

```sh
python -m benchmarks policy_transfer
```

Median distance from the goal at the end [cm], and the share of goals reached within 5 cm. On robots 1 to 3: mean
difference to the first row [cm] with 95 % intervals over goals, and over goals and seeds; change of torques from step
to step (*smoothness*). In DART, medians differ by up to {dart:.1f} cm.

{table}

{words}

The [network](compensation.md#robots-that-take-torques) does not improve this simulator: off by 5.1 mrad after half a
second, 5.0 without.

### Twice as long

The main two with the laptop's full {long:,} control steps ({minutes:.0f} min of one core):

{long_table}
"""


def part(result: Mapping[str, Any]) -> str:
    """The section as Markdown."""
    found, config = result["table"], result["provenance"]["config"]
    return TEXT.format(
        rows={1: "one", 2: "two", 3: "three", 4: "four"}[len(found)],
        steps=config["steps"],
        seeds=_seeds(result["policies"]),
        table=_table(found),
        words=_words(found),
        dart=max(
            100 * abs(own["dart"]["median"] - own["identified"]["median"])
            for by_draws in found.values()
            for own in by_draws.values()
        ),
        long=config["long"],
        minutes=mean_minutes(result["long"]),
        long_table=_table(result["long_table"]),
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


def _table(found: Mapping[str, Any]) -> str:
    """Where policies end, what that is against the simulator as it comes, and how they get there."""
    rows = []
    for simulator, by_draws in found.items():
        for draws, own in by_draws.items():
            said = own["recorded robots"]
            rows.append(
                [
                    SIMULATORS[simulator],
                    DRAWS[draws],
                    *(_distance(own[place], success="robots" in place) for place in PLACES),
                    "" if (simulator, draws) == ("stock", "none") else _difference(said),
                    f"{said['smoothness']:.2f}",
                ]
            )
    return table(["trained in", "randomized", *PLACES.values(), "difference", "smoothness"], rows, left=2)


def _distance(own: Mapping[str, Any], *, success: bool) -> str:
    median = f"{100 * own['median']:.1f}"
    return f"{median}, {100 * own['success']:.0f} %" if success else median


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


def _words(found: Mapping[str, Any]) -> str:
    """The bar, as it came out."""
    own = found["identified"]["posterior"]["recorded robots"]
    base = found["stock"]["none"]
    home, away = (100 * item["median"] for item in (base["stock"], found["identified"]["posterior"]["identified"]))
    return (
        "On robots 1 to 3, policies from the identified simulator with its posterior are "
        f"{_verdict(own['minus_stock'])} than those from the stock simulator over goals, "
        f"{_verdict(own['minus_stock_seeds'])} over goals and seeds. They end {away:.1f} cm from the goal in their own "
        f"simulator, the others {home:.1f} cm in theirs. Their reward differs by {minus_stock_reward(own)}."
    )


def _verdict(difference: Sequence[float]) -> str:
    """Whether an interval of a difference in distance excludes zero, and on which side."""
    _, low, high = difference
    return "nearer" if high < 0 else "farther away" if low > 0 else "neither for sure"
