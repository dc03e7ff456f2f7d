"""Payloads, conditions and engines side by side: `engines.json`, the numbers behind the gap analysis of the report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from trueup.core.atomic import read_json, write_json
from trueup.core.config import read_versioned
from trueup.core.results import Estimate, PairedDifference

ENGINES_SCHEMA = "trueup.engines/1"
MEASURED = "measured"
ANY_PAYLOAD = ""

TrendVerdict = Literal["grows", "falls", "undecided"]
Repeated = Literal["condition", "payload_kg"]
TrendShape = Literal["straight", "bends up", "bends down", "undecided"]


@dataclass(frozen=True)
class Trend:
    """How a metric changes with the payload: a straight line through the motions.

    Attributes:
        slope: change per kilogram with its 95 % interval, in the metric's unit per kg.
        at_zero: the line's value without payload, in the metric's unit.
        motions: number of motions.
        verdict: `grows` or `falls` where the interval excludes zero, else `undecided`.
        bend: how much lower a parabola through the motions is at the middle of the payloads than halfway between its
            values at their ends, in the metric's unit; None with fewer than three payloads.
        shape: `straight` where the interval of the bend is within a tenth of the change over all payloads, `bends up`
            (the heavier, the faster) or `bends down` where it excludes zero, else `undecided`.
    """

    slope: Estimate
    at_zero: float
    motions: int
    verdict: TrendVerdict
    bend: Estimate | None = None
    shape: TrendShape = "undecided"

    def to_json(self) -> dict[str, Any]:
        """JSON object."""
        at_zero = self.at_zero if math.isfinite(self.at_zero) else None
        return {
            "slope": self.slope.to_json(),
            "at_zero": at_zero,
            "motions": self.motions,
            "verdict": self.verdict,
            "bend": None if self.bend is None else self.bend.to_json(),
            "shape": self.shape,
        }

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> Trend:
        """Read back what `to_json` wrote."""
        at_zero = math.nan if data["at_zero"] is None else data["at_zero"]
        bend = None if data.get("bend") is None else Estimate.from_json(data["bend"])
        shape = data.get("shape", "undecided")
        return Trend(Estimate.from_json(data["slope"]), at_zero, data["motions"], data["verdict"], bend, shape)


@dataclass(frozen=True)
class Envelope:
    """Where the motions of one source lie in the plane: mean and covariance of all its samples.

    Attributes:
        center: (x, y).
        covariance: (xx, xy, yy).
        samples: how many.
    """

    center: tuple[float, float]
    covariance: tuple[float, float, float]
    samples: int


@dataclass(frozen=True)
class JointPlane:
    """The plane of the two main axes of the measured joint positions, and what lies in it (GapONet, Figure 3a).

    Attributes:
        joints: the joints that span the space.
        unit: of their positions.
        center: mean measured position of each joint.
        axes: the two unit vectors over the joints, the one of larger variance first.
        share: share of the measured variance along each.
        envelopes: source (`measured` or a run) -> payload in kg as text (`""`: all motions) -> envelope.
        paths: motion -> source -> thinned (x, y) points.
        payloads: motion -> payload in kg as text, `""` where it was not recorded.
        conditions: motion -> condition, `""` where it was not recorded.
        executed: motion -> what was executed; the repetitions of a motion have the same.
    """

    joints: tuple[str, ...]
    unit: str
    center: tuple[float, ...]
    axes: tuple[tuple[float, ...], tuple[float, ...]]
    share: tuple[float, float]
    envelopes: Mapping[str, Mapping[str, Envelope]]
    paths: Mapping[str, Mapping[str, Sequence[tuple[float, float]]]]
    payloads: Mapping[str, str]
    conditions: Mapping[str, str] = field(default_factory=dict)
    executed: Mapping[str, str] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """JSON object."""
        return {
            "joints": list(self.joints),
            "unit": self.unit,
            "center": list(self.center),
            "axes": [list(axis) for axis in self.axes],
            "share": list(self.share),
            "envelopes": {
                source: {
                    payload: {
                        "center": list(item.center),
                        "covariance": list(item.covariance),
                        "samples": item.samples,
                    }
                    for payload, item in items.items()
                }
                for source, items in self.envelopes.items()
            },
            "paths": {
                motion: {source: [list(point) for point in points] for source, points in sources.items()}
                for motion, sources in self.paths.items()
            },
            "payloads": dict(self.payloads),
            "conditions": dict(self.conditions),
            "executed": dict(self.executed),
        }

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> JointPlane:
        """Read back what `to_json` wrote."""
        first, second = (tuple(axis) for axis in data["axes"])
        return JointPlane(
            joints=tuple(data["joints"]),
            unit=data["unit"],
            center=tuple(data["center"]),
            axes=(first, second),
            share=_pair(data["share"]),
            envelopes={
                source: {payload: _envelope(item) for payload, item in items.items()}
                for source, items in data["envelopes"].items()
            },
            paths={
                motion: {source: [_pair(point) for point in points] for source, points in sources.items()}
                for motion, sources in data["paths"].items()
            },
            payloads=data["payloads"],
            conditions=data.get("conditions", {}),
            executed=data.get("executed", {}),
        )


@dataclass(frozen=True)
class Shift:
    """What changes when motions are repeated under another condition, or with another payload (GapONet 3.3).

    Attributes:
        by: `condition` or `payload_kg`.
        first: what is compared with.
        second: what is compared.
        motions: number of motions that were executed under both.
        path: RMS distance of the measured joint path from that under the first, whatever the time at which a posture is
            passed, per joint.
        share: that distance over the size of the motion, i.e. the standard deviation of its samples.
        offset: how far the mean posture moves, per joint.
        lag: how much later behind the command the robot is than under the first [s].
        gaps: run -> `SIGNAL.METRIC` -> the metric under the second minus that under the first.
    """

    by: Repeated
    first: str
    second: str
    motions: int
    path: Estimate
    share: Estimate
    offset: Estimate
    lag: Estimate
    gaps: Mapping[str, Mapping[str, Estimate]] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """JSON object."""
        numbers = {name: getattr(self, name).to_json() for name in _SHIFTED}
        gaps = {run: {name: item.to_json() for name, item in items.items()} for run, items in self.gaps.items()}
        plain = {"by": self.by, "first": self.first, "second": self.second, "motions": self.motions}
        return {**plain, **numbers, "gaps": gaps}

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> Shift:
        """Read back what `to_json` wrote."""
        gaps = {
            run: {name: Estimate.from_json(item) for name, item in items.items()} for run, items in data["gaps"].items()
        }
        numbers = {name: Estimate.from_json(data[name]) for name in _SHIFTED}
        return Shift(data["by"], data["first"], data["second"], data["motions"], **numbers, gaps=gaps)


_SHIFTED = ("path", "share", "offset", "lag")


@dataclass(frozen=True)
class EngineComparison:
    """The content of engines.json.

    Attributes:
        trends: run -> signal -> metric -> joint (`""`: mean of the scored joints) -> trend; empty unless two or more
            payloads were recorded.
        plane: None where positions of fewer than two joints were measured.
        shifts: repetitions of motions under other conditions and with other payloads.
        inside: condition -> share of its samples that lie within the ellipse of all motions in the plane.
        nearer: payload in kg as text (`""`: all motions) -> engine against engine on the same motions.
        missing: part of the analysis -> why there is none, and what it would need.
        provenance: versions, git hash, data hash.
    """

    trends: Mapping[str, Mapping[str, Mapping[str, Mapping[str, Trend]]]] = field(default_factory=dict)
    plane: JointPlane | None = None
    shifts: tuple[Shift, ...] = ()
    inside: Mapping[str, Estimate] = field(default_factory=dict)
    nearer: Mapping[str, tuple[PairedDifference, ...]] = field(default_factory=dict)
    missing: Mapping[str, str] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def save(self, path: Path) -> None:
        """Write engines.json atomically."""
        trends = {
            run: {
                signal: {
                    metric: {joint: item.to_json() for joint, item in joints.items()}
                    for metric, joints in metrics.items()
                }
                for signal, metrics in signals.items()
            }
            for run, signals in self.trends.items()
        }
        plane = None if self.plane is None else self.plane.to_json()
        content = {
            "schema": ENGINES_SCHEMA,
            "trends": trends,
            "plane": plane,
            "shifts": [item.to_json() for item in self.shifts],
            "inside": {name: item.to_json() for name, item in self.inside.items()},
            "nearer": {payload: [item.to_json() for item in items] for payload, items in self.nearer.items()},
            "missing": dict(self.missing),
            "provenance": dict(self.provenance),
        }
        write_json(path, content)

    @staticmethod
    def load(path: Path) -> EngineComparison:
        """Read engines.json.

        Raises:
            FormatError: another kind of file, or another version.
            DataError: the file is broken.
        """
        return read_versioned(
            EngineComparison._read, read_json(path), str(path), schema=ENGINES_SCHEMA, what="comparison of engines"
        )

    @staticmethod
    def _read(data: Mapping[str, Any]) -> EngineComparison:
        return EngineComparison(
            trends={
                run: {
                    signal: {
                        metric: {joint: Trend.from_json(item) for joint, item in joints.items()}
                        for metric, joints in metrics.items()
                    }
                    for signal, metrics in signals.items()
                }
                for run, signals in data["trends"].items()
            },
            plane=None if data["plane"] is None else JointPlane.from_json(data["plane"]),
            shifts=tuple(Shift.from_json(item) for item in data.get("shifts", ())),
            inside={name: Estimate.from_json(item) for name, item in data.get("inside", {}).items()},
            nearer={
                payload: tuple(PairedDifference.from_json(item) for item in items)
                for payload, items in data.get("nearer", {}).items()
            },
            missing=data.get("missing", {}),
            provenance=data.get("provenance", {}),
        )


def _pair(values: Sequence[Any]) -> tuple[Any, Any]:
    x, y = values
    return x, y


def _envelope(data: Mapping[str, Any]) -> Envelope:
    xx, xy, yy = data["covariance"]
    return Envelope(_pair(data["center"]), (xx, xy, yy), data["samples"])
