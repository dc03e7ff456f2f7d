"""What the error depends on: velocity, position, load, delay, time since a restart."""

from __future__ import annotations

from trueup.core.analysis import Analysis
from trueup.report.chooser import Chooser, Menu, Table, TableRow, Variant, make_chooser
from trueup.report.figures import bins_figure, horizon_figure, lag_figure
from trueup.report.folder import RunFolder
from trueup.report.labels import SIGNALS, ordered, ordered_runs, source_title
from trueup.report.sections.base import Section
from trueup.report.sections.cells import lag_cell

AGAINST = ("velocity", "position", "load")


def causes_section(run: RunFolder) -> Section | None:
    """Only where the run was analyzed."""
    if run.analysis is None:
        return None
    context = {
        "bins": bins_chooser(run, run.analysis),
        "lags": lags_chooser(run, run.analysis),
        "horizon": horizon_chooser(run, run.analysis),
    }
    return Section("causes", "What the error depends on", context) if any(context.values()) else None


def bins_chooser(run: RunFolder, analysis: Analysis) -> Chooser | None:
    """Error against velocity, position or load, per signal and joint."""
    leaves = [
        (signal, joint, against)
        for signals in analysis.bins.values()
        for signal, joints in signals.items()
        for joint, curves in joints.items()
        for against in curves
    ]
    menus = [
        Menu("Signal", [(name, name) for name in ordered({leaf[0] for leaf in leaves}, SIGNALS)]),
        Menu("Joint", [(name, name) for name in ordered({leaf[1] for leaf in leaves}, run.gap.joints)]),
        Menu("Against", [(name, name) for name in ordered({leaf[2] for leaf in leaves}, AGAINST)]),
    ]

    def make(signal: str, joint: str, against: str) -> Variant | None:
        curves = {}
        for label in ordered_runs(analysis.bins):
            curve = analysis.bins[label].get(signal, {}).get(joint, {}).get(against)
            if curve is not None:
                curves[label] = curve
        figure = bins_figure(curves, run.styles, against=against, signal=signal)
        return Variant(figures={"bins": figure}) if curves else None

    return make_chooser("bins-chooser", menus, make, preferred=("position", "", "velocity"))


def lags_chooser(run: RunFolder, analysis: Analysis) -> Chooser | None:
    """How far each joint runs behind the command and behind each run; there is nothing to choose."""
    joints = ordered({joint for values in analysis.lags.values() for joint in values}, run.gap.joints)
    if not joints:
        return None
    sources = ordered_runs(analysis.lags)
    lags = {label: analysis.lags[label] for label in sources}
    rows = [TableRow(joint, [lag_cell(lags[label].get(joint)) for label in sources]) for joint in joints]
    caption = "Delay of the measured motion: measured(t) = source(t − delay), 95 % interval below it."
    table = Table(["Joint", *(source_title(label) for label in sources)], rows, caption)
    variant = Variant(tables={"lags": table}, figures={"lags": lag_figure(joints, lags, run.styles)})
    return make_chooser("lags-chooser", [], lambda: variant, preferred=())


def horizon_chooser(run: RunFolder, analysis: Analysis) -> Chooser | None:
    """Error over the time since a restart, per signal and joint."""
    leaves = [
        (signal, joint)
        for signals in analysis.horizon.values()
        for signal, joints in signals.items()
        for joint in joints
    ]
    menus = [
        Menu("Signal", [(name, name) for name in ordered({leaf[0] for leaf in leaves}, SIGNALS)]),
        Menu("Joint", [(name, name) for name in ordered({leaf[1] for leaf in leaves}, run.gap.joints)]),
    ]

    def make(signal: str, joint: str) -> Variant | None:
        curves = {
            label: analysis.horizon[label][signal][joint]
            for label in ordered_runs(analysis.horizon)
            if joint in analysis.horizon[label].get(signal, {})
        }
        return Variant(figures={"horizon": horizon_figure(curves, run.styles, signal=signal)}) if curves else None

    return make_chooser("horizon-chooser", menus, make, preferred=("position", ""))
