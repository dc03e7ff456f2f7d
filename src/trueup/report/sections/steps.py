"""How the result was made: the steps of a close, one after the other."""

from __future__ import annotations

from trueup.report.folder import RunFolder
from trueup.report.sections.base import Section
from trueup.report.sections.cells import seconds_cell

_SIGNS = {"done": "✓", "kept": "✓", "cut short": "◐", "left out": "–", "failed": "▲"}


def steps_section(run: RunFolder) -> Section | None:
    """Only after a close."""
    if run.close is None or not run.close.steps:
        return None
    rows = [
        (step.name, f"{_SIGNS[step.status]} {step.status}", step.status, seconds_cell(step.seconds).text, step.what)
        for step in run.close.steps
    ]
    total = sum(step.seconds for step in run.close.steps)
    budget = run.close.budget_s
    words = f"{seconds_cell(total).text} in all"
    if budget is not None:
        words += f", of {seconds_cell(budget).text} that were given"
    return Section("steps", "Steps: how this was made", {"rows": rows, "words": words})
