"""What the numbers of four algorithms do to learning (ES thesis, Fig. 2.1 to 2.5 and 2.7), three seeds each.

One number at a time is varied around the laptop's, with one reward counted at a time and a learning rate that stays, as
in the thesis; a fifth of the laptop's control steps. Each is a grid search (`trueup policy grid`).

`python -m benchmarks policy_grid` searches what is not there, under runs/policies/grids (about half an hour on two
cores). Its figures are kept in benchmarks/results/policy_grid.json.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import torch

from benchmarks.policy_data import FOLDER, STOCK
from benchmarks.table import Row, rounded, shown
from trueup.core.atomic import as_read_back, read_json, write_json
from trueup.core.provenance import provenance
from trueup.policy.config import LAPTOP, Algorithm, PolicyConfig
from trueup.policy.grid import read_grid
from trueup.robots import load_robot
from trueup.stages.policy_grid import search_grid

RESULT = Path(__file__).parent / "results" / "policy_grid.json"
SEEDS = (0, 1, 2)
STEPS = 40_000


@dataclass(frozen=True)
class Question:
    """One figure of the thesis.

    Attributes:
        figure: its number.
        algorithm: whose numbers.
        name: of what is varied.
        values: that it has.
        noise: of the actions, for what has no other way to explore.
    """

    figure: str
    algorithm: Algorithm
    name: str
    values: tuple[Any, ...]
    noise: Literal["none", "normal"] = "none"

    @property
    def id(self) -> str:
        """Name of the search's folder."""
        return f"{self.algorithm}-{self.name}"

    @property
    def config(self) -> PolicyConfig:
        """What the grid does not say."""
        learner = replace(LAPTOP.learner, rate=1e-3, last_rate=None, n_steps=1, noise=self.noise)
        return replace(LAPTOP, algorithm=self.algorithm, learner=learner, steps=STEPS, rounds=10)


QUESTIONS = (
    Question("2.1", "ddpg", "noise", ("none", "normal", "ou")),
    Question("2.2", "sac", "gamma", (0.99, 0.95)),
    Question("2.3", "td3", "gamma", (0.99, 0.95), noise="normal"),
    Question("2.4 and 2.5", "tqc", "rate", (1e-4, 1e-3, 1e-2)),
    Question("2.7", "tqc", "gamma", (0.99, 0.95, 0.9)),
    # 2.3.2 has 0.9 as the best, 2.3.1 calls 0.9 and more poor.
    Question("2.3.2", "tqc", "tau", (0.9, 0.8, 0.1, 0.02)),
)


def run() -> list[Row]:
    """Search what is not there; keep the curves, those of questions that were asked before, too."""
    torch.set_num_threads(1)
    found, before = [], _asked_before()
    for question in QUESTIONS:
        if question.id in before:
            found.append(before[question.id])
            continue
        grid = read_grid({question.name: list(question.values), "seed": list(SEEDS)}, question.id)
        searched = search_grid(
            load_robot(STOCK), FOLDER / "grids" / question.id, config=question.config, grid=grid, jobs=2, resume=True
        )
        groups = []
        for value in question.values:
            own = [trial for trial in searched.trials if trial.point.values[f"learner.{question.name}"] == value]
            curves = [[[item.steps, item.reward, item.distance_m] for item in trial.rounds] for trial in own]
            groups.append({"value": value, "curves": curves, "failed": sum(bool(trial.reason) for trial in own)})
        found.append({**_about(question), "groups": groups})
    result = {
        "steps": STEPS,
        "seeds": len(SEEDS),
        "questions": found,
        "provenance": provenance(config={question.id: asdict(question.config) for question in QUESTIONS}, seed=0),
    }
    write_json(RESULT, rounded(result))
    return rows(read_json(RESULT))


def _asked_before() -> dict[str, Any]:
    """Answers that are kept, of the same configurations; delete the file to ask them again."""
    if not RESULT.is_file():
        return {}
    result = read_json(RESULT)
    asked = result["provenance"]["config"]
    same = {question.id for question in QUESTIONS if asked.get(question.id) == as_read_back(asdict(question.config))}
    answers = {f"{item['algorithm']}-{item['name']}": item for item in result["questions"]}
    return {name: answers[name] for name in same if name in answers}


def _about(question: Question) -> dict[str, str]:
    return {"figure": question.figure, "algorithm": question.algorithm, "name": question.name}


def rows(result: dict[str, Any]) -> list[Row]:
    rows = []
    for question in result["questions"]:
        for group in question["groups"]:
            ends = [max(point[1] for point in curve) for curve in group["curves"] if curve]
            if ends:
                title = f"{question['algorithm']}, {question['name']} {group['value']}: reward of a control step, best"
                rows.append(shown(title, sum(ends) / len(ends), "1"))
    return rows
