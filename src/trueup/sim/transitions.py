"""What a simulator makes of states and commands within one control step, and how that depends on them.

The actuation function of GapONet (4.1), U(position, velocity): command -> position and velocity one control step later.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float64

from trueup.core.protocols import RolloutRequest, Simulator
from trueup.errors import ConfigError
from trueup.sim.mujoco_engine import MujocoSimulator

# What commands may be.
SIGNALS = ("position", "torque")
# Motions that are simulated at once: their sensors and states in every physics step must fit into memory.
_AT_ONCE = 4096
_PART_OF_STEP = 1e-6


@dataclass(frozen=True, eq=False)
class Slopes:
    """How the next states depend on what comes before, for B transitions of J joints.

    Attributes:
        state: derivatives by positions and velocities, (B, 2J, 2J); rows and columns are positions, then velocities.
        before: derivatives by the command before, (B, 2J, J); zero where commands act at once.
        command: derivatives by the command, (B, 2J, J).
    """

    state: Float64[np.ndarray, "B S S"]
    before: Float64[np.ndarray, "B S J"]
    command: Float64[np.ndarray, "B S J"]


class Transitions:
    """A robot under commands of positions or torques, from one control step to the next.

    Args:
        simulator: with the robot in it, whose controller follows these and keeps no state of its own.
        control_s: control step [s]; a command is held as long.
        delay_s: how much later commands act, one per joint or one for all, at most a control step [s].

    Raises:
        ConfigError: the control step is no number of physics steps, the delay is longer, the controller is another, or
            joints swing whose states are not among those of the robot's.
    """

    def __init__(self, simulator: MujocoSimulator, control_s: float, delay_s: float | Sequence[float] = 0.0) -> None:
        self.steps = physics_steps(simulator, control_s)
        if simulator.command_signals[0] not in SIGNALS or simulator.model.na:
            raise ConfigError(
                f"robot {simulator.robot.name!r} follows no positions or torques, or its controller remembers",
                got=simulator.robot.controller.kind,
                available=("position", "pd", "torque"),
            )
        if swinging := simulator.holding.swinging:
            raise ConfigError(
                f"robot {simulator.robot.name!r}: what its named joints do in a control step depends on others, which "
                "move by themselves",
                got=list(swinging),
                hint="Write `unlisted: lock` into robot.yaml, or name these joints where the logs have them.",
            )
        self.simulator = simulator
        self.signal = simulator.command_signals[0]
        self.control_s = control_s
        self._late = late_shares(simulator, control_s, delay_s)

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the J joints."""
        return self.simulator.joints

    def without_dry_friction(self) -> Transitions:
        """The same robot with joints that do not stick: its slopes say what commands do once joints move."""
        simulator = self.simulator.clone()
        simulator.model = copy.copy(simulator.model)
        simulator.model.dof_frictionloss[:] = 0.0
        other = Transitions(simulator, self.control_s)
        other._late = self._late
        return other

    @property
    def delayed(self) -> bool:
        """Whether the command before matters."""
        return bool(self._late.any())

    def held(self, before: Float[np.ndarray, "B J"], command: Float[np.ndarray, "B J"]) -> Float64[np.ndarray, "B N J"]:
        """What acts in each of the N physics steps of a control step."""
        acting: Float64[np.ndarray, "B N J"] = self._late * before[:, None] + (1.0 - self._late) * command[:, None]
        return acting

    def next(
        self,
        state: Float[np.ndarray, "B S"],
        before: Float[np.ndarray, "B J"],
        command: Float[np.ndarray, "B J"],
        *,
        gravity: Float[np.ndarray, "B 3"] | None = None,
    ) -> Float64[np.ndarray, "B S"]:
        """Positions, then velocities, one control step later, (B, 2J).

        Args:
            state: positions, then velocities.
            before: what was commanded one control step ago.
            command: what is commanded now.
            gravity: what pulls on the robot meanwhile, see `RolloutRequest`; None for a base at rest.

        Raises:
            DataError: a simulation diverged.
        """
        out = np.empty(state.shape)
        for start in range(0, len(state), _AT_ONCE):
            part = slice(start, start + _AT_ONCE)
            position, velocity = np.split(np.asarray(state[part], np.float64), 2, axis=1)
            held = self.held(before[part], command[part])
            pull = None if gravity is None else np.repeat(gravity[part][:, None], self.steps, axis=1)
            result = self.simulator.rollout(RolloutRequest(position, velocity, {self.signal: held}, pull))
            out[part] = np.concatenate([result.position[:, -1], result.velocity[:, -1]], axis=1)
        return out

    def slopes(
        self,
        state: Float[np.ndarray, "B S"],
        before: Float[np.ndarray, "B J"],
        command: Float[np.ndarray, "B J"],
        *,
        size: float = 1e-5,
        gravity: Float[np.ndarray, "B 3"] | None = None,
    ) -> Slopes:
        """Central differences of `next`, `size` to either side [rad or m, and per second]."""
        parts = [state, before, command] if self.delayed else [state, command]
        given = np.concatenate(parts, axis=1).astype(np.float64)
        count, width = given.shape
        moves = size * np.eye(width)
        moved = (given[:, None, None, :] + np.stack([moves, -moves])).reshape(-1, width)
        own, joints = state.shape[1], command.shape[1]
        earlier = moved[:, own : own + joints]  # without a delay, the command itself: it does not matter
        pull = None if gravity is None else np.repeat(gravity, 2 * width, axis=0)
        after = self.next(moved[:, :own], earlier, moved[:, -joints:], gravity=pull).reshape(count, 2, width, own)
        slopes = ((after[:, 0] - after[:, 1]) / (2.0 * size)).transpose(0, 2, 1)
        late = slopes[:, :, own : own + joints] if self.delayed else np.zeros((count, own, joints))
        return Slopes(slopes[:, :, :own], late, slopes[:, :, -joints:])


