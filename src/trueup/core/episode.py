"""One motion of a robot: what was commanded, what was measured, what simulators made of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import PurePosixPath
from typing import Any

from trueup.core.timeseries import TimeSeries
from trueup.errors import MissingSignal


@dataclass(frozen=True)
class Flag:
    """One thing that is suspicious in an episode.

    Attributes:
        kind: short stable word, e.g. `saturation`, `gap`, `nan`, `frozen`, `repeated_stamps`.
        series: `command` or `measured`.
        signal: signal name, or empty when the flag is about the clock or the whole episode.
        joint: joint name, or empty.
        detail: one sentence with numbers, for people.
        severity: `note` (worth knowing; `--drop-flagged` keeps the episode) or `warning`.
        start_s: first time at which it was seen [s], or None.
        end_s: last time at which it was seen [s], or None.
    """

    kind: str
    series: str = "measured"
    signal: str = ""
    joint: str = ""
    detail: str = ""
    severity: str = "warning"
    start_s: float | None = None
    end_s: float | None = None

    def to_json(self) -> dict[str, Any]:
        """A dictionary that `Flag(**d)` reads back."""
        return asdict(self)


def warning_kinds(flags: Iterable[Flag]) -> tuple[str, ...]:
    """The kinds of the flags of severity `warning`, each once."""
    return tuple(dict.fromkeys(flag.kind for flag in flags if flag.severity == "warning"))


@dataclass(frozen=True)
class EpisodeMeta:
    """What is known about an episode apart from its samples.

    Attributes:
        id: unique in its dataset; letters, digits, `_ . - /`.
        robot: name of the kind of robot, e.g. `so101`; empty if unknown.
        unit: which individual robot.
        payload_kg: payload [kg], or None if not recorded.
        condition: free word for the base condition or gait.
        split: `train`, `val`, `test`, or empty when not assigned.
        source: file or folder that it came from, relative to what was imported.
        source_hash: SHA-256 of those bytes.
        flags: what the quality checks found.
    """

    id: str
    robot: str = ""
    unit: str = ""
    payload_kg: float | None = None
    condition: str = ""
    split: str = ""
    source: str = ""
    source_hash: str = ""
    flags: tuple[Flag, ...] = ()

    @property
    def executed(self) -> str:
        """What was executed: the same for the repetitions of a motion. A file may hold several motions, a plan one."""
        return self.id if not self.source or PurePosixPath(self.source).suffix else self.source

    @property
    def warned(self) -> bool:
        """Whether a quality flag of severity `warning` is set (what `--drop-flagged` drops)."""
        return bool(warning_kinds(self.flags))


@dataclass(frozen=True, eq=False)
class Episode:
    """One motion: metadata and series, each series with a clock of its own.

    Attributes:
        meta: what is known about it.
        measured: what the robot's sensors said.
        command: what was asked of the robot, held between its stamps; None for purely passive motions.
        simulated: run label (e.g. `mujoco/stock`) -> the simulator's answer to the same command.
    """

    meta: EpisodeMeta
    measured: TimeSeries
    command: TimeSeries | None = None
    simulated: Mapping[str, TimeSeries] = field(default_factory=dict)

    @property
    def id(self) -> str:
        """The episode's id."""
        return self.meta.id

    def commanded(self) -> TimeSeries:
        """The command series.

        Raises:
            MissingSignal: the episode has no command.
        """
        if self.command is None:
            raise MissingSignal(f"episode {self.id!r} has no command series", available=["measured"])
        return self.command

    def run(self, label: str) -> TimeSeries:
        """The simulated series of one run.

        Raises:
            MissingSignal: there is no such run for this episode.
        """
        try:
            return self.simulated[label]
        except KeyError:
            raise MissingSignal(f"episode {self.id!r} has no run {label!r}", available=self.simulated) from None

    def with_flags(self, flags: tuple[Flag, ...]) -> Episode:
        """The same episode with these quality flags."""
        return replace(self, meta=replace(self.meta, flags=flags))
