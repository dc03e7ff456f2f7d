"""The gap joint by joint, run against run."""

from __future__ import annotations

from trueup.core.results import MetricResult
from trueup.core.timeseries import BODY_PREFIX
from trueup.report.chooser import Chooser, Figure, Menu, Table, TableRow, Variant, make_chooser
from trueup.report.figures import bars_figure
from trueup.report.folder import RunFolder
from trueup.report.labels import (
    MAIN_METRIC,
    METRICS,
    SIGNALS,
    SPLITS,
    axis_title,
    main_split,
    metric_title,
    ordered,
    run_title,
    split_title,
)
from trueup.report.numbers import plural
from trueup.report.sections.base import Section
from trueup.report.sections.cells import difference_cell, estimate_cell, percent_cell, verdict_cell


def joints_section(run: RunFolder) -> Section | None:
    """Tables and bars per split, signal and metric."""
    chooser = joints_chooser(run)
    return None if chooser is None else Section("joints", "Joint by joint", {"chooser": chooser})


def joints_chooser(run: RunFolder) -> Chooser | None:
    """All choices of split, signal and metric that hold a number."""
    runs = run.gap.runs
    splits = ordered({split for items in runs.values() for split in items}, SPLITS)
    signals = ordered({s for items in runs.values() for m in items.values() for s in m}, SIGNALS)
    metrics = ordered(
        {name for items in runs.values() for m in items.values() for r in m.values() for name in r}, METRICS
    )
    menus = [
        Menu("Split", [(split, split_title(split)) for split in splits]),
        Menu("Signal", [(signal, signal) for signal in signals]),
        Menu("Metric", [(metric, metric_title(metric)) for metric in metrics]),
    ]

    def make(split: str, signal: str, metric: str) -> Variant | None:
        results = {
            label: runs[label][split][signal][metric]
            for label in run.runs
            if metric in runs[label].get(split, {}).get(signal, {})
        }
        return _variant(run, split, signal, metric, results) if results else None

    preferred = (main_split(splits), "position", MAIN_METRIC) if splits else ("", "", "")
    return make_chooser("joints-chooser", menus, make, preferred=preferred)


def _variant(run: RunFolder, split: str, signal: str, metric: str, results: dict[str, MetricResult]) -> Variant:
    joints = ordered({joint for result in results.values() for joint in result.per_joint}, run.gap.joints)
    tables = {"joints": _joints_table(run, split, signal, metric, results, joints)}
    pairs = _pairs_table(run, split, signal, metric)
    if pairs.rows:
        tables["pairs"] = pairs
    return Variant(tables=tables, figures={"joints": joints_figure(run, signal, metric, results, joints)})


def _joints_table(
    run: RunFolder, split: str, signal: str, metric: str, results: dict[str, MetricResult], joints: list[str]
) -> Table:
    scored = set(run.gap.scored_joints)
    rows = [
        TableRow(
            joint,
            [estimate_cell(result.per_joint.get(joint)) for result in results.values()],
            note="not scored" if joint in run.gap.joints and joint not in scored else "",
        )
        for joint in joints
    ]
    kind = "Body" if signal.startswith(BODY_PREFIX) else "Joint"
    if len(joints) > 1:
        name = "Mean of scored joints" if kind == "Joint" and len(scored) < len(joints) else "Mean"
        rows.append(TableRow(name, [estimate_cell(result.total) for result in results.values()], strong=True))
    counts = sorted({result.episodes for result in results.values()})
    count = plural(counts[0], "motion") if len(counts) == 1 else f"{counts[0]} to {plural(counts[-1], 'motion')}"
    caption = (
        f"{metric_title(metric)} of {signal}, {split_title(split)} ({count}), 95 % interval over motions below it."
    )
    return Table([kind, *(run_title(label) for label in results)], rows, caption)


def _pairs_table(run: RunFolder, split: str, signal: str, metric: str) -> Table:
    rows = [
        TableRow(
            f"{run_title(item.run)} against {run_title(item.baseline)}",
            [
                difference_cell(item.difference),
                percent_cell(item.relative),
                verdict_cell(item.verdict),
            ],
        )
        for item in sorted(
            run.gap.paired,
            key=lambda item: (run.runs.index(item.baseline) if item.baseline in run.runs else -1, item.run),
        )
        if (item.split, item.signal, item.metric) == (split, signal, metric)
    ]
    caption = (
        "Differences on the same motions, with 95 % interval: better or worse only if the interval excludes zero. "
        "A negative difference means a smaller value."
    )
    return Table(["Paired comparison", "Difference", "Relative", "Verdict"], rows, caption)


def joints_figure(
    run: RunFolder, signal: str, metric: str, results: dict[str, MetricResult], joints: list[str]
) -> Figure:
    """Bars per joint and run; only joints in the unit of the total, since bars of rad and m do not compare."""
    unit = next(iter(results.values())).total.unit
    bars = {
        label: {joint: item for joint, item in result.per_joint.items() if item.unit == unit}
        for label, result in results.items()
    }
    rows = [joint for joint in joints if any(joint in items for items in bars.values())]
    return bars_figure(rows, bars, run.styles, title=axis_title(signal, metric, unit))
