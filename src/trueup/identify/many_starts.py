"""Searches from several starts, one after the other or side by side on a Ray cluster."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from trueup.core.parameters import ParameterSet
from trueup.core.ray_workers import Cluster, on_ray, refuse_other_model
from trueup.core.time_limit import TimeLimit
from trueup.errors import DataError
from trueup.identify.candidate import Nominal
from trueup.identify.phases import search_from
from trueup.identify.problem import Problem, Weights
from trueup.identify.search import Stopwatch, space_of
from trueup.identify.segments import Segment
from trueup.identify.solution import OnProgress, Progress, Solution, SolveSettings
from trueup.identify.solvers import compare_ends, draw_starts
from trueup.identify.window_starts import WindowStarts
from trueup.robots import RobotSpec

# Half a unit of z around the start: far enough to leave a dent, near enough to be simulated.
_SPREAD = 0.5


@dataclass(frozen=True, eq=False)
class _Start:
    """Where one search begins, and how long it may take [s]."""

    number: int
    parameters: ParameterSet
    left_s: float | None


@dataclass(frozen=True, eq=False)
class _Ended:
    """Where it ended, None if it could not be simulated, and candidates that it took."""

    number: int
    solution: Solution | None
    evaluations: int

    @property
    def cost(self) -> float:
        """Sum of the squares of its residual; infinite without one."""
        return np.inf if self.solution is None else float(self.solution.residual @ self.solution.residual)


@dataclass(frozen=True, eq=False)
class _Sent:
    """A problem on its way to another machine, which compiles the model anew."""

    robot: RobotSpec
    model: Path
    model_sha256: str
    hard_friction: bool
    parameters: ParameterSet
    segments: tuple[Segment, ...]
    weights: Weights
    starts: Mapping[Segment, WindowStarts]
    trapezoidal: bool
    coarse: _Sent | None

    @staticmethod
    def of(problem: Problem) -> _Sent:
        nominal = problem.nominal
        return _Sent(
            nominal.given,
            nominal.path.absolute(),
            nominal.simulator.fingerprint,
            nominal.hard_friction,
            problem.parameters,
            problem.segments,
            problem.weights,
            problem.starts,
            problem.trapezoidal,
            None if problem.coarse is None else _Sent.of(problem.coarse),
        )

    def problem(self) -> Problem:
        nominal = Nominal(self.robot, self.model, hard_friction=self.hard_friction)
        refuse_other_model(self.model, nominal.simulator.fingerprint, self.model_sha256)
        coarse = None if self.coarse is None else self.coarse.problem()
        return Problem(
            nominal,
            self.parameters,
            self.segments,
            weights=self.weights,
            coarse=coarse,
            starts=self.starts,
            trapezoidal=self.trapezoidal,
        )


@dataclass(frozen=True, eq=False)
class _Given:
    """What all starts share."""

    problem: _Sent
    settings: SolveSettings
    checkpoint: Path | None


def from_many_starts(
    problem: Problem,
    settings: SolveSettings,
    *,
    checkpoint: Path | None,
    on_progress: OnProgress | None,
    limit: TimeLimit | None,
    cluster: Cluster | None,
) -> Solution:
    """The best of several searches, each with checkpoints of its own, and whether they agree.

    A search depends on its start alone, so that it ends in the same place wherever it is done.

    Args:
        problem: logs, model and parameters.
        settings: how to search, and from how many starts.
        checkpoint: as of `solve`; on a cluster, in a folder that its machines share.
        on_progress: called after every iteration; on a cluster, after every start.
        limit: when all of them have to end.
        cluster: where they are searched from; here, one after the other, if None.

    Raises:
        DataError: none of the starts can be simulated.
        ConfigError: there is no such cluster, or a worker of it was killed again and again, or has another model or
            MuJoCo.
    """
    clock = Stopwatch()
    ends = draw_starts(space_of(problem), settings.starts, spread=_SPREAD, seed=settings.seed)
    starts = (
        _Start(
            number,
            problem.parameters.at(problem.parameters.values(start)),
            None if limit is None else limit.left_s,
        )
        for number, start in enumerate(ends)
    )
    found: list[_Ended] = []
    for end in _ended(starts, problem, settings, checkpoint, on_progress, cluster):
        found.append(end)
        if cluster is not None and on_progress is not None:
            on_progress(_progress(found, clock))
    found.sort(key=lambda end: end.number)
    problem.evaluations += sum(end.evaluations for end in found)
    return _best(problem, ends, found)


def _best(problem: Problem, starts: Float64[np.ndarray, "S P"], found: Sequence[_Ended]) -> Solution:
    """The one whose residual is smallest, with what is to be said of all.

    Raises:
        DataError: there is none.
    """
    ends = np.array(
        [start if end.solution is None else end.solution.z for start, end in zip(starts, found, strict=True)]
    )
    costs = np.array([end.cost for end in found])
    best = found[int(np.argmin(np.where(np.isfinite(costs), costs, np.inf)))].solution
    if best is None:
        raise DataError("the model cannot be simulated from any of the starts", got=f"{len(found)} starts")
    agreement = compare_ends(space_of(problem), ends, costs, cost_tolerance=0.01, place_tolerance=0.1)
    seconds = round(sum(float(end.solution.solver["seconds"]) for end in found if end.solution is not None), 3)
    told = {"starts": agreement.text, "agreement": agreement.verdict}
    solver = {**best.solver, "seconds": seconds, "evaluations": problem.evaluations, **told}
    return replace(best, solver=solver, agreement=agreement)


def _ended(
    starts: Iterable[_Start],
    problem: Problem,
    settings: SolveSettings,
    checkpoint: Path | None,
    on_progress: OnProgress | None,
    cluster: Cluster | None,
) -> Iterator[_Ended]:
    """The searches as they end."""
    if cluster is None:
        for start in starts:
            yield _searched(start, problem, settings, checkpoint, on_progress)
        return
    given = _Given(_Sent.of(problem), settings, None if checkpoint is None else checkpoint.absolute())
    ended = on_ray(
        _searched_there, starts, address=cluster.address, jobs=cluster.jobs, begin=_begin, with_args=(given,)
    )
    for _, end in ended:
        yield end


def _searched(
    start: _Start,
    problem: Problem,
    settings: SolveSettings,
    checkpoint: Path | None,
    on_progress: OnProgress | None = None,
) -> _Ended:
    moved = problem.with_parameters(start.parameters)
    moved.evaluations = 0
    path = None if checkpoint is None else checkpoint.with_name(f"{checkpoint.stem}.start{start.number}.json")
    limit = None if start.left_s is None else TimeLimit.after(start.left_s)
    try:
        solution = search_from(moved, settings, checkpoint=path, on_progress=on_progress, limit=limit)
    except DataError:
        return _Ended(start.number, None, moved.evaluations)
    return _Ended(start.number, solution, moved.evaluations)


def _progress(found: Sequence[_Ended], clock: Stopwatch) -> Progress:
    """What can be said while searches are under way elsewhere."""
    rms = min((end.solution.rms for end in found if end.solution is not None), default=np.inf)
    return Progress("starts that have ended", len(found), rms, sum(end.evaluations for end in found), clock.seconds)


# The problem of the searches that this process of a cluster works on.
_there: list[tuple[_Given, Problem]] = []


def _begin(given: _Given) -> None:
    _there[:] = [(given, given.problem.problem())]


def _searched_there(start: _Start) -> _Ended:
    ((given, problem),) = _there
    return _searched(start, problem, given.settings, given.checkpoint)
