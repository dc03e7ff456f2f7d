"""Learned corrections in plain words: what they cut, where they harm, what they leave alone."""

from __future__ import annotations

import math
from collections.abc import Sequence

from trueup.core.augment_result import (
    ALL_JOINTS,
    ANY_CONDITION,
    AugmentResult,
    ModelEvaluation,
    group_title,
    joint_title,
)
from trueup.core.results import Estimate
from trueup.report.numbers import plural, quantity, significant

TIMES = "\N{MULTIPLICATION SIGN}"


def factor_words(factor: Estimate) -> str:
    """`×28.4`."""
    return f"{TIMES}{significant(factor.value)}" if math.isfinite(factor.value) else ""


def factor_interval(factor: Estimate) -> str:
    """`24.1 to 33.5`; `above 3.2` where nothing may be left of the error."""
    if factor.low is None:
        return ""
    if factor.high is None:
        return f"above {significant(factor.low)}"
    return f"{significant(factor.low)} to {significant(factor.high)}"


def lead(result: AugmentResult, model: ModelEvaluation, signal: str = "") -> str:
    """What a network makes of a signal, the main one if not given, over all motions."""
    signal = signal or result.main_signal
    cut = model.cuts[ANY_CONDITION].get(signal, {}).get(ALL_JOINTS)
    before = result.simulated[ANY_CONDITION].get(signal, {}).get(ALL_JOINTS)
    if cut is None or before is None:
        return f"{model.name} corrects {result.run}; see joint by joint."
    ends = f"{quantity(before.rmse.value, before.rmse.unit)} to {quantity(cut.rmse.value, cut.rmse.unit)}"
    motions = plural(result.motions[ANY_CONDITION], "motion")
    if cut.verdict == "better":
        return f"{model.name} cuts the {signal} error of {result.run} from {ends} RMSE on {motions}."
    if cut.verdict == "worse":
        return f"{model.name} does not help: it takes the {signal} error of {result.run} from {ends} RMSE on {motions}."
    return f"It is not decided whether {model.name} helps: {signal} goes from {ends} RMSE on {motions}."


def sentences(
    result: AugmentResult, model: ModelEvaluation, signal: str = "", *, order: Sequence[str] = ()
) -> list[str]:
    """Cut of a signal by group of motions, against the next best network, and harm.

    Args:
        result: of the evaluation.
        model: which.
        signal: the main one if not given.
        order: names of the networks, the best first; by what they leave of the signal if not given.
    """
    signal = signal or result.main_signal
    lines = [line for name in result.conditions if (line := _group_sentence(result, model, name, signal))]
    lines += _rival_sentence(result, model, signal, order)
    lines.append(_harm_sentence(result, model))
    return lines


def off_sentences(result: AugmentResult) -> list[str]:
    """Which outputs their training has switched off, and why."""
    lines = []
    for model in result.models:
        if model.gated:
            what, reasons = "; ".join(result.off_outputs(model)), model.off_reasons
            more = "; the other reasons are in augment.json" if len(reasons) > 1 else ""
            lines.append(f"{model.name} leaves {what} as simulated{f': {reasons[0]}{more}' if reasons else ''}.")
    return lines


def _group_sentence(result: AugmentResult, model: ModelEvaluation, condition: str, signal: str) -> str:
    cuts = model.cuts[condition].get(signal, {})
    total = cuts.get(ALL_JOINTS)
    single = {joint: cut for joint, cut in cuts.items() if joint and math.isfinite(cut.factor.value)}
    if total is None or not math.isfinite(total.factor.value):
        return ""
    ends = factor_interval(total.factor)
    line = (
        f"{f'{condition.capitalize()} motions' if condition else 'All'} ({result.motions[condition]}): {signal} MSE "
        f"{significant(total.factor.value)} times smaller{f' ({ends})' if ends else ''}"
    )
    if len(single) > 1:
        least, most = (pick(single, key=lambda name: single[name].factor.value) for pick in (min, max))
        extremes = [f"{significant(single[joint].factor.value)} on {joint}" for joint in (least, most)]
        line += f", from {' to '.join(extremes)}"
    return line + ("." if total.verdict == "better" else f"; {total.verdict}.")


def _rival_sentence(result: AugmentResult, model: ModelEvaluation, signal: str, order: Sequence[str]) -> list[str]:
    """Against the next best network."""
    rivals = [item for item in result.models if item.name != model.name]
    left = {
        item.name: cut.mse.value
        for item in rivals
        if (cut := item.cuts[ANY_CONDITION].get(signal, {}).get(ALL_JOINTS)) is not None
    }
    if not left:
        return []
    rival = next((name for name in order if name in left), min(left, key=lambda name: left[name]))
    factor, verdict = against(result, model.name, rival, ANY_CONDITION, signal)
    if factor is None or not math.isfinite(factor.value):
        return []
    ends = factor_interval(factor)
    times = f"{significant(factor.value)} times smaller"
    start = f"Against {rival}, the next best: {times}{f' ({ends})' if ends else ''}"
    return [start + ("." if verdict == "better" else f"; {verdict}.")]


def against(result: AugmentResult, model: str, other: str, condition: str, signal: str) -> tuple[Estimate | None, str]:
    """Factor and verdict of one network against another, whichever was named first."""
    for item in result.pairs:
        if (item.condition, item.signal) != (condition, signal):
            continue
        if (item.model, item.baseline) == (model, other):
            return item.factor, item.verdict
        if (item.model, item.baseline) == (other, model):
            turned = {"better": "worse", "worse": "better"}.get(item.verdict, item.verdict)
            return _inverse(item.factor), turned
    return None, ""


def _inverse(factor: Estimate) -> Estimate:
    def over(value: float | None) -> float | None:
        return None if value is None or not value > 0.0 else 1.0 / value

    value = over(factor.value)
    return Estimate(math.nan if value is None else value, factor.unit, over(factor.high), over(factor.low))


def _harm_sentence(result: AugmentResult, model: ModelEvaluation) -> str:
    worse = [
        f"{signal} of {joint_title(joint, signal)} ({group_title(condition)})"
        for condition in result.conditions
        for signal, cuts in model.cuts[condition].items()
        for joint, cut in cuts.items()
        if joint != ALL_JOINTS and cut.verdict == "worse"
    ]
    if not worse:
        return "It makes no signal of any joint worse for sure, in no group of motions."
    return f"It makes worse for sure: {', '.join(worse)}."
