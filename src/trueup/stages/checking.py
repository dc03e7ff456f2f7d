"""Check: whether logs, robot.yaml and model fit together, before anything is fitted."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from trueup.align import JointMap
from trueup.core.atomic import json_hash
from trueup.core.check_result import CheckResult
from trueup.core.provenance import provenance
from trueup.dataset import Dataset
from trueup.errors import DataError, SetupWrong, TrueupError
from trueup.robots import RobotSpec
from trueup.stages.close_asked import asked_of_data
from trueup.stages.close_words import of_certain
from trueup.stages.replay_parts import readable
from trueup.stages.robot_model import model_file

# More motions say the same once more.
_MOST = 40
GO_ON = "Fix the errors above and start again, or continue anyway with --force."


def check_setup(
    dataset: Dataset, robot: RobotSpec, *, model: Path | None = None, ids: Sequence[str] | None = None
) -> CheckResult:
    """What is wrong with a set-up: signs, names, units, zeros, clocks, gravity, control mode.

    It takes seconds: what commands and measurements say of each other, and what the model's inverse dynamics says of
    both. At most 40 motions are looked at, spread over the dataset.

    Args:
        dataset: logs; any joint names that the robot's joint map knows.
        robot: its description.
        model: MJCF or URDF; looked for beside the data and in the package if None.
        ids: episodes; all if None.

    Raises:
        NameMismatch: the joints of log, robot and model do not agree.
        ConfigError: the model is not found, or does not load.
        DataError: there is no episode, or none could be read.
    """
    from trueup.check import check_motions

    began = time.perf_counter()
    path = model_file(robot, dataset, given=model)
    wanted = list(dataset.ids if ids is None else ids)
    if not wanted:
        raise DataError(f"{dataset.path} has no episodes", hint="Record or import some first.")
    chosen = [wanted[row] for row in np.unique(np.linspace(0, len(wanted) - 1, _MOST).astype(int))]
    failed: dict[str, TrueupError] = {}
    episodes = list(readable(dataset, chosen, JointMap.from_dict(robot.joint_rules()), failed))
    if not episodes:
        raise next(iter(failed.values()))
    findings, unseen = check_motions(episodes, robot, path)
    return CheckResult(
        findings,
        motions=len(episodes),
        unseen=unseen,
        seconds=round(time.perf_counter() - began, 3),
        provenance=provenance(config={"robot": robot.to_dict(), "model": path.name}, data_hash=dataset.hash),
    )


def check_inputs(dataset: Dataset, robot: RobotSpec, *, model: Path | None) -> str:
    """Hash of everything that decides about what a check finds.

    Raises:
        ConfigError: there is no model.
    """
    return json_hash([asked_of_data(dataset, robot, model), robot.to_dict()])


def refuse_wrong(result: CheckResult) -> None:
    """Refuse to fit what cannot be right.

    Raises:
        SetupWrong: something is certainly wrong.
    """
    if result.certain:
        raise SetupWrong(
            "the set-up is wrong, and a fit would hide that in wrong parameter values",
            got=of_certain(result),
            hint=GO_ON,
        )
