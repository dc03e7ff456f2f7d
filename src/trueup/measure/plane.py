"""Principal components of joint trajectories: do two engines and two payloads move through the same postures?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64

from trueup.core.engines import ANY_PAYLOAD, MEASURED, Envelope, JointPlane
from trueup.measure.comparison import Comparison

_MOST_MOTIONS = 24
_MOST_REPEATED = 4
_MOST_REPETITIONS = 48
_MOST_POINTS = 150


@dataclass
class _Moments:
    """Count, mean and scatter of J columns, taken in part by part (Chan, Golub and LeVeque 1983)."""

    count: int = 0
    mean: np.ndarray = field(default_factory=lambda: np.zeros(0))
    scatter: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

    def add(self, values: Float64[np.ndarray, "T J"]) -> None:
        values = values[np.isfinite(values).all(axis=1)]
        if not len(values):
            return
        mean = values.mean(axis=0)
        centered = values - mean
        if self.count == 0:
            self.count, self.mean, self.scatter = len(values), mean, centered.T @ centered
            return
        total, shift = self.count + len(values), mean - self.mean
        weight = self.count * len(values) / total
        self.scatter = self.scatter + centered.T @ centered + weight * np.outer(shift, shift)
        self.mean = self.mean + shift * len(values) / total
        self.count = total


class PlaneBuilder:
    """Collects the joint positions of measured and simulated motions, in bounded memory.

    Args:
        joints: the joints that span the space; None for all of the first episode. Joints in another unit than the
            first one's are left out.
    """

    def __init__(self, joints: Sequence[str] | None = None) -> None:
        self._wanted = joints
        self._joints: tuple[str, ...] = ()
        self._unit = ""
        self._moments: dict[tuple[str, str], _Moments] = {}
        self._curves: dict[str, dict[str, np.ndarray]] = {}
        self._payloads: dict[str, str] = {}
        self._conditions: dict[str, str] = {}
        self._executed: dict[str, str] = {}

    def add(self, comparison: Comparison) -> None:
        """Take in one episode; without measured positions it is left out."""
        measured = comparison.measured
        if "position" not in measured:
            return
        if not self._joints:
            known = dict(zip(measured.joints, measured.units["position"], strict=True))
            wanted = [name for name in (self._wanted or measured.joints) if name in known]
            self._unit = known[wanted[0]] if wanted else ""
            self._joints = tuple(name for name in wanted if known[name] == self._unit)
        load = comparison.meta.payload_kg
        payload = ANY_PAYLOAD if load is None else f"{load:.12g}"
        columns = [measured.joints.index(name) for name in self._joints]
        curves = {MEASURED: measured["position"][:, columns].astype(np.float64)}
        for label in comparison.simulated:
            run = comparison.run(label)
            if "position" in run:
                curves[label] = run["position"][:, columns].astype(np.float64)
        for source, values in curves.items():
            for group in {ANY_PAYLOAD, payload}:
                self._moments.setdefault((source, group), _Moments()).add(values)
        # Every payload has a motion to show, and the first motions all their repetitions, as far as there is room.
        executed = comparison.meta.executed
        new = payload not in self._payloads.values()
        again = executed in list(dict.fromkeys(self._executed.values()))[:_MOST_REPEATED]
        count = len(self._curves)
        if count < _MOST_MOTIONS // 2 or (new and count < _MOST_MOTIONS) or (again and count < _MOST_REPETITIONS):
            stride = max(1, -(-len(measured) // _MOST_POINTS))
            self._curves[comparison.meta.id] = {source: values[::stride] for source, values in curves.items()}
            self._payloads[comparison.meta.id] = payload
            self._conditions[comparison.meta.id] = comparison.meta.condition
            self._executed[comparison.meta.id] = executed

    def result(self) -> JointPlane | None:
        """The plane; None without two joints that move."""
        measured = self._moments.get((MEASURED, ANY_PAYLOAD))
        if measured is None or measured.count < 3 or len(self._joints) < 2:
            return None
        variances, vectors = np.linalg.eigh(measured.scatter / measured.count)
        if variances[-2] <= 0.0:
            return None
        axes = vectors[:, [-1, -2]].T
        # An axis has no sign of its own: its largest part is positive.
        axes = axes * np.sign(axes[np.arange(2), np.abs(axes).argmax(axis=1)])[:, None]
        share = variances[[-1, -2]] / variances.sum()
        envelopes: dict[str, dict[str, Envelope]] = {}
        for (source, payload), moments in sorted(self._moments.items()):
            if moments.count:
                x, y = (axes @ (moments.mean - measured.mean)).tolist()
                cov = axes @ (moments.scatter / moments.count) @ axes.T
                spread = (float(cov[0, 0]), float(cov[0, 1]), float(cov[1, 1]))
                envelopes.setdefault(source, {})[payload] = Envelope((x, y), spread, moments.count)
        paths: dict[str, dict[str, list[tuple[float, float]]]] = {}
        for motion, curves in self._curves.items():
            paths[motion] = {}
            for source, values in curves.items():
                seen = values[np.isfinite(values).all(axis=1)]
                points = (seen - measured.mean) @ axes.T
                paths[motion][source] = [(_short(x), _short(y)) for x, y in points.tolist()]
        return JointPlane(
            joints=self._joints,
            unit=self._unit,
            center=tuple(measured.mean.tolist()),
            axes=(tuple(axes[0].tolist()), tuple(axes[1].tolist())),
            share=(float(share[0]), float(share[1])),
            envelopes=envelopes,
            paths=paths,
            payloads=dict(self._payloads),
            conditions=dict(self._conditions),
            executed=dict(self._executed),
        )


def _short(value: float) -> float:
    """Five significant digits, enough for a drawing."""
    return float(f"{value:.5g}")
