"""How well one way of reading the logs agrees with the model: the equation of the drive, joint by joint.

Where torques are commanded, they are what the motion takes: `command = g T + b v + c sign(v) + e a + d`, with T the
model's inverse dynamics without losses. A servo's error is that torque over its stiffness: `command - x = T / k + ...`,
with x the position, or the velocity of a velocity servo. All factors are free within bounds and none is negative, so
that friction, armature and gains that a model has wrong are not held against it; signs, zeros, units and names are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float64
from scipy.optimize import nnls

from trueup.check.dynamics import Dynamics
from trueup.check.reading import Reading
from trueup.check.samples import Motion

# Rows that are looked at in all, and groups of motions (or parts of one) that have to agree.
_ROWS, _COARSE_ROWS, _CHUNKS = 1200, 300, 6
# A servo may be this much softer than the model says, and lag by this part of what the model does at least; a torque
# may be this much off, a zero this far [rad].
_SOFTER, _LAGS, _GAIN, ZERO = 6.0, 0.4, 3.0, 0.1
# Below these a joint is not moved by its command [rad or m; rad/s or m/s].
_LEAST_MOTION = {"position": 0.03, "velocity": 0.03, "torque": 1e-9}
# A servo may follow by so much less than it is told, whatever it carries.
_OF_ITS_OWN = 0.05
_FLOOR, _SMALL = 1e-7, 0.02


@dataclass(frozen=True, eq=False)
class Score:
    """How well a reading explains the motions; (J,) each, NaN for joints that do not move.

    Attributes:
        left: mean square of what the equation leaves, over that of what it is to explain: the motion around its mean
            for a servo, the torque for a motor.
        blind: the same without the model's torque; what the model explains is what `left` is below it.
        chunks: `left` by group of motions, (C, J).
        outside: share of the samples outside of the joint's range.
        beyond: how far the 98th percentile of them is outside [rad or m].
        gain: factor of the model's torque: 1 over the stiffness of a servo; of a motor, commanded per needed torque.
        damping: factor of the velocity of a position servo or a motor, of the acceleration of a velocity servo.
        zero: constant that was left over, of a servo [rad or m].
    """

    left: Float64[np.ndarray, "J"]
    blind: Float64[np.ndarray, "J"]
    chunks: Float64[np.ndarray, "C J"]
    outside: Float64[np.ndarray, "J"]
    beyond: Float64[np.ndarray, "J"]
    gain: Float64[np.ndarray, "J"]
    damping: Float64[np.ndarray, "J"]
    zero: Float64[np.ndarray, "J"]


@dataclass
class Evidence:
    """Rows of all motions, and what the model says about them under any reading.

    Args:
        motions: to look at.
        dynamics: payload [kg] -> the model with it.
        signal: that the robot follows.
        rows: that are looked at in all.
    """

    motions: Sequence[Motion]
    dynamics: Mapping[float, Dynamics]
    signal: str
    rows: int = _ROWS
    _rows: list[np.ndarray] = field(init=False)
    _chunk: np.ndarray = field(init=False)
    _known: dict[object, Float64[np.ndarray, "N J"]] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        """Choose the rows: spread over all motions, and more of those in which something moves."""
        budget = max(self.rows // 40, self.rows // len(self.motions))
        self._rows = []
        for motion in self.motions:
            rows = np.flatnonzero(motion.known)
            speed = np.abs(motion.velocity[rows]).max(axis=1, initial=0.0)
            moving = rows[speed > 0.1 * speed.max(initial=0.0)]
            rows = moving if moving.size > budget // 2 else rows
            self._rows.append(rows[np.unique(np.linspace(0, rows.size - 1, budget).astype(int))] if rows.size else rows)
        count = len(self.motions)
        if count >= 3:
            own = np.arange(count) * min(count, _CHUNKS) // count
            parts = [np.full(rows.size, own[index]) for index, rows in enumerate(self._rows)]
        else:
            parts = [3 * index + np.arange(rows.size) * 3 // max(rows.size, 1) for index, rows in enumerate(self._rows)]
        self._chunk = np.concatenate(parts)

    @cached_property
    def coarse(self) -> Evidence:
        """Fewer rows, for a first look at many readings."""
        return Evidence(self.motions, self.dynamics, self.signal, _COARSE_ROWS)

    @cached_property
    def rates(self) -> Float64[np.ndarray, "J"]:
        """Slope of the position per measured velocity, joint by joint; NaN without, or where the two do not agree."""
        found = np.full(self.joints, np.nan)
        parts = [motion.measured_velocity for motion in self.motions]
        if any(part is None for part in parts):
            return found
        said = np.concatenate([part[rows] for part, rows in zip(parts, self._rows, strict=True) if part is not None])
        done = self.gather("velocity")
        for joint in range(self.joints):
            one, other = said[:, joint], done[:, joint]
            product = float(one @ other)
            if one @ one > 0 and other @ other > 0 and product**2 > 0.8 * float(one @ one) * float(other @ other):
                found[joint] = product / float(one @ one)
        return found

    @cached_property
    def _kp_factor(self) -> Float64[np.ndarray, "N"]:
        """Position gains at all rows, per those of the description."""
        factors = [motion.setup.kp_factor for motion in self.motions]
        return np.repeat(factors, [rows.size for rows in self._rows])

    @property
    def whole(self) -> np.ndarray:
        """Whether positions are whole numbers as robot.yaml has them now, (J,)."""
        return np.asarray(np.all([motion.whole for motion in self.motions], axis=0))

    @property
    def joints(self) -> int:
        """J."""
        return int(self.motions[0].position.shape[1])

    @property
    def first(self) -> Dynamics:
        """The model, with whatever payload."""
        return next(iter(self.dynamics.values()))

    @property
    def sure(self) -> bool:
        """Whether what the model says counts."""
        return self.first.sure

    @property
    def compensated(self) -> bool:
        """Whether the description has something else carry the weight."""
        return self.first.compensated

    def followed(self, reading: Reading) -> str:
        """Signal that is followed under this reading."""
        return reading.signal or self.signal

    def gather(self, name: str) -> Float64[np.ndarray, "N J"]:
        """A measured quantity at all rows, as robot.yaml has it now."""
        if name not in self._known:
            parts = [getattr(motion, name)[rows] for motion, rows in zip(self.motions, self._rows, strict=True)]
            self._known[name] = np.concatenate(parts)
        return self._known[name]

    def commanded(self, signal: str, lag_s: float) -> Float64[np.ndarray, "N J"]:
        """The command at all rows."""
        key = (signal, round(lag_s, 6))
        if key not in self._known:
            parts = [
                motion.commanded(signal, lag_s)[rows] for motion, rows in zip(self.motions, self._rows, strict=True)
            ]
            self._known[key] = np.concatenate(parts)
        return self._known[key]

    def state(self, reading: Reading) -> tuple[Float64[np.ndarray, "N J"], ...]:
        """Position, velocity and acceleration of the joints under a reading."""
        rate = 1.0 / reading.clock_scale
        return (
            reading.measured.of(self.gather("position"), moved=True),
            rate * reading.measured.of(self.gather("velocity"), moved=False),
            rate**2 * reading.measured.of(self.gather("acceleration"), moved=False),
        )

    def needed(self, reading: Reading) -> Float64[np.ndarray, "N J"]:
        """The model's torques along the motions under a reading."""
        columns = reading.measured
        key = (
            columns.column.tobytes(),
            columns.factor.tobytes(),
            columns.offset.tobytes(),
            reading.clock_scale,
            reading.gravity,
            reading.uncompensated,
            reading.end_mass_kg,
        )
        if key not in self._known:
            position, velocity, acceleration = self.state(reading)
            gravity = None if reading.gravity is None else np.array(reading.gravity)
            ends = np.cumsum([rows.size for rows in self._rows])
            out = np.empty_like(position)
            for motion, end, rows in zip(self.motions, ends, self._rows, strict=True):
                own = slice(end - rows.size, end)
                out[own] = self.dynamics[motion.setup.payload_kg].torque(
                    position[own],
                    velocity[own],
                    acceleration[own],
                    gravity=gravity,
                    uncompensated=reading.uncompensated,
                    end_mass_kg=reading.end_mass_kg,
                )
            self._known[key] = out
        return self._known[key]

    def score(self, reading: Reading, needed: Float64[np.ndarray, "N J"] | None = None) -> Score:
        """How well a reading agrees with the model; with other torques of a model if they are given."""
        signal = self.followed(reading)
        position, velocity, acceleration = self.state(reading)
        command = reading.command.of(self.commanded(self.signal, reading.lag_s), moved=signal == "position")
        needed = self.needed(reading) if needed is None else needed
        dynamics = self.first
        count = self.joints
        chunks = int(self._chunk.max()) + 1
        values = {name: np.full(count, np.nan) for name in ("left", "blind", "gain", "damping", "zero")}
        by_chunk = np.full((chunks, count), np.nan)
        for joint in range(count):
            speed = velocity[:, joint]
            slip = np.tanh(speed / (0.02 * np.percentile(np.abs(speed), 95) + 1e-3))
            one = np.ones_like(speed)
            if signal == "torque":
                target = command[:, joint]
                columns = [needed[:, joint], speed, slip, acceleration[:, joint], one, -one]
                size = float(np.mean(target**2))
                limits = (1.0 / _GAIN, _GAIN, 0.0, 0.2 * np.sqrt(size))
                moves = np.sqrt(size) > _LEAST_MOTION["torque"] and np.ptp(position[:, joint]) > 1e-6
            else:
                actual = position[:, joint] if signal == "position" else speed
                target = command[:, joint] - actual
                stiffness = dynamics.stiffness[joint] if signal == self.signal else np.nan
                softest = np.inf if np.isnan(stiffness) else _SOFTER / stiffness
                # No acceleration beside the position: of a swinging joint it is the position itself.
                rate = speed if signal == "position" else acceleration[:, joint]
                gain = self._kp_factor if signal == "position" else one
                columns = [needed[:, joint] / gain, rate / gain, slip / gain, one, -one]
                size = float(np.var(actual))
                lag = dynamics.damping[joint] / stiffness
                slowest = _LAGS * lag if signal == "position" and np.isfinite(lag) else 0.0
                limits = (0.0, softest, slowest, ZERO if signal == "position" else 0.0)
                moves = np.ptp(actual) > _LEAST_MOTION[signal] or np.ptp(command[:, joint]) > _LEAST_MOTION[signal]
            if not moves:
                continue
            size = max(size, 1e-12)
            table = np.column_stack([*columns, target])
            grams = np.stack([table[self._chunk == chunk].T @ table[self._chunk == chunk] for chunk in range(chunks)])
            if not np.isfinite(grams).all():  # numbers that no robot moves by
                continue
            counts = np.bincount(self._chunk, minlength=chunks)
            gram = grams.sum(axis=0)
            rest, factors = _solved(gram, limits)
            # Without the model's torque; a motor whose torque is not explained at all has 1.
            blind, _ = _solved(gram, (0.0, 0.0, *limits[2:]))
            rows = counts.sum()
            values["left"][joint] = rest / rows / size
            values["blind"][joint] = blind / rows / size
            values["gain"][joint], values["damping"][joint] = factors[0], factors[1]
            values["zero"][joint] = factors[-2] - factors[-1]
            for chunk in range(chunks):
                own = grams[chunk]
                scale = own[-1, -1] / max(counts[chunk], 1) if signal == "torque" else size
                if counts[chunk] and scale > 1e-3 * size:
                    by_chunk[chunk, joint] = _rest(own, factors) / counts[chunk] / scale
        outside, beyond = self._outside(position)
        return Score(
            left=values["left"],
            blind=values["blind"],
            chunks=by_chunk,
            outside=outside,
            beyond=beyond,
            gain=values["gain"],
            damping=values["damping"],
            zero=values["zero"],
        )

    def unmodelled(self, reading: Reading) -> Float64[np.ndarray, "J"]:
        """What a servo leaves that follows a little less than it is told, or overshoots, for reasons of its own.

        As `Score.left`, with the joint's own position and acceleration in place of the model's torque; NaN where these
        would be more than a small part of the motion, which only weight does, and for joints that do not move.
        """
        signal = self.followed(reading)
        position, velocity, acceleration = self.state(reading)
        command = reading.command.of(self.commanded(self.signal, reading.lag_s), moved=signal == "position")
        found = np.full(self.joints, np.nan)
        for joint in range(self.joints):
            actual, speed = (own[:, joint] for own in (position if signal == "position" else velocity, velocity))
            size = float(np.var(actual))
            if size < 1e-12:
                continue
            slip = np.tanh(speed / (0.02 * np.percentile(np.abs(speed), 95) + 1e-3))
            own = np.column_stack([actual - actual.mean(), acceleration[:, joint]])
            table = np.column_stack([own, speed, slip, np.ones_like(speed)])
            factors, *_ = np.linalg.lstsq(table, command[:, joint] - actual, rcond=None)
            if np.var(own @ factors[:2]) < _OF_ITS_OWN**2 * size:
                found[joint] = float(np.mean((command[:, joint] - actual - table @ factors) ** 2)) / size
        return found

    def _outside(self, position: Float64[np.ndarray, "N J"]) -> tuple[np.ndarray, np.ndarray]:
        low, high = self.first.limits.T
        apart = np.maximum(np.maximum(low - position, position - high), 0.0)
        width = np.where(np.isfinite(high - low), high - low, 1.0)
        return (apart > 0.02 * width + 0.02).mean(axis=0), np.percentile(apart, 98, axis=0)


