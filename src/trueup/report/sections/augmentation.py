"""Learned corrections: what each network cuts, one motion as an example, and how far they can be trusted."""

from __future__ import annotations

import math
from collections.abc import Mapping

from trueup.core.augment_result import (
    ALL_JOINTS,
    AugmentResult,
    Coverage,
    Cut,
    ErrorKind,
    JointGap,
    ModelEvaluation,
    group_title,
    joint_title,
)
from trueup.core.results import Estimate
from trueup.core.timeseries import BODY_PREFIX
from trueup.core.traces import EpisodeTraces, Trace
from trueup.report.augment_choice import choice_sentence, chosen_order
from trueup.report.augment_figures import factor_figure, latency_figure, motion_figure, reliability_figure
from trueup.report.augment_words import (
    against,
    factor_interval,
    factor_words,
    lead,
    off_sentences,
    sentences,
)
from trueup.report.chooser import Cell, Chooser, Menu, Table, TableRow, Variant, make_chooser
from trueup.report.folder import RunFolder
from trueup.report.labels import MAIN_METRIC, SIGNALS, ordered, split_title
from trueup.report.numbers import NOTHING, percent, plural, pretty_unit, quantity, significant
from trueup.report.palette import Style
from trueup.report.sections.attention import attention_chooser, attention_sentences
from trueup.report.sections.base import Section

_ERRORS: dict[ErrorKind, str] = {"mse": "mean square error", "rmse": "root mean square error"}
# Curves of one motion: joints, and points each, so that the page stays small.
_MOST_JOINTS = 8
_POINTS = 220


def augmentation_section(run: RunFolder) -> Section | None:
    """Only where learned corrections were evaluated."""
    result = run.augment
    if result is None or not result.models or not result.signals:
        return None
    signal = told_signal(run, result)
    order = chosen_order(run, result, signal)
    best = result.model(order[0]) if order else result.best(signal)
    assert best is not None
    context = {
        "lead": lead(result, best, signal),
        "sentences": [
            *filter(None, [choice_sentence(result, elsewhere=bool(order))]),
            *sentences(result, best, signal, order=order),
        ],
        "notes": result.notes,
        "networks": network_table(result),
        "cuts": cuts_chooser(run, result),
        "gaps": gaps_table(result),
        "motion": motion_chooser(run, result, best),
        "coverage": confidence_chooser(run, result),
        "off": off_sentences(result),
        "attention": attention_chooser(result, _styles(run, result)),
        "looks": attention_sentences(result),
        "latency": latency_chooser(run, result),
    }
    return Section("augmentation", "Learned correction: what it is worth", context)


def told_signal(run: RunFolder, result: AugmentResult) -> str:
    """The signal that comes first: after a close the one that its rungs are chosen by, where a network corrects it."""
    corrected = {signal for model in result.models for signal in model.signals}
    chosen = run.close is not None and "position" in corrected.intersection(result.signals)
    return "position" if chosen else result.main_signal


def network_table(result: AugmentResult) -> Chooser:
    """Who is who."""
    rows = [
        TableRow(
            model.name,
            [
                Cell(model.method),
                Cell(f"{model.trained_run}{f' of {model.trained_robot}' if model.trained_robot else ''}"),
                Cell("yes" if model.causal else "no, it sees the whole motion"),
            ],
        )
        for model in result.models
    ]
    table = Table(["Network", "Method", "Trained to correct", "Runs in a control loop"], rows)
    return Chooser("networks-chooser", [], Variant(tables={"networks": table}), [])


def cuts_chooser(run: RunFolder, result: AugmentResult) -> Chooser | None:
    """Table and dots per group of motions, signal and kind of error; and the networks against each other."""
    menus = [
        _group_menu(result),
        Menu("Signal", [(signal, signal) for signal in ordered(result.signals, SIGNALS)]),
        Menu("Error", [(error, f"{error.upper()} ({words})") for error, words in _ERRORS.items()]),
    ]
    styles = _styles(run, result)

    def make(condition: str, signal: str, error: ErrorKind) -> Variant | None:
        if signal not in result.simulated[condition]:
            return None
        joints = result.joints_of(condition, signal)
        tables = {"cuts": _cuts_table(result, condition, signal, error, joints)}
        pairs = _pairs_table(result, condition, signal)
        if pairs.rows:
            tables["pairs"] = pairs
        cuts = {model.name: model.cuts[condition].get(signal, {}) for model in result.models}
        return Variant(tables=tables, figures={"cuts": factor_figure(joints, cuts, styles, signal)})

    preferred = (next(iter(result.conditions)), told_signal(run, result), "mse")
    return make_chooser("cuts-chooser", menus, make, preferred=preferred)


