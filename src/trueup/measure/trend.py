"""How the gap changes with the payload (GapONet, 3.3: heavier payloads yield larger gaps and longer delays)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64
from scipy.special import stdtrit

from trueup.core.engines import Trend, TrendShape, TrendVerdict
from trueup.core.results import Estimate, GapResult
from trueup.measure.columns import mean
from trueup.measure.uncertainty import LEVEL

# Signal -> metrics: errors of what a payload changes first, the lag, and how often motors reach their limit.
TREND_METRICS: Mapping[str, tuple[str, ...]] = {
    "position": ("rmse", "nrmse", "phase_lag"),
    "velocity": ("rmse",),
    "torque": ("rmse", "saturation_measured", "saturation_simulated"),
}
_FEWEST_PAIRS = 3
# A bend that is surely smaller than this share of the change over all payloads is none.
_STRAIGHT = 0.1


def trend(
    payload_kg: Float64[np.ndarray, "E"],
    values: Float64[np.ndarray, "E"],
    unit: str,
    *,
    motions: Sequence[str] | None = None,
) -> Trend | None:
    """The straight line of a metric over the payload, by least squares over motions.

    Where at least three motions were repeated with another payload, the slope is that within motions: each motion has a
    level of its own, which no longer hides what the payload does, and motions without a repetition do not count. Its
    interval is Student's t with a covariance that is robust to what the repetitions of a motion have in common (Liang
    and Zeger 1986). Otherwise the interval is Student's t with the covariance HC3 (MacKinnon and White 1985), since
    motions with a payload scatter more than those without. Whether the dependence is curved, a parabola through the
    same motions says, with an interval made in the same way.

    Args:
        payload_kg: one per motion, (E,) [kg].
        values: one per motion, (E,); NaN where it is not defined, which leaves the motion out.
        unit: of the values.
        motions: name of the motion that was executed, one per motion; equal names are repetitions. All differ if None.

    Returns:
        None with fewer than two different payloads; without interval with fewer than three motions, or where a single
        motion alone decides about the line.
    """
    valid = np.isfinite(values) & np.isfinite(payload_kg)
    x, y = payload_kg[valid], values[valid]
    if x.size < 2 or np.ptp(x) == 0.0:
        return None
    if motions is not None:
        names = np.asarray(motions, dtype=str)[valid]
        repeated = _within(x, y, names, unit)
        if repeated is not None:
            return _bent(repeated, x, y, np.unique(names, return_inverse=True)[1], unit)
    return _bent(_across(x, y, unit), x, y, None, unit)


def _across(x: Float64[np.ndarray, "E"], y: Float64[np.ndarray, "E"], unit: str) -> Trend:
    """The slope over motions that are no repetitions of each other."""
    centered = x - x.mean()
    spread = float(centered @ centered)
    slope = float(centered @ y) / spread
    at_zero = float(y.mean() - slope * x.mean())
    per_kg = _per_kg(unit)
    leverage = 1.0 / x.size + centered**2 / spread
    if x.size < 3 or leverage.max() > 1.0 - 1e-9:
        return Trend(Estimate(slope, per_kg), at_zero, int(x.size), "undecided")
    residual = (y - at_zero - slope * x) / (1.0 - leverage)
    error = float(np.sqrt(centered**2 @ residual**2)) / spread
    return _judged(slope, error, x.size - 2, at_zero, x.size, per_kg)


def _within(x: Float64[np.ndarray, "E"], y: Float64[np.ndarray, "E"], names: np.ndarray, unit: str) -> Trend | None:
    """The slope within repeated motions; None if fewer than three were repeated with another payload."""
    _, motion = np.unique(names, return_inverse=True)
    count = np.bincount(motion)
    across = x - (np.bincount(motion, x) / count)[motion]
    along = y - (np.bincount(motion, y) / count)[motion]
    moved = np.bincount(motion, across**2)
    pairs = int(np.count_nonzero(moved > 0.0))
    if pairs < _FEWEST_PAIRS:
        return None
    spread = float(moved.sum())
    slope = float(across @ along) / spread
    score = np.bincount(motion, across * (along - slope * across))
    error = float(np.sqrt(pairs / (pairs - 1) * score @ score)) / spread
    used = moved[motion] > 0.0
    at_zero = float(y[used].mean() - slope * x[used].mean())
    return _judged(slope, error, pairs - 1, at_zero, int(used.sum()), _per_kg(unit))


def _judged(slope: float, error: float, freedom: int, at_zero: float, motions: int, per_kg: str) -> Trend:
    half = float(stdtrit(freedom, 0.5 + 0.5 * LEVEL)) * error
    low, high = slope - half, slope + half
    verdict: TrendVerdict = "grows" if low > 0 else "falls" if high < 0 else "undecided"
    return Trend(Estimate(slope, per_kg, low, high), at_zero, int(motions), verdict)


def _bent(
    line: Trend, x: Float64[np.ndarray, "E"], y: Float64[np.ndarray, "E"], motion: np.ndarray | None, unit: str
) -> Trend:
    """The line with what a parabola says about its shape.

    Args:
        line: the straight line.
        x: payloads.
        y: values.
        motion: number of the motion that was executed, one per value; None where none is repeated.
        unit: of the values.
    """
    if np.unique(x).size < 3:
        return line
    half = 0.5 * float(np.ptp(x))
    # In these coordinates the coefficient of the square is the bend.
    scaled = (x - x.min()) / half - 1.0
    powers = [scaled, scaled**2]
    if motion is None:
        design, cluster = np.column_stack([np.ones(x.size), *powers]), np.arange(x.size)
    else:
        count = np.bincount(motion)
        design = np.column_stack([item - (np.bincount(motion, item) / count)[motion] for item in powers])
        y, cluster = y - (np.bincount(motion, y) / count)[motion], motion
    gram = design.T @ design
    freedom = np.unique(cluster[np.abs(design).max(axis=1) > 0.0]).size - (1 if motion is not None else 3)
    if freedom < 1 or np.linalg.cond(gram) > 1e10:
        return line
    inverse = np.linalg.inv(gram)
    values = inverse @ design.T @ y
    residual = y - design @ values
    if motion is None:
        leverage = np.einsum("ij,jk,ik->i", design, inverse, design)
        if leverage.max() > 1.0 - 1e-9:
            return line
        scores = design * (residual / (1.0 - leverage))[:, None]
    else:
        scores = np.stack([np.bincount(cluster, column * residual) for column in design.T], axis=1)
        scores *= np.sqrt((freedom + 1) / freedom)
    error = float(np.linalg.norm(scores @ inverse[-1]))
    reach = float(stdtrit(freedom, 0.5 + 0.5 * LEVEL)) * error
    bend = float(values[-1])
    low, high = bend - reach, bend + reach
    change = 2.0 * half * abs(line.slope.value)
    shape: TrendShape = "bends up" if low > 0.0 else "bends down" if high < 0.0 else "undecided"
    if line.verdict != "undecided" and max(-low, high) <= _STRAIGHT * change:
        shape = "straight"
    return replace(line, bend=Estimate(bend, unit, low, high), shape=shape)


def _per_kg(unit: str) -> str:
    return "1/kg" if unit == "1" else f"{unit}/kg"


def trends_of(
    result: GapResult, payload_kg: Mapping[str, float | None], *, motions: Mapping[str, str] | None = None
) -> dict[str, dict[str, dict[str, dict[str, Trend]]]]:
    """Run -> signal -> metric -> joint -> trend; `""` is the mean of the scored joints.

    Episodes whose payload is not known are left out.

    Args:
        result: with values episode by episode.
        payload_kg: episode -> payload [kg].
        motions: episode -> the motion that was executed, the same for its repetitions with another payload.
    """
    trends: dict[str, dict[str, dict[str, dict[str, Trend]]]] = {}
    for run, episodes in result.episodes.items():
        known = [name for name in episodes if payload_kg.get(name) is not None]
        loads = np.array([float(payload_kg[name] or 0.0) for name in known])
        repeated = None if motions is None else [motions.get(name) or name for name in known]
        for signal, metric in ((signal, metric) for signal, own in TREND_METRICS.items() for metric in own):
            units = _units(result, run, signal, metric)
            rows = [episodes[name].get(signal, {}).get(metric, {}) for name in known]
            columns = {joint: np.array([row.get(joint, np.nan) for row in rows], dtype=np.float64) for joint in units}
            scored = [columns[joint] for joint in result.scored_joints if joint in columns]
            if scored:
                unit = units[next(joint for joint in result.scored_joints if joint in units)]
                columns, units = {"": mean(np.stack(scored)), **columns}, {"": unit, **units}
            found = {joint: trend(loads, values, units[joint], motions=repeated) for joint, values in columns.items()}
            kept = {joint: item for joint, item in found.items() if item is not None}
            if kept:
                trends.setdefault(run, {}).setdefault(signal, {})[metric] = kept
    return trends


def _units(result: GapResult, run: str, signal: str, metric: str) -> dict[str, str]:
    for split in result.runs.get(run, {}).values():
        found = split.get(signal, {}).get(metric)
        if found is not None:
            return {joint: item.unit for joint, item in found.per_joint.items()}
    return {}
