"""How the gap changes with the payload (GapONet, 3.3: heavier payloads yield larger gaps and longer delays)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float64
from scipy.special import stdtrit

from trueup.core.engines import Trend
from trueup.core.results import Estimate, GapResult

TREND_METRICS = ("rmse", "phase_lag")
_LEVEL = 0.95


def trend(payload_kg: Float64[np.ndarray, "E"], values: Float64[np.ndarray, "E"], unit: str) -> Trend | None:
    """The straight line of a metric over the payload, by least squares over motions.

    The interval is Student's t with the covariance HC3 (MacKinnon and White 1985), since motions with a payload scatter
    more than those without. A curved dependence is not seen by it; the values per payload are for that.

    Args:
        payload_kg: one per motion, (E,) [kg].
        values: one per motion, (E,); NaN where it is not defined, which leaves the motion out.
        unit: of the values.

    Returns:
        None with fewer than two different payloads; without interval with fewer than three motions, or where a single
        motion alone decides about the line.
    """
    valid = np.isfinite(values) & np.isfinite(payload_kg)
    x, y = payload_kg[valid], values[valid]
    if x.size < 2 or np.ptp(x) == 0.0:
        return None
    centered = x - x.mean()
    spread = float(centered @ centered)
    slope = float(centered @ y) / spread
    at_zero = float(y.mean() - slope * x.mean())
    per_kg = "1/kg" if unit == "1" else f"{unit}/kg"
    leverage = 1.0 / x.size + centered**2 / spread
    if x.size < 3 or leverage.max() > 1.0 - 1e-9:
        return Trend(Estimate(slope, per_kg), at_zero, int(x.size), "undecided")
    residual = (y - at_zero - slope * x) / (1.0 - leverage)
    error = float(np.sqrt(centered**2 @ residual**2)) / spread
    half = float(stdtrit(x.size - 2, 0.5 + 0.5 * _LEVEL)) * error
    low, high = slope - half, slope + half
    verdict = "grows" if low > 0 else "falls" if high < 0 else "undecided"
    return Trend(Estimate(slope, per_kg, low, high), at_zero, int(x.size), verdict)


def trends_of(
    result: GapResult, payload_kg: Mapping[str, float | None], *, signal: str = "position"
) -> dict[str, dict[str, dict[str, Trend]]]:
    """Run -> metric -> joint -> trend, over the motions whose payload is known; `""` is the mean of the scored joints.

    Args:
        result: with values motion by motion.
        payload_kg: motion -> payload [kg].
        signal: whose error and lag.
    """
    trends: dict[str, dict[str, dict[str, Trend]]] = {}
    for run, episodes in result.episodes.items():
        known = [name for name in episodes if payload_kg.get(name) is not None]
        loads = np.array([float(payload_kg[name] or 0.0) for name in known])
        for metric in TREND_METRICS:
            units = _units(result, run, signal, metric)
            rows = [episodes[name].get(signal, {}).get(metric, {}) for name in known]
            columns = {joint: np.array([row.get(joint, np.nan) for row in rows], dtype=np.float64) for joint in units}
            scored = [columns[joint] for joint in result.scored_joints if joint in columns]
            if scored:
                unit = units[next(joint for joint in result.scored_joints if joint in units)]
                columns, units = {"": _mean(np.stack(scored)), **columns}, {"": unit, **units}
            found = {joint: trend(loads, values, units[joint]) for joint, values in columns.items()}
            kept = {joint: item for joint, item in found.items() if item is not None}
            if kept:
                trends.setdefault(run, {})[metric] = kept
    return trends


def _units(result: GapResult, run: str, signal: str, metric: str) -> dict[str, str]:
    for split in result.runs.get(run, {}).values():
        found = split.get(signal, {}).get(metric)
        if found is not None:
            return {joint: item.unit for joint, item in found.per_joint.items()}
    return {}


def _mean(rows: Float64[np.ndarray, "S E"]) -> Float64[np.ndarray, "E"]:
    valid = np.isfinite(rows)
    count = valid.sum(axis=0)
    total = np.where(valid, rows, 0.0).sum(axis=0)
    return np.asarray(np.divide(total, count, out=np.full(rows.shape[1], np.nan), where=count > 0))
