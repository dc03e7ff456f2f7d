"""Results as tables for the terminal."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import replace

from rich.markup import escape
from rich.table import Table

from trueup.core.close_result import CloseResult
from trueup.core.results import Estimate, GapResult, Ladder, MetricResult, Metrics, PairedDifference

_MAIN = "rmse"
# What stands for the RMSE of a joint where the signal is that of a body.
_OF_BODIES = {"body.position": "position_norm", "body.rotation": "rotation_distance"}
_COMPARED = {"position": _MAIN, **_OF_BODIES}


def number(estimate: Estimate) -> str:
    """`0.0365 [0.021, 0.054] rad`; the interval is left out where there is none."""
    if math.isnan(estimate.value):
        return "not defined"
    unit = "" if estimate.unit == "1" else f" {estimate.unit}"
    if estimate.low is None or estimate.high is None:
        return f"{estimate.value:.4g}{unit}"
    return f"{estimate.value:.4g} [{estimate.low:.3g}, {estimate.high:.3g}]{unit}"


def _short(estimate: Estimate) -> str:
    """The same to two digits and without its unit."""
    if math.isnan(estimate.value):
        return "not defined"
    value, low, high = (
        "" if own is None else f"{own:.0f}" if abs(own) >= 99.5 else f"{own:.2g}"
        for own in (estimate.value, estimate.low, estimate.high)
    )
    return f"{value} [{low}, {high}]" if low and high else value


def ladder_table(ladder: Ladder, *, signal: str = "position", metric: str = "rmse") -> Table:
    """One row per rung, one column per split."""
    present = {split for rung in ladder.rungs for split in rung.splits}
    order = ("train", "val", "test") if present - {"all"} else ("all",)
    splits = [split for split in order if split in present]
    results = [rung.splits.get(split, {}).get(signal, {}).get(metric) for rung in ladder.rungs for split in splits]
    units = sorted({result.total.unit for result in results if result is not None})
    title = f"{signal} {metric} [{' or '.join(units)}], mean over scored joints and motions, with 95 % intervals"
    table = Table(title=escape(title), title_justify="left")
    table.add_column("rung")
    for split in splits:
        episodes = max((_episodes(rung.splits.get(split, {}), signal, metric) for rung in ladder.rungs), default=0)
        table.add_column(f"{split} ({episodes})", justify="right")
    table.add_column("seconds", justify="right")
    _say_where_none(table, {result.episodes for result in results if result is not None})
    for rung in ladder.rungs:
        cells = []
        for split in splits:
            result = rung.splits.get(split, {}).get(signal, {}).get(metric)
            cells.append("" if result is None else _short(result.total))
        table.add_row(rung.name + (" *" if rung.chosen else ""), *cells, f"{rung.seconds:.1f}")
    return table


def steps_table(result: CloseResult) -> Table:
    """One row per step of a close."""
    table = Table(title="steps", title_justify="left")
    for name in ("step", "", "seconds", "what"):
        table.add_column(name, justify="right" if name == "seconds" else "left", overflow="fold")
    for step in result.steps:
        table.add_row(step.name, step.status, f"{step.seconds:.1f}", escape(step.what))
    return table


def gap_table(gap: GapResult, *, metric: str = "rmse") -> Table:
    """One row per run, split and signal."""
    has_bodies = metric == _MAIN and any(
        signal in _OF_BODIES for splits in gap.runs.values() for items in splits.values() for signal in items
    )
    about = " (of bodies: mean distance and angle)" if has_bodies else ""
    table = Table(title=f"{metric}{about}, mean over scored joints and motions [95 % interval]", title_justify="left")
    for name in ("run", "split", "signal"):
        table.add_column(name)
    table.add_column("motions", justify="right")
    table.add_column(metric, justify="right")
    table.add_column("worst joint")
    counts = set[int]()
    for run, splits in gap.runs.items():
        for split, signals in splits.items():
            for signal, metrics in signals.items():
                own = _OF_BODIES.get(signal, metric) if metric == _MAIN else metric
                if own in metrics and not _repeats(splits, split, signal, own):
                    result = metrics[own]
                    counts.add(result.episodes)
                    table.add_row(run, split, signal, str(result.episodes), number(result.total), _worst(gap, result))
    _say_where_none(table, counts)
    return table


def _say_where_none(table: Table, counts: Collection[int]) -> None:
    """Below a table of means over so many motions, why some have no interval."""
    if 1 in counts:
        table.caption, table.caption_justify = "no interval from one motion", "left"


def verdicts(gap: GapResult, *, of: Collection[str] | None = None, split: str | None = None) -> list[str]:
    """What else must be known of the table, one line each: windows, and runs compared in pairs.

    Args:
        gap: the numbers.
        of: runs whose comparisons are told; all if None.
        split: the only one of which they are; all if None.
    """
    window_s = gap.settings.get("window_s")
    lines = [] if window_s is None else [f"simulations restarted from the measured state every {window_s:g} s"]
    whole = not any(gap.splits.values())  # no splits: the comparison over all motions is the only one
    for pair in gap.paired:
        if (of is not None and pair.run not in of) or split not in (None, pair.split):
            continue
        if _COMPARED.get(pair.signal) == pair.metric and (pair.split != "all" or whole):
            change = _change(pair)
            about = f"{pair.signal}, " if pair.signal in _OF_BODIES else ""
            lines.append(f"{pair.run} against {pair.baseline}, {about}{pair.split}: {change} ({pair.verdict})")
    return lines


def _change(pair: PairedDifference) -> str:
    """By how much, in percent where the baseline has an error that it can be a part of."""
    value = pair.difference.value
    if math.isnan(value):
        return "not defined"
    size = replace(pair.difference, value=abs(value), low=None, high=None)
    much = number(size) if math.isnan(pair.relative) else f"{100 * abs(pair.relative):.1f} %"
    return f"{much} {'less' if value < 0 else 'more'}"


def _repeats(splits: Mapping[str, Metrics], split: str, signal: str, metric: str) -> bool:
    """Whether `all` is the only other split once more."""
    others = [_episodes(metrics, signal, metric) for name, metrics in splits.items() if name != "all"]
    return split == "all" and len(others) == 1 and others[0] == _episodes(splits["all"], signal, metric)


def _episodes(metrics: Metrics, signal: str, metric: str) -> int:
    result = metrics.get(signal, {}).get(metric)
    return 0 if result is None else result.episodes


def _worst(gap: GapResult, result: MetricResult) -> str:
    joints = result.per_joint if not result.per_joint.keys() <= set(gap.joints) else gap.scored_joints
    scored = {joint: result.per_joint[joint] for joint in joints if joint in result.per_joint}
    known = {joint: item for joint, item in scored.items() if not math.isnan(item.value)}
    if not known:
        return ""
    joint = max(known, key=lambda name: known[name].value)
    return f"{joint} {known[joint].value:.4g}"
