"""The transfer table for policies that go on: in the simulator as it came, or as it was identified from their own runs.

Policies that are trained from nothing differ more by their seed than by their simulator (`policy_transfer`). Here each
of six robots has a seed. A policy is trained as the simulator comes (`--config laptop`), drives its robot (`trueup
deploy run`), the robot is identified from these logs, and the policy goes on from where it was: in the simulator as it
comes, or as it was identified, with draws from its posterior. What differs is what it went on in. Judged on other goals
than those that were driven, and than those of `policy_transfer`.

`python -m benchmarks policy_going_on` makes what is not there, under runs/policies (40 min of a core for each robot).
Its figures are kept in benchmarks/results/policy_going_on.json; a robot that stands there, of the same question, is not
trained for again.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.policy_data import FIT, FOLDER, STOCK
from benchmarks.policy_transfer import BAR_M, DART_GOALS, GOALS, TASK, judged_on, minus, of_training, places
from benchmarks.table import Row, at_most, rounded, shown
from trueup.core.atomic import read_json, write_json
from trueup.core.config import build
from trueup.core.provenance import provenance
from trueup.dataset import Dataset
from trueup.deploy.policy import Policy
from trueup.identify import IdentifyConfig
from trueup.measure.seeds import seeds_interval
from trueup.policy.config import LAPTOP, PolicyConfig
from trueup.policy.randomization import RandomizationConfig
from trueup.robots import RobotSpec, load_robot
from trueup.stages import fit
from trueup.stages.policy_driving import drive
from trueup.stages.policy_training import train_policy

RESULT = Path(__file__).parent / "results" / "policy_going_on.json"
# Goals that each robot is driven to, of which three in five are fitted.
DRIVEN = 50
# Half of the laptop's learning rate: what was learned is soon lost.
RATE = 1e-3
# What is held against each other.
CELLS = (("stock", "none"), ("identified", "posterior"))
# Virtual robots that have a policy of their own each, in the order in which they are trained for.
ROBOTS = (1, 2, 3, 4, 5, 6)
# And those that no policy has been on.
STRANGERS = (7, 8, 9)
ABOUT = {
    "strangers": list(STRANGERS),
    "goals": GOALS,
    "driven": DRIVEN,
    "steps": LAPTOP.steps,
    "rate": RATE,
    "delayed": True,
    "velocity limit": "the model's",
}


@dataclass(frozen=True)
class GoingOn:
    """One training that goes on from its robot's first policy.

    Attributes:
        simulator: `stock` or `identified`.
        draws: what differs from episode to episode.
        unit: the robot; it has a seed of its own.
    """

    simulator: str
    draws: str
    unit: int

    @property
    def folder(self) -> Path:
        """Of the policy."""
        return FOLDER / "going-on" / f"{self.simulator}-{self.draws}-{self.unit}"

    @property
    def robot(self) -> RobotSpec:
        """Whose simulator it is trained in."""
        return load_robot(STOCK if self.simulator == "stock" else identified(self.unit) / "robot.fitted.yaml")

    @property
    def config(self) -> PolicyConfig:
        """The laptop's, as long again, begun with the robot's first policy."""
        drawn = {"none": RandomizationConfig(), "posterior": RandomizationConfig(posterior=str(identified(self.unit)))}
        learner = replace(LAPTOP.learner, rate=RATE)
        start = str(first_of(self.unit))
        return replace(LAPTOP, learner=learner, randomization=drawn[self.draws], start=start)


def first_of(unit: int) -> Path:
    """Folder of a robot's first policy, trained as the simulator comes."""
    return FOLDER / "policies" / f"stock-none-{unit - 1}-times-2"


def identified(unit: int) -> Path:
    """Folder of the identification of a robot from what its first policy did."""
    return FOLDER / f"fit-driven-{unit}"


def began(unit: int) -> dict[str, Any]:
    """Train a robot's first policy, drive the robot by it, identify the robot; where it is done, only its curve."""
    torch.set_num_threads(1)
    made = train_policy(load_robot(STOCK), first_of(unit), config=LAPTOP, seed=unit - 1, jobs=1, resume=True)
    if not (identified(unit) / "fit.json").is_file():
        logs = FOLDER / f"driven-{unit}"
        if not logs.exists() or len(Dataset(logs)) < DRIVEN:
            drive(made.folder, load_robot(STOCK), DRIVEN, unit=unit, seed=300 + unit, out=logs, overwrite=True)
        fit(
            Dataset(logs),
            load_robot(STOCK),
            identified(unit),
            config=build(IdentifyConfig, FIT, "the fit"),
            jobs=1,
            resume=True,
        )
    return of_training(made)


def trained(cell: GoingOn) -> dict[str, Any]:
    """Train the policy of a cell, if it is not there: its curve."""
    torch.set_num_threads(1)
    return of_training(
        train_policy(cell.robot, cell.folder, config=cell.config, seed=cell.unit - 1, jobs=1, resume=True)
    )


