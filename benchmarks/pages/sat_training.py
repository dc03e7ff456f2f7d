"""The section "What training decides" of docs/building-blocks.md, from `python -m benchmarks sat_training`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.pages.sat import BARS, ROBOTS, UNSEEN

SHORT = {test: label.split()[0] for test, label in ROBOTS.items()}

TEXT = """## What training decides

Of the mean position error, {count} seeds remove {seeds} (`python -m benchmarks sat_training`). Targets on unseen robots
were {missed}

Share of the error left in the first and last {piece_s:g} s of {long_s:g} s: {drift}. `sat` and the smaller `zero` are
told no past errors; `switched` learns with true errors first, then with its own predictions.
"""


def part(result: Mapping[str, Any]) -> str:
    """The section as Markdown."""
    return TEXT.format(
        seeds=_seeds(result),
        missed=_missed(result),
        count=len(result["seeds"]),
        long_s=result["long_s"],
        piece_s=result["piece_s"],
        drift=_drift(result),
    )


def _seeds(result: Mapping[str, Any]) -> str:
    """From the least to the largest, of each robot."""
    gone = {name: [own[test]["mae"]["value"] for own in result["seeds"].values()] for test, name in SHORT.items()}
    return ", ".join(f"{100 * min(own):.0f} to {100 * max(own):.0f} % on {name}" for name, own in gone.items())


def _missed(result: Mapping[str, Any]) -> str:
    """Which seeds stay below what is asked of `sat` on robots that it never saw."""
    missed = [
        f"seed {seed} by the {words} error on {SHORT[test]} ({own[test][metric]['value']:.0%})".replace("%", " %")
        for seed, own in result["seeds"].items()
        for test in UNSEEN
        for metric, words in (("mae", "mean"), ("max", "largest"))
        if own[test][metric]["value"] < BARS[metric]
    ]
    return f"missed: {'; '.join(missed)}." if missed else "all kept."


def _drift(result: Mapping[str, Any]) -> str:
    """What is left of the simulator's error in the first and in the last piece."""
    long = result["long"]
    simulator = long["simulator"]["value"]
    said = [
        f"`{name}` {long[name]['value'][0] / simulator[0]:.0%} and {long[name]['value'][-1] / simulator[-1]:.0%}"
        for name in long
        if name != "simulator"
    ]
    return ", ".join(said).replace("%", " %")
