"""The section "Rigid bodies" of docs/building-blocks.md, from `python -m benchmarks sat_bodies`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.pages.markdown import table

METRICS = {
    "position_mae": ("position, mean [mm]", 1e3),
    "position_max": ("position, largest [mm]", 1e3),
    "rotation_mae": ("rotation, mean [deg]", 57.29578),
    "rotation_max": ("rotation, largest [deg]", 57.29578),
}

TEXT = """## Rigid bodies

A virtual KickBotA whose parts sit beside where the model has them, with {count} marked bodies. Networks are trained on
{train} random fields of all joints, chosen on {val} others, and tested on {test} motions of other kinds (from point to
point, and sums of sines) of the same unit. In brackets the share of the simulator's error that is gone, with its paired
95 % interval over motions. `{chosen}` is the one that val chose.

```sh
python -m benchmarks sat_bodies
```

{errors}

Asked were 75 % of the mean and 65 % of the largest position error; the paper has 8.72 to 1.90 mm and 17.52 to 5.03 mm
(Table I). What comes apart at joints, and what a projection onto the model costs, says
[bodies that come apart](augmentation.md#bodies-that-come-apart).
"""


def part(result: Mapping[str, Any]) -> str:
    """The section as Markdown."""
    motions = result["motions"]
    return TEXT.format(
        count=len(result["bodies"]),
        train=motions["train"],
        val=motions["val"],
        test=motions["test"],
        chosen=result["chosen_on_val"],
        errors=_errors(result["tests"][""] if "" in result["tests"] else next(iter(result["tests"].values()))),
    )


def _errors(test: Mapping[str, Any]) -> str:
    heads = ["", *(label for label, _ in METRICS.values())]
    rows = [
        ["simulator", *(f"{unit * test[metric]['simulated']['value']:.2f}" for metric, (_, unit) in METRICS.items())]
    ]
    networks = next(test[metric]["networks"] for metric in METRICS)
    rows += [[f"`{name}`", *_cells(test, name)] for name in networks]
    return table(heads, rows)


def _cells(test: Mapping[str, Any], name: str) -> list[str]:
    return [_cell(test[metric]["networks"][name], unit) for metric, (_, unit) in METRICS.items()]


def _cell(item: Mapping[str, Any], unit: float) -> str:
    cut = item["cut"]
    return (
        f"{unit * item['error']['value']:.2f} "
        f"({100 * cut['value']:.0f} % [{100 * cut['low']:.0f}, {100 * cut['high']:.0f}])"
    )
