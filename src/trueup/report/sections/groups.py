"""The gap by payload, unit or condition, where the motions differ in one."""

from __future__ import annotations

from collections.abc import Mapping

from trueup.core.results import Metrics
from trueup.report.chooser import Menu, Table, TableRow, Variant, make_chooser
from trueup.report.figures import bars_figure
from trueup.report.folder import RunFolder
from trueup.report.labels import MAIN_METRIC, SIGNALS, axis_title, group_order, ordered, ordered_runs, run_title
from trueup.report.numbers import plural
from trueup.report.sections.base import Section
from trueup.report.sections.cells import estimate_cell

FIELDS = {
    "payload_kg": "payload",
    "kp_setting": "setting of the position gain",
    "unit": "robot unit",
    "condition": "condition",
}


def groups_section(run: RunFolder) -> Section | None:
    """Only for fields that have two or more values."""
    groups = {name: values for name, values in run.gap.groups.items() if len(values) > 1}
    signals = ordered(
        {
            signal
            for values in groups.values()
            for runs in values.values()
            for metrics in runs.values()
            for signal, results in metrics.items()
            if MAIN_METRIC in results
        },
        SIGNALS,
    )
    menus = [
        Menu("Group by", [(name, FIELDS.get(name, name)) for name in ordered(groups, FIELDS)]),
        Menu("Signal", [(signal, signal) for signal in signals]),
    ]

    def make(name: str, signal: str) -> Variant | None:
        return _variant(run, name, groups[name], signal)

    preferred = (menus[0].options[0][0], "position") if groups else ("", "")
    chooser = make_chooser("groups-chooser", menus, make, preferred=preferred) if signals else None
    return None if chooser is None else Section("groups", "By group", {"chooser": chooser})


def _variant(run: RunFolder, name: str, values: Mapping[str, Mapping[str, Metrics]], signal: str) -> Variant | None:
    labels = ordered_runs({label for runs in values.values() for label in runs})
    found = {
        value: {
            label: values[value][label][signal][MAIN_METRIC]
            for label in labels
            if MAIN_METRIC in values[value].get(label, {}).get(signal, {})
        }
        for value in group_order(list(values))
    }
    found = {value: results for value, results in found.items() if results}
    if not found:
        return None
    rows = [
        TableRow(
            _value_title(name, value),
            [estimate_cell(results[label].total if label in results else None) for label in labels],
            note=plural(max(result.episodes for result in results.values()), "motion"),
        )
        for value, results in found.items()
    ]
    bars = {
        label: {_value_title(name, value): results[label].total for value, results in found.items() if label in results}
        for label in labels
    }
    unit = next(result.total.unit for results in found.values() for result in results.values())
    title = axis_title(signal, MAIN_METRIC, unit)
    caption = f"RMSE of {signal}, mean of scored joints over all motions of the group, 95 % interval below it."
    figure = bars_figure([row.head for row in rows], bars, run.styles, title=title)
    columns = [FIELDS.get(name, name).capitalize(), *(run_title(label) for label in labels)]
    return Variant(tables={"groups": Table(columns, rows, caption)}, figures={"groups": figure})


def _value_title(name: str, value: str) -> str:
    return f"{value} kg" if name == "payload_kg" and value not in ("", "None") else value or "not recorded"
