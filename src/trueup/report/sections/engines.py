"""Engines and payloads side by side: error, lag and smoothness, trends, and the trace of the motions (GapONet 3.3)."""

from __future__ import annotations

import math
from collections.abc import Mapping

from trueup.core.engines import ANY_PAYLOAD, EngineComparison, JointPlane, Trend
from trueup.core.results import Estimate, MetricResult, Metrics
from trueup.report.chooser import Cell, Chooser, Menu, Table, TableRow, Variant, make_chooser
from trueup.report.engine_figures import envelope_figure, path_figure, payload_figure
from trueup.report.figures import bars_figure
from trueup.report.folder import RunFolder
from trueup.report.labels import COMMAND, axis_title, metric_title, ordered, run_title
from trueup.report.numbers import NOTHING, plural
from trueup.report.sections.base import Section
from trueup.report.sections.cells import difference_cell, estimate_cell
from trueup.report.sections.groups import group_order

_SHOWN = ("rmse", "phase_lag", "smoothness")
_SIGNALS = ("position", "velocity", "torque")
_MEAN = ""
_PAYLOAD = "payload_kg"


def engines_section(run: RunFolder) -> Section | None:
    """Only where two engines or two payloads were compared."""
    if run.engines is None:
        return None
    context = {
        "engines": engines_chooser(run),
        "payloads": payloads_chooser(run, run.engines),
        "plane": None if run.engines.plane is None else plane_chooser(run, run.engines.plane),
    }
    return Section("engines", "Engines and payloads", context) if any(context.values()) else None


def engines_chooser(run: RunFolder) -> Chooser | None:
    """Joint by joint, one column per simulator, for all motions or those of one payload; two engines at least."""
    if len({label.partition("/")[0] for label in run.simulators}) < 2:
        return None
    payloads = group_order(list(run.gap.groups.get(_PAYLOAD, {})))
    menus = [
        Menu("Signal", [(name, name) for name in _SIGNALS]),
        Menu("Metric", [(name, metric_title(name)) for name in _SHOWN]),
        Menu("Payload", [(ANY_PAYLOAD, "all motions"), *((load, f"{load} kg") for load in payloads)]),
    ]

    def make(signal: str, metric: str, payload: str) -> Variant | None:
        results = {
            label: found
            for label in run.simulators
            if (found := _result(run, label, payload, signal, metric)) is not None
        }
        if len(results) < 2:
            return None
        joints = ordered({joint for item in results.values() for joint in item.per_joint}, run.gap.joints)
        rows = [
            TableRow(joint, [estimate_cell(item.per_joint.get(joint)) for item in results.values()]) for joint in joints
        ]
        rows.append(
            TableRow("Mean of scored joints", [estimate_cell(item.total) for item in results.values()], strong=True)
        )
        where = "all motions" if payload == ANY_PAYLOAD else f"motions with {payload} kg"
        count = max(item.episodes for item in results.values())
        caption = (
            f"{metric_title(metric)} of {signal}, {where} ({plural(count, 'motion')}), 95 % interval below it. "
            f"{_MEANING[metric]}"
        )
        unit = next(iter(results.values())).total.unit
        bars = {
            label: {joint: value for joint, value in item.per_joint.items() if value.unit == unit}
            for label, item in results.items()
        }
        shown = [joint for joint in joints if any(joint in items for items in bars.values())]
        figure = bars_figure(shown, bars, run.styles, title=axis_title(signal, metric, unit))
        if any(value.value < 0 for items in bars.values() for value in items.values()):
            figure["layout"]["xaxis"].pop("rangemode")
        table = Table(["Joint", *(run_title(label) for label in results)], rows, caption)
        return Variant(tables={"engines": table}, figures={"engines": figure})

    return make_chooser("engines-chooser", menus, make, preferred=("position", "rmse", ANY_PAYLOAD))


_MEANING = {
    "rmse": "",
    "phase_lag": "Positive: the robot moves later than the simulation.",
    "smoothness": "Mean difference of the second differences: an engine that shakes where the robot does not is high.",
}


