"""A robot whose commands are compensated, against the same robot without, on unseen motions (GapONet, 4 and 5.2).

The network is trained on the identified simulator of three individuals, so that they move like the stock simulator with
empty hands, whatever they carry. It runs beside a fourth individual of the virtual hardware, payloads among them that
no training has seen. The recordings without compensation are those of `compensation`.

`python -m benchmarks compensation_robot` trains and records what is not there, under runs/gapo. Its figures are kept in
benchmarks/results/compensation_robot.json.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from benchmarks.compensation import FITTED, TAU_RAD, figures, fitted, prepared
from benchmarks.gapo_data import DATA, FOLDER, data_of, plans_of, rigs_of, robot_of
from benchmarks.table import Row, at_most, rounded, shown
from trueup.compensate.closed_loop import closed_loop
from trueup.compensate.config import METHODS
from trueup.compensate.plants import Plants
from trueup.compensate.tracks import Track, track_of
from trueup.core.atomic import read_json, write_json
from trueup.core.provenance import provenance
from trueup.dataset import Dataset
from trueup.measure import paired_difference, robustness, smoothness, trajectory_consistency
from trueup.robots import find_model
from trueup.stages import compensate, record
from trueup.stages.rigs import CompensatedRig

RESULT = Path(__file__).parent / "results" / "compensation_robot.json"
SEEDS = (0, 1, 2)
# Between the targets of a loop at 200 Hz, the network at 50 Hz has its corrections approached along straight lines.
TESTS = ("test", "test-unseen-payload", "test-200hz")
CONFIG = METHODS["operator-robot"]
_FINE_S = 0.001
PLAIN, COMPENSATED = "plain", "compensated"
# What motions are compared with: the stock simulator with empty hands, and where the joints were told to be.
SIMULATOR, TARGET = "simulator", "target"
UNITS = {
    "mae": "rad",
    "large_gap_ratio": "1",
    "large_gap_ratio_paper": "1",
    "iqr": "rad",
    "range": "rad",
    "trajectory_consistency": "rad/s^2",
    "smoothness": "rad/s^2",
    "robustness": "rad",
}
# Metric -> motions, one value each.
Figures = Mapping[str, Float64[np.ndarray, "M"]]


def run() -> list[Row]:
    """Train and record what is not there; hold the robot with compensation against the robot without."""
    result: dict[str, Any] = {"tau_rad": TAU_RAD, "units": UNITS, "seeds": {}}
    for seed in SEEDS:
        made = compensate(
            data_of("train"),
            robot_of("train"),
            network_folder(seed),
            config=CONFIG,
            prepared=prepared(FITTED),
            twin=(None, fitted()),
            empty_handed=True,
            seed=seed,
            jobs=1,
            resume=True,
        )
        said = made.compensation.card.provenance["training"]
        result["seeds"][str(seed)] = {
            "minutes": said["seconds"] / 60,
            "cpu_minutes": said["cpu_seconds"] / 60,
            "best_round": said["best_round"],
            "tests": {name: _test(name, seed) for name in TESTS},
        }
    result["provenance"] = provenance(config=asdict(CONFIG), seed=0, data_hash=data_of("train").hash)
    write_json(RESULT, rounded(result))
    return rows(read_json(RESULT))


def network_folder(seed: int) -> Path:
    """Where the network is kept."""
    return FOLDER / "networks" / f"operator-robot-{seed}"


def recorded(name: str, seed: int) -> Dataset:
    """The motions of a test set on the robot with compensation, which knows what it carries."""
    made, robot, folder = DATA[name], robot_of(name), FOLDER / f"{name}-compensated-{seed}"
    rigs = [
        CompensatedRig.of(rig, robot, network_folder(seed), control_hz=made.settings.control_hz)
        for rig in rigs_of(name)
    ]
    record(folder, robot, rigs, plans_of(name), payloads_kg=made.payloads_kg, settings=made.settings, resume=True)
    return Dataset(folder)


def _test(name: str, seed: int) -> dict[str, Any]:
    """Payload -> reference -> metric -> without, with, and the difference, by whole motion."""
    robot = robot_of(name)
    step_s = 1.0 / DATA[name].settings.control_hz
    if name == "test-200hz":  # of which the robot's own physics step is no part
        robot = replace(robot, simulation=replace(robot.simulation, timestep_s=_FINE_S))
    plain, helped = (
        {episode: track_of(data.episode(episode), robot.joint_names, step_s) for episode in data.ids}
        for data in (data_of(name), recorded(name, seed))
    )
    # A motion that was stopped on one of the two robots is no pair; it is counted.
    ids = [episode for episode in plain if episode in helped]
    empty = Plants(robot, find_model(robot), step_s, empty=True)
    simulated = [np.asarray(run.state) for run in closed_loop([plain[i] for i in ids], empty, None)]
    found: dict[str, Any] = {"motions": {PLAIN: len(plain), COMPENSATED: len(helped)}, "payloads": {}}
    for payload_kg in sorted({track.payload_kg for track in plain.values()}):
        own = [k for k, i in enumerate(ids) if plain[i].payload_kg == payload_kg]
        aims = {SIMULATOR: [simulated[k] for k in own], TARGET: [plain[ids[k]].command for k in own]}
        found["payloads"][f"{payload_kg:g}"] = {
            reference: _compared(
                *(
                    [_figures(tracks[ids[k]], aim, step_s) for k, aim in zip(own, wanted, strict=True)]
                    for tracks in (plain, helped)
                )
            )
            for reference, wanted in aims.items()
        }
    return found


def _figures(track: Track, aim: Float64[np.ndarray, "T C"], step_s: float) -> dict[str, float]:
    """Mean over joints."""
    joints, count = track.command.shape[1], min(len(track), len(aim))
    measured, wanted = (np.asarray(values[:count, :joints], np.float64) for values in (track.state, aim))
    clock = step_s * np.arange(count)
    added = {
        "trajectory_consistency": trajectory_consistency(measured, wanted, clock),
        "smoothness": smoothness(measured, wanted, clock),
        "robustness": robustness(measured, wanted),
    }
    return figures(measured, wanted) | {name: float(own.mean()) for name, own in added.items()}


def _compared(plain: Sequence[Mapping[str, float]], helped: Sequence[Mapping[str, float]]) -> dict[str, Any]:
    found = {}
    for metric, unit in UNITS.items():
        without, given = (np.array([motion[metric] for motion in own]) for own in (plain, helped))
        paired = paired_difference(
            given, without, run=COMPENSATED, baseline=PLAIN, split="test", signal="position", metric=metric, unit=unit
        )
        difference = paired.difference
        found[metric] = {
            PLAIN: float(without.mean()),
            COMPENSATED: float(given.mean()),
            "motions": len(plain),
            "difference": [difference.value, difference.low, difference.high],
        }
    return found


def rows(result: Mapping[str, Any]) -> list[Row]:
    rows = []
    for (seed, own), name in itertools.product(result["seeds"].items(), TESTS):
        for (payload, references), reference in itertools.product(
            own["tests"][name]["payloads"].items(), (SIMULATOR, TARGET)
        ):
            errors = references[reference]["mae"]
            about = f"seed {seed}, {name}, {payload} kg, to the {reference}"
            rows.append(shown(f"{about}: mean error, plain", errors[PLAIN], "rad"))
            rows.append(shown(f"{about}: mean error, compensated", errors[COMPENSATED], "rad"))
            high = errors["difference"][2]
            rows.append(at_most(f"{about}: difference, upper end", math.nan if high is None else high, 0.0, "rad"))
    rows += [at_most(f"seed {seed}: training", own["minutes"], 20.0, "min") for seed, own in result["seeds"].items()]
    return rows
