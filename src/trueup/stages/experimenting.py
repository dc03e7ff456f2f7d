"""Experiments: recordings of a breakaway, of constant torques or of coasting in; thresholds and friction out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from trueup.core.provenance import provenance
from trueup.dataset import Dataset
from trueup.robots import RobotSpec
from trueup.stages.identifying import by_split

if TYPE_CHECKING:
    from trueup.identify.experiments import ExperimentResult

ExperimentName = Literal["breakaway", "constant-torque", "coast"]


def experiment(
    dataset: Dataset,
    robot: RobotSpec,
    kind: ExperimentName,
    *,
    joints: Sequence[str] | None = None,
    breakaway: Path | None = None,
) -> ExperimentResult:
    """Evaluate recordings of an experiment that isolates one thing.

    Args:
        dataset: recordings with commanded torque; splits do not matter.
        robot: its description.
        kind: which experiment was recorded.
        joints: joints to look at; those that were driven if None.
        breakaway: result of a breakaway experiment on the same robot, which splits offset from asymmetry.

    Raises:
        NotIdentifiable: the recordings do not determine anything.
        MissingSignal: there is no commanded torque.
    """
    from trueup.identify.experiments import (
        ExperimentResult,
        estimate_breakaway,
        estimate_coast,
        estimate_constant_torque,
    )

    episodes = [episode for logs in by_split(dataset, robot).values() for episode in logs]
    match kind:
        case "breakaway":
            found = estimate_breakaway(episodes, joints=joints)
        case "constant-torque":
            before = ExperimentResult.load(breakaway) if breakaway else None
            found = estimate_constant_torque(episodes, joints=joints, breakaway=before)
        case "coast":
            found = estimate_coast(episodes, joints=joints)
    return ExperimentResult(
        experiment=found.experiment,
        joints=found.joints,
        notes=found.notes,
        runs=found.runs,
        rejected=found.rejected,
        settings=found.settings,
        provenance=provenance(config={"robot": robot.to_dict(), "experiment": kind}, data_hash=dataset.hash),
    )
