"""The motions to record next, designed for what a fit leaves unsure: lines to copy, and what they promise."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from trueup.core.design_result import DesignResult, Foreseen
from trueup.core.fit_result import FIT_CONFIG, STOCK_ROBOT, FitResult, FittedParameter
from trueup.core.traces import MEASURED, TraceSet
from trueup.report.chooser import Cell, Table, TableRow
from trueup.report.fit_words import CAUSES, kind_of, listed
from trueup.report.folder import OWN_DATASET, PLANS, RunFolder
from trueup.report.numbers import NOTHING, percent, plural, significant, with_unit
from trueup.report.recipes import Recipe

# Of the speeds of a joint this quantile counts: the rest is noise of its readings.
_FAST = 0.99
# A designed motion has harmonics up to this frequency [Hz].
_HIGHEST_HZ = 1.0
# Beyond that a share would be no measure of a factor.
_LARGEST_SHARE = 0.5

_DESIGN = """\
trueup design --robot {robot} --fit fit.json --count {count}{limits} --out {plans}
"""
_RECORD = """\
trueup record --robot {robot} --hardware ros2 --plan {plans} --out recorded
trueup identify recorded --robot {robot}{config} --out identified
trueup replay {dataset} --robot identified/robot.fitted.yaml --label mujoco/identified
trueup gap {dataset} --runs mujoco/fitted,mujoco/identified --out judged"""


def design_recipe(run: RunFolder, fit: FitResult) -> Recipe | None:
    """How to have motions designed for this fit, record them, fit again, and see whether that is better.

    None where every number is determined.
    """
    unsure = unsure_parameters(fit)
    if not unsure:
        return None
    # Folders of fits that were made before these files were kept have neither.
    robot = STOCK_ROBOT if STOCK_ROBOT in run.given_files else "path/to/robot.yaml"
    lines = _RECORD.format(
        robot=robot,
        config=f" --config {FIT_CONFIG}" if FIT_CONFIG in run.given_files else "",
        plans=PLANS,
        dataset=OWN_DATASET if run.own_dataset else "path/to/dataset",
    )
    limits = ""
    if promised(run) is None:
        limits = limit_options(usual_speed(run.traces, run.gap.scored_joints), stated=run.stated_limits)
        lines = _DESIGN.format(robot=robot, count=count_for(unsure), limits=limits, plans=PLANS) + lines
    return Recipe("Motions designed for that", design_words(unsure, limits_asked=bool(limits)), lines)


def promised(run: RunFolder) -> DesignResult | None:
    """What motions promise that were designed for this fit; None if there are none, or they are for another."""
    if run.fit is None or run.design is None:
        return None
    known = {item.name: item.value for item in run.fit.free}
    same = known.keys() == {item.name for item in run.design.parameters} and all(
        math.isclose(item.value, known[item.name], rel_tol=1e-6, abs_tol=1e-12) for item in run.design.parameters
    )
    return run.design if same else None


def unsure_parameters(fit: FitResult) -> list[FittedParameter]:
    """Those that the motions determine weakly or not at all, the least certain first."""
    unsure = [item for item in fit.free if kind_of(item) in ("weakly", "no")]
    return sorted(unsure, key=lambda item: (-(item.prior_share or 0.0), item.name))


def count_for(unsure: Sequence[FittedParameter]) -> int:
    """One motion for each kind of cause that is unsure, and one more: what shows one kind may hide another."""
    return len({item.cause for item in unsure}) + 1


def design_words(unsure: Sequence[FittedParameter], *, limits_asked: bool) -> str:
    """What the lines do, and what to look at before a robot moves."""
    causes = [cause for cause in CAUSES if cause in {item.cause for item in unsure}]
    most = listed([item.name for item in unsure], limit=3)
    what = "1 number that is" if len(unsure) == 1 else f"{plural(len(unsure), 'number')} that are"
    words = [
        f"For {what} unsure, most of all {most}: a motion for each of {listed(causes)}, and one more.",
        "Run the lines in the folder of these results. The robot is the one as it came, not the fitted one.",
    ]
    if limits_asked:
        words.append("The limits are what the recorded motions reached: put those of your robot.")
    words.append("The last lines judge the new fit on the motions of this report.")
    return " ".join(words)


def usual_speed(traces: TraceSet | None, joints: Sequence[str]) -> float | None:
    """How fast a joint was, the median over joints that moved [rad/s or m/s]; None without curves."""
    found = [speed for joint in joints if (speed := _fastest(traces, joint)) > 0] if traces else []
    return float(np.median(found)) if found else None


def limit_options(speed: float | None, *, stated: Sequence[str] = ()) -> str:
    """Options for what the model does not state: this speed, and the acceleration of the fastest harmonic at it."""
    if speed is None:
        return ""
    values = {"velocity": speed, "acceleration": 2.0 * math.pi * _HIGHEST_HZ * speed}
    options = [f"--{name}-limit {float(f'{value:.2g}'):g}" for name, value in values.items() if name not in stated]
    return f" \\\n  {' '.join(options)}" if options else ""


def promise_table(design: DesignResult) -> Table:
    """Standard deviations before and after the designed motions."""
    rows = [
        TableRow(
            item.name,
            [
                Cell(deviation_words(item, item.before)),
                Cell(NOTHING if item.random is None else deviation_words(item, item.random)),
                Cell(deviation_words(item, item.designed), extra=percent(item.designed / item.before - 1.0)),
            ],
        )
        for item in design.parameters
    ]
    caption = (
        "Predicted standard deviations, if the robot is as the fit says: as it is known now, after as many random "
        "motions, and after the designed ones."
    )
    return Table(["Parameter", "Now", "After random motions", "After these motions"], rows, caption)


def deviation_words(item: Foreseen, std: float) -> str:
    """`7.2 %`, or `factor 2.7` where a share says little; with its unit on a linear scale."""
    if item.transform == "linear":
        return with_unit(significant(std, 2), item.unit)
    return percent(std, sign=False) if std < _LARGEST_SHARE else f"factor {significant(math.exp(min(std, 20.0)), 2)}"


def _fastest(traces: TraceSet, joint: str) -> float:
    """Speed of a joint over all motions, from its measured positions; 0 if it has none or never moved."""
    speeds = [np.zeros(0)]
    for episode in traces.episodes.values():
        for trace in episode.traces:
            if (trace.signal, trace.joint) == ("position", joint) and MEASURED in trace.curves:
                step_s = np.diff(trace.time_s.astype(np.float64))
                change = np.abs(np.diff(trace.curves[MEASURED].astype(np.float64)))
                speeds.append(change[step_s > 0] / step_s[step_s > 0])
    every = np.concatenate(speeds)
    every = every[np.isfinite(every)]
    return float(np.quantile(every, _FAST)) if every.size else 0.0
