"""Statistics of a LeRobot dataset: per episode, and over all episodes without holding them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from jaxtyping import Float64, Int64, Shaped

_QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
_BINS = 5000

Values = Shaped[np.ndarray, "T W"]
Stats = dict[str, list[float] | list[int]]


def episode_stats(values: Values) -> Stats:
    """Statistics of one feature of one episode.

    Args:
        values: (T, W).

    Returns:
        `min`, `max`, `mean`, `std`, `q01` to `q99`, each with W numbers, and `count` with one.
    """
    exact = values.astype(np.float64)
    spread = np.quantile(exact, list(_QUANTILES.values()), axis=0)
    return {
        "min": exact.min(axis=0).tolist(),
        "max": exact.max(axis=0).tolist(),
        "mean": exact.mean(axis=0).tolist(),
        "std": exact.std(axis=0).tolist(),
        "count": [len(values)],
        **{name: row.tolist() for name, row in zip(_QUANTILES, spread, strict=True)},
    }


class RunningStats:
    """Minimum, maximum, mean and standard deviation of values that come in blocks.

    Mean and sum of squared deviations are merged block by block (Chan, Golub and LeVeque 1983), which does not
    lose digits when the mean is large against the deviation.
    """

    def __init__(self, width: int) -> None:
        self._count = 0
        self._mean = np.zeros(width)
        self._squares = np.zeros(width)
        self.minimum = np.full(width, np.inf)
        self.maximum = np.full(width, -np.inf)

    def add(self, values: Values) -> None:
        """Take a block of values, (T, W)."""
        block = values.astype(np.float64)
        mean = block.mean(axis=0)
        away = mean - self._mean
        count = self._count + len(block)
        self._mean = self._mean + away * (len(block) / count)
        self._squares += ((block - mean) ** 2).sum(axis=0) + away**2 * (self._count * len(block) / count)
        self._count = count
        self.minimum = np.minimum(self.minimum, block.min(axis=0))
        self.maximum = np.maximum(self.maximum, block.max(axis=0))

    def summary(self) -> Stats:
        """`min`, `max`, `mean`, `std` and `count` of all blocks."""
        return {
            "min": self.minimum.tolist(),
            "max": self.maximum.tolist(),
            "mean": self._mean.tolist(),
            "std": np.sqrt(self._squares / self._count).tolist(),
            "count": [self._count],
        }


def quantiles(
    files: Sequence[Path], within: Mapping[str, tuple[Float64[np.ndarray, "W"], Float64[np.ndarray, "W"]]]
) -> dict[str, Stats]:
    """Quantiles of the features in Parquet files, to 1/5000 of each value's range, reading one row group at a time.

    Args:
        files: the files with the rows.
        within: feature -> smallest and largest value of each of its W numbers.
    """
    counts = {name: np.zeros((_BINS, low.size), dtype=np.int64) for name, (low, _) in within.items()}
    for path in files:
        with pq.ParquetFile(path) as file:
            for group in range(file.num_row_groups):
                table = file.read_row_group(group, columns=list(within), use_threads=False)
                for name, (low, high) in within.items():
                    column = table[name].combine_chunks()
                    flat = column.flatten() if low.size > 1 else column
                    values = flat.to_numpy().reshape(-1, low.size).astype(np.float64)
                    scale = np.divide(_BINS, high - low, out=np.zeros(low.size), where=high > low)
                    bins = np.minimum(((values - low) * scale).astype(np.int64), _BINS - 1)
                    for k in range(low.size):
                        counts[name][:, k] += np.bincount(bins[:, k], minlength=_BINS)
    return {name: _from_counts(counts[name], low, high) for name, (low, high) in within.items()}


def _from_counts(
    counts: Int64[np.ndarray, "B W"], low: Float64[np.ndarray, "W"], high: Float64[np.ndarray, "W"]
) -> Stats:
    edges = np.linspace(0.0, 1.0, _BINS + 1)
    result: Stats = {}
    for name, share in _QUANTILES.items():
        row = []
        for k in range(low.size):
            below = np.concatenate(([0], np.cumsum(counts[:, k])))
            place = float(np.interp(share * below[-1], below, edges))
            row.append(float(low[k] + place * (high[k] - low[k])))
        result[name] = row
    return result
