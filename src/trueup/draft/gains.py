"""Gains of servos of which nobody says any: stiff enough to carry the arm, calm at the time step of the model."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float64

from trueup.errors import ConfigError
from trueup.robots import RobotSpec
from trueup.sim.compiled_robot import compile_robot

# A servo of usual stiffness: its joint alone swings at this frequency [Hz], damped critically.
_FREQUENCY_HZ = 5.0
# How far a joint sags at most under the weight that it carries, or stays away by its dry friction [rad or m].
_SAG = {"rad": 0.02, "m": 0.002}
# Largest product of time step and natural frequency, and of time step and damping over inertia.
_CALM = 0.8
_LARGEST_CONDITION = 1e14  # of a mass matrix that has an inverse
_POSES = 12
_ROUNDS = 100
_SEED = 0


@dataclass(frozen=True)
class Gains:
    """Of one joint: kp [Nm/rad or N/m], kv [Nm s/rad or N s/m]."""

    kp: float
    kv: float


def stable_gains(robot: RobotSpec, spec: mujoco.MjSpec, *, origin: Path) -> dict[str, Gains]:
    """Gains of position servos from the model's mass matrix M(q) and weight g(q), over poses within its ranges.

    kp = max(M_ii w^2, D_i w / 2, (g_i + f_i) / sag) with dry friction f, but no more than what the step h takes,
    (c / h)^2 / (A^-1)_ii, the smallest over poses, with A = M + h D, since the damping D is integrated implicitly;
    kv = 2 sqrt(kp M_ii) - D, likewise at most c / (h (A^-1)_ii). At last the kp of joints that take part in a mode of
    A^-1 diag(kp) that is faster than c / h are lowered until none is.

    Args:
        robot: its description, with a controller that needs no gains.
        spec: its model, which is changed.
        origin: of the model, for messages.

    Returns:
        Joint -> gains.

    Raises:
        ConfigError: MuJoCo refuses the model, or its mass matrix has no inverse.
    """
    model, _, _ = compile_robot(spec, robot, origin=origin)
    rows = [model.joint(name).id for name in robot.joint_names]
    dofs = model.jnt_dofadr[rows]
    masses, weights = _poses(model, rows)
    inertia = masses[:, range(len(rows)), range(len(rows))].max(axis=0)
    if not np.isfinite(masses).all() or np.linalg.cond(masses).max() > _LARGEST_CONDITION:
        raise ConfigError(
            f"{origin} has masses for which no gains of servos can be made up",
            got=f"{inertia.min():.3g} to {inertia.max():.3g} kg m2 at its joints",
            hint="Look at its masses and inertias, or state the gains in a robot.yaml: kind, kp, kv.",
        )
    step, swing, damping = float(model.opt.timestep), 2.0 * np.pi * _FREQUENCY_HZ, model.dof_damping[dofs]
    masses = masses + step * np.diag(damping)
    mobility = np.linalg.inv(masses)[:, range(len(rows)), range(len(rows))].max(axis=0)
    slide = model.jnt_type[rows] == int(mujoco.mjtJoint.mjJNT_SLIDE)
    sag = np.where(slide, _SAG["m"], _SAG["rad"])
    fastest = (_CALM / step) ** 2
    kp = np.maximum(inertia * swing**2, 0.5 * damping * swing)
    kp = np.maximum(kp, (weights + model.dof_frictionloss[dofs]) / sag)
    kp = _calmed(np.minimum(kp, fastest / mobility), masses, fastest)
    kv = np.clip(2.0 * np.sqrt(kp * inertia) - damping, 0.02 * np.sqrt(kp * inertia), None)
    kv = np.minimum(kv, _CALM / (step * mobility))
    return {
        name: Gains(float(f"{own:.3g}"), float(f"{calm:.3g}"))
        for name, own, calm in zip(robot.joint_names, kp, kv, strict=True)
    }


def _calmed(
    kp: Float64[np.ndarray, "J"], masses: Float64[np.ndarray, "N J J"], fastest: float
) -> Float64[np.ndarray, "J"]:
    """Stiffnesses, lowered where they take part in a mode whose frequency squared is above `fastest` [1/s^2]."""
    inverses = np.linalg.inv(masses)
    for _ in range(_ROUNDS):
        root = np.sqrt(kp)
        squares, shapes = np.linalg.eigh(root[:, None] * inverses * root)
        worst = int(squares[:, -1].argmax())
        if squares[worst, -1] <= fastest:
            return kp
        part = shapes[worst, :, -1] ** 2
        kp = kp * (fastest / squares[worst, -1]) ** (part / part.max())
    return kp * min(1.0, fastest / float(squares[:, -1].max()))


def _poses(model: mujoco.MjModel, rows: list[int]) -> tuple[Float64[np.ndarray, "N J J"], Float64[np.ndarray, "J"]]:
    """Mass matrices of the joints in some poses, and the largest weight that each carries there [Nm or N]."""
    data, random = mujoco.MjData(model), np.random.default_rng(_SEED)
    dofs = model.jnt_dofadr[rows]
    masses, weights = [], []
    for number in range(_POSES):
        mujoco.mj_resetData(model, data)
        for row in rows if number else ():
            low, high = model.jnt_range[row] if model.jnt_limited[row] else (-np.pi, np.pi)
            data.qpos[model.jnt_qposadr[row]] = random.uniform(low, high)
        mujoco.mj_forward(model, data)
        full = np.empty((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        masses.append(full[np.ix_(dofs, dofs)])
        weights.append(np.abs(data.qfrc_bias[dofs]))
    return np.array(masses), np.max(weights, axis=0)
