"""How narrow intervals can be: what logs say of a robot's numbers if time step and timing are known.

The Cramer-Rao bound at the truth, with the priors that the fit has: derivatives of the readings by every number that
the fit has left free, in plain MuJoCo at the fine step, and none of the package's simulators. The largest torque of a
drive is known to a tenth, as it is to the fit: one that saturates would otherwise tell the scale of all torques. A
robot that is simulated piece by piece begins each at a state of which only the readings are known.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mujoco import rollout

from benchmarks.foreign_cases import Case
from benchmarks.foreign_motions import POSITION_NOISE, VELOCITY_NOISE, Numbers, simulate, true_model
from benchmarks.foreign_plants import FINE_S
from benchmarks.foreign_robots import joint_dofs
from benchmarks.foreign_truth import TORQUE_NOISE, numbers
from trueup.core.parameters import Parameter
from trueup.identify.candidate import Nominal
from trueup.identify.config import IdentifyConfig, make_parameters
from trueup.identify.quantities import quantity
from trueup.robots import load_robot

# Of differences, in z, and of states at the begin of windows, in rad (m) and rad/s (m/s).
_STEP, _STATE_STEP = 0.01, 1e-4
# How well a drive's largest torque is known, one standard deviation of its logarithm.
_LIMIT = 0.1
# Of torque-driven robots, as their robot.yaml says [s].
_WINDOW_S = 0.5
# Half of 95 % of a normal distribution.
_WIDE = 1.96
# Fields of `Numbers` that have another name than their quantity.
_FIELDS = {"torque_limit": "limit"}


@dataclass(frozen=True, eq=False)
class Windows:
    """Where simulations begin, and what is read while they last.

    Attributes:
        motion: index of the motion of each, (W,).
        begin: index of its first reading, (W,).
        readings: how many each has.
    """

    motion: np.ndarray
    begin: np.ndarray
    readings: int


def intervals(case: Case, seed: int, folder: Path, motions: Sequence[int], free: Sequence[str]) -> list[dict[str, Any]]:
    """Rows as of a fit: true values, and the narrowest intervals that hold them in 95 % of cases.

    Args:
        case: of group A.
        seed: of its draws.
        folder: where `foreign_truth.make` has written it.
        motions: that are fitted.
        free: names of the numbers that the fit has left free; others are known as well as their priors say, or exactly
            without one.
    """
    nominal = Nominal(load_robot(folder / "robot.yaml"), folder / "model.xml")
    known = {item.name: item for item in make_parameters(IdentifyConfig().resolved(nominal).fit, nominal)}
    items, truth = [known[name] for name in free], Truth(case, seed, folder, motions)
    made = quantity("torque_limit")
    limits = [made.parameter(nominal, joint) for joint in case.joints if joint in made.holders(nominal)]
    items += [replace(item, prior_std=_LIMIT) for item in limits if item.name not in free]
    # What the fit has left as the model has it, since these motions do not show it, is known no better than before.
    items += [item for item in known.values() if item.name not in free and item.prior_std is not None]
    slopes = truth.slopes(items)
    information = slopes @ slopes.T - truth.lost(slopes)
    information += np.diag([0.0 if item.prior_std is None else item.prior_std**-2.0 for item in items])
    reach = _WIDE * np.sqrt(np.diag(np.linalg.pinv(information, hermitian=True)))
    rows = []
    for item, own in zip(items[: len(free)], reach, strict=False):
        value = truth.value(item.name)
        low, high = (_at(item, value, side * own) for side in (-1.0, 1.0))
        row = {"name": item.name, "value": value, "low": low, "high": high, "truth": value}
        rows.append({**row, "identified": "yes", "frozen": False, "transform": item.transform})
    return rows


class Truth:
    """The readings of a true robot in units of their noise, as functions of its numbers and of where windows begin."""

    def __init__(self, case: Case, seed: int, folder: Path, motions: Sequence[int]) -> None:
        self._case, self._path = case, folder / "model.xml"
        _, self._true, _ = numbers(case, mujoco.MjModel.from_xml_path(str(self._path)), seed)
        self._model = true_model(self._path, case, self._true, {}, drives=True)
        run = simulate(case, self._path, self._true, seed, cause={})
        count = round(_WINDOW_S * case.measured_hz) + 1 if case.drive == "torque" else len(run.time_s)
        starts = np.arange(0, len(run.time_s) - count + 1, max(1, count - 1))
        self._windows = Windows(np.repeat(motions, starts.size), np.tile(starts, len(motions)), count)
        at = self._windows.begin, self._windows.motion
        self._state, self._command = np.stack([run.position[at], run.velocity[at]]), run.command
        self._torque_noise = TORQUE_NOISE * np.sqrt((run.torque**2).mean(axis=0))[self._windows.motion][:, None, :]

    def value(self, name: str) -> float:
        """The true value of a number that a fit may change."""
        kind, target = _split(name)
        if kind.startswith("com_"):
            return float(self._model.body(target).ipos["xyz".index(kind[-1])])
        if kind in ("mass", "inertia_scale"):
            return self._true.mass[target] if kind == "mass" else 1.0
        return float(getattr(self._true, _FIELDS.get(kind, kind))[self._case.joints.index(target)])

    def slopes(self, items: Sequence[Parameter]) -> np.ndarray:
        """Derivatives of all readings by each number, in z, (P, N).

        Where positions alone are read, all torques and masses times the same factor change nothing. Single derivatives
        do not add up to that over the kinks of dry friction: the difference along all of them takes the place of their
        sum, and each gets a part by the square of its size.
        """
        found = np.array([self.slope(item) for item in items])
        sized = np.array([item.transform == "log" and item.unit.startswith(("N", "kg")) for item in items])
        if sized.any():
            rows = [item for item, own in zip(items, sized, strict=True) if own]
            up, down = (
                self._readings({item.name: _at(item, self.value(item.name), side * _STEP) for item in rows})
                for side in (1.0, -1.0)
            )
            shares = np.square(np.linalg.norm(found, axis=1)) * sized
            missed = (up - down).ravel() / (2 * _STEP) - found[sized].sum(axis=0)
            found += np.outer(shares / max(float(shares.sum()), 1e-300), missed)
        return found

    def slope(self, item: Parameter) -> np.ndarray:
        """Derivatives of all readings by one number, in z, (N,)."""
        step = FINE_S / item.scale if item.name.startswith("delay_s") else _STEP
        value = self.value(item.name)
        up, down = (self._readings({item.name: _at(item, value, side * step)}) for side in (1.0, -1.0))
        return np.asarray((up - down).ravel() / (2 * step))

    def lost(self, slopes: np.ndarray) -> np.ndarray:
        """What of the information of derivatives (P, N) states take away that only readings tell, (P, P)."""
        total = np.zeros((len(slopes), len(slopes)))
        if self._case.drive != "torque":
            return total
        _, windows, joints = self._state.shape
        columns = []
        for kind, joint in np.ndindex(2, joints):
            more = np.zeros_like(self._state)
            more[kind, :, joint] = _STATE_STEP
            up, down = (self._readings({}, side * more) for side in (1.0, -1.0))
            columns.append((up - down).reshape(windows, -1) / (2 * _STATE_STEP))
        read = np.diag(np.repeat([0.0, VELOCITY_NOISE**-2.0 * self._case.velocity], joints))
        for window in range(windows):
            own = np.array([column[window] for column in columns])
            both = slopes.reshape(len(slopes), windows, -1)[:, window] @ own.T
            total += both @ np.linalg.solve(own @ own.T + read, both.T)
        return total

    def _readings(self, changed: Mapping[str, float], more: np.ndarray | float = 0.0) -> np.ndarray:
        """Position, and torque where it is logged, (W, T, J) or (W, T, 2 J); windows begin `more` away, (2, W, J)."""
        case, windows = self._case, self._windows
        true, model = self._changed(changed)
        dofs, every = np.array(joint_dofs(model, case.joints)), round(1 / case.measured_hz / FINE_S)
        late = np.round(true.delay_s / FINE_S).astype(int)
        steps = np.arange((windows.readings - 1) * every + 1)
        ticks = np.maximum(windows.begin[:, None, None] * every + steps[:, None] - late, 0)
        command = self._command[
            ticks // round(1 / case.command_hz / FINE_S), windows.motion[:, None, None], np.arange(dofs.size)
        ]
        data, kind = mujoco.MjData(model), mujoco.mjtState.mjSTATE_FULLPHYSICS
        begin = np.zeros((windows.begin.size, mujoco.mj_stateSize(model, kind)))
        for row, q, v in zip(begin, *(self._state + more), strict=True):
            data.qpos[dofs], data.qvel[dofs] = q, v
            mujoco.mj_getState(model, data, row, kind)
        threads = [mujoco.MjData(model) for _ in range(os.cpu_count() or 1)]
        states, _ = rollout.rollout(model, threads, begin, command[:, :-1])
        states = np.concatenate([begin[:, None], states[:, every - 1 :: every]], axis=1)
        position, velocity = states[..., 1 + dofs], states[..., 1 + model.nq + dofs]
        found = [position / POSITION_NOISE]
        if case.torque:
            told = command[:, ::every]
            wanted = {
                "position": true.kp * (told - position) - true.kv * velocity,
                "velocity": true.kv * (told - velocity),
                "torque": told,
            }[case.drive]
            found.append(np.clip(wanted + true.torque_offset, -true.limit, true.limit) / self._torque_noise)
        return np.concatenate(found, axis=2)

    def _changed(self, changed: Mapping[str, float]) -> tuple[Numbers, mujoco.MjModel]:
        """The true numbers and model with other values."""
        true, case = self._true, self._case
        for name, value in changed.items():
            kind, target = _split(name)
            if kind == "mass":
                true = replace(true, mass={**true.mass, target: value})
            elif (field := _FIELDS.get(kind, kind)) in Numbers.__dataclass_fields__:
                here = np.array([joint == target for joint in case.joints])
                true = replace(true, **{field: np.where(here, value, getattr(true, field))})
        model = true_model(self._path, case, true, {}, drives=True)
        for name, value in changed.items():
            kind, target = _split(name)
            if kind.startswith("com_"):
                model.body(target).ipos["xyz".index(kind[-1])] = value
            elif kind == "inertia_scale":
                model.body(target).inertia[:] *= value
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return true, model


def _split(name: str) -> tuple[str, str]:
    kind, _, target = name.removesuffix("]").partition("[")
    return kind, target


def _at(item: Parameter, value: float, step: float) -> float:
    """A value a step in z away."""
    return float(value * np.exp(step) if item.transform == "log" else value + item.scale * step)
