"""Pairs of simulated and measured motions, as training reads them: in one flat file per split.

Windows are read from the file when they are needed, so that memory does not grow with the data.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Literal

import numpy as np
from jaxtyping import Float32, Float64, UInt64

from trueup.augment.channels import Grid, column, gather
from trueup.augment.components import components
from trueup.core.episode import Episode
from trueup.core.model_card import ANY_JOINT, Channel
from trueup.core.timeseries import BODY_PREFIX, TimeSeries
from trueup.errors import ConfigError, DataError, MissingSignal, UnitError

# Samples of a val motion are looked for among those of train in runs of this many changes; encoders of low resolution
# repeat short ones by chance, so several must be found.
_RUN = 32
_SHORTEST = 8
_RUNS_PER_MOTION = 200
_FOUND = 3
_NAME_BODIES = "Name the bodies in robot.yaml, `simulation: {bodies: [...]}`, and replay again."
_KINDS = (("joints", False), ("bodies", True))


@dataclass(frozen=True)
class Motion:
    """Where a motion stands in the file.

    Attributes:
        id: episode id; with the joint behind it where joints are motions of their own.
        episode: number of the episode: what the joints of a robot do at one time says no more than one motion.
        condition: its condition.
        start: its first row.
        rows: number of rows.
        executed: what was executed, the same for repetitions with another payload; it is no repetition if empty.
    """

    id: str
    episode: int
    condition: str
    start: int
    rows: int
    executed: str = ""


@dataclass(frozen=True, eq=False)
class Pairs:
    """The motions of one split, in a file of float32 rows: I inputs, then K measured outputs.

    Attributes:
        path: the file.
        inputs: I channels.
        outputs: K channels, measured.
        rate_hz: samples per second.
        motions: where each is.
        marks: for each motion the numbers of its runs of measured samples, as logged; see `refuse_overlap`.
    """

    path: Path
    inputs: tuple[Channel, ...]
    outputs: tuple[Channel, ...]
    rate_hz: float
    motions: tuple[Motion, ...]
    marks: Path
    _open: list[int] = field(default_factory=list)

    @property
    def rows(self) -> int:
        """Rows of all motions."""
        return sum(motion.rows for motion in self.motions)

    @property
    def episodes(self) -> int:
        """Number of episodes; that of the motions where these are not joints."""
        return len({motion.episode for motion in self.motions})

    def read(self, start: int, rows: int) -> Float32[np.ndarray, "N C"]:
        """Rows of the file, (N, I + K)."""
        if not self._open:
            self._open.append(os.open(self.path, os.O_RDONLY))
        width = 4 * (len(self.inputs) + len(self.outputs))
        data = os.pread(self._open[0], rows * width, start * width)
        if len(data) != rows * width:
            raise DataError(f"{self.path} is truncated", got=f"{len(data)} bytes at row {start}")
        return np.frombuffer(data, np.float32).reshape(rows, -1)

    def motion(self, motion: Motion) -> tuple[Float32[np.ndarray, "T I"], Float32[np.ndarray, "T K"]]:
        """Inputs and measured outputs of a motion."""
        rows = self.read(motion.start, motion.rows)
        return rows[:, : len(self.inputs)], rows[:, len(self.inputs) :]

    def __iter__(self) -> Iterator[tuple[Motion, Float32[np.ndarray, "T I"], Float32[np.ndarray, "T K"]]]:
        """Every motion with its inputs and measured outputs."""
        for motion in self.motions:
            yield motion, *self.motion(motion)

    def __enter__(self) -> Pairs:
        """For `with`: the file is closed at the end."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the file; reading opens it again."""
        while self._open:
            os.close(self._open.pop())


def write_pairs(
    episodes: Iterable[Episode],
    path: Path,
    *,
    run: str,
    inputs: Sequence[Channel],
    outputs: Sequence[Channel],
    rate_hz: float,
    joints: Sequence[str] = (),
    mirrored: bool = False,
) -> Pairs:
    """Bring motions onto one clock each and append them to a file.

    Args:
        episodes: with the simulated run, in the robot's joint names.
        path: file that is written.
        run: label of the run.
        inputs: what the network reads.
        outputs: what it corrects; the measured signals are read.
        rate_hz: of the network.
        joints: for channels of any joint or body: those that each become a motion of their own.
        mirrored: each motion also comes the other way around.

    Raises:
        DataError: a value is not finite, there is no motion, or the disk is full.
        TrueupError: an episode lacks a signal or a joint.
    """
    motions: list[Motion] = []
    marks = path.with_suffix(".marks")
    at = 0
    try:
        with path.open("wb") as file, marks.open("wb") as marked:
            for number, episode in enumerate(episodes):
                grid = Grid.of(_common(episode, run), rate_hz, f"episode {episode.id!r}")
                runs = _runs(episode.measured)
                for joint in joints or ("",):
                    given, wanted = (_of_joint(channels, joint) for channels in (inputs, outputs))
                    x = gather(episode, run, given, grid.time_s)
                    y = _measured(episode, wanted, grid.time_s)
                    _refuse_gaps(episode, x, given)
                    _refuse_gaps(episode, y, wanted)
                    name = f"{episode.id} {joint}" if joint else episode.id
                    rows = np.concatenate([x, y], axis=1)
                    for sign in (1, -1) if mirrored else (1,):
                        file.write((sign * rows).tobytes())
                        marked.write(np.array([len(runs)], np.uint64).tobytes() + runs.tobytes())
                        motions.append(
                            Motion(name, number, episode.meta.condition, at, len(rows), episode.meta.executed)
                        )
                        at += len(rows)
    except OSError as error:  # of these two files: reading has errors of its own
        raise DataError(f"cannot write {path}", got=error.strerror or str(error)) from error
    if not motions:
        raise DataError(f"there is no motion for {path.stem}")
    return Pairs(path, tuple(inputs), tuple(outputs), rate_hz, tuple(motions), marks)


