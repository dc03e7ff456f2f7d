"""Delta actions on a robot that no training has seen, carrying what none has carried (GapONet, Table 1).

`python -m benchmarks compensation` trains what is not there, under runs/gapo, a process for each simulator; it goes on
where it was interrupted. Its figures are kept in benchmarks/results/compensation.json.
"""

from __future__ import annotations

import itertools
import math
import multiprocessing
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float64

from benchmarks.gapo_data import FOLDER, SEEN_KG, UNSEEN_KG, data_of, robot_of
from benchmarks.table import Row, at_most, rounded, shown
from trueup.augment.corrector import Corrector
from trueup.compensate.closed_loop import Run, closed_loop
from trueup.compensate.compensation import Compensation
from trueup.compensate.config import METHODS, CompensateConfig, TrainConfig
from trueup.compensate.plants import Plants
from trueup.compensate.sensors import Sensors
from trueup.compensate.tracks import Track, track_of
from trueup.core.atomic import read_json, write_json
from trueup.core.config import build
from trueup.core.provenance import provenance
from trueup.identify import IdentifyConfig
from trueup.measure import paired_difference
from trueup.measure.metrics.distribution import gap_iqr, gap_range, large_gap_ratio
from trueup.robots import RobotSpec, find_model, load_robot
from trueup.stages import Prepared, compensate, fit, prepare

RESULT = Path(__file__).parent / "results" / "compensation.json"
CONTROL_S = 0.02
SEEDS = range(6)
# At this error, about 12 % of what plain PD does without a payload is a large gap; and the paper's own.
TAU_RAD, PAPER_TAU_RAD = 0.05, 0.5
# Simulators; the last one hears what an accelerometer on the base says (`simulation: {base_sensor: torso}`).
STOCK, FITTED, SENSED = "stock", "identified", "identified, base sensed"
PD, OPERATOR = "pd", "operator"
TESTS = ("test", "test-unseen-payload")
# A quarter of the default's updates and windows two thirds as long: 54 trainings in half an hour of two cores.
SHORT = TrainConfig(updates=150, rounds=6, horizon=20)
# The same updates, batches and windows for all of them.
METHOD_NAMES = (OPERATOR, "mlp", "transformer")
NETWORKS: Mapping[str, tuple[str, CompensateConfig]] = {
    f"{name}{suffix}": (base, replace(METHODS[name], training=SHORT))
    for base, suffix in ((FITTED, ""), (STOCK, "-on-stock"), (SENSED, "-sensed"))
    for name in METHOD_NAMES
}
# Operator -> simulator, and what it is held against.
BASELINES: Mapping[str, tuple[str, tuple[str, ...]]] = {
    OPERATOR: (FITTED, (FITTED, "mlp", "transformer", "mlp-on-stock", "transformer-on-stock")),
    "operator-sensed": (SENSED, (SENSED, "mlp-sensed", "transformer-sensed")),
}
METRICS = ("large_gap_ratio", "large_gap_ratio_paper", "iqr", "range", "mae")
# GapONet, Table 1: share of large gaps.
BARS = {0.0: 0.001, 3.0: 0.009}


def run() -> list[Row]:
    """Train what is not there, simulate the test motions with each network, and hold the figures against the bars."""
    # Before there are two processes that could make the same.
    for base, test in itertools.product((FITTED, SENSED), TESTS):
        fitted(base)
        data_of(_named(test, base))
    spawned = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(2, mp_context=spawned) as pool:
        parts = list(pool.map(tables_on, (STOCK, FITTED, SENSED)))
    result = {
        "tau_rad": TAU_RAD,
        "paper_tau_rad": PAPER_TAU_RAD,
        "tables": {name: own for tables, _ in parts for name, own in tables.items()},
        "training": {name: own for _, training in parts for name, own in training.items()},
        "provenance": provenance(seed=0, data_hash=data_of("train").hash, config=asdict(SHORT)),
    }
    write_json(RESULT, rounded(result))
    return rows(read_json(RESULT))


