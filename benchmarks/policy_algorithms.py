"""Four algorithms at equal budget, three seeds each (ES thesis, Fig. 2.6): reaching in the simulator as it comes.

All have the laptop's numbers and as many control steps and updates; what acts by a deterministic policy explores by
normal noise and counts one reward at a time, for with three it learns nothing here (seed 0, the first two minutes).

`python -m benchmarks policy_algorithms` trains what is not there, under runs/policies/algorithms (about half an hour on
two cores). Its figures are kept in benchmarks/results/policy_algorithms.json.
"""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, replace
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.policy_data import FOLDER, STOCK
from benchmarks.table import Row, rounded, shown
from trueup.core.atomic import read_json, write_json
from trueup.core.provenance import provenance
from trueup.deploy.policy import Policy
from trueup.measure import paired_difference
from trueup.measure.seeds import seeds_interval
from trueup.policy.config import ALGORITHMS, LAPTOP, Algorithm, PolicyConfig, laptop
from trueup.policy.evaluation import evaluate
from trueup.policy.simulated import simulated
from trueup.robots import find_model, load_robot
from trueup.stages.policy_training import train_policy

RESULT = Path(__file__).parent / "results" / "policy_algorithms.json"
SEEDS = (0, 1, 2)
STEPS = 100_000
GOALS = 100


def config_of(algorithm: Algorithm) -> PolicyConfig:
    """The laptop's numbers; deterministic policies explore by noise."""
    return replace(laptop(algorithm), steps=STEPS)


def trained(task: tuple[Algorithm, int]) -> dict[str, Any]:
    """Train, if it is not there, and judge on the same goals."""
    torch.set_num_threads(1)
    algorithm, seed = task
    robot, folder = load_robot(STOCK), FOLDER / "algorithms" / f"{algorithm}-{seed}"
    made = train_policy(robot, folder, config=config_of(algorithm), seed=seed, jobs=1, resume=True)
    policy = Policy.load(folder, joints=robot.joint_names, rate_hz=made.card.rate_hz)
    reaching = simulated(LAPTOP, robot, find_model(robot), count=50, randomized=False)
    found = evaluate(policy.act, reaching, reaching.workspace.draw(np.random.default_rng(21), GOALS))
    return {
        "distances": found.values["distance"].tolist(),
        "rewards": found.values["reward"].tolist(),
        "minutes": made.history[-1].cpu_seconds / 60,
        "curve": [[item.steps, item.cpu_seconds, item.reward, item.distance_m] for item in made.history],
    }


def run() -> list[Row]:
    """Train what is not there; hold TQC against the others, goal by goal, with the mean over seeds."""
    tasks = list(product(ALGORITHMS, SEEDS))
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        done = dict(zip(tasks, pool.map(trained, tasks), strict=True))
    result: dict[str, Any] = {"steps": STEPS, "goals": GOALS, "algorithms": {}}
    reward = {name: np.mean([done[name, seed]["rewards"] for seed in SEEDS], axis=0) for name in ALGORITHMS}
    for name in ALGORITHMS:
        distances = np.array([done[name, seed]["distances"] for seed in SEEDS])
        own: dict[str, Any] = {
            "config": asdict(config_of(name).learner),
            "median": float(np.median(distances)),
            "by_seed": np.median(distances, axis=1).tolist(),
            "reward": float(reward[name].mean()),
            "minutes": float(np.mean([done[name, seed]["minutes"] for seed in SEEDS])),
            "curves": [done[name, seed]["curve"] for seed in SEEDS],
        }
        if name != "tqc":
            paired = paired_difference(
                reward["tqc"],
                reward[name],
                run="tqc",
                baseline=name,
                split="goals",
                signal="reach",
                metric="reward",
                unit="1",
            ).difference
            own["tqc_minus"] = [paired.value, paired.low, paired.high]
            each = [np.array([done[item, seed]["rewards"] for seed in SEEDS]) for item in ("tqc", name)]
            own["tqc_minus_seeds"] = list(seeds_interval(*each))
        result["algorithms"][name] = own
    result["provenance"] = provenance(config={"steps": STEPS, "seeds": SEEDS}, seed=0)
    write_json(RESULT, rounded(result))
    return rows(read_json(RESULT))


def rows(result: dict[str, Any]) -> list[Row]:
    rows = []
    for name, own in result["algorithms"].items():
        rows.append(shown(f"{name}: median distance", 100 * own["median"], "cm"))
        rows.append(shown(f"{name}: reward of a control step", own["reward"], "1"))
        rows.append(shown(f"{name}: training", own["minutes"], "min of one core"))
        if "tqc_minus" in own:
            rows.append(shown(f"{name}: reward of tqc minus this, lower end", own["tqc_minus"][1], "1"))
    return rows
