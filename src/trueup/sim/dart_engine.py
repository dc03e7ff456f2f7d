"""DART behind the Simulator protocol, on the numbers of the compiled MuJoCo model."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float, Float64

from trueup.core.protocols import RolloutRequest, RolloutResult
from trueup.errors import DataError
from trueup.robots import AS_DESCRIBED, RobotSpec, Setup, with_kp_factor
from trueup.robots.holding import Holding
from trueup.robots.model import gravity_of, load_spec
from trueup.sim.actuators import Actuators
from trueup.sim.compiled_robot import ABSURD, CompiledRobot, compile_robot
from trueup.sim.controllers import Channel
from trueup.sim.dart_blocks import DartBlocks
from trueup.sim.dart_friction import DartFriction, laws_of
from trueup.sim.dart_model import JointNumbers, load_dart, refuse_unmatched, skeleton_of
from trueup.sim.dry_friction import friction_impulse
from trueup.sim.moving_base import MovingBase


class DartSimulator(CompiledRobot):
    """A robot in DART, with its controller.

    Bodies, joints, gains, limits and friction are read from the same compiled model as `MujocoSimulator`'s. DART
    steps by semi-implicit Euler and takes viscous terms implicitly, which is what MuJoCo's `implicitfast` does too:
    without friction and limits both engines agree to rounding. What differs are MuJoCo's other integrators, how
    friction holds a joint (here: rigidly) and how a limit stops it (DART: rigidly, and as if there were no armature).

    A step runs Python code, and Python's lock is held while DART steps: to use several cores, use processes (a
    simulator can be pickled).

    Args:
        model: compiled model with the controller's actuators.
        robot: its description.
        channels: how commands reach the actuators.
        holding: see `CompiledRobot`.

    Raises:
        ConfigError: dartpy is not installed, or the model holds what DART cannot match; everything is named.
    """

    def __init__(
        self, model: mujoco.MjModel, robot: RobotSpec, channels: tuple[Channel, ...], holding: Holding | None = None
    ) -> None:
        load_dart()
        refuse_unmatched(model)
        super().__init__(model, robot, channels, holding)
        laws = laws_of(model)
        self._numbers = JointNumbers.of(model)
        self._actuators = Actuators(model, robot, laws)
        self._friction = DartFriction(model, self._numbers, laws)
        self._dofs = np.array([model.jnt_dofadr[model.joint(name).id] for name in robot.joint_names])
        # Semi-implicit Euler with a damping of armature / step that is taken off again as a force: (M + armature).
        self._rotor = self._numbers.armature / float(model.opt.timestep)
        wanted = robot.simulation
        self._blocks = DartBlocks(model, self._dofs, wanted) if wanted.load or wanted.bodies else None
        self._base = MovingBase(model, robot.simulation.base_sensor)
        self._copies: _Copies | None = None

    @staticmethod
    def from_robot(robot: RobotSpec, model_path: Path, *, setup: Setup = AS_DESCRIBED) -> DartSimulator:
        """The simulator of a robot description, with what it carries and how its gains are set in a motion.

        Raises:
            ConfigError: the model does not load, lacks an actuator, holds no payload, or cannot be matched.
            NameMismatch: a joint is not in the model.
        """
        spec = load_spec(model_path)
        return DartSimulator.from_spec(spec, robot, origin=model_path, setup=setup)

    @staticmethod
    def from_spec(spec: mujoco.MjSpec, robot: RobotSpec, *, origin: Path, setup: Setup = AS_DESCRIBED) -> DartSimulator:
        """The simulator of a model that is still editable; `origin` is named in messages."""
        model, channels, holding = compile_robot(spec, robot, origin=origin, setup=setup)
        # Of a PID plugin, DART takes the gains from the description.
        return DartSimulator(model, with_kp_factor(robot, setup.kp_factor), channels, holding)

    def clone(self) -> DartSimulator:
        """Another simulator on the same compiled model."""
        return DartSimulator(self.model, self.robot, self.channels, self.holding)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled as what it was made from; a batch that is being stepped is not carried along."""
        return DartSimulator, (self.model, self.robot, self.channels, self.holding)

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the compiled model, controller and options with it, and of both engines' versions."""
        return self.digest(f"dart {load_dart().__version__}, mujoco {mujoco.__version__}")

    def rollout(self, request: RolloutRequest) -> RolloutResult:
        """Simulate B motions of N steps.

        Raises:
            MissingSignal: the controller needs a signal that the command lacks.
            DataError: a motion diverged; the message says when.
        """
        control = self.control_of(request.command)
        copies = self._start(request.position, request.velocity)
        count, steps = control.shape[:2]
        q, v = np.empty((2, count, steps + 1, self.model.nv))
        torque = np.empty((count, steps + 1, len(self._dofs)))
        q[:, 0], v[:, 0] = copies.position, copies.velocity
        change = None if request.gravity is None else self._base.change(request.gravity)
        for row in range(steps):
            if change is not None:
                copies.pull(change[:, row])
            torque[:, row] = self._advance(copies, control[:, row])[:, self._dofs]
            q[:, row + 1], v[:, row + 1] = copies.position, copies.velocity
            # DART is not asked to go on with what is not a number.
            if copies.lost():
                raise DataError(
                    f"the simulation of {self.robot.name!r} diverged",
                    got=f"{(row + 1) * self.timestep_s:.3f} s after its start, at a time step of {self.timestep_s} s",
                    hint="`trueup check` says whether units or signs are wrong; else take a smaller timestep_s.",
                )
        torque[:, -1] = torque[:, -2]
        position, velocity = q[..., self._dofs], v[..., self._dofs]
        blocks, bodies = self._blocks.read(q, v) if self._blocks else ({}, {})
        further = {**self.electrics(torque, velocity), **blocks}
        return RolloutResult(position, velocity, torque, further, bodies, self.robot.simulation.bodies)

    def reset(self, position: Float[np.ndarray, "B J"], velocity: Float[np.ndarray, "B J"]) -> None:
        """Put B independent copies of the robot into these states, at time 0."""
        self._copies = self._start(position, velocity)

    def step(self, command: Mapping[str, Float[np.ndarray, "B J"]]) -> dict[str, Float[np.ndarray, "B J"]]:
        """Advance every copy by one physics step.

        Returns:
            `position` and `velocity` after the step and `torque` during it, each (B, J).

        Raises:
            MissingSignal: the controller needs a signal that the command lacks.
            DataError: `reset` was not called.
        """
        if self._copies is None:
            raise DataError("step before reset", hint="Call reset(position, velocity) first.")
        control = self.control_of({name: values[:, None, :] for name, values in command.items()})
        torque = self._advance(self._copies, control[:, 0])
        return {
            "position": self._copies.position[:, self._dofs],
            "velocity": self._copies.velocity[:, self._dofs],
            "torque": torque[:, self._dofs],
        }

    def _start(self, position: Float[np.ndarray, "B J"], velocity: Float[np.ndarray, "B J"]) -> _Copies:
        q = np.tile(self.model.qpos0, (len(position), 1))
        v = np.zeros_like(q)
        q[:, self._dofs], v[:, self._dofs] = position, velocity
        return _Copies(self.model, q, v, self._actuators.start(q))

    def _advance(self, copies: _Copies, control: Float64[np.ndarray, "B U"]) -> Float64[np.ndarray, "B V"]:
        """One step; returns the torque that the actuators asked for."""
        q, v, numbers = copies.position, copies.velocity, self._numbers
        torque, copies.activation = self._actuators.torque(copies.activation, control, q, v)
        braked = torque.damping + self._rotor
        force = torque.given + braked * v
        copies.damp(numbers.damping + braked)
        if self._friction.there:
            force += self._friction.force(v)
            force += copies.friction(force, self._friction.level(q, v))
        copies.step(force)
        return torque.asked