def tables_on(base: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Figures and trainings of all networks for one simulator, and of that simulator alone."""
    torch.set_num_threads(1)
    names = [name for name, (own, _) in NETWORKS.items() if own == base]
    alone = PD if base == STOCK else base
    tables: dict[str, Any] = {alone: table(base, [None])}
    training: dict[str, Any] = {}
    for name in names:
        made = [network(name, seed) for seed in SEEDS]
        training[name] = [_training(item) for item in made]
        tables[name] = table(base, [item.corrector for item in made])
    return tables, training


def fitted(base: str = FITTED) -> RobotSpec:
    """The robot whose numbers were identified on the train motions, those with payloads too."""
    folder = FOLDER / _named("fit", base)
    config = build(
        IdentifyConfig,
        {
            "fit": {
                "delay_s": {"shared": True},
                **dict.fromkeys(("kp", "kv", "damping", "frictionloss", "armature"), "all"),
            },
            "models": {"load": ["load"]},
            "data": {"budget_s": 80.0},
            "solver": {"max_iterations": 4, "tolerance": 0.02},
        },
        "the fit of this benchmark",
    )
    if not (folder / "robot.fitted.yaml").is_file():
        train = _named("train", base)
        fit(data_of(train), robot_of(train), folder, config=config, resume=True)
    return load_robot(folder / "robot.fitted.yaml")


@cache
def prepared(base: str) -> Prepared:
    """The train motions along one simulator."""
    return prepare(data_of(_named("train", base)), _robot(base), jobs=1)


def network(name: str, seed: int) -> Compensation:
    """A network of this benchmark, found or trained."""
    base, config = NETWORKS[name]
    return trained(name, base, config, seed)


def trained(name: str, base: str, config: CompensateConfig, seed: int) -> Compensation:
    """A network for a simulator under a name of its own, found or trained."""
    made = compensate(
        data_of(_named("train", base)),
        _robot(base),
        FOLDER / "networks" / f"{name}-{seed}",
        config=config,
        prepared=prepared(base),
        name=name,
        seed=seed,
        jobs=1,
        resume=True,
    )
    print(f"{name}, seed {seed}: {made.seconds:.0f} s", flush=True)
    return made.compensation


def table(
    base: str, networks: Sequence[Corrector | None], *, sensors: Sensors | None = None
) -> dict[str, dict[str, dict[str, list[list[float]]]]]:
    """Data set -> payload -> metric -> seed -> motion."""
    found: dict[str, dict[str, dict[str, list[list[float]]]]] = {}
    for test, net in itertools.product(TESTS, networks):
        motions = _motions(_named(test, base))
        runs = closed_loop(motions, plants(base), net, sensors=sensors)
        for payload_kg in sorted({motion.payload_kg for motion in motions}):
            pairs = [(m, r) for m, r in zip(motions, runs, strict=True) if m.payload_kg == payload_kg]
            own = found.setdefault(test, {}).setdefault(f"{payload_kg:g}", {metric: [] for metric in METRICS})
            for metric, values in _metrics(pairs).items():
                own[metric].append(values)
    return found


def figures(measured: Float64[np.ndarray, "T J"], wanted: Float64[np.ndarray, "T J"]) -> dict[str, float]:
    """How far positions of one motion are from where they should be, mean over joints."""
    values = {
        "large_gap_ratio": large_gap_ratio(measured, wanted, tau=TAU_RAD),
        "large_gap_ratio_paper": large_gap_ratio(measured, wanted, tau=PAPER_TAU_RAD),
        "iqr": gap_iqr(measured, wanted),
        "range": gap_range(measured, wanted),
        "mae": np.abs(measured - wanted),
    }
    return {metric: float(own.mean()) for metric, own in values.items()}


def _metrics(pairs: Sequence[tuple[Track, Run]]) -> dict[str, list[float]]:
    """Of each motion, the mean over its joints."""
    found: dict[str, list[float]] = {metric: [] for metric in METRICS}
    for motion, run in pairs:
        joints = motion.command.shape[1]
        measured, simulated = (np.asarray(state[:, :joints], np.float64) for state in (motion.state, run.state))
        for metric, value in figures(measured, simulated).items():
            found[metric].append(value)
    return found


def _robot(base: str) -> RobotSpec:
    return robot_of("train") if base == STOCK else fitted(base)


def _named(name: str, base: str) -> str:
    """A data set or fit as a simulator needs it."""
    return f"{name}-sensed" if base == SENSED else name


@cache
def plants(base: str) -> Plants:
    """A simulator with any payload."""
    robot = _robot(base)
    return Plants(robot, find_model(robot), CONTROL_S)


@cache
def _motions(test: str) -> list[Track]:
    data, robot = data_of(test), robot_of(test)
    base = robot.simulation.base_sensor
    return [track_of(data.episode(name), robot.joint_names, CONTROL_S, base_sensor=base) for name in data.ids]


def _training(made: Compensation) -> dict[str, Any]:
    said = made.card.provenance["training"]
    return {key: said[key] for key in ("cpu_seconds", "best_round", "motions", "val")}


def rows(result: Mapping[str, Any]) -> list[Row]:
    tables = result["tables"]
    rows = [shown("0 kg: large gaps, plain PD", _mean(tables, PD, "test", 0.0, "large_gap_ratio"), "")]
    for operator, (alone, baselines) in BASELINES.items():
        rows += _held(tables, operator, alone, baselines)
    return rows


def _held(tables: Mapping[str, Any], operator: str, alone: str, baselines: Sequence[str]) -> list[Row]:
    """An operator against its bars, its baselines and the simulator without it."""
    rows = []
    for payload_kg, bar in BARS.items():
        value = _mean(tables, operator, "test", payload_kg, "large_gap_ratio")
        rows.append(at_most(f"{payload_kg:g} kg: large gaps, {operator}", value, bar, ""))
    best = min(_mean(tables, name, "test", 0.0, "large_gap_ratio") for name in baselines)
    rows.append(
        at_most(
            f"0 kg: large gaps, {operator} against a tenth of the best baseline's",
            _mean(tables, operator, "test", 0.0, "large_gap_ratio"),
            0.1 * best,
            "",
        )
    )
    for metric, payload_kg in itertools.product(("iqr", "range"), SEEN_KG):
        own = _mean(tables, operator, "test", payload_kg, metric)
        least = min(_mean(tables, name, "test", payload_kg, metric) for name in baselines)
        rows.append(at_most(f"{payload_kg:g} kg: {metric}, {operator} against the best baseline", own, least, "rad"))
    for unseen_kg in UNSEEN_KG:
        seen = [own for own in SEEN_KG if abs(own - unseen_kg) < 1.0]
        nearest = max(_mean(tables, operator, "test", own, "mae") for own in seen)
        ratio = _mean(tables, operator, "test-unseen-payload", unseen_kg, "mae") / nearest
        rows.append(at_most(f"{unseen_kg:g} kg, unseen: mean error, {operator} against seen payloads", ratio, 1.5, ""))
    for payload_kg in SEEN_KG:
        high = _difference(tables, operator, alone, payload_kg)["high"]
        rows.append(at_most(f"{payload_kg:g} kg: mean error, {operator} - {alone}, upper end", high, 0.0, "rad"))
    return rows


def _of(tables: Mapping[str, Any], name: str, test: str, payload_kg: float, metric: str) -> Float64[np.ndarray, "S M"]:
    return np.array(tables[name][test][f"{payload_kg:g}"][metric], np.float64)


def _mean(tables: Mapping[str, Any], name: str, test: str, payload_kg: float, metric: str) -> float:
    """Mean over seeds and motions."""
    return float(_of(tables, name, test, payload_kg, metric).mean())


def _difference(tables: Mapping[str, Any], operator: str, alone: str, payload_kg: float) -> dict[str, float]:
    """Operator minus the simulator without it, by motion."""
    ours, theirs = (_of(tables, name, "test", payload_kg, "mae").mean(axis=0) for name in (operator, alone))
    found = paired_difference(
        ours, theirs, run=operator, baseline=alone, split="test", signal="position", metric="mae", unit="rad"
    ).difference
    low, high = (math.nan if end is None else end for end in (found.low, found.high))
    return {"value": found.value, "low": low, "high": high}