def loss(score: Score, than: Score) -> Float64[np.ndarray, "J"]:
    """Logarithm of what is left, joint by joint; 0 for joints that do not move. Being outside of a range counts, too.

    A joint that moves no more, since its numbers are read as next to nothing, is explained no better.

    Args:
        score: of a reading.
        than: of the one that it is compared with: what is left counts no further down than to a small share of what the
            model could explain there.
    """
    least = _FLOOR + _SMALL * np.nan_to_num(np.minimum(than.blind, 0.01))
    known = np.where(np.isnan(score.left), np.fmax(than.left, 1.0), score.left)
    left = np.where(np.isnan(known), 1.0, np.clip(known, least, 1e6))
    return np.asarray(np.log(left) + 4.0 * score.outside)


def _solved(
    gram: Float64[np.ndarray, "K K"], limits: tuple[float, float, float, float]
) -> tuple[float, Float64[np.ndarray, "C"]]:
    """Least squares with factors that are not negative: of the first within limits, of the last two below a limit.

    Args:
        gram: of columns and target.
        limits: lowest and highest factor of the first column, lowest of the second, largest constant.
    """
    lowest, highest, slowest, largest = limits
    count = len(gram) - 1
    fixed: dict[int, float] = {}
    while True:
        free = [index for index in range(count) if index not in fixed]
        target = gram[:count, count] - sum(
            (gram[:count, index] * value for index, value in fixed.items()), np.zeros(count)
        )
        scale = np.sqrt(np.maximum(np.diag(gram)[free], 1e-300))
        own = gram[np.ix_(free, free)] / np.outer(scale, scale) + 1e-12 * np.eye(len(free))
        factor = np.linalg.cholesky(own + 1e-10 * np.eye(len(free)))
        found, _ = nnls(factor.T, np.linalg.solve(factor, target[free] / scale))
        factors = np.zeros(count)
        factors[free] = found / scale
        for index, value in fixed.items():
            factors[index] = value
        if 0 not in fixed and not lowest <= factors[0] <= highest:
            fixed[0] = float(np.clip(factors[0], lowest, highest))
        elif 1 not in fixed and factors[1] < slowest:
            fixed[1] = slowest
        elif not fixed.keys() & {count - 1, count - 2} and max(factors[-2:]) > largest:
            larger = count - 2 if factors[-2] > factors[-1] else count - 1
            fixed |= {larger: largest, (2 * count - 3) - larger: 0.0}
        else:
            return _rest(gram, factors), factors


def _rest(gram: Float64[np.ndarray, "K K"], factors: Float64[np.ndarray, "C"]) -> float:
    whole = np.append(-factors, 1.0)
    return max(float(whole @ gram @ whole), 0.0)
