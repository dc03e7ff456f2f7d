"""How to use what was fitted and trained: lines to copy."""

from __future__ import annotations

from trueup.report.folder import RunFolder
from trueup.report.network_recipes import in_training_loop, network_recipes
from trueup.report.recipes import Recipe, fit_recipes
from trueup.report.sections.base import Section


def usage_section(run: RunFolder) -> Section | None:
    """Only where fitted files lie beside fit.json, or networks were trained."""
    found = recipes(run)
    return Section("usage", "How to use it: lines to copy", {"recipes": found}) if found else None


def recipes(run: RunFolder) -> list[Recipe]:
    """Of the fit, then of the networks; a loop of steps is there once, with the network if one can go with it."""
    found = []
    if run.fit is not None and run.fitted_files:
        found = fit_recipes(run, run.fit, stepped=not in_training_loop(run))
    return found + network_recipes(run)
