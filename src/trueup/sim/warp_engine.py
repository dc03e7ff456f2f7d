"""MuJoCo Warp behind the Simulator protocol: thousands of motions at once on a GPU, in single precision."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float, Float64

from trueup.core.protocols import RolloutRequest, RolloutResult
from trueup.errors import ConfigError, DataError, needing
from trueup.robots import AS_DESCRIBED, RobotSpec, Setup
from trueup.robots.holding import Holding
from trueup.robots.model import load_spec
from trueup.sim.compiled_robot import compile_robot
from trueup.sim.controllers import Channel
from trueup.sim.friction import has_friction
from trueup.sim.mujoco_engine import MujocoSimulator
from trueup.sim.warp_room import refuse_overflow, room_for

_INSTEAD = "Take --engine mujoco."


class WarpSimulator(MujocoSimulator):
    """A robot in MuJoCo Warp, with its controller; the compiled model is that of `MujocoSimulator`.

    On a processor, where it is slow and for tests, or on a GPU if there is one. Numbers are those of MuJoCo to single
    precision, which short motions keep, and chaotic ones do not.

    Args:
        model: see `MujocoSimulator`.
        robot: its description.
        channels: how commands reach the actuators.
        holding: see `CompiledRobot`.
        threads: of no meaning here.

    Raises:
        ConfigError: Warp cannot simulate this robot: friction laws, plugins, closed chains, bodies and bases that are
            watched or moved, or what it says itself.
        MissingDependency: MuJoCo Warp is not installed.
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
        with needing("--engine warp", "warp"):
            import warp

            # Its words about the machine and what it compiles would stand among ours.
            warp.config.log_level = warp.LOG_ERROR
            import mujoco_warp
        self._warp: Any = warp
        self._engine = mujoco_warp
        lacking = {
            "friction laws": has_friction(model),
            "plugins": bool(model.nplugin),
            "closed chains": bool(model.neq),
            "watched bodies": bool(robot.simulation.bodies),
            "a moving base": bool(robot.simulation.base_sensor),
        }
        if present := [name for name, there in lacking.items() if there]:
            raise ConfigError(f"MuJoCo Warp simulates no {', '.join(present)}, as in {robot.name!r}", hint=_INSTEAD)
        super().__init__(model, robot, channels, holding, threads=threads)
        compiled = copy.copy(model)
        # Warp has no such flag: it never starts again from the reset state.
        compiled.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        try:
            self._put = mujoco_warp.put_model(compiled)
        except NotImplementedError as error:
            raise ConfigError(f"MuJoCo Warp cannot simulate robot {robot.name!r}", got=error, hint=_INSTEAD) from error
        self._compiled, self._worlds = compiled, None
        self._rows = room_for(mujoco_warp, compiled)

    @staticmethod
    def from_robot(
        robot: RobotSpec, model_path: Path, *, setup: Setup = AS_DESCRIBED, threads: int = 1
    ) -> WarpSimulator:
        """The simulator of a robot description, with what it carries and how its gains are set in a motion.

        Raises:
            ConfigError: the model does not load, lacks an actuator, holds no payload, or is nothing for Warp.
            NameMismatch: a joint is not in the model.
            MissingDependency: MuJoCo Warp is not installed.
        """
        spec = load_spec(model_path, shapes=robot.simulation.contacts)
        model, channels, holding = compile_robot(spec, robot, origin=model_path, setup=setup)
        return WarpSimulator(model, robot, channels, holding, threads=threads)

    def clone(self, *, threads: int = 1) -> WarpSimulator:
        """Another simulator on the same compiled model."""
        return WarpSimulator(self.model, self.robot, self.channels, self.holding, threads=threads)

    @property
    def device(self) -> str:
        """Where it runs: `cpu`, `cuda:0`."""
        return str(self._warp.get_device())

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the compiled model and of the versions of MuJoCo and Warp."""
        return self.digest(f"{mujoco.__version__} warp {version('mujoco-warp')} {version('warp-lang')}")

    def rollout_candidates(
        self,
        request: RolloutRequest,  # noqa: ARG002
        models: Sequence[mujoco.MjModel],  # noqa: ARG002
        force: Float64[np.ndarray, "B N J"] | None = None,  # noqa: ARG002
    ) -> RolloutResult:
        """Not here: every candidate would be a model to be put on the device.

        Raises:
            ConfigError: always.
        """
        raise ConfigError("MuJoCo Warp fits no models", hint="Identify with MuJoCo, and replay by Warp.")

    def _rollout(
        self,
        model: mujoco.MjModel | list[mujoco.MjModel],  # noqa: ARG002 - its own, which was put on the device
        states: Float64[np.ndarray, "B S"],
        control: Float64[np.ndarray, "B N U"],
        what: int,  # noqa: ARG002 - controls; bases that move are refused
    ) -> tuple[Float64[np.ndarray, "B N S"], Float64[np.ndarray, "B N D"]]:
        count, steps = control.shape[:2]
        data = self._placed(states)
        sizes = (self.model.nq, self.model.nv, self.model.na, self.model.nsensordata)
        warp = self._warp
        # On the device from the first step to the last: what goes to and fro in each of them costs more than the step.
        given = warp.array(np.ascontiguousarray(control.swapaxes(0, 1), np.float32), dtype=float)
        kept = [warp.zeros((steps, count, size), dtype=float) for size in sizes]
        for step in range(steps):
            if control.shape[2]:
                warp.copy(data.ctrl, given[step])
            self._engine.step(self._put, data)
            for own, now in zip(kept, (data.qpos, data.qvel, data.act, data.sensordata), strict=True):
                if own.shape[2]:
                    warp.copy(own[step], now)
        refuse_overflow(self._engine, data, self.robot.name, _INSTEAD)
        qpos, qvel, act, sensors = (own.numpy().swapaxes(0, 1).astype(np.float64) for own in kept)
        after = np.tile(states[:, None], (1, steps, 1))
        after[..., 0] = states[:, :1] + self.timestep_s * np.arange(1, steps + 1)
        first = 1
        for values in (qpos, qvel, act):
            after[..., first : first + values.shape[2]] = values
            first += values.shape[2]
        return after, sensors

    def reset(self, position: Float[np.ndarray, "B J"], velocity: Float[np.ndarray, "B J"]) -> None:
        """Put B independent copies of the robot into these states, at time 0."""
        self._worlds = self._placed(self._states(RolloutRequest(position, velocity, {})))

    def step(self, command: Mapping[str, Float[np.ndarray, "B J"]]) -> dict[str, Float[np.ndarray, "B J"]]:
        """Advance every copy by one physics step; see `MujocoSimulator.step`.

        Raises:
            DataError: `reset` was not called, or Warp had no room for all constraints, such as contacts.
        """
        if self._worlds is None:
            raise DataError("step before reset", hint="Call reset(position, velocity) first.")
        data, layout = self._worlds, self._layout
        data.ctrl.assign(self.control_of({name: values[:, None, :] for name, values in command.items()})[:, 0])
        self._engine.step(self._put, data)
        refuse_overflow(self._engine, data, self.robot.name, _INSTEAD)
        return {
            "position": data.qpos.numpy()[:, layout.qpos].astype(np.float64),
            "velocity": data.qvel.numpy()[:, layout.qvel].astype(np.float64),
            "torque": data.sensordata.numpy()[:, layout.torque].astype(np.float64),
        }

    def _placed(self, states: Float64[np.ndarray, "B S"]) -> Any:
        """As many worlds, in these states."""
        data = self._engine.put_data(
            self._compiled, mujoco.MjData(self._compiled), nworld=len(states), njmax=self._rows
        )
        first = 1
        for field, size in ((data.qpos, self.model.nq), (data.qvel, self.model.nv), (data.act, self.model.na)):
            if size:
                field.assign(states[:, first : first + size].astype(np.float32))
            first += size
        return data
