"""What the error depends on, over all episodes of all runs: comparisons in, `core.analysis.Analysis` out."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float, Float64

from trueup.core.analysis import Analysis, BinnedCurve, HorizonCurve, Lag
from trueup.core.results import GapResult
from trueup.core.timeseries import BODY_PREFIX, TimeSeries
from trueup.errors import ConfigError, NameMismatch
from trueup.measure.bins import HorizonError, binned_error, error_against_horizon
from trueup.measure.comparison import Comparison
from trueup.measure.derivatives import gradient

DRIVERS = ("velocity", "position", "load")
_Key = tuple[str, str, str]  # run, signal, joint


class _Thinned:
    """Rows of K numbers, thinned evenly as they come, so that memory stays bounded and no draw is needed.

    Args:
        limit: rows that are kept at most.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._stride = 1
        self._seen = 0
        self._size = 0
        self._parts: list[Float[np.ndarray, "N K"]] = []

    def add(self, rows: Float[np.ndarray, "N K"]) -> None:
        kept = rows[-self._seen % self._stride :: self._stride]
        self._seen += len(rows)
        self._parts.append(kept)
        self._size += len(kept)
        while self._size > self._limit:
            self._parts = [self.rows()[::2].copy()]
            self._size = len(self._parts[0])
            self._stride *= 2

    def rows(self) -> Float[np.ndarray, "N K"]:
        return np.concatenate(self._parts)


