"""The verdict: what must not be overlooked, a sentence, and tiles that repeat its numbers."""

from __future__ import annotations

from dataclasses import dataclass

from trueup.core.fit_result import FitResult
from trueup.core.quality import Quality
from trueup.report.fit_words import alert_of, as_sentence, sure_sentence
from trueup.report.folder import RunFolder
from trueup.report.labels import COMMAND, split_title
from trueup.report.numbers import in_degrees, interval, percent, plural, quantity, with_unit
from trueup.report.sections.base import Section
from trueup.report.verdict import (
    Comparison,
    Headline,
    JointError,
    compare,
    extreme_joints,
    find_headline,
    gap_sentence,
    joints_sentence,
    stock_label,
    tone_words,
)


@dataclass(frozen=True)
class Tile:
    """A number that is read from afar.

    Attributes:
        title: what it is.
        value: the number.
        note: below it.
        tone: `better`, `worse`, `undecided`, or empty.
    """

    title: str
    value: str
    note: str = ""
    tone: str = ""


def verdict_section(run: RunFolder) -> Section:
    """Always there; without any RMSE it says so."""
    headline = find_headline(run.gap, run.ladder)
    alert = alert_of(run.fit) if run.fit else None
    of_fit = fit_sentences(run.fit) if run.fit else []
    fit_tiles = [fit_tile(run.fit)] if run.fit else []
    if headline is None:
        sentence = "This run holds no RMSE of any signal, so there is no verdict; see the tables below."
        context = {"alert": alert, "lead": sentence, "sentences": of_fit, "tiles": fit_tiles}
        return Section("verdict", "Verdict", context)
    comparisons = [compare(headline, label, run.gap) for label in run.runs]
    found = [item for item in comparisons if item is not None]
    tested = [item for item in found if item.tone != "untested"]
    found = tested or found  # two means beside paired comparisons would only be many words
    extremes = extreme_joints(headline, run.gap)
    sentences = [item.sentence for item in found]
    sentences += [headline.reason] if headline.reason else []
    sentences += of_fit
    sentences += [joints_sentence(*extremes)] if extremes else []
    sentences += [quality_sentence(run.quality)] if run.quality else []
    sentences += [str(warning) for warning in run.gap.settings.get("warnings", ())]
    return Section(
        "verdict",
        "Verdict",
        {
            "alert": alert,
            "lead": gap_sentence(headline, run.gap),
            "sentences": sentences,
            "tiles": tiles(headline, found, extremes) + fit_tiles,
        },
    )


def fit_sentences(fit: FitResult) -> list[str]:
    """How sure the fit is; what an alert says already is not said again."""
    statements = [as_sentence(text) for text in fit.statements] if fit.status == "ok" else []
    return [sure_sentence(fit), *statements]


def fit_tile(fit: FitResult) -> Tile:
    """How many parameters the data determine, and the status."""
    free = fit.free
    sure = sum(item.identified == "yes" for item in free)
    ok = fit.status == "ok"
    words = fit.status.replace("-", " ")
    return Tile(
        "Parameters determined",
        f"{sure} of {len(free)}",
        "✓ fit ok" if ok else f"▲ {words}",
        "better" if ok else "worse",
    )


def tiles(
    headline: Headline, comparisons: list[Comparison], extremes: tuple[JointError, JointError] | None
) -> list[Tile]:
    """The gap, its change against the model as it came and the command, the worst and the best joint, if known."""
    total = headline.result.total
    ends = interval(total)
    note = with_unit(ends, total.unit) if ends else "no interval"
    degrees = in_degrees(total.value, total.unit)
    result = [
        Tile(
            f"{headline.signal.capitalize()} RMSE, {split_title(headline.split)}",
            quantity(total.value, total.unit),
            f"{degrees} · {note}" if degrees else note,
        )
    ]
    stock = stock_label(headline.run, [item.baseline for item in comparisons])
    for baseline, title in ((stock, "Against the model as it came"), (COMMAND, "Against the command")):
        result += [comparison_tile(item, title) for item in comparisons if item.baseline == baseline]
    for title, item in zip(("Worst joint", "Best joint"), extremes or (), strict=False):
        value = quantity(item.error.value, item.error.unit)
        degrees = in_degrees(item.error.value, item.error.unit)
        result.append(Tile(title, item.joint, f"{value} · {degrees}" if degrees else value))
    return result


def comparison_tile(item: Comparison, title: str) -> Tile:
    """How much less or more, the verdict, and the paired interval that it rests on."""
    note = tone_words(item.tone)
    return Tile(title, percent(item.ratio), f"{note} · {item.ends}" if item.ends else note, item.tone)


def quality_sentence(quality: Quality) -> str:
    """How many motions carry warnings and how many were left out."""
    items = quality.episodes.values()
    total, warned = len(items), sum(item.warned for item in items)
    dropped = sum(item.dropped for item in items)
    left_out = "none was left out" if dropped == 0 else f"{dropped} {'was' if dropped == 1 else 'were'} left out"
    if warned == 0:
        return f"Quality checks raised no warning on {plural(total, 'motion')}; {left_out}."
    verb = "carries" if warned == 1 else "carry"
    return f"Of {plural(total, 'motion')}, {warned} {verb} a quality warning; {left_out}."
