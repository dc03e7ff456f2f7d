"""The same motion again: under another condition, or with another payload (GapONet, 3.3 and Figure 3a)."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64
from scipy.spatial import cKDTree

from trueup.core.engines import ANY_PAYLOAD, MEASURED, JointPlane, Repeated, Shift
from trueup.core.episode import EpisodeMeta
from trueup.core.interpolation import columns_at
from trueup.core.ordering import by_number
from trueup.core.results import Estimate, GapResult
from trueup.measure.columns import mean
from trueup.measure.comparison import COMMAND_RUN, Comparison
from trueup.measure.metrics.base import SHARE
from trueup.measure.uncertainty import bootstrap_interval, estimate

# What a condition may change of the gap; lag and saturation as in section 3.2.
SHIFT_METRICS: Mapping[str, tuple[str, ...]] = {
    "position": ("rmse", "nrmse", "phase_lag"),
    "torque": ("saturation_measured",),
}
_MOST_MOTIONS = 60
_MOST_EPISODES = 480
_MOST_POINTS = 250  # of a path that is compared
_FINER = 4  # points of the other path for each of them
_SAME_COMMAND = 0.05  # of the size of a motion


def conditions_repeat(metas: Iterable[EpisodeMeta]) -> bool:
    """Whether a motion was executed under two conditions."""
    found: dict[str, set[str]] = {}
    for meta in metas:
        if meta.condition:
            found.setdefault(meta.executed, set()).add(meta.condition)
    return any(len(conditions) > 1 for conditions in found.values())


@dataclass(frozen=True, eq=False)
class _Kept:
    meta: EpisodeMeta
    time_s: Float64[np.ndarray, "T"]
    measured: Float32[np.ndarray, "T J"]
    command: Float32[np.ndarray, "T J"] | None


class RepeatBuilder:
    """Keeps the measured paths of motions that are executed again and again, in bounded memory."""

    def __init__(self, joints: Sequence[str] | None = None) -> None:
        self._wanted = joints
        self._joints: tuple[str, ...] = ()
        self._unit = ""
        self._kept: dict[str, list[_Kept]] = {}
        self._count = 0

    def add(self, comparison: Comparison) -> None:
        """Take in one episode; without measured positions it is left out."""
        measured = comparison.measured
        executed = comparison.meta.executed
        room = len(self._kept) < _MOST_MOTIONS or executed in self._kept
        if "position" not in measured or not room or self._count >= _MOST_EPISODES:
            return
        if not self._joints:
            units = dict(zip(measured.joints, measured.units["position"], strict=True))
            wanted = [name for name in (self._wanted or measured.joints) if name in units]
            self._unit = units[wanted[0]] if wanted else ""
            self._joints = tuple(name for name in wanted if units[name] == self._unit)
        columns = [measured.joints.index(name) for name in self._joints]
        values = measured["position"][:, columns]
        known = np.isfinite(values).all(axis=1)
        if known.sum() < 2:
            return
        command = None
        if comparison.command is not None and "position" in comparison.command:
            command = comparison.command.select(self._joints)["position"][known].astype(np.float32)
        clock = measured.time_s[known] - measured.time_s[0]
        self._kept.setdefault(executed, []).append(
            _Kept(comparison.meta, clock, values[known].astype(np.float32), command)
        )
        self._count += 1

    def shifts(self, gap: GapResult, *, seed: int = 0) -> tuple[Shift, ...]:
        """What other conditions and payloads change, each compared with the first, over whole motions.

        Args:
            gap: with the metrics of each episode.
            seed: of the bootstrap.
        """
        rows: dict[tuple[Repeated, str, str], dict[str, list[dict[str, float]]]] = {}
        loads = {item.meta.payload_kg for episodes in self._kept.values() for item in episodes} - {None}
        lightest = f"{min((load for load in loads if load is not None), default=0.0):.12g}"
        for executed, episodes in self._kept.items():
            for first, second in itertools.permutations(episodes, 2):
                key = _changed(first.meta, second.meta)
                if key is None or (key[0] == "payload_kg" and key[1] != lightest):
                    continue
                if _same_command(first, second):
                    row = {**_path_shift(first, second), **_gap_shift(gap, first.meta.id, second.meta.id)}
                    rows.setdefault(key, {}).setdefault(executed, []).append(row)
        return tuple(
            self._shift(gap, *key, found, seed)
            for key, found in sorted(
                rows.items(), key=lambda item: (item[0][0], by_number(item[0][1]), by_number(item[0][2]))
            )
        )

    def inside(self, plane: JointPlane, *, seed: int = 0) -> dict[str, Estimate]:
        """Condition -> share of its measured samples within two standard deviations of all motions in the plane."""
        envelope = plane.envelopes[MEASURED][ANY_PAYLOAD]
        xx, xy, yy = envelope.covariance
        if plane.joints != self._joints or xx * yy <= xy**2:
            return {}
        inverse = np.linalg.inv(np.array([[xx, xy], [xy, yy]]))
        shares: dict[str, dict[str, list[float]]] = {}
        for executed, episodes in self._kept.items():
            for item in episodes:
                points = (item.measured - np.array(plane.center)) @ np.array(plane.axes).T - envelope.center
                distance = np.einsum("ij,jk,ik->i", points, inverse, points)
                own = shares.setdefault(item.meta.condition, {})
                own.setdefault(executed, []).append(float(np.mean(distance <= 4.0)))
        result = {}
        for condition, motions in shares.items():
            if condition:
                values = np.array([[np.mean(items)] for items in motions.values()])
                low, high = bootstrap_interval(values, seed=seed)
                result[condition] = estimate(float(values.mean()), "1", float(low[0]), float(high[0]), SHARE)
        return result

    def _shift(
        self,
        gap: GapResult,
        by: Repeated,
        first: str,
        second: str,
        motions: Mapping[str, Sequence[Mapping[str, float]]],
        seed: int,
    ) -> Shift:
        names = list(dict.fromkeys(name for rows in motions.values() for row in rows for name in row))
        table = np.stack(
            [
                mean(np.array([[row.get(name, np.nan) for name in names] for row in rows], dtype=np.float64))
                for rows in motions.values()
            ]
        )
        low, high = bootstrap_interval(table, seed=seed)
        value = mean(table)
        units = {"path": self._unit, "share": "1", "offset": self._unit, "lag": "s"}
        numbers, gaps = {}, dict[str, dict[str, Estimate]]()
        for k, name in enumerate(names):
            ends = float(low[k]), float(high[k])
            if name in units:
                bounds = (-np.inf, np.inf) if name == "lag" else (0.0, np.inf)
                numbers[name] = estimate(float(value[k]), units[name], *ends, bounds)
                continue
            run, _, metric = name.partition("\0")
            signal, _, kind = metric.partition(".")
            if np.isfinite(value[k]):
                unit = gap.runs[run]["all"][signal][kind].total.unit
                gaps.setdefault(run, {})[metric] = estimate(float(value[k]), unit, *ends)
        numbers.setdefault("lag", Estimate(np.nan, "s"))
        return Shift(by, first, second, len(motions), **numbers, gaps=gaps)


def _changed(first: EpisodeMeta, second: EpisodeMeta) -> tuple[Repeated, str, str] | None:
    """What alone differs between two episodes, from the smaller to the larger; None if it is not one thing."""
    loads = first.payload_kg, second.payload_kg
    if first.unit != second.unit or first.kp_setting != second.kp_setting:
        return None
    if loads[0] == loads[1] and first.condition and first.condition < second.condition:
        return "condition", first.condition, second.condition
    if first.condition == second.condition and None not in loads and (loads[0] or 0.0) < (loads[1] or 0.0):
        return "payload_kg", f"{loads[0]:.12g}", f"{loads[1]:.12g}"
    return None


def _same_command(first: _Kept, second: _Kept) -> bool:
    """Whether two episodes were told to do the same, as far as it is known: a name alone may be that of a file."""
    if first.command is None or second.command is None:
        return True
    at = np.linspace(0.0, min(first.time_s[-1], second.time_s[-1]), 100)
    values = [_at(item.command, item.time_s, at) for item in (first, second)]
    size = float(np.sqrt(values[0].var(axis=0).sum()))
    distance = float(np.sqrt(((values[1] - values[0]) ** 2).sum(axis=1).mean()))
    return distance <= _SAME_COMMAND * size or distance < 1e-9


def _path_shift(first: _Kept, second: _Kept) -> dict[str, float]:
    end = min(first.time_s[-1], second.time_s[-1])
    count = min(max(2, int((first.time_s <= end).sum())), _MOST_POINTS)
    at, finer = np.linspace(0.0, end, count), np.linspace(0.0, end, _FINER * count)
    here, there = (_at(item.measured, item.time_s, at) for item in (first, second))
    joints = here.shape[1]
    squares = []
    for points, other in ((here, second), (there, first)):
        squares.append(np.mean(_distance(points, _at(other.measured, other.time_s, finer)) ** 2))
    path = float(np.sqrt(np.mean(squares) / joints))
    size = float(np.sqrt(here.var(axis=0).sum() / joints))
    offset = float(np.linalg.norm((there - here).mean(axis=0)) / np.sqrt(joints))
    return {"path": path, "share": path / size if size > 0.0 else np.nan, "offset": offset}


def _distance(points: Float64[np.ndarray, "N J"], path: Float64[np.ndarray, "M J"]) -> Float64[np.ndarray, "N"]:
    """How far each point is from a polyline, next to its nearest corner."""
    _, nearest = cKDTree(path).query(points)
    found = np.full(len(points), np.inf)
    for first in (np.maximum(nearest - 1, 0), np.minimum(nearest, len(path) - 2)):
        along = path[first + 1] - path[first]
        length = np.maximum((along**2).sum(axis=1), 1e-300)
        share = np.clip(((points - path[first]) * along).sum(axis=1) / length, 0.0, 1.0)
        found = np.minimum(found, np.linalg.norm(points - path[first] - share[:, None] * along, axis=1))
    return found


def _gap_shift(gap: GapResult, first: str, second: str) -> dict[str, float]:
    """RUN, a zero byte and SIGNAL.METRIC -> the second minus the first; `lag` is that behind the command."""
    result = {}
    for run, episodes in gap.episodes.items():
        for signal, metrics in SHIFT_METRICS.items():
            for metric in metrics:
                values = [
                    _scored(gap, episodes.get(name, {}).get(signal, {}).get(metric, {})) for name in (first, second)
                ]
                result[f"{run}\0{signal}.{metric}"] = values[1] - values[0]
    if f"{COMMAND_RUN}\0position.phase_lag" in result:
        result["lag"] = result[f"{COMMAND_RUN}\0position.phase_lag"]
    return result


def _scored(gap: GapResult, joints: Mapping[str, float]) -> float:
    values = np.array([[joints.get(name, np.nan)] for name in gap.scored_joints], dtype=np.float64)
    return float(mean(values)[0])


def _at(
    values: Float32[np.ndarray, "T J"] | None, time_s: Float64[np.ndarray, "T"], at: Float64[np.ndarray, "N"]
) -> Float64[np.ndarray, "N J"]:
    assert values is not None
    return columns_at(at, time_s, values)
