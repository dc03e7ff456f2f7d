"""The gap analysis: payloads, lag, saturation, conditions, engines, and torque block by block (GapONet 3.1, 3.3)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace

from trueup.core.engines import ANY_PAYLOAD, MEASURED, EngineComparison, JointPlane, Shift, Trend
from trueup.core.results import Estimate, MetricResult, Metrics, PairedDifference
from trueup.report.chooser import Cell, Chooser, Menu, Table, TableRow, Variant, make_chooser
from trueup.report.engine_figures import (
    MEASURED_STYLE,
    envelope_figure,
    path_figure,
    payload_figure,
    repetitions_of,
    retrace_figure,
)
from trueup.report.figures import bars_figure
from trueup.report.folder import RunFolder
from trueup.report.gap_words import findings
from trueup.report.labels import (
    COMMAND,
    axis_title,
    group_order,
    metric_title,
    ordered,
    plot_text,
    run_title,
    source_title,
)
from trueup.report.numbers import NOTHING, percent, plural
from trueup.report.sections.base import Section
from trueup.report.sections.cells import difference_cell, estimate_cell, verdict_cell
from trueup.report.sections.graybox import graybox_chooser

_SHOWN = ("rmse", "nrmse", "smoothness", "phase_lag")
_SIGNALS = ("position", "velocity", "torque")
_MEAN = ""
_PAYLOAD = "payload_kg"


def engines_section(run: RunFolder) -> Section | None:
    """Only where two payloads, two conditions or two engines were compared."""
    if run.engines is None:
        return None
    blocks = None if run.graybox is None else graybox_chooser(run.graybox, run.gap.joints)
    context = {
        "payloads": payloads_chooser(run, run.engines),
        "lag": lag_chooser(run, run.engines),
        "saturation": saturation_chooser(run),
        "shifts": shifts_chooser(run.engines),
        "plane": None if run.engines.plane is None else plane_chooser(run, run.engines.plane),
        "engines": engines_chooser(run),
        "nearer": nearer_chooser(run.engines),
        "blocks": blocks,
    }
    if not any(context.values()):
        return None
    notes = [] if run.graybox is None else run.graybox.notes
    return Section("engines", "Gap analysis", {**context, "findings": findings(run), "notes": notes})


def engines_chooser(run: RunFolder) -> Chooser | None:
    """Joint by joint, one column per simulator, for all motions or those of one payload; two engines at least."""
    if len({label.partition("/")[0] for label in run.simulators}) < 2:
        return None
    payloads = group_order(run.gap.groups.get(_PAYLOAD, {}))
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
    "nrmse": "Over the range of the measured motion.",
    "smoothness": "Mean difference of the second differences: an engine that shakes where the robot does not is high.",
}


def payloads_chooser(run: RunFolder, engines: EngineComparison) -> Chooser | None:
    """Error and lag over the payload, with the slope of the straight line."""
    groups = run.gap.groups.get(_PAYLOAD, {})
    if len(groups) < 2 or not all(_is_number(load) for load in groups):
        return None
    menus = [
        Menu("Signal", [(name, name) for name in _SIGNALS]),
        Menu("Metric", [(name, metric_title(name)) for name in _SHOWN if name != "phase_lag"]),
        _joint_menu(run),
    ]

    def make(signal: str, metric: str, joint: str) -> Variant | None:
        values = _over_payload(run, signal, metric, joint)
        if not values:
            return None
        trends = _trends(engines, values, signal, metric, joint)
        unit = next(iter(next(iter(values.values())).values())).unit
        figure = payload_figure(values, trends, run.styles, title=axis_title(signal, metric, unit))
        return Variant(
            tables={"payloads": _payload_table(values, trends, signal, metric)}, figures={"payloads": figure}
        )

    return make_chooser("payloads-chooser", menus, make, preferred=(_first_to_grow(engines), "rmse", _MEAN))


def lag_chooser(run: RunFolder, engines: EngineComparison) -> Chooser | None:
    """How late the robot is, behind its command and behind each simulation, over the payload or joint by joint."""
    groups = run.gap.groups.get(_PAYLOAD, {})
    if len(groups) < 2 or not all(_is_number(load) for load in groups):
        return None

    def make(joint: str) -> Variant | None:
        values = {
            label: {load: _in_milliseconds(item) for load, item in points.items()}
            for label, points in _over_payload(run, "position", "phase_lag", joint).items()
        }
        if not values:
            return None
        trends = {
            label: replace(item, slope=_in_milliseconds(item.slope), at_zero=1e3 * item.at_zero)
            for label, item in _trends(engines, values, "position", "phase_lag", joint).items()
        }
        figure = payload_figure(values, trends, run.styles, title="lag of the measured motion [ms]")
        names = {plot_text(run_title(label)): plot_text(source_title(label)) for label in values}
        for item in figure["data"]:
            if "name" in item:
                item["name"] = names[item["name"]]
        table = _payload_table(values, trends, "position", "phase_lag")
        return Variant(tables={"lag": table}, figures={"lag": figure})

    return make_chooser("lag-chooser", [_joint_menu(run)], make, preferred=(_MEAN,))


def saturation_chooser(run: RunFolder) -> Chooser | None:
    """Share of samples at the torque limit, measured and in each simulation, by payload or over all motions."""

    def make(joint: str) -> Variant | None:
        bars: dict[str, dict[str, Estimate]] = {}
        for load in group_order(run.gap.groups.get(_PAYLOAD, {})) or [ANY_PAYLOAD]:
            row = f"{load} kg" if load else "all motions"
            for label in run.simulators:
                for name, metric in ((MEASURED, "saturation_measured"), (label, "saturation_simulated")):
                    result = _result(run, label, load, "torque", metric)
                    found = None if result is None else result.per_joint.get(joint) if joint else result.total
                    if found is not None and math.isfinite(found.value):
                        bars.setdefault(name, {})[row] = _in_percent(found)
        if not bars:
            return None
        rows = list(dict.fromkeys(row for values in bars.values() for row in values))
        styles = {MEASURED: MEASURED_STYLE, **run.styles}
        figure = bars_figure(rows, bars, styles, title="samples at the torque limit [%]")
        cells = [TableRow(row, [estimate_cell(values.get(row)) for values in bars.values()]) for row in rows]
        caption = (
            "Share of the samples whose torque is at the joint's limit or above, 95 % interval below it. A sensor that "
            "reads a little less than the motor gives never sees the limit: then the measured share is too small."
        )
        table = Table(["Payload", *bars], cells, caption)
        return Variant(tables={"saturation": table}, figures={"saturation": figure})

    return make_chooser("saturation-chooser", [_joint_menu(run)], make, preferred=(_MEAN,))


def _joint_menu(run: RunFolder) -> Menu:
    return Menu("Joint", [(_MEAN, "mean of scored joints"), *((joint, joint) for joint in run.gap.joints)])


def _over_payload(run: RunFolder, signal: str, metric: str, joint: str) -> dict[str, dict[float, Estimate]]:
    """Run -> payload -> estimate of a joint or of the mean over joints."""
    values: dict[str, dict[float, Estimate]] = {}
    for load in group_order(run.gap.groups.get(_PAYLOAD, {})):
        for label in run.runs:
            result = _result(run, label, load, signal, metric)
            estimate = None if result is None else result.per_joint.get(joint) if joint else result.total
            if estimate is not None:
                values.setdefault(label, {})[float(load)] = estimate
    return values


def _trends(engines: EngineComparison, labels: Iterable[str], signal: str, metric: str, joint: str) -> dict[str, Trend]:
    found = {label: engines.trends.get(label, {}).get(signal, {}).get(metric, {}).get(joint) for label in labels}
    return {label: item for label, item in found.items() if item is not None}


def _in_milliseconds(estimate: Estimate) -> Estimate:
    return _scaled(estimate, 1e3, estimate.unit.replace("s", "ms", 1))


def _in_percent(estimate: Estimate) -> Estimate:
    return _scaled(estimate, 1e2, "%")


def _scaled(estimate: Estimate, factor: float, unit: str) -> Estimate:
    ends = (None if end is None else factor * end for end in (estimate.low, estimate.high))
    return Estimate(factor * estimate.value, unit, *ends)


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
        bent = {label: (item.bend, item.shape) for label, item in trends.items() if item.bend is not None}
        if bent and metric != "phase_lag":
            cells = [
                replace(difference_cell(bent[label][0]), extra=bent[label][1]) if label in bent else Cell(NOTHING)
                for label in values
            ]
            rows.append(TableRow("Bend in the middle", cells))
            caption += (
                " The bend is how much lower a parabola is in the middle than the straight line between its ends."
            )
        caption += " The change is the slope of a straight line, within motions where they were repeated with other "
        caption += "payloads; it grows or falls only if the interval of the slope excludes zero."
    title = run_title
    if metric == "phase_lag":
        title, caption = source_title, caption.replace("phase lag of position", "How late the measured motion is")
    return Table(["Payload", *(title(label) for label in values)], rows, caption)


def plane_chooser(run: RunFolder, plane: JointPlane) -> Chooser | None:
    """Envelopes over all motions or those of a payload, and single motions."""
    payloads = group_order(run.gap.groups.get(_PAYLOAD, {}))
    options = [
        ("envelope:", "all motions, as ellipses"),
        *((f"envelope:{load}", f"{load} kg, as ellipses") for load in payloads),
    ]
    repeated = [name for name in dict.fromkeys(plane.executed.values()) if len(repetitions_of(plane, name)) > 1]
    options += [(f"again:{name}", f"{name}, all repetitions") for name in repeated]
    for motion in plane.paths:
        load = plane.payloads.get(motion, ANY_PAYLOAD)
        options.append((f"path:{motion}", f"{motion} ({load} kg)" if load else motion))
    styles = run.styles

    def make(choice: str) -> Variant | None:
        kind, _, name = choice.partition(":")
        if kind == "again":
            figure = retrace_figure(plane, name)
        else:
            figure = envelope_figure(plane, name, styles) if kind == "envelope" else path_figure(plane, name, styles)
        return Variant(figures={"plane": figure}) if figure["data"] else None

    first = next((choice for choice, _ in options if choice.startswith(("again:", "path:"))), "envelope:")
    return make_chooser("plane-chooser", [Menu("Show", options)], make, preferred=(first,))


def shifts_chooser(engines: EngineComparison) -> Chooser | None:
    """What another condition or payload does to the same motions, as a table."""
    if not engines.shifts:
        return None
    runs = list(dict.fromkeys(run for shift in engines.shifts for run in shift.gaps if run != COMMAND))
    rows = []
    for shift in engines.shifts:
        unit = " kg" if shift.by == _PAYLOAD else ""
        rows.append(
            TableRow(
                f"{shift.second}{unit} against {shift.first}{unit}",
                [
                    estimate_cell(_in_percent(shift.share)),
                    estimate_cell(shift.offset),
                    difference_cell(_in_milliseconds(shift.lag)),
                    *(_gap_cell(shift, run, "position.rmse") for run in runs),
                    *(_gap_cell(shift, run, "position.nrmse") for run in runs[:1]),
                    *(_gap_cell(shift, run, "torque.saturation_measured") for run in runs[:1]),
                ],
                note=plural(shift.motions, "motion"),
            )
        )
    columns = [
        *("The same motions, with", "Path differs by", "Mean posture by", "Lag behind the command by"),
        *(f"Position RMSE of {run}" for run in runs),
        *(f"NRMSE of {run}" for run in runs[:1]),
        *("Samples at the torque limit" for _ in runs[:1]),
    ]
    caption = (
        "What changes where motions are repeated, 95 % interval over motions below it. The path is compared whatever "
        "the time, in percent of the size of a motion (the standard deviation of its samples)."
    )
    return make_chooser(
        "shifts-chooser", [], lambda: Variant(tables={"shifts": Table(columns, rows, caption)}), preferred=()
    )


def _gap_cell(shift: Shift, run: str, metric: str) -> Cell:
    found = shift.gaps.get(run, {}).get(metric)
    if found is None:
        return Cell(NOTHING)
    return difference_cell(_in_percent(found) if found.unit == "1" else found)


def nearer_chooser(engines: EngineComparison) -> Chooser | None:
    """Engine against engine on the same motions, payload by payload."""
    pairs = list(dict.fromkeys((item.run, item.baseline) for items in engines.nearer.values() for item in items))
    kinds = list(dict.fromkeys((item.signal, item.metric) for items in engines.nearer.values() for item in items))
    menus = [Menu("Engines", [("\t".join(pair), f"{pair[0]} against {pair[1]}") for pair in pairs])]

    def make(pair: str) -> Variant | None:
        run, _, baseline = pair.partition("\t")
        rows = []
        for payload, items in engines.nearer.items():
            found = {(item.signal, item.metric): item for item in items if (item.run, item.baseline) == (run, baseline)}
            cells = [_nearer_cell(found.get(kind)) for kind in kinds]
            if found:
                rows.append(TableRow(f"{payload} kg" if payload else "all motions", cells, strong=not payload))
        columns = ["Payload", *(f"{metric_title(metric).split(' (')[0]} of {signal}" for signal, metric in kinds)]
        caption = (
            f"{run} minus {baseline} on the same motions, 95 % interval below it; ▼ where {run} is nearer to the "
            f"robot, ▲ where {baseline} is, ≈ where that cannot be told."
        )
        return Variant(tables={"nearer": Table(columns, rows, caption)}) if rows else None

    return make_chooser("nearer-chooser", menus, make, preferred=("\t".join(pairs[0]),)) if pairs else None


def _nearer_cell(item: PairedDifference | None) -> Cell:
    if item is None:
        return Cell(NOTHING)
    cell, sign = difference_cell(item.difference), verdict_cell(item.verdict)
    return Cell(sign.text.removesuffix(item.verdict) + cell.text, cell.note, percent(item.relative), tone=item.verdict)


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
