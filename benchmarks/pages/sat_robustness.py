"""The section "How far it carries" of docs/building-blocks.md, from `python -m benchmarks sat_robustness`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.pages.markdown import table

SIZES = {
    "resistance": "resistance, 30 %",
    "mass": "masses, 50 %",
    "center of mass": "centers of mass, 10 mm",
    "joint positions": "joint positions, 2 mm",
    "all of these": "masses, 50 %, centers of mass, 10 mm, joint positions, 2 mm",
}
BARS = {"0.5": 0.50, "1.0": 0.25}

TEXT = """## How far it carries

If KickBotB's animations are played {speeds} times as fast, `sat` removes {gone} % of the mean position error.

[Simulators with perturbed parameters](augmentation.md#how-far-a-correction-carries) (`sat` for servos, `lstm-bodies`
for bodies): share of the mean position error that is gone, at half of the standard deviation s and at s, for what harms
most (`python -m benchmarks sat_robustness`):

{perturbed}

Targets were 50 % and 25 %. {verdict}
"""


def part(result: Mapping[str, Any]) -> str:
    """The section as Markdown."""
    return TEXT.format(
        speeds=", ".join(result["speeds"]),
        gone=", ".join(f"{100 * item['mae']['value']:.0f}" for item in result["speeds"].values()),
        perturbed=_perturbed(result),
        verdict=_verdict(result),
    )


def _perturbed(result: Mapping[str, Any]) -> str:
    rows = []
    for kind in ("servos", "bodies"):
        name, shares = min(result[kind].items(), key=lambda item: item[1]["1.0"]["mae"]["value"])
        rows.append([f"{kind}: {SIZES[name]}", *(_gone(item["mae"]) for item in shares.values())])
    return table(["perturbed, s", "s / 2", "s"], rows)


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
