"""Semi-implicit Euler on MuJoCo's accelerations, with nothing taken implicitly: what an integrator is worth."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float

from trueup.core.protocols import RolloutRequest, RolloutResult
from trueup.errors import ConfigError, DataError
from trueup.robots import AS_DESCRIBED, RobotSpec, Setup
from trueup.robots.holding import Holding
from trueup.robots.model import load_spec
from trueup.sim.compiled_robot import ABSURD, CompiledRobot, compile_robot, torque_sensor
from trueup.sim.controllers import Channel
from trueup.sim.friction import has_friction


class ExplicitSimulator(CompiledRobot):
    """A robot whose velocities and positions go on by a step of their slopes."""

    def __init__(
        self, model: mujoco.MjModel, robot: RobotSpec, channels: tuple[Channel, ...], holding: Holding
    ) -> None:
        super().__init__(model, robot, channels, holding)
        lacking = {
            "friction laws": has_friction(model),
            "actuators with a state": bool(model.na or model.nplugin),
            "loads, bodies or a moving base": robot.simulation.load
            or bool(robot.simulation.bodies or robot.simulation.base_sensor),
        }
        if named := [name for name, there in lacking.items() if there]:
            raise ConfigError(f"the explicit engine knows no {', '.join(named)}", hint="Take --engine mujoco.")
        joints = [model.joint(name).id for name in robot.joint_names]
        self._q, self._v = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        self._torque = [model.sensor_adr[model.sensor(torque_sensor(name)).id] for name in robot.joint_names]
        self._copies: list[mujoco.MjData] = []

    @staticmethod
    def from_robot(robot: RobotSpec, model_path: Path, *, setup: Setup = AS_DESCRIBED) -> ExplicitSimulator:
        """The simulator of a robot description, with what it carries and how its gains are set in a motion."""
        model, channels, holding = compile_robot(load_spec(model_path), robot, origin=model_path, setup=setup)
        return ExplicitSimulator(model, robot, channels, holding)

    def clone(self) -> ExplicitSimulator:
        """Another simulator on the same compiled model, for another thread."""
        return ExplicitSimulator(self.model, self.robot, self.channels, self.holding)

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the compiled model and of what steps it: runs of other ones are not kept by --resume."""
        return self.digest(f"explicit 1, mujoco {mujoco.__version__}")

    def rollout(self, request: RolloutRequest) -> RolloutResult:
        """Simulate B motions."""
        self.reset(request.position, request.velocity)
        steps = len(next(iter(request.command.values()))[0])
        said = [self.step({name: held[:, row] for name, held in request.command.items()}) for row in range(steps)]
        torque = np.stack([one["torque"] for one in said] + [said[-1]["torque"]], axis=1)
        position = np.stack([request.position, *(one["position"] for one in said)], axis=1)
        velocity = np.stack([request.velocity, *(one["velocity"] for one in said)], axis=1)
        if not (np.abs(position).max() < ABSURD and np.abs(velocity).max() < ABSURD):
            raise DataError(f"the simulation of {self.robot.name!r} diverged", got=f"steps of {self.timestep_s} s")
        return RolloutResult(position, velocity, torque)

    def reset(self, position: Float[np.ndarray, "B J"], velocity: Float[np.ndarray, "B J"]) -> None:
        """Put B copies into these states."""
        self._copies = [mujoco.MjData(self.model) for _ in position]
        for data, q, v in zip(self._copies, position, velocity, strict=True):
            data.qpos[self._q], data.qvel[self._v] = q, v

    def step(self, command: Mapping[str, Float[np.ndarray, "B J"]]) -> dict[str, Float[np.ndarray, "B J"]]:
        """Advance every copy by one step."""
        control = self.control_of({name: held[:, None] for name, held in command.items()})[:, 0]
        for data, own in zip(self._copies, control, strict=True):
            data.ctrl[:] = own
            mujoco.mj_forward(self.model, data)
            data.qvel[:] += self.timestep_s * data.qacc
            mujoco.mj_integratePos(self.model, data.qpos, data.qvel, self.timestep_s)
        return {
            "position": np.stack([data.qpos[self._q] for data in self._copies]),
            "velocity": np.stack([data.qvel[self._v] for data in self._copies]),
            "torque": np.stack([data.sensordata[self._torque] for data in self._copies]),
        }
