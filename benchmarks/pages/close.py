"""The section "On a real arm" of docs/close.md, from what `python -m benchmarks close` has measured."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.pages.markdown import table

TEXT = """## On a real arm

The command at the top took {seconds} on {machine} (`python -m benchmarks close`). Position RMSE [mrad] with 95 %
intervals over motions; **{best}** is the best on val:

{ladder}

{steps}

Status of the fit: `{fit}`.

`trueup demo --full` took {demo}. Test errors: command {demo_command}, stock {demo_stock}, fitted {demo_fitted}
mrad. Best on val: `{demo_best}`. Status of the fit: `{demo_fit}`.
"""
_SPLITS = ("train", "val", "test")


def part(result: Mapping[str, Any]) -> str:
    """The part of the page that belongs to a result."""
    so101, demo = result["so101"], result["demo"]
    return TEXT.format(
        machine=result["provenance"]["config"]["machine"]["name"],
        seconds=_minutes(so101["seconds"]),
        ladder=_ladder(so101["ladder"]),
        best=next(rung["name"] for rung in so101["ladder"] if rung["chosen"]),
        steps=_steps(so101),
        fit=so101["fit"],
        demo=_minutes(demo["seconds"]),
        demo_best=next(rung["name"] for rung in demo["ladder"] if rung["chosen"]),
        demo_fit=demo["fit"],
        **{f"demo_{name}": demo_mrad(result, name) for name in ("command", "stock", "fitted")},
    )


def demo_mrad(result: Mapping[str, Any], name: str) -> str:
    """The error of a rung of the demo on test [mrad], as the pages say it."""
    (rung,) = (rung for rung in result["demo"]["ladder"] if rung["name"] == name)
    return f"{1e3 * rung['errors']['test']['value']:.1f}"


def _ladder(rungs: list[dict[str, Any]]) -> str:
    rows = []
    for rung in rungs:
        name = f"**{rung['name']}**" if rung["chosen"] else rung["name"]
        rows.append([name, *(_error(rung["errors"].get(split)) for split in _SPLITS), f"{rung['seconds']:.0f}"])
    return table(["rung", *_SPLITS, "seconds"], rows)


def _error(estimate: Mapping[str, Any] | None) -> str:
    if estimate is None:
        return ""
    ends = [estimate.get(end) for end in ("low", "high")]
    interval = (
        "" if None in ends else " [{:.1f}, {:.1f}]".format(*(1e3 * float(end) for end in ends if end is not None))
    )
    return f"{1e3 * estimate['value']:.1f}{interval}"


def _steps(call: Mapping[str, Any]) -> str:
    rows = [
        [step["name"], step["status"], step["what"].replace("|", "\\|"), f"{step['seconds']:.0f}"]
        for step in call["steps"]
    ]
    return table(["step", "status", "what came of it", "seconds"], rows, left=3)


def _minutes(seconds: float) -> str:
    return f"{seconds / 60:.1f} min"
