"""Sums per motion into errors pooled over samples, cuts and shares, with intervals over whole motions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from jaxtyping import Float64, Int

from trueup.core.augment_result import ALL_JOINTS, Coverage, Cut, Pooled
from trueup.core.results import Estimate, Verdict
from trueup.core.timeseries import BODY_PREFIX
from trueup.measure import by_motion, metric_unit, ratio_interval

T = TypeVar("T")


@dataclass(frozen=True)
class Column:
    """A column of all sums: a joint of a signal, or the scored joints of a signal together."""

    signal: str
    joint: str
    unit: str


class Totals:
    """Adds to sums by joint those over the scored joints of each signal, where they share a unit."""

    def __init__(self, columns: Sequence[Column], scored: Sequence[str]) -> None:
        self.columns = list(columns)
        self._members: list[list[int]] = []
        for signal in dict.fromkeys(column.signal for column in columns):
            own = [k for k, item in enumerate(columns) if item.signal == signal]
            members = own if signal.startswith(BODY_PREFIX) else [k for k in own if columns[k].joint in scored]
            units = {columns[k].unit for k in members}
            if len(units) == 1:
                self._members.append(members)
                self.columns.append(Column(signal, ALL_JOINTS, units.pop()))

    def of(self, rows: Sequence[Float64[np.ndarray, "C"]]) -> Float64[np.ndarray, "E S"]:
        """One row per motion, one column per column, totals last."""
        table = np.array(rows)
        totals = [table[:, members].sum(axis=1, keepdims=True) for members in self._members]
        return np.concatenate([table, *totals], axis=1)


@dataclass(frozen=True)
class Pooling:
    """Sums per motion into estimates, one per column.

    Attributes:
        columns: of the sums.
        draws: bootstrap resamples.
        seed: of the draws.
        motions: number of the motion that each row executed; repetitions are drawn together. All differ if None.
    """

    columns: Sequence[Column]
    draws: int
    seed: int
    motions: Int[np.ndarray, "E"] | None = None

    def tree(self, items: Sequence[T | None]) -> dict[str, dict[str, T]]:
        """Signal -> joint -> item, without those that are None."""
        found: dict[str, dict[str, T]] = {}
        for column, item in zip(self.columns, items, strict=True):
            if item is not None:
                found.setdefault(column.signal, {})[column.joint] = item
        return found

    def pooled(self, squares: Float64[np.ndarray, "E S"], samples: Float64[np.ndarray, "E S"]) -> list[Pooled | None]:
        """Error over all samples; None where there are none."""
        ends = self._ratio(squares, samples)
        return [
            None if np.isnan(value) else _pooled(value, max(low, 0.0), high, column.unit)
            for column, value, low, high in zip(self.columns, *ends, strict=True)
        ]

    def cuts(
        self,
        own: Float64[np.ndarray, "E S"],
        squares: Float64[np.ndarray, "E S"],
        samples: Float64[np.ndarray, "E S"],
    ) -> list[Cut | None]:
        """What is left of the simulator's error, from the sums of squares of both."""
        errors = self.pooled(own, samples)
        return [
            None if item is None else Cut(item.mse, item.rmse, factor, verdict)
            for item, (factor, verdict) in zip(errors, self.factors(own, squares), strict=True)
        ]

    def factors(
        self, own: Float64[np.ndarray, "E S"], other: Float64[np.ndarray, "E S"]
    ) -> list[tuple[Estimate, Verdict]]:
        """How many times smaller one pooled error is than another on the same motions.

        The bootstrap runs over (own - other) / (own + other), which is defined also where one of them is zero; it is
        a monotone function of the factor, so that its percentiles are those of the factor.
        """
        found = []
        for value, low, high in zip(*self._ratio(own - other, own + other), strict=True):
            verdict: Verdict = "better" if high < 0.0 else "worse" if low > 0.0 else "undecided"
            found.append((_estimate(_factor(value), "1", _factor(high), _factor(low)), verdict))
        return found

    def coverage(
        self,
        inside: Float64[np.ndarray, "E S"],
        widths: Float64[np.ndarray, "E S"],
        covered: Float64[np.ndarray, "E S"],
    ) -> list[Coverage | None]:
        """Shares of samples within the interval, and its half width; None where there is no interval.

        Both are means over motions, as an interval promises them for a new motion (conformal risk control).
        """
        known = (covered > 0.0).astype(np.float64)
        shares, halves = (
            self._ratio(np.divide(part, covered, out=np.zeros_like(part), where=covered > 0.0), known)
            for part in (inside, widths)
        )
        return [
            None
            if np.isnan(share)
            else Coverage(
                _estimate(share, "1", max(low, 0.0), min(high, 1.0)),
                _estimate(half, column.unit, max(narrow, 0.0), wide),
            )
            for column, share, low, high, half, narrow, wide in zip(self.columns, *shares, *halves, strict=True)
        ]

    def _ratio(self, numerator: np.ndarray, denominator: np.ndarray) -> tuple[list[float], list[float], list[float]]:
        if self.motions is not None:
            numerator, denominator = (by_motion(part, self.motions) for part in (numerator, denominator))
        value, low, high = ratio_interval(numerator, denominator, draws=self.draws, seed=self.seed)
        return value.tolist(), low.tolist(), high.tolist()


def _pooled(value: float, low: float, high: float, unit: str) -> Pooled:
    squared = metric_unit("signal^2", unit)
    return Pooled(
        _estimate(value, squared, low, high),
        _estimate(float(np.sqrt(value)), unit, float(np.sqrt(low)), float(np.sqrt(high))),
    )


def _factor(ratio: float) -> float:
    """(other / own) of (own - other) / (own + other); NaN where nothing is left."""
    ratio = min(max(ratio, -1.0), 1.0)
    return math.nan if ratio == -1.0 else (1.0 - ratio) / (1.0 + ratio)


def _estimate(value: float, unit: str, low: float, high: float) -> Estimate:
    """An estimate; an end that is not defined, or infinite, is left out."""
    ends = (None if np.isnan(end) else float(end) for end in (low, high))
    return Estimate(float(value), unit, *ends)
