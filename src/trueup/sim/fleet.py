"""Many robots side by side, each with what it carries, stepped together from one control step to the next."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import mujoco
import numpy as np
from jaxtyping import Float, Float64, Int
from mujoco import batch

from trueup.errors import ConfigError
from trueup.sim.compiled_robot import ABSURD
from trueup.sim.transitions import Transitions, refuse_others
from trueup.sim.warp_fleet import WarpFleet


@runtime_checkable
class Fleet(Protocol):
    """N robots of J joints, numbered from 0."""

    def place(self, rows: Int[np.ndarray, "R"], state: Float[np.ndarray, "R S"]) -> None:
        """Put R of them into these states, positions and then velocities, with no memory of what was before."""

    def step(self, before: Float[np.ndarray, "N J"], command: Float[np.ndarray, "N J"]) -> Float64[np.ndarray, "N S"]:
        """Advance all by a control step; those that diverged are NaN until they are placed again.

        Args:
            before: what was commanded one control step ago.
            command: what is commanded now.

        Returns:
            positions, then velocities.
        """
        ...

    def memory(self) -> Float64[np.ndarray, "N M"]:
        """All that decides how it goes on."""
        ...

    def restore(self, memory: Float64[np.ndarray, "N M"]) -> None:
        """Go on from there."""


class MujocoFleet:
    """Robots in MuJoCo itself, on threads of the processor.

    Args:
        transitions: one for each robot; simulators may differ in what they carry, and the first decides about threads.

    Raises:
        ConfigError: the control steps or delays of two of them differ.
    """

    def __init__(self, transitions: Sequence[Transitions]) -> None:
        self._first = transitions[0]
        self._joints = len(self._first.joints)
        refuse_others(transitions)
        models = [each.simulator.model for each in transitions]
        kinds = [_sizes(model) for model in models]
        self._parts: list[tuple[np.ndarray, batch.Batch]] = []
        self._where = np.zeros((len(models), 2), int)
        for kind in dict.fromkeys(kinds):
            # Models of the same sizes are stepped by one call; a robot without a payload has a body less.
            rows = np.array([row for row, own in enumerate(kinds) if own == kind])
            own = batch.Batch(models[rows[0]], nsim=len(rows), nthread=max(1, self._first.simulator.threads))
            own.set_models([models[row] for row in rows])
            self._where[rows] = np.stack([np.full(len(rows), len(self._parts)), np.arange(len(rows))], axis=1)
            self._parts.append((rows, own))

    def place(self, rows: Int[np.ndarray, "R"], state: Float[np.ndarray, "R S"]) -> None:
        """See `Fleet.place`."""
        for number, (_, own) in enumerate(self._parts):
            chosen = self._where[rows, 0] == number
            if not chosen.any():
                continue
            ids = self._where[rows[chosen], 1]
            own.reset(ids, stage=mujoco.mjtStage.mjSTAGE_NONE.value)
            qpos, qvel = own.bind("qpos")[ids], own.bind("qvel")[ids]
            self._first.simulator.place(qpos, qvel, *np.split(state[chosen].astype(np.float64), 2, axis=1))
            own.bind("qpos")[ids], own.bind("qvel")[ids] = qpos, qvel

    def step(self, before: Float[np.ndarray, "N J"], command: Float[np.ndarray, "N J"]) -> Float64[np.ndarray, "N S"]:
        """See `Fleet.step`."""
        first = self._first
        qpos, qvel = first.simulator.places
        out = np.empty((len(command), 2 * self._joints))
        held = first.held(before, command) if first.delayed else np.asarray(command, np.float64)[:, None]
        control = first.simulator.control_of({"position": held})
        for rows, own in self._parts:
            every = slice(None) if len(self._parts) == 1 else rows
            failed: np.ndarray | None = None
            try:
                if first.delayed:
                    own.rollout(first.steps, control[every], record=())
                else:
                    own.bind("ctrl")[:] = control[every, 0]
                    own.step(nstep=first.steps)
            except batch.SimulationError as error:
                failed = error.ids
            state = np.concatenate([own.bind("qpos")[:, qpos], own.bind("qvel")[:, qvel]], axis=1)
            if failed is not None:
                state[failed] = np.nan
            out[every] = state
        out[~(np.abs(out).max(axis=1) <= ABSURD)] = np.nan
        return out

    def memory(self) -> Float64[np.ndarray, "N M"]:
        """See `Fleet.memory`."""
        out = np.zeros((len(self._where), max(own.nstate for _, own in self._parts)))
        for rows, own in self._parts:
            out[rows, : own.nstate] = own.state
        return out

    def restore(self, memory: Float64[np.ndarray, "N M"]) -> None:
        """See `Fleet.restore`."""
        for rows, own in self._parts:
            own.state[:] = memory[rows, : own.nstate]


def make_fleet(transitions: Sequence[Transitions], device: str = "cpu") -> Fleet:
    """Robots on the processor, or on a GPU by MuJoCo Warp.

    Args:
        transitions: one for each robot.
        device: `cpu` or `cuda`.

    Raises:
        ConfigError: there is no such device, or their control steps differ, or MuJoCo Warp cannot simulate the robot.
        MissingDependency: MuJoCo Warp is not installed, or there is no GPU.
    """
    if device == "cpu":
        return MujocoFleet(transitions)
    if device != "cuda":
        raise ConfigError("--device", got=device, available=("cpu", "cuda"))
    return WarpFleet(transitions)


def _sizes(model: mujoco.MjModel) -> tuple[int, ...]:
    names = (name for name in dir(model) if name.startswith("n"))
    return tuple(value for value in (getattr(model, name) for name in names) if isinstance(value, int))
