"""Results that other programs rely on: `gap.json` and `ladder.json`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from trueup.core.atomic import read_json, without_nan, write_json
from trueup.core.config import read_versioned

GAP_SCHEMA = "trueup.gap/1"
LADDER_SCHEMA = "trueup.ladder/1"

Verdict = Literal["better", "worse", "undecided"]


@dataclass(frozen=True)
class Estimate:
    """A number with its unit and 95 % interval.

    Attributes:
        value: the estimate; NaN when it is not defined (e.g. a correlation with a constant).
        unit: its unit, `1` for a pure number.
        low: lower end of the interval, None where there is none (a single episode).
        high: upper end of the interval.
    """

    value: float
    unit: str
    low: float | None = None
    high: float | None = None

    def to_json(self) -> dict[str, Any]:
        """JSON object; a NaN becomes null."""
        return {"value": _number(self.value), "low": _number(self.low), "high": _number(self.high), "unit": self.unit}

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> Estimate:
        """Read back what `to_json` wrote."""
        value = math.nan if data["value"] is None else data["value"]
        return Estimate(value=value, unit=data["unit"], low=data.get("low"), high=data.get("high"))


@dataclass(frozen=True)
class MetricResult:
    """One metric of one signal: over the scored joints, and joint by joint.

    Attributes:
        total: mean over episodes of the mean over scored joints.
        per_joint: mean over episodes, for every joint (also those that are not scored).
        episodes: number of episodes it was computed from.
    """

    total: Estimate
    per_joint: Mapping[str, Estimate]
    episodes: int

    def to_json(self) -> dict[str, Any]:
        """The metric object of gap.json and ladder.json."""
        return {
            **self.total.to_json(),
            "episodes": self.episodes,
            "per_joint": {joint: estimate.to_json() for joint, estimate in self.per_joint.items()},
        }

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> MetricResult:
        """Read back what `to_json` wrote."""
        joints = {joint: Estimate.from_json(item) for joint, item in data["per_joint"].items()}
        return MetricResult(total=Estimate.from_json(data), per_joint=joints, episodes=data["episodes"])


# SIGNAL -> METRIC -> result
Metrics = Mapping[str, Mapping[str, MetricResult]]


@dataclass(frozen=True)
class PairedDifference:
    """Is one run better than another on the same episodes?

    Attributes:
        run: label of the run that is judged.
        baseline: label of the run that it is compared with.
        split: split, or `all`.
        signal: signal name.
        metric: metric name; lower is better for all metrics that are compared.
        difference: mean over episodes of (run - baseline), with interval.
        relative: difference over the baseline's mean.
        verdict: `better` or `worse` when the interval excludes zero, else `undecided`.
    """

    run: str
    baseline: str
    split: str
    signal: str
    metric: str
    difference: Estimate
    relative: float
    verdict: Verdict

    def to_json(self) -> dict[str, Any]:
        """JSON object."""
        return {
            "run": self.run,
            "baseline": self.baseline,
            "split": self.split,
            "signal": self.signal,
            "metric": self.metric,
            "difference": self.difference.to_json(),
            "relative": _number(self.relative),
            "verdict": self.verdict,
        }

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> PairedDifference:
        """Read back what `to_json` wrote."""
        relative = math.nan if data["relative"] is None else data["relative"]
        return PairedDifference(**{**data, "difference": Estimate.from_json(data["difference"]), "relative": relative})


@dataclass(frozen=True)
class GapResult:
    """The gap between a robot and simulations of it.

    Attributes:
        runs: run label -> split (also `all`) -> signal -> metric -> result. The label `command` takes the
            command as the motion.
        paired: paired comparisons between runs.
        groups: field (`payload_kg`, `kp_setting`, `unit`, `condition`) -> its value -> run label -> signal -> metric ->
            result.
        episodes: run label -> episode id -> signal -> metric -> joint -> value.
        splits: episode id -> split.
        joints: all joints, in order.
        scored_joints: the joints that enter `value`.
        settings: what was chosen: window_s, tau_rad, bootstrap draws, seed, …
        provenance: versions, git hash, data hash, configuration of the runs.
    """

    runs: Mapping[str, Mapping[str, Metrics]]
    joints: tuple[str, ...]
    scored_joints: tuple[str, ...]
    paired: tuple[PairedDifference, ...] = ()
    groups: Mapping[str, Mapping[str, Mapping[str, Metrics]]] = field(default_factory=dict)
    episodes: Mapping[str, Mapping[str, Mapping[str, Mapping[str, Mapping[str, float]]]]] = field(default_factory=dict)
    splits: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """The content of gap.json."""
        return {
            "schema": GAP_SCHEMA,
            "joints": list(self.joints),
            "scored_joints": list(self.scored_joints),
            "runs": {
                label: {"splits": {split: metrics_to_json(item) for split, item in splits.items()}}
                for label, splits in self.runs.items()
            },
            "paired": [item.to_json() for item in self.paired],
            "groups": {
                name: {
                    value: {label: metrics_to_json(item) for label, item in runs.items()}
                    for value, runs in values.items()
                }
                for name, values in self.groups.items()
            },
            "episodes": without_nan(self.episodes),
            "episode_splits": dict(self.splits),
            "settings": dict(self.settings),
            "provenance": dict(self.provenance),
        }

    @staticmethod
    def from_json(data: Any, where: str = "gap.json") -> GapResult:
        """Read back what `to_json` wrote.

        Raises:
            FormatError: not a gap result, or of another version.
            DataError: a gap result, but broken.
        """
        return read_versioned(GapResult._read, data, where, schema=GAP_SCHEMA, what="gap")

    @staticmethod
    def _read(data: Mapping[str, Any]) -> GapResult:
        return GapResult(
            runs={
                label: {split: metrics_from_json(item) for split, item in run["splits"].items()}
                for label, run in data["runs"].items()
            },
            joints=tuple(data["joints"]),
            scored_joints=tuple(data["scored_joints"]),
            paired=tuple(PairedDifference.from_json(item) for item in data["paired"]),
            groups={
                name: {
                    value: {label: metrics_from_json(item) for label, item in runs.items()}
                    for value, runs in values.items()
                }
                for name, values in data["groups"].items()
            },
            episodes=_with_nan(data["episodes"]),
            splits=data["episode_splits"],
            settings=data["settings"],
            provenance=data["provenance"],
        )

    def save(self, path: Path) -> None:
        """Write gap.json atomically."""
        write_json(path, self.to_json())

    @staticmethod
    def load(path: Path) -> GapResult:
        """Read gap.json."""
        return GapResult.from_json(read_json(path), str(path))


@dataclass(frozen=True)
class Rung:
    """One step of the ladder from the raw command to the corrected simulator.

    Attributes:
        name: `command`, `stock`, `moving-average`, `fitted`, `fitted+METHOD`.
        seconds: what it took to compute [s].
        splits: split -> signal -> metric -> result.
        chosen: whether it is the best on val.
    """

    name: str
    seconds: float
    splits: Mapping[str, Metrics]
    chosen: bool = False


@dataclass(frozen=True)
class Ladder:
    """The rungs of a `close`, in the order in which they were climbed."""

    rungs: Sequence[Rung]
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """The content of ladder.json."""
        rungs: list[dict[str, Any]] = []
        for rung in self.rungs:
            item: dict[str, Any] = {
                "name": rung.name,
                "seconds": round(rung.seconds, 3),
                "splits": {split: metrics_to_json(metrics) for split, metrics in rung.splits.items()},
            }
            if rung.chosen:
                item["chosen"] = True
            rungs.append(item)
        return {"schema": LADDER_SCHEMA, "rungs": rungs, "provenance": dict(self.provenance)}

    @staticmethod
    def from_json(data: Any, where: str = "ladder.json") -> Ladder:
        """Read back what `to_json` wrote.

        Raises:
            FormatError: not a ladder, or of another version.
            DataError: a ladder, but broken.
        """
        return read_versioned(Ladder._read, data, where, schema=LADDER_SCHEMA, what="ladder")

    @staticmethod
    def _read(data: Mapping[str, Any]) -> Ladder:
        rungs = [
            Rung(
                name=item["name"],
                seconds=item["seconds"],
                splits={split: metrics_from_json(metrics) for split, metrics in item["splits"].items()},
                chosen=item.get("chosen", False),
            )
            for item in data["rungs"]
        ]
        return Ladder(rungs=rungs, provenance=data.get("provenance", {}))

    def save(self, path: Path) -> None:
        """Write ladder.json atomically."""
        write_json(path, self.to_json())

    @staticmethod
    def load(path: Path) -> Ladder:
        """Read ladder.json."""
        return Ladder.from_json(read_json(path), str(path))


def metrics_to_json(metrics: Metrics) -> dict[str, Any]:
    """SIGNAL -> METRIC -> JSON object."""
    return {signal: {name: result.to_json() for name, result in results.items()} for signal, results in metrics.items()}


def metrics_from_json(data: Mapping[str, Any]) -> dict[str, dict[str, MetricResult]]:
    """Read back what `metrics_to_json` wrote."""
    return {
        signal: {name: MetricResult.from_json(item) for name, item in results.items()}
        for signal, results in data.items()
    }


def _number(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


def _with_nan(tree: Any) -> Any:
    if isinstance(tree, Mapping):
        return {key: _with_nan(value) for key, value in tree.items()}
    return math.nan if tree is None else tree
