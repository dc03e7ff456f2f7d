"""CMA-ES: the covariance matrix adaptation evolution strategy, from the `cma` package."""

from __future__ import annotations

import math
import sys
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from trueup.errors import ConfigError
from trueup.identify.solvers.ask_tell import (
    Evaluation,
    Stop,
    StopKind,
    check_state,
    check_told,
    finite_or_none,
    from_finite_or_none,
)
from trueup.identify.solvers.space import Space

# Rounding may differ between machines; replayed candidates that are further apart come from another `cma`.
_REPLAY_TOLERANCE = 1e-6
# Standard deviations below so many typical scales change nothing.
_STEP_TOLERANCE = 1e-7
# Generations in a row in which every candidate failed.
_FAILED_LIMIT = 10
_SENTENCES = {
    "tolfun": "the costs of the last generations differ by less than the tolerance",
    "tolfunhist": "the costs of the last generations differ by less than the tolerance",
    "tolx": "the steps are smaller than the tolerance",
    "tolflatfitness": "all candidates cost the same: the cost does not depend on what is searched",
    "tolstagnation": "no progress over many generations",
    "tolxstagnation": "the mean of the candidates no longer moves",
    "maxiter": "the largest number of generations is reached",
    "tolfacupx": "the steps grow without end: the typical scale is far too small, or the cost is not bounded",
    "tolupsigma": "the steps grow without end",
    "tolconditioncov": "the covariance is singular to rounding: some directions do not matter for the cost",
    "noeffectaxis": "a step along an axis is lost in rounding",
    "noeffectcoord": "a step in a coordinate is lost in rounding",
}
_CONVERGED = {"tolfun", "tolfunhist", "tolx", "noeffectaxis", "noeffectcoord"}


@dataclass(frozen=True)
class CmaSettings:
    """How CMA-ES searches.

    Attributes:
        population: candidates per generation, at least 3; 4 + 3 ln P when None. A multiple of the number of
            threads leaves none idle.
        step: standard deviation of the first candidates, in typical scales.
        cost_tolerance: stop when costs differ by less than this share of the first finite best cost.
    """

    population: int | None = None
    step: float = 0.3
    cost_tolerance: float = 1e-9

    def __post_init__(self) -> None:
        if self.population is not None and self.population < 3:
            raise ConfigError("population of CMA-ES", got=self.population, expected="at least 3")
        if not self.step > 0.0:
            raise ConfigError("step of CMA-ES", got=self.step, expected="above 0")


