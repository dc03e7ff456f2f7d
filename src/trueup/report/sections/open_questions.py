"""What the data leave open, and what to record next."""

from __future__ import annotations

from trueup.report.fit_words import as_sentence
from trueup.report.folder import RunFolder
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
        "directions": [(as_sentence(words), gain) for words, gain in directions[:MAX_ROWS]],
        "more_directions": max(0, len(directions) - MAX_ROWS),
        "pairs": [
            (first, second, fixed(r, 2, sign=True), correlation_words(r)) for first, second, r in pairs[:MAX_ROWS]
        ],
        "more_pairs": max(0, len(pairs) - MAX_ROWS),
    }
    return Section("open", "Open questions: what these motions do not tell", context)
