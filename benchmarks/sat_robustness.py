"""How far networks for servos and bodies carry: motions beyond what servos can do, simulators that are off (SAT, VI-C).

Uses the networks of `benchmarks.sat` and `benchmarks.sat_bodies`, and writes `benchmarks/results/sat_robustness.json`,
from which a part of docs/building-blocks.md is made. The sizes of the perturbations are ours: those of the paper stand
in a figure that its text does not repeat.

    python -m benchmarks sat_robustness
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks import sat_bodies, sat_models
from benchmarks.table import Row, at_least, rounded, shown
from trueup.core.atomic import make_folder, write_json
from trueup.core.provenance import provenance
from trueup.core.robustness_result import RobustnessResult, RobustnessRow
from trueup.dataset import Dataset, is_dataset
from trueup.lab import load_lab
from trueup.record import load_plans
from trueup.robots import RobotSpec, load_robot
from trueup.sim import Perturbation
from trueup.stages import LabRig, record, robustness

RESULT = Path(__file__).parent / "results" / "sat_robustness.json"
FOLDER = Path("runs") / "sat_robustness"
SPEEDS = (1, 2, 5, 10, 20)
ROBOT = "kickbot_b"
MOTIONS = 8
DRAWS = 3
SHARES = (0.5, 1.0)
# Least improvement over the simulator at each share of the largest perturbation.
BARS = {0.5: 0.50, 1.0: 0.25}
UNITS = {"rad": math.degrees(1.0), "m": 1e3}


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


def run() -> list[Row]:
    """Record, perturb, correct, write the result file."""
    sat, lstm = sat_models.train("sat"), sat_bodies.train(sat_bodies.data(), "lstm-bodies")
    plain = load_robot(ROBOT)
    speeds = robustness(
        [_sped_up(speed) for speed in SPEEDS], plain, sat, FOLDER / "judged-speeds", split="all", jobs=1, resume=True
    )
    servos = _perturbed(sat_models.data_of(ROBOT), plain, sat, SERVOS, "servos")
    bodies = _perturbed(sat_bodies.data(), sat_bodies.robot(), lstm, BODIES, "bodies")
    result = {
        "schema": "trueup.sat_robustness/1",
        "draws": DRAWS,
        "motions": MOTIONS,
        "speeds": {str(speed): _cuts(row) for speed, row in zip(SPEEDS, speeds.datasets, strict=True)},
        "servos": _shares(servos),
        "bodies": _shares(bodies),
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
    return rows(result)


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
    return Dataset(folder)


def _perturbed(
    data: Dataset, robot: RobotSpec, network: Path, perturbations: Mapping[str, Perturbation], name: str
) -> RobustnessResult:
    return robustness(
        [data],
        robot,
        network,
        FOLDER / f"judged-{name}",
        perturbations=perturbations,
        shares=SHARES,
        draws=DRAWS,
        motions=MOTIONS,
        jobs=1,
        resume=True,
    )


def _shares(result: RobustnessResult) -> dict[str, Any]:
    """Perturbation -> share of its largest size -> what the network takes away, over draws and motions."""
    return {name: {str(row.share): _cuts(row) for row in rows} for name, rows in result.perturbed.items()}


def _cuts(row: RobustnessRow) -> dict[str, Any]:
    """Errors in degrees or millimeters."""
    return {
        metric: {
            "simulator": UNITS[item.simulated.unit] * item.simulated.value,
            "corrected": UNITS[item.corrected.unit] * item.corrected.value,
            "value": item.gone.value,
            "low": item.gone.low,
            "high": item.gone.high,
        }
        for metric, item in row.errors.items()
    }


def rows(result: Mapping[str, Any]) -> list[Row]:
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