def _cuts_table(result: AugmentResult, condition: str, signal: str, error: ErrorKind, joints: list[str]) -> Table:
    stock = {joint: getattr(result.simulated[condition][signal][joint], error) for joint in joints}
    unit = result.unit_of(condition, signal, error)
    rows = []
    for joint in joints:
        cells = [Cell(_number(stock[joint], unit))]
        for model in result.models:
            cut = model.cuts[condition].get(signal, {}).get(joint)
            cells.append(_cut_cell(cut, error, unit, off=result.is_off(model, signal, joint)))
        rows.append(TableRow(joint_title(joint, signal), cells, strong=joint == ALL_JOINTS))
    count = plural(result.motions[condition], "motion")
    split = "" if result.split == "all" else f", {split_title(result.split)}"
    caption = (
        f"{_ERRORS[error].capitalize()} of {signal}{f' [{pretty_unit(unit)}]' if unit else ''}, "
        f"{group_title(condition)}{split} ({count}), pooled over samples; beside it how many times smaller the mean "
        "square error is than the simulation's, below it the paired 95 % interval of that, over whole motions. "
        "▼ better and ▲ worse where it excludes 1, ≈ undecided."
    )
    head = "Body" if signal.startswith(BODY_PREFIX) else "Joint"
    return Table([head, "simulation", *(model.name for model in result.models)], rows, caption)


def _number(estimate: Estimate, unit: str) -> str:
    return significant(estimate.value) if unit else quantity(estimate.value, estimate.unit)


def _cut_cell(cut: Cut | None, error: str, unit: str, *, off: bool) -> Cell:
    if cut is None:
        return Cell(NOTHING)
    shown = _number(getattr(cut, error), unit)
    if off:
        return Cell(shown, note="switched off", tone="undecided")
    sign = {"better": "▼", "worse": "▲"}.get(cut.verdict, "≈")
    factor = factor_words(cut.factor)
    tone = "" if cut.verdict == "better" else cut.verdict
    return Cell(shown, note=factor_interval(cut.factor), extra=f"{sign} {factor}" if factor else "", tone=tone)


def _pairs_table(result: AugmentResult, condition: str, signal: str) -> Table:
    """Every network against the others, all joints together."""
    names = [model.name for model in result.models]
    rows = []
    for name in names:
        cells = []
        for other in names:
            factor, verdict = against(result, name, other, condition, signal)
            if factor is None or not math.isfinite(factor.value):
                cells.append(Cell(NOTHING))
            else:
                tone = "" if verdict == "better" else verdict
                cells.append(Cell(factor_words(factor), note=factor_interval(factor), tone=tone))
        rows.append(TableRow(name, cells))
    caption = (
        f"Network against network: how many times smaller the {signal} MSE of the row is than that of the column, on "
        "the same motions, all joints together, with the paired 95 % interval."
    )
    return Table(["", *names], rows if len(names) > 1 else [], caption)


def gaps_table(result: AugmentResult) -> Chooser | None:
    """How far corrected bodies have come apart at their joints."""
    models = [model for model in result.models if model.gaps]
    if not models or not result.gaps:
        return None
    columns = {"measured": result.measured_gaps, "simulation": result.gaps}
    columns |= {model.name: model.gaps for model in models}
    rows = [
        TableRow(
            joint_title(joint),
            [_gap_cell(gaps.get(joint)) for gaps in columns.values()],
            strong=joint == ALL_JOINTS,
        )
        for joint in result.gaps
    ]
    table = Table(["Joint", *columns], rows, _GAPS_CAPTION)
    return Chooser("gaps-chooser", [], Variant(tables={"gaps": table}), [])


