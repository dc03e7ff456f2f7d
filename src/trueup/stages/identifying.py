"""Identify: a dataset and a model in; what the model has wrong, a fitted model and a rung of the ladder out."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from trueup.core.atomic import json_hash, remove
from trueup.core.attribution import Attribution
from trueup.core.fit_result import FitResult
from trueup.core.provenance import other_versions
from trueup.core.quality import left_out
from trueup.core.ray_workers import Cluster, connected
from trueup.core.results import Ladder
from trueup.core.sole_writer import sole_writer
from trueup.core.time_limit import TimeLimit
from trueup.dataset import Dataset
from trueup.errors import OutputExists, TrueupError
from trueup.robots import RobotSpec, load_robot
from trueup.stages.fit_given import keep_given
from trueup.stages.folder import CHECKPOINTS, forget_explanation
from trueup.stages.ladder import ladder_of
from trueup.stages.measuring import Measurement, gap
from trueup.stages.motions import Motions, motions_of
from trueup.stages.progress import Track, silent
from trueup.stages.replaying import STOCK, ReplaySummary, carried_kg, kp_factors, replay_unless_same
from trueup.stages.robot_model import model_file

if TYPE_CHECKING:
    from trueup.identify import IdentifyConfig, OnModel

FITTED = "mujoco/fitted"


@dataclass(frozen=True)
class Identified:
    """What `fit` made.

    Attributes:
        fit: parameters, intervals, statements.
        replayed: the replays of the stock and of the fitted model.
        measurement: gap of both.
        ladder: command, stock, fitted.
        notes: what was left out, and what could not be done besides.
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
    ray: str | None = None,
    overwrite: bool = False,
    resume: bool = False,
    keep_gap: bool = False,
    track: Track = silent,
    on_begin: Callable[[], None] = lambda: None,
    on_progress: OnModel | None = None,
    limit: TimeLimit | None = None,
) -> Identified:
    """Estimate what the simulator has wrong, and say how sure that is.

    Fits on the train split, chooses among models on val, reports test. Writes fit.json, robot.fitted.yaml,
    model.fitted.xml, isaac.actuators.yaml, fit.samples.npz, what it was given (robot.stock.yaml, fit.config.yaml), and
    the files of `gap` and `close` for the runs `mujoco/stock` and `mujoco/fitted`. Where the robot says no
    `replay.window_s`, both runs are replayed in the windows of the fit (see `identify.judged`).

    Args:
        dataset: logs; any joint names that the robot's joint map knows.
        robot: its description.
        out: folder for the results.
        model: MJCF or URDF; looked for beside the data and in the package if None.
        config: what to fit, to what, and how; the default for the robot's controller if None.
        seed: of all draws.
        jobs: threads; the number of cores if None. On a cluster, starts at a time, too; its processors if None.
        ray: address of a Ray cluster, `local` for one on this machine, whose machines find model and `out` in the same
            folders: it takes the starts of each search, of which there are several. This process if None.
        overwrite: replace the results that are in `out`.
        resume: go on where an earlier call was interrupted; what is finished is not done again.
        keep_gap: leave the files of `gap` and the ladder that are in `out` as they are, since they are of more runs.
        track: shows progress of the replays.
        on_begin: called when the search begins: inputs and `out` are fit for it.
        on_progress: called after every iteration of every model.
        limit: when the searches have to end; see `identify.identify`.

    Raises:
        OutputExists: `out` holds results, and neither `overwrite` nor `resume` is given; or it holds a finished fit
            that was made from other inputs, and `overwrite` is not given.
        NotIdentifiable: there is nothing to learn from these motions.
        ConfigError: no cluster answers, or there is one and a single start.
        TrueupError: what any step raises.
    """
    from trueup.identify import IdentifyConfig, identify, judged, refuse_one_start, rehearse, save_identification

    out = Path(out)
    cluster = None if ray is None else Cluster(ray, jobs)
    if cluster is not None:
        refuse_one_start(config)
    with connected(ray, jobs), sole_writer(out):
        if any(out.iterdir()) and not (overwrite or resume):
            raise OutputExists(f"{out} is not empty", hint="Give --overwrite or --resume, or choose another --out.")
        checkpoints = out / CHECKPOINTS
        if overwrite and not resume:
            shutil.rmtree(checkpoints, ignore_errors=True)
        path = model_file(robot, dataset, given=model)
        jobs = jobs or os.cpu_count() or 1
        given, robot = robot, judged(robot, config)
        inputs = _digest(dataset, robot, path, config, seed)
        drop = (config or IdentifyConfig()).data.drop
        result = _finished(out, inputs) if resume and not overwrite else None
        motions = motions_of(dataset, robot)
        # Before the fit, since what keeps a replay from working must not come to light after an hour of it.
        stock = replay_unless_same(dataset, robot, model=path, label=STOCK, jobs=jobs, track=track)
        if result is None:
            rehearse(robot, path, config)
            on_begin()
            found = identify(
                motions.by_split,
                robot,
                path,
                config=config,
                jobs=jobs,
                seed=seed,
                checkpoints=checkpoints,
                data_hash=dataset.hash,
                on_progress=on_progress,
                limit=limit,
                cluster=cluster,
            )
            data = {
                **found.result.data,
                "refused": _joined(motions.refused, found.result.data["refused"]),
                "inputs": inputs,
            }
            found = replace(found, result=replace(found.result, data=data))
            save_identification(found, out, seed=seed)
            result = found.result
        keep_given(out, given, path, config)
        graybox = _save_graybox(motions, robot, path, out, drop_flagged=drop)
        fitted_robot = load_robot(out / "robot.fitted.yaml")
        # Not looked for: the dataset may hold a model of that name, too.
        own = out / fitted_robot.model
        fitted = replay_unless_same(dataset, fitted_robot, model=own, label=FITTED, jobs=jobs, track=track)
        measurement = gap(dataset, runs=[STOCK, FITTED], seed=seed, blocks=False, track=track)
        seconds = sum(row.seconds for row in result.models) + fitted.seconds
        ladder = ladder_of(measurement, {"stock": (STOCK, stock.seconds), "fitted": (FITTED, seconds)})
        if not keep_gap:
            forget_explanation(out, unless_of=None if overwrite else dataset.hash)
            measurement.save(out)
            ladder.save(out / "ladder.json")
        # Only here is nothing left that an interruption could cost.
        shutil.rmtree(checkpoints, ignore_errors=True)
        notes = (
            *stock.command_notes,
            *_left_out_notes(result),
            *_window_note(given, robot),
            *_version_note(result),
            *graybox,
        )
        notes = (*notes, *measurement.gap.settings["warnings"])
        return Identified(result, (stock, fitted), measurement, ladder, notes)


