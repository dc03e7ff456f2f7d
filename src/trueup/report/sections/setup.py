"""What the check of the set-up found, before anything was fitted."""

from __future__ import annotations

from dataclasses import dataclass

from trueup.core.check_result import Finding, Mend
from trueup.report.folder import RunFolder
from trueup.report.numbers import plural
from trueup.report.sections.base import Section

_SIGNS = {"certain": "▲", "likely": "◐", "note": "·"}
_TONES = {"certain": "worse", "likely": "undecided", "note": "undecided"}
_MOST_MENDS = 2


@dataclass(frozen=True)
class FindingRow:
    """One finding as printed.

    Attributes:
        finding: what was found.
        sign: of its severity.
        tone: likewise.
        mends: those that are shown.
    """

    finding: Finding
    sign: str
    tone: str
    mends: tuple[Mend, ...]


def setup_section(run: RunFolder) -> Section | None:
    """Only where something was found."""
    if run.checked is None or not run.checked.findings:
        return None
    rows = [
        FindingRow(one, _SIGNS[one.severity], _TONES[one.severity], one.mends[:_MOST_MENDS])
        for one in run.checked.findings
    ]
    certain = len(run.checked.certain)
    words = f"{plural(len(rows), 'finding')} in {plural(run.checked.motions, 'motion')}."
    if certain:
        words += " What is certain has to be mended before numbers of the model mean anything."
    return Section(
        "setup", "Set-up: what does not fit together", {"rows": rows, "words": words, "unseen": run.checked.unseen}
    )
