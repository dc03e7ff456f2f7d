"""One fit of one set of parameters: a solver driven to its end, with checkpoints."""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, astuple, dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float64

from trueup.core.atomic import as_read_back, json_hash, read_json, write_json
from trueup.core.parameters import ParameterSet
from trueup.errors import ConfigError, DataError
from trueup.identify.problem import Problem
from trueup.identify.segments import Segment
from trueup.identify.solvers import Agreement, GaussNewtonSettings

# A delay lets commands act that were given before the motion begins.
_EARLIER_S = 1.0

SolverName = Literal["auto", "gauss-newton", "cma-es", "evolution"]


@dataclass(frozen=True)
class Progress:
    """What a running fit says after each iteration.

    Attributes:
        phase: `start`, `gauss-newton`, …
        iteration: so far.
        rms: root mean square of the weighted residual at the best place so far.
        evaluations: candidates simulated so far.
        seconds: since the fit began [s].
    """

    phase: str
    iteration: int
    rms: float
    evaluations: int
    seconds: float


OnProgress = Callable[[Progress], None]
# Name of the model, then how its search goes on.
OnModel = Callable[[str, Progress], None]


@dataclass(frozen=True)
class SolveSettings:
    """How to search.

    Attributes:
        solver: `auto` chooses and says why.
        gauss_newton: its settings.
        max_evaluations: of the derivative-free solvers.
        max_seconds: stop a search after this long [s], with the best so far; None for no limit. Each start has as
            long.
        starts: searches from so many places; the best one counts, and whether the others agree is said.
        seed: of the derivative-free solvers and the starts.
    """

    solver: SolverName = "auto"
    gauss_newton: GaussNewtonSettings = field(default_factory=GaussNewtonSettings)
    max_evaluations: int = 4000
    max_seconds: float | None = None
    starts: int = 1
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Solution:
    """Where a search ended.

    Attributes:
        parameters: with the start that was used.
        z: best parameters, (P,).
        residual: at z, (N,); under a robust loss, that of the least-squares fit that is as certain.
        jacobian: at z, (P, N), likewise.
        rms: root mean square of the weighted residual, outliers included.
        solver: name, stop (`converged`, or what ended it early), iterations, evaluations, seconds, and remarks.
        agreement: whether searches from other starts end here, too; None if there was one start.
    """

    parameters: ParameterSet
    z: Float64[np.ndarray, "P"]
    residual: Float64[np.ndarray, "N"]
    jacobian: Float64[np.ndarray, "P N"]
    rms: float
    solver: dict[str, Any]
    agreement: Agreement | None = None

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
        """The stored state, empty if there is none that fits, or not as it was written."""
        if self._path is None or not self._path.is_file():
            return {}
        try:
            tree = read_json(self._path)
        except DataError:
            return {}
        if not isinstance(tree, dict) or tree.get("fingerprint") != self._fingerprint:
            return {}
        if not isinstance(tree.get("state"), dict) or tree.get("sha256") != json_hash(tree["state"]):
            return {}
        state: dict[str, Any] = _read_back(tree["state"])
        return state

    @contextlib.contextmanager
    def reading(self) -> Iterator[None]:
        """What a state lacks or has too much is a broken file, not a bug.

        Raises:
            DataError: in place of what its reader says.
        """
        try:
            yield
        except (KeyError, TypeError, ValueError, AttributeError, LookupError, OverflowError, ConfigError) as error:
            got = f"{type(error).__name__}: {error}"
            raise DataError(f"{self._path} is broken", got=got, hint="Delete it: the search begins anew.") from error

    def save(self, state: dict[str, Any]) -> None:
        """Write the state, whole or not at all."""
        if self._path is not None:
            plain = as_read_back(_written(state))
            write_json(self._path, {"fingerprint": self._fingerprint, "sha256": json_hash(plain), "state": plain})


_NOT_FINITE = {"Infinity": math.inf, "-Infinity": -math.inf, "NaN": math.nan}


def _written(tree: Any) -> Any:
    """The state with numbers that JSON does not know as words: a search that has found nothing costs infinity."""
    if isinstance(tree, Mapping):
        return {key: _written(item) for key, item in tree.items()}
    if isinstance(tree, (list, tuple)):
        return [_written(item) for item in tree]
    if isinstance(tree, float) and not math.isfinite(tree):
        return "NaN" if math.isnan(tree) else "Infinity" if tree > 0 else "-Infinity"
    return tree


def _read_back(tree: Any) -> Any:
    if isinstance(tree, dict):
        return {key: _read_back(item) for key, item in tree.items()}
    if isinstance(tree, list):
        return [_read_back(item) for item in tree]
    return _NOT_FINITE.get(tree, tree) if isinstance(tree, str) else tree


def fingerprint_of(problem: Problem, settings: SolveSettings) -> str:
    """Hash of everything that decides about a search: logs, model, parameters, weights, settings."""
    delays_s = np.array(problem.nominal.given.delay_s)
    digest = hashlib.sha256(problem.nominal.simulator.fingerprint.encode())
    for array in (delays_s, problem.columns, *(array for segment in problem.segments for array in _arrays(segment))):
        digest.update(f"{array.dtype} {array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    carried, factors = zip(*(astuple(segment.setup) for segment in problem.segments), strict=True)
    for values, usual in ((carried, 0.0), (factors, 1.0)):
        if any(value != usual for value in values):
            digest.update(json.dumps(values).encode())
    plain = {
        "parameters": [parameter.to_json() for parameter in problem.parameters],
        "motions": [segment.episode_id for segment in problem.segments],
        "weights": asdict(problem.weights),
        "settings": asdict(settings),
        "trapezoidal": problem.trapezoidal,
    }
    digest.update(json.dumps(plain, sort_keys=True).encode())
    return digest.hexdigest()


def _arrays(segment: Segment) -> Iterator[np.ndarray]:
    """What is simulated, and what it is compared with."""
    plan = segment.plan
    now, earlier = plan.request(), plan.request(_EARLIER_S)
    yield from (plan.starts, plan.measured.time_s, segment.counts, now.position, now.velocity)
    yield from (request.command[name] for request in (now, earlier) for name in sorted(request.command))
    yield from (plan.measured[name] for name in sorted(plan.measured.signals))