def any_joint(channels: Sequence[Channel]) -> tuple[Channel, ...]:
    """The channels of a modular network: each once, of no joint of its own.

    Raises:
        UnitError: joints have different units, such as hinges and slides.
        ConfigError: some are of joints and some of bodies.
    """
    if len({channel.of_body for channel in channels}) > 1:
        kinds = {kind: [c.name for c in channels if c.of_body == of_body] for kind, of_body in _KINDS}
        raise ConfigError(
            "joints and bodies are blocks of different dimension, and cannot share a modular network",
            got=f"{kinds['joints'][0]} and {kinds['bodies'][0]}",
            hint="Train one network for the joints and one for the bodies.",
        )
    found: dict[tuple[str, str], Channel] = {}
    for channel in channels:
        own = found.setdefault((channel.series, channel.signal), replace(channel, joint=ANY_JOINT))
        if own.unit != channel.unit:
            raise UnitError(
                f"joints of different kinds cannot share a network: {channel.signal} of {channel.joint!r}",
                got=channel.unit,
                expected=own.unit,
                hint="Train one network for the hinges and one for the slides: name the joints.",
            )
    return tuple(found.values())


def _of_joint(channels: Sequence[Channel], joint: str) -> tuple[Channel, ...]:
    return tuple(replace(channel, joint=joint) if joint else channel for channel in channels)


def _common(episode: Episode, run: str) -> Float64[np.ndarray, "T"]:
    """The stamps of a run that the measurement covers too."""
    measured, stamps = episode.measured.time_s, episode.run(run).time_s
    inside = (stamps >= measured[0]) & (stamps <= measured[-1])
    if not inside.any():
        raise DataError(
            f"episode {episode.id!r}: {run} and the measurement share no time",
            got=f"{stamps[0]:.4g} to {stamps[-1]:.4g} s and {measured[0]:.4g} to {measured[-1]:.4g} s",
        )
    return stamps if inside.all() else stamps[inside]


def _measured(
    episode: Episode, outputs: Sequence[Channel], time_s: Float64[np.ndarray, "T"]
) -> Float32[np.ndarray, "T K"]:
    series = episode.measured
    columns = [column(series, channel, f"episode {episode.id!r}, measured") for channel in outputs]
    return np.stack([np.interp(time_s, series.time_s, values) for values in columns], axis=1).astype(np.float32)


def _refuse_gaps(episode: Episode, values: Float32[np.ndarray, "T C"], channels: Sequence[Channel]) -> None:
    wrong = ~np.isfinite(values)
    if wrong.any():
        row, channel = np.argwhere(wrong)[0]
        raise DataError(
            f"episode {episode.id!r} cannot be trained on",
            got=f"{values[row, channel]} in {channels[channel].signal} of {channels[channel].joint!r}, sample {row}",
            expected="finite numbers",
            hint="Give --drop-flagged to leave out motions with quality warnings, or mend the log.",
        )


