"""One joint of an episode, in SI units on the measured clock: what the estimators look at."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64

from trueup.align import QualityConfig
from trueup.align.quality_signal import saturation_flags
from trueup.core.episode import Episode
from trueup.core.hold import held_rows
from trueup.core.timeseries import TimeSeries
from trueup.core.units import si_factor
from trueup.errors import DataError, MissingSignal, NameMismatch
from trueup.identify.experiments.findings import in_words
from trueup.identify.regression.samples import TorqueSource

# How much later commands act [s]: one number, or joint -> its own.
Delay = float | Mapping[str, float]

_LEAST_ROWS = 10
_DISTURBED_RAD = 0.05  # a joint that is not excited and moves this far changes inertia and gravity of the one that is


@dataclass(frozen=True, eq=False)
class JointLog:
    """What one joint did, and the torque that it was told.

    Attributes:
        episode: id of the episode.
        joint: its name.
        time_s: measured stamps with finite values, (T,) [s].
        torque: torque in force at each stamp, (T,) [Nm or N].
        position: (T,) [rad or m], or None.
        velocity: (T,) [rad/s or m/s], or None; one of the two is there.
        length: `rad` or `m`.
    """

    episode: str
    joint: str
    time_s: Float64[np.ndarray, "T"]
    torque: Float64[np.ndarray, "T"]
    position: Float64[np.ndarray, "T"] | None
    velocity: Float64[np.ndarray, "T"] | None
    length: str

    @property
    def effort(self) -> str:
        """Unit of the torque."""
        return "N" if self.length == "m" else "Nm"


def joint_log(
    episode: Episode, joint: str, *, delay_s: Delay = 0.0, torque_source: TorqueSource = "command"
) -> JointLog:
    """One joint of an episode.

    Rows with a missing value are left out; a channel of which most is missing is taken as not there.

    Args:
        episode: with `position` or `velocity` measured, and the torque that `torque_source` asks for.
        joint: joint name.
        delay_s: the commanded torque acts this much later [s]; a joint that a mapping does not name has none.
        torque_source: `command`, or the `measured` torque where the drive does not follow its command.

    Raises:
        NameMismatch: the joint is not in the episode.
        MissingSignal: no motion or no torque.
        DataError: hardly a finite value.
        UnitError: a unit that is not known.
    """
    measured = episode.measured.select([joint])
    channels = {name: in_si(measured, name) for name in ("position", "velocity") if name in measured}
    channels = {name: values for name, values in channels.items() if np.isfinite(values).mean() > 0.5}
    if not channels:
        raise MissingSignal(
            f"episode {episode.id!r} has no usable position or velocity of {joint!r}", available=measured.signals
        )
    own_s = delay_s.get(joint, 0.0) if isinstance(delay_s, Mapping) else delay_s
    torque = _torque(episode, joint, own_s, torque_source)
    good: Bool[np.ndarray, "T"] = np.isfinite(torque)
    for values in channels.values():
        good &= np.isfinite(values)
    if good.sum() < _LEAST_ROWS:
        raise DataError(f"episode {episode.id!r} has hardly a finite value of {joint!r}", got=int(good.sum()))
    return JointLog(
        episode=episode.id,
        joint=joint,
        time_s=measured.time_s[good],
        torque=torque[good],
        position=channels["position"][good] if "position" in channels else None,
        velocity=channels["velocity"][good] if "velocity" in channels else None,
        length=_length_unit(measured),
    )


def delay_to_json(delay_s: Delay) -> Any:
    """JSON types only."""
    return dict(delay_s) if isinstance(delay_s, Mapping) else delay_s


def excited_joints(episode: Episode, joints: Sequence[str] | None) -> tuple[str, ...]:
    """The joints that an episode is about.

    They are the ones asked for; else the one whose name begins the id, as in `joint1_torque-2.0`; else those whose
    commanded torque changes.

    Raises:
        NameMismatch: a joint that was asked for is not in the episode.
        MissingSignal: neither the id nor a torque command says which joint it is.
    """
    if joints is not None:
        missing = [joint for joint in joints if joint not in episode.measured.joints]
        if missing:
            raise NameMismatch(f"episode {episode.id!r} lacks {missing}", left=joints, right=episode.measured.joints)
        return tuple(joints)
    own = episode.id.rsplit("/", 1)[-1]
    named = [joint for joint in episode.measured.joints if own.startswith(f"{joint}_")]
    if named:
        return (max(named, key=len),)
    command = episode.commanded()
    if "torque" not in command:
        raise MissingSignal(f"episode {episode.id!r} has no torque command", available=command.signals)
    values = np.nan_to_num(command["torque"])
    return tuple(joint for joint, span in zip(command.joints, np.ptp(values, axis=0), strict=True) if span > 0)


def disturbances(episodes: Iterable[Episode], joint: str) -> list[str]:
    """What else happened in these episodes that spoils a number about one joint: others that moved, saturation."""
    others: dict[str, float] = {}
    saturated = []
    for episode in episodes:
        measured = episode.measured
        if "position" in measured and len(measured) >= _LEAST_ROWS:
            for other in measured.joints:
                values = in_si(measured.select([other]), "position")
                if other != joint and np.isfinite(values).any():
                    others[other] = max(others.get(other, 0.0), float(np.nanmax(values) - np.nanmin(values)))
        if joint in measured.joints and episode.command is not None and joint in episode.command.joints:
            saturated += saturation_flags(measured.select([joint]), None, episode.command, QualityConfig())
    notes = [
        f"{other} moved by up to {travel:.2g} meanwhile: effective inertia and gravity are not constant"
        for other, travel in others.items()
        if travel > _DISTURBED_RAD
    ]
    if saturated:
        notes.append(f"the drive did not deliver the torque that was commanded: {saturated[0].detail}")
    return notes


def reason_of(what: object, episode: Episode) -> str:
    """Why an episode is of no use, with what the recording says about itself."""
    details = [flag.detail for flag in episode.meta.flags if flag.severity == "warning"]
    return "; ".join([in_words(what), *details])


def _torque(episode: Episode, joint: str, delay_s: float, source: TorqueSource) -> Float64[np.ndarray, "T"]:
    if source == "measured":
        return in_si(episode.measured.select([joint]), "torque")
    command = episode.commanded().select([joint])
    rows = np.maximum(held_rows(command.time_s, episode.measured.time_s - delay_s), 0)
    return np.asarray(in_si(command, "torque")[rows])


def in_si(series: TimeSeries, signal: str) -> Float64[np.ndarray, "T"]:
    """The only column of a signal, in SI units, (T,)."""
    values = np.asarray(series[signal][:, 0], dtype=np.float64)
    return np.asarray(values * si_factor(series.units[signal][0])[1])


def _length_unit(series: TimeSeries) -> str:
    if "position" in series:
        return si_factor(series.units["position"][0])[0]
    return si_factor(series.units["velocity"][0])[0].removesuffix("/s")
