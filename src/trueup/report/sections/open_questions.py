"""What the data leave open, and what to record next."""

from __future__ import annotations

from trueup.report.chooser import Chooser, Variant
from trueup.report.fit_words import as_sentence
from trueup.report.folder import RunFolder
from trueup.report.next_motions import design_recipe, promise_table, promised
from trueup.report.numbers import fixed
from trueup.report.open_words import correlation_words, direction_rows, strongest, suggestions
from trueup.report.sections.base import Section

MAX_ROWS = 12


def open_section(run: RunFolder) -> Section | None:
    """Only after an identification; where nothing is open it says so."""
    if run.fit is None:
        return None
    directions = direction_rows(run.fit.directions)
    pairs = strongest(run.fit.correlation)
    context = {
        "record": suggestions(run.fit.parameters),
        "design": design_recipe(run, run.fit),
        "promise": promise_chooser(run),
        "directions": [(as_sentence(words), gain) for words, gain in directions[:MAX_ROWS]],
        "more_directions": max(0, len(directions) - MAX_ROWS),
        "pairs": [
            (first, second, fixed(r, 2, sign=True), correlation_words(r)) for first, second, r in pairs[:MAX_ROWS]
        ],
        "more_pairs": max(0, len(pairs) - MAX_ROWS),
    }
    return Section("open", "Record next: what these motions leave open", context)


def promise_chooser(run: RunFolder) -> Chooser | None:
    """What designed motions promise, where there are any for this fit."""
    design = promised(run)
    if design is None:
        return None
    return Chooser("promise-chooser", [], Variant(tables={"promise": promise_table(design)}), [])