class CmaEs:
    """CMA-ES within bounds, behind ask and tell.

    The search runs in (z - start) / scale. The bounds are kept by `cma`'s smooth transformation of the box. The first
    batch holds the start as an extra candidate, so that the result is never worse than it. Failed candidates rank
    last; a generation in which all fail teaches nothing about directions: the step is halved if the cost is known
    somewhere, and candidates are drawn anew.

    `state` holds the costs of every generation, and `restore` repeats the search from its seed with these costs in
    place of simulations. `cma` draws all its numbers from the generator that it is given and looks at no clock, so
    that the resumed search is the uninterrupted one, bit by bit on the same machine. It takes about a millisecond
    per generation.

    Args:
        space: bounds, start and typical scale.
        settings: how to search.
        seed: of the candidates.
    """

    def __init__(self, space: Space, settings: CmaSettings | None = None, *, seed: int = 0) -> None:
        self._space = space
        self._settings = settings or CmaSettings()
        self._seed = seed
        self._reset()

    def _reset(self) -> None:
        self._strategy = _new_strategy(self._space, self._settings, self._seed)
        self._costs: list[Float[np.ndarray, "C"]] = []
        self._best_z, self._best_cost = self._space.start.copy(), math.inf
        self._evaluations = 0
        self._failed_in_a_row = 0
        self._varied = False
        self._drawn: list[Float[np.ndarray, "P"]] = []
        self._asked: Float[np.ndarray, "C P"] | None = None
        self._last: Float[np.ndarray, "P"] = self._space.start.copy()
        self._stop: Stop | None = None

    @property
    def stop(self) -> Stop | None:
        """Why the search is over, None while it is not."""
        return self._stop

    @property
    def best(self) -> tuple[Float[np.ndarray, "P"], float]:
        """The best candidate so far and its cost."""
        return self._best_z.copy(), self._best_cost

    @property
    def evaluations(self) -> int:
        """Candidates told so far."""
        return self._evaluations

    def ask(self) -> Float[np.ndarray, "C P"]:
        """One generation, (population, P); the first has the start before it."""
        if self._asked is None:
            with _quiet():
                self._drawn = self._strategy.ask()
            steps = np.array(self._drawn)[:, : self._space.size]
            z = self._space.clip(self._space.start + steps * self._space.scale)
            self._asked = z if self._costs else np.vstack([self._space.start, z])
        return self._asked.copy()

    def tell(self, z: Float[np.ndarray, "C P"], evaluation: Evaluation) -> None:
        """Take the costs of the last batch.

        Raises:
            ConfigError: it is not the answer to the last `ask`.
        """
        check_told(self._asked, z, evaluation)
        cost = np.where(evaluation.failed, math.inf, evaluation.cost)
        lowest = int(np.argmin(cost))
        if cost[lowest] < self._best_cost:
            if self._best_cost == math.inf:
                tolerance = self._settings.cost_tolerance * abs(float(cost[lowest]))
                self._strategy.opts.set({"tolfun": tolerance, "tolfunhist": tolerance})
            self._best_z, self._best_cost = z[lowest].copy(), float(cost[lowest])
        self._learn(cost[-len(self._drawn) :])
        self._costs.append(cost)
        self._evaluations += len(cost)
        self._last, self._asked = z[-1].copy(), None

    def _learn(self, cost: Float[np.ndarray, "C"]) -> None:
        finite = cost[np.isfinite(cost)]
        if not finite.size:
            self._failed_in_a_row += 1
            if self._best_cost < math.inf:
                self._strategy.sigma *= 0.5
            if self._failed_in_a_row >= _FAILED_LIMIT:
                self._stop = Stop("failed", f"every candidate failed in {self._failed_in_a_row} generations in a row")
            return
        self._failed_in_a_row = 0
        self._varied |= bool(finite.max() > self._best_cost)
        # Only ranks matter to CMA-ES, but its stopping rules compute with the values.
        worst, best = float(finite.max()), float(finite.min())
        last = min(worst + max(worst - best, abs(worst), 1e-300), sys.float_info.max)
        with _quiet():
            self._strategy.tell(self._drawn, [value if math.isfinite(value) else last for value in cost.tolist()])
            reasons = self._strategy.stop()
        if reasons and not self._varied:
            self._stop = Stop("stalled", _SENTENCES["tolflatfitness"])
        elif reasons:
            kind: StopKind = "converged" if _CONVERGED & set(reasons) else "stalled"
            if set(reasons) == {"maxiter"}:
                kind = "evaluations"
            self._stop = Stop(kind, "; ".join(dict.fromkeys(_SENTENCES.get(reason, reason) for reason in reasons)))

    def _setup(self) -> dict[str, Any]:
        return {
            "solver": "cma-es",
            "space": self._space.to_json(),
            "settings": asdict(self._settings),
            "seed": self._seed,
        }

    def state(self) -> dict[str, Any]:
        """Seed and costs of all generations, and the last candidate, by which `restore` checks itself."""
        return {
            "setup": self._setup(),
            "costs": [finite_or_none(cost) for cost in self._costs],
            "last": self._last.tolist(),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Repeat the search up to the state.

        Raises:
            ConfigError: the state was made with other settings, or by a `cma` that draws other candidates.
        """
        check_state(state, self._setup(), ("costs", "last"))
        self._reset()
        for costs in state["costs"]:
            z = self.ask()
            if len(costs) != len(z):
                raise ConfigError("the checkpoint's population", got=len(costs), expected=f"{len(z)}")
            self.tell(z, Evaluation(from_finite_or_none(costs)))
        away = float(np.max(np.abs(self._last - np.array(state["last"], dtype=float)) / self._space.scale))
        if not away <= _REPLAY_TOLERANCE:
            raise ConfigError(
                "the checkpoint's candidates cannot be drawn again",
                got=f"{away:.2g} typical scales apart",
                hint="It was made with another version of cma or numpy; start anew.",
            )


def _new_strategy(space: Space, settings: CmaSettings, seed: int) -> Any:
    rng = np.random.default_rng(seed)
    low, high = (space.low - space.start) / space.scale, (space.high - space.start) / space.scale
    if space.size == 1:  # cma does not support one dimension: it gets a second one that does not matter
        low, high = np.append(low, -1.0), np.append(high, 1.0)
    options: dict[str, Any] = {
        "bounds": [low.tolist(), high.tolist()],
        "randn": lambda *shape: rng.standard_normal(shape),
        "seed": math.nan,
        "tolx": _STEP_TOLERANCE,
        "verbose": -10,
        "verb_log": 0,
        "verb_disp": 0,
        "CMA_stds": np.minimum(1.0, (high - low) / 3.0 / settings.step).tolist(),
    }
    if settings.population is not None:
        options["popsize"] = settings.population
    with _quiet():
        import cma

        return cma.CMAEvolutionStrategy(np.zeros(low.size), settings.step, options)


@contextmanager
def _quiet() -> Iterator[None]:
    """Without cma's warnings: of plots that need matplotlib, and of what its stopping rules say anyway."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
