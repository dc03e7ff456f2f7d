"""The result in plain words, as careful as its numbers."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from trueup.core.results import Estimate, GapResult, Ladder, MetricResult, PairedDifference, Verdict
from trueup.report.labels import COMMAND, MAIN_METRIC, main_signal, main_split, ordered_runs, split_title
from trueup.report.numbers import (
    has_interval,
    interval,
    percent,
    plural,
    quantity,
    quantity_with_degrees,
    with_unit,
)

# What is said of the best of several that nothing else has judged.
TOO_KIND = "on the very motions that it is judged on, so the number is a little too kind."


@dataclass(frozen=True)
class Headline:
    """What the verdict is about.

    Attributes:
        run: label of the run that is judged; `command` when nothing was simulated.
        split: split that it is judged on.
        signal: signal that is judged.
        result: RMSE of that run, split and signal.
        reason: why this run, when there were several; a sentence or empty.
    """

    run: str
    split: str
    signal: str
    result: MetricResult
    reason: str


@dataclass(frozen=True)
class Comparison:
    """The judged run against another one on the same motions.

    Attributes:
        baseline: label of the other run.
        ratio: difference over the baseline's error; negative is better.
        tone: `better`, `worse`, `undecided`; or `untested` when only two means are known.
        sentence: the same in words.
        ends: 95 % interval of the difference with its unit; empty where there is none.
    """

    baseline: str
    ratio: float
    tone: str
    sentence: str
    ends: str = ""


@dataclass(frozen=True)
class JointError:
    """The error of one joint."""

    joint: str
    error: Estimate


def find_headline(gap: GapResult, ladder: Ladder | None = None) -> Headline | None:
    """Choose the run, split and signal of the verdict.

    The split is what was held back (`test`, else `val`, else all). Among several runs it is the chosen rung of
    the ladder, else the lowest on `val`, else the lowest on the judged split, and the reason says so.

    Returns:
        None when no run holds an RMSE.
    """
    scored = {
        label: {split: metrics for split, metrics in splits.items() if metrics and _rmse(metrics, main_signal(metrics))}
        for label, splits in gap.runs.items()
    }
    scored = {label: splits for label, splits in scored.items() if splits}
    if not scored:
        return None
    simulators = [label for label in ordered_runs(scored) if label != COMMAND] or [COMMAND]
    split = main_split({name for label in simulators for name in scored[label]})
    candidates = [label for label in simulators if split in scored[label]]
    run, reason = _choose(candidates, scored, split, ladder)
    signal = main_signal(scored[run][split])
    return Headline(run, split, signal, scored[run][split][signal][MAIN_METRIC], reason)


def _choose(
    candidates: list[str], scored: Mapping[str, Mapping[str, object]], split: str, ladder: Ladder | None
) -> tuple[str, str]:
    if len(candidates) == 1:
        return candidates[0], ""
    chosen = next((rung.name for rung in ladder.rungs if rung.chosen), None) if ladder else None
    rung_run = next((label for label in candidates if chosen in (label, *rung_names(label))), None)
    if rung_run is not None and split == "val":
        return rung_run, f"It was chosen among {len(candidates)} runs {TOO_KIND}"
    if rung_run is not None:
        return rung_run, f"Of {len(candidates)} runs it is the one chosen on validation motions."
    on = "val" if split != "val" and all("val" in scored[label] for label in candidates) else split
    best = min(candidates, key=lambda label: _sortable(scored[label][on]))
    if on != split:
        return (
            best,
            f"Of {len(candidates)} runs it has the lowest error on the validation motions, on which it was chosen.",
        )
    return best, f"It is the lowest of {len(candidates)} runs {TOO_KIND}"


def rung_names(label: str) -> tuple[str, ...]:
    """What a run may be called in the ladder; what corrects the model as it came is called after its network alone."""
    name = label.split("/")[-1]
    return (name, name.removeprefix("stock+"))


def _sortable(metrics: object) -> float:
    assert isinstance(metrics, Mapping)
    value = metrics[main_signal(metrics)][MAIN_METRIC].total.value
    return value if math.isfinite(value) else math.inf


def _rmse(metrics: Mapping[str, Mapping[str, MetricResult]], signal: str) -> MetricResult | None:
    return metrics.get(signal, {}).get(MAIN_METRIC)


def gap_sentence(headline: Headline, gap: GapResult) -> str:
    """How far off the run is, with interval or with the reason why there is none."""
    total, episodes = headline.result.total, headline.result.episodes
    on = f"On {motions(episodes, headline.split)} "
    window = gap.settings.get("window_s")
    if isinstance(window, int | float):
        on += f"(restarted from the measured state every {window:g} s) "
    subject = (
        f"the command taken as the motion misses the measured {headline.signal}"
        if headline.run == COMMAND
        else f"the simulator {headline.run} misses the measured {headline.signal}"
    )
    if not math.isfinite(total.value):
        return f"{on}the error of {headline.signal} of {headline.run} is not defined: there are no samples to compare."
    scored = len(gap.scored_joints)
    over = f", averaged over {scored} joints" if scored > 1 else ""
    size = quantity_with_degrees(total.value, total.unit)
    return f"{on}{subject} by {size} RMSE{over} ({interval_words(headline.result)})."


def interval_words(result: MetricResult) -> str:
    """`95 % interval 0.0220 to 0.0510 rad`, or why there is none."""
    if has_interval(result.total):
        return f"95\N{NO-BREAK SPACE}% interval {with_unit(interval(result.total), result.total.unit)}"
    if result.episodes <= 1:
        return "no interval: a single motion does not show how much motions differ"
    return "no interval was computed"


def motions(count: int, split: str) -> str:
    """`6 test motions`, `all 43 motions`."""
    if split == "all":
        return f"all {plural(count, 'motion')}" if count > 1 else plural(count, "motion")
    return plural(count, f"{split_title(split)} motion")


def compare(headline: Headline, baseline: str, gap: GapResult) -> Comparison | None:
    """The judged run against `baseline`; None when the two have nothing in common."""
    other = gap.runs.get(baseline, {}).get(headline.split, {})
    reference = _rmse(other, headline.signal)
    if baseline == headline.run or reference is None:
        return None
    pair = _paired(headline, baseline, gap)
    if pair is not None and math.isfinite(pair.relative):
        return _tested(pair, reference.total)
    value, base = headline.result.total.value, reference.total.value
    if not (math.isfinite(value) and math.isfinite(base) and base > 0):
        return None
    ratio = value / base - 1.0
    than = _baseline_words(baseline, reference.total)
    sentence = f"That is {_more_or_less(ratio)} than {than}; the two were not compared motion by motion."
    return Comparison(baseline, ratio, "untested", sentence)


def _tested(pair: PairedDifference, reference: Estimate) -> Comparison:
    start = f"That is {_more_or_less(pair.relative)} than {_baseline_words(pair.baseline, reference)}"
    if not has_interval(pair.difference):
        tail = ", but without an interval of the difference (too few motions) this decides nothing."
        return Comparison(pair.baseline, pair.relative, "undecided", start + tail)
    ends = with_unit(interval(pair.difference, sign=True), pair.difference.unit)
    what = f"the 95\N{NO-BREAK SPACE}% interval of the difference, {ends},"
    if pair.verdict == "undecided":
        return Comparison(
            pair.baseline, pair.relative, "undecided", f"{start}, but undecided: {what} includes zero.", ends
        )
    sentence = f"{start}, clearly {pair.verdict}: {what} excludes zero."
    return Comparison(pair.baseline, pair.relative, pair.verdict, sentence, ends)


def _paired(headline: Headline, baseline: str, gap: GapResult) -> PairedDifference | None:
    """The stored comparison of the two runs, turned around if it was stored the other way."""
    key = (headline.split, headline.signal, MAIN_METRIC)
    for item in gap.paired:
        if (item.split, item.signal, item.metric) != key:
            continue
        if (item.run, item.baseline) == (headline.run, baseline):
            return item
        if (item.run, item.baseline) == (baseline, headline.run):
            return turned(item)
    return None


def turned(item: PairedDifference) -> PairedDifference:
    """The same comparison seen from the baseline."""
    low, high = item.difference.low, item.difference.high
    difference = Estimate(
        -item.difference.value, item.difference.unit, None if high is None else -high, None if low is None else -low
    )
    # relative = (run - baseline) / baseline, so run / baseline = 1 + relative
    relative = -item.relative / (1.0 + item.relative) if item.relative != -1.0 else math.inf
    opposite: dict[Verdict, Verdict] = {"better": "worse", "worse": "better"}
    verdict = opposite.get(item.verdict, item.verdict)
    return PairedDifference(
        item.baseline, item.run, item.split, item.signal, item.metric, difference, relative, verdict
    )


def _more_or_less(ratio: float) -> str:
    if abs(ratio) < 5e-4:
        return "no more and no less"
    return f"{percent(abs(ratio), sign=False)} {'less' if ratio < 0 else 'more'}"


def _baseline_words(baseline: str, reference: Estimate) -> str:
    words = "taking the command as the motion" if baseline == COMMAND else baseline
    return f"{words} ({quantity(reference.value, reference.unit)})"


def stock_label(run: str, labels: Iterable[str]) -> str:
    """The model as it came that a run is compared with, of its own engine if there is one; empty without any."""
    stock = [label for label in labels if label.split("/")[-1] == "stock"]
    own = f"{run.partition('/')[0]}/stock"
    return own if own in stock else "".join(stock[:1])


def extreme_joints(headline: Headline, gap: GapResult) -> tuple[JointError, JointError] | None:
    """The scored joints with the largest and the smallest error; None unless two or more share a unit."""
    found = [
        JointError(joint, headline.result.per_joint[joint])
        for joint in gap.scored_joints
        if joint in headline.result.per_joint and math.isfinite(headline.result.per_joint[joint].value)
    ]
    if len(found) < 2 or len({item.error.unit for item in found}) > 1:
        return None
    return max(found, key=lambda item: item.error.value), min(found, key=lambda item: item.error.value)


def joints_sentence(worst: JointError, best: JointError) -> str:
    """Where the error is."""

    def words(item: JointError) -> str:
        return f"{item.joint}, {quantity_with_degrees(item.error.value, item.error.unit)}"

    return f"The joint with the largest error is {words(worst)}; the one with the smallest is {words(best)}."


def tone_words(tone: str) -> str:
    """What stands beside a comparison, with a sign so that color is not the only cue."""
    return {
        "better": "▼ better",
        "worse": "▲ worse",
        "undecided": "≈ undecided",
        "untested": "not tested",
    }[tone]
