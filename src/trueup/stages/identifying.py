"""Identify: a dataset and a model in; what the model has wrong, a fitted model and a rung of the ladder out."""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from trueup.align import JointMap
from trueup.core.atomic import make_folder
from trueup.core.attribution import Attribution
from trueup.core.episode import Episode
from trueup.core.fit_result import FitResult
from trueup.core.results import Ladder
from trueup.dataset import Dataset
from trueup.errors import DataError, MissingSignal, OutputExists, TrueupError
from trueup.robots import RobotSpec, find_model, load_robot
from trueup.stages.ladder import ladder_of
from trueup.stages.measuring import Measurement, gap
from trueup.stages.progress import Track, silent
from trueup.stages.replaying import STOCK, ReplaySummary, in_robot_names, replay_unless_same

if TYPE_CHECKING:
    from trueup.identify import IdentifyConfig, Nominal, OnModel

FITTED = "mujoco/fitted"
# State of the searches while they run; gone when the fit is written.
_CHECKPOINTS = "checkpoints"


@dataclass(frozen=True)
class Identified:
    """What `fit` made.

    Attributes:
        fit: parameters, intervals, statements.
        replayed: the replays of the stock and of the fitted model.
        measurement: gap of both.
        ladder: command, stock, fitted.
        notes: what could not be done besides.
    """

    fit: FitResult
    replayed: tuple[ReplaySummary, ReplaySummary]
    measurement: Measurement
    ladder: Ladder
    notes: tuple[str, ...] = ()


def fit(
    dataset: Dataset,
    robot: RobotSpec,
    out: Path | str,
    *,
    model: Path | None = None,
    config: IdentifyConfig | None = None,
    seed: int = 0,
    jobs: int | None = None,
    overwrite: bool = False,
    resume: bool = False,
    track: Track = silent,
    on_progress: OnModel | None = None,
) -> Identified:
    """Estimate what the simulator has wrong, and say how sure that is.

    Fits on the train split, chooses among models on val, reports test. Writes fit.json, robot.fitted.yaml,
    model.fitted.xml, isaac.actuators.yaml, fit.samples.npz, and the files of `gap` and `close` for the runs
    `mujoco/stock` and `mujoco/fitted`.

    Args:
        dataset: logs; any joint names that the robot's joint map knows.
        robot: its description.
        out: folder for the results.
        model: MJCF or URDF; looked for beside the data and in the package if None.
        config: what to fit, to what, and how; the default for the robot's controller if None.
        seed: of all draws.
        jobs: threads; the number of cores if None.
        overwrite: replace the results that are in `out`.
        resume: go on where an earlier call was interrupted.
        track: shows progress of the replays.
        on_progress: called after every iteration of every model.

    Raises:
        OutputExists: `out` holds results, and neither `overwrite` nor `resume` is given.
        NotIdentifiable: there is nothing to learn from these motions.
        TrueupError: what any step raises.
    """
    from trueup.identify import identify as fit_robot
    from trueup.identify import save_identification

    out = Path(out)
    make_folder(out)
    if any(out.iterdir()) and not (overwrite or resume):
        raise OutputExists(f"{out} is not empty", hint="Give --overwrite or --resume, or choose another --out.")
    checkpoints = out / _CHECKPOINTS
    if overwrite and not resume:
        shutil.rmtree(checkpoints, ignore_errors=True)
    path = find_model(robot, given=model, folder=dataset.info.model_path(dataset.path) or dataset.path / "model")
    jobs = jobs or os.cpu_count() or 1
    found = fit_robot(
        by_split(dataset, robot),
        robot,
        path,
        config=config,
        jobs=jobs,
        seed=seed,
        checkpoints=checkpoints,
        data_hash=dataset.hash,
        on_progress=on_progress,
    )
    save_identification(found, out, seed=seed)
    notes = _save_graybox(dataset, robot, found.nominal, out)
    shutil.rmtree(checkpoints, ignore_errors=True)
    stock = replay_unless_same(dataset, robot, model=path, label=STOCK, jobs=jobs, track=track)
    fitted_robot = load_robot(out / "robot.fitted.yaml")
    fitted = replay_unless_same(dataset, fitted_robot, model=None, label=FITTED, jobs=jobs, track=track)
    measurement = gap(dataset, runs=[STOCK, FITTED], seed=seed, track=track)
    seconds = sum(row.seconds for row in found.result.models) + fitted.seconds
    ladder = ladder_of(measurement, {"stock": (STOCK, stock.seconds), "fitted": (FITTED, seconds)})
    measurement.save(out)
    ladder.save(out / "ladder.json")
    return Identified(found.result, (stock, fitted), measurement, ladder, notes)


