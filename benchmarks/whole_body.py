"""Arms that hang and lag under what they hold, on a base that has to balance: with compensation and without.

Two references, since what a compensation should bring about depends on what the balance was designed for. `follows`:
the simulated arms are where they are told to be; a compensation carries their weight. `empty`: they hang under the same
PD as with empty hands, whatever they hold; so moves a robot with a network of `compensation_robot`.

Trajectories are kept under runs/whole_body, and an interrupted run goes on from there; what came of them is
`benchmarks/results/whole_body.json`.

    python -m benchmarks whole_body    # half an hour on two cores, after `compensation_robot`
"""

from __future__ import annotations

import json
import math
import multiprocessing
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from benchmarks.compensation_robot import SEEDS, network_folder
from benchmarks.table import Row, at_most, rounded, shown
from benchmarks.whole_body_motions import MOTIONS, SECONDS, targets_of
from trueup import deploy
from trueup.core.atomic import make_folder, replacing, without_nan, write_text
from trueup.core.provenance import provenance
from trueup.deploy import Limits
from trueup.lab import draw_truth, load_lab
from trueup.measure import bootstrap_interval, paired_difference
from trueup.robots import load_robot
from trueup.whole_body import (
    UNITS,
    BalanceSettings,
    BaseSpec,
    Compensator,
    DrivingSettings,
    GravityFeedForward,
    Trajectory,
    Trial,
    VirtualBody,
    body_gap,
    draw_base,
)
from trueup.whole_body.bodies import Arms
from trueup.whole_body.model import ROBOT

RESULT = Path(__file__).parent / "results" / "whole_body.json"
FOLDER = Path("runs") / "whole_body"
PAYLOADS_KG = (0.0, 1.0, 2.0, 3.0)
# Individuals that nothing was trained or designed on.
BODIES = (4, 5)
SEED = 1


@dataclass(frozen=True)
class Way:
    """One way to command the arms of the real body.

    Attributes:
        reference: what the simulated arms do, `follows` or `empty`.
        make: a compensator for one motion; None for plain PD.
    """

    reference: str
    make: Callable[[], Compensator] | None = None


NETWORK = "network"
WAYS: Mapping[str, Way] = {
    "plain PD, follows": Way("follows"),
    "weight fed forward": Way("follows", GravityFeedForward),
    "plain PD, empty": Way("empty"),
    "payload fed forward": Way("empty", partial(GravityFeedForward, arms=False)),
    NETWORK: Way("empty", lambda: Trained(network_folder(SEEDS[0]))),
}
# Reference -> what commands the simulated arms.
REFERENCES: Mapping[str, Compensator] = {
    "follows": GravityFeedForward(),
    "empty": GravityFeedForward(arms=False),
}
PLAIN = {reference: f"plain PD, {reference}" for reference in REFERENCES}
# Way -> metric -> (bodies, motions), NaN where a body fell.
Figures = Mapping[str, Mapping[str, Float64[np.ndarray, "U M"]]]


class Trained:
    """A network for the robot beside the arms; it begins when the first target is given."""

    def __init__(self, folder: Path) -> None:
        robot = load_robot(ROBOT)
        low, high = zip(*(joint.position_limits or (-math.inf, math.inf) for joint in robot.joints), strict=True)
        limits = Limits(low=low, high=high)
        self._made = deploy.Compensator.load(folder, joints=robot.joint_names, limits=limits, payload_kg=0.0)
        self._carries = 0.0

    def __call__(self, position: Arms, velocity: Arms, target: Arms, payload_kg: float) -> Arms:
        """The target to send instead [rad]."""
        if payload_kg != self._carries:
            self._made.carry(payload_kg)
            self._carries = payload_kg
        return np.array(self._made.step(position, velocity, target).target)


def run() -> list[Row]:
    """Drive every body along every motion, and write the result file."""
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        figures = dict(zip(PAYLOADS_KG, pool.map(figures_of, PAYLOADS_KG), strict=True))
    result = {
        "schema": "trueup.whole_body/1",
        "motions": list(MOTIONS),
        "bodies": list(BODIES),
        "seconds": SECONDS,
        "units": dict(UNITS),
        "references": {name: way.reference for name, way in WAYS.items()},
        "payloads": {f"{payload_kg:g}": _stored(own) for payload_kg, own in figures.items()},
        "provenance": provenance(
            config={
                "driving": asdict(DrivingSettings()),
                "balance": asdict(BalanceSettings()),
                "base": asdict(BaseSpec()),
                "lab": asdict(load_lab("upper_body")),
            },
            seed=SEED,
        ),
    }
    make_folder(RESULT.parent)
    write_text(RESULT, json.dumps(without_nan(rounded(result)), allow_nan=False, separators=(",", ":")) + "\n")
    return rows(result)


