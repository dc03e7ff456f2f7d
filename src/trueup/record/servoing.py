"""A robot that takes torques, led along positions: springs and dampers at its joints, closed in the control loop."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Float64

from trueup.core.protocols import Hardware
from trueup.errors import ConfigError, DataError, MissingSignal, RobotStopped

if TYPE_CHECKING:
    import mujoco

# How quick the springs are by default: natural frequency of each joint with all that hangs on it [Hz].
SERVO_HZ = 3.0


class Springs:
    """Critically damped springs at the joints, as stiff as suits what moves.

    Their torque is M(q) (w^2 (q* - q) + 2 w (dq* - dq)). With the inertia M of the pose, no joint is stiffer than a
    control loop can be where little hangs on it (computed torque control, without what the robot itself does for its
    weight).

    Args:
        model: the robot, with joints of one degree of freedom.
        joints: names of the J joints.
        most: largest torques, (J,) [Nm or N].
        frequency_hz: w / 2 pi [Hz].

    Raises:
        ConfigError: a frequency that is none.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        joints: Sequence[str],
        most: Float[np.ndarray, "J"],
        *,
        frequency_hz: float = SERVO_HZ,
    ) -> None:
        import mujoco

        if not 0 < frequency_hz < np.inf:
            raise ConfigError("the frequency of a servo must be positive", got=frequency_hz)
        self._mujoco, self._model, self._data = mujoco, model, mujoco.MjData(model)
        rows = [model.joint(name) for name in joints]
        self._qpos = np.array([row.qposadr[0] for row in rows])
        self._dofs = np.ix_([row.dofadr[0] for row in rows], [row.dofadr[0] for row in rows])
        self._full = np.zeros((model.nv, model.nv))
        self._w = 2 * np.pi * frequency_hz
        self.most = np.asarray(most, np.float64)

    def torque(
        self,
        position: Float[np.ndarray, "J"],
        velocity: Float[np.ndarray, "J"],
        goal: tuple[Float[np.ndarray, "J"], Float[np.ndarray, "J"]],
    ) -> Float64[np.ndarray, "J"]:
        """What leads the joints to a position and velocity [Nm or N]."""
        self._data.qpos[self._qpos] = position
        self._mujoco.mj_kinematics(self._model, self._data)
        self._mujoco.mj_comPos(self._model, self._data)
        self._mujoco.mj_crb(self._model, self._data)
        self._mujoco.mj_fullM(self._model, self._data, self._full)
        pull = self._w**2 * (goal[0] - position) + 2 * self._w * (goal[1] - velocity)
        return np.asarray(np.clip(self._full[self._dofs] @ pull, -self.most, self.most))


class TorqueServo:
    """Hardware that takes torques, driven by positions and velocities as a `Recorder` does.

    At each of its own control steps the springs say the torque, on top of what the robot itself does for its weight.
    What was sent is kept: it is what a model of a robot that takes torques is driven by.

    Args:
        inner: the robot; it measures positions and velocities.
        springs: at its joints.
        step_s: its control step [s].

    Raises:
        ConfigError: the robot follows no torques.
        MissingSignal: it does not say where it is, or how fast.
    """

    def __init__(self, inner: Hardware, springs: Springs, *, step_s: float = 1e-3) -> None:
        if "torque" not in inner.command_signals:
            raise ConfigError("a servo is for robots that take torques", got=inner.command_signals)
        reading = inner.read()
        if missing := {"position", "velocity"} - set(reading):
            raise MissingSignal(f"a servo needs {sorted(missing)}", available=reading)
        self.inner, self._springs, self._step_s = inner, springs, step_s
        self._goal = np.array(reading["position"], np.float64), np.zeros(len(inner.joints))
        self.sent: Float64[np.ndarray, "J"] = np.zeros(len(inner.joints))

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the J joints."""
        return self.inner.joints

    @property
    def command_signals(self) -> tuple[str, ...]:
        """Positions, and velocities where they are known."""
        return ("position", "velocity")

    def read(self) -> dict[str, Float[np.ndarray, "J"]]:
        """What the robot measures."""
        return self.inner.read()

    def write(self, command: dict[str, Float[np.ndarray, "J"]]) -> None:
        """Where the joints should be, and how fast they should move; at rest if that is not said.

        Raises:
            MissingSignal: no position, or another signal.
            DataError: not one finite value per joint.
            RobotStopped: the robot takes no commands.
        """
        if "position" not in command or set(command) - set(self.command_signals):
            raise MissingSignal("a servo follows positions", available=command)
        for signal, values in command.items():
            if np.shape(values) != (len(self.joints),) or not np.isfinite(values).all():
                raise DataError(f"a {signal} command needs one finite value per joint", got=values)
        position = np.array(command["position"], np.float64)
        self._goal = position, np.array(command.get("velocity", np.zeros_like(position)), np.float64)
        self._servo()

    def now_s(self) -> float:
        """Seconds on the robot's clock."""
        return self.inner.now_s()

    def wait_until_s(self, time_s: float) -> None:
        """Let time pass, with new torques at each control step; one that stops meanwhile refuses the next command."""
        with contextlib.suppress(RobotStopped):
            while (now := self.inner.now_s()) + self._step_s < time_s - 1e-9:
                self.inner.wait_until_s(now + self._step_s)
                self._servo()
        self.inner.wait_until_s(time_s)

    def recover(self) -> None:
        """Make it take commands again after a stop; it stays where it is."""
        self.inner.recover()
        self._goal = np.array(self.inner.read()["position"], np.float64), np.zeros(len(self.joints))
        self._servo()

    def _servo(self) -> None:
        reading = self.inner.read()
        self.sent = self._springs.torque(reading["position"], reading["velocity"], self._goal)
        self.inner.write({"torque": self.sent})
