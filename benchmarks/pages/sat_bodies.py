"""The section "Rigid bodies" of docs/building-blocks.md, from `python -m benchmarks sat_bodies`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.pages.markdown import table

METRICS = {
    "position_mae": ("position, mean [mm]", 1e3),
    "position_max": ("position, largest [mm]", 1e3),
}

TEXT = """## Rigid bodies

The parts of a virtual KickBotA are not quite where the model has them. Networks for {count} marked bodies were trained
on {train} motions and tested on {test} of other kinds. `{chosen}` is the one that val chose. `-projected` is its
[nearest pose of the model](augmentation.md#bodies-that-come-apart) (`python -m benchmarks sat_bodies`).

{errors}

Targets were 75 % of the mean and 65 % of the largest position error.
"""


def part(result: Mapping[str, Any]) -> str:
    """The section as Markdown."""
    motions = result["motions"]
    return TEXT.format(
        count=len(result["bodies"]),
        train=motions["train"],
        test=motions["test"],
        chosen=result["chosen_on_val"],
        errors=_errors(
            result["tests"][""] if "" in result["tests"] else next(iter(result["tests"].values())),
            result["chosen_on_val"],
        ),
    )


def _errors(test: Mapping[str, Any], chosen: str) -> str:
    heads = ["", *(label for label, _ in METRICS.values())]
    rows = [
        ["simulator", *(f"{unit * test[metric]['simulated']['value']:.2f}" for metric, (_, unit) in METRICS.items())]
    ]
    networks = next(test[metric]["networks"] for metric in METRICS)
    shown = [name for name in networks if not name.endswith("-projected") or name.startswith(chosen)]
    rows += [[f"`{name}`", *_cells(test, name)] for name in shown]
    return table(heads, rows)


def _cells(test: Mapping[str, Any], name: str) -> list[str]:
    return [_cell(test[metric]["networks"][name], unit) for metric, (_, unit) in METRICS.items()]


def _cell(item: Mapping[str, Any], unit: float) -> str:
    cut = item["cut"]
    return (
        f"{unit * item['error']['value']:.2f} "
        f"({100 * cut['value']:.0f} % [{100 * cut['low']:.0f}, {100 * cut['high']:.0f}])"
    )
