"""Whole bodies that can be balanced: one protocol, and the simulated one."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol, runtime_checkable

import mujoco
import numpy as np
from jaxtyping import Float64

from trueup.errors import ConfigError
from trueup.robots import load_robot
from trueup.sim.compiled_robot import compile_robot
from trueup.sim.payload import attach_payload
from trueup.whole_body.model import MODEL, ROBOT, BaseReading, Chassis, load_body

Arms = Float64[np.ndarray, "J"]


@runtime_checkable
class WholeBody(Protocol):
    """Two arms under PD on a base with two driven wheels."""

    @property
    def payload_kg(self) -> float:
        """What each hand holds [kg]."""
        ...

    @property
    def chassis(self) -> Chassis:
        """The base as it is, which its own sensors may see otherwise."""
        ...

    def restart(self, arms: Arms, pitch: float, *, seed: int = 0) -> None:
        """Stand at the start, at rest, with the arms in a pose [rad] and the base leaning forward [rad]."""
        ...

    def arms(self) -> tuple[Arms, Arms]:
        """Positions [rad] and velocities [rad/s] of the arms as their sensors say."""
        ...

    def reading(self) -> BaseReading:
        """What the base's sensors say."""
        ...

    def advance(self, target: Arms, torque: Float64[np.ndarray, "2"], time_s: float) -> None:
        """Follow targets of the arms [rad] with these torques of the wheels [Nm] for a while [s]."""
        ...


class SimulatedBody:
    """The whole body as its simulator has it: the stock upper body and its PD, perfect sensors, motors that obey.

    Args:
        payload_kg: in each hand [kg].
    """

    def __init__(self, payload_kg: float = 0.0) -> None:
        robot = load_robot(ROBOT)
        # Wheels roll on a floor; nothing else can touch anything.
        robot = replace(robot, simulation=replace(robot.simulation, contacts=True))
        spec = load_body()
        attach_payload(spec, robot, payload_kg)
        self.model, channels, _ = compile_robot(spec, robot, origin=MODEL, moves=True)
        self.payload_kg = payload_kg
        self._data = mujoco.MjData(self.model)
        self.chassis = Chassis(self.model, self._data)
        names = robot.joint_names
        self._place = np.array([self.model.joint(name).qposadr[0] for name in names])
        self._freedom = np.array([self.model.joint(name).dofadr[0] for name in names])
        drives = {channel.joint: channel.actuator for channel in channels}
        self._drives = np.array([self.model.actuator(drives[name]).id for name in names])

    @property
    def home(self) -> Arms:
        """The pose in which the arms wait [rad]."""
        return np.array(self.model.key("home").qpos[self._place])

    def restart(self, arms: Arms, pitch: float, *, seed: int = 0) -> None:  # noqa: ARG002 - nothing is drawn
        """Stand at the start, at rest."""
        mujoco.mj_resetData(self.model, self._data)
        self._data.qpos[self._place] = arms
        self._data.ctrl[self._drives] = arms
        self.chassis.stand(pitch)

    def arms(self) -> tuple[Arms, Arms]:
        """Positions and velocities of the arms as they are."""
        return np.array(self._data.qpos[self._place]), np.array(self._data.qvel[self._freedom])

    def reading(self) -> BaseReading:
        """What perfect sensors say."""
        return self.chassis.reading()

    def advance(self, target: Arms, torque: Float64[np.ndarray, "2"], time_s: float) -> None:
        """Simulate for a while.

        Raises:
            ConfigError: no whole number of physics steps.
        """
        steps = whole_steps(time_s, self.model.opt.timestep)
        self._data.ctrl[self._drives] = target
        self.chassis.drive(torque)
        mujoco.mj_step(self.model, self._data, steps)


def whole_steps(time_s: float, step_s: float) -> int:
    """How many steps there are in a time.

    Raises:
        ConfigError: no whole number.
    """
    steps = round(time_s / step_s)
    if steps < 1 or abs(steps * step_s - time_s) > 1e-9:
        raise ConfigError("this time is no whole number of steps", got=f"{time_s:g} s", expected=f"n * {step_s:g} s")
    return steps
