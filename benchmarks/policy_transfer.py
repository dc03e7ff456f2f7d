"""Policies trained in three simulators with three randomizations, on robots: how near they come to goals.

Columns are what is randomized (ES thesis, 4.1.1, or the posterior of the identification); rows are the simulators: as
it comes, identified, identified and with a network that was trained on the same logs. The thesis's own way, friction in
actions, is a fourth. All are judged on the same 100 goals: in the simulators, in DART, on the three robots that were
recorded and on three that were not. The two cells that the question is about are trained twice as long besides.

`python -m benchmarks policy_transfer` records, identifies and trains what is not there, under runs/policies (two to
three hours on two cores). Its figures are kept in benchmarks/results/policy_transfer.json.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.policy_data import FOLDER, STOCK, UNITS, fitted, network
from benchmarks.table import Row, at_most, rounded, shown
from trueup.core.atomic import read_json, write_json
from trueup.core.provenance import provenance
from trueup.deploy.policy import Policy
from trueup.lab import LabSpec, VirtualRobot, draw_truth
from trueup.lab.spec import Controller
from trueup.measure import paired_difference
from trueup.measure.seeds import seeds_interval
from trueup.policy.arms import HardwareArm
from trueup.policy.config import LAPTOP, PolicyConfig
from trueup.policy.evaluation import UNITS as METRICS
from trueup.policy.evaluation import evaluate
from trueup.policy.randomization import THESIS, RandomizationConfig
from trueup.policy.reaching import Reaching
from trueup.policy.simulated import simulated
from trueup.policy.thesis_friction import OFFSET
from trueup.robots import RobotSpec, find_model, load_robot
from trueup.sim import MujocoSimulator
from trueup.stages.policy_judging import velocity_limit
from trueup.stages.policy_training import TrainedPolicy, train_policy

RESULT = Path(__file__).parent / "results" / "policy_transfer.json"
# A training takes six minutes of a core: three of each where it matters, one elsewhere.
SEEDS = {"stock": (0, 1, 2), "identified": (0, 1, 2), "augmented": (0,), "thesis": (0,)}
# Half of the laptop's, so that there is time for every cell.
STEPS = LAPTOP.steps // 2
# What the laptop's are held against each other in, at their full length.
LONG = (("stock", "none"), ("identified", "posterior"))
GOALS = 100
# DART takes its physics steps one by one: as long for these as for all on six robots.
DART_GOALS = 40
STRANGERS = (4, 5, 6)
DRAWS = ("none", "thesis", "posterior")
TASK = LAPTOP.reach
BAR_M = 0.05


@dataclass(frozen=True)
class Cell:
    """One training.

    Attributes:
        simulator: where.
        draws: what differs from episode to episode.
        seed: of everything that is drawn.
        steps: of control, in all.
    """

    simulator: str
    draws: str
    seed: int
    steps: int = STEPS

    @property
    def folder(self) -> Path:
        """Of the policy."""
        times = self.steps // STEPS
        own = f"{self.simulator}-{self.draws}-{self.seed}"
        return FOLDER / "policies" / (own if times == 1 else f"{own}-times-{times}")

    @property
    def robot(self) -> RobotSpec:
        """Whose simulator it is trained in."""
        return robot_of(self.simulator)

    @property
    def config(self) -> PolicyConfig:
        """The laptop's but for its length, in this simulator with these draws."""
        drawn = {
            "none": RandomizationConfig(),
            "thesis": THESIS,
            "posterior": RandomizationConfig(posterior=str(fitted())),
        }
        return replace(
            LAPTOP,
            steps=self.steps,
            randomization=drawn[self.draws],
            friction="thesis" if self.simulator == "thesis" else "simulator",
            network=str(network()) if self.simulator == "augmented" else "",
        )


def cells() -> Iterator[Cell]:
    """All trainings: a posterior is that of the identified simulator."""
    for simulator, seeds in SEEDS.items():
        for seed, draws in product(seeds, DRAWS):
            if draws != "posterior" or simulator in ("identified", "augmented"):
                yield Cell(simulator, draws, seed)


def long_cells() -> Iterator[Cell]:
    """The trainings at the laptop's full length."""
    for (simulator, draws), seed in product(LONG, SEEDS["identified"]):
        yield Cell(simulator, draws, seed, steps=LAPTOP.steps)


