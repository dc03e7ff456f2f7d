"""Points to start searches from."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.stats import qmc

from trueup.errors import ConfigError
from trueup.identify.solvers.ask_tell import Evaluation
from trueup.identify.solvers.space import Space


def draw_starts(
    space: Space,
    count: int,
    *,
    method: Literal["sobol", "latin"] = "sobol",
    spread: float | None = None,
    seed: int = 0,
) -> Float[np.ndarray, "C P"]:
    """Starts that fill a box evenly; the first is the start of the space itself.

    Args:
        space: bounds, start and typical scale.
        count: number of starts.
        method: scrambled Sobol sequence, or Latin hypercube.
        spread: half width of the box around the start in typical scales, cut at the bounds; the bounds when None.
        seed: of the scrambling.

    Returns:
        (count, P), all within the bounds.

    Raises:
        ConfigError: fewer than one start, or a spread that is not above 0.
    """
    if count < 1:
        raise ConfigError("number of starts", got=count, expected="at least 1")
    if spread is not None and not spread > 0.0:
        raise ConfigError("spread of the starts", got=spread, expected="above 0")
    low, high = space.low, space.high
    if spread is not None:
        low, high = space.clip(space.start - spread * space.scale), space.clip(space.start + spread * space.scale)
    rng = np.random.default_rng(seed)
    others = count - 1
    if method == "latin":
        cells = np.array([rng.permutation(others) for _ in range(space.size)]).reshape(space.size, others).T
        unit = (cells + rng.uniform(size=cells.shape)) / max(others, 1)
    else:
        # A Sobol sequence is balanced in powers of two only, and scipy warns of other lengths.
        unit = qmc.Sobol(space.size, seed=rng).random_base2(max(others - 1, 0).bit_length())[:others]
    return np.vstack([space.start, space.clip(low + unit * (high - low))])


def screen_starts(
    starts: Float[np.ndarray, "C P"], evaluate: Callable[[Float[np.ndarray, "C P"]], Evaluation], *, keep: int
) -> Float[np.ndarray, "K P"]:
    """The first start and the cheapest of the others, best first, after one evaluation of each.

    Starts that fail are left out, so that fewer than `keep` may come back.

    Raises:
        ConfigError: `keep` is below 1.
    """
    if keep < 1:
        raise ConfigError("number of starts to keep", got=keep, expected="at least 1")
    evaluation = evaluate(starts)
    order = [row for row in np.argsort(evaluation.cost, kind="stable") if row > 0 and not evaluation.failed[row]]
    return starts[[0, *order[: keep - 1]]]
