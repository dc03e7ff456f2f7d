"""The gap analysis in words: one finding before each figure, as careful as its numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from trueup.core.engines import ANY_PAYLOAD, EngineComparison, Shift, Trend
from trueup.core.graybox_result import HELD_OUT, BlockFit, GrayboxResult
from trueup.core.results import Estimate, GapResult, Metrics, PairedDifference
from trueup.report.folder import RunFolder
from trueup.report.labels import COMMAND, group_order
from trueup.report.numbers import has_interval, interval, percent, plural, quantity, significant, with_unit
from trueup.report.verdict import find_headline

PAYLOAD = "payload_kg"
_MEAN = ""
# A path that surely stays within this share of a motion's size is the same path to the eye.
_RETRACED = 0.05
BLOCK_WORDS = {
    "pd": "the servo (position and velocity error, constant)",
    "friction": "friction",
    "payload": "a constant torque per kilogram",
    "posture": "sine and cosine of the posture under payload",
    "coupling": "speed and acceleration under payload",
}


def findings(run: RunFolder) -> dict[str, list[str]]:
    """Part of the analysis -> what was found, or why it was not looked for; empty without an analysis."""
    engines = run.engines
    if engines is None:
        return {}
    parts = {
        "payload": payload_words(run, engines),
        "lag": lag_words(run, engines),
        "saturation": saturation_words(run.gap, run.simulators),
        "conditions": condition_words(engines),
        "engines": engine_words(engines),
        "blocks": [] if run.graybox is None else block_words(run.graybox),
    }
    missing = engines.missing
    return {name: [*words, *([missing[name]] if name in missing else [])] for name, words in parts.items()}


def spoken_run(run: RunFolder) -> str | None:
    """The simulation that sentences are about: that of the verdict."""
    headline = find_headline(run.gap, run.ladder)
    if headline is not None and headline.run != COMMAND:
        return headline.run
    return run.simulators[0] if run.simulators else None


def payload_words(run: RunFolder, engines: EngineComparison) -> list[str]:
    """How the error grows with the payload, whether it bends, and in which joints."""
    label = spoken_run(run)
    words = []
    for signal in ("position", "torque"):
        joints = engines.trends.get(label or "", {}).get(signal, {}).get("rmse", {})
        item = joints.get(_MEAN)
        if item is None:
            continue
        slope = item.slope
        if item.verdict == "undecided":
            words.append(
                f"Whether the {signal} error of {label} changes with the payload cannot be told: "
                f"{_signed(slope)} per kilogram."
            )
            continue
        grown = [joint for joint, own in joints.items() if joint and own.verdict == item.verdict]
        most = max(grown, key=lambda joint: abs(joints[joint].slope.value), default="")
        where = f", most in {most} ({_plain(joints[most].slope)})" if most else ""
        # Estimates carry the unit per kilogram; the sentence says it in words.
        words.append(
            f"The {signal} error of {label} {item.verdict} by {_interval_of(slope)} with each kilogram, "
            f"in {len(grown)} of {plural(len(joints) - 1, 'joint')}{where}."
        )
        words += _shape_words(item)
    return words


def _shape_words(item: Trend) -> list[str]:
    if item.bend is None:
        return []
    if item.shape == "straight":
        return [f"That is a straight line: in the middle of the payloads it is off by {_signed(item.bend)}."]
    if item.shape == "undecided":
        return [f"Whether it bends cannot be told: in the middle of the payloads by {_signed(item.bend)}."]
    size = Estimate(abs(item.bend.value), item.bend.unit, *sorted(_sizes(item.bend)))
    lower, heavy = ("below", "more") if item.shape == "bends up" else ("above", "less")
    told = f"That is no straight line: in the middle of the payloads it is {_interval_of(size)} {lower} one"
    return [f"{told}, so that the last kilogram counts for {heavy} than the first."]


def _sizes(estimate: Estimate) -> tuple[float, float]:
    return abs(estimate.low or 0.0), abs(estimate.high or 0.0)


def lag_words(run: RunFolder, engines: EngineComparison) -> list[str]:
    """How late the robot is, behind its command and behind the simulation."""
    words = []
    groups = run.gap.groups.get(PAYLOAD, {})
    for label in (COMMAND, spoken_run(run)):
        if label is None or label not in run.gap.runs:
            continue
        behind = "its command" if label == COMMAND else label
        lags = {load: _total(groups[load].get(label, {}), "position", "phase_lag") for load in group_order(groups)}
        known = {load: item for load, item in lags.items() if item is not None and math.isfinite(item.value)}
        whole = _total(run.gap.runs[label].get("all", {}), "position", "phase_lag")
        trend = engines.trends.get(label, {}).get("position", {}).get("phase_lag", {}).get(_MEAN)
        if len(known) > 1:
            ends = [next(iter(known)), list(known)[-1]]
            told = ", ".join(f"{milliseconds(known[load])} with {load} kg" for load in ends)
            words.append(f"The robot is later than {behind}: {told}.")
        elif whole is not None and math.isfinite(whole.value):
            words.append(f"The robot is later than {behind}: {milliseconds(whole)}.")
        if trend is not None and words:
            told = milliseconds(trend.slope, sign=True)
            sure = "" if trend.verdict != "undecided" else ", which may be nothing"
            words[-1] += f" Each kilogram adds {told}{sure}."
    return words


def saturation_words(gap: GapResult, simulators: Sequence[str]) -> list[str]:
    """How often motors are at their limit, on the robot and in simulations."""
    groups = gap.groups.get(PAYLOAD, {})
    loads = group_order(groups)
    sets = [(f" with {load} kg", groups[load]) for load in (loads[:1] + loads[-1:] if len(loads) > 1 else [])]
    sets = sets or [("", {label: splits.get("all", {}) for label, splits in gap.runs.items()})]
    words = []
    for where, runs in sets:
        measured = next(
            (found for label in simulators if (found := _total(runs.get(label, {}), "torque", "saturation_measured"))),
            None,
        )
        if measured is None or not math.isfinite(measured.value):
            continue
        others = {label: _total(runs.get(label, {}), "torque", "saturation_simulated") for label in simulators}
        told = ", ".join(f"{_percent(item)} in {label}" for label, item in others.items() if item is not None)
        words.append(f"Motors are at their torque limit in {_percent(measured)} of the samples{where}; {told}.")
    return words


def condition_words(engines: EngineComparison) -> list[str]:
    """Whether a motion is retraced under another condition, and with another payload."""
    words = []
    for shift in engines.shifts:
        if shift.by != "condition":
            continue
        retraced = shift.share.high is not None and shift.share.high <= _RETRACED
        verdict = f"{'is' if shift.motions == 1 else 'are'} {'nearly retraced' if retraced else 'moved'}"
        gaps = "; ".join(f"{_signed(items['position.rmse'])} in {run}" for run, items in _simulated_gaps(shift))
        words.append(
            f"Under {shift.second} instead of {shift.first}, {plural(shift.motions, 'motion')} with the same command "
            f"and payload {verdict}: the path differs by {_percent(shift.share)} of the size of a motion, the mean "
            f"posture by {_interval_of(shift.offset)}, the lag behind the command by "
            f"{milliseconds(shift.lag, sign=True)}." + (f" The position error changes by {gaps}." if gaps else "")
        )
    heavy = [shift for shift in engines.shifts if shift.by == PAYLOAD]
    if heavy:
        shift = heavy[-1]
        words.append(
            f"A payload moves the same motions by {_percent(shift.share)} of their size "
            f"({shift.second} kg against {shift.first} kg)."
        )
    if len(engines.inside) > 1:
        told = ", ".join(f"{_percent(item)} under {name}" for name, item in engines.inside.items())
        words.append(f"Of the samples, so many lie within the ellipse that all conditions share: {told}.")
    return words


def engine_words(engines: EngineComparison) -> list[str]:
    """Which engine is nearer to the robot, by position error, payload by payload."""
    pairs: dict[tuple[str, str], dict[str, PairedDifference]] = {}
    for payload, items in engines.nearer.items():
        for item in items:
            if (item.signal, item.metric) == ("position", "rmse"):
                pairs.setdefault((item.run, item.baseline), {})[payload] = item
    words = []
    for (run, baseline), found in pairs.items():
        by_payload = {load: item for load, item in found.items() if load != ANY_PAYLOAD} or found
        for verdict, near, far in (("better", run, baseline), ("worse", baseline, run)):
            sure = {load: item for load, item in by_payload.items() if item.verdict == verdict}
            if sure:
                told = ", ".join(f"{_smaller(item)}{_with(load)}" for load, item in sure.items())
                words.append(f"{near} is nearer to the robot than {far}: its position error is smaller by {told}.")
        open_ = [f"{_signed(item.difference)}{_with(load)}" for load, item in by_payload.items() if _open(item)]
        if open_:
            words.append(
                f"Which of {run} and {baseline} is nearer cannot be told where the difference is {', '.join(open_)}."
            )
    return words


def block_words(graybox: GrayboxResult) -> list[str]:
    """Which blocks of terms are worth having, on motions that were held out."""
    fitted = [block for block in graybox.total if HELD_OUT in block.splits]
    if not fitted:
        return ["Too few motions to hold any out: what a block is worth on new motions is not known."]
    first = fitted[0].splits[HELD_OUT]
    before = first.rmse.value + first.reduction.value
    left = f"{BLOCK_WORDS['pd']} leaves {_interval_of(first.rmse)} of the torque unexplained"
    constant = f"a constant leaves {quantity(before, first.rmse.unit)} (RMSE, mean of joints)"
    words = [f"Of motions that were held out, {left}; {constant}."]
    worth = [block for block in fitted[1:] if _sure(block.splits[HELD_OUT].reduction) > 0]
    harm = [block for block in fitted[1:] if _sure(block.splits[HELD_OUT].reduction) < 0]
    nothing = [block for block in fitted[1:] if block not in worth and block not in harm]
    for blocks, verb in ((worth, "lowers"), (harm, "raises")):
        for block in blocks:
            score = block.splits[HELD_OUT]
            size = Estimate(abs(score.reduction.value), score.reduction.unit, *sorted(_sizes(score.reduction)))
            share = percent(size.value / (score.rmse.value + score.reduction.value), sign=False)
            words.append(f"Adding {_block(block)} {verb} it by {_interval_of(size)}, {share}.")
    if nothing:
        told = "; ".join(f"{_block(block)}, {_signed(block.splits[HELD_OUT].reduction)}" for block in nothing)
        words.append(f"Not worth having, since they lower it by nothing that is sure: {told}.")
    left_out: dict[str, list[str]] = {}
    for block in graybox.total:
        if block.left_out:
            left_out.setdefault(block.left_out, []).append(_block(block))
    words += [f"Left out: {'; '.join(blocks)} ({why})." for why, blocks in left_out.items()]
    return words + _heavy_words(fitted[-1])


def _heavy_words(block: BlockFit) -> list[str]:
    scores = block.payloads.get(HELD_OUT, {})
    loads = group_order(scores)
    if len(loads) < 2:
        return []
    light, heavy = scores[loads[0]].rmse, scores[loads[-1]].rmse
    told = f"With all of it, {_interval_of(heavy)} are left with {loads[-1]} kg"
    told += f" and {_interval_of(light)} with {loads[0]} kg"
    ends = light.high, heavy.low
    apart = ends[0] is not None and ends[1] is not None and ends[1] > ends[0]
    return [told + (": the equation holds less well under the payload." if apart else ".")]


def _block(block: BlockFit) -> str:
    return BLOCK_WORDS.get(block.block, block.block)


def _sure(estimate: Estimate) -> int:
    """1 or -1 where the interval lies above or below zero, else 0."""
    if estimate.low is None or estimate.high is None:
        return 0
    return 1 if estimate.low > 0.0 else -1 if estimate.high < 0.0 else 0


def _simulated_gaps(shift: Shift) -> list[tuple[str, Mapping[str, Estimate]]]:
    return [(run, items) for run, items in shift.gaps.items() if run != COMMAND and "position.rmse" in items]


def _open(item: PairedDifference) -> bool:
    return item.verdict == "undecided" and math.isfinite(item.difference.value)


def _smaller(item: PairedDifference) -> str:
    difference = item.difference
    size = Estimate(abs(difference.value), difference.unit, *sorted(_sizes(difference)))
    return f"{_interval_of(size)}, {percent(abs(item.relative), sign=False)}"


def _with(payload: str) -> str:
    return "" if payload == ANY_PAYLOAD else f" with {payload} kg"


def _total(metrics: Metrics, signal: str, metric: str) -> Estimate | None:
    found = metrics.get(signal, {}).get(metric)
    return None if found is None else found.total


def milliseconds(estimate: Estimate, *, sign: bool = False) -> str:
    """Seconds as `12.3 ms (10.1 to 14.5)`."""
    ends = [None if end is None else 1e3 * end for end in (estimate.low, estimate.high)]
    scaled = Estimate(1e3 * estimate.value, "ms", *ends)
    return _signed(scaled) if sign else _interval_of(scaled)


def _percent(estimate: Estimate) -> str:
    ends = [] if not has_interval(estimate) else [100.0 * float(end or 0.0) for end in (estimate.low, estimate.high)]
    told = f" ({significant(ends[0], 2)} to {significant(ends[1], 2)})" if ends else ""
    return f"{significant(100.0 * estimate.value, 2)}\N{NO-BREAK SPACE}%{told}"


def _interval_of(estimate: Estimate) -> str:
    """`0.0123 rad (0.0101 to 0.0145)`; a slope without its `/kg`, which the sentence says."""
    ends = interval(estimate)
    return _plain(estimate) + (f" ({ends})" if ends else "")


def _signed(estimate: Estimate) -> str:
    ends = interval(estimate, sign=True)
    text = with_unit(significant(estimate.value, sign=True), _unit(estimate))
    return text + (f" ({ends})" if ends else "")


def _plain(estimate: Estimate) -> str:
    return quantity(estimate.value, _unit(estimate))


def _unit(estimate: Estimate) -> str:
    return estimate.unit.removesuffix("/kg")
