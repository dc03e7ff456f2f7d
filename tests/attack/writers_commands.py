"""Writers that are whole commands: close, fleet, trainings, grids, sweeps, a policy at work; to be killed.

What is left is the result of an earlier call, a part that the next call goes on from, or nothing.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from safetensors.torch import load_file

from attack.harness import Writer
from augment.augment_cases import RUN, make_dataset
from compensate.arm_cases import arm_of
from compensate.arm_cases import recorded as commanded
from compensate.test_training import CONFIG as COMPENSATION
from compensate.test_training import sags
from identify.recovery_cases import Truth, arm
from policy.test_learned import SAC
from stages.test_policy_grid import every_point_once, searched
from stages.test_sweeping import CANDIDATES, SEEDS, numbers
from trueup import zoo
from trueup.core.close_result import CLOSE_NAME, CloseResult
from trueup.core.fit_result import FitResult
from trueup.core.fleet_result import FLEET_NAME, FleetResult
from trueup.core.model_card import CARD_NAME, ModelCard
from trueup.core.policy_card import POLICY_CARD, POLICY_GRAPH, POLICY_LEARNER, PolicyCard
from trueup.core.policy_evaluation import EPISODES_NAME, EVALUATION_NAME, PolicyEvaluation, load_curves
from trueup.core.results import GapResult, Ladder
from trueup.core.sweep_result import SweepResult
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter, is_dataset
from trueup.deploy import Predictor
from trueup.deploy.policy import Policy
from trueup.identify import IdentifyConfig, Nominal
from trueup.identify.config import SolverChoice
from trueup.robots import load_robot
from trueup.stages import compensate, sweep
from trueup.stages.closing import close
from trueup.stages.fleet import fleet
from trueup.stages.policy_driving import drive
from trueup.stages.policy_grid import GRID_FILE
from trueup.stages.policy_judging import judge_policies
from trueup.stages.policy_training import train_policy

QUICK = IdentifyConfig(fit={"kp": "all"}, solver=SolverChoice(max_iterations=3))
UNITS = {"arm-1": 41.0, "arm-2": 45.0}
POLICY = "panda-reach"
TRAINING = replace(SAC, steps=480, rounds=3)
CORRECTING = replace(COMPENSATION, training=replace(COMPENSATION.training, updates=40, rounds=8))
# What depends on the clock, or on where the folder is.
_OF_THE_CALL = ("seconds", "cpu_seconds", "measuring_s", "provenance", "machine", "status")


def _said(tree: Any) -> Any:
    """A result without what differs from call to call."""
    if isinstance(tree, Mapping):
        return {key: _said(value) for key, value in tree.items() if key not in _OF_THE_CALL}
    return [_said(item) for item in tree] if isinstance(tree, list) else tree


def _read(path: Path) -> Any:
    return _said(json.loads(path.read_text()))


def _files(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file() and path.name != ".lock"}


# --- logs of two arms, each of its own


def _prepare_arms(base: Path) -> None:
    spec, model = arm(base)
    (base / "robot.yaml").write_text(json.dumps(replace(spec, folder=None).to_dict()))
    nominal = Nominal(load_robot(base / "robot.yaml"), model)
    for name in ("data", "again"):
        with DatasetWriter.create(base / name, DatasetInfo(robot="arm")) as writer:
            for unit, kp in UNITS.items():
                truth = Truth(nominal.robot, nominal, {"kp[shoulder]": kp, "kp[elbow]": kp})
                for number, split in enumerate(("train", "val", "test")):
                    log = truth.log(10 * number + int(unit[-1]), seconds=2.0)
                    meta = replace(log.meta, id=f"{unit}/{number}", unit=unit, robot="arm", split=split)
                    writer.append(replace(log, meta=meta))


# --- close


def _close(base: Path, name: str = "closed", data: str = "data") -> None:
    close(
        *(base / data, load_robot(base / "robot.yaml"), base / name),
        config=QUICK, methods=("moving-average",), jobs=1, resume=True,
    )  # fmt: skip


def _prepare_close(base: Path) -> None:
    _prepare_arms(base)
    _close(base, "expected", "again")


_CLOSED = {CLOSE_NAME: CloseResult, "gap.json": GapResult, "ladder.json": Ladder, "fit.json": FitResult}


def _close_part(base: Path) -> None:
    for name, kind in _CLOSED.items():
        if (base / "closed" / name).exists():
            kind.load(base / "closed" / name)
    for name in ("data", "again"):
        assert len(Dataset(base / name)) == 3 * len(UNITS)


def _closed(base: Path) -> None:
    _close_part(base)
    assert all(step.finished for step in CloseResult.load(base / "closed" / CLOSE_NAME).steps)
    found, expected = (FitResult.load(base / name / "fit.json").values for name in ("closed", "expected"))
    assert found == expected
    ladders = [Ladder.load(base / name / "ladder.json").rungs for name in ("closed", "expected")]
    errors = [
        [(rung.name, rung.chosen, rung.splits["test"]["position"]["rmse"].total.value) for rung in rungs]
        for rungs in ladders
    ]
    assert errors[0] == errors[1]
    assert _files(base / "closed") == _files(base / "expected")


# --- fleet


def _fleet(base: Path, name: str = "fleet") -> None:
    fleet([base / "data"], load_robot(base / "robot.yaml"), base / name, config=QUICK, jobs=1, resume=True)


def _prepare_fleet(base: Path) -> None:
    _prepare_arms(base)
    _fleet(base, "expected")


def _fleet_part(base: Path) -> None:
    if (base / "fleet" / FLEET_NAME).exists():
        _fleet_done(base)
    for unit in UNITS:
        if (base / "fleet" / unit / "fit.json").exists():
            FitResult.load(base / "fleet" / unit / "fit.json")


def _fleet_done(base: Path) -> None:
    found, expected = (FleetResult.load(base / name / FLEET_NAME) for name in ("fleet", "expected"))
    assert found.parameters == expected.parameters
    for one, other in zip(found.units, expected.units, strict=True):
        assert (one.name, one.status, one.errors, one.parameters) == (
            *(other.name, other.status, other.errors, other.parameters),
        )
    assert _files(base / "fleet") == _files(base / "expected")


# --- trainings


def _train_policy(base: Path, name: str = "policy") -> None:
    train_policy(load_robot("panda_torque"), base / name, config=TRAINING, jobs=1, resume=True)


def _policy_part(base: Path) -> None:
    if (base / "policy" / POLICY_CARD).exists():
        card = PolicyCard.load(base / "policy")
        Policy.load(base / "policy", joints=card.joints, rate_hz=card.rate_hz)


def _policy(base: Path) -> None:
    _policy_part(base)
    assert _files(base / "policy") == {POLICY_CARD, POLICY_GRAPH, POLICY_LEARNER}
    assert (base / "policy" / POLICY_GRAPH).read_bytes() == (base / "expected" / POLICY_GRAPH).read_bytes()
    # Tensors, not bytes: safetensors writes what is said beside them in any order.
    found, expected = (load_file(base / name / POLICY_LEARNER) for name in ("policy", "expected"))
    assert found.keys() == expected.keys()
    assert all(found[name].equal(expected[name]) for name in expected)


def _prepare_compensation(base: Path) -> None:
    robot, path = arm_of(base / "robot", friction=False)
    commanded(base / "data", robot, path, offset=sags, payloads=(0.0,), seconds=1.2)
    _compensate(base, "expected")


def _compensate(base: Path, name: str = "model") -> None:
    robot, path = arm_of(base / "robot", friction=False)
    compensate(Dataset(base / "data"), robot, base / name, model=path, config=CORRECTING, jobs=1, resume=True)


def _compensation_part(base: Path) -> None:
    if (base / "model" / CARD_NAME).exists():
        Predictor.load(base / "model")


def _compensation(base: Path) -> None:
    _compensation_part(base)
    assert _files(base / "model") == _files(base / "expected")
    for name in _files(base / "model") - {CARD_NAME}:
        assert (base / "model" / name).read_bytes() == (base / "expected" / name).read_bytes(), name


# --- many trainings


def _grid_part(base: Path) -> None:
    for path in (base / "grid").glob(f"trials/*/{POLICY_CARD}"):
        card = PolicyCard.load(path.parent)
        Policy.load(path.parent, joints=card.joints, rate_hz=card.rate_hz)
    if (base / "grid" / GRID_FILE).exists():
        every_point_once(base / "grid")


def _grid(base: Path) -> None:
    _grid_part(base)
    found, expected = (_read(base / name / GRID_FILE) for name in ("grid", "expected"))
    assert found["curve"][1] == "seconds"
    for tree in (found, expected):
        for trial in tree["trials"]:
            trial["curve"] = [[steps, *rest] for steps, _, *rest in trial["curve"]]
    assert found == expected
    assert _files(base / "grid") == _files(base / "expected")


def _sweep(base: Path, name: str = "swept") -> None:
    sweep([base / "arm"], base / name, run=RUN, candidates=CANDIDATES, seeds=SEEDS, jobs=1, resume=True)


def _prepare_sweep(base: Path) -> None:
    make_dataset(base / "arm")
    _sweep(base, "expected")


def _sweep_part(base: Path) -> None:
    if (base / "swept" / "sweep.json").exists():
        for training in SweepResult.load(base / "swept" / "sweep.json").trainings:
            if training.state == "complete":
                ModelCard.load(base / "swept" / training.folder)


def _swept(base: Path) -> None:
    _sweep_part(base)
    found, expected = (SweepResult.load(base / name / "sweep.json") for name in ("swept", "expected"))
    assert numbers(found) == numbers(expected)
    assert _files(base / "swept") == _files(base / "expected")


# --- what is made anew by each call


def _drive(base: Path, name: str = "driven") -> None:
    robot = load_robot("panda_torque")
    drive(zoo.folder(POLICY), robot, 3, seconds=0.2, rate_hz=500.0, out=base / name, overwrite=True)


def _driven_part(base: Path) -> None:
    if not is_dataset(base / "driven"):
        return
    driven, expected = (Dataset(base / name) for name in ("driven", "expected"))
    assert list(driven.ids) == list(expected.ids)[: len(driven)]
    for episode in driven:
        known = expected[episode.id]
        for one, other in ((episode.measured, known.measured), (episode.commanded(), known.commanded())):
            assert one.time_s.tobytes() == other.time_s.tobytes()
            assert all(one[signal].tobytes() == other[signal].tobytes() for signal in one.signals)


def _driven(base: Path) -> None:
    _driven_part(base)
    assert Dataset(base / "driven").ids == Dataset(base / "expected").ids
    assert _files(base / "driven") == _files(base / "expected")


def _judge(base: Path, name: str = "judged") -> None:
    robot = load_robot("panda_torque")
    judge_policies([zoo.folder(POLICY)], robot, goals=3, jobs=1, out=base / name, overwrite=True)


def _judged_part(base: Path) -> None:
    if (base / "judged" / EVALUATION_NAME).exists():  # then the curves are there, too, of this call or an earlier one
        found = PolicyEvaluation.load(base / "judged" / EVALUATION_NAME)
        load_curves(base / "judged" / EPISODES_NAME, found)


def _judged(base: Path) -> None:
    _judged_part(base)
    assert _read(base / "judged" / EVALUATION_NAME) == _read(base / "expected" / EVALUATION_NAME)
    assert _files(base / "judged") == {EVALUATION_NAME, EPISODES_NAME}


COMMAND_WRITERS = (
    Writer("close", _close, _close_part, _closed, _prepare_close, slow=True),
    Writer("fleet", _fleet, _fleet_part, _fleet_done, _prepare_fleet, slow=True),
    Writer(
        "policy training", _train_policy, _policy_part, _policy, lambda base: _train_policy(base, "expected"), slow=True
    ),
    Writer("compensation", _compensate, _compensation_part, _compensation, _prepare_compensation, slow=True),
    Writer(
        *("policy grid", lambda base: searched(base / "grid", resume=True), _grid_part, _grid),
        lambda base: searched(base / "expected"),
        slow=True,
    ),
    Writer("sweep", _sweep, _sweep_part, _swept, _prepare_sweep, slow=True),
    Writer("policy at work", _drive, _driven_part, _driven, lambda base: _drive(base, "expected"), slow=True),
    Writer("policy judged", _judge, _judged_part, _judged, lambda base: _judge(base, "expected"), slow=True),
)
