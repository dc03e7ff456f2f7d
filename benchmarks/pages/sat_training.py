"""The section "What training decides" of docs/building-blocks.md, from `python -m benchmarks sat_training`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.pages.markdown import table
from benchmarks.pages.sat import BARS, ROBOTS, UNSEEN, share

SHORT = {test: label.split(",")[0] for test, label in ROBOTS.items()}
ABOUT = {
    "simulator": "simulator",
    "sat": "`sat`, told no errors",
    "zero": "small, told no errors",
    "switched": "small, told true errors at first, then more and more of its own predictions",
}

TEXT = """## What training decides

The network `sat` above, trained with other seeds; share of the simulator's position error that is gone, mean and
largest, with the paired 95 % interval over the four animations of each robot:

```sh
python -m benchmarks sat_training
```

{seeds}

{missed}

**Losses** (Fig. 12). The same network on {loss_motions} motions, taught with quantiles (0.1, 0.5, 0.9), with absolute
errors (L1), and with L1 and the term that keeps added velocities the slopes of added positions (PL1, eq. 3). Mean
errors on animations of KickBotA that nobody trained on, after each epoch, in degrees and, in brackets, rad/s:

{losses}

**Long runs.** All animations of KickBotB, one after the other, {count} motions of which the first {long_s:g} s are
counted; networks of KickBotA that run open loop. The encoder can be told past errors; where no sensor gives them, these
are the network's own predictions. Beside `sat`, two networks of half its width, trained on {long_motions} motions,
that differ in what they are told. Mean absolute error of the position in each {piece_s:g} s, in degrees:

{long}

{drift}
"""


def part(result: Mapping[str, Any]) -> str:
    """The section as Markdown."""
    return TEXT.format(
        seeds=_seeds(result),
        missed=_missed(result),
        loss_motions=result["loss_motions"],
        losses=_losses(result),
        count=result["long"]["simulator"]["motions"],
        long_s=result["long_s"],
        long_motions=result["long_motions"],
        piece_s=result["piece_s"],
        long=_long(result),
        drift=_drift(result),
    )


def _seeds(result: Mapping[str, Any]) -> str:
    rows = [
        [f"seed {seed}", *(f"{share(own[test]['mae'])}, {share(own[test]['max'])}" for test in SHORT)]
        for seed, own in result["seeds"].items()
    ]
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
    asked = "The 50 % of the mean and 35 % of the largest error that are asked on robots never seen are"
    return f"{asked} missed: {'; '.join(missed)}." if missed else f"{asked} kept by all."


def _losses(result: Mapping[str, Any]) -> str:
    count = max(len(own) for own in result["losses"].values())
    rows = [
        [name, *(f"{epoch['position']:.3f} ({epoch['velocity']:.4f})" for epoch in own)]
        for name, own in result["losses"].items()
    ]
    return table(["", *(f"epoch {number}" for number in range(1, count + 1))], rows)


def _long(result: Mapping[str, Any]) -> str:
    long, piece = result["long"], result["piece_s"]
    starts = [number * piece for number in range(len(long["simulator"]["value"]))]
    rows = [
        [
            ABOUT[name],
            *(
                f"{value:.2f} [{low:.2f}, {high:.2f}]"
                for value, low, high in zip(own["value"], own["low"], own["high"], strict=True)
            ),
        ]
        for name, own in long.items()
    ]
    return table(["", *(f"{start:g} to {start + piece:g} s" for start in starts)], rows)


def _drift(result: Mapping[str, Any]) -> str:
    """What is left of the simulator's error in the first and in the last piece."""
    long = result["long"]
    simulator = long["simulator"]["value"]
    said = [
        f"`{name}` {long[name]['value'][0] / simulator[0]:.0%} and {long[name]['value'][-1] / simulator[-1]:.0%}"
        for name in long
        if name != "simulator"
    ]
    return f"Left of the simulator's error in the first and in the last of them: {', '.join(said)}.".replace("%", " %")