def explain_inputs(
    dataset: Dataset,
    robot: RobotSpec,
    *,
    model: Path | None,
    config: IdentifyConfig | None,
    seed: int,
    fitted: FitResult | None = None,
) -> str:
    """Hash of everything that decides about what `explain` finds.

    Raises:
        ConfigError: there is no model.
    """
    own = _digest(dataset, robot, model_file(robot, dataset, given=model), config, seed)
    return own if fitted is None else json_hash([own, fitted.values])


def _digest(dataset: Dataset, robot: RobotSpec, model: Path, config: IdentifyConfig | None, seed: int) -> str:
    """Hash of everything that decides about a fit."""
    from trueup.identify import IdentifyConfig
    from trueup.sim import MujocoSimulator

    inputs = {
        "data": dataset.hash,
        "splits": dataset.splits,
        "clean": dataset.select(drop_flagged=(config or IdentifyConfig()).data.drop),
        "robot": robot.to_dict(),
        "model": MujocoSimulator.from_robot(robot, model).fingerprint,
        "config": (config or IdentifyConfig()).to_json(),
        "seed": seed,
    }
    # What earlier versions did not know of leaves the hash alone where it is not there.
    further = {"carried_kg": carried_kg(dataset, robot), "kp_factors": kp_factors(dataset, robot)}
    return json_hash({**inputs, **{name: own for name, own in further.items() if own}})


