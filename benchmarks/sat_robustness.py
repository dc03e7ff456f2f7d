"""How far networks for servos and bodies carry: motions beyond what servos can do, simulators that are off (SAT, VI-C).

Uses the networks of `benchmarks.sat` and `benchmarks.sat_bodies`, and writes `benchmarks/results/sat_robustness.json`,
from which a part of docs/building-blocks.md is made. The sizes of the perturbations are ours: those of the paper stand
in a figure that its text does not repeat.

    python -m benchmarks sat_robustness
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from benchmarks import sat_bodies, sat_models
from benchmarks.sat import apart
from benchmarks.sat_models import RUN
from benchmarks.table import Row, at_least, rounded, shown
from trueup.augment.trained import Trained
from trueup.core.atomic import make_folder, write_json
from trueup.core.provenance import provenance
from trueup.core.timeseries import TimeSeries
from trueup.dataset import Dataset, is_dataset
from trueup.lab import load_lab
from trueup.measure import position_distance, ratio_interval
from trueup.record import load_plans
from trueup.robots import RobotSpec, find_model, load_robot
from trueup.robots.model import load_spec
from trueup.stages import LabRig, record, replay

RESULT = Path(__file__).parent / "results" / "sat_robustness.json"
FOLDER = Path("runs") / "sat_robustness"
SPEEDS = (1, 2, 5, 10, 20)
ROBOT = "kickbot_b"
MOTIONS = 8
DRAWS = 3
SHARES = (0.5, 1.0)
# Least improvement over the simulator at each share of the largest perturbation.
BARS = {0.5: 0.50, 1.0: 0.25}
# A factor drawn from N(1, s) is no less than this: masses and resistances stay positive.
_LEAST = 0.05
METRICS = ("mae", "max")


@dataclass(frozen=True)
class Perturbation:
    """What is drawn of a simulator.

    Attributes:
        mass: s of the factor of each body's mass, and of its inertia.
        com_m: s of the shift of each body's center of mass, each axis [m].
        joint_m: s of the shift of each body against its parent, each axis [m].
        resistance: s of the factor of the motors' resistance.
    """

    mass: float = 0.0
    com_m: float = 0.0
    joint_m: float = 0.0
    resistance: float = 0.0

    def times(self, share: float) -> Perturbation:
        """A share of it."""
        return Perturbation(*(share * value for value in (self.mass, self.com_m, self.joint_m, self.resistance)))


# At their largest: far beyond what a scale, a caliper and an ohmmeter leave open.
BODIES = {
    "mass": Perturbation(mass=0.5),
    "center of mass": Perturbation(com_m=0.01),
    "joint positions": Perturbation(joint_m=0.002),
    "all of these": Perturbation(mass=0.5, com_m=0.01, joint_m=0.002),
}
SERVOS = {
    "resistance": Perturbation(resistance=0.3),
    "mass": Perturbation(mass=0.5),
    "center of mass": Perturbation(com_m=0.01),
}

Rows = dict[str, list[float]]


def run() -> list[Row]:
    """Record, perturb, correct, write the result file."""
    servos, bodies = (
        Trained.load(train) for train in (sat_models.train("sat"), sat_bodies.train(sat_bodies.data(), "lstm-bodies"))
    )
    speeds = {str(speed): _cuts(*_errors(_sped_up(speed), RUN, servos, _joints)) for speed in SPEEDS}
    known = Dataset(_copied(sat_models.FOLDER / ROBOT, "servos"))
    marked = Dataset(_copied(sat_bodies.FOLDER / "data", "bodies"))
    result = {
        "schema": "trueup.sat_robustness/1",
        "draws": DRAWS,
        "motions": MOTIONS,
        "speeds": speeds,
        "servos": {name: _perturbed(known, load_robot(ROBOT), item, servos, _joints) for name, item in SERVOS.items()},
        "bodies": {
            name: _perturbed(marked, sat_bodies.robot(), item, bodies, _bodies) for name, item in BODIES.items()
        },
        "provenance": provenance(
            config={
                "servos": {name: vars(item) for name, item in SERVOS.items()},
                "bodies": {name: vars(item) for name, item in BODIES.items()},
            },
            seed=0,
            data_hash=sat_models.data_of(ROBOT).hash,
        ),
    }
    make_folder(RESULT.parent)
    write_json(RESULT, rounded(result))
    return _rows(result)


def _sped_up(speed: int) -> Dataset:
    """Animations at several times their speed, whatever the servos can do."""
    robot, folder = load_robot(ROBOT), FOLDER / f"speed-{speed}"
    spec = load_plans(f"{ROBOT}-animations")
    free = dict.fromkeys(robot.joint_names, 1e6)
    groups = tuple(replace(group, count=MOTIONS, speed=(speed, speed), amplitude=(0.8, 0.8)) for group in spec.groups)
    plans = replace(spec, groups=groups, velocity_limits=free, acceleration_limits=free)
    settings = replace(sat_models.SETTINGS, path_tolerance_rad=10.0, tolerance_rad=0.3)
    if not is_dataset(folder) or not Dataset(folder).info.provenance.get("complete"):
        record(folder, robot, LabRig(load_lab(sat_models.LAB, robot=ROBOT), 1), plans, settings=settings)
    data = Dataset(folder)
    replay(data, robot, jobs=1, resume=True)
    return Dataset(folder)


def _copied(source: Path, name: str) -> Path:
    """A dataset of its own: perturbed runs do not belong to the other one."""
    target = FOLDER / name
    if not is_dataset(target):
        make_folder(FOLDER)
        shutil.copytree(source, target)
    return target


def _perturbed(
    data: Dataset,
    robot: RobotSpec,
    largest: Perturbation,
    model: Trained,
    errors: Callable[[TimeSeries, TimeSeries], np.ndarray],
) -> dict[str, Any]:
    """Share of the largest perturbation -> what the network takes away, over draws and motions."""
    ids = data.select(split="test")[:MOTIONS]
    found = {}
    for share in SHARES:
        before: list[np.ndarray] = []
        after: list[np.ndarray] = []
        for draw in range(DRAWS):
            size = largest.times(share)
            label = "mujoco/" + "-".join(f"{value:g}" for value in vars(size).values()) + f"-{draw}"
            own, path = _drawn(robot, size, FOLDER / "models", draw)
            replay(data, own, model=path, label=label, ids=ids, jobs=1, resume=True)
            one, other = _errors(data, label, model, errors, ids)
            before.append(one)
            after.append(other)
        found[str(share)] = _cuts(np.mean(before, axis=0), np.mean(after, axis=0))
    return found


def _drawn(robot: RobotSpec, size: Perturbation, folder: Path, draw: int) -> tuple[RobotSpec, Path]:
    """A robot whose model is off, and the model."""
    rng = np.random.default_rng(draw)
    source = find_model(robot)
    # As compiled: there, every geom has a position and a mass of its own.
    plain = load_spec(source)
    plain.compile()
    spec = mujoco.MjSpec.from_string(plain.to_xml())
    for body in spec.bodies[1:]:
        factor, shift = max(_LEAST, 1 + size.mass * rng.standard_normal()), size.com_m * rng.standard_normal(3)
        for geom in body.geoms:
            geom.mass *= factor
            geom.pos = np.array(geom.pos) + shift
        moved = size.joint_m * rng.standard_normal(3)
        if body.joints:
            body.pos = np.array(body.pos) + moved
    ohm = max(_LEAST, 1 + size.resistance * rng.standard_normal())
    spec.compile()
    make_folder(folder)
    path = folder / ("-".join(f"{value:g}" for value in vars(size).values()) + f"-{draw}-{robot.name}.xml")
    path.write_text(spec.to_xml())
    assert robot.motor is not None
    return replace(robot, motor=replace(robot.motor, resistance_ohm=ohm * robot.motor.resistance_ohm)), path


def _errors(
    data: Dataset,
    label: str,
    model: Trained,
    errors: Callable[[TimeSeries, TimeSeries], np.ndarray],
    ids: Sequence[str] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and largest error of each motion, (E, 2), simulated and corrected."""
    before, after = [], []
    for episode in data.episodes(ids, runs=[label]):
        simulated = episode.run(label)
        for run, into in ((simulated, before), (model.predict(episode, label), after)):
            apart = errors(episode.measured, run)
            into.append((apart.mean(), apart.max(axis=0).mean()))
    return np.array(before), np.array(after)


