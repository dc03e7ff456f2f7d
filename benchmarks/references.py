"""Stock models on real recordings, beside what the README files of the recordings state for them."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.recordings import recording
from benchmarks.table import Row, at_least, at_most
from trueup.core.results import GapResult
from trueup.robots import load_robot
from trueup.stages import close

STOCK = "mujoco/stock"
# README of so101_sage: position RMSE [rad], mean over joints 1 to 5 and over motions.
SO101 = {(STOCK, "val"): 0.0273, (STOCK, "test"): 0.0365, ("command", "val"): 0.0284, ("command", "test"): 0.0383}
# README of dfki_double_pendulum_A0: RMSE of joint 1 and 2 [deg], 0.5 s windows, commanded torque.
DOUBLE_PENDULUM = {
    "trajectory_00": (3.9, 15.5),
    "trajectory_01": (2.6, 9.0),
    "trajectory_02": (3.8, 11.3),
    "trajectory_03": (2.4, 9.3),
    "trajectory_11": (9.2, 23.6),
    "trajectory_12": (4.1, 15.4),
    "trajectory_13": (2.6, 7.0),
}
_SO101_PERCENT, _PENDULUM_PERCENT = 2.0, 5.0


def run() -> list[Row]:
    """How far `close` is from each stated number [%]; empty without the recordings."""
    arm, pendulum = recording("so101_sage"), recording("dfki_double_pendulum_A0")
    if arm is None or pendulum is None:
        return []
    with TemporaryDirectory() as folder:
        return [*_so101(_gap(arm, "so101", Path(folder))), *_pendulum(_gap(pendulum, "double_pendulum", Path(folder)))]


def _gap(logs: Path, robot: str, folder: Path) -> GapResult:
    return close(logs, load_robot(robot), folder / robot).measurement.gap


def _so101(gap: GapResult) -> list[Row]:
    return [
        at_most(
            f"SO-101, {run}, {split}: off the stated {stated} rad by",
            _percent(gap.runs[run][split]["position"]["rmse"].total.value, stated),
            _SO101_PERCENT,
            "%",
        )
        for (run, split), stated in SO101.items()
    ]


def _pendulum(gap: GapResult) -> list[Row]:
    """The mean over files and joints of each split, and the numbers one by one."""
    found = {name: _by_joint_deg(gap, name) for name in DOUBLE_PENDULUM}
    rows = []
    for split in ("train", "val", "test"):
        names = [name for name, own in gap.splits.items() if own == split]
        stated = float(np.mean([DOUBLE_PENDULUM[name] for name in names]))
        off = _percent(float(np.mean([found[name] for name in names])), stated)
        rows.append(
            at_most(f"double pendulum, {split}: off the stated {stated:.4g} deg by", off, _PENDULUM_PERCENT, "%")
        )
    apart = [
        _percent(own, stated)
        for name, both in DOUBLE_PENDULUM.items()
        for own, stated in zip(found[name], both, strict=True)
    ]
    near = sum(off <= _PENDULUM_PERCENT for off in apart)
    return [*rows, at_least("double pendulum: files' joints within 5 % of what is stated", near, len(apart), "of 14")]


def _by_joint_deg(gap: GapResult, name: str) -> tuple[float, ...]:
    joints = gap.episodes[STOCK][name]["position"]["rmse"]
    return tuple(float(np.degrees(joints[joint])) for joint in gap.joints)


def _percent(found: float, stated: float) -> float:
    return 100 * abs(found / stated - 1)
