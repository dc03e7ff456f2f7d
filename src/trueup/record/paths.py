"""Paths in joint space from one pose to another, around what stands in the way: RRT-Connect and shortcuts.

Kuffner, LaValle: RRT-Connect, ICRA 2000; as in the LSTM thesis, section 2.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float64

from trueup.errors import ConfigError, NoPlan
from trueup.record.packages import quiet_ompl
from trueup.record.scene import Scene

# Largest change of pose between two that OMPL looks at [rad or m]; edges are proven afterwards, without gaps.
_RESOLUTION = 0.05


@dataclass(frozen=True)
class PathSettings:
    """How a path is looked for.

    Attributes:
        checks: poses that the planner may look at before it gives up. Counted, not timed, so that a loaded machine
            finds the same paths; 10,000 are about 0.1 s.
        step: longest edge of the planner's trees [rad or m].
        shortcuts: draws of two points of the path that may be joined by a straight line.

    Raises:
        ConfigError: a number that is not positive.
    """

    checks: int = 10_000
    step: float = 1.0
    shortcuts: int = 60

    def __post_init__(self) -> None:
        """Refuse settings that can find nothing."""
        for name in ("checks", "step"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name} of the planner must be positive", got=getattr(self, name))


def plan_path(
    scene: Scene,
    start: Float64[np.ndarray, "J"],
    goal: Float64[np.ndarray, "J"],
    *,
    moving: Sequence[str],
    seed: int,
    settings: PathSettings | None = None,
) -> Float64[np.ndarray, "K J"]:
    """Way points of a path free of collision; only the joints `moving` move.

    The straight line is taken if it is free: it is what shortcuts would leave of any other path. Else RRT-Connect
    searches the space of the moving joints, and shortcuts drawn from the seed straighten what it found. The same
    arguments give the same path.

    Args:
        scene: robot and obstacles.
        start: pose to begin with [rad or m].
        goal: pose to end with.
        moving: the joints that may move.
        seed: of all draws, 0 to 2^32 - 2.
        settings: how long to search.

    Returns:
        K >= 2 poses, the first `start`, the last `goal`.

    Raises:
        ConfigError: a pose out of limits, or a goal that moves another joint.
        NameMismatch: an unknown joint.
        NoPlan: a pose in collision, or no path within the planner's attempts.
    """
    settings = settings or PathSettings()
    columns = scene.limits.columns(tuple(moving))
    still = np.setdiff1d(np.arange(len(scene.joints)), columns)
    if still.size and not np.array_equal(start[still], goal[still]):
        row = int(still[np.argmax(np.abs(goal - start)[still])])
        raise ConfigError(
            f"the goal moves joint {scene.joints[row]!r}, which must not move",
            got=f"{start[row]:.4f} to {goal[row]:.4f}",
            expected=f"a motion of {list(moving)}",
        )
    scene.require_free(start, "the start")
    scene.require_free(goal, "the goal")
    if scene.edge_free(start, goal):
        return np.stack([start, goal])
    way = _search(scene, start, goal, columns, seed, settings)
    return _straightened(scene, way, np.random.default_rng(seed), settings.shortcuts)


def _search(
    scene: Scene,
    start: Float64[np.ndarray, "J"],
    goal: Float64[np.ndarray, "J"],
    columns: list[int],
    seed: int,
    settings: PathSettings,
) -> Float64[np.ndarray, "K J"]:
    looked_at = 0
    pose = start.copy()

    def valid(state: object) -> bool:
        nonlocal looked_at
        looked_at += 1
        pose[columns] = [state[row] for row in range(len(columns))]  # type: ignore[index]
        return scene.free(pose)

    with quiet_ompl(seed) as (base, geometric):
        space = base.RealVectorStateSpace(len(columns))
        bounds = base.RealVectorBounds(len(columns))
        for row, column in enumerate(columns):
            bounds.setLow(row, float(scene.limits.low[column]))
            bounds.setHigh(row, float(scene.limits.high[column]))
        space.setBounds(bounds)
        information = base.SpaceInformation(space)
        information.setStateValidityChecker(valid)
        information.setStateValidityCheckingResolution(_RESOLUTION / space.getMaximumExtent())
        information.setup()
        problem = base.ProblemDefinition(information)
        ends = space.allocState(), space.allocState()
        for state, values in zip(ends, (start, goal), strict=True):
            for row, column in enumerate(columns):
                state[row] = float(values[column])
        problem.setStartAndGoalStates(*ends)
        planner = geometric.RRTConnect(information)
        planner.setRange(settings.step)
        planner.setProblemDefinition(problem)
        planner.setup()
        planner.solve(base.PlannerTerminationCondition(lambda: looked_at >= settings.checks))
        found = []
        if problem.hasExactSolution():
            path = problem.getSolutionPath()
            for number in range(path.getStateCount()):
                found.append(start.copy())
                state = path.getState(number)
                found[-1][columns] = [state[row] for row in range(len(columns))]
        # The checker holds this frame and OMPL the checker: unhooked, nothing is left to be complained of at exit.
        information.setStateValidityChecker(lambda state: True)  # noqa: ARG005
    if not found:
        raise NoPlan(
            "no path around the obstacles was found",
            got=f"{looked_at} poses looked at",
            hint="Choose another goal, or allow the planner more checks.",
        )
    way = np.array(found)
    # The planner looks at poses along its edges; what lies between them is looked at here.
    if not all(scene.edge_free(a, b) for a, b in pairwise(way)):
        raise NoPlan("the path that was found scrapes along an obstacle", hint="Choose another goal or another seed.")
    return way


def _straightened(
    scene: Scene, way: Float64[np.ndarray, "K J"], rng: np.random.Generator, draws: int
) -> Float64[np.ndarray, "L J"]:
    """Replace parts of a path by straight lines, where these are free."""
    for _ in range(draws):
        if len(way) == 2:
            break
        lengths = np.linalg.norm(np.diff(way, axis=0), axis=1)
        ends = np.concatenate([[0.0], np.cumsum(lengths)])
        low, high = np.sort(rng.uniform(0, ends[-1], 2))
        first, last = (int(np.searchsorted(ends, value, side="right")) for value in (low, high))
        last = min(last, len(way) - 1)
        if first == last:
            continue
        a = way[first - 1] + (low - ends[first - 1]) / lengths[first - 1] * (way[first] - way[first - 1])
        b = way[last - 1] + (high - ends[last - 1]) / lengths[last - 1] * (way[last] - way[last - 1])
        if scene.edge_free(a, b):
            way = np.vstack([way[:first], a, b, way[last:]])
    return _without_needless(scene, way)


def _without_needless(scene: Scene, way: Float64[np.ndarray, "K J"]) -> Float64[np.ndarray, "L J"]:
    """From each way point straight to the farthest one that can be seen."""
    kept, row = [0], 0
    while row < len(way) - 1:
        ahead = range(len(way) - 1, row + 1, -1)
        row = next((far for far in ahead if scene.edge_free(way[row], way[far])), row + 1)
        kept.append(row)
    return way[kept]