class _Copies:
    """B skeletons in a world of their own; made anew for each start, so that no step remembers an earlier motion."""

    def __init__(
        self,
        model: mujoco.MjModel,
        position: Float64[np.ndarray, "B V"],
        velocity: Float64[np.ndarray, "B V"],
        activation: Float64[np.ndarray, "B A"],
    ) -> None:
        dart = load_dart()
        self.position, self.velocity, self.activation = position.copy(), velocity.copy(), activation
        self._world = dart.simulation.World()
        self._world.setTimeStep(float(model.opt.timestep))
        self._world.setGravity(gravity_of(model))
        asleep = self._world.getDeactivationOptions()
        asleep.mEnabled = False  # DART would freeze a robot that moves slowly
        self._world.setDeactivationOptions(asleep)
        self._skeletons, self._joints = [], []
        for row in range(len(position)):
            skeleton = skeleton_of(model)
            skeleton.setName(f"copy{row}")
            skeleton.setPositions(position[row])
            skeleton.setVelocities(velocity[row])
            self._world.addSkeleton(skeleton)
            self._skeletons.append(skeleton)
            self._joints.append([skeleton.getDof(dof) for dof in range(model.nv)])
        self._step_s = float(model.opt.timestep)
        self._damping, self._impulse = np.zeros_like(position), np.zeros_like(position)

    def damp(self, damping: Float64[np.ndarray, "B V"]) -> None:
        if np.array_equal(damping, self._damping):
            return
        for row, dof in np.argwhere(damping != self._damping).tolist():
            self._joints[row][dof].setDampingCoefficient(damping[row, dof])
        self._damping = damping.copy()

    def pull(self, change: Float64[np.ndarray, "B 3"]) -> None:
        """Of this step, a force on every kilogram beside gravity [m/s2]; DART forgets it at the end of the step."""
        for skeleton, own in zip(self._skeletons, change, strict=True):
            for node in skeleton.getBodyNodes():
                node.addExtForce(node.getMass() * own, node.getLocalCOM(), False, True)  # noqa: FBT003 - DART's own

    def friction(self, force: Float64[np.ndarray, "B V"], level: Float64[np.ndarray, "B V"]) -> np.ndarray:
        """The friction of this step, of at most `level`, if `force` acts beside it, (B, V)."""
        for row, skeleton in enumerate(self._skeletons):
            skeleton.setForces(force[row])
            skeleton.computeForwardDynamics()
            free = self.velocity[row] + self._step_s * skeleton.getAccelerations()
            mobility = np.linalg.inv(skeleton.getAugMassMatrix())
            self._impulse[row] = friction_impulse(mobility, free, level[row] * self._step_s, self._impulse[row])
        return self._impulse / self._step_s

    def lost(self) -> bool:
        """Whether the numbers are absurd, or no numbers at all."""
        q, v = self.position.ravel(), self.velocity.ravel()
        return not (q @ q <= ABSURD**2 and v @ v <= ABSURD**2)

    def step(self, force: Float64[np.ndarray, "B V"]) -> None:
        for skeleton, own in zip(self._skeletons, force, strict=True):
            skeleton.setForces(own)
        self._world.step()
        for row, skeleton in enumerate(self._skeletons):
            self.position[row] = skeleton.getPositions()
            self.velocity[row] = skeleton.getVelocities()