def figures_of(payload_kg: float) -> Figures:
    """Every figure of one payload; motions whose trajectories are there are not driven again."""
    drive_all(payload_kg)
    gaps = {
        (name, unit, motion): body_gap(
            _load(_path(payload_kg, name, unit, motion)), _load(_path(payload_kg, way.reference, 0, motion))
        )
        for name, way in WAYS.items()
        for unit in BODIES
        for motion in MOTIONS
    }
    return {
        name: {
            metric: np.array([[gaps[name, unit, motion][metric] for motion in MOTIONS] for unit in BODIES])
            for metric in UNITS
        }
        for name in WAYS
    }


def drive_all(payload_kg: float) -> None:
    """Drive whatever is not there yet with one payload."""
    trial, lab = Trial(payload_kg), load_lab("upper_body")
    bodies = {
        unit: VirtualBody(draw_truth(lab, unit=unit), draw_base(unit=unit), payload_kg=payload_kg) for unit in BODIES
    }
    for motion in MOTIONS:
        targets, simulated = targets_of(motion), {}
        for reference, own in REFERENCES.items():
            path = _path(payload_kg, reference, 0, motion)
            if not path.is_file():
                _save(path, trial.simulated(targets, compensator=own))
            simulated[reference] = _load(path)
        for name, way in WAYS.items():
            for unit, body in bodies.items():
                path = _path(payload_kg, name, unit, motion)
                if not path.is_file():
                    helper = way.make() if way.make else None
                    _save(path, trial.real(body, targets, simulated[way.reference], compensator=helper, seed=SEED))


def _path(payload_kg: float, name: str, unit: int, motion: str) -> Path:
    """Where a trajectory is kept; that of the simulated body as unit 0."""
    return FOLDER / f"{payload_kg:g}kg" / name / f"{motion}-{unit}.npz"


def _save(path: Path, trajectory: Trajectory) -> None:
    make_folder(path.parent)
    parts = {name: value for name, value in vars(trajectory).items() if name != "fallen_s"}
    fallen_s = np.nan if trajectory.fallen_s is None else trajectory.fallen_s
    with replacing(path) as there, there.open("wb") as file:
        np.savez_compressed(file, fallen_s=fallen_s, **parts)


def _load(path: Path) -> Trajectory:
    with np.load(path, allow_pickle=False) as file:
        parts = {name: file[name] for name in file.files}
    fallen_s = float(parts.pop("fallen_s"))
    return Trajectory(**parts, fallen_s=None if np.isnan(fallen_s) else fallen_s)


def _stored(figures: Figures) -> dict[str, Any]:
    """Of each way the figures, its falls, and what it is against plain PD; whole motions are drawn again."""
    found: dict[str, Any] = {}
    for name, own in figures.items():
        plain = PLAIN[WAYS[name].reference]
        found[name] = {
            "falls": int(np.isnan(own["drift_mean"]).sum()),
            "figures": {metric: _estimate(values, UNITS[metric]) for metric, values in own.items()},
            "differences": {}
            if name == plain
            else {metric: _difference(values, figures[plain][metric], name, metric) for metric, values in own.items()},
        }
    return found


def _of_motions(values: Float64[np.ndarray, "U M"]) -> Float64[np.ndarray, "M"]:
    """Means over the bodies that stood; one motion on several bodies is no independent sample."""
    stood = ~np.isnan(values)
    count = stood.sum(axis=0)
    return np.where(count > 0, np.where(stood, values, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan)


def _estimate(values: Float64[np.ndarray, "U M"], unit: str) -> dict[str, Any]:
    means = _of_motions(values)
    low, high = bootstrap_interval(means[:, None])
    mean = float(np.nanmean(means)) if np.isfinite(means).any() else np.nan
    return {"value": mean, "low": float(low[0]), "high": float(high[0]), "unit": unit}


def _difference(
    values: Float64[np.ndarray, "U M"], plain: Float64[np.ndarray, "U M"], name: str, metric: str
) -> dict[str, Any]:
    both = np.isnan(values) | np.isnan(plain)
    own, base = (_of_motions(np.where(both, np.nan, part)) for part in (values, plain))
    signal = "base" if metric.startswith(("drift", "base", "tilt")) else "arms"
    return paired_difference(
        own, base, run=name, baseline="plain PD", split="all", signal=signal, metric=metric, unit=UNITS[metric]
    ).to_json()


def rows(result: Mapping[str, Any]) -> list[Row]:
    rows = []
    for payload, ways in result["payloads"].items():
        for name, own in ways.items():
            rows.append(shown(f"{payload} kg, {name}: falls", own["falls"], "1"))
            for metric in ("drift_mean", "tilt_rms"):
                rows.append(shown(f"{payload} kg, {name}: {metric}", own["figures"][metric]["value"], UNITS[metric]))
                if own["differences"] and float(payload) > 0:
                    about = f"{payload} kg, {name} - plain PD: {metric}, upper end"
                    high = own["differences"][metric]["difference"]["high"]
                    # Fed forward stands beside it for comparison.
                    row = (about, high, 0.0, UNITS[metric])
                    rows.append(at_most(*row) if name == NETWORK else shown(about, high, UNITS[metric]))
    return rows
