"""What the shape of links, which nobody knows exactly, takes from the certainty of a fit."""

from __future__ import annotations

import mujoco
import numpy as np
from jaxtyping import Float64

from trueup.core.parameters import Parameter, ParameterSet
from trueup.identify.inertial import COMPONENTS
from trueup.identify.problem import Problem
from trueup.identify.quantities import quantity
from trueup.identify.uncertainty import precision_of

# How well the inertia of a body is known beside its mass, one standard deviation of its logarithm; components of its
# log-Cholesky parameters are logarithms of lengths, of which the inertia has the squares.
_INERTIA, _COMPONENT = 0.1, 0.05
# Of differences: of a residual, and of torques, in z.
_NEAR, _NEARER = 0.01, 1e-4
# States in which torques are compared, with velocities and accelerations of this size [rad/s and rad/s^2].
_STATES, _VELOCITY, _ACCELERATION = 60, 2.0, 10.0
# A combination of numbers changes no torque if it changes them by less than this share of what others do.
_NOTHING = 1e-5


def shape_shifts(
    problem: Problem,
    z: Float64[np.ndarray, "P"],
    jacobian: Float64[np.ndarray, "P N"],
    weight: float,
) -> list[Float64[np.ndarray, "P"]]:
    """What the estimate changes by, in z, if bodies whose mass was fitted have other shapes than the model's.

    A mass is fitted with the radii of gyration that the model has; where all inertia is scaled by one number, with its
    principal axes and their proportions. Those of a real link are known no better than its mass, by a tenth in its
    inertia. With shapes that are exactly the model's, masses and their centers look as if motions told them; in truth
    a joint shows combinations of them alone (base parameters). So the covariance of the fit is told as if the shapes
    were fitted, too, with a prior, and with no information along what the equations of motion say is unseen: with J
    the derivatives of the residual by all of these, without their part along `unseen`, L the precision of the prior
    and w the variance of one observation, it is w (J J^T + w L)^-1. What that is more than without shapes is returned
    as independent shifts.

    Source: Gautier, Khalil 1990, "Direct calculation of minimum set of inertial parameters of serial robots", for what
    is unseen.

    Args:
        problem: of the fit.
        z: best estimate, (P,).
        jacobian: verified, at z, (P, N).
        weight: variance of one independent observation.
    """
    extra = _shapes(problem)
    if not extra:
        return []
    wider = problem.with_parameters(ParameterSet((*problem.parameters, *extra)))
    count = len(extra)
    moves = _NEAR * np.eye(count, z.size + count, z.size)
    here = np.concatenate([z, np.zeros(count)])
    seen = wider.slopes(np.concatenate([here + moves, here - moves])).reshape(2, count, -1)
    both = np.concatenate([jacobian, np.nan_to_num((seen[0] - seen[1]) / (2.0 * _NEAR))])
    norms = np.linalg.norm(both, axis=1)
    size = np.where(norms > 0, norms, 1.0)
    nothing = unseen(wider, here) * size
    unit = both / size[:, None]
    both = (unit - np.linalg.pinv(nothing) @ (nothing @ unit)) * size[:, None]
    rate = np.array([_INERTIA if item.transform == "log" else _COMPONENT / item.scale for item in extra])
    own = precision_of(problem.parameters)
    prior = np.zeros((len(both), len(both)))
    prior[: z.size, : z.size], prior[z.size :, z.size :] = own, np.diag(rate**-2.0)
    more = _covariance(both, prior, weight)[: z.size, : z.size] - _covariance(jacobian, own, weight)
    values, vectors = np.linalg.eigh(0.5 * (more + more.T))
    return [np.sqrt(value) * vector for value, vector in zip(values, vectors.T, strict=True) if value > 0.0]


def _shapes(problem: Problem) -> list[Parameter]:
    """The shapes of bodies whose mass was fitted; of none whose shape was fitted, too."""
    fitted = {(item.quantity, item.target) for item in problem.parameters}
    components = [f"inertia_{component}" for component in COMPONENTS]
    bodies = {item.target for item in problem.parameters.free if item.quantity == "mass" and item.target}
    bodies -= {body for name, body in fitted if name in components}
    scaled = {body for body in bodies if ("inertia_scale", body) in fitted}
    shapes = dict.fromkeys(components, scaled) | {"inertia_scale": bodies - scaled}
    return [
        quantity(name).parameter(problem.nominal, body)
        for name, own in shapes.items()
        for body in quantity(name).holders(problem.nominal)
        if body in own
    ]


def _covariance(
    jacobian: Float64[np.ndarray, "P N"], precision: Float64[np.ndarray, "P P"], weight: float
) -> Float64[np.ndarray, "P P"]:
    return np.asarray(weight * np.linalg.pinv(jacobian @ jacobian.T + weight * precision, rcond=1e-14, hermitian=True))


def unseen(problem: Problem, z: Float64[np.ndarray, "P"]) -> Float64[np.ndarray, "K P"]:
    """Directions in z along which no torque of any motion changes, by the equations of motion, (K, P), orthonormal.

    Torques depend on masses, their centers, inertias and armatures, and on nothing else that is fitted here: their
    derivatives by these in random states are a matrix with as many columns, whose null space this is.

    Args:
        problem: whose free parameters count.
        z: where, (P,).
    """
    rigid = [
        number
        for number, item in enumerate(problem.parameters.free)
        if quantity(item.quantity).of == "body" or item.quantity == "armature"
    ]
    if not rigid:
        return np.zeros((0, z.size))
    rows, bounds = [], problem.parameters.bounds
    for number in rigid:
        move = _NEARER * np.eye(1, z.size, number)[0]
        one, other = (np.clip(z + sign * move, *bounds) for sign in (1.0, -1.0))
        away = max(float((one - other)[number]), 1e-300)
        rows.append((_torques(problem, one) - _torques(problem, other)) / away)
    slopes = np.array(rows)
    size = np.linalg.norm(slopes, axis=1)
    size = np.maximum(size, _NOTHING * max(float(size.max(initial=0.0)), 1e-300))
    vectors, sizes, _ = np.linalg.svd(slopes / size[:, None], full_matrices=True)
    rank = int(np.count_nonzero(sizes > _NOTHING * sizes.max(initial=0.0)))
    found = np.zeros((len(rigid) - rank, z.size))
    found[:, rigid] = (vectors[:, rank:] / size[:, None]).T
    if not len(found):
        return found
    basis, _ = np.linalg.qr(found.T)
    return np.asarray(basis.T)


def _torques(problem: Problem, z: Float64[np.ndarray, "P"]) -> Float64[np.ndarray, "S"]:
    """Torques of inertia and gravity in random states, the same ones for all z [Nm or N]."""
    model = problem.candidate(problem.parameters.values(z)).compile()
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    turning = np.isin(model.jnt_type, (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)))
    torques = np.empty((_STATES, model.nv))
    for own in torques:
        data.qpos[model.jnt_qposadr[turning]] = rng.uniform(-np.pi, np.pi, np.count_nonzero(turning))
        data.qvel[:] = rng.normal(0.0, _VELOCITY, model.nv)
        mujoco.mj_forward(model, data)
        mujoco.mj_mulM(model, data, own, rng.normal(0.0, _ACCELERATION, model.nv))
        own += data.qfrc_bias - data.qfrc_gravcomp
    return np.asarray(torques.ravel())
