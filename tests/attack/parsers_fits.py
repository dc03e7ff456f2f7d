"""What a search and a planner go on from, and what a command finds in the folder that it writes into."""

from __future__ import annotations

import functools
import json
import random
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from attack.harness import Parser, Unsound
from attack.mutations import change, mutate
from attack.parsers_results import make_gap_file, make_identification, make_ladder_file
from identify.recovery_cases import SERVO, Truth, arm, nominal_of
from identify.test_solve import Replaced, linear
from trueup.core.atomic import json_hash
from trueup.identify import Problem, SegmentRule, SolveSettings, make_segments, solve
from trueup.identify.config import make_parameters
from trueup.identify.solution import SolverName
from trueup.identify.solvers import GaussNewtonSettings
from trueup.record import Plan, PlanSet, load_workspace, store_plans
from trueup.robots import RobotSpec
from trueup.stages.folder import forget_explanation, forget_fit, forget_other_ladder, refuse_other_fit

SOLVERS: tuple[SolverName, ...] = ("gauss-newton", "cma-es", "evolution")
ORIGIN = {
    "by": "attack",
    "workspace": asdict(load_workspace("floor")),
    "limits": {"velocity": [2.0, 2.0], "acceleration": [5.0, 5.0], "low": [-3.0, -3.0], "high": [3.0, 3.0]},
}
IDS = [f"motion/{number:05d}" for number in range(3)]


@functools.cache
def _problem() -> Problem:
    with tempfile.TemporaryDirectory() as folder:
        robot, nominal = nominal_of(Path(folder), SERVO)
    segments, _ = make_segments([Truth(robot, nominal, {}).log(1, seconds=1.0)], nominal.simulator, SegmentRule())
    return Problem(nominal, make_parameters({"damping": "all"}, nominal), segments)


def _solve(folder: Path, solver: SolverName) -> np.ndarray:
    settings = SolveSettings(
        solver=solver, max_evaluations=60, gauss_newton=GaussNewtonSettings(max_iterations=3, tolerance=1e-12)
    )
    problem = Replaced(_problem(), linear(_problem().size))
    found: np.ndarray = solve(problem, settings, checkpoint=folder / "fit.json").z
    return found


@functools.cache
def _expected(solver: SolverName) -> np.ndarray:
    with tempfile.TemporaryDirectory() as folder:
        return _solve(Path(folder), solver)


def make_search(solver: SolverName) -> Callable[[Path], None]:
    """The checkpoint of a search that is finished."""

    def make(folder: Path) -> None:
        _solve(folder, solver)

    return make


def read_search(solver: SolverName) -> Callable[[Path], Iterator[Exception]]:
    """As `identify --resume` does."""

    def read(folder: Path) -> Iterator[Exception]:
        found = _solve(folder, solver)
        low, high = _problem().parameters.bounds
        if not (np.isfinite(found).all() and (low <= found).all() and (found <= high).all()):
            raise Unsound(f"ended at {found}")
        yield from ()

    return read


def change_search(folder: Path, rng: random.Random) -> str:
    """The state, and a hash that fits."""
    path = next(folder.glob("*.json"))
    whole = json.loads(path.read_bytes())
    try:
        state = json.loads(change(json.dumps(whole["state"]).encode(), ".json", rng))
    except (ValueError, RecursionError):
        return mutate(folder, rng)
    path.write_text(json.dumps({**whole, "state": state, "sha256": json_hash(state)}))
    return "state changed, hash made anew"


def _plans(made: int) -> Plan:
    time_s = np.arange(40) / 100.0
    position = np.outer(np.sin(time_s), [1.0, 0.5 + made])
    velocity, acceleration = np.gradient(position, 0.01, axis=0), np.zeros_like(position)
    joints = ("shoulder", "elbow")
    return Plan(
        "x",
        "chirp",
        joints,
        joints,
        time_s,
        position,
        velocity,
        acceleration,
        0.1,
        0.3,
        "a",
        "train",
        0,
        made,
        {"size": 1.0},
    )


@functools.cache
def _robot() -> tuple[tempfile.TemporaryDirectory[str], RobotSpec, Path]:
    folder = tempfile.TemporaryDirectory()
    robot, path = arm(Path(folder.name))
    joints = tuple(replace(joint, position_limits=(-3.0, 3.0)) for joint in robot.joints)
    return folder, replace(robot, joints=joints), path


def _store(folder: Path) -> tuple[Plan, ...]:
    _, robot, model = _robot()
    return store_plans(lambda made: _plans(len(made)), IDS, robot, folder, origin=ORIGIN, model=model)


def make_plans(folder: Path) -> None:
    """Three plans that were stored."""
    _store(folder)


def read_plans(folder: Path) -> Iterator[Exception]:
    """Read, and stored again as after an interruption."""
    plans = PlanSet(folder)
    found = {plan.id: plan for plan in plans}
    list(plans.ids()), plans.skipped(), json.dumps(plans.to_dict())
    plans.scene(_robot()[1], model=_robot()[2])
    if not all(np.isfinite(plan.position).all() for plan in found.values()):
        raise Unsound("a plan is not finite")
    stored = _store(folder)
    if [plan.id for plan in stored] != IDS:
        raise Unsound("plans are missing")
    yield from ()


def make_results(folder: Path) -> None:
    """What earlier commands have left."""
    make_gap_file(folder)
    make_ladder_file(folder)
    make_identification(folder)


def read_results(folder: Path) -> Iterator[Exception]:
    """What a command looks at before it writes."""
    refuse_other_fit(folder, "other")
    yield from ()


def forget_results(folder: Path) -> Iterator[Exception]:
    """What a command forgets when it has written."""
    forget_explanation(folder, unless_of="other")
    forget_other_ladder(folder)
    forget_fit(folder)
    yield from ()


PARSERS = [
    *(Parser(f"search by {solver}", make_search(solver), read_search(solver), change_search) for solver in SOLVERS),
    Parser("plan set", make_plans, read_plans),
    Parser("refused results", make_results, read_results, refuses=True),
    Parser("forgotten results", make_results, forget_results),
]
