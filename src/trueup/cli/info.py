"""`trueup info` and `trueup robots`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table

from trueup.cli import options
from trueup.cli.console import answer, note, out

_MOST_NAMES = 12


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command("info")(info)
    app.command("robots")(robots)


def info(
    path: Annotated[Path, typer.Argument(help="Logs of any known format, a dataset, a fit, or results of close.")],
    format: options.Format = None,
    mapping: options.Mapping = None,
    unit: options.Units = None,
    command_topic: options.CommandTopic = None,
    measured_topic: options.MeasuredTopic = None,
) -> int:
    """Show what a file or folder holds."""
    from trueup.stages.contents import contents_of

    choices = options.reading(mapping, unit, command_topic, measured_topic)
    found = contents_of(path, format=format, options=choices)
    answer(found)
    for line in _lines(found):
        out.print(line, markup=False)
    for line in [*found.get("notes", ()), *found.get("statements", ())]:
        note(line)
    return 0


def robots() -> int:
    """List the robots that are known by name."""
    from trueup.stages.contents import robots as known

    found = known()
    answer(found)
    table = Table()
    for name in ("robot", "joints", "driven by", "model", ""):
        table.add_column(name, overflow="fold")
    for item in found:
        model = item["model"] if item["model_shipped"] else f"{item['model']} (not shipped)"
        table.add_row(item["name"], str(len(item["joints"])), item["command"], model, escape(item["description"]))
    out.print(table)
    out.print("next: trueup close LOGS --robot NAME; a robot of your own: trueup init MODEL LOGS", markup=False)
    return 0


def _lines(found: Mapping[str, Any]) -> list[str]:
    """What there is, a line each."""
    if found["kind"] in ("dataset", "logs"):
        return _recorded(found)
    if found["kind"] == "fit":
        return _fitted(found)
    if found["kind"] == "model":
        floats = ", a base that floats" if found["free"] else ""
        return [
            f"model: {len(found['joints'])} joints{floats}, {found['actuators']} actuators, {found['mass_kg']:.4g} kg",
            f"joints: {_listed(found['joints'])}",
            f"next: trueup init {found['path']} LOGS",
        ]
    steps = [f"  {step['name']}: {step['status']}: {step['what']}" for step in found["steps"]]
    return [f"results of close --until {found['until']}", *steps, *(_fitted(found["fit"]) if "fit" in found else ())]


def _recorded(found: Mapping[str, Any]) -> list[str]:
    what = f"logs ({found['format']})" if found["kind"] == "logs" else "dataset"
    long = f", {found['seconds']:.0f} s" if "seconds" in found else ""
    whose = f" of {found['robot']}" if found["robot"] else ""
    lines = [f"{what}{whose}: {found['motions']} motions{long}"]
    lines += [f"{name}: {_counted(found[name])}" for name in ("splits", "warnings") if found.get(name)]
    if "joints" in found:
        lines.append(f"{len(found['joints'])} joints: {_listed(found['joints'])}")
    for name in ("measured", "command"):
        if name in found:
            signals = ", ".join(f"{key} [{', '.join(units)}]" for key, units in found[name]["signals"].items())
            rate = found[name]["rate_hz"]
            lines.append(f"{name}: {signals}{f', {rate:g} Hz' if rate else ''}")
        elif "joints" in found:
            lines.append(f"{name}: none")
    if found.get("runs"):
        lines.append(f"simulated: {_listed(found['runs'])}")
    return lines


def _fitted(found: Mapping[str, Any]) -> list[str]:
    counts = _counted(found["parameters"])
    lines = [f"fit: status {found['status']}; parameters determined by the data: {counts or 'none'}"]
    for run, splits in found["errors"].items():
        values = ", ".join(f"{split} {own['value']:.4g} {own['unit']}" for split, own in splits.items())
        lines.append(f"  {run}: {values}")
    for own in found["values"]:
        low, high = own["interval"]
        lines.append(f"  {own['name']} {own['value']:.4g} [{low:.3g}, {high:.3g}] {own['unit']} ({own['identified']})")
    return lines


def _counted(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{key} {count}" for key, count in counts.items())


def _listed(names: Sequence[str]) -> str:
    more = len(names) - _MOST_NAMES
    return ", ".join(names[:_MOST_NAMES]) + (f", and {more} more" if more > 0 else "")
