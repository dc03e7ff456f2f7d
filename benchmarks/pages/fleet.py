"""The section "Fifty robots" of docs/fleet.md, from what `python -m benchmarks fleet` has measured."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from benchmarks.pages.markdown import table

TEXT = """## Fifty robots

An example (`python -m benchmarks fleet`): {units} [virtual upper bodies](virtual-robot.md) with {joints} joints,
{motions} motions of {seconds:.1f} s each, three to fit and one to judge. The friction of the last one, {worn}, is
{factor:g} times that of its kind. Fitted are stiffness, damping and dry friction of every joint, {fitted} numbers
for each robot.

{better} of {units} fitted models are better than the stock model on the held-out motion; the median RMSE falls from
{stock:.1f} to {fit:.1f} mrad. {found}

{parameters}

All units differ from the model in the same direction: stiffness and friction take up effects that the fitted
numbers do not contain (elasticity, a friction that falls with speed, gravity).

Each robot, with {recorded:.0f} s of motion, took {cpu:.0f} s of one core and {megabytes:.1f} MB of disk; all
{units} took {wall:.1f} min in {processes} processes and {all_megabytes:.0f} MB. Computed from that, 10,000 robots
need {days:.1f} days of one core ({hours:.1f} h on 64) and {gigabytes:.0f} GB. A fit of the Panda with its defaults
takes minutes, not {cpu:.0f} s.
"""
# Joints that are shown.
_SHOWN = ("left_shoulder_yaw", "left_elbow")


def part(result: Mapping[str, Any]) -> str:
    """The part of the page that belongs to a result."""
    units, count = result["units"], len(result["units"])
    errors = {name: np.array([unit["errors"][name]["test"] for unit in units]) for name in ("stock", "fitted")}
    friction = [row["name"] for row in result["parameters"] if result["worn"] in row["apart"]]
    others = sum(len(set(row["apart"]) - {result["worn"]}) for row in result["parameters"])
    found = f"{result['worn']} is not like the others in {', '.join(f'`{name}`' for name in friction)}"
    compared = sum(row["units"] for row in result["parameters"]) - len(friction)
    cpu = result["cpu_s"] / count
    own = result["bytes"] / count / 1e6
    recorded = result["motion_s"] * result["motions"] / count
    return TEXT.format(
        units=count,
        joints=result["joints"],
        motions=result["motions"] // count,
        seconds=result["motion_s"],
        worn=result["worn"],
        factor=result["factor"],
        fitted=result["fitted"],
        better=int((errors["fitted"] < errors["stock"]).sum()),
        stock=1e3 * float(np.median(errors["stock"])),
        fit=1e3 * float(np.median(errors["fitted"])),
        found=f"{found if friction else 'The worn one is not found'}. Of the {compared} other comparisons, "
        f"{others} are false alarms: they name a unit that is ordinary.",
        parameters=_parameters(result),
        processes=result["processes"],
        cpu=cpu,
        wall=result["wall_s"] / 60,
        days=1e4 * cpu / 86400,
        hours=1e4 * cpu / 3600 / 64,
        megabytes=own,
        all_megabytes=result["bytes"] / 1e6,
        gigabytes=own * 10,
        recorded=recorded,
    )


def _parameters(result: Mapping[str, Any]) -> str:
    """Of some joints; the others are alike."""
    heads = ["parameter", "unit", "model", "mean [95 %]", "spread", "uncertain by", "units", "not like the others"]
    rows = []
    for row in result["parameters"]:
        if row["name"].partition("[")[2].rstrip("]") not in _SHOWN:
            continue
        scale, sign = (100.0, " %") if row["relative"] else (1.0, "")
        rows.append(
            [
                f"`{row['name']}`",
                row["unit"],
                "" if row["nominal"] is None else f"{row['nominal']:.3g}",
                f"{row['mean']:.3g} [{row['low']:.3g}, {row['high']:.3g}]",
                f"{scale * row['spread']:.2g}{sign}",
                f"{scale * row['uncertainty']:.2g}{sign}",
                str(row["units"]),
                ", ".join(row["apart"]),
            ]
        )
    return table(heads, rows)
