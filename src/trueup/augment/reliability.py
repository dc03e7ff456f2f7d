"""How reliable the probability is that the simulator is far off: counts in, a curve with intervals out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float64, Int

from trueup.core.augment_result import Reliability
from trueup.core.results import Estimate
from trueup.measure import by_motion, ratio_interval


class Calibration:
    """Counts of predicted and seen, per motion, signal and bin of the predicted probability.

    Attributes:
        bins: number of bins, of equal width from 0 to 1.
    """

    bins = 10

    def __init__(self) -> None:
        # signal -> motion -> rows: samples, sum of predictions, samples that were far off, sum of squared errors.
        self._sums: dict[str, dict[int, Float64[np.ndarray, "4 bins"]]] = {}
        self._motions = 0

    def add(
        self,
        signals: Sequence[str],
        valid: Bool[np.ndarray, "T N"],
        predicted: Float64[np.ndarray, "T N"],
        far: Bool[np.ndarray, "T N"],
    ) -> None:
        """Count one motion.

        Args:
            signals: signal of each of N outputs.
            valid: samples that count.
            predicted: probability that the simulator is far off.
            far: whether it was.
        """
        for column, signal in enumerate(signals):
            rows = valid[:, column]
            chance, seen = predicted[rows, column], far[rows, column].astype(np.float64)
            bins = np.minimum((chance * self.bins).astype(np.int64), self.bins - 1)
            sums = self._sums.setdefault(signal, {}).setdefault(self._motions, np.zeros((4, self.bins)))
            for row, weights in enumerate((np.ones_like(seen), chance, seen, (chance - seen) ** 2)):
                sums[row] += np.bincount(bins, weights=weights, minlength=self.bins)
        self._motions += 1

    def result(
        self, rows: Bool[np.ndarray, "E"], *, motions: Int[np.ndarray, "R"] | None = None, draws: int, seed: int
    ) -> dict[str, Reliability]:
        """Signal -> reliability, for the signals that have one.

        Args:
            rows: which of the E recordings that were counted.
            motions: number of the motion that each of these R executed, the same for repetitions, which are drawn
                together. All differ if None.
            draws: of the bootstrap.
            seed: of the bootstrap.
        """
        found = {}
        for signal, sums in self._sums.items():
            table = np.array([sums.get(number, np.zeros((4, self.bins))) for number in np.flatnonzero(rows).tolist()])
            if table[:, 0].any():
                found[signal] = _reliability(table, np.arange(len(table)) if motions is None else motions, draws, seed)
        return found


def _reliability(
    table: Float64[np.ndarray, "R 4 bins"], motions: Int[np.ndarray, "R"], draws: int, seed: int
) -> Reliability:
    filled = np.flatnonzero(table[:, 0].sum(axis=0))
    samples, predicted, far, squares = np.moveaxis(table[:, :, filled], 1, 0)
    observed, low, high = ratio_interval(by_motion(far, motions), by_motion(samples, motions), draws=draws, seed=seed)
    weight = samples.sum(axis=0) / samples.sum()
    mean = predicted.sum(axis=0) / samples.sum(axis=0)
    share = float(far.sum() / samples.sum())
    reference = share * (1.0 - share)
    return Reliability(
        predicted=tuple(mean.tolist()),
        observed=tuple(
            Estimate(value, "1") if np.isnan(start) else Estimate(value, "1", max(start, 0.0), min(end, 1.0))
            for value, start, end in zip(observed.tolist(), low.tolist(), high.tolist(), strict=True)
        ),
        weight=tuple(weight.tolist()),
        far=share,
        error=float((weight * np.abs(observed - mean)).sum()),
        skill=None if reference == 0.0 else float(1.0 - squares.sum() / samples.sum() / reference),
    )
