"""Kinematic quality (GapONet, appendix A.6.1, Table 2): trajectory consistency, smoothness, robustness.

Every function returns one value per joint, (J,). The paper assumes a uniform step; real stamps jitter, so that
all derivatives use the actual stamps. They never cross the start of a segment, where the simulation was
restarted. Samples that are not finite in either series are left out, and so are derivatives that need them.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float64, Int

from trueup.measure.columns import mean, paired
from trueup.measure.derivatives import gradient, second_difference
from trueup.measure.metrics.base import Metric

# The paper names no noise levels; these span encoders from good to poor [rad].
ROBUSTNESS_SIGMAS = (0.001, 0.005, 0.01)


def trajectory_consistency(
    measured: Float[np.ndarray, "T J"],
    simulated: Float[np.ndarray, "T J"],
    time_s: Float64[np.ndarray, "T"],
    *,
    starts: Int[np.ndarray, "S"] | None = None,
) -> Float64[np.ndarray, "J"]:
    """Mean absolute difference of the gradient of the gradient, unit of the signal per s^2 (GapONet, eq. 15, 16).

    Central differences twice, so that a sample is compared over five samples and noise enters with a quarter of
    the weight that it has in `smoothness`. Segments of fewer than three samples are left out.

    Args:
        measured: shape (T, J).
        simulated: shape (T, J).
        time_s: common clock [s].
        starts: first row of each segment; None for one segment.
    """
    first, second = paired(measured, simulated)
    begin = _starts(starts)
    # The derivative is linear: two gradients of the residual equal the difference of two gradients each.
    bend = np.abs(gradient(gradient(first - second, time_s, begin), time_s, begin))
    lengths = np.diff(np.append(begin, len(bend)))
    return mean(np.where(np.repeat(lengths >= 3, lengths)[:, None], bend, np.nan))


def smoothness(
    measured: Float[np.ndarray, "T J"],
    simulated: Float[np.ndarray, "T J"],
    time_s: Float64[np.ndarray, "T"],
    *,
    starts: Int[np.ndarray, "S"] | None = None,
) -> Float64[np.ndarray, "J"]:
    """Mean absolute difference of second differences, unit of the signal per s^2 (GapONet, eq. 17).

    The mean is over the samples that have both neighbors in their segment.

    Args:
        measured: shape (T, J).
        simulated: shape (T, J).
        time_s: common clock [s].
        starts: first row of each segment; None for one segment.
    """
    first, second = paired(measured, simulated)
    return mean(np.abs(second_difference(first - second, time_s, _starts(starts))))


def robustness(
    measured: Float[np.ndarray, "T J"],
    simulated: Float[np.ndarray, "T J"],
    *,
    sigmas: tuple[float, ...] = ROBUSTNESS_SIGMAS,
    seed: int = 0,
) -> Float64[np.ndarray, "J"]:
    """Mean absolute change of the gap under measurement noise on both series, unit of the signal (eq. 18, 19).

    As the equations are written the series cancel: what remains is the mean of |noise - noise'|, about
    `2 sigma / sqrt(pi)` averaged over the levels, for any two series. It is here to reproduce tables, and says
    nothing about a simulation.

    Args:
        measured: shape (T, J).
        simulated: shape (T, J).
        sigmas: standard deviations of the noise, in the unit of the signal.
        seed: seed of the noise.
    """
    first, second = paired(measured, simulated)
    rng = np.random.default_rng(seed)
    # The same draws for each level and joint: no mean here needs them to be independent, and joints stay
    # independent of their order.
    noise, other_noise = rng.standard_normal((2, len(first), 1))
    gap = first - second
    changes = [mean(np.abs((first + sigma * noise) - (second + sigma * other_noise) - gap)) for sigma in sigmas]
    return np.asarray(sum(changes)) / len(sigmas)


def _starts(starts: Int[np.ndarray, "S"] | None) -> Int[np.ndarray, "S"]:
    return np.zeros(1, dtype=np.int64) if starts is None else starts


METRICS = (
    Metric(
        "trajectory_consistency",
        lambda s: trajectory_consistency(s.measured, s.simulated, s.time_s, starts=s.starts),
        "mean|∇(∇e)|, central differences twice",
        "GapONet, eq. 15, 16",
        unit="signal/s^2",
        signals=("position",),
    ),
    Metric(
        "smoothness",
        lambda s: smoothness(s.measured, s.simulated, s.time_s, starts=s.starts),
        "mean|second difference of e|",
        "GapONet, eq. 17",
        unit="signal/s^2",
        signals=("position",),
    ),
    Metric(
        "robustness",
        lambda s: robustness(s.measured, s.simulated, seed=s.options.seed),
        "mean change of the gap under noise of 0.001, 0.005 and 0.01 on both series",
        "GapONet, eq. 18, 19",
        signals=("position",),
    ),
)
