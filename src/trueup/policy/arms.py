"""Arms that take torques, one or many: simulated in MuJoCo side by side, in any engine, or hardware."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, runtime_checkable

import mujoco
import numpy as np
from jaxtyping import Float, Float64, Int
from mujoco import batch

from trueup.core.protocols import Hardware, Simulator
from trueup.errors import ConfigError, DataError, RobotStopped
from trueup.policy.delay_line import Delay, DelayLine
from trueup.sim import MujocoSimulator
from trueup.sim.transitions import physics_steps


@runtime_checkable
class Arms(Protocol):
    """N arms of J joints, each at a moment of its own, that hold their weight and add the torques that they are told.

    After a step, `position` and `velocity` are those of its end; no numbers, or absurdly fast, where a simulation
    diverged.
    """

    count: int
    control_s: float

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the J joints."""
        ...

    @property
    def position(self) -> Float64[np.ndarray, "N J"]:
        """Measured [rad or m]."""
        ...

    @property
    def velocity(self) -> Float64[np.ndarray, "N J"]:
        """Measured [rad/s or m/s]."""
        ...

    def begin(self, rows: Int[np.ndarray, "R"], position: Float[np.ndarray, "R J"], rng: np.random.Generator) -> None:
        """Put R of them into these poses, at rest; what is drawn anew for each episode is drawn from `rng`."""
        ...

    def step(self, torque: Float[np.ndarray, "N J"]) -> None:
        """One control step with these torques [Nm or N]."""
        ...