def _finished(out: Path, inputs: str) -> FitResult | None:
    """The fit that an earlier call has finished; None if there is still one to finish.

    Raises:
        OutputExists: the earlier call has finished another one.
    """
    path = out / "fit.json"
    if not path.is_file():
        return None
    result = FitResult.load(path)
    if result.data.get("inputs") == inputs:
        return result
    if (out / CHECKPOINTS).is_dir():
        return None
    raise OutputExists(
        f"{path} was fitted to other data or splits, or with another robot, model, configuration or seed",
        hint="Give --overwrite to replace it, or choose another --out.",
    )


def _joined(*reasons: Mapping[str, Mapping[str, str]]) -> dict[str, dict[str, str]]:
    """Split -> motion -> why, of several."""
    splits = dict.fromkeys(split for item in reasons for split in item)
    return {split: {name: why for item in reasons for name, why in item.get(split, {}).items()} for split in splits}


def _left_out_notes(result: FitResult) -> list[str]:
    return left_out(_joined(result.data["flagged"], result.data["refused"]))


def _window_note(given: RobotSpec, robot: RobotSpec) -> list[str]:
    if given.replay.window_s == robot.replay.window_s:
        return []
    note = (
        f"{given.name} says no replay.window_s: models are judged, and {STOCK} and {FITTED} replayed, in windows of "
        f"{robot.replay.window_s:g} s as the fit has them; robot.fitted.yaml says so"
    )
    return [note]


def _version_note(result: FitResult) -> list[str]:
    """A fit that was kept is not made again for a version's sake, as a run is."""
    then = " and ".join(f"{name} {was}" for name, was in other_versions(result.provenance).items())
    return [f"fit.json was made by {then}; --overwrite fits anew, with what is installed now"] if then else []


def _save_graybox(
    motions: Motions, robot: RobotSpec, model: Path, out: Path, *, drop_flagged: bool | None
) -> tuple[str, ...]:
    """Write graybox.json where the logs have a torque and a commanded position that a regression can use.

    Returns:
        Why there is none, else nothing.
    """
    from trueup.identify import Nominal
    from trueup.identify.regression import GrayboxSettings, fit_graybox
    from trueup.identify.segments import usable

    remove(out / "graybox.json")
    nominal = Nominal(robot, model)
    logs, _ = usable(motions.by_split, drop_flagged=drop_flagged)
    episodes = [episode for own in logs.values() for episode in own]
    settings = GrayboxSettings(
        kp_setting=nominal.given.controller.kp_setting,
        delay_s=float(np.median(nominal.given.delay_s)),
        torque_limits=nominal.simulator.torque_limits,
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
    fitted: FitResult | None = None,
    config: IdentifyConfig | None = None,
    seed: int = 0,
    jobs: int | None = None,
    on_progress: OnModel | None = None,
    limit: TimeLimit | None = None,
) -> Attribution:
    """How much of the gap is delay, gains, friction, gravity or payload, inertia, and unexplained.

    By the numbers of a fit, or of a search of its own; see `identify.explain`.

    Raises:
        NotIdentifiable: there is nothing to learn from these motions.
        TrueupError: what any step raises.
    """
    from trueup.identify import explain as attribute

    path = model_file(robot, dataset, given=model)
    motions = motions_of(dataset, robot)
    found = attribute(
        motions.by_split,
        robot,
        path,
        fitted=fitted,
        config=config,
        jobs=jobs or os.cpu_count() or 1,
        seed=seed,
        data_hash=dataset.hash,
        on_progress=on_progress,
        limit=limit,
    )
    unused = {split: why for split, why in motions.refused.items() if split in ("train", found.split)}
    return replace(found, statements=(*left_out(unused), *found.statements))
