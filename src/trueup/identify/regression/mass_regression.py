"""Torques regressed on each link's own share, with MuJoCo alone: coarse, fast, and a judge of low-pass filters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from jaxtyping import Float64, Int
from scipy.optimize import lsq_linear

from trueup.core.episode import Episode
from trueup.errors import ConfigError, DataError, NameMismatch
from trueup.identify.regression.equation import JOINT_TERMS
from trueup.identify.regression.samples import Samples, SampleSettings, gather

_ROUNDS = 3
_LEAST_SPEED = 0.2  # of a joint's RMS velocity; slower, dry friction is no function of the velocity
_EPSILON = 0.05  # width of the smoothed Coulomb step [rad/s or m/s]
_LEAST_SCALE = 0.05
_SCALE_DEVIATION = 0.5  # of a body's mass, relative: what the torques do not tell stays at the model's
_LOOSE = 100.0  # joint terms may go this many typical torques away
_CUTOFFS_HZ = (3.0, 5.0, 7.0, 10.0, 15.0, 22.0, 33.0)
_ROWS_TO_CHOOSE = 400


@dataclass(frozen=True, eq=False)
class MassRegression:
    """A regression of torques on shares of links and terms of joints.

    Attributes:
        joints: names of the J columns.
        links: names of the B bodies that move on their own.
        values: factor on each link's mass, then `JOINT_TERMS` by joint, (B + 4 J,).
        table: what each value contributes, (T, J, B + 4 J).
        load: torques, (T, J).
    """

    joints: tuple[str, ...]
    links: tuple[str, ...]
    values: Float64[np.ndarray, "P"]
    table: Float64[np.ndarray, "T J P"]
    load: Float64[np.ndarray, "T J"]

    @property
    def unexplained(self) -> float:
        """Residual over torque, geometric mean over the joints that have a torque."""
        size = self.load.std(axis=0)
        used = size > 0.0
        rmse = np.sqrt(np.mean((self.load - self.table @ self.values) ** 2, axis=0))
        ratio = np.maximum(rmse[used] / size[used], 1e-12)
        return float(np.exp(np.mean(np.log(ratio)))) if used.any() else 1.0


def choose_cutoff(
    episodes: Sequence[Episode], model: mujoco.MjModel, settings: SampleSettings, joints: Sequence[str] | None
) -> float:
    """The low-pass [Hz] after which the largest part of the torques is explained.

    Too high, noise of the acceleration passes for motion, and all inertias and weights come out too small; too low,
    motion is cut away. Both leave more of the torque unexplained.

    Args:
        episodes: logs with torques.
        model: of the robot.
        settings: sources and delay.
        joints: joints to look at.
    """
    rate = min(episode.measured.rate_hz for episode in episodes)
    candidates = [cutoff for cutoff in _CUTOFFS_HZ if cutoff < 0.4 * rate] or [0.4 * rate]
    left: dict[float, float] = {}
    for cutoff in candidates:
        samples = gather(episodes, replace(settings, cutoff_hz=cutoff), joints=joints)
        left[cutoff] = regress_masses(samples, model, max_rows=_ROWS_TO_CHOOSE).unexplained
    return min(left, key=lambda cutoff: left[cutoff])


def regress_masses(samples: Samples, model: mujoco.MjModel, *, max_rows: int) -> MassRegression:
    """Least squares within what is possible.

    Args:
        samples: low-passed rows with torques.
        model: with the nominal bodies.
        max_rows: rows are thinned evenly to about this number.

    Raises:
        ConfigError: a joint is neither hinge nor slide.
        DataError: too few rows.
        NameMismatch: the model lacks a joint.
    """
    columns = _joint_columns(model, samples.joints)
    states = [samples.position, samples.velocity, samples.acceleration, samples.torque]
    complete = np.flatnonzero(np.all([np.isfinite(values).all(axis=1) for values in states], axis=0))
    complete = complete[:: max(1, complete.size // max_rows)]
    if complete.size < 10 * len(JOINT_TERMS):
        raise DataError(
            "too few rows for a regression", got=complete.size, expected=f"at least {10 * len(JOINT_TERMS)}"
        )
    q, dq, ddq, tau = (values[complete] for values in states)
    links, shares = _body_shares(model, columns, q, dq, ddq)
    own = np.eye(len(columns))
    extra = [term[:, :, None] * own for term in (ddq, dq, np.tanh(dq / _EPSILON), np.ones_like(dq))]
    table = np.concatenate([shares, *extra], axis=2)
    load = tau + model.jnt_stiffness[columns] * (model.qpos_spring[columns] - q)
    # A joint without any torque has no torque that was measured, and says nothing.
    moving = (np.abs(dq) >= _LEAST_SPEED * np.sqrt(np.mean(dq**2, axis=0))) & np.any(tau != 0.0, axis=0)
    return MassRegression(
        joints=samples.joints,
        links=tuple(links),
        values=_bounded(table * moving[:, :, None], load * moving, len(links)),
        table=table,
        load=load,
    )


def model_torque(
    model: mujoco.MjModel, samples: Samples, *, rigid: bool = False, epsilon: float = _EPSILON
) -> Float64[np.ndarray, "T J"]:
    """The torque that a model takes for a motion, by MuJoCo's inverse dynamics; NaN where the motion is not known.

    Args:
        model: with its own masses, armature, damping, springs and dry friction; contacts and limits are left out.
        samples: the motion, low-passed.
        rigid: of the links alone, without what the joints take.
        epsilon: width of the smoothed sign of the velocity in dry friction [rad/s or m/s].

    Raises:
        ConfigError: a joint is neither hinge nor slide.
        NameMismatch: the model lacks a joint.
    """
    columns = _joint_columns(model, samples.joints)
    states = samples.position, samples.velocity, samples.acceleration
    known = np.flatnonzero(np.all([np.isfinite(values).all(axis=1) for values in states], axis=0))
    q, dq, ddq = (values[known] for values in states)
    result = np.full(samples.position.shape, np.nan)
    result[known] = _inverse(_bare(model) if rigid else _unconstrained(model), columns, q, dq, ddq)
    if not rigid:
        result[known] += model.dof_frictionloss[columns] * np.tanh(dq / epsilon)
    return result


def _unconstrained(model: mujoco.MjModel) -> mujoco.MjModel:
    """Without contacts, limits, dry friction and drives."""
    free = mujoco.MjModel.__copy__(model)
    free.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_ACTUATION
    return free


def _bare(model: mujoco.MjModel) -> mujoco.MjModel:
    """Links alone: also without what the joints take."""
    bare = _unconstrained(model)
    for field in ("dof_armature", "dof_damping", "dof_dampingpoly", "jnt_stiffness", "jnt_stiffnesspoly"):
        if hasattr(bare, field):
            getattr(bare, field)[:] = 0.0
    return bare


def _joint_columns(model: mujoco.MjModel, joints: tuple[str, ...]) -> Int[np.ndarray, "J"]:
    every = [model.joint(number).name for number in range(model.njnt)]
    missing = [name for name in joints if name not in every]
    if missing:
        raise NameMismatch(f"joints {missing} are not in the model", left=joints, right=every, right_name="model has")
    if model.nv != model.njnt or model.nq != model.njnt:
        raise ConfigError(
            "start values are for hinges and slides on a fixed base", got=f"{model.nv} degrees of freedom"
        )
    return np.array([every.index(name) for name in joints])


def _body_shares(
    model: mujoco.MjModel,
    columns: Int[np.ndarray, "J"],
    q: Float64[np.ndarray, "T J"],
    dq: Float64[np.ndarray, "T J"],
    ddq: Float64[np.ndarray, "T J"],
) -> tuple[list[str], Float64[np.ndarray, "T J B"]]:
    """The torque that each link's own mass asks for: what inverse dynamics add when it is doubled."""
    bare = _bare(model)
    plain = _inverse(bare, columns, q, dq, ddq)
    owners = [body for body in np.unique(model.body_weldid) if body > 0]
    result = np.empty((*plain.shape, len(owners)))
    for number, owner in enumerate(owners):
        factor = np.where(model.body_weldid == owner, 2.0, 1.0)
        bare.body_mass[:], bare.body_inertia[:] = model.body_mass * factor, model.body_inertia * factor[:, None]
        result[:, :, number] = _inverse(bare, columns, q, dq, ddq) - plain
    return [model.body(int(owner)).name or f"body{owner}" for owner in owners], result


