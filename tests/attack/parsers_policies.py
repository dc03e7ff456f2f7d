"""Policies, what is said of them, and what they and compensations are trained by."""

from __future__ import annotations

import json
import random
import shutil
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import numpy as np
import yaml

from attack.harness import Parser, Unsound
from attack.mutations import edit_tree, mutate
from attack.parsers_models import seal
from report.test_report_policies import evaluation, saved
from trueup import zoo
from trueup.compensate.config import METHODS, CompensateConfig
from trueup.core.atomic import write_json
from trueup.core.config import build, read_yaml
from trueup.core.policy_card import POLICY_CARD, POLICY_GRAPH, PolicyCard
from trueup.core.policy_evaluation import EPISODES_NAME, EVALUATION_NAME, PolicyEvaluation, load_curves
from trueup.deploy.policy import Policy
from trueup.identify.export import SAMPLES_FILE
from trueup.policy.config import LAPTOP, PolicyConfig, task_of
from trueup.policy.grid import read_grid
from trueup.policy.posterior import Posterior

POLICY = "panda-reach"
GRID = {"rate": [0.005, 0.002], "noise, sigma": [["none", 0.1], ["ou", 0.2]], "steps": [40_000], "seed": [0, 1]}


def make_policy(folder: Path) -> None:
    """That of the zoo."""
    for name in (POLICY_CARD, POLICY_GRAPH):
        shutil.copy(zoo.folder(POLICY) / name, folder / name)


def change_policy(folder: Path, rng: random.Random) -> str:
    """What lies behind the hashes: the card's tree, or anything."""
    if rng.random() < 0.5:
        said = mutate(folder, rng)
    else:
        card = json.loads((folder / POLICY_CARD).read_bytes())
        (folder / POLICY_CARD).write_text(json.dumps(edit_tree(card, rng)))
        said = "card edited"
    seal(folder, POLICY_CARD, [POLICY_GRAPH])
    return f"{said}, hashes made anew"


def read_policy(folder: Path) -> Iterator[Exception]:
    """As far as torques."""
    card = PolicyCard.load(folder)
    task_of(card)
    policy = Policy.load(folder, joints=card.joints, rate_hz=card.rate_hz)
    rng = np.random.default_rng(0)
    for _ in range(5):
        step = policy.step(rng.normal(size=len(card.joints)), rng.normal(size=len(card.joints)), np.full(3, 0.4))
        if step.sound and not (np.abs(step.torque) <= np.array(card.torque_nm) * (1 + 1e-6)).all():
            raise Unsound("torques beyond the largest ones")
    yield from ()


def make_evaluation(folder: Path) -> None:
    """Two policies in two places."""
    saved(folder, *evaluation(("one", "other")))


def read_evaluation(folder: Path) -> Iterator[Exception]:
    """Numbers and curves, there and back."""
    found = PolicyEvaluation.load(folder / EVALUATION_NAME)
    found.save(folder / "again.json")
    if PolicyEvaluation.load(folder / "again.json").to_json() != found.to_json():
        raise Unsound("what was written again is not what was read")
    load_curves(folder / EPISODES_NAME, found)
    yield from ()


def make_samples(folder: Path) -> None:
    """What an identification draws from."""
    rng = np.random.default_rng(0)
    samples = {"damping[joint1]": rng.uniform(0.5, 1.5, 50), "delay_s": rng.uniform(0.0, 0.01, 50)}
    np.savez(folder / SAMPLES_FILE, **samples)
    tree = {"schema": "trueup.fit/1", "status": "ok", "statements": [], "solver": {}}
    empty = {key: {} for key in ("errors", "correlation", "whiteness", "data", "provenance")}
    write_json(folder / "fit.json", {**tree, **empty, "parameters": [], "directions": [], "models": []})


def read_samples(folder: Path) -> Iterator[Exception]:
    """As a training that randomizes does."""
    if not all(np.isfinite(values).all() for values in Posterior.load(folder).samples.values()):
        raise Unsound("a sample is not finite")
    yield from ()


def make_policy_config(folder: Path) -> None:
    """Every key."""
    (folder / "policy.yaml").write_text(yaml.safe_dump(json.loads(json.dumps(asdict(LAPTOP))), sort_keys=False))


def read_policy_config(folder: Path) -> Iterator[Exception]:
    """There and back."""
    config = build(PolicyConfig, read_yaml(folder / "policy.yaml"), str(folder / "policy.yaml"))
    json.dumps(asdict(config), allow_nan=False)
    yield from ()


def make_grid(folder: Path) -> None:
    """Axes of one number and of two."""
    (folder / "grid.yaml").write_text(yaml.safe_dump(GRID, sort_keys=False))


def read_grid_file(folder: Path) -> Iterator[Exception]:
    """As far as the trainings."""
    grid = read_grid(read_yaml(folder / "grid.yaml"), str(folder / "grid.yaml"))
    points = grid.points(LAPTOP)
    if len({point.id for point in points}) < len(points):
        raise Unsound("two trainings of one name")
    yield from ()


def make_compensate_config(folder: Path) -> None:
    """Every key, of a network by its steps and of one by reinforcement."""
    for name in ("operator", "operator-paper", "transformer"):
        tree = json.loads(json.dumps(asdict(METHODS[name])))
        tree["network"] = {key: value for key, value in tree["network"].items() if value is not None}
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(tree, sort_keys=False))


def read_compensate_config(folder: Path) -> Iterator[Exception]:
    """There and back."""
    for path in sorted(folder.glob("*.yaml")):
        json.dumps(asdict(CompensateConfig.load(path)), allow_nan=False)
    yield from ()


PARSERS = [
    Parser("policy", make_policy, read_policy, change_policy),
    Parser("evaluation of policies", make_evaluation, read_evaluation),
    Parser("samples of a fit", make_samples, read_samples),
    Parser("policy.yaml", make_policy_config, read_policy_config),
    Parser("grid.yaml", make_grid, read_grid_file),
    Parser("compensate.yaml", make_compensate_config, read_compensate_config),
]
