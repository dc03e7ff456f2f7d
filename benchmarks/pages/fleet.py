"""The section "Fifty robots" of docs/fleet.md, from what `python -m benchmarks fleet` has measured."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from benchmarks.pages.markdown import table

TEXT = """## Fifty robots

{units} individuals of the [lab](virtual-robot.md)'s upper body ({joints} joints), {motions} motions of {seconds:.1f} s
each, three to fit and one to judge; the friction of the last one, {worn}, is {factor:g} times that of its kind. Fitted
are {fitted} numbers of each: stiffness, damping and dry friction of every joint.

```sh
python -m benchmarks fleet
```

{better} of {units} fitted models are better than the stock model on the motion that they were not fitted to: RMSE
{stock:.1f} mrad to {fit:.1f} mrad in the median. {found}

{parameters}

The lab draws friction and springs of each individual anew, and their common effects (elasticity, a friction that falls
with speed, gravity) are in no number of the model: stiffness and friction take up what they can of it, which is why all
units differ from the model in the same direction.

### What it takes

| | per robot | 50 robots, {processes} processes | 10,000 robots |
|---|---|---|---|
| time | {cpu:.0f} s of one core | {wall:.1f} min, measured | {days:.1f} days of one core, {hours:.1f} h on 64 |
| results on disk | {megabytes:.1f} MB | {all_megabytes:.0f} MB | {gigabytes:.0f} GB |
| recordings | {recorded:.0f} s of motion | {recorded_min:.0f} min | {recorded_h:.0f} h of robots at work |

The column of 10,000 is computed from the first: robots share nothing but the disk, so that processors count and nothing
else is known to get in the way; more than {processes} were not at hand to be measured. Cost grows with motion
times parameters: a whole identification of the Panda with its defaults takes minutes, not {cpu:.0f} s.
"""


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
        recorded_min=recorded * count / 60,
        recorded_h=recorded * 1e4 / 3600,
    )


def _parameters(result: Mapping[str, Any]) -> str:
    """Of the left arm; the right one is alike."""
    heads = ["left arm", "unit", "model", "mean [95 %]", "spread", "uncertain by", "units", "not like the others"]
    rows = []
    for row in result["parameters"]:
        if "[left_" not in row["name"]:
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