def _joints(measured: TimeSeries, said: TimeSeries) -> np.ndarray:
    """Errors of the position, (T, J) [deg]."""
    return np.degrees(np.abs(apart(measured, said, "position")[0]))


def _bodies(measured: TimeSeries, said: TimeSeries) -> np.ndarray:
    """Distances of the bodies, (T, B) [mm]."""
    rows = (said.time_s >= measured.time_s[0]) & (said.time_s <= measured.time_s[-1])
    order = [said.bodies.index(name) for name in measured.bodies]
    truth = measured["body.position"]
    flat = truth.reshape(len(truth), -1).T
    there = np.stack([np.interp(said.time_s[rows], measured.time_s, own) for own in flat], axis=1)
    return 1e3 * position_distance(there.reshape(-1, *truth.shape[1:]), said["body.position"][rows][:, order])


def _cuts(before: np.ndarray, after: np.ndarray) -> dict[str, Any]:
    value, low, high = ratio_interval(after, before)
    return {
        metric: {
            "simulator": float(before[:, at].mean()),
            "corrected": float(after[:, at].mean()),
            "value": float(1 - value[at]),
            "low": float(1 - high[at]),
            "high": float(1 - low[at]),
        }
        for at, metric in enumerate(METRICS)
    }


def _rows(result: Mapping[str, Any]) -> list[Row]:
    rows = [
        shown(f"{ROBOT} at {speed} times the speed: position MAE cut", item["mae"]["value"], "")
        for speed, item in result["speeds"].items()
    ]
    for kind, name, share, item in _each(result):
        rows.append(at_least(f"{kind}, {name}, {share:g} of the largest: MAE cut", item["value"], BARS[share], ""))
    return rows


def _each(result: Mapping[str, Any]) -> Iterator[tuple[str, str, float, Mapping[str, float]]]:
    for kind in ("servos", "bodies"):
        for name, shares in result[kind].items():
            for share, item in shares.items():
                yield kind, name, float(share), item["mae"]