def robot_of(simulator: str) -> RobotSpec:
    """The description of a simulator's robot."""
    return load_robot(fitted() / "robot.fitted.yaml" if simulator in ("identified", "augmented") else STOCK)


def trained(cell: Cell) -> dict[str, Any]:
    """Train the policy of a cell, if it is not there: its curve."""
    torch.set_num_threads(1)
    return of_training(train_policy(cell.robot, cell.folder, config=cell.config, seed=cell.seed, jobs=1, resume=True))


def of_training(made: TrainedPolicy) -> dict[str, Any]:
    """What is kept of a training: its best round, what it took, its curve."""
    best = max(made.history, key=lambda item: item.reward)
    return {
        "round": best.number,
        "distance": best.distance_m,
        "minutes": made.history[-1].seconds / 60,
        "cpu_minutes": made.history[-1].cpu_seconds / 60,
        "curve": [[item.steps, item.cpu_seconds, item.reward, item.distance_m] for item in made.history],
    }


def judged(cell: Cell) -> dict[str, Any]:
    """Place -> metric -> mean over goals; and the distances, goal by goal."""
    policy = Policy.load(cell.folder, joints=load_robot(STOCK).joint_names, rate_hz=TASK.control_hz)
    found = {}
    robots = {name: robot_of(name) for name in ("stock", "identified")}
    offset = np.array(OFFSET) if cell.simulator == "thesis" else None
    for place, reaching in places(robots, (*UNITS, *STRANGERS), offset).items():
        goals = reaching.workspace.draw(np.random.default_rng(21), GOALS)
        found[place] = judged_on(policy, reaching, goals[:DART_GOALS] if place == "dart" else goals)
    return found


def places(
    robots: Mapping[str, RobotSpec], units: Sequence[int], offset: np.ndarray | None = None
) -> dict[str, Reaching]:
    """Where a policy is judged.

    Args:
        robots: simulators by name; the one that is called `identified` is there in DART, too.
        units: of the virtual hardware.
        offset: what the thesis adds to actions on hardware, for its way alone (Table 3.1) [Nm].
    """
    model = MujocoSimulator.from_robot(load_robot(STOCK), find_model(load_robot(STOCK))).model
    asked = PolicyConfig(reach=TASK)
    found = {
        name: simulated(asked, robot, find_model(robot), count=50, randomized=False) for name, robot in robots.items()
    }
    robot = robots["identified"]
    found["dart"] = simulated(asked, robot, find_model(robot), engine="dart")
    spec = replace(LabSpec(), controller=Controller(kind="torque"))
    for unit in units:
        lab = VirtualRobot(draw_truth(spec, unit=unit))

        def put(pose: np.ndarray, rng: np.random.Generator, lab: VirtualRobot = lab) -> None:
            lab.restart(position=pose, seed=int(rng.integers(2**31)))

        found[f"lab-{unit}"] = Reaching(HardwareArm(lab, TASK.control_s, place=put), model, TASK, offset_nm=offset)
    return found


def judged_on(policy: Policy, reaching: Reaching, goals: np.ndarray) -> dict[str, Any]:
    """What is kept of a policy in a place."""
    robot = load_robot(STOCK)
    episodes = evaluate(policy.act, reaching, goals, velocity_limit=velocity_limit(find_model(robot), robot))
    return {
        **{name: float(episodes.values[name].mean()) for name in METRICS},
        "lost": int(episodes.lost.sum()),
        "distances": episodes.values["distance"].tolist(),
        "rewards": episodes.values["reward"].tolist(),
    }


def run() -> list[Row]:
    """Train what is not there, judge all, and hold the cells against the stock simulator's."""
    fitted()
    network()
    every, at_length = list(cells()), list(long_cells())
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        trainings = list(pool.map(trained, every + at_length))
        found = list(pool.map(judged, every + at_length))
    results: dict[str, Any] = {"policies": {}, "long": {}}
    for cell, training, own in zip(every + at_length, trainings, found, strict=True):
        by_draws = results["long" if cell in at_length else "policies"].setdefault(cell.simulator, {})
        by_draws.setdefault(cell.draws, {})[str(cell.seed)] = {"training": training, "places": own}
    about = {
        "units": UNITS,
        "strangers": STRANGERS,
        "goals": GOALS,
        "steps": STEPS,
        "long": LAPTOP.steps,
        "delayed": True,
    }
    result = {
        **results,
        "table": table(results["policies"]),
        "long_table": table(results["long"]),
        "provenance": provenance(config=about, seed=0),
    }
    write_json(RESULT, rounded(result))
    return rows(read_json(RESULT))


