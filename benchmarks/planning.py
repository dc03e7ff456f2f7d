"""Planning, timing and checking of motions of the Panda in its cell, one by one, and a set over two processes."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from statistics import median

import numpy as np

from benchmarks.table import Row, at_most, shown
from trueup.record import MotionGroup, PlanSetSpec, load_plans, plan_all, straightness_m
from trueup.robots import load_robot

_EACH = 40


def run() -> list[Row]:
    """Milliseconds for each kind of motion, checks at 1 kHz included; about a minute."""
    spec, robot = load_plans("paper"), load_robot("panda")
    scene = spec.scene(robot)
    spec.plan(scene, 0)  # imports
    rows, all_ms = [], []
    for name in ("multi-joint", "single-joint", "cartesian"):
        milliseconds = _times(spec, scene, name)
        all_ms += milliseconds * (1 if name == "cartesian" else 17)  # in the ratio of the set
        rows += [
            shown(f"{name}: median", median(milliseconds), "ms"),
            shown(f"{name}: 95th percentile", float(np.percentile(milliseconds, 95)), "ms"),
        ]
    rows.insert(
        0, at_most("one motion of the papers' set, planned, timed and checked: median", median(all_ms), 50, "ms")
    )
    others = PlanSetSpec(
        "others",
        (
            MotionGroup("b-spline", "b-spline", _EACH),
            MotionGroup("multisine", "multisine", _EACH),
            MotionGroup("random-field", "random-field", _EACH),
        ),
        workspace=spec.workspace,
    )
    rows += [shown(f"{group.name}: median", median(_times(others, scene, group.name)), "ms") for group in others.groups]
    lines = [spec.plan(scene, spec.number(f"cartesian/{index:05d}")) for index in range(10)]
    rows.append(
        at_most("largest deviation of 10 lines", 1e3 * max(straightness_m(scene, line) for line in lines), 1, "mm")
    )
    return [*rows, *_processes(spec.scaled(0.3), robot)]


def _times(spec, scene, name):
    group = next(group for group in spec.groups if group.name == name)
    milliseconds = []
    for index in range(min(_EACH, group.count)):
        start = time.perf_counter()
        spec.plan(scene, spec.number(f"{name}/{index:05d}"))
        milliseconds.append(1e3 * (time.perf_counter() - start))
    return milliseconds


def _processes(spec, robot):
    seconds = []
    for jobs in (1, 2):
        with tempfile.TemporaryDirectory() as folder:
            start = time.perf_counter()
            counts = plan_all(spec, robot, Path(folder) / "plans", jobs=jobs)
            seconds.append(time.perf_counter() - start)
    return [
        shown(f"{len(spec)} motions, one process", seconds[0], "s"),
        shown("the same, two processes, times faster", seconds[0] / seconds[1], "x"),
        shown("skipped", counts.skipped, ""),
    ]
