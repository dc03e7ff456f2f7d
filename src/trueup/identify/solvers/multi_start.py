"""Several starts, and whether the searches from them end in one place."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float

from trueup.errors import ConfigError, TrueupError
from trueup.identify.solvers.ask_tell import SolverResult, Stop, check_state
from trueup.identify.solvers.space import Space

Verdict = Literal["agree", "not-unique", "local-minima", "single", "failed"]


@dataclass(frozen=True, eq=False)
class LocalSolution:
    """Where the search from one start ended.

    Attributes:
        start: (P,).
        z: best point, (P,).
        cost: its cost, infinite when the search failed.
        evaluations: candidates evaluated.
        stop: why it ended.
    """

    start: Float[np.ndarray, "P"]
    z: Float[np.ndarray, "P"]
    cost: float
    evaluations: int
    stop: Stop

    def to_json(self) -> dict[str, Any]:
        """JSON object."""
        return {
            "start": self.start.tolist(),
            "z": self.z.tolist(),
            "cost": self.cost if math.isfinite(self.cost) else None,
            "evaluations": self.evaluations,
            "stop": {"kind": self.stop.kind, "text": self.stop.text},
        }

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> LocalSolution:
        """Read back what `to_json` wrote."""
        return LocalSolution(
            np.array(data["start"], dtype=float),
            np.array(data["z"], dtype=float),
            math.inf if data["cost"] is None else float(data["cost"]),
            int(data["evaluations"]),
            Stop(**data["stop"]),
        )


@dataclass(frozen=True, eq=False)
class Agreement:
    """Do the searches from different starts end in one place?

    Attributes:
        verdict: `agree` (at least two end where the best does, and none finds an equally good place elsewhere);
            `not-unique` (as good elsewhere: the data do not determine some parameters); `local-minima` (the best
            stands alone and the others are worse); `single` (only one start succeeded); `failed` (none did).
        same: solutions at the best place, the best included.
        elsewhere: solutions as good at other places.
        worse: solutions that cost more.
        failed: searches without a result.
        spread: largest difference among all solutions as good as the best, in typical scales, (P,).
        text: the same as a sentence.
    """

    verdict: Verdict
    same: int
    elsewhere: int
    worse: int
    failed: int
    spread: Float[np.ndarray, "P"]
    text: str


@dataclass(frozen=True, eq=False)
class MultiStartResult:
    """All local solutions, in the order of their starts.

    Attributes:
        solutions: one per start.
        best: the cheapest of them (the first, if all failed).
        agreement: whether the starts agree.
    """

    solutions: tuple[LocalSolution, ...]
    best: LocalSolution
    agreement: Agreement


class MultiStart:
    """Run a local solver from several starts, one after another.

    What a search from one start needs is its start alone, so that a run resumed after some of them is the
    uninterrupted one.

    Args:
        space: bounds and typical scale.
        starts: (C, P), e.g. from `draw_starts`.
    """

    def __init__(self, space: Space, starts: Float[np.ndarray, "C P"]) -> None:
        if starts.ndim != 2 or starts.shape[1] != space.size or not len(starts):
            raise ConfigError("starts", got=starts.shape, expected=f"(at least 1, {space.size})")
        if not np.array_equal(starts, space.clip(starts)):
            raise ConfigError("starts must lie within the bounds")
        self._space = space
        self._starts = starts
        self._solutions: list[LocalSolution] = []

    @property
    def solutions(self) -> tuple[LocalSolution, ...]:
        """Those that are done."""
        return tuple(self._solutions)

    def run(
        self,
        solve: Callable[[Float[np.ndarray, "P"]], SolverResult],
        *,
        on_solution: Callable[[LocalSolution], None] | None = None,
        cost_tolerance: float = 0.01,
        place_tolerance: float = 0.05,
    ) -> MultiStartResult:
        """Search from every start that is not done yet.

        Args:
            solve: local solver, from a start (P,) to its result. An error of trueup counts as a failed start.
            on_solution: called after every start; the place to save `state()`.
            cost_tolerance: a solution is as good as the best when it costs at most this share more.
            place_tolerance: two solutions are at one place when no parameter differs by more typical scales.
        """
        for start in self._starts[len(self._solutions) :]:
            try:
                found = solve(start.copy())
                cost = found.cost if math.isfinite(found.cost) else math.inf
                solution = LocalSolution(start, found.z, cost, found.evaluations, found.stop)
            except TrueupError as error:
                solution = LocalSolution(start, start, math.inf, 0, Stop("failed", str(error)))
            self._solutions.append(solution)
            if on_solution is not None:
                on_solution(solution)
        best = min(self._solutions, key=lambda solution: solution.cost)
        agreement = compare_solutions(
            self._space, self.solutions, cost_tolerance=cost_tolerance, place_tolerance=place_tolerance
        )
        return MultiStartResult(self.solutions, best, agreement)

    def _setup(self) -> dict[str, Any]:
        return {"solver": "multi-start", "space": self._space.to_json(), "starts": self._starts.tolist()}

    def state(self) -> dict[str, Any]:
        """The solutions so far."""
        return {"setup": self._setup(), "solutions": [solution.to_json() for solution in self._solutions]}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on after the solutions of a state.

        Raises:
            ConfigError: it belongs to other starts or another space.
        """
        check_state(state, self._setup(), ("solutions",))
        self._solutions = [LocalSolution.from_json(item) for item in state["solutions"]]


def compare_solutions(
    space: Space, solutions: Sequence[LocalSolution], *, cost_tolerance: float, place_tolerance: float
) -> Agreement:
    """Sort solutions into those at the best place, those as good elsewhere, and those that are worse."""
    good = [solution for solution in solutions if math.isfinite(solution.cost)]
    failed = len(solutions) - len(good)
    if not good:
        return Agreement("failed", 0, 0, 0, failed, np.full(space.size, math.nan), "no start led to a result")
    z = np.array([solution.z for solution in good])
    cost = np.array([solution.cost for solution in good])
    best = int(np.argmin(cost))
    same: Bool[np.ndarray, "C"] = (np.abs(z - z[best]) <= place_tolerance * space.scale).all(axis=1)
    as_good = same | (cost <= cost[best] + cost_tolerance * abs(cost[best]))
    spread = np.ptp(z[as_good], axis=0) / space.scale
    counts = int(same.sum()), int((as_good & ~same).sum()), int((~as_good).sum())
    loose = [space.names[index] for index in np.flatnonzero(spread > place_tolerance)]
    verdict: Verdict
    if len(good) == 1:
        verdict, text = "single", "only one start led to a result: nothing to compare it with"
    elif counts[1]:
        verdict = "not-unique"
        text = f"{counts[1]} of {len(good)} starts end as good elsewhere: {', '.join(loose)} not determined by the data"
    elif counts[0] > 1:
        verdict, text = "agree", f"{counts[0]} of {len(good)} starts end in the same best place"
    else:
        verdict, text = "local-minima", f"the other {len(good) - 1} starts end in worse places; try more starts"
    return Agreement(verdict, *counts, failed, spread, text)