def physics_steps(simulator: Simulator, control_s: float) -> int:
    """How many make a control step.

    Raises:
        ConfigError: it is no whole number.
    """
    steps = control_s / simulator.timestep_s
    if steps < 1 - _PART_OF_STEP or abs(steps - round(steps)) > _PART_OF_STEP * steps:
        raise ConfigError(
            "a control step must be a number of physics steps",
            got=f"{control_s:g} s of {simulator.timestep_s:g} s",
            hint="Set simulation.timestep_s in robot.yaml, or another control rate.",
        )
    return round(steps)


def late_shares(
    simulator: Simulator, control_s: float, delay_s: float | Sequence[float] | Float64[np.ndarray, "J"]
) -> Float64[np.ndarray, "N J"]:
    """What of the command before acts in each of the N physics steps of a control step.

    Where a delay ends within a physics step, a mean of both commands acts in it.

    Args:
        simulator: of J joints.
        control_s: control step [s].
        delay_s: how much later commands act, one per joint or one for all, at most a control step [s].

    Raises:
        ConfigError: a delay is longer, or negative.
    """
    steps = physics_steps(simulator, control_s)
    delays = np.broadcast_to(np.asarray(delay_s, float), (len(simulator.joints),)) / simulator.timestep_s
    if not (delays.min() >= 0 and delays.max() <= steps * (1 + _PART_OF_STEP)):
        raise ConfigError(
            "commands may be late by a control step at most",
            got=f"{float(delays.max()) * simulator.timestep_s:g} s",
            expected=f"0 to {control_s:g} s",
        )
    late = np.clip(delays - np.arange(steps)[:, None], 0.0, 1.0)
    return np.where(late > 1 - _PART_OF_STEP, 1.0, late)


def refuse_others(transitions: Sequence[Transitions]) -> None:
    """Refuse, by ConfigError, robots whose control steps or delays differ from those of the first."""
    first = transitions[0]
    zero, one = np.zeros((1, len(first.joints))), np.ones((1, len(first.joints)))
    for other in {id(each): each for each in transitions}.values():
        same = other.steps == first.steps and other.joints == first.joints
        if not (same and np.array_equal(other.held(zero, one), first.held(zero, one))):
            raise ConfigError(
                "robots side by side have the same joints, control step and delays",
                got=f"{other.control_s:g} s and {first.control_s:g} s",
            )