def _save_graybox(dataset: Dataset, robot: RobotSpec, nominal: Nominal, out: Path) -> tuple[str, ...]:
    """Write graybox.json where the logs have a torque and a commanded position that a regression can use.

    Returns:
        Why there is none, else nothing.
    """
    from trueup.identify.regression import GrayboxSettings, fit_graybox

    (out / "graybox.json").unlink(missing_ok=True)
    episodes = [episode for logs in by_split(dataset, robot).values() for episode in logs]
    settings = GrayboxSettings(
        delay_s=float(np.median(nominal.given.delay_s)), torque_limits=nominal.simulator.torque_limits
    )
    try:
        graybox = fit_graybox(episodes, settings=settings, joints=robot.scored_joints)
    except TrueupError as error:  # no torque, or torque-driven: there is no servo to take apart
        return (f"no gray-box regression: {error.what}",)
    if not any(joint.final is not None for joint in graybox.joints.values()):
        why = next((note for joint in graybox.joints.values() for note in joint.notes), "no joint can be used")
        return (f"no gray-box regression: {why}",)
    graybox.save(out / "graybox.json")
    return ()


def explain(
    dataset: Dataset,
    robot: RobotSpec,
    *,
    model: Path | None = None,
    config: IdentifyConfig | None = None,
    seed: int = 0,
    jobs: int | None = None,
    on_progress: OnModel | None = None,
) -> Attribution:
    """How much of the gap is delay, gains, friction, gravity or payload, inertia, and unexplained.

    Nested fits on train, scored on test; see `identify.explain`.

    Raises:
        NotIdentifiable: there is nothing to learn from these motions.
        TrueupError: what any step raises.
    """
    from trueup.identify import explain as attribute

    path = find_model(robot, given=model, folder=dataset.info.model_path(dataset.path) or dataset.path / "model")
    return attribute(
        by_split(dataset, robot),
        robot,
        path,
        config=config,
        jobs=jobs or os.cpu_count() or 1,
        seed=seed,
        data_hash=dataset.hash,
        on_progress=on_progress,
    )


def by_split(dataset: Dataset, robot: RobotSpec) -> dict[str, list[Episode]]:
    """The motions of a dataset in the robot's names, by split; without any split all are `train`.

    A motion that cannot be brought into the robot's names is left out if others can.

    Raises:
        NameMismatch: the joints of the log are not the robot's.
        DataError: no motion is usable.
    """
    joint_map = JointMap.from_dict(robot.joint_rules())
    assigned = dict(dataset.splits)
    if not any(assigned.values()):
        assigned = dict.fromkeys(dataset.ids, "train")
    if "train" not in assigned.values():
        raise MissingSignal("the dataset has no train split to fit", available=sorted(set(assigned.values())))
    found: dict[str, list[Episode]] = {}
    refused: list[TrueupError] = []
    for name in dataset.ids:
        split = assigned.get(name, "")
        if not split:
            continue
        try:
            episode = in_robot_names(dataset.episode(name), joint_map)
            episode.commanded()
        except TrueupError as error:
            refused.append(error)
            continue
        found.setdefault(split, []).append(episode)
    if refused and not found.get("train"):
        raise refused[0]
    if not found:
        raise DataError("the dataset has no episode in a split")
    return found
