"""One fit of one set of parameters: a solver driven to its end, with checkpoints."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float64

from trueup.core.atomic import read_json, write_json
from trueup.core.parameters import ParameterSet
from trueup.errors import DataError
from trueup.identify.problem import Problem
from trueup.identify.solvers.gauss_newton import GaussNewton, GaussNewtonSettings, GaussNewtonState
from trueup.identify.uncertainty import noise_of

SolverName = Literal["auto", "gauss-newton", "cma-es", "evolution"]


@dataclass(frozen=True)
class Progress:
    """What a running fit says after each iteration.

    Attributes:
        phase: `start`, `gauss-newton`, …
        iteration: so far.
        rms: root mean square of the weighted residual.
        evaluations: candidates simulated so far.
        seconds: since the fit began [s].
    """

    phase: str
    iteration: int
    rms: float
    evaluations: int
    seconds: float


OnProgress = Callable[[Progress], None]


@dataclass(frozen=True)
class SolveSettings:
    """How to search.

    Attributes:
        solver: `auto` chooses and says why.
        gauss_newton: its settings.
        max_seconds: stop a search after this long [s], with the best so far; None for no limit.
        seed: of the derivative-free solvers.
    """

    solver: SolverName = "auto"
    gauss_newton: GaussNewtonSettings = field(default_factory=GaussNewtonSettings)
    max_seconds: float | None = None
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Solution:
    """Where a search ended.

    Attributes:
        parameters: with the start that was used.
        z: best parameters, (P,).
        residual: at z, (N,).
        jacobian: at z, (P, N).
        rms: root mean square of the weighted residual.
        solver: name, why, stop, iterations, evaluations, seconds.
    """

    parameters: ParameterSet
    z: Float64[np.ndarray, "P"]
    residual: Float64[np.ndarray, "N"]
    jacobian: Float64[np.ndarray, "P N"]
    rms: float
    solver: dict[str, Any]

    @property
    def values(self) -> dict[str, float]:
        """Parameter name -> value."""
        return self.parameters.values(self.z)


class Checkpoint:
    """The state of a search on disk, valid only for the same problem.

    Args:
        path: JSON file; None keeps nothing.
        fingerprint: what decides about the search; a file with another one is ignored.
    """

    def __init__(self, path: Path | None, fingerprint: str) -> None:
        self._path = path
        self._fingerprint = fingerprint

    def load(self) -> dict[str, Any]:
        """The stored state, empty if there is none that fits."""
        if self._path is None or not self._path.is_file():
            return {}
        try:
            tree = read_json(self._path)
        except DataError:
            return {}
        return tree["state"] if isinstance(tree, dict) and tree.get("fingerprint") == self._fingerprint else {}

    def save(self, state: dict[str, Any]) -> None:
        """Write the state, whole or not at all."""
        if self._path is not None:
            write_json(self._path, {"fingerprint": self._fingerprint, "state": state})


def fingerprint_of(problem: Problem, settings: SolveSettings) -> str:
    """Hash of everything that decides about a search: logs, model, parameters, weights, settings."""
    digest = hashlib.sha256(problem.nominal.simulator.fingerprint.encode())
    for segment in problem.segments:
        digest.update(segment.plan.measured["position"].tobytes())
        digest.update(np.packbits(segment.counts).tobytes())
    plain = {
        "parameters": [parameter.to_json() for parameter in problem.parameters],
        "weights": {"signals": dict(problem.weights.signals), "joints": dict(problem.weights.joints)},
        "settings": asdict(settings),
    }
    digest.update(json.dumps(plain, sort_keys=True).encode())
    return digest.hexdigest()


def solve(
    problem: Problem,
    settings: SolveSettings,
    *,
    checkpoint: Path | None = None,
    on_progress: OnProgress | None = None,
) -> Solution:
    """Drive a solver to its end.

    Args:
        problem: logs, model and parameters.
        settings: how to search.
        checkpoint: JSON file that is written after every iteration and read at the beginning; the search goes on
            from it if it belongs to the same problem.
        on_progress: called after every iteration.

    Raises:
        DataError: the start cannot be simulated.
    """
    started = time.perf_counter()
    store = Checkpoint(checkpoint, fingerprint_of(problem, settings))
    kept = store.load()
    earlier_s, earlier = float(kept.get("seconds", 0.0)), int(kept.get("evaluations", 0))
    low, high = problem.parameters.bounds
    mean, std = problem.parameters.prior
    state = (
        GaussNewtonState.from_json(kept["solver"]) if "solver" in kept else GaussNewtonState(problem.parameters.start)
    )
    search = GaussNewton(
        problem.residuals,
        low,
        high,
        state,
        prior_mean=mean,
        prior_std=std,
        prior_weight=lambda residual: noise_of(problem, residual).weight,
        settings=settings.gauss_newton,
    )

    def spent_s() -> float:
        return earlier_s + time.perf_counter() - started

    while not search.done:
        search.step()
        if settings.max_seconds is not None and spent_s() > settings.max_seconds and not search.done:
            state.reason = "time"
        evaluations = earlier + problem.evaluations
        store.save({"solver": state.to_json(), "seconds": spent_s(), "evaluations": evaluations})
        if on_progress is not None:
            on_progress(Progress("gauss-newton", state.iteration, _rms(search), evaluations, spent_s()))
    jacobian = search.final_jacobian()
    assert search.residual is not None
    return Solution(
        parameters=problem.parameters,
        z=state.z,
        residual=search.residual,
        jacobian=jacobian,
        rms=_rms(search),
        solver={
            "name": "gauss-newton",
            "stop": state.reason,
            "iterations": state.iteration,
            "evaluations": earlier + problem.evaluations,
            "seconds": round(spent_s(), 3),
        },
    )


def _rms(search: GaussNewton) -> float:
    return float(np.sqrt(np.sum(search.residual**2))) if search.residual is not None else float("nan")