class AnalysisBuilder:
    """Collects what explains the error, episode by episode, in bounded memory.

    The error of each joint is binned by its measured velocity (the derivative of position where velocity was not
    measured), its measured position, and its load (measured torque, or the current where there is none). With
    restarts it is also followed over the time since the restart.

    Args:
        bins: number of bins per curve.
        max_samples: samples per run, signal and joint that medians are taken from; of longer data every 2nd, 4th,
            ... sample is used.
        window_s: length of the windows between restarts [s]; None for no restarts.
        horizon_steps: points of the error-against-horizon curve.

    Raises:
        ConfigError: a number is not positive.
    """

    def __init__(
        self, *, bins: int = 12, max_samples: int = 50_000, window_s: float | None = None, horizon_steps: int = 25
    ) -> None:
        if bins < 1 or max_samples < 2 or horizon_steps < 1 or (window_s is not None and not window_s > 0.0):
            raise ConfigError(
                "bins, max_samples, horizon_steps and window_s must be positive",
                got=(bins, max_samples, horizon_steps, window_s),
            )
        self._bins = bins
        self._max_samples = max_samples
        self._steps = horizon_steps
        self._step_s = None if window_s is None else window_s / horizon_steps
        self._samples: dict[_Key, _Thinned] = {}
        self._units: dict[tuple[str, str], str] = {}
        self._horizon: dict[tuple[str, str], HorizonError] = {}
        self._joints: tuple[str, ...] = ()

    def add(self, comparison: Comparison) -> None:
        """Take in one episode.

        Raises:
            NameMismatch: its joints are not those of the episodes before.
        """
        measured = comparison.measured
        self._joints = self._joints or measured.joints
        if set(self._joints) != set(measured.joints):
            raise NameMismatch(
                f"episode {comparison.meta.id!r} has other joints than before", left=measured.joints, right=self._joints
            )
        drivers = self._drivers(measured)
        for label in comparison.labels:
            run = comparison.run(label)
            for signal in comparison.common_signals(label):
                if signal.startswith(BODY_PREFIX):
                    continue
                residual = measured[signal].astype(np.float64) - run[signal].astype(np.float64)
                for column, joint in enumerate(measured.joints):
                    self._units.setdefault((signal, joint), measured.units[signal][column])
                    rows = np.column_stack([residual[:, column], *(values[:, column] for values in drivers)])
                    store = self._samples.setdefault((label, signal, joint), _Thinned(self._max_samples))
                    store.add(rows.astype(np.float32))
                self._add_horizon(comparison, label, signal, residual)

    def result(self, lags: Mapping[str, Mapping[str, Lag]] | None = None) -> Analysis:
        """Everything that was taken in.

        Args:
            lags: source -> joint -> delay, e.g. from `lags_of`.
        """
        bins: dict[str, dict[str, dict[str, dict[str, BinnedCurve]]]] = {}
        for (label, signal, joint), store in self._samples.items():
            rows = store.rows()
            curves = {
                name: curve
                for number, name in enumerate(DRIVERS, start=1)
                if (curve := self._curve(rows[:, 0], rows[:, number], signal, joint, name)) is not None
            }
            if curves:
                bins.setdefault(label, {}).setdefault(signal, {})[joint] = curves
        return Analysis(bins=bins, lags=lags or {}, horizon=self._horizon_curves())

    def _drivers(self, measured: TimeSeries) -> tuple[Float64[np.ndarray, "T J"], ...]:
        """Velocity, position and load, NaN where they were not measured; notes their units."""
        missing = np.full((len(measured), len(measured.joints)), np.nan)
        loads = [name for name in ("torque", "current") if name in measured]
        found = {
            "velocity": "velocity" if "velocity" in measured else "",
            "position": "position" if "position" in measured else "",
            "load": loads[0] if loads else "",
        }
        values = {name: measured[signal].astype(np.float64) if signal else missing for name, signal in found.items()}
        for name, signal in found.items():
            for joint, unit in zip(measured.joints, measured.units.get(signal, ()), strict=False):
                self._units.setdefault((name, joint), unit)
        if not found["velocity"] and found["position"]:
            start = np.zeros(1, dtype=np.int64)
            values["velocity"] = gradient(values["position"], measured.time_s, start)
            for joint, unit in zip(measured.joints, measured.units["position"], strict=True):
                self._units.setdefault(("velocity", joint), f"{unit}/s")
        return tuple(values[name] for name in DRIVERS)

    def _curve(
        self, residual: Float[np.ndarray, "N"], driver: Float[np.ndarray, "N"], signal: str, joint: str, name: str
    ) -> BinnedCurve | None:
        binned = binned_error(driver, residual, bins=self._bins)
        if not binned.centers.size:
            return None
        return BinnedCurve(
            centers=tuple(binned.centers.tolist()),
            median=tuple(binned.median.tolist()),
            q25=tuple(binned.q25.tolist()),
            q75=tuple(binned.q75.tolist()),
            count=tuple(binned.samples.tolist()),
            x_unit=self._units[name, joint],
            y_unit=self._units[signal, joint],
        )

    def _add_horizon(
        self, comparison: Comparison, label: str, signal: str, residual: Float64[np.ndarray, "T J"]
    ) -> None:
        if self._step_s is None:
            return
        order = [comparison.measured.joints.index(joint) for joint in self._joints]
        part = error_against_horizon(
            residual[:, order],
            comparison.measured.time_s,
            comparison.starts,
            step_s=self._step_s,
            steps=self._steps + 1,
        )
        before = self._horizon.get((label, signal))
        self._horizon[label, signal] = (
            part if before is None else HorizonError(before.squares + part.squares, before.samples + part.samples)
        )

    def _horizon_curves(self) -> dict[str, dict[str, dict[str, HorizonCurve]]]:
        curves: dict[str, dict[str, dict[str, HorizonCurve]]] = {}
        for (label, signal), sums in self._horizon.items():
            values = sums.rmse()
            reached = sums.samples.any(axis=1)
            times = np.arange(len(values))[reached] * (self._step_s or 0.0)
            curves.setdefault(label, {})[signal] = {
                joint: HorizonCurve(
                    time_s=tuple(times.tolist()),
                    rmse=tuple(values[reached, column].tolist()),
                    unit=self._units[signal, joint],
                )
                for column, joint in enumerate(self._joints)
            }
        return curves


def lags_of(result: GapResult) -> dict[str, dict[str, Lag]]:
    """Run (also `command`) -> joint -> mean lag of the measured motion behind it, from the metric `phase_lag`."""
    lags = {}
    for label, splits in result.runs.items():
        found = splits.get("all", {}).get("position", {}).get("phase_lag")
        if found is not None:
            lags[label] = {
                joint: Lag(value_s=item.value, low_s=item.low, high_s=item.high)
                for joint, item in found.per_joint.items()
            }
    return lags
