"""Slides: stretches in which a joint moves in one direction and friction has one sign."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float64

from trueup.align.tracks import runs
from trueup.errors import ConfigError, MissingSignal
from trueup.identify.experiments.joint_log import Delay, JointLog, delay_to_json
from trueup.identify.experiments.onset import STILL_SPEED, encoder_step
from trueup.identify.regression.samples import TorqueSource

_SMOOTH_S = 0.01
_LEAST_ROWS = 8
_LIMIT_MARGIN = 0.02  # rad; a position limit is soft
_PEAK_SHARE = 0.05
_FLOOR_SIGMAS = 6.0
_STEPS = 1.5  # of the encoder
_PUSH_SHARE = 0.2  # of the largest torque; less may be the noise of a measured one


@dataclass(frozen=True)
class SlideSettings:
    """How motions are cut and read.

    Attributes:
        signal: `position` or `velocity` alone; `auto` takes the position where there is one. Both are used without
            differentiating (see `motion_fit`).
        torque: `command`, or the `measured` torque where the drive does not follow its command.
        delay_s: the commanded torque acts this much later [s], one number or joint -> its own.
        min_speed: slower than this is standing, or friction of another kind [rad/s]; None takes 0.03 rad/s (ES thesis
            3.1.2), 5 % of the largest speed, or what noise and encoder ask for, whatever is most.
        max_travel_rad: motion further than this from the start is left out, because gravity changes; None for all.
        position_rad: joint -> range; motion within 0.02 rad of its ends is left out (not with `velocity`).

    Raises:
        ConfigError: a value that makes no sense.
    """

    signal: Literal["auto", "position", "velocity"] = "auto"
    torque: TorqueSource = "command"
    delay_s: Delay = 0.0
    min_speed: float | None = None
    max_travel_rad: float | None = None
    position_rad: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse what cannot be meant."""
        for name in ("min_speed", "max_travel_rad"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise ConfigError(f"{name} must be positive", got=value)
        delays = self.delay_s.values() if isinstance(self.delay_s, Mapping) else [self.delay_s]
        if not all(delay_s >= 0 for delay_s in delays):
            raise ConfigError("delay_s must be >= 0", got=self.delay_s)

    def to_json(self) -> dict[str, Any]:
        """JSON types only."""
        ranges = {name: list(ends) for name, ends in self.position_rad.items()}
        return {**asdict(self), "delay_s": delay_to_json(self.delay_s), "position_rad": ranges}


@dataclass(frozen=True, eq=False)
class Slide:
    """One stretch.

    Attributes:
        episode: id of the episode.
        direction: +1 or -1.
        time_s: (N,) [s].
        torque: in force from each stamp to the next, (N,) [Nm].
        position: measured, or integrated from the velocity, (N,) [rad].
        values: the observation, (N,): the position, or the velocity [rad/s].
        is_position: which of the two.
        start: position at the start of the episode [rad].
    """

    episode: str
    direction: int
    time_s: Float64[np.ndarray, "N"]
    torque: Float64[np.ndarray, "N"]
    position: Float64[np.ndarray, "N"]
    values: Float64[np.ndarray, "N"]
    is_position: bool
    start: float

    def part(self, mask: Bool[np.ndarray, "N"]) -> Slide | None:
        """The longest stretch of it in which `mask` holds; None if that is too short."""
        stretches = runs(mask)
        if not stretches:
            return None
        begin, end = max(stretches, key=lambda item: item[1] - item[0])
        if end - begin < _LEAST_ROWS:
            return None
        return self.rows(slice(begin, end))

    def rows(self, rows: slice) -> Slide:
        """The stretch in these rows."""
        return replace(
            self,
            time_s=self.time_s[rows],
            torque=self.torque[rows],
            position=self.position[rows],
            values=self.values[rows],
        )


@dataclass(frozen=True)
class Motion:
    """What one episode shows of a joint.

    Attributes:
        slides: its stretches.
        travel: largest distance from the start [rad].
        top_speed: [rad/s].
        torque: the largest commanded torque, signed [Nm].
        against: samples that moved against their torque and were left out.
    """

    slides: tuple[Slide, ...]
    travel: float
    top_speed: float
    torque: float
    against: int

    @property
    def direction(self) -> int:
        """Of the commanded torque: +1, -1, or 0 without torque."""
        return int(np.sign(self.torque))


def motion(log: JointLog, settings: SlideSettings) -> Motion:
    """Cut a log into slides.

    Left out are standing still, the neighborhood of position limits, motion beyond `max_travel_rad`, and motion
    against a commanded torque: a rebound from an end stop.

    Raises:
        MissingSignal: `settings.signal` is not in the log.
    """
    observed = settings.signal
    if observed == "auto":
        observed = "velocity" if log.position is None else "position"
    values = log.position if observed == "position" else log.velocity
    if values is None:
        raise MissingSignal(f"episode {log.episode!r} has no {observed} of {log.joint!r}")
    is_position = observed == "position"
    speed = _smooth_speed(log.time_s, values, is_position=is_position)
    position = values if is_position else integral(values, log.time_s)
    whole = Slide(
        log.episode, 0, log.time_s, log.torque, position, values, is_position, start=float(np.median(position[:3]))
    )
    floor = settings.min_speed or _floor(log.time_s, values, speed, is_position=is_position)
    travel = np.abs(position - whole.start)
    used = travel <= (settings.max_travel_rad or np.inf)
    if log.joint in settings.position_rad and is_position:
        low, high = settings.position_rad[log.joint]
        used &= (position >= low + _LIMIT_MARGIN) & (position <= high - _LIMIT_MARGIN)
    size = np.abs(log.torque)
    pushed = np.where(size > _PUSH_SHARE * size.max(), np.sign(log.torque), 0.0)
    slides, against = [], 0
    for direction in (1, -1):
        moving = direction * speed > floor
        against += int((moving & (pushed == -direction)).sum())
        for begin, end in runs(moving & used & (pushed != -direction)):
            if end - begin >= _LEAST_ROWS:
                slides.append(replace(whole, direction=direction).rows(slice(begin, end)))
    peak = float(log.torque[int(np.argmax(size))])
    return Motion(tuple(slides), float(travel.max()), float(np.abs(speed).max()), peak, against)


def _smooth_speed(
    time_s: Float64[np.ndarray, "T"], values: Float64[np.ndarray, "T"], *, is_position: bool
) -> Float64[np.ndarray, "T"]:
    """Speed over a few samples on either side."""
    half = max(2, round(_SMOOTH_S / float(np.median(np.diff(time_s)))))
    rows = np.arange(time_s.size)
    low, high = np.maximum(rows - half, 0), np.minimum(rows + half, time_s.size - 1)
    track = values if is_position else integral(values, time_s)
    return np.asarray((track[high] - track[low]) / (time_s[high] - time_s[low]))


def integral(values: Float64[np.ndarray, "T"], time_s: Float64[np.ndarray, "T"]) -> Float64[np.ndarray, "T"]:
    """Trapezoidal integral from the first sample."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time_s))])


def _noise(values: Float64[np.ndarray, "T"]) -> float:
    """Standard deviation of white noise: what second differences show."""
    return float(np.std(np.diff(values, n=2)) / np.sqrt(6.0))


def _floor(
    time_s: Float64[np.ndarray, "T"],
    values: Float64[np.ndarray, "T"],
    speed: Float64[np.ndarray, "T"],
    *,
    is_position: bool,
) -> float:
    """Smoothed speed below which a joint stands, or noise and encoder steps look like motion."""
    step_s = float(np.median(np.diff(time_s)))
    rows = 2 * max(2, round(_SMOOTH_S / step_s))
    if is_position:
        apparent = max(_FLOOR_SIGMAS * math.sqrt(2.0) * _noise(values), _STEPS * encoder_step(values)) / (rows * step_s)
    else:
        apparent = _FLOOR_SIGMAS * _noise(values) / math.sqrt(rows)
    return max(STILL_SPEED, _PEAK_SHARE * float(np.abs(speed).max()), apparent)