def _inverse(
    model: mujoco.MjModel,
    columns: Int[np.ndarray, "J"],
    q: Float64[np.ndarray, "T J"],
    dq: Float64[np.ndarray, "T J"],
    ddq: Float64[np.ndarray, "T J"],
) -> Float64[np.ndarray, "T J"]:
    data = mujoco.MjData(model)
    result = np.empty(q.shape)
    for row in range(len(q)):
        data.qpos[columns], data.qvel[columns], data.qacc[columns] = q[row], dq[row], ddq[row]
        mujoco.mj_inverse(model, data)
        result[row] = data.qfrc_inverse[columns]
    return result


def _bounded(
    table: Float64[np.ndarray, "T J P"], load: Float64[np.ndarray, "T J"], bodies: int
) -> Float64[np.ndarray, "P"]:
    """Least squares within what is possible, joints weighing by their residual, masses drawn to 1."""
    count, width = table.shape[2], load.shape[1]
    low = np.concatenate([np.full(bodies, _LEAST_SCALE), np.zeros(3 * width), np.full(width, -np.inf)])
    center = np.concatenate([np.ones(bodies), np.zeros(4 * width)])
    by_joint = table.transpose(1, 0, 2)
    grams = by_joint.transpose(0, 2, 1) @ by_joint
    moments = np.einsum("jtp,tj->jp", by_joint, load)
    noise = np.maximum(load.std(axis=0), 1e-6)
    values = center
    for _ in range(_ROUNDS):
        gram = np.tensordot(noise**-2.0, grams, axes=1)
        sizes = np.sqrt(np.diag(gram))
        # Joint terms are held only as far as needed for a column without any content.
        loose = np.where(sizes > 0.0, _LOOSE * np.sqrt(load.size) / np.where(sizes > 0.0, sizes, 1.0), 1.0)
        precision = np.concatenate([np.full(bodies, _SCALE_DEVIATION), loose[bodies:]]) ** -2.0
        scale = 1.0 / np.sqrt(sizes**2 + precision)
        factor = np.linalg.cholesky((gram + np.diag(precision)) * scale[:, None] * scale)
        right = np.linalg.solve(factor, scale * (noise**-2.0 @ moments + precision * center))
        values = scale * lsq_linear(factor.T, right, bounds=(low / scale, np.full(count, np.inf)), method="bvls").x
        left = np.mean((load - table @ values) ** 2, axis=0)
        noise = np.maximum(np.sqrt(left), 1e-6 * np.abs(load).max() + 1e-12)
    return np.asarray(values)