def table(results: Mapping[str, Any]) -> dict[str, Any]:
    """Simulator -> draws -> place -> median distance over goals and seeds, and the difference to the stock simulator.

    A goal counts once: with the mean over seeds, and over the robots where there are several.
    """
    lab = {
        "recorded robots": [f"lab-{unit}" for unit in UNITS],
        "other robots": [f"lab-{unit}" for unit in STRANGERS],
    }
    spots = {"stock": ["stock"], "identified": ["identified"], "dart": ["dart"], **lab}
    found: dict[str, Any] = {}
    for simulator, by_draws in results.items():
        for draws, by_seed in by_draws.items():
            own = {}
            for spot, names in spots.items():
                stock = results["stock"]["none"]
                distances, base = (_values(cell, names, "distances") for cell in (by_seed, stock))
                rewards = [_values(cell, names, "rewards") for cell in (by_seed, stock)]
                own[spot] = {
                    "median": float(np.median(distances)),
                    "interval": _interval(distances),
                    "by_seed": np.median(distances, axis=(1, 2)).tolist(),
                    "success": float((distances <= BAR_M).mean()),
                    "minus_stock": minus(distances, base, "distances"),
                    "minus_stock_reward": minus(*rewards, "rewards"),
                    "minus_stock_seeds": list(seeds_interval(distances.mean(axis=1), base.mean(axis=1))),
                    **{
                        name: float(np.mean([s["places"][n][name] for s in by_seed.values() for n in names]))
                        for name in ("overshoot", "smoothness", "torque_at_limit", "velocity_violation", "reward")
                    },
                }
            found.setdefault(simulator, {})[draws] = own
    return found


def _values(by_seed: Mapping[str, Any], names: list[str], key: str) -> np.ndarray:
    """(seeds, robots, goals)."""
    return np.array([[own["places"][name][key] for name in names] for own in by_seed.values()])


def minus(values: np.ndarray, base: np.ndarray, key: str) -> list[float | None]:
    """The difference of two cells, goal by goal, with its interval.

    Args:
        values: of all policies and robots, (..., goals).
        base: of the simulator as it comes, (..., goals).
        key: what they are, `distances` or `rewards`.
    """
    said = paired_difference(
        *(every.mean(axis=tuple(range(every.ndim - 1))) for every in (values, base)),
        run="this",
        baseline="stock, none",
        split="goals",
        signal="reach",
        metric=key,
        unit="m" if key == "distances" else "1",
    ).difference
    return [said.value, said.low, said.high]


def _interval(distances: np.ndarray, draws: int = 2000) -> list[float]:
    """Of the median, 95 %, over goals drawn again, with all robots and seeds of each."""
    rng = np.random.default_rng(0)
    goals = distances.shape[-1]
    medians = [np.median(distances[..., rng.integers(goals, size=goals)]) for _ in range(draws)]
    low, high = np.quantile(medians, (0.025, 0.975))
    return [float(low), float(high)]


def rows(result: Mapping[str, Any]) -> list[Row]:
    """The cells, and the bars."""
    found = []
    for name, steps in (("table", "steps"), ("long_table", "long")):
        said = f"{result['provenance']['config'][steps]:,} steps: "
        for simulator, by_draws in result[name].items():
            for draws, own in by_draws.items():
                for spot, item in own.items():
                    found.append(shown(f"{said}{simulator}, {draws}: on {spot}, median", 100 * item["median"], "cm"))
        best = result[name]["identified"]["posterior"]["recorded robots"]
        found.append(
            at_most(f"{said}identified, posterior, on the recorded robots: median", 100 * best["median"], 5.0, "cm")
        )
        found.append(at_most(f"{said}its difference to stock, upper end", 100 * best["minus_stock"][2], 0.0, "cm"))
    return found
