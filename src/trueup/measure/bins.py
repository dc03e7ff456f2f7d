"""What the error depends on: binned by another quantity, and by the time since a restart."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float64, Int

from trueup.measure.columns import quantiles

_FEWEST = 5  # samples of a bin that has a median


class BinnedError(NamedTuple):
    """The distribution of |residual| of one joint in bins of another quantity.

    Attributes:
        centers: middle of each bin, shape (N,), increasing.
        median: median of |residual|, shape (N,); NaN in a bin with too few samples.
        q25: lower quartile, likewise.
        q75: upper quartile, likewise.
        samples: number of samples in each bin, shape (N,).
    """

    centers: Float64[np.ndarray, "N"]
    median: Float64[np.ndarray, "N"]
    q25: Float64[np.ndarray, "N"]
    q75: Float64[np.ndarray, "N"]
    samples: Int[np.ndarray, "N"]


class HorizonError(NamedTuple):
    """Sums from which the error against the time since a restart follows; add those of many episodes.

    Attributes:
        squares: sum of squared residuals for each step, shape (H, J).
        samples: number of samples in each step, shape (H, J).
    """

    squares: Float64[np.ndarray, "H J"]
    samples: Int[np.ndarray, "H J"]

    def rmse(self) -> Float64[np.ndarray, "H J"]:
        """Root of the mean square over all windows, shape (H, J); NaN for a step without samples."""
        result = np.full(self.squares.shape, np.nan)
        np.divide(self.squares, self.samples, out=result, where=self.samples > 0)
        return np.asarray(np.sqrt(result))


def binned_error(driver: Float[np.ndarray, "T"], residual: Float[np.ndarray, "T"], *, bins: int = 12) -> BinnedError:
    """Median and quartiles of |residual| in bins of equal width of a driver, e.g. velocity, position or load.

    The bins span the 1st to the 99th percentile of the driver, so that a few spikes do not push everything into
    one bin; what lies outside counts in the outermost bins. Bins with
    fewer than five samples have no median. A driver that does not vary has one bin.

    Args:
        driver: shape (T,); samples that are not finite here or in the residual are left out.
        residual: shape (T,), measured - simulated.
        bins: number of bins; more of them show more detail and are noisier.
    """
    valid = np.isfinite(driver) & np.isfinite(residual)
    x = driver[valid].astype(np.float64)
    size = np.abs(residual[valid].astype(np.float64))
    if not x.size:
        empty = np.empty(0)
        return BinnedError(empty, empty, empty, empty, np.empty(0, dtype=np.int64))
    low, high = quantiles(x[:, None], (0.01, 0.99))[:, 0]
    if not high > low:
        bins = 1
    edges = np.linspace(low, high, bins + 1)
    slot = np.clip(np.searchsorted(edges[1:-1], x, side="right"), 0, bins - 1)
    order = np.argsort(slot, kind="stable")
    count = np.bincount(slot, minlength=bins)
    quartiles = np.full((3, bins), np.nan)
    for number, part in enumerate(np.split(size[order], np.cumsum(count)[:-1])):
        if part.size >= _FEWEST:
            quartiles[:, number] = quantiles(part[:, None], (0.25, 0.5, 0.75))[:, 0]
    return BinnedError(0.5 * (edges[1:] + edges[:-1]), quartiles[1], quartiles[0], quartiles[2], count)


def error_against_horizon(
    residual: Float[np.ndarray, "T J"],
    time_s: Float64[np.ndarray, "T"],
    starts: Int[np.ndarray, "S"],
    *,
    step_s: float,
    steps: int,
) -> HorizonError:
    """Squared residuals by the time since the last restart from the measured state.

    Args:
        residual: measured - simulated, shape (T, J); samples that are not finite are left out.
        time_s: clock [s].
        starts: rows of the restarts, increasing, the first is 0.
        step_s: width of a step [s]; step h holds the samples within half a step of `h * step_s`.
        steps: number of steps H; later samples are left out.
    """
    begin = time_s[starts][np.searchsorted(starts, np.arange(len(time_s)), side="right") - 1]
    slot = np.floor((time_s - begin) / step_s + 0.5).astype(np.int64)
    squares = np.zeros((steps, residual.shape[1]))
    count = np.zeros((steps, residual.shape[1]), dtype=np.int64)
    for joint in range(residual.shape[1]):
        kept = np.isfinite(residual[:, joint]) & (slot < steps)
        values = residual[kept, joint].astype(np.float64)
        squares[:, joint] = np.bincount(slot[kept], weights=values**2, minlength=steps)
        count[:, joint] = np.bincount(slot[kept], minlength=steps)
    return HorizonError(squares, count)