def refuse_overlap(train: Pairs, val: Pairs) -> None:
    """Refuse a val split that holds a piece of a train motion: nothing could be chosen by it.

    Runs of 32 measured samples that differ from the one before, and how long each of them stood, are looked for bit by
    bit, in all joint signals, or those of bodies where there are no others, as they were logged. Motions with fewer
    changes are compared as a whole.

    Raises:
        DataError: a val motion, or a piece of it, is in train too.
    """
    sought = [runs[:: max(1, len(runs) // _RUNS_PER_MOTION)].copy() for runs in _marks(val)]
    counts = np.array([len(runs) for runs in sought])
    owners = np.repeat(np.arange(len(sought)), counts)
    numbers = np.concatenate(sought)
    order = np.argsort(numbers, kind="stable")
    numbers, owners = numbers[order], owners[order]
    for motion, runs in zip(train.motions, _marks(train), strict=True):
        first, behind = (np.searchsorted(numbers, runs, side) for side in ("left", "right"))
        there = np.unique(np.stack([first, behind], axis=1)[behind > first], axis=0)
        if not len(there):
            continue
        owner, found = np.unique(np.concatenate([owners[a:b] for a, b in there]), return_counts=True)
        enough = found >= np.minimum(_FOUND, counts[owner])
        if enough.any():
            raise DataError(
                f"val motion {val.motions[owner[enough.argmax()]].id!r} holds samples of train motion {motion.id!r}",
                hint="Split by whole motions: what is trained on cannot judge.",
            )


def _marks(pairs: Pairs) -> Iterator[UInt64[np.ndarray, "N"]]:
    """The numbers of the runs of each motion."""
    with pairs.marks.open("rb") as file:
        for _ in pairs.motions:
            count = int(np.frombuffer(file.read(8), np.uint64)[0])
            yield np.frombuffer(file.read(8 * count), np.uint64)


def _runs(series: TimeSeries) -> UInt64[np.ndarray, "N"]:
    """A number for each run of changes; one for all of them if there are few, none if hardly anything changes."""
    signals = [values for name, values in series.signals.items() if not name.startswith(BODY_PREFIX)]
    # Bodies count only where nothing else was measured.
    signals = signals or [values.reshape(len(series), -1) for values in series.signals.values()]
    if not signals:
        return np.empty(0, np.uint64)
    bits = np.concatenate(signals, axis=1).astype(np.float64).view(np.uint64)
    factors = np.random.default_rng(0).integers(1, 2**63, bits.shape[1], np.uint64) * np.uint64(2) + np.uint64(1)
    bits = (bits ^ (bits >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)  # neighboring numbers differ in few bits
    rows = ((bits ^ (bits >> np.uint64(32))) * factors).sum(axis=1, dtype=np.uint64)
    # Logs hold samples, for a bus slower than the log or an encoder that is coarse. How long they stand counts: the
    # ticks of such an encoder alone are the same whenever it passes them. The last sample may stand on beyond a cut.
    changes = np.flatnonzero(rows[1:] != rows[:-1]) + 1
    stood = np.diff(changes).astype(np.uint64)
    marks = rows[changes[:-1]] + stood * np.uint64(0x94D049BB133111EB)
    width = min(_RUN, len(marks))
    if width < _SHORTEST:
        return np.empty(0, np.uint64)
    numbers = np.zeros(len(marks) - width + 1, np.uint64)
    for number in range(width):
        numbers = numbers * np.uint64(0x9E3779B97F4A7C15) + marks[number : number + len(numbers)]
    return numbers


def channels_of(
    episode: Episode,
    run: str,
    *,
    signals: Sequence[str] | None,
    reads: Sequence[str] = (),
    command: Sequence[str] = (),
    measured: Sequence[str] = (),
    known: Sequence[str],
) -> tuple[tuple[Channel, ...], tuple[Channel, ...]]:
    """Inputs and outputs for an episode: all joints of each signal, simulated ones before commanded ones.

    Of a body's signal it is all components of all bodies; those that were measured can be corrected.

    Args:
        episode: one that has everything.
        run: label of the run.
        signals: those to correct; None for those of `known` that both sides have.
        reads: other simulated signals to read.
        command: commanded signals to read.
        measured: measured signals to read, one sample late.
        known: signals that can be corrected, in order.

    Raises:
        MissingSignal: a signal is on one side only.
    """
    series, truth = episode.run(run), episode.measured
    chosen = [name for name in known if name in series and name in truth] if signals is None else list(signals)
    for name in chosen:
        if name not in series or name not in truth:
            side, has = ("the run", series) if name not in series else ("the measurement", truth)
            raise MissingSignal(
                f"{side} of episode {episode.id!r} has no {name}",
                available=has.signals,
                hint=_NAME_BODIES if name.startswith(BODY_PREFIX) and name not in series else None,
            )
    if not chosen:
        raise MissingSignal(f"episode {episode.id!r}: robot and run {run!r} share no signal", available=known)
    corrected = _channels(series, chosen)
    read = _channels(series, [name for name in reads if name not in chosen])
    told = _channels(episode.commanded(), command, "command") if command else []
    sensed = _channels(truth, measured, "measured") if measured else []
    seen = [item for item in corrected if not item.of_body or item.joint in truth.bodies]
    return (*corrected, *read, *told, *sensed), tuple(seen)


def _channels(
    series: TimeSeries, signals: Sequence[str], kind: Literal["simulated", "command", "measured"] = "simulated"
) -> list[Channel]:
    for name in signals:
        if name not in series:
            what = "commanded" if kind == "command" else kind
            raise MissingSignal(
                f"there is no {what} {name}",
                available=series.signals,
                hint=_NAME_BODIES if name.startswith(BODY_PREFIX) else None,
            )
    return [
        Channel(component, owner, unit, kind)
        for name in signals
        for component in components(name)
        for owner, unit in zip(
            series.bodies if name.startswith(BODY_PREFIX) else series.joints, series.units[name], strict=True
        )
    ]