_GAPS_CAPTION = (
    "Distance between the two halves of a joint and, beside it, the angle off the joint's axis: mean over samples and "
    "motions; below, the mean over motions of the largest. A simulated robot has none, nor has a projected one. What "
    "is measured of a robot whose parts sit elsewhere than in its model has some, and corrections follow it there."
)


def _gap_cell(gap: JointGap | None) -> Cell:
    if gap is None:
        return Cell(NOTHING)
    most = f"at most {quantity(gap.apart_max.value, gap.apart.unit)}, {quantity(gap.turned_max.value, gap.turned.unit)}"
    return Cell(quantity(gap.apart.value, gap.apart.unit), note=most, extra=quantity(gap.turned.value, gap.turned.unit))


def motion_chooser(run: RunFolder, result: AugmentResult, best: ModelEvaluation) -> Chooser | None:
    """One typical motion of each group."""
    if run.traces is None:
        return None
    signal, styles = told_signal(run, result), run.styles
    networks = {model.name: model.run for model in result.models}
    found: dict[str, tuple[str, float]] = {}
    for condition in result.conditions[:-1] or result.conditions:
        motion = typical_motion(run, result, best, condition, signal)
        if motion is not None:
            found[condition] = motion
    menus = [
        Menu(
            "Motion",
            [
                (condition, f"{group_title(condition)}: {name}, MSE {significant(factor)} times smaller")
                for condition, (name, factor) in found.items()
            ],
        )
    ]

    def make(condition: str) -> Variant | None:
        assert run.traces is not None
        traces = shown_traces(run.traces.episodes[found[condition][0]], signal, result.run)
        figure = motion_figure(traces, result.run, networks, styles, shown=best.name)
        return Variant(figures={"motion": figure}) if figure["data"] else None

    return make_chooser("motion-chooser", menus, make, preferred=(next(iter(found), ""),))