def judged(cell: GoingOn) -> dict[str, Any]:
    """Place -> metric -> mean over goals; and the distances, goal by goal."""
    torch.set_num_threads(1)
    policy = Policy.load(cell.folder, joints=load_robot(STOCK).joint_names, rate_hz=TASK.control_hz)
    own = load_robot(identified(cell.unit) / "robot.fitted.yaml")
    found = {}
    for place, reaching in places({"stock": load_robot(STOCK), "identified": own}, (cell.unit, *STRANGERS)).items():
        goals = reaching.workspace.draw(np.random.default_rng(22), GOALS)
        found[place] = judged_on(policy, reaching, goals[:DART_GOALS] if place == "dart" else goals)
    return found


def of_robot(unit: int) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The curve of a robot's first policy, and what became of it in each of `CELLS`."""
    before = began(unit)
    cells = [GoingOn(simulator, draws, unit) for simulator, draws in CELLS]
    return before, [{"training": trained(cell), "places": judged(cell)} for cell in cells]


def run() -> list[Row]:
    """Make what is not there, judge all, and hold the cells against going on in the simulator as it comes."""
    result = kept()
    missing = [unit for unit in ROBOTS if str(unit) not in result["before"]]
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        for unit, (before, found) in zip(missing, pool.map(of_robot, missing), strict=True):
            result["before"][str(unit)] = before
            for (simulator, draws), own in zip(CELLS, found, strict=True):
                result["policies"].setdefault(simulator, {}).setdefault(draws, {})[str(unit)] = own
            result["table"] = table(result["policies"])
            result["provenance"] = provenance(config=ABOUT, seed=0)
            result["commits"][str(unit)] = result["provenance"]["git"]
            write_json(RESULT, rounded(result))
    return rows(read_json(RESULT))


def kept() -> dict[str, Any]:
    """The result, with the robots of earlier calls; without any where it was made of another question."""
    found = read_json(RESULT) if RESULT.is_file() else {}
    if found and found["provenance"]["config"] == ABOUT:
        return found
    return {"before": {}, "policies": {}, "commits": {}}


def table(policies: Mapping[str, Any]) -> dict[str, Any]:
    """Simulator -> draws -> place -> median distance over goals and robots, and the difference to the stock simulator.

    A goal counts once: with the mean over robots, each with its own policy.
    """
    found: dict[str, Any] = {}
    for simulator, by_draws in policies.items():
        for draws, by_unit in by_draws.items():
            own = {}
            for spot, names in _spots(by_unit).items():
                distances, rewards = (_values(by_unit, names, key) for key in ("distances", "rewards"))
                base = {key: _values(policies["stock"]["none"], names, key) for key in ("distances", "rewards")}
                own[spot] = {
                    "median": float(np.median(distances)),
                    "mean": float(distances.mean()),
                    "worst": float(distances.max()),
                    "by_robot": np.median(distances, axis=1).tolist(),
                    "success": float((distances <= BAR_M).mean()),
                    "minus_stock": minus(distances, base["distances"], "distances"),
                    "minus_stock_robots": _minus_robots(by_unit, policies["stock"]["none"], names),
                    "minus_stock_reward": minus(rewards, base["rewards"], "rewards"),
                    **{
                        name: float(
                            np.mean([by_unit[unit]["places"][n][name] for unit in by_unit for n in names[unit]])
                        )
                        for name in ("overshoot", "smoothness", "torque_at_limit", "velocity_violation", "reward")
                    },
                }
            found.setdefault(simulator, {})[draws] = own
    return found


def _spots(by_unit: Mapping[str, Any]) -> dict[str, dict[str, list[str]]]:
    """Place -> robot -> names of what its policy is judged on there."""
    return {
        **{name: {unit: [name] for unit in by_unit} for name in ("stock", "identified", "dart")},
        "own robot": {unit: [f"lab-{unit}"] for unit in by_unit},
        "other robots": {
            unit: [name for name in own["places"] if name.startswith("lab-") and name != f"lab-{unit}"]
            for unit, own in by_unit.items()
        },
    }


def _values(by_unit: Mapping[str, Any], names: Mapping[str, list[str]], key: str) -> np.ndarray:
    """(policies, goals), or a row for each robot that a policy is judged on."""
    return np.array([own["places"][name][key] for unit, own in by_unit.items() for name in names[unit]])


def _minus_robots(by_unit: Mapping[str, Any], base: Mapping[str, Any], names: Mapping[str, list[str]]) -> list[float]:
    """The difference in distance with its interval over goals and robots.

    Paired by both: a robot has one seed and one first policy, from which both cells go on.
    """

    def of(policies: Mapping[str, Any]) -> np.ndarray:
        places = ([policies[unit]["places"][name]["distances"] for name in names[unit]] for unit in by_unit)
        return np.array([np.mean(rows, axis=0) for rows in places])

    return list(seeds_interval(of(by_unit) - of(base)))


def rows(result: Mapping[str, Any]) -> list[Row]:
    """The cells, and the bars."""
    found = []
    for simulator, by_draws in result["table"].items():
        for draws, own in by_draws.items():
            for spot, item in own.items():
                found.append(shown(f"{simulator}, {draws}: on {spot}, mean", 100 * item["mean"], "cm"))
    best = result["table"]["identified"]["posterior"]["own robot"]
    found.append(at_most("identified, posterior, on the own robot: median", 100 * best["median"], 5.0, "cm"))
    found.append(at_most("its difference to stock, upper end", 100 * best["minus_stock"][2], 0.0, "cm"))
    return found