def payloads_chooser(run: RunFolder, engines: EngineComparison) -> Chooser | None:
    """Error and lag over the payload, with the slope of the straight line."""
    groups = run.gap.groups.get(_PAYLOAD, {})
    if len(groups) < 2 or not all(_is_number(load) for load in groups):
        return None
    menus = [
        Menu("Signal", [(name, name) for name in _SIGNALS]),
        Menu("Metric", [(name, metric_title(name)) for name in _SHOWN]),
        Menu("Joint", [(_MEAN, "mean of scored joints"), *((joint, joint) for joint in run.gap.joints)]),
    ]

    def make(signal: str, metric: str, joint: str) -> Variant | None:
        values: dict[str, dict[float, Estimate]] = {}
        for load in group_order(list(groups)):
            for label in run.runs:
                result = _result(run, label, load, signal, metric)
                estimate = None if result is None else result.per_joint.get(joint) if joint else result.total
                if estimate is not None:
                    values.setdefault(label, {})[float(load)] = estimate
        if not values:
            return None
        trends = {
            label: item
            for label in values
            if (item := engines.trends.get(label, {}).get(signal, {}).get(metric, {}).get(joint)) is not None
        }
        unit = next(iter(next(iter(values.values())).values())).unit
        figure = payload_figure(values, trends, run.styles, title=axis_title(signal, metric, unit))
        return Variant(
            tables={"payloads": _payload_table(values, trends, signal, metric)}, figures={"payloads": figure}
        )

    return make_chooser("payloads-chooser", menus, make, preferred=(_first_to_grow(engines), "rmse", _MEAN))


def _first_to_grow(engines: EngineComparison) -> str:
    """The signal whose error a payload visibly changes, the position if it does."""
    for signal in _SIGNALS:
        for label, signals in engines.trends.items():
            item = signals.get(signal, {}).get("rmse", {}).get(_MEAN)
            if label != COMMAND and item is not None and item.verdict == "grows":
                return signal
    return _SIGNALS[0]


def _payload_table(
    values: Mapping[str, Mapping[float, Estimate]], trends: Mapping[str, Trend], signal: str, metric: str
) -> Table:
    loads = sorted({load for items in values.values() for load in items})
    rows = [TableRow(f"{load:g} kg", [estimate_cell(items.get(load)) for items in values.values()]) for load in loads]
    caption = f"{metric_title(metric)} of {signal} by payload, 95 % interval below it."
    if trends:
        cells = [difference_cell(trends[label].slope) if label in trends else Cell(NOTHING) for label in values]
        rows.append(TableRow("Change per kg", cells, strong=True))
        words = [Cell(trends[label].verdict) if label in trends else Cell(NOTHING) for label in values]
        rows.append(TableRow("With the payload it", words))
        caption += " The change is the slope of a straight line, within motions where they were repeated with other "
        caption += "payloads; it grows or falls only if the interval of the slope excludes zero."
    if metric == "phase_lag" and COMMAND in values:
        caption += " The column of the command is the lag of the robot behind what it was told."
    return Table(["Payload", *(run_title(label) for label in values)], rows, caption)


def plane_chooser(run: RunFolder, plane: JointPlane) -> Chooser | None:
    """Envelopes over all motions or those of a payload, and single motions."""
    payloads = group_order(list(run.gap.groups.get(_PAYLOAD, {})))
    options = [
        ("envelope:", "all motions, as ellipses"),
        *((f"envelope:{load}", f"{load} kg, as ellipses") for load in payloads),
    ]
    for motion in plane.paths:
        load = plane.payloads.get(motion, ANY_PAYLOAD)
        options.append((f"path:{motion}", f"{motion} ({load} kg)" if load else motion))
    styles = run.styles

    def make(choice: str) -> Variant | None:
        kind, _, name = choice.partition(":")
        figure = envelope_figure(plane, name, styles) if kind == "envelope" else path_figure(plane, name, styles)
        return Variant(figures={"plane": figure}) if figure["data"] else None

    first = next((choice for choice, _ in options if choice.startswith("path:")), "envelope:")
    return make_chooser("plane-chooser", [Menu("Show", options)], make, preferred=(first,))


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def _result(run: RunFolder, label: str, payload: str, signal: str, metric: str) -> MetricResult | None:
    metrics: Metrics = (
        run.gap.runs.get(label, {}).get("all", {})
        if payload == ANY_PAYLOAD
        else run.gap.groups.get(_PAYLOAD, {}).get(payload, {}).get(label, {})
    )
    return metrics.get(signal, {}).get(metric)
