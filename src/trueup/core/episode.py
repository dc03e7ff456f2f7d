"""One motion of a robot: what was commanded, what was measured, what simulators made of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import PurePosixPath
from typing import Any

from trueup.core.timeseries import TimeSeries
from trueup.errors import MissingSignal

# Kinds of which a warning says that what was recorded is not what happened. Every other kind describes the motion: a
# robot that lags, saturates or runs into something does what a fit is to explain.
BROKEN_MEASUREMENT = frozenset({"gap", "clock_mismatch", "nan", "spike", "frozen", "unit", "silent"})


@dataclass(frozen=True)
class Flag:
    """One thing that is suspicious in an episode, or worth knowing of it.

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

    @property
    def broken(self) -> bool:
        """Whether it says that the measurement is broken: nothing is fitted to such an episode.

        Missing values do so in positions and commands; where a velocity or a torque is missing, the rest is as good.
        """
        if self.severity != "warning" or self.kind not in BROKEN_MEASUREMENT:
            return False
        return self.kind != "nan" or self.series == "command" or self.signal == "position"

    def to_json(self) -> dict[str, Any]:
        """A dictionary that `Flag(**d)` reads back."""
        return asdict(self)


def warning_kinds(flags: Iterable[Flag]) -> tuple[str, ...]:
    """The kinds of the flags of severity `warning`, each once."""
    return tuple(dict.fromkeys(flag.kind for flag in flags if flag.severity == "warning"))


def broken_kinds(flags: Iterable[Flag]) -> tuple[str, ...]:
    """The kinds of the flags that say that the measurement is broken, each once."""
    return tuple(dict.fromkeys(flag.kind for flag in flags if flag.broken))


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
        kp_setting: of the drives' position gain, in the unit of their firmware; None if not recorded.
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
    kp_setting: float | None = None

    @property
    def executed(self) -> str:
        """What was executed: the same for the repetitions of a motion. A file may hold several motions, a plan one."""
        return self.id if not self.source or PurePosixPath(self.source).suffix else self.source

    @property
    def warned(self) -> bool:
        """Whether a quality flag of severity `warning` is set (what `--drop-flagged` drops)."""
        return bool(warning_kinds(self.flags))

    def why_dropped(self, *, drop_flagged: bool | None) -> tuple[str, ...]:
        """The kinds of flags because of which it is left out; none if it is used.

        Args:
            drop_flagged: whether motions with any warning are left out; None leaves out those only whose measurement
                is broken.
        """
        if drop_flagged is None:
            return broken_kinds(self.flags)
        return warning_kinds(self.flags) if drop_flagged else ()


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
