"""The section "How far it carries" of docs/building-blocks.md, from `python -m benchmarks sat_robustness`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.pages.markdown import table

SIZES = {
    "resistance": "resistance, s = 0.3 of it",
    "mass": "masses, s = 0.5 of them",
    "center of mass": "centers of mass, s = 10 mm",
    "joint positions": "joint positions, s = 2 mm",
    "all of these": "all of these",
}
BARS = {"0.5": 0.50, "1.0": 0.25}

TEXT = """## How far it carries

KickBotB's animations at several times their speed, up to far beyond what its servos can do, and what `sat` leaves of
the simulator's position error (Fig. 9):

{speeds}

Simulators that are off: masses, centers of mass, positions of joints and the resistance of the motors are drawn anew
around those of the model, {draws} times, at the largest spread s and at half of it; {motions} test motions each
(Fig. 10; the spreads of the paper stand in a figure only, these are ours). Networks are those above, `sat` for the
servos of KickBotB, `lstm-bodies` for the bodies of KickBotA; none was trained on a simulator that is off.

```sh
python -m benchmarks sat_robustness
```

{perturbed}

The same of networks, robots and recordings of yours, with figures, says
[`trueup augment robustness`](augmentation.md#how-far-a-correction-carries).

Asked were 50 % of the mean error at half of the largest spread and 25 % at the largest. {verdict}
"""


def part(result: Mapping[str, Any]) -> str:
    """The section as Markdown."""
    return TEXT.format(
        draws=result["draws"],
        motions=result["motions"],
        speeds=_speeds(result["speeds"]),
        perturbed=_perturbed(result),
        verdict=_verdict(result),
    )


def _speeds(speeds: Mapping[str, Any]) -> str:
    heads = ["speed", "simulator, mean [deg]", "corrected", "gone", "simulator, largest", "corrected", "gone"]
    rows = []
    for speed, item in speeds.items():
        cells = [[f"{item[m]['simulator']:.2f}", f"{item[m]['corrected']:.2f}", _gone(item[m])] for m in ("mae", "max")]
        rows.append([f"{speed}x", *cells[0], *cells[1]])
    return table(heads, rows)


def _perturbed(result: Mapping[str, Any]) -> str:
    rows = []
    for kind, unit in (("servos", "deg"), ("bodies", "mm")):
        for name, shares in result[kind].items():
            cells = [
                f"{item['mae']['simulator']:.2f} to {item['mae']['corrected']:.2f} {unit}, {_gone(item['mae'])}"
                for item in shares.values()
            ]
            rows.append([kind, SIZES[name], *cells])
    return table(["", "largest spread", "at half of it", "at the largest"], rows, left=2)


def _gone(item: Mapping[str, float]) -> str:
    return f"{100 * item['value']:.0f} % [{100 * item['low']:.0f}, {100 * item['high']:.0f}]"


def _verdict(result: Mapping[str, Any]) -> str:
    missed = [
        f"{kind}, {name} at {'half' if share == '0.5' else 'the largest'}"
        for kind in ("servos", "bodies")
        for name, shares in result[kind].items()
        for share, item in shares.items()
        if item["mae"]["value"] < BARS[share]
    ]
    return f"Missed: {'; '.join(missed)}." if missed else "Both are kept everywhere."