class MujocoArms:
    """Arms in MuJoCo itself, on threads of the processor.

    Args:
        simulator: a robot that follows torques.
        count: N.
        control_s: control step [s].
        delay_s: torques act this much later, one number per joint or one for all [s].
        threads: of the processor.
        draw: makes the model of an arm for the next episode, with the simulator's joints and the same structure each
            time, and says how much later its torques act, (J,) [s]; the simulator's own and `delay_s` for all if None.

    Raises:
        ConfigError: the control step is no number of physics steps, a delay is negative, or the robot follows no
            torques.
    """

    def __init__(
        self,
        simulator: MujocoSimulator,
        count: int,
        control_s: float,
        *,
        delay_s: Delay = 0.0,
        threads: int = 1,
        draw: Callable[[np.random.Generator], tuple[mujoco.MjModel, Float64[np.ndarray, "J"]]] | None = None,
    ) -> None:
        self.count, self.control_s = count, control_s
        self._substeps = substeps_of(simulator, control_s)
        self._simulator, self._draw = simulator, draw
        # A drawn payload is a body more than the simulator has: all models have the structure of the drawn ones.
        model = simulator.model if draw is None else draw(np.random.default_rng(0))[0]
        self._batch = batch.Batch(model, nsim=count, nthread=threads)
        self._models = [model] * count
        self._qpos, self._qvel = simulator.places
        self._ctrl, self._state = self._batch.bind("ctrl"), (self._batch.bind("qpos"), self._batch.bind("qvel"))
        self._drive = self._batch.bind("qfrc_actuator")
        # Commands go into actuators as they are: a matrix says which, quicker than the simulator does.
        self._wires = simulator.control_of({"torque": np.eye(len(simulator.joints))[:, None]})[:, 0]
        self.position = np.zeros((count, len(self.joints)))
        self.velocity = np.zeros_like(self.position)
        self._line = DelayLine(simulator, control_s, delay_s, count=count)

    @property
    def joints(self) -> tuple[str, ...]:
        """See `Arms`."""
        return self._simulator.joints

    @property
    def torque(self) -> Float64[np.ndarray, "N J"]:
        """Of the drives, in the last physics step [Nm or N]."""
        return np.asarray(self._drive.take(self._qvel, axis=1))

    def begin(self, rows: Int[np.ndarray, "R"], position: Float[np.ndarray, "R J"], rng: np.random.Generator) -> None:
        """See `Arms`."""
        if self._draw is not None:
            for row in rows.tolist():
                self._models[row], delays = self._draw(rng)
                self._line.set(np.array([row]), delays)
            self._batch.set_models(self._models)
        self._line.clear(rows)
        self._batch.reset(rows, stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        qpos, qvel = (own[rows] for own in self._state)
        self._simulator.place(qpos, qvel, position, np.zeros_like(position))
        self._state[0][rows], self._state[1][rows] = qpos, qvel
        self.position[rows], self.velocity[rows] = position, 0.0

    def step(self, torque: Float[np.ndarray, "N J"]) -> None:
        """See `Arms`."""
        failed: np.ndarray | None = None
        try:
            if self._line.delayed:
                self._batch.rollout(self._substeps, self._line.acting(torque) @ self._wires, record=())
            else:
                np.matmul(torque, self._wires, out=self._ctrl)
                self._batch.step(nstep=self._substeps)
        except batch.SimulationError as error:
            failed = error.ids
        self.position = self._state[0].take(self._qpos, axis=1)
        self.velocity = self._state[1].take(self._qvel, axis=1)
        if failed is not None:
            self.position[failed] = np.nan


class EngineArm:
    """One arm in any engine.

    Args:
        simulator: a robot that follows torques.
        control_s: control step [s].
        delay_s: see `MujocoArms`.

    Raises:
        ConfigError: see `MujocoArms`.
    """

    count = 1

    def __init__(self, simulator: Simulator, control_s: float, *, delay_s: Delay = 0.0) -> None:
        self.control_s = control_s
        self._substeps = substeps_of(simulator, control_s)
        self._simulator = simulator
        self._line = DelayLine(simulator, control_s, delay_s)
        self.position = np.zeros((1, len(simulator.joints)))
        self.velocity = np.zeros_like(self.position)

    @property
    def joints(self) -> tuple[str, ...]:
        """See `Arms`."""
        return self._simulator.joints

    def begin(self, rows: Int[np.ndarray, "R"], position: Float[np.ndarray, "R J"], rng: np.random.Generator) -> None:
        """See `Arms`."""
        del rng
        self.position, self.velocity = np.array(position, np.float64), np.zeros(position.shape)
        self._line.clear(rows)
        self._simulator.reset(self.position, self.velocity)

    def step(self, torque: Float[np.ndarray, "N J"]) -> None:
        """See `Arms`."""
        done: dict[str, np.ndarray] = {}
        for acting in self._line.acting(torque)[0]:
            done = self._simulator.step({"torque": acting[None]})
        self.position, self.velocity = (np.asarray(done[name], np.float64) for name in ("position", "velocity"))


class HardwareArm:
    """One arm that is there, or that behaves as if it were.

    Args:
        robot: takes torques, and holds its own weight.
        control_s: control step [s].
        place: brings it into a pose, at rest, before an episode; what it draws comes from the generator.

    Raises:
        ConfigError: the robot takes no torques.
    """

    count = 1

    def __init__(
        self,
        robot: Hardware,
        control_s: float,
        *,
        place: Callable[[Float64[np.ndarray, "J"], np.random.Generator], None],
    ) -> None:
        if "torque" not in robot.command_signals:
            raise ConfigError("the robot takes no torques", got=list(robot.command_signals), expected="torque")
        self.control_s = control_s
        self._robot, self._place = robot, place
        self._due_s = 0.0
        self.position = np.zeros((1, len(robot.joints)))
        self.velocity = np.zeros_like(self.position)

    @property
    def joints(self) -> tuple[str, ...]:
        """See `Arms`."""
        return self._robot.joints

    def begin(self, rows: Int[np.ndarray, "R"], position: Float[np.ndarray, "R J"], rng: np.random.Generator) -> None:
        """See `Arms`."""
        del rows
        self._place(np.asarray(position[0], np.float64), rng)
        self._due_s = self._robot.now_s()
        self._read()

    def step(self, torque: Float[np.ndarray, "N J"]) -> None:
        """See `Arms`.

        Raises:
            RobotStopped: the robot has stopped.
        """
        self._robot.write({"torque": np.asarray(torque[0], np.float64)})
        self._due_s += self.control_s
        try:
            self._robot.wait_until_s(self._due_s)
        except DataError:  # virtual hardware whose simulation diverged
            self.position, self.velocity = np.full_like(self.position, np.nan), np.full_like(self.position, np.nan)
            return
        self._read()

    def _read(self) -> None:
        reading = self._robot.read()
        missing: Sequence[str] = [name for name in ("position", "velocity") if name not in reading]
        if missing:
            raise RobotStopped(f"the robot does not say its {' and '.join(missing)}")
        self.position, self.velocity = (
            np.asarray(reading[name], np.float64)[None] for name in ("position", "velocity")
        )


def substeps_of(simulator: Simulator, control_s: float) -> int:
    """Physics steps of a control step.

    Raises:
        ConfigError: it is no number of physics steps, or the robot follows no torques.
    """
    if simulator.command_signals[0] != "torque":
        raise ConfigError(
            "a policy of torques needs a robot that follows them",
            got=simulator.command_signals[0],
            expected="controller: {kind: torque}",
        )
    return physics_steps(simulator, control_s)
