"""The evolution strategy of the ES thesis (3.2.1): random steps, smart adjustment and a worse counter.

What the thesis leaves open, and what is taken here:

- Neighborhood: uniform within +- `step` typical scales of every parameter. In the logarithm of a parameter that is
  a random factor, and the parameter keeps its sign. Both thresholds, the neighborhood and its growth are not given
  there. (All six elements of each inertia in its Table 3.5 change by one common factor, so that its search moved
  one number per link; whoever builds the space can do the same.)
- Acceptance: its steps begin with "for each joint", its signed error is summed per joint and its results (Table
  3.6) stand per joint: each joint is taken to accept or revert its own parameters by its own error. That is
  `acceptance: group`. It is right as far as a joint's trajectories do not depend on the parameters of the others,
  so parameters put together from several candidates are evaluated as a whole before they replace the best, and
  only if the total is lower. `acceptance: total` accepts or reverts the whole candidate.
- Positive eigenvalues: in the coordinates that are searched here every candidate is a possible body, so that none has
  to be drawn again.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from trueup.errors import ConfigError
from trueup.identify.solvers.ask_tell import (
    Evaluation,
    Stop,
    check_state,
    check_told,
    finite_or_none,
    from_finite_or_none,
)
from trueup.identify.solvers.evolution_settings import EvolutionSettings, Roles
from trueup.identify.solvers.space import Space


@dataclass(frozen=True, eq=False)
class _Point:
    """An evaluated candidate: (P,), its cost, the error of each block (B,) and the signed error of each group (G,)."""

    z: Float[np.ndarray, "P"]
    cost: float
    errors: Float[np.ndarray, "B"]
    signed: Float[np.ndarray, "G"]

    def to_json(self) -> dict[str, Any]:
        return {
            "z": self.z.tolist(),
            "cost": self.cost if math.isfinite(self.cost) else None,
            "errors": finite_or_none(self.errors),
            "signed": finite_or_none(self.signed),
        }

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> _Point:
        cost = math.inf if data["cost"] is None else float(data["cost"])
        errors, signed = _inf_for_nan(from_finite_or_none(data["errors"])), from_finite_or_none(data["signed"])
        return _Point(np.array(data["z"], dtype=float), cost, errors, signed)


class EvolutionStrategy:
    """The thesis's evolution strategy behind ask and tell.

    The parameters are cut into blocks that accept or revert on their own, each with a worse counter of its own: one
    block per group and one for shared parameters (which go by the total cost), or a single block for
    `acceptance: total`. The best is never worse than the start, and never a point that was not evaluated as a whole.

    Every step draws from a generator made of seed and step number, so that a search resumed from its state is the
    uninterrupted one, bit by bit.

    Args:
        space: bounds, start and typical scale.
        roles: group and effect of each parameter; without, the search is blind (`total`, not smart).
        settings: how to search.
        seed: of the steps.

    Raises:
        ConfigError: roles that do not fit the space.
    """

    def __init__(
        self,
        space: Space,
        roles: Roles | None = None,
        settings: EvolutionSettings | None = None,
        *,
        seed: int = 0,
    ) -> None:
        self._space = space
        self._settings = settings or EvolutionSettings()
        self._seed = seed
        if roles is None:
            roles = Roles(np.full(space.size, -1), np.zeros(space.size, dtype=int))
        if roles.group.shape != (space.size,) or roles.effect.shape != (space.size,):
            raise ConfigError("roles", got=f"{roles.group.size} and {roles.effect.size}", expected=f"{space.size} each")
        if roles.group.min() < -1 or not set(roles.effect.tolist()) <= {-1, 0, 1}:
            raise ConfigError("roles", expected="groups from -1 up, effects of -1, 0 or 1")
        self._roles = roles
        self._groups = int(roles.group.max()) + 1
        by_group = self._settings.acceptance == "group" and self._groups > 0
        self._blocks = self._groups + 1 if by_group else 1
        self._block = (
            np.where(roles.group < 0, self._blocks - 1, roles.group) if by_group else np.zeros_like(roles.group)
        )
        nothing = np.full(self._groups, math.nan)
        self._current = _Point(space.start.copy(), math.inf, np.full(self._blocks, math.inf), nothing)
        # What the next candidates surround: the current point, or its successor that is yet to be evaluated.
        self._center, self._center_signed, self._pending = space.start.copy(), nothing, True
        self._worse, self._lowest = np.zeros(self._blocks, dtype=int), np.full(self._blocks, math.inf)
        self._steps = self._evaluations = self._failed_in_a_row = 0
        self._asked: Float[np.ndarray, "C P"] | None = None

    @property
    def stop(self) -> Stop | None:
        """Why the search is over, None while it is not."""
        if self._current.cost == math.inf and self._failed_in_a_row >= self._settings.failed_limit:
            return Stop("failed", f"every candidate failed in {self._failed_in_a_row} steps from the start")
        used = int(self._worse[np.unique(self._block)].min())
        if used < self._settings.patience:
            return None
        failed = f"; in the last {self._failed_in_a_row} every candidate failed" if self._failed_in_a_row else ""
        return Stop("stalled", f"nothing better in {used} steps{failed}")

    @property
    def best(self) -> tuple[Float[np.ndarray, "P"], float]:
        """The best candidate so far and its cost."""
        return self._current.z.copy(), self._current.cost

    @property
    def evaluations(self) -> int:
        """Candidates told so far."""
        return self._evaluations

    def ask(self) -> Float[np.ndarray, "C P"]:
        """The candidates of one step, (population, P); a point that was put together from several comes first."""
        if self._asked is None:
            rng = np.random.default_rng([self._seed, self._steps])
            rows = [self._center] if self._pending else []
            rows += [self._draw(rng) for _ in range(self._settings.population - len(rows))]
            self._asked = np.array(rows)
        return self._asked.copy()

    def _draw(self, rng: np.random.Generator) -> Float[np.ndarray, "P"]:
        settings = self._settings
        direction = self._direction()
        wide = np.where(self._worse > settings.widen_after, settings.widen, 1.0)
        finer = 10.0 ** -rng.uniform(0.0, settings.finer_decades, self._blocks)
        width = settings.step * self._space.scale * (wide * finer)[self._block]
        step = rng.uniform(-1.0, 1.0, self._space.size)
        step = np.where(direction == 0, step, direction * np.abs(step))
        # Cut at the bounds: a reflection would turn the direction around.
        return self._space.clip(self._center + width * step)

    def _direction(self) -> Int[np.ndarray, "P"]:
        """Where each parameter may move: +1 up, -1 down, 0 both ways."""
        group = self._roles.group
        if not self._settings.smart or not self._groups:
            return np.zeros_like(group)
        signed = np.where(group < 0, 0.0, self._center_signed[group])
        wanted = -np.sign(np.nan_to_num(signed)).astype(int) * self._roles.effect
        return np.where(self._worse[self._block] > self._settings.ignore_after, 0, wanted)

    def tell(self, z: Float[np.ndarray, "C P"], evaluation: Evaluation) -> None:
        """Accept what is better and revert the rest.

        Raises:
            ConfigError: it is not the answer to the last `ask`, or lacks the errors per group that are needed.
        """
        check_told(self._asked, z, evaluation)
        before, told = self._current, self._points(z, evaluation)
        self._current = min([before, *told], key=lambda point: point.cost)
        drawn = len(told) - int(self._pending)
        self._join([before, *told])
        better = self._current.errors < self._lowest
        self._worse = np.where(better, 0, self._worse + int(drawn > 0))
        # While a joined point waits, what it takes from earlier points is still to beat.
        self._lowest = np.minimum(self._lowest, self._current.errors) if self._pending else self._current.errors
        self._steps += 1
        self._evaluations += len(told)
        self._failed_in_a_row = 0 if any(math.isfinite(point.cost) for point in told) else self._failed_in_a_row + 1
        self._asked = None

    def _points(self, z: Float[np.ndarray, "C P"], evaluation: Evaluation) -> list[_Point]:
        count = len(z)
        absolute, signed = evaluation.absolute, evaluation.signed
        by_group = self._blocks > 1
        needed = {"absolute": by_group, "signed": self._settings.smart and bool(np.any(self._roles.effect))}
        for name, values in (("absolute", absolute), ("signed", signed)):
            if needed[name] and (values is None or values.shape[1] < self._groups):
                raise ConfigError(
                    f"the evolution strategy needs the {name} error of each group",
                    got="none" if values is None else f"{values.shape[1]} groups",
                    expected=f"{self._groups}",
                    hint="Give it, or choose acceptance: total and smart: false.",
                )
        cost = np.where(evaluation.failed, math.inf, evaluation.cost)
        errors = cost[:, np.newaxis]
        if by_group and absolute is not None:
            errors = np.hstack([absolute[:, : self._groups], errors])
        # A candidate whose error of one joint is not a number has failed as a whole.
        lost = ~np.all(np.isfinite(errors), axis=1, keepdims=True)
        errors = np.where(lost, math.inf, errors)
        cost = np.where(lost[:, 0], math.inf, cost)
        signs = np.full((count, self._groups), math.nan)
        if signed is not None:
            signs = np.where(np.isfinite(signed), signed, math.nan)[:, : self._groups]
        return [_Point(z[row].copy(), float(cost[row]), errors[row], signs[row]) for row in range(count)]

    def _join(self, points: list[_Point]) -> None:
        """Surround the best parameters of every block next; what no candidate was yet has to be evaluated."""
        picks = np.argmin([point.errors for point in points], axis=0)
        center = np.array([point.z for point in points])[picks[self._block], np.arange(self._space.size)]
        self._pending = not any(np.array_equal(center, point.z) for point in [self._current, *points])
        self._center, self._center_signed = self._current.z, self._current.signed
        if self._pending:
            groups = np.arange(self._groups)
            self._center = center
            self._center_signed = np.array([point.signed for point in points])[picks[groups], groups]

    def _setup(self) -> dict[str, Any]:
        return {
            "solver": "evolution",
            "space": self._space.to_json(),
            "roles": {"group": self._roles.group.tolist(), "effect": self._roles.effect.tolist()},
            "settings": asdict(self._settings),
            "seed": self._seed,
        }

    def state(self) -> dict[str, Any]:
        """The point that stands, its successor in waiting and the counters."""
        return {
            "setup": self._setup(),
            "current": self._current.to_json(),
            "center": self._center.tolist(),
            "center_signed": finite_or_none(self._center_signed),
            "pending": self._pending,
            "worse": self._worse.tolist(),
            "lowest": finite_or_none(self._lowest),
            "steps": self._steps,
            "evaluations": self._evaluations,
            "failed_in_a_row": self._failed_in_a_row,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a state.

        Raises:
            ConfigError: it was made in another space, or with other roles, settings or seed.
        """
        check_state(state, self._setup(), self.state())
        before = self._shapes()
        self._current = _Point.from_json(state["current"])
        self._center = np.array(state["center"], dtype=float)
        self._center_signed = from_finite_or_none(state["center_signed"])
        self._pending = bool(state["pending"])
        self._worse = np.array(state["worse"], dtype=int)
        self._lowest = _inf_for_nan(from_finite_or_none(state["lowest"]))
        self._steps, self._evaluations = int(state["steps"]), int(state["evaluations"])
        self._failed_in_a_row = int(state["failed_in_a_row"])
        self._asked = None
        inside = all(np.array_equal(self._space.clip(z), z) for z in (self._current.z, self._center))
        if self._shapes() != before or not inside:
            raise ConfigError("the checkpoint's numbers are not those of this search")

    def _shapes(self) -> list[tuple[int, ...]]:
        point = self._current
        arrays = (point.z, point.errors, point.signed, self._center, self._center_signed, self._worse, self._lowest)
        return [array.shape for array in arrays]


def _inf_for_nan(values: Float[np.ndarray, "N"]) -> Float[np.ndarray, "N"]:
    return np.where(np.isnan(values), math.inf, values)
