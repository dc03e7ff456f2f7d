"""The section "On a robot" of docs/what-compensation-brings.md, from `python -m benchmarks compensation_robot`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.pages.augment_cells import span
from benchmarks.pages.compensation import over_neighbors
from benchmarks.pages.markdown import table

# Reference and metric -> head, factor, digits.
COLUMNS = {
    ("simulator", "mae"): ("mean error [mrad]", 1e3, 1),
    ("simulator", "large_gap_ratio"): ("large gaps [%]", 1e2, 2),
    ("simulator", "smoothness"): ("smoothness [rad/s²]", 1.0, 2),
}
# Test -> what is said of its payloads, and which of them are shown [kg]; the result has others.
TESTS = {
    "test": ("", ("0", "3")),
    "test-200hz": (", targets at 200 Hz", ("3",)),
}
TEXT = """## On a robot

A network for the robot ([how](compensation.md#for-the-robot-itself)), trained so that the robot with its payload moves
as the stock simulator does with empty hands. It runs beside the held-out individual, standing, squatting and walking,
and is told the payload. {seeds} of training, {minutes} min on one core each; the table is of the first
(`benchmarks/results/compensation_robot.json` has all).

```sh
python -m benchmarks compensation_robot
```

Without, with, and the paired difference with its 95 % interval over motions. Errors are to the simulator.

{table}

Motion is rougher: consistency and smoothness are {rougher} times those without. Untrained payloads have
{unseen} times the error of the worse trained neighbor. {spread}
"""


def part(result: Mapping[str, Any]) -> str:
    """The section as Markdown."""
    seeds = result["seeds"]
    tests = next(iter(seeds.values()))["tests"]
    minutes = span((own["minutes"] for own in seeds.values()), 0)
    return TEXT.format(
        seeds=f"{len(seeds)} seeds" if len(seeds) > 1 else "One seed",
        minutes=minutes,
        table=by_payload(tests),
        rougher=span(rougher_by(tests), 1),
        unseen=span(_unseen(tests)),
        spread=_spread(seeds),
    )


def by_payload(tests: Mapping[str, Any]) -> str:
    """A row for each payload at each rate."""
    rows = []
    for test, (said, payloads) in TESTS.items():
        if test in tests:
            for payload in payloads:
                found = tests[test]["payloads"][payload]
                cells = [
                    _cell(found[where][metric], factor, digits)
                    for (where, metric), (_, factor, digits) in COLUMNS.items()
                ]
                rows.append([f"{payload} kg{said}", *cells])
    return table(["", *(head for head, _, _ in COLUMNS.values())], rows)


def _spread(seeds: Mapping[str, Any]) -> str:
    """What another seed of the training would have said."""
    errors = {
        kg: [1e3 * own["tests"]["test"]["payloads"][kg]["simulator"]["mae"]["compensated"] for own in seeds.values()]
        for kg in TESTS["test"][1]
    }
    said = "; ".join(f"{', '.join(f'{error:.1f}' for error in own)} ({kg} kg)" for kg, own in errors.items())
    return f"Mean error by seed [mrad]: {said}."


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
