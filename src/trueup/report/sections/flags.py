"""What the quality checks found."""

from __future__ import annotations

from dataclasses import dataclass

from trueup.core.episode import Flag
from trueup.report.folder import RunFolder
from trueup.report.labels import split_title
from trueup.report.numbers import fixed, plural
from trueup.report.sections.base import Section
from trueup.report.sections.verdict import quality_sentence

# A page with ten thousand rows helps nobody; warnings come first.
MAX_ROWS = 500


@dataclass(frozen=True)
class FlagRow:
    """One flag as printed.

    Attributes:
        episode: id of the episode.
        split: its split.
        dropped: whether the episode was left out.
        flag: what was found.
        time: from when to when.
    """

    episode: str
    split: str
    dropped: bool
    flag: Flag
    time: str

    @property
    def start(self) -> float:
        """For sorting by time."""
        return -1.0 if self.flag.start_s is None else self.flag.start_s


def flags_section(run: RunFolder) -> Section | None:
    """Only where quality was checked; without any flag it says so."""
    if run.quality is None:
        return None
    rows = [
        FlagRow(name, split_title(item.split), item.dropped, flag, time_span(flag))
        for name, item in sorted(run.quality.episodes.items())
        for flag in item.flags
    ]
    rows.sort(key=lambda row: row.flag.severity != "warning")
    summary = quality_sentence(run.quality)
    if len(rows) > MAX_ROWS:
        summary += f" The table shows {MAX_ROWS} of {plural(len(rows), 'flag')}, warnings first."
    traced = set(run.traces.episodes) if run.traces else set()
    context = {"summary": summary, "rows": rows[:MAX_ROWS], "traced": traced}
    return Section("flags", "Quality of the recordings", context)


def time_span(flag: Flag) -> str:
    """`1.20 to 3.45 s`."""
    if flag.start_s is None:
        return ""
    if flag.end_s is None or flag.end_s == flag.start_s:
        return f"{fixed(flag.start_s, 2)}\N{NO-BREAK SPACE}s"
    return f"{fixed(flag.start_s, 2)} to {fixed(flag.end_s, 2)}\N{NO-BREAK SPACE}s"
