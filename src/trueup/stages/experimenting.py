"""Experiments: recordings of a breakaway, of constant torques or of coasting in; thresholds and friction out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from trueup.core.provenance import provenance
from trueup.dataset import Dataset
from trueup.robots import RobotSpec
from trueup.stages.motions import readable

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
    delay_s: float | None = None,
) -> ExperimentResult:
    """Evaluate recordings of an experiment that isolates one thing.

    Args:
        dataset: recordings with commanded torque; splits do not matter. Those that cannot be brought into the robot's
            names, or command no torque, are rejected if others can be used.
        robot: its description.
        kind: which experiment was recorded.
        joints: joints to look at; those that were driven if None.
        breakaway: result of a breakaway experiment on the same robot, which splits offset from asymmetry.
        delay_s: the commanded torque acts this much later [s]; the robot's own, joint by joint, if None.

    Raises:
        NotIdentifiable: the recordings do not determine anything.
        MissingSignal: no recording has a commanded torque.
        NameMismatch: the joints of the recordings are not the robot's.
        DataError: there are no recordings.
    """
    from trueup.identify.experiments import (
        ExperimentResult,
        Rejection,
        SlideSettings,
        estimate_breakaway,
        estimate_coast,
        estimate_constant_torque,
    )

    episodes, refused = readable(dataset, robot, dataset.ids, "torque")
    if refused and not episodes:
        raise next(iter(refused.values()))
    own_s = dict(zip(robot.joint_names, robot.delay_s, strict=True))
    delay = own_s if delay_s is None else dict.fromkeys(own_s, delay_s)
    settings = SlideSettings(delay_s=delay)
    match kind:
        case "breakaway":
            found = estimate_breakaway(episodes, joints=joints, delay_s=delay)
        case "constant-torque":
            before = ExperimentResult.load(breakaway) if breakaway else None
            found = estimate_constant_torque(episodes, joints=joints, breakaway=before, settings=settings)
        case "coast":
            found = estimate_coast(episodes, joints=joints, settings=settings)
    rejected = (Rejection(name, "", error.summary) for name, error in refused.items())
    return replace(
        found,
        rejected=(*rejected, *found.rejected),
        provenance=provenance(config={"robot": robot.to_dict(), "experiment": kind}, data_hash=dataset.hash),
    )
