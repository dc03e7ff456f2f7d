"""Search a grid of trainings: each trial a policy in a folder of its own, all of them in one database."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trueup.augment.config import CHECKPOINT_NAME
from trueup.core.atomic import as_read_back, json_hash, left_behind, remove, write_json
from trueup.core.policy_card import PolicyCard
from trueup.core.provenance import provenance
from trueup.core.ray_workers import connected
from trueup.core.sole_writer import sole_writer
from trueup.core.spread import go_to, here, spread
from trueup.errors import DataError, Diverged, OutputExists, TrueupError, needing
from trueup.robots import RobotSpec, find_model
from trueup.stages.policy_training import policy_question, train_policy

if TYPE_CHECKING:
    from trueup.policy.config import PolicyConfig
    from trueup.policy.grid import Grid, Point
    from trueup.policy.training import Round
    from trueup.stages.grid_study import GridStudy

GRID_SCHEMA = "trueup.policy-grid/1"
GRID_FILE, STUDY_FILE, TRIALS = "grid.json", "study.db", "trials"
CURVE = ("steps", "seconds", "reward", "distance_m")


@dataclass(frozen=True)
class GridTrial:
    """What has become of one point of a grid.

    Attributes:
        point: of the grid.
        folder: of its policy.
        rounds: of its training; those before it diverged, if it did.
        reason: why it failed; nothing if it did not.
    """

    point: Point
    folder: Path
    rounds: tuple[Round, ...]
    reason: str = ""

    @property
    def best(self) -> Round | None:
        """The round whose policy was kept; None if the trial has failed."""
        return None if self.reason else max(self.rounds, key=lambda item: item.reward)

    def to_json(self) -> dict[str, Any]:
        """One entry of grid.json."""
        best = self.best
        return {
            "id": self.point.id,
            "values": dict(self.point.values),
            "state": "failed" if self.reason else "complete",
            "reason": self.reason,
            "reward": None if best is None else best.reward,
            "distance_m": None if best is None else best.distance_m,
            "curve": [[getattr(item, name) for name in CURVE] for item in self.rounds],
            "folder": f"{TRIALS}/{self.point.id}",
        }


@dataclass(frozen=True)
class GridResult:
    """What a search has found.

    Attributes:
        trials: all of them, in the order of the grid.
        folder: of the search.
    """

    trials: tuple[GridTrial, ...]
    folder: Path

    @property
    def ranking(self) -> tuple[GridTrial, ...]:
        """Trials that have not failed, the one with the highest reward first."""
        rewards = [(trial.best.reward, trial) for trial in self.trials if trial.best is not None]
        return tuple(trial for _, trial in sorted(rewards, key=lambda pair: -pair[0]))


@dataclass(frozen=True)
class _Trial:
    number: int
    point: Point
    folder: Path
    robot: RobotSpec
    model: Path
    device: str
    force: bool

    @property
    def name(self) -> str:
        return f"{self.robot.name}-{self.point.config.algorithm}-{self.point.id}"


@dataclass(frozen=True)
class _Outcome:
    rounds: tuple[Round, ...]
    reason: str = ""


def search_grid(
    robot: RobotSpec,
    out: Path | str,
    *,
    config: PolicyConfig | None = None,
    grid: Grid | None = None,
    model: Path | None = None,
    seed: int = 0,
    jobs: int | None = None,
    ray: str | None = None,
    device: str = "cpu",
    force: bool = False,
    overwrite: bool = False,
    resume: bool = False,
    on_trial: Callable[[int, int, GridTrial | None], None] = lambda *_: None,
) -> GridResult:
    """Train a policy at each point of a grid (ES thesis, 2.3), and say which is best.

    A trial depends on its values alone, not on when, where and beside which others it is trained. One that diverges is
    noted, with its reason, and not tried again.

    Args:
        robot: its description; it follows torques.
        out: folder of the search.
        config: what the grid does not say; the default if None.
        grid: its axes; the thesis's for the algorithm if None.
        model: MJCF or URDF; looked for beside the description and in the package if None.
        seed: of all draws, where no axis says it.
        jobs: trials at a time, of one thread each; the number of cores, of the cluster if there is one, if None.
        ray: address of a Ray cluster, or `local`; `out` is on a file system that its machines share.
        device: of the networks, `cpu` or `cuda`.
        force: randomize by an identification whose status is not ok, too.
        overwrite: replace the search in `out`.
        resume: go on where an earlier call was interrupted: what is finished is not trained again.
        on_trial: told how many of how many trials have ended, and the best so far.

    Raises:
        OutputExists: `out` is not empty, or holds another search.
        ConfigError: a point that makes no configuration, or one whose networks are not those of the policy that it
            begins with, a robot that follows no torques, no such cluster, or a worker process was killed.
        DataError: a trial could not be trained for want of disk or by a broken file, or all of them diverged.
        MissingDependency: Stable-Baselines3, Optuna or Ray is not installed.
    """
    with needing("searching a grid", "rl"):
        from trueup.augment.training import find_device
        from trueup.policy.config import PolicyConfig
        from trueup.policy.grid import THESIS
        from trueup.policy.learned import read_learned
        from trueup.policy.simulated import simulated
        from trueup.stages.grid_study import GridStudy

    config, out = config or PolicyConfig(), Path(out).absolute()
    grid = grid or THESIS[config.algorithm]
    points = grid.points(config, seed)
    path = find_model(robot, given=model).absolute()
    simulated(config, robot, path, count=1, force=force)  # refuses what every trial would
    for point in points:
        read_learned(point.config, robot.joint_names)  # refuses what one trial would, hours later
    if ray is None:
        find_device(device)  # likewise; what a cluster has, its machines know
    axes = {axis.title: [list(row) for row in axis.rows] for axis in grid.axes}
    asked = json_hash({"policy": policy_question(robot, path, config, name="", seed=seed), "axes": axes})
    with connected(ray, jobs), sole_writer(out):
        _prepare(out, overwrite=overwrite, resume=resume)
        if overwrite:
            _clear(out)
        study = GridStudy(out / STUDY_FILE, asked, grid, points)
        try:
            made = partial(_Trial, robot=robot, model=path, device=device, force=force)
            trials = (made(number, point, out / TRIALS / point.id) for number, point in _asked(study))
            _search(study, points, out, _ended(trials, jobs, ray, gpus=int(device != "cpu")), on_trial)
            found = _result(study, points, out)
        finally:
            study.close()
        _save(found, config, axes, seed)
    if not found.ranking:
        raise DataError("every trial of the grid has diverged", got=f"{len(found.trials)}", hint="Lower learner.rate.")
    return found


def _prepare(out: Path, *, overwrite: bool, resume: bool) -> None:
    for left in (*left_behind(out / STUDY_FILE), *left_behind(out / GRID_FILE)):
        remove(left)
    there = {file.name for file in out.iterdir()}
    if there and not (overwrite or resume):
        raise OutputExists(f"{out} is not empty", hint="Give --overwrite or --resume, or choose another --out.")
    if there - {GRID_FILE, STUDY_FILE, f"{STUDY_FILE}-journal", TRIALS} and STUDY_FILE not in there:
        raise OutputExists(f"{out} holds something else than a grid", hint="Choose another --out.")


def _clear(out: Path) -> None:
    """The database first: without it, nothing takes what is left of the others for a search."""
    for name in (STUDY_FILE, f"{STUDY_FILE}-journal", GRID_FILE):
        remove(out / name)
    for folder in (out / TRIALS).glob("*"):
        if re.fullmatch("[0-9a-f]{12}", folder.name):  # no name that a person gives
            shutil.rmtree(folder, ignore_errors=True)


def _asked(study: GridStudy) -> Iterator[tuple[int, Point]]:
    yield from study.under_way()
    while (asked := study.ask()) is not None:
        yield asked


def _ended(
    trials: Iterable[_Trial], jobs: int | None, ray: str | None, *, gpus: int
) -> Iterator[tuple[_Trial, _Outcome]]:
    return spread(_train, trials, jobs=jobs, ray=ray, gpus=gpus, begin=go_to, with_args=here())


def _search(
    study: GridStudy,
    points: Sequence[Point],
    out: Path,
    ended: Iterator[tuple[_Trial, _Outcome]],
    on_trial: Callable[[int, int, GridTrial | None], None],
) -> None:
    def say() -> None:
        found = _result(study, points, out)
        on_trial(len(found.trials), len(points), found.ranking[0] if found.ranking else None)

    say()
    for trial, outcome in ended:
        if not outcome.reason:
            _look(trial)
        study.tell(trial.number, outcome.rounds, outcome.reason)
        say()


def _look(trial: _Trial) -> None:
    """What was trained elsewhere is to be found here.

    Raises:
        DataError: it is not.
    """
    try:
        PolicyCard.load(trial.folder)
    except DataError as error:
        raise DataError(
            f"what was trained is not in {trial.folder}",
            got=error.summary,
            hint="--out must be on a file system that all machines of the Ray cluster share, under the same path.",
        ) from error


def _result(study: GridStudy, points: Sequence[Point], out: Path) -> GridResult:
    told = study.told()
    trials = (GridTrial(point, out / TRIALS / point.id, *told[point.id]) for point in points if point.id in told)
    return GridResult(tuple(trials), out)


def _save(found: GridResult, config: PolicyConfig, axes: Mapping[str, Any], seed: int) -> None:
    write_json(
        found.folder / GRID_FILE,
        {
            "schema": GRID_SCHEMA,
            "algorithm": config.algorithm,
            "axes": axes,
            "curve": list(CURVE),
            "trials": [trial.to_json() for trial in found.trials],
            "best": found.ranking[0].point.id if found.ranking else None,
            "provenance": provenance(config=as_read_back(asdict(config)), seed=seed),
        },
    )


def _train(trial: _Trial) -> _Outcome:
    from trueup.policy.training import rounds_of

    try:
        made = train_policy(
            trial.robot,
            trial.folder,
            config=trial.point.config,
            model=trial.model,
            name=trial.name,
            seed=trial.point.seed,
            jobs=1,
            device=trial.device,
            force=trial.force,
            resume=True,
        )
    except Diverged as error:
        checkpoint = trial.folder / CHECKPOINT_NAME
        asked = policy_question(trial.robot, trial.model, trial.point.config, name=trial.name, seed=trial.point.seed)
        rounds = rounds_of(checkpoint, asked)
        remove(checkpoint)
        return _Outcome(rounds, error.summary)
    except (TrueupError, OSError) as error:
        raise DataError(
            f"trial {trial.point.id}",
            got=error.summary if isinstance(error, TrueupError) else error.strerror or str(error),
            hint="Trials are kept: free space, or remove the folder of this one if it is broken, and give the same "
            "command with --resume.",
        ) from error
    return _Outcome(made.history)
