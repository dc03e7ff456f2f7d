"""The section "What training decides" of docs/building-blocks.md, from `python -m benchmarks sat_training`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.pages.markdown import table
from benchmarks.pages.sat import BARS, ROBOTS, UNSEEN, share

SHORT = {test: label.split()[0] for test, label in ROBOTS.items()}

TEXT = """## What training decides

Share of the mean position error that is gone, with other seeds (`python -m benchmarks sat_training`):

{seeds}

Targets on unseen robots were {missed}

With {loss_motions} motions and {epochs} epochs, the mean error depends on the loss: {losses} degrees. PL1 is L1 with
the paper's physics-informed term.

In runs of {long_s:g} s, `sat` and two smaller networks leave this share of the error in the first and last
{piece_s:g} s: {drift}. `zero` and `sat` are told no past errors; `switched` learns with true errors first, then with
its own predictions.
"""


def part(result: Mapping[str, Any]) -> str:
    """The section as Markdown."""
    return TEXT.format(
        seeds=_seeds(result),
        missed=_missed(result),
        loss_motions=result["loss_motions"],
        epochs=max(len(own) for own in result["losses"].values()),
        losses=_losses(result),
        long_s=result["long_s"],
        piece_s=result["piece_s"],
        drift=_drift(result),
    )


def _seeds(result: Mapping[str, Any]) -> str:
    rows = [[f"seed {seed}", *(share(own[test]["mae"]) for test in SHORT)] for seed, own in result["seeds"].items()]
    return table(["", *SHORT.values()], rows)


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


def _losses(result: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {own[-1]['position']:.3f}" for name, own in result["losses"].items())


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
