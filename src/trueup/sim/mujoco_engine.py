"""MuJoCo behind the Simulator protocol."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float, Float64
from mujoco import batch, rollout

from trueup.core.protocols import RolloutRequest, RolloutResult
from trueup.errors import DataError
from trueup.robots import AS_DESCRIBED, RobotSpec, Setup
from trueup.robots.holding import Holding
from trueup.robots.model import load_spec
from trueup.sim.body_sensors import BodySensors
from trueup.sim.closed_chains import ClosedChains
from trueup.sim.compiled_robot import ABSURD, CompiledRobot, compile_robot, load_sensor, torque_sensor
from trueup.sim.controllers import Channel
from trueup.sim.friction import has_friction, install
from trueup.sim.moving_base import MovingBase

_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
_CONTROL = int(mujoco.mjtState.mjSTATE_CTRL)
# What follows in a row of inputs, in this order.
_JOINT_FORCES = int(mujoco.mjtState.mjSTATE_QFRC_APPLIED)
_BODY_FORCES = int(mujoco.mjtState.mjSTATE_XFRC_APPLIED)
# Forces on all bodies in every step of motions that are simulated at once [bytes].
_FORCES_AT_ONCE = 2**27
_INTEGRATOR = int(mujoco.mjtDyn.mjDYN_INTEGRATOR)
_FILTERS = (int(mujoco.mjtDyn.mjDYN_FILTER), int(mujoco.mjtDyn.mjDYN_FILTEREXACT))
_DIVERGED = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)

# MuJoCo's own handler writes MUJOCO_LOG.TXT into the current folder; a divergence is reported as an error here.
if mujoco.get_mju_user_warning() is None:
    mujoco.set_mju_user_warning(logging.getLogger(__name__).debug)


@dataclass(frozen=True)
class _Layout:
    """Where the robot's joints sit in MuJoCo's vectors."""

    qpos: np.ndarray
    qvel: np.ndarray
    torque: np.ndarray
    load: np.ndarray  # (J, 3) of the wrench's part, or (0, 3)
    axis: np.ndarray  # (J, 3), in the axes of the body
    holding: tuple[tuple[int, int, float], ...]  # (activation, joint column, scale) whose state is a position target


class MujocoSimulator(CompiledRobot):
    """A robot in MuJoCo, with its controller.

    Args:
        model: compiled model with the controller's actuators and one `jointactuatorfrc` sensor per joint.
        robot: its description.
        channels: how commands reach the actuators.
        holding: see `CompiledRobot`.
        threads: threads for `rollout` and `step`; one simulator must not be used from several threads itself.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        robot: RobotSpec,
        channels: tuple[Channel, ...],
        holding: Holding | None = None,
        *,
        threads: int = 1,
    ) -> None:
        super().__init__(model, robot, channels, holding)
        self.threads = threads
        self._layout = _layout(model, robot.joint_names, channels)
        bodies = robot.simulation.bodies
        self._bodies = BodySensors(model, bodies) if bodies else None
        self._base = MovingBase(model, robot.simulation.base_sensor)
        self._chains = ClosedChains(model, self._layout.qpos, self._layout.qvel) if model.neq else None
        if has_friction(model):
            install()
        self._data = [mujoco.MjData(model) for _ in range(threads)]
        self._batch: batch.Batch | None = None

    @staticmethod
    def from_robot(
        robot: RobotSpec, model_path: Path, *, setup: Setup = AS_DESCRIBED, threads: int = 1
    ) -> MujocoSimulator:
        """The simulator of a robot description, with what it carries and how its gains are set in a motion.

        Raises:
            ConfigError: the model does not load, lacks an actuator, or holds no payload, or has no gains to set.
            NameMismatch: a joint is not in the model.
        """
        spec = load_spec(model_path, shapes=robot.simulation.contacts)
        return MujocoSimulator.from_spec(spec, robot, origin=model_path, setup=setup, threads=threads)

    @staticmethod
    def from_spec(
        spec: mujoco.MjSpec, robot: RobotSpec, *, origin: Path, setup: Setup = AS_DESCRIBED, threads: int = 1
    ) -> MujocoSimulator:
        """The simulator of a model that is still editable; `origin` is named in messages.

        The spec is completed in place: controller, torque sensors, friction laws and options of the robot.
        """
        model, channels, holding = compile_robot(spec, robot, origin=origin, setup=setup)
        return MujocoSimulator(model, robot, channels, holding, threads=threads)

    def clone(self, *, threads: int = 1) -> MujocoSimulator:
        """Another simulator on the same compiled model, for another thread."""
        return MujocoSimulator(self.model, self.robot, self.channels, self.holding, threads=threads)

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the compiled model, included files, controller and options with it, and of MuJoCo's version."""
        return self.digest(mujoco.__version__)

    @property
    def position_limits(self) -> dict[str, tuple[float, float]]:
        """Joint name -> range [rad or m]; joints without limits are left out."""
        limits: dict[str, tuple[float, float]] = {}
        for spec in self.robot.joints:
            joint = self.model.joint(spec.name)
            if spec.position_limits:
                limits[spec.name] = spec.position_limits
            elif self.model.jnt_limited[joint.id]:
                low, high = self.model.jnt_range[joint.id]
                limits[spec.name] = (float(low), float(high))
        return limits

    def rollout(self, request: RolloutRequest) -> RolloutResult:
        """Simulate B motions of N steps.

        Raises:
            MissingSignal: the controller needs a signal that the command lacks.
            DataError: a motion diverged; the message says which and when.
        """
        result = self._run(request, self.model)
        self._refuse_divergence(np.maximum(np.abs(result.position), np.abs(result.velocity)))
        return result

    def rollout_candidates(
        self,
        request: RolloutRequest,
        models: Sequence[mujoco.MjModel],
        force: Float64[np.ndarray, "B N J"] | None = None,
    ) -> RolloutResult:
        """Simulate B motions, each on a model of its own: candidates of a fit.

        Args:
            request: as for `rollout`.
            models: B models of the same structure as this simulator's; may repeat.
            force: what acts on the joints in each step besides their drives [Nm or N]; nothing if None.

        Returns:
            As `rollout`; a motion that diverged is NaN from its first row on, and the others stand.
        """
        result = self._run(request, list(models), force)
        size = np.maximum(np.abs(result.position), np.abs(result.velocity)).max(axis=(1, 2))
        lost = ~(size <= ABSURD)
        for values in (result.position, result.velocity, result.torque):
            values[lost] = np.nan
        return result

    def _run(
        self,
        request: RolloutRequest,
        model: mujoco.MjModel | list[mujoco.MjModel],
        force: Float64[np.ndarray, "B N J"] | None = None,
    ) -> RolloutResult:
        layout = self._layout
        count = request.position.shape[0]
        control, what = self.control_of(request.command), _CONTROL
        steps = control.shape[1]
        states = self._states(request)
        if force is not None:
            applied = np.zeros((count, steps, self.model.nv))
            applied[..., layout.qvel] = force
            control, what = np.concatenate([control, applied], axis=2), what | _JOINT_FORCES
        if request.gravity is None:
            state, sensors = self._rollout(model, states, control, what)
        else:
            state, sensors = self._rollout_on_base(model, states, control, what, self._base.change(request.gravity))
        position = np.empty((count, steps + 1, len(self.joints)))
        velocity, torque = np.empty_like(position), np.empty_like(position)
        position[:, 0], velocity[:, 0] = request.position, request.velocity
        # The state is time, qpos, qvel, … after each step; the sensors belong to the state before it.
        position[:, 1:] = state[:, :, 1 + layout.qpos]
        velocity[:, 1:] = state[:, :, 1 + self.model.nq + layout.qvel]
        torque[:, :-1] = sensors[:, :, layout.torque]
        torque[:, -1] = torque[:, -2]
        further = self.electrics(torque, velocity)
        if layout.load.size:
            load = np.empty_like(torque)
            load[:, :-1] = (sensors[:, :, layout.load] * layout.axis).sum(axis=-1)
            load[:, -1] = load[:, -2]
            further["load"] = load
        bodies = {}
        if self._bodies is not None:
            bodies = {
                name: np.concatenate([values, values[:, -1:]], axis=1)
                for name, values in self._bodies.read(sensors).items()
            }
        return RolloutResult(position, velocity, torque, further, bodies, self.robot.simulation.bodies)

    def _rollout(
        self,
        model: mujoco.MjModel | list[mujoco.MjModel],
        states: Float64[np.ndarray, "B S"],
        control: Float64[np.ndarray, "B N U"],
        what: int,
    ) -> tuple[Float64[np.ndarray, "B N S"], Float64[np.ndarray, "B N D"]]:
        """States after and sensors before each step; `what` says what a row of `control` holds."""
        if self.model.nplugin and isinstance(model, list):
            return _rollout_apart(model, states, control, what)
        threads = self._data[: max(1, min(self.threads, len(states)))]
        state, sensors = rollout.rollout(model, threads, states, control, control_spec=what)
        return state, sensors

    def _rollout_on_base(
        self,
        model: mujoco.MjModel | list[mujoco.MjModel],
        states: Float64[np.ndarray, "B S"],
        control: Float64[np.ndarray, "B N U"],
        what: int,
        change: Float64[np.ndarray, "B N 3"],
    ) -> tuple[Float64[np.ndarray, "B N S"], Float64[np.ndarray, "B N D"]]:
        """The same with a force on the center of mass of every body; some motions at once, for memory."""
        count, steps = control.shape[:2]
        at_once = max(self.threads, _FORCES_AT_ONCE // (steps * 6 * self.model.nbody * 8))
        parts = []
        for start in range(0, count, at_once):
            own = slice(start, start + at_once)
            models = model[own] if isinstance(model, list) else model
            mass = np.stack([each.body_mass for each in models]) if isinstance(models, list) else models.body_mass[None]
            wrench = np.zeros((*change[own].shape[:2], self.model.nbody, 6))
            wrench[..., :3] = mass[:, None, :, None] * change[own][:, :, None]
            given = np.concatenate([control[own], wrench.reshape(*wrench.shape[:2], -1)], axis=2)
            parts.append(self._rollout(models, states[own], given, what | _BODY_FORCES))
        return np.concatenate([state for state, _ in parts]), np.concatenate([sensors for _, sensors in parts])

    def reset(self, position: Float[np.ndarray, "B J"], velocity: Float[np.ndarray, "B J"]) -> None:
        """Put B independent copies of the robot into these states, at time 0."""
        count = position.shape[0]
        if self._batch is None or self._batch.nsim != count:
            self._batch = batch.Batch(self.model, nsim=count, nthread=self.threads)
        self._batch.reset()
        self.place(self._batch.bind("qpos"), self._batch.bind("qvel"), position, velocity)
        for activation, column, scale in self._layout.holding:
            self._batch.bind("act")[:, activation] = scale * position[:, column]

    def step(self, command: Mapping[str, Float[np.ndarray, "B J"]]) -> dict[str, Float[np.ndarray, "B J"]]:
        """Advance every copy by one physics step.

        Returns:
            `position` and `velocity` after the step and `torque` during it, each (B, J).

        Raises:
            MissingSignal: the controller needs a signal that the command lacks.
            DataError: `reset` was not called.
        """
        if self._batch is None:
            raise DataError("step before reset", hint="Call reset(position, velocity) first.")
        held = {name: values[:, None, :] for name, values in command.items()}
        self._batch.bind("ctrl")[:] = self.control_of(held)[:, 0]
        sensors = self._batch.bind("sensordata")
        self._batch.step()
        return {
            "position": self._batch.bind("qpos")[:, self._layout.qpos],
            "velocity": self._batch.bind("qvel")[:, self._layout.qvel],
            "torque": sensors[:, self._layout.torque],
        }

    @property
    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """Where the joints are in MuJoCo's vectors of positions and of velocities, (J,) each."""
        return self._layout.qpos, self._layout.qvel

    def _states(self, request: RolloutRequest) -> Float64[np.ndarray, "B S"]:
        mujoco.mj_resetData(self.model, self._data[0])
        template = np.empty(mujoco.mj_stateSize(self.model, _STATE))
        mujoco.mj_getState(self.model, self._data[0], template, _STATE)
        states = np.tile(template, (request.position.shape[0], 1))
        qpos, qvel = states[:, 1 : 1 + self.model.nq], states[:, 1 + self.model.nq : 1 + self.model.nq + self.model.nv]
        self.place(qpos, qvel, request.position, request.velocity)
        for activation, column, scale in self._layout.holding:
            states[:, 1 + self.model.nq + self.model.nv + activation] = scale * request.position[:, column]
        return states

    def place(
        self,
        qpos: Float64[np.ndarray, "B Q"],
        qvel: Float64[np.ndarray, "B V"],
        position: Float[np.ndarray, "B J"],
        velocity: Float[np.ndarray, "B J"],
    ) -> None:
        """Write the states of B copies with these joints; passive ones follow where chains are closed."""
        if self._chains is None:
            qpos[:, self._layout.qpos], qvel[:, self._layout.qvel] = position, velocity
            return
        for row, own in enumerate(zip(position, velocity, strict=True)):
            qpos[row], qvel[row] = self._chains.close(*own)

    def _refuse_divergence(self, size: Float[np.ndarray, "B N1 J"]) -> None:
        # MuJoCo's own warnings tell of the last motion of each thread only; a NaN makes the comparison false.
        warned = any(data.warning[kind].number for data in self._data for kind in _DIVERGED)
        if not warned and size.max() <= ABSURD:
            return
        bad = ~(size <= ABSURD).all(axis=2)
        for data in self._data:
            mujoco.mj_resetData(self.model, data)
        row = int(np.argmax(bad.any(axis=0))) if bad.any() else size.shape[1] - 1
        raise DataError(
            f"the simulation of {self.robot.name!r} diverged",
            got=f"{row * self.timestep_s:.3f} s after its start, at a time step of {self.timestep_s} s",
            hint="`trueup check` says whether units or signs are wrong; else take a smaller simulation.timestep_s.",
        )


def _rollout_apart(
    models: list[mujoco.MjModel],
    states: Float64[np.ndarray, "B S"],
    control: Float64[np.ndarray, "B N U"],
    what: int,
) -> tuple[Float64[np.ndarray, "B N S"], Float64[np.ndarray, "B N D"]]:
    """The same rollout with data of its own for each model: a plugin reads its numbers only when data are made."""
    groups = [list(rows) for _, rows in groupby(range(len(models)), key=lambda row: id(models[row]))]
    parts = [
        rollout.rollout(
            models[rows[0]], [mujoco.MjData(models[rows[0]])], states[rows], control[rows], control_spec=what
        )
        for rows in groups
    ]
    return np.concatenate([state for state, _ in parts]), np.concatenate([sensors for _, sensors in parts])


def _layout(model: mujoco.MjModel, joints: tuple[str, ...], channels: tuple[Channel, ...]) -> _Layout:
    columns = {joint: index for index, joint in enumerate(joints)}
    holding = []
    for channel in channels:
        actuator = model.actuator(channel.actuator).id
        kind = int(model.actuator_dyntype[actuator])
        if kind == _INTEGRATOR or (kind in _FILTERS and channel.signal == "position"):
            holding.append((int(model.actuator_actadr[actuator]), columns[channel.joint], channel.scale))
    return _Layout(
        qpos=np.array([model.jnt_qposadr[model.joint(name).id] for name in joints]),
        qvel=np.array([model.jnt_dofadr[model.joint(name).id] for name in joints]),
        torque=np.array([model.sensor_adr[model.sensor(torque_sensor(name)).id] for name in joints]),
        load=_load_places(model, joints),
        axis=np.array([model.jnt_axis[model.joint(name).id] for name in joints]),
        holding=tuple(holding),
    )


def _load_places(model: mujoco.MjModel, joints: tuple[str, ...]) -> np.ndarray:
    known = {model.sensor(number).name: int(model.sensor_adr[number]) for number in range(model.nsensor)}
    first = [known[load_sensor(name)] for name in joints if load_sensor(name) in known]
    return np.array(first, int)[:, None] + np.arange(3)