def typical_motion(
    run: RunFolder, result: AugmentResult, model: ModelEvaluation, condition: str, signal: str
) -> tuple[str, float] | None:
    """The motion with the median cut among those whose curves were kept, and its factor; None if there is none."""
    assert run.traces is not None
    factors = {}
    for name in run.traces.episodes:
        if name not in result.conditions_of or (condition and result.conditions_of[name] != condition):
            continue
        before, after = (_squares(run, label, name, signal) for label in (result.run, model.run))
        if before > 0.0 and after > 0.0:
            factors[name] = before / after
    ranked = sorted(factors, key=lambda name: (factors[name], name))
    return (ranked[len(ranked) // 2], factors[ranked[len(ranked) // 2]]) if ranked else None


def _squares(run: RunFolder, label: str, motion: str, signal: str) -> float:
    """Sum of the mean square errors of the scored joints; 0 where they are not known."""
    errors = run.gap.episodes.get(label, {}).get(motion, {}).get(signal, {}).get(MAIN_METRIC, {})
    known = [errors[joint] for joint in run.gap.scored_joints if math.isfinite(errors.get(joint, math.nan))]
    return sum((value**2 for value in known), 0.0)


def shown_traces(motion: EpisodeTraces, signal: str, run: str) -> list[Trace]:
    """The curves of a signal, thinned; of many joints those with the largest error of the simulator."""
    traces = [trace for trace in motion.traces if trace.signal == signal and run in trace.curves]

    def error(trace: Trace) -> float:
        gap = trace.curves["measured"] - trace.curves[run]
        return float((gap[gap == gap] ** 2).mean()) if (gap == gap).any() else 0.0

    worst = sorted(traces, key=error, reverse=True)[:_MOST_JOINTS]
    return [trace.thinned(_POINTS) for trace in traces if trace in worst]


def confidence_chooser(run: RunFolder, result: AugmentResult) -> Chooser | None:
    """Coverage of the intervals joint by joint, and the reliability of "far off"."""
    menus = [
        _group_menu(result),
        Menu("Signal", [(signal, signal) for signal in ordered(result.signals, SIGNALS)]),
    ]
    styles = _styles(run, result)

    def make(condition: str, signal: str) -> Variant | None:
        tables, figures = {}, {}
        joints = result.joints_of(condition, signal)
        covered = [
            (model, items) for model in result.models if (items := model.coverage.get(condition, {}).get(signal, {}))
        ]
        if covered:
            rows = [
                TableRow(
                    joint_title(joint, signal),
                    [_coverage_cell(items.get(joint), model.coverage_target) for model, items in covered],
                    strong=joint == ALL_JOINTS,
                )
                for joint in joints
            ]
            heads = (_coverage_head(model) for model, _ in covered)
            tables["coverage"] = Table(["Joint", *heads], rows, _COVERAGE_CAPTION)
        curves = {
            model.name: model.reliability[condition][signal]
            for model in result.models
            if signal in model.reliability.get(condition, {})
        }
        if curves:
            rows = [
                TableRow(
                    name,
                    [
                        Cell(percent(curve.far, sign=False)),
                        Cell(percent(curve.error, sign=False)),
                        Cell(NOTHING if curve.skill is None else significant(curve.skill, 2)),
                    ],
                )
                for name, curve in curves.items()
            ]
            columns = ["", "Far off in", "Calibration error", "Skill"]
            tables["reliability"] = Table(columns, rows, _RELIABILITY_CAPTION)
            figures["reliability"] = reliability_figure(curves, styles)
        return Variant(tables=tables, figures=figures) if tables else None

    preferred = (next(iter(result.conditions)), told_signal(run, result))
    return make_chooser("confidence-chooser", menus, make, preferred=preferred)


_COVERAGE_CAPTION = (
    "How often the measured value lies in the interval around the corrected one: share of the samples of a motion, "
    "mean over motions, with its 95 % interval below it and the mean half width beside it."
)
_RELIABILITY_CAPTION = (
    "Calibration error: mean distance between predicted and seen. Skill: 1 if it knew every sample, 0 if it always "
    "said the mean."
)


def _coverage_head(model: ModelEvaluation) -> str:
    target = percent(model.coverage_target, sign=False)
    what = f"meant to be {target}, nothing promised" if model.coverage_note else f"promised {target}"
    return f"{model.name}, {what}"


def _coverage_cell(item: Coverage | None, target: float) -> Cell:
    if item is None:
        return Cell(NOTHING)
    share = item.share
    known = share.low is not None and share.high is not None
    ends = f"{percent(share.low or 0.0, sign=False)} to {percent(share.high or 0.0, sign=False)}" if known else ""
    short = share.high is not None and share.high < target
    half = f"± {quantity(item.half_width.value, item.half_width.unit)}"
    note = f"{ends}: too few" if short else ends
    return Cell(percent(share.value, sign=False), note=note, extra=half, tone="worse" if short else "")


def latency_chooser(run: RunFolder, result: AugmentResult) -> Chooser | None:
    """Histogram and percentiles of the time of one step."""
    timed = {model.name: model.latency for model in result.models if model.latency is not None}
    if not timed:
        return None
    rows = [
        TableRow(
            name,
            [
                *(Cell(quantity(value, "µs")) for value in (item.p50_us, item.p99_us, item.p999_us, item.max_us)),
                Cell(str(item.count)),
                Cell(NOTHING if item.missed is None else str(item.missed)),
            ],
            note=item.machine,
        )
        for name, item in timed.items()
    ]
    columns = ["", "Median", "99 %", "99.9 %", "Longest", "Steps", "Missed deadlines"]
    caption = "Time of one step of a stream, as it was taken when the network was timed."
    if any(item.period_us is not None for item in timed.values()):
        caption += " The vertical line is the period of the loop."
    table = Table(columns, rows, caption)
    figure = latency_figure(timed, _styles(run, result))
    return Chooser("latency-chooser", [], Variant({"latency": table}, {"latency": figure}), [])


def _group_menu(result: AugmentResult) -> Menu:
    options = [
        (condition, f"{group_title(condition)} ({result.motions[condition]})") for condition in result.conditions
    ]
    return Menu("Motions", options)


def _styles(run: RunFolder, result: AugmentResult) -> Mapping[str, Style]:
    """By the name of the network, as its run is drawn elsewhere."""
    return {model.name: run.styles[model.run] for model in result.models}
