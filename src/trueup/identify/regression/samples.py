"""The rows that a regression is fitted on: all episodes on their measured clocks, with what acted at each stamp."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Float64, Int

from trueup.core.episode import Episode
from trueup.core.hold import held_rows
from trueup.core.timeseries import TimeSeries
from trueup.errors import ConfigError, DataError, MissingSignal, NameMismatch, UnitError
from trueup.identify.regression.smoothing import smooth, without_noise
from trueup.robots.spec import CommandSignal

TORQUE_UNIT = {"rad": "Nm", "m": "N"}

CommandVelocity = Literal["signal", "derived", "zero"]
TorqueSource = Literal["measured", "command"]


@dataclass(frozen=True)
class Motion:
    """One episode among the rows.

    Attributes:
        id: the episode's id.
        split: `train`, `val`, `test` or empty.
        payload_kg: payload [kg]; 0 where it was not recorded.
        executed: what was executed; repetitions have the same.
        kp_setting: of the drives' position gain; None where it was not recorded.
    """

    id: str
    split: str
    payload_kg: float
    executed: str
    kp_setting: float | None = None


@dataclass(frozen=True, eq=False)
class Samples:
    """T rows of J joints out of E motions; NaN where a signal is not known.

    Attributes:
        joints: names of the J columns.
        length_units: `rad` or `m` per joint.
        time_s: the measured stamps [s]; they start again with every motion.
        motion: number of the motion that a row belongs to, increasing.
        motions: the E motions.
        position: measured, low-passed [rad or m].
        velocity: measured and low-passed, or the derivative of the low-passed position.
        acceleration: measured, or the derivative of the low-passed velocity.
        torque: measured or commanded [Nm or N].
        command: what is commanded at the stamp, delayed: a position, the integral of a velocity from the measured
            position on [rad or m], or a torque [Nm or N].
        command_velocity: commanded velocity in force at the stamp, delayed; 0 beside commanded torques.
        notes: what had to be assumed.
    """

    joints: tuple[str, ...]
    length_units: tuple[str, ...]
    time_s: Float64[np.ndarray, "T"]
    motion: Int[np.ndarray, "T"]
    motions: tuple[Motion, ...]
    position: Float64[np.ndarray, "T J"]
    velocity: Float64[np.ndarray, "T J"]
    acceleration: Float64[np.ndarray, "T J"]
    torque: Float64[np.ndarray, "T J"]
    command: Float64[np.ndarray, "T J"]
    command_velocity: Float64[np.ndarray, "T J"]
    notes: tuple[str, ...]

    @property
    def payload_kg(self) -> Float64[np.ndarray, "T"]:
        """The payload of each row [kg]."""
        carried: Float64[np.ndarray, "E"] = np.array([motion.payload_kg for motion in self.motions], np.float64)
        return np.take(carried, self.motion)


@dataclass(frozen=True)
class SampleSettings:
    """How rows are made of episodes.

    Attributes:
        delay_s: the command acts this much later [s], >= 0.
        cutoff_hz: low-pass of what is differentiated [Hz].
        smooth_torque: low-pass the torque like everything else and derive the velocity from the position, as the
            equation of motion wants it; a servo's torque follows its command without a filter.
        derive_velocity: take the derivative of the low-passed position although the log has a velocity.
        command_velocity: `signal` takes the velocity of the command series, zero where it has none; `derived`
            differentiates the position command; `zero` is a servo that damps towards standstill.
        torque: the measured torque, or the commanded one of a torque-driven robot.
        follows: which signal of the command is taken.
    """

    delay_s: float = 0.0
    cutoff_hz: float = 15.0
    smooth_torque: bool = False
    derive_velocity: bool = False
    command_velocity: CommandVelocity = "signal"
    torque: TorqueSource = "measured"
    follows: CommandSignal = "position"

    def __post_init__(self) -> None:
        """Refuse what cannot be meant."""
        if not 0.0 <= self.delay_s < np.inf:
            raise ConfigError("delay_s must be >= 0", got=self.delay_s)
        if not 0.0 < self.cutoff_hz < np.inf:
            raise ConfigError("cutoff_hz must be above 0", got=self.cutoff_hz)


def gather(episodes: Iterable[Episode], settings: SampleSettings, *, joints: Sequence[str] | None = None) -> Samples:
    """Stack the rows of all episodes.

    Args:
        episodes: in the joint names and units of the robot (see `align.JointMap`).
        settings: delay, filter and sources.
        joints: the joints to take; those of the first episode if None.

    Raises:
        DataError: there is no episode.
        MissingSignal: an episode lacks the position or the torque.
        NameMismatch: an episode lacks a joint.
        UnitError: a position is neither in rad nor in m, or a torque in neither Nm nor N.
    """
    names: tuple[str, ...] | None = tuple(joints) if joints is not None else None
    motions, parts, units, notes = [], [], None, []
    for episode in episodes:
        names = names or episode.measured.joints
        measured = episode.measured.select(names)
        if units is not None and measured.units["position"] != units:
            raise UnitError(
                f"positions of episode {episode.id!r} are in other units than before",
                got=measured.units["position"],
                expected=units,
            )
        units = _checked_units(episode.id, measured)
        parts.append(_rows(episode, measured, settings))
        if episode.meta.payload_kg is None:
            notes.append("payload not recorded: taken as 0 kg")
        meta = episode.meta
        motions.append(Motion(meta.id, meta.split, float(meta.payload_kg or 0.0), meta.executed, meta.kp_setting))
    if names is None or units is None:
        raise DataError("there are no episodes to fit", expected="at least one")
    stacked = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    lengths = [part["time_s"].size for part in parts]
    return Samples(
        joints=names,
        length_units=units,
        motion=np.repeat(np.arange(len(parts)), lengths),
        motions=tuple(motions),
        notes=tuple(f"{note} ({notes.count(note)} of {len(parts)} episodes)" for note in dict.fromkeys(notes)),
        **stacked,
    )


def _checked_units(episode_id: str, measured: TimeSeries) -> tuple[str, ...]:
    lengths = measured.units["position"] if "position" in measured else ()
    if "position" not in measured:
        raise MissingSignal(f"episode {episode_id!r} has no measured position", available=measured.signals)
    for joint, unit in zip(measured.joints, lengths, strict=True):
        if unit not in TORQUE_UNIT:
            raise UnitError(
                f"the position of joint {joint!r} in episode {episode_id!r} is not in SI",
                got=unit,
                expected="rad or m",
                hint="Apply the robot's joint map first (align.JointMap).",
            )
    return lengths


def _rows(episode: Episode, measured: TimeSeries, settings: SampleSettings) -> dict[str, np.ndarray]:
    clock = measured.time_s
    raw = np.asarray(measured["position"], np.float64)
    position, velocity, acceleration = smooth(raw, clock, cutoff_hz=settings.cutoff_hz)
    torque = _torque(episode, measured, settings)
    if settings.smooth_torque:
        torque = smooth(torque, clock, cutoff_hz=settings.cutoff_hz).value
    else:
        position = without_noise(raw, position)
        if "velocity" in measured and not settings.derive_velocity:
            raw = np.asarray(measured["velocity"], np.float64)
            velocity, acceleration, _ = smooth(raw, clock, cutoff_hz=settings.cutoff_hz)
            velocity = without_noise(raw, velocity)
    if "acceleration" in measured and not settings.smooth_torque:
        acceleration = np.asarray(measured["acceleration"], np.float64)
    command, command_velocity = _commanded(episode, measured, position, settings)
    return {
        "time_s": clock,
        "position": position,
        "velocity": velocity,
        "acceleration": acceleration,
        "torque": torque,
        "command": command,
        "command_velocity": command_velocity,
    }


def _torque(episode: Episode, measured: TimeSeries, settings: SampleSettings) -> Float64[np.ndarray, "T J"]:
    source = measured if settings.torque == "measured" else _selected_command(episode, measured)
    if "torque" not in source:
        raise MissingSignal(
            f"episode {episode.id!r} has no {settings.torque} torque",
            available=source.signals,
            hint="A fit of torques needs the torque (or current times the torque constant) in the log.",
        )
    for joint, unit, length in zip(measured.joints, source.units["torque"], measured.units["position"], strict=True):
        if unit != TORQUE_UNIT[length]:
            raise UnitError(
                f"torque of joint {joint!r}, episode {episode.id!r}", got=unit, expected=TORQUE_UNIT[length]
            )
    if settings.torque == "measured":
        return np.asarray(source["torque"], np.float64)
    return _held(source, "torque", measured.time_s - settings.delay_s)


def _commanded(
    episode: Episode, measured: TimeSeries, actual: Float64[np.ndarray, "T J"], settings: SampleSettings
) -> tuple[Float64[np.ndarray, "T J"], Float64[np.ndarray, "T J"]]:
    shape, follows = (len(measured), len(measured.joints)), settings.follows
    if episode.command is None or follows not in episode.command:
        return np.full(shape, np.nan), np.full(shape, np.nan)
    command = _selected_command(episode, measured)
    if follows != "position":
        held = _held(command, follows, measured.time_s - settings.delay_s)
        if follows == "torque":
            return held, np.where(np.isfinite(held), 0.0, np.nan)
        return _integrated(held, measured.time_s, actual), held
    if command.units["position"] != measured.units["position"]:
        raise UnitError(
            f"command and measurement of episode {episode.id!r} are in different units",
            got=command.units["position"],
            expected=measured.units["position"],
        )
    times = measured.time_s - settings.delay_s
    position = _held(command, "position", times)
    if settings.command_velocity == "derived" and len(command) > 1:
        slope = np.gradient(np.asarray(command["position"], np.float64), command.time_s, axis=0)
        velocity = _held(command, slope, times)
    elif settings.command_velocity == "signal" and "velocity" in command:
        velocity = _held(command, "velocity", times)
    else:
        velocity = np.where(np.isfinite(position), 0.0, np.nan)
    return position, velocity


def _integrated(
    velocity: Float64[np.ndarray, "T J"], time_s: Float64[np.ndarray, "T"], actual: Float64[np.ndarray, "T J"]
) -> Float64[np.ndarray, "T J"]:
    """Where a commanded velocity leads from the first position at which it is known [rad or m]; NaN before that."""
    known = np.isfinite(velocity) & np.isfinite(actual)
    first = np.argmax(known, axis=0)
    steps = np.where(np.isfinite(velocity), velocity, 0.0)[:-1] * np.diff(time_s)[:, None]
    travelled = np.concatenate([np.zeros((1, velocity.shape[1])), np.cumsum(steps, axis=0)])
    column = np.arange(velocity.shape[1])
    place = actual[first, column] + travelled - travelled[first, column]
    return np.where(np.isfinite(velocity) & (np.arange(len(time_s))[:, None] >= first), place, np.nan)


def _selected_command(episode: Episode, measured: TimeSeries) -> TimeSeries:
    try:
        return episode.commanded().select(measured.joints)
    except NameMismatch as error:
        raise NameMismatch(
            f"the command of episode {episode.id!r} lacks joints",
            left=episode.commanded().joints,
            right=measured.joints,
            left_name="command",
            right_name="measured",
        ) from error


def _held(
    command: TimeSeries, signal: str | Float[np.ndarray, "N J"], times: Float64[np.ndarray, "T"]
) -> Float64[np.ndarray, "T J"]:
    values = command[signal] if isinstance(signal, str) else signal
    rows = held_rows(command.time_s, times)
    return np.where(rows[:, None] >= 0, np.asarray(values, np.float64)[np.maximum(rows, 0)], np.nan)
