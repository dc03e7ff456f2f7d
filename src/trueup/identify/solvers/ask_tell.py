"""Solvers that are asked for candidates and told what they cost, and the loop that drives one.

A solver knows vectors and costs, nothing of robots. Whoever drives it evaluates a whole batch of candidates at
once, on as many threads as there are.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from trueup.errors import ConfigError


@dataclass(frozen=True, eq=False)
class Evaluation:
    """What C candidates cost.

    Attributes:
        cost: one number per candidate, (C,), lower is better; nan or infinite for a candidate that failed, e.g.
            because the simulation diverged. It loses, and the search goes on.
        signed: error sums of G groups (joints), (C, G), with the sign of the applied torque: positive where the
            simulation has too much friction (ES thesis 3.2.1).
        absolute: the thesis's error of every group, (C, G): sum of absolute position differences at regular
            intervals.
    """

    cost: Float[np.ndarray, "C"]
    signed: Float[np.ndarray, "C G"] | None = None
    absolute: Float[np.ndarray, "C G"] | None = None

    @property
    def failed(self) -> Bool[np.ndarray, "C"]:
        """Which candidates have no usable cost."""
        failed: Bool[np.ndarray, "C"] = ~np.isfinite(self.cost)
        return failed


StopKind = Literal["converged", "stalled", "failed", "evaluations", "time"]


@dataclass(frozen=True)
class Stop:
    """Why a search ended.

    Attributes:
        kind: `converged` (the solver's own tolerance), `stalled` (no better candidate for long), `failed` (no
            candidate could be evaluated), `evaluations` or `time` (a budget ran out).
        text: the same as a sentence, with numbers.
    """

    kind: StopKind
    text: str


@runtime_checkable
class AskTell(Protocol):
    """A derivative-free solver.

    `ask` gives the same batch until it is answered by `tell`. Between the two nothing is lost by an interruption:
    `state` describes the solver as it was after the last `tell`.
    """

    @property
    def stop(self) -> Stop | None:
        """Why the search is over, None while it is not."""
        ...

    @property
    def best(self) -> tuple[Float[np.ndarray, "P"], float]:
        """The best candidate that was evaluated, and its cost: the start and infinity while there is none."""
        ...

    @property
    def evaluations(self) -> int:
        """Number of candidates that were told, the failed ones included."""
        ...

    def ask(self) -> Float[np.ndarray, "C P"]:
        """Candidates to evaluate, all within the bounds."""
        ...

    def tell(self, z: Float[np.ndarray, "C P"], evaluation: Evaluation) -> None:
        """Answer the last `ask`, all of it and in its order."""
        ...

    def state(self) -> dict[str, Any]:
        """Everything that is needed to go on, as JSON without NaN."""
        ...

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a state of a solver that was built with the same arguments."""
        ...


@dataclass(frozen=True)
class Step:
    """Where a search stood after one batch.

    Attributes:
        evaluations: candidates evaluated so far.
        cost: best cost so far; infinite while every candidate failed.
        seconds: time spent so far [s].
    """

    evaluations: int
    cost: float
    seconds: float


@dataclass(frozen=True, eq=False)
class SolverResult:
    """The end of a search.

    Attributes:
        z: best candidate, (P,).
        cost: its cost; infinite when every candidate failed, and `z` is the start then.
        evaluations: candidates evaluated.
        stop: why it ended.
        history: one entry per batch.
    """

    z: Float[np.ndarray, "P"]
    cost: float
    evaluations: int
    stop: Stop
    history: tuple[Step, ...] = ()


def minimize(
    solver: AskTell,
    evaluate: Callable[[Float[np.ndarray, "C P"]], Evaluation],
    *,
    on_step: Callable[[Step], None] | None = None,
    max_evaluations: int | None = None,
    max_seconds: float | None = None,
    history: Sequence[Step] = (),
    clock: Callable[[], float] = time.perf_counter,
) -> SolverResult:
    """Drive a solver until it stops or a budget is spent.

    Budgets are looked at between batches: the last batch may go beyond them, and the first is always evaluated.

    Args:
        solver: new, or restored from a checkpoint; its evaluations before that count.
        evaluate: candidates (C, P) to their costs, in the same order.
        on_step: called after every batch; the place to save `solver.state()`.
        max_evaluations: stop when so many candidates were evaluated.
        max_seconds: stop after so much time, that of `history` included [s].
        history: steps before the checkpoint.
        clock: seconds from any origin.

    Raises:
        ConfigError: the evaluation does not fit the candidates.
    """
    began = clock() - (history[-1].seconds if history else 0.0)
    steps = list(history)
    while True:
        seconds, stop = clock() - began, solver.stop
        if stop is None and solver.evaluations:
            stop = _spent(solver.evaluations, seconds, max_evaluations, max_seconds)
        if stop is not None:
            break
        z = solver.ask()
        solver.tell(z, evaluate(z))
        steps.append(Step(solver.evaluations, solver.best[1], clock() - began))
        if on_step is not None:
            on_step(steps[-1])
    best, cost = solver.best
    return SolverResult(best, cost, solver.evaluations, stop, tuple(steps))


def _spent(evaluations: int, seconds: float, max_evaluations: int | None, max_seconds: float | None) -> Stop | None:
    if max_evaluations is not None and evaluations >= max_evaluations:
        return Stop("evaluations", f"{evaluations} candidates evaluated, {max_evaluations} allowed")
    if max_seconds is not None and seconds >= max_seconds:
        return Stop("time", f"{seconds:.3g} s spent, {max_seconds:.3g} s allowed")
    return None


def check_told(asked: Float[np.ndarray, "C P"] | None, told: Float[np.ndarray, "D P"], evaluation: Evaluation) -> None:
    """Refuse an answer that is not the answer to the last question.

    Raises:
        ConfigError: other candidates than asked, or not one cost (and row of errors) for each.
    """
    if asked is None or not np.array_equal(asked, told):
        raise ConfigError("a solver was told of other candidates than it asked for", hint="Call ask, then tell.")
    for name in ("cost", "signed", "absolute"):
        values = getattr(evaluation, name)
        if values is not None and len(values) != len(asked):
            raise ConfigError(f"{name} of an evaluation", got=f"{len(values)} rows", expected=f"{len(asked)}")


def check_state(state: Mapping[str, Any], setup: Mapping[str, Any], needed: Iterable[str]) -> None:
    """Refuse a checkpoint that another solver, or the same with other settings, has written.

    Args:
        state: what `state()` returned, perhaps by way of a JSON file.
        setup: what this solver's `state()["setup"]` is.
        needed: further keys that must be there.

    Raises:
        ConfigError: says which settings differ or which keys are missing.
    """
    found = state.get("setup")
    differing = [key for key, value in setup.items() if not isinstance(found, Mapping) or found.get(key) != value]
    if differing:
        raise ConfigError(
            "the checkpoint belongs to another search",
            got=f"other {', '.join(differing)}",
            hint="Start anew, or go back to the settings it was made with.",
        )
    missing = [key for key in needed if key not in state]
    if missing:
        raise ConfigError(f"the checkpoint lacks {missing}", available=state)


def finite_or_none(values: Float[np.ndarray, "N"]) -> list[float | None]:
    """Numbers for JSON, in which there is no NaN."""
    return [value if math.isfinite(value) else None for value in values.tolist()]


def from_finite_or_none(values: Iterable[float | None]) -> Float[np.ndarray, "N"]:
    """Read back what `finite_or_none` wrote; what was not finite is nan."""
    return np.array([math.nan if value is None else value for value in values], dtype=float)
