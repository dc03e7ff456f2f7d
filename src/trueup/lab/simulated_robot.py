"""A simulator that behaves like a robot: it takes commands and reports what its sensors say, on a clock of its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float64

from trueup.core.protocols import Simulator
from trueup.errors import ConfigError, DataError, MissingSignal
from trueup.sim.compiled_robot import ABSURD

_INSTANT = 1e-6  # share of a control step


@dataclass(frozen=True)
class Sensors:
    """What sensors make of the truth: first noise, then steps; 0 leaves a signal as it is.

    Attributes:
        position_noise_rad: standard deviation.
        position_step_rad: encoder resolution.
        velocity_noise_rad_s: standard deviation.
        velocity_step_rad_s: resolution.
        torque_noise_nm: standard deviation.
        torque_step_nm: resolution.
        current_noise_a: standard deviation, of servos.
        current_step_a: resolution.
        voltage_noise_v: standard deviation, of servos.
        voltage_step_v: resolution.

    Raises:
        ConfigError: a negative value.
    """

    position_noise_rad: float = 0.0
    position_step_rad: float = 0.0
    velocity_noise_rad_s: float = 0.0
    velocity_step_rad_s: float = 0.0
    torque_noise_nm: float = 0.0
    torque_step_nm: float = 0.0
    current_noise_a: float = 0.0
    current_step_a: float = 0.0
    voltage_noise_v: float = 0.0
    voltage_step_v: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what is no sensor."""
        if min(noise for pair in self.by_signal.values() for noise in pair) < 0:
            raise ConfigError("noise and steps of sensors must not be negative", got=self)

    @property
    def by_signal(self) -> dict[str, tuple[float, float]]:
        """Signal -> noise and step."""
        return {
            "position": (self.position_noise_rad, self.position_step_rad),
            "velocity": (self.velocity_noise_rad_s, self.velocity_step_rad_s),
            "torque": (self.torque_noise_nm, self.torque_step_nm),
            "current": (self.current_noise_a, self.current_step_a),
            "voltage": (self.voltage_noise_v, self.voltage_step_v),
        }

    def sense(
        self, truth: Mapping[str, Float64[np.ndarray, "*T J"]], rng: np.random.Generator
    ) -> dict[str, Float64[np.ndarray, "*T J"]]:
        """One reading of each signal at each time; many at once draw the same noise as one after the other."""
        *times, joints = truth["position"].shape
        drawn = rng.standard_normal((*times, len(truth), joints))
        reading = {}
        for index, (signal, (noise, step)) in enumerate((name, self.by_signal[name]) for name in truth):
            values = truth[signal] + noise * drawn[..., index, :]
            reading[signal] = np.round(values / step) * step if step else values
        return reading


def ticks_until(time_s: float, control_step_s: float) -> int:
    """Number of the first control step at or after a time; what rounding puts just before it counts as it."""
    return int(np.ceil(time_s / control_step_s - _INSTANT))


class SimulatedRobot:
    """One copy of a simulated robot as `RobotIO`, and the `Clock` on which it lives.

    Time passes only in `wait_until_s`, in whole control steps: the command that was written last is held for the
    physics steps of one control step, then the sensors are read. As long as nothing was written, a position command
    holds the starting pose, and other commands are zero.

    Args:
        simulator: the truth; `reset` and `step` are used, with one copy.
        position: starting pose, (J,) [rad or m]; zero if None.
        velocity: (J,) [rad/s or m/s]; zero if None.
        steps_per_control: physics steps per control step.
        sensors: noise and resolution.
        seed: of the sensor noise.

    Raises:
        ConfigError: `steps_per_control` is not positive.
    """

    def __init__(
        self,
        simulator: Simulator,
        *,
        position: Float[np.ndarray, "J"] | None = None,
        velocity: Float[np.ndarray, "J"] | None = None,
        steps_per_control: int = 1,
        sensors: Sensors | None = None,
        seed: int = 0,
    ) -> None:
        if steps_per_control < 1:
            raise ConfigError("steps_per_control must be positive", got=steps_per_control)
        self.simulator = simulator
        self.control_step_s = steps_per_control * simulator.timestep_s
        self._steps = steps_per_control
        self._sensors = sensors or Sensors()
        self._rng = np.random.default_rng(seed)
        self._tick = 0
        nothing = np.zeros(len(simulator.joints))
        truth = {
            "position": nothing if position is None else np.asarray(position, np.float64),
            "velocity": nothing if velocity is None else np.asarray(velocity, np.float64),
            "torque": nothing,
        }
        simulator.reset(truth["position"][None], truth["velocity"][None])
        self._command = {
            signal: (truth["position"] if signal == "position" else nothing)[None].copy()
            for signal in simulator.command_signals
        }
        self._reading = self._sensors.sense(truth, self._rng)

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the J joints."""
        return self.simulator.joints

    @property
    def command_signals(self) -> tuple[str, ...]:
        """Signals that its controller follows; the first is required."""
        return self.simulator.command_signals

    def recover(self) -> None:
        """Nothing: it never stops."""

    def now_s(self) -> float:
        """Simulated seconds since the start."""
        return self._tick * self.control_step_s

    def wait_until_s(self, time_s: float) -> None:
        """Simulate up to the first control step at or after `time_s`; nothing happens if it has passed.

        Raises:
            DataError: the simulation diverged.
        """
        last = ticks_until(time_s, self.control_step_s)
        while self._tick < last:
            self._advance()

    def read(self) -> dict[str, Float[np.ndarray, "J"]]:
        """What the sensors said at the last control step: `position`, `velocity`, `torque`."""
        return {signal: values.copy() for signal, values in self._reading.items()}

    def write(self, command: dict[str, Float[np.ndarray, "J"]]) -> None:
        """Hold this command from now on; signals that are left out stay as they are.

        Raises:
            MissingSignal: a signal that the controller does not follow.
            DataError: not one finite value per joint.
        """
        for signal, values in command.items():
            if signal not in self._command:
                raise MissingSignal(f"the robot takes no {signal!r}", available=self._command)
            if values.shape != (len(self.joints),) or not np.isfinite(values).all():
                raise DataError(f"a {signal} command needs one finite value per joint", got=values)
        for signal, values in command.items():
            self._command[signal] = np.array(values, np.float64)[None]

    def _advance(self) -> None:
        for _ in range(self._steps):
            state = self.simulator.step(self._command)
        truth = {signal: np.asarray(state[signal][0], np.float64) for signal in ("position", "velocity", "torque")}
        size = max(np.abs(truth["position"]).max(), np.abs(truth["velocity"]).max())
        if not size <= ABSURD:  # a NaN is not
            raise DataError("the simulation of the robot diverged", got=f"{self.now_s():.3f} s after its start")
        self._tick += 1
        self._reading = self._sensors.sense(truth, self._rng)
