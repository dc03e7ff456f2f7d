"""Points to start searches from."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.stats import qmc

from trueup.errors import ConfigError
from trueup.identify.solvers.space import Space


def draw_starts(
    space: Space,
    count: int,
    *,
    spread: float | None = None,
    seed: int = 0,
) -> Float[np.ndarray, "C P"]:
    """Starts that fill a box evenly, by a scrambled Sobol sequence; the first is the start of the space itself.

    Args:
        space: bounds, start and typical scale.
        count: number of starts.
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
    others = count - 1
    # A Sobol sequence is balanced in powers of two only, and scipy warns of other lengths.
    sequence = qmc.Sobol(space.size, seed=np.random.default_rng(seed))
    unit = sequence.random_base2(max(others - 1, 0).bit_length())[:others]
    return np.vstack([space.start, space.clip(low + unit * (high - low))])
