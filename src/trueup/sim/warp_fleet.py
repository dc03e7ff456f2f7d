"""The same robots on a GPU, by MuJoCo Warp, in single precision."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float, Float64, Int

from trueup.errors import ConfigError, MissingDependency, needing
from trueup.sim.compiled_robot import ABSURD
from trueup.sim.friction import has_friction
from trueup.sim.transitions import Transitions, refuse_others
from trueup.sim.warp_room import refuse_overflow, room_for

# What a robot goes on from; everything else is computed from it in each step.
_MEMORY = ("time", "qpos", "qvel", "qacc_warmstart")
_INSTEAD = "Leave --device out."


@dataclass(frozen=True, eq=False)
class _Part:
    """Robots that carry the same: `rows` of the fleet."""

    rows: np.ndarray
    model: Any
    data: Any
    controls: tuple[Any, ...]  # of each physics step; of one where they are all the same
    graph: Any


class WarpFleet:
    """See `trueup.sim.fleet.Fleet`.

    Args:
        transitions: one for each robot.
        device: of Warp; `cpu` for tests, where it is slow.

    Raises:
        ConfigError: the robots cannot be side by side, or MuJoCo Warp cannot simulate them.
        MissingDependency: MuJoCo Warp is not installed, or there is no GPU.
    """

    def __init__(self, transitions: Sequence[Transitions], device: str = "cuda") -> None:
        with needing("--device cuda", "warp"):
            import warp

            warp.config.log_level = warp.LOG_ERROR
            import mujoco_warp
        self._warp: Any = warp
        self._engine = mujoco_warp
        refuse_others(transitions)
        self._first = transitions[0]
        simulator = self._first.simulator
        if has_friction(simulator.model) or simulator.model.nplugin or simulator.model.neq:
            raise ConfigError(
                f"MuJoCo Warp simulates no friction laws, plugins and closed chains, as in {simulator.robot.name!r}",
                hint=_INSTEAD,
            )
        if device != "cpu" and not warp.is_cuda_available():
            raise MissingDependency("--device cuda: MuJoCo Warp finds no GPU", hint=_INSTEAD)
        self._count = len(transitions)
        numbers = np.array([id(each) for each in transitions])
        with warp.ScopedDevice(device):
            self._parts = [self._part(each, numbers) for each in {id(each): each for each in transitions}.values()]

    def _part(self, own: Transitions, numbers: np.ndarray) -> _Part:
        warp, engine = self._warp, self._engine
        rows = np.flatnonzero(numbers == id(own))
        compiled = copy.copy(own.simulator.model)
        # Warp has no such flag: it never starts again from the reset state.
        compiled.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        try:
            model = engine.put_model(compiled)
        except NotImplementedError as error:
            raise ConfigError(
                f"MuJoCo Warp cannot simulate robot {own.simulator.robot.name!r}",
                got=error,
                hint=_INSTEAD,
            ) from error
        data = engine.put_data(compiled, mujoco.MjData(compiled), nworld=len(rows), njmax=room_for(engine, compiled))
        controls = tuple(warp.zeros_like(data.ctrl) for _ in range(own.steps if own.delayed else 1))
        self._advance(model, data, controls)  # compiles what the graph is made of
        graph = None
        if warp.get_device().is_cuda:
            with warp.ScopedCapture() as capture:
                self._advance(model, data, controls)
            graph = capture.graph
        engine.reset_data(model, data)
        return _Part(rows, model, data, controls, graph)

    def place(self, rows: Int[np.ndarray, "R"], state: Float[np.ndarray, "R S"]) -> None:
        """See `Fleet.place`."""
        to = np.full(self._count, -1)
        to[rows] = np.arange(len(rows))
        qpos_at, qvel_at = self._first.simulator.places
        joints = len(qpos_at)
        for part in self._parts:
            chosen = to[part.rows] >= 0
            if not chosen.any():
                continue
            wanted = state[to[part.rows[chosen]]]
            which = self._warp.array(chosen, dtype=bool, device=part.data.qpos.device)
            self._engine.reset_data(part.model, part.data, which)
            for field, places, values in (
                (part.data.qpos, qpos_at, wanted[:, :joints]),
                (part.data.qvel, qvel_at, wanted[:, joints:]),
            ):
                whole = field.numpy()
                whole[np.ix_(chosen, places)] = values
                field.assign(whole)

    def step(self, before: Float[np.ndarray, "N J"], command: Float[np.ndarray, "N J"]) -> Float64[np.ndarray, "N S"]:
        """See `Fleet.step`.

        Raises:
            DataError: Warp had no room for all constraints of a robot, such as contacts.
        """
        first = self._first
        held = first.held(before, command) if first.delayed else np.asarray(command, np.float64)[:, None]
        control = first.simulator.control_of({"position": held}).astype(np.float32)
        for part in self._parts:
            for number, given in enumerate(part.controls):
                given.assign(control[part.rows, number])
            if part.graph is None:
                self._advance(part.model, part.data, part.controls)
            else:
                self._warp.capture_launch(part.graph)
            refuse_overflow(self._engine, part.data, first.simulator.robot.name, _INSTEAD)
        qpos, qvel = first.simulator.places
        out = np.empty((self._count, 2 * len(qpos)))
        for part in self._parts:
            out[part.rows] = np.concatenate([part.data.qpos.numpy()[:, qpos], part.data.qvel.numpy()[:, qvel]], axis=1)
        out[~(np.abs(out).max(axis=1) <= ABSURD)] = np.nan
        return out

    def memory(self) -> Float64[np.ndarray, "N M"]:
        """See `Fleet.memory`."""
        parts = [(part.rows, _joined(part.data)) for part in self._parts]
        out = np.zeros((self._count, max(values.shape[1] for _, values in parts)))
        for rows, values in parts:
            out[rows, : values.shape[1]] = values
        return out

    def restore(self, memory: Float64[np.ndarray, "N M"]) -> None:
        """See `Fleet.restore`."""
        for part in self._parts:
            at = 0
            for name in _MEMORY:
                field = getattr(part.data, name)
                width = int(np.prod(field.shape[1:], dtype=int))
                field.assign(memory[part.rows, at : at + width].reshape(field.shape).astype(np.float32))
                at += width

    def _advance(self, model: Any, data: Any, controls: Sequence[Any]) -> None:
        for step in range(self._first.steps):
            if step < len(controls):
                self._warp.copy(data.ctrl, controls[step])
            self._engine.step(model, data)


def _joined(data: Any) -> Float64[np.ndarray, "N M"]:
    fields = [getattr(data, name).numpy() for name in _MEMORY]
    return np.concatenate([field.reshape(len(field), -1) for field in fields], axis=1).astype(np.float64)
