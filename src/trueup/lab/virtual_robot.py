"""A robot that behaves like hardware: `VirtualRobot`, a `RobotIO` and the `Clock` on which it lives."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Float64, Int

from trueup.core.timeseries import TimeSeries, same_units
from trueup.core.units import SI_UNIT
from trueup.errors import ConfigError, DataError, MissingSignal, RobotStopped
from trueup.lab.accelerometer import Accelerometer
from trueup.lab.base import draw_base
from trueup.lab.faults import FOREVER, Fault, stalls
from trueup.lab.markers import MotionCapture
from trueup.lab.plant import (
    CURRENT,
    LOGGED,
    MOTOR_POSITION,
    MOTOR_TORQUE,
    POSITION,
    RISE,
    TORQUE,
    VELOCITY,
    VOLTAGE,
    Orders,
    compiled,
)
from trueup.lab.setup import Carrier, Plant, build_plant
from trueup.lab.simulated_robot import Sensors, ticks_until
from trueup.lab.truth import Truth, draw_truth
from trueup.sim.compiled_robot import ABSURD

_COMMANDS: Mapping[str, tuple[str, ...]] = {
    "impedance": ("position", "velocity"),
    "torque": ("torque",),
    "servo": ("position",),
    "pd": ("position",),
}
_USUAL_SPEED = 0.5  # of a joint at work [rad/s]
_MEASURED = {"position": "rad", "velocity": "rad/s", "torque": "Nm"}
_OF_SERVOS = {"position": "rad", "velocity": "rad/s", "current": "A", "voltage": "V"}
_HIDDEN = {
    **_MEASURED,
    "motor_position": "rad",
    "motor_torque": "Nm",
    "rise": "K",
    "current": "A",
    "voltage": "V",
}
_PLACES = (POSITION, VELOCITY, TORQUE, MOTOR_POSITION, MOTOR_TORQUE, RISE, CURRENT, VOLTAGE)
_ROWS = dict(zip(_HIDDEN, _PLACES, strict=True))


class _Look(NamedTuple):
    """What is needed to say what a motion capture and an accelerometer saw."""

    places: np.ndarray  # (N, Q), all coordinates of the model; none where there are no markers
    drawn: np.ndarray  # (N, M, 6)
    felt: np.ndarray  # (N, 3), noise of the accelerometer; none where there is none


@dataclass(frozen=True, eq=False)
class Execution:
    """What came of a whole command trajectory.

    Attributes:
        measured: `position`, `velocity`, `torque` as the sensors read them, of servos `current` and `voltage` in
            place of the torque; `body.position` and `body.rotation` of bodies with markers, `body.specific_force` of
            a base with an accelerometer. The first row is from before the first command, the last from after the last
            one, or from the moment of a stop.
        truth: the same signals without sensors, and `motor_position`, `motor_torque`, `rise` (temperature above the
            surroundings). For tests and studies; it belongs into no dataset.
        stopped_s: when a protective stop ended it [s], None if nothing did.
    """

    measured: TimeSeries
    truth: TimeSeries
    stopped_s: float | None


class VirtualRobot:
    """One individual of a kind of robot, with a payload, in motion or at rest.

    Two faces, the same motion: `write` and `read` at control steps, as a driver does, and `execute` with commands
    that are known beforehand, which runs compiled. Time passes in whole control steps; the command that was written
    last is sent to the robot again at each of them. As long as nothing was written, it holds its starting pose (or,
    torque controlled, its weight).

    Args:
        truth: the individual; the first Panda with all effects if None.
        position: starting pose, (J,) [rad or m]; the model's keyframe `home` if None, else zero.
        payload_kg: [kg].
        seed: of sensor noise, jitter and lost readings.
        faults: what will go wrong.
        real_time: waiting takes as long as it says; otherwise the robot runs as fast as it can.
        carrier: makes a model of the robot on something that moves, such as a base on wheels, which is driven through
            `engine`; held as in its own model if None.

    Raises:
        ConfigError: a truth, payload or fault that does not fit the robot's model.
    """

    def __init__(
        self,
        truth: Truth | None = None,
        *,
        position: Float[np.ndarray, "J"] | None = None,
        payload_kg: float = 0.0,
        seed: int = 0,
        faults: Sequence[Fault] = (),
        real_time: bool = False,
        carrier: Carrier | None = None,
    ) -> None:
        self.truth = truth or draw_truth()
        spec = self.truth.spec
        self.joints: tuple[str, ...] = tuple(self.truth.joints)
        self.control_step_s = spec.control_step_s
        self.command_signals = _COMMANDS[spec.controller.kind]
        self._measured = _OF_SERVOS if spec.controller.kind == "servo" else _MEASURED
        self.payload_kg = payload_kg
        self._carrier = carrier
        self._plant: Plant = build_plant(self.truth, payload_kg, carrier=carrier)
        self._sensors = spec.readings.sensors if spec.readings.enabled else Sensors()
        self._bias = np.array([joint.torque_bias_nm for joint in self.truth.joints.values()])
        self._capture = MotionCapture(self._plant.model, spec.markers)
        if spec.inertial.body and carrier is not None:
            raise ConfigError("an inertial sensor is on a base that moves as prescribed", got="a carrier")
        self._accelerometer = Accelerometer(self._plant.model, spec.inertial)
        self._real_time = real_time
        self._advance, self._weigh = compiled()
        self._command = np.zeros((2, len(self.joints)))
        self._reading: dict[str, Float64[np.ndarray, "J"]] = {}
        self.restart(position=position, seed=seed, faults=faults)

    def restart(
        self,
        *,
        position: Float[np.ndarray, "J"] | None = None,
        seed: int | Sequence[int] = 0,
        faults: Sequence[Fault] = (),
        worked_s: float = 0.0,
    ) -> None:
        """Begin anew, with the clock at zero: what follows depends on these arguments and on nothing before.

        Args:
            position: starting pose, as for the robot itself.
            seed: of sensor noise, jitter and lost readings; several numbers are one seed, too.
            faults: what will go wrong.
            worked_s: its joints are as warm as after so long a work [s]: moving at about 0.5 rad/s around `home`.

        Raises:
            ConfigError: a fault that does not fit, or a negative time.
        """
        if not 0 <= worked_s < np.inf:
            raise ConfigError("worked_s must not be negative", got=worked_s)
        streams = np.random.default_rng([*np.atleast_1d(seed).tolist(), self.truth.unit]).spawn(6)
        self._noise, self._jitter, self._losses, self._looks, underfoot, inertial = streams
        self._accelerometer.restart(inertial)
        self._base = draw_base(self.truth.spec.base, underfoot)
        self._faults = tuple(faults)
        self._stalls = stalls(self._faults, self.joints, self.control_step_s)
        self._stop = min((f.ticks(self.control_step_s)[0] for f in faults if f.kind == "stop"), default=FOREVER)
        self._started = time.monotonic()
        self._plant.state.counters[:] = 0
        self.place(self._plant.home)
        self._plant.state.joints["rise"][:] = self._plant.warmth(_USUAL_SPEED, worked_s)
        if position is not None:
            self.place(position)

    @property
    def engine(self) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """MuJoCo's model and data, for what carries the robot: whoever steps or resets them breaks it."""
        return self._plant.model, self._plant.data

    @property
    def stopped(self) -> bool:
        """Whether a protective stop holds it."""
        return self._tick >= self._stop

    @property
    def _tick(self) -> int:
        return int(self._plant.state.counters[0])

    def now_s(self) -> float:
        """Seconds on the robot's clock."""
        return self._tick * self.control_step_s

    def wait_until_s(self, time_s: float) -> None:
        """Let time pass up to the first control step at or after `time_s`; nothing happens if it has passed.

        Raises:
            DataError: the robot's simulation diverged.
        """
        count = ticks_until(time_s, self.control_step_s) - self._tick
        if count > 0:
            held = np.broadcast_to(self._command, (count, *self._command.shape))
            self._run(held, with_velocity=self._with_velocity, until_stop=False)
        self._keep_time()

    def read(self) -> dict[str, Float64[np.ndarray, "J"]]:
        """What the sensors said last: `position` and `velocity` of the links, `torque` between motor and link.

        Of servos `current` and `voltage` in place of the torque. What is seen of markers, and felt by the base, is in
        what `execute` has measured.
        """
        return {signal: values.copy() for signal, values in self._reading.items()}

    def write(self, command: dict[str, Float[np.ndarray, "J"]]) -> None:
        """Send this command from now on.

        Args:
            command: `position`, and `velocity` if it is known; a torque-controlled robot takes `torque`, a servo
                `position` alone.

        Raises:
            RobotStopped: after a protective stop.
            MissingSignal: a signal that the controller does not follow.
            DataError: not one finite value per joint.
        """
        self._refuse_stopped()
        for signal, values in command.items():
            self._check(signal, values[None])
        if "velocity" in command:
            self._command[1] = command["velocity"]
        if first := [signal for signal in ("position", "torque") if signal in command]:
            self._command[0] = command[first[0]]
        self._with_velocity = "velocity" in command

    def execute(self, command: dict[str, Float[np.ndarray, "N J"]], *, every: int = 1) -> Execution:
        """Follow a whole trajectory, one row per control step; the same as writing the rows one by one.

        Args:
            command: as for `write`, (N, J).
            every: keep every so many control steps of what was measured.

        Raises:
            RobotStopped: it had stopped before.
            MissingSignal: a signal is missing, or one that the controller does not follow.
            DataError: not one finite value per joint and row, `every` is not positive, or the simulation diverged.
        """
        self._refuse_stopped()
        first = self.command_signals[0]
        if first not in command:
            raise MissingSignal(f"a trajectory of this robot needs {first!r}", available=command)
        for signal, values in command.items():
            self._check(signal, values)
        if every < 1 or len({len(values) for values in command.values()}) != 1:
            raise DataError("a trajectory needs as many rows of each signal, and every >= 1", got=f"every={every}")
        rows = np.zeros((len(command[first]), *self._command.shape))
        rows[:, 0] = command[first]
        if "velocity" in command:
            rows[:, 1] = command["velocity"]
        start, before, true_before, look = self._tick, self._reading, self._truth_now(), self._look
        readings, log, looks = self._run(rows, with_velocity="velocity" in command, until_stop=True)
        done = len(log)
        if done:
            self._command, self._with_velocity = rows[done - 1].copy(), "velocity" in command
        self._keep_time()
        kept = np.arange(0, done + 1, every)
        clock = (start + kept) * self.control_step_s
        measured = {name: np.concatenate([before[name][None], readings[name]])[kept] for name in self._measured}
        true = {signal: np.concatenate([true_before[row][None], log[:, row]])[kept] for signal, row in _ROWS.items()}
        seen, poses = self._of_bodies(look, looks, kept, clock)
        return Execution(
            measured=self._series(clock, measured, self._measured, seen),
            truth=self._series(clock, true, _HIDDEN, poses),
            stopped_s=self.now_s() if done < len(rows) else None,
        )

    def _of_bodies(
        self, before: _Look, after: _Look, kept: Int[np.ndarray, "N"], clock: Float64[np.ndarray, "N"]
    ) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Bodies with sensors as they are seen, and as they are; nothing where there are none."""
        if self._accelerometer.bodies:
            standing = self._plant.engine.gravity
            pull = np.tile(standing, (len(clock), 1)) if self._base is None else self._base.gravity(clock, standing)
            return self._accelerometer.felt(pull, np.concatenate([before.felt, after.felt])[kept])
        if not self._capture.bodies:
            return {}, {}
        places, drawn = (np.concatenate(parts)[kept] for parts in zip(before[:2], after[:2], strict=True))
        poses = self._capture.poses(places)
        return self._capture.seen(poses, drawn), poses

    def _series(
        self,
        clock: Float64[np.ndarray, "N"],
        signals: dict[str, Float64[np.ndarray, "N J"]],
        units: Mapping[str, str],
        bodies: dict[str, np.ndarray],
    ) -> TimeSeries:
        names = self._accelerometer.bodies or self._capture.bodies
        of_bodies = {name: (SI_UNIT[name],) * len(names) for name in bodies}
        return TimeSeries(
            clock,
            self.joints,
            {**signals, **bodies},
            {**same_units(units, self.joints), **of_bodies},
            names,
        )

    def stop(self) -> None:
        """A protective stop, now."""
        self._stop = min(self._stop, self._tick)

    def recover(self) -> None:
        """Open the brakes after a stop and hold the present pose; later stops still come."""
        if not self.stopped:
            return
        later = [f.ticks(self.control_step_s)[0] for f in self._faults if f.kind == "stop"]
        self._stop = min((tick for tick in later if tick > self._tick), default=FOREVER)
        self._hold(self._plant.position())

    def place(self, position: Float[np.ndarray, "J"]) -> None:
        """Put the robot into a pose, at rest, as if it had been there; its clock and its warmth stay.

        Raises:
            DataError: not one finite value per joint.
        """
        pose = np.asarray(position, np.float64)
        if pose.shape != (len(self.joints),) or not np.isfinite(pose).all():
            raise DataError("a pose needs one finite value per joint", got=pose)
        if self._base is not None:
            self._plant.engine.pull[:] = self._pull(self._tick, 1)[0]
        self._plant.place(pose)
        self._weigh(self._plant.engine, self._plant.numbers, self._plant.state)
        self._plant.state.joints["drive"][:] = self._plant.state.joints["weight"]
        self._hold(pose)
        self._reading = {name: values[0] for name, values in self._sense(self._truth_now()[None]).items()}
        self._look = self._looked(self._plant.data.qpos[None].copy(), 1)

    def load(self, payload_kg: float) -> None:
        """Change the payload, at rest in the present pose.

        Raises:
            ConfigError: the payload is out of range.
        """
        pose, old = self._plant.position(), self._plant
        self._plant = build_plant(self.truth, payload_kg, carrier=self._carrier)
        self._capture = MotionCapture(self._plant.model, self.truth.spec.markers)
        self._plant.state.joints["rise"][:] = old.state.joints["rise"]
        self._plant.state.counters[:] = old.state.counters
        self.payload_kg = payload_kg
        self.place(pose)

    def _hold(self, pose: Float64[np.ndarray, "J"]) -> None:
        """Forget all commands and stay."""
        state = self._plant.state
        self._command[:] = 0.0
        if self.command_signals[0] == "position":
            self._command[0] = pose
        self._with_velocity = False
        state.joints["reference"][:] = pose
        state.active[:] = self._command
        state.follows_velocity[0] = 0
        state.counters[1:] = state.counters[0]

    def _run(
        self, rows: Float64[np.ndarray, "N 2 J"], *, with_velocity: bool, until_stop: bool
    ) -> tuple[dict[str, Float64[np.ndarray, "M J"]], Float64[np.ndarray, "M S J"], _Look]:
        plant, start = self._plant, self._tick
        log = np.empty((len(rows), LOGGED, len(self.joints)))
        places = np.empty((len(rows) if self._capture.bodies else 0, plant.model.nq))
        # As many draws as steps are done, so that a motion in pieces has those of the whole.
        count = min(len(rows), max(0, self._stop - start)) if until_stop else len(rows)
        orders = Orders(
            np.array(rows[:count]),
            with_velocity,
            self._jitter.random(count),
            self._stop,
            until_stop,
            self._stalls,
            self._pull(start, count),
        )
        with np.errstate(all="ignore"):
            done = int(self._advance(plant.engine, plant.numbers, plant.settings, plant.state, orders, log, places))
        log = log[:done]
        if not (np.abs(log[:, (POSITION, VELOCITY)]) <= ABSURD).all():  # a NaN is not
            raise DataError("the simulation of the robot diverged", got=f"after {start * self.control_step_s:.3f} s")
        readings = self._sense(log)
        readings = self._after_losses(readings, start + 1, self._losses.random(done))
        looks = self._looked(places[:done], done)
        if done:
            self._reading = {signal: values[-1] for signal, values in readings.items()}
            self._look = _Look(*(values[-1:] for values in looks))
        return readings, log, looks

    def _pull(self, first: int, count: int) -> Float64[np.ndarray, "N 3"]:
        """Gravity in the middle of so many control steps, in the frame of the base; no rows where it is at rest."""
        if self._base is None:
            return np.zeros((0, 3))
        middle = (first + np.arange(count) + 0.5) * self.control_step_s
        return self._base.gravity(middle, self._plant.engine.gravity)

    def _looked(self, places: Float64[np.ndarray, "L Q"], rows: int) -> _Look:
        return _Look(places, self._capture.draw(self._looks, rows), self._accelerometer.draw(rows))

    def _sense(self, log: Float64[np.ndarray, "N S J"]) -> dict[str, Float64[np.ndarray, "N J"]]:
        truth = {signal: log[:, _ROWS[signal]] for signal in self._measured}
        if "torque" in truth:
            truth["torque"] = truth["torque"] + self._bias
        return self._sensors.sense(truth, self._noise)

    def _after_losses(
        self, readings: dict[str, Float64[np.ndarray, "N J"]], first: int, chance: Float64[np.ndarray, "N"]
    ) -> dict[str, Float64[np.ndarray, "N J"]]:
        """The readings as they arrive: instead of a lost one, the one before it."""
        lost = self._lost(first + np.arange(chance.size), chance)
        if not lost.any():
            return readings
        row = np.maximum.accumulate(np.where(lost, -1, np.arange(lost.size)))
        return {
            signal: np.where(row[:, None] < 0, self._reading[signal], values[np.maximum(row, 0)])
            for signal, values in readings.items()
        }

    def _lost(self, ticks: np.ndarray, chance: Float64[np.ndarray, "N"]) -> Bool[np.ndarray, "N"]:
        lost = np.zeros(ticks.size, bool)
        for fault in self._faults:
            if fault.kind == "drop":
                first, end = fault.ticks(self.control_step_s)
                lost |= (ticks >= first) & (ticks < end) & (chance < fault.share)
        return lost

    def _truth_now(self) -> Float64[np.ndarray, "S J"]:
        state, plant = self._plant.state, self._plant
        rows = (
            plant.position(),
            plant.velocity(),
            state.joints["spring"],
            state.joints["motor_position"],
            state.joints["drive"],
            state.joints["rise"],
            state.joints["current"],
            state.joints["voltage"],
        )
        return np.stack([np.array(row) for row in rows])

    def _check(self, signal: str, values: Float[np.ndarray, "N J"]) -> None:
        if signal not in self.command_signals:
            raise MissingSignal(f"the robot takes no {signal!r}", available=self.command_signals)
        if values.ndim != 2 or values.shape[1] != len(self.joints) or not np.isfinite(values).all():
            raise DataError(f"a {signal} command needs one finite value per joint", got=values)

    def _refuse_stopped(self) -> None:
        if self.stopped:
            raise RobotStopped(
                "the robot has stopped", got=f"{self.now_s():.3f} s on its clock", hint="Call recover() to carry on."
            )

    def _keep_time(self) -> None:
        if self._real_time:
            time.sleep(max(0.0, self._started + self.now_s() - time.monotonic()))
