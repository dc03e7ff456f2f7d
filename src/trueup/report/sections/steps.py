"""How the result was made: the steps of a close, one after the other."""

from __future__ import annotations

from trueup.core.close_result import CloseResult
from trueup.report.fit_words import listed
from trueup.report.folder import RunFolder
from trueup.report.numbers import plural
from trueup.report.sections.base import Section
from trueup.report.sections.cells import seconds_cell

_SIGNS = {"done": "✓", "kept": "✓", "cut short": "◐", "left out": "–", "failed": "▲"}
# The method that has nothing to learn.
_NOT_LEARNED = "moving-average"
# Worst first: status -> what is said of the steps that have it.
_LACKING = {"failed": "failed", "left out": "left out", "cut short": "cut short by the time limit"}


def steps_section(run: RunFolder) -> Section | None:
    """Only after a close."""
    if run.close is None or not run.close.steps:
        return None
    rows = [
        (step.name, f"{_SIGNS[step.status]} {step.status}", step.status, seconds_cell(step.seconds).text, step.what)
        for step in run.close.steps
    ]
    context = {"rows": rows, "words": f"{time_words(run.close)}. {alone_words(run.close)}"}
    return Section("steps", "Steps: how this was made", {**context, "alert": steps_alert(run.close)})


def steps_alert(close: CloseResult) -> str:
    """What stands first on the page where a step is not what it was asked to be; empty if all are."""
    parts = []
    for status, words in _LACKING.items():
        names = [step.name for step in close.steps if step.status == status]
        if names:
            parts.append(f"{listed(names)} {words}")
    if not parts:
        return ""
    count = sum(step.status in _LACKING for step in close.steps)
    return f"{plural(count, 'step')} of this result did not go to the end: {'; '.join(parts)}."


def time_words(close: CloseResult) -> str:
    """How long everything took, and how long it was given."""
    words = f"{seconds_cell(close.seconds).text} in all"
    if close.measuring_s:
        words += ", the last measurement included"
    if any(step.status == "kept" for step in close.steps):
        return f"{words}, in several calls"
    if close.budget_s is not None:
        words += f", of {seconds_cell(close.budget_s).text} that were given"
    return words


def alone_words(close: CloseResult) -> str:
    """What the command of a step gives when it is run alone."""
    words = "The command of a step that is done gives the same alone"
    if any(step.status == "cut short" for step in close.steps):
        words += "; a step that was cut short had less time than its command takes"
    if any(not label.endswith(f"+{_NOT_LEARNED}") for label in close.networks):
        words += "; a network that learns under a budget slows down with the time and is not repeated exactly"
    return f"{words}."
