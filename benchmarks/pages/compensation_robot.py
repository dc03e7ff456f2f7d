"""The section "On a robot" of docs/what-compensation-brings.md, from `python -m benchmarks compensation_robot`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.pages.augment_cells import span
from benchmarks.pages.compensation import over_neighbors
from benchmarks.pages.markdown import table

# Reference -> title, how many of the metrics.
REFERENCES = {
    "simulator": ("Against the simulator with empty hands", 6),
    "target": ("Against the targets", 2),
}
# Metric -> head, factor, digits.
METRICS = {
    "mae": ("mean error [mrad]", 1e3, 1),
    "large_gap_ratio": ("large gaps [%]", 1e2, 2),
    "iqr": ("interquartile range [mrad]", 1e3, 1),
    "range": ("range [mrad]", 1e3, 0),
    "trajectory_consistency": ("consistency [rad/s²]", 1.0, 2),
    "smoothness": ("smoothness [rad/s²]", 1.0, 2),
}
TESTS = {"test": "50 Hz", "test-unseen-payload": "50 Hz, payload never trained", "test-200hz": "targets at 200 Hz"}
TEXT = """## On a robot

A network for the robot, trained on the identified simulator of three individuals so that the robot moves as the stock
simulator does with empty hands ([how](compensation.md#for-the-robot-itself)), beside a fourth individual of the virtual
hardware that no training has seen, on motions that none has seen, standing, squatting and walking. The same motions
were recorded without it. It is told what is carried. {seeds} of training: {minutes} min on one core; the tables are of
the first.

```sh
python -m benchmarks compensation_robot
```

Each cell: without, with, and the difference with its 95 % interval over whole motions, paired. Large gaps are errors of
{tau:g} rad and more.

{tables}

Positions come nearer; accelerations do not: with what the network adds, consistency and smoothness, which are
differences of accelerations, are {rougher} times those without. With payloads that were never trained, the mean error
to the simulator is {unseen} times that of the worse of the trained neighbors.

{spread}

The third figure of Table 2, robustness, is the noise that it adds, and says nothing of a robot ([why](metrics.md)).
"""


def part(result: Mapping[str, Any]) -> str:
    """The section as Markdown."""
    seeds = result["seeds"]
    tests = next(iter(seeds.values()))["tests"]
    minutes = ", ".join(f"{own['minutes']:.0f}" for own in seeds.values())
    return TEXT.format(
        seeds=f"{len(seeds)} seeds" if len(seeds) > 1 else "One seed",
        minutes=minutes,
        tau=result["tau_rad"],
        rougher=span(rougher_by(tests), 1),
        unseen=span(_unseen(tests)),
        spread=_spread(seeds),
        tables="\n\n".join(
            f"### {title}\n\n{by_payload(tests, reference, count)}" for reference, (title, count) in REFERENCES.items()
        ),
    )


def by_payload(tests: Mapping[str, Any], reference: str, count: int) -> str:
    """A row for each payload at each rate, a column for each of the first metrics."""
    shown, rows = dict(list(METRICS.items())[:count]), []
    for test, title in TESTS.items():
        if test in tests:
            for payload, references in tests[test]["payloads"].items():
                found = references[reference]
                cells = [_cell(found[metric], factor, digits) for metric, (_, factor, digits) in shown.items()]
                rows.append([payload, title, *cells])
    return table(["kg", "", *(head for head, _, _ in shown.values())], rows, left=2)


def _spread(seeds: Mapping[str, Any]) -> str:
    """What another seed of the training would have said."""
    payloads = next(iter(seeds.values()))["tests"]["test"]["payloads"]
    errors = {
        kg: [1e3 * own["tests"]["test"]["payloads"][kg]["simulator"]["mae"]["compensated"] for own in seeds.values()]
        for kg in payloads
    }
    said = "; ".join(f"{', '.join(f'{error:.1f}' for error in own)} mrad at {kg} kg" for kg, own in errors.items())
    return f"From seed to seed, the mean error to the simulator is {said}."


def rougher_by(tests: Mapping[str, Any]) -> list[float]:
    """How many times rougher accelerations are with a network, by test, payload and metric."""
    return [
        found["simulator"][metric]["compensated"] / found["simulator"][metric]["plain"]
        for own in tests.values()
        for found in own["payloads"].values()
        for metric in ("trajectory_consistency", "smoothness")
    ]


def _unseen(tests: Mapping[str, Any]) -> list[float]:
    seen, unseen = (
        {float(kg): found["simulator"]["mae"]["compensated"] for kg, found in tests[name]["payloads"].items()}
        for name in ("test", "test-unseen-payload")
    )
    return over_neighbors(seen, unseen)


def _cell(found: Mapping[str, Any], factor: float, digits: int) -> str:
    before, after = (format(factor * found[name], f".{digits}f") for name in ("plain", "compensated"))
    difference: Sequence[float | None] = found["difference"]
    if any(value is None for value in difference):
        return f"{before} to {after}"
    value, low, high = (format(factor * item, f"+.{digits}f") for item in difference if item is not None)
    return f"{before} to {after}: {value} [{low}, {high}]".replace("-", "\N{MINUS SIGN}")
