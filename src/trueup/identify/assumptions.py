"""What numbers that a fit takes from the model, and nobody knows exactly, take from its certainty."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from jaxtyping import Float64

from trueup.core.parameters import Parameter, ParameterSet
from trueup.errors import DataError
from trueup.identify.inertial import COMPONENTS
from trueup.identify.problem import Problem
from trueup.identify.quantities import quantity
from trueup.identify.sensitivity import invariant
from trueup.identify.uncertainty import precision_of

# How well the inertia of a body is known beside its mass, one standard deviation of its logarithm; components of its
# log-Cholesky parameters are logarithms of lengths, of which the inertia has the squares. Its center, as a share of its
# radius of gyration.
_INERTIA, _COMPONENT, _CENTER = 0.1, 0.05, 0.05
# How well a drive's largest torque is known, one standard deviation of its logarithm.
_LIMIT = 0.1
# Numbers of a payload, which belong to the whole robot.
_CARRIED = frozenset({"payload_mass", "payload_x", "payload_y", "payload_z", "payload_inertia"})
# Of differences: of a residual, and of torques, in z.
_NEAR, _NEARER = 0.01, 1e-4
# States in which torques are compared, with velocities and accelerations of this size [rad/s and rad/s^2].
_STATES, _VELOCITY, _ACCELERATION = 60, 2.0, 10.0
# A combination of numbers changes no torque if it changes them by less than this share of what others do.
_NOTHING = 1e-5


def assumption_shifts(
    problem: Problem,
    z: Float64[np.ndarray, "P"],
    jacobian: Float64[np.ndarray, "P N"],
    weight: float,
) -> list[Float64[np.ndarray, "P"]]:
    """What the estimate changes by, in z, if the robot has other numbers than the model where none were fitted.

    A mass is fitted with the center and the radii of gyration that the model has; where all inertia is scaled by one
    number, with its principal axes and their proportions. Those of a real link are known no better than its mass: by a
    tenth in its inertia, and its center by a twentieth of its radius of gyration. With shapes that are exactly the
    model's, masses and their centers look as if motions told them; in truth a joint shows combinations of them alone
    (base parameters). A drive that saturates for a moment tells the scale of all torques, if its largest torque is what
    the model says: that is known to a tenth.

    So the covariance of the fit is told as if these numbers were fitted, too, with a prior, and with no information
    along what the equations of motion say is unseen: with J the derivatives of the residual by all of these, without
    their part along `unseen`, and mended along the common scale of all torques, L the precision of the prior and w the
    variance of one observation, it is w (J J^T + w L)^-1. What that is more than without them is returned as
    independent shifts.

    Source: Gautier, Khalil 1990, "Direct calculation of minimum set of inertial parameters of serial robots", for what
    is unseen.

    Args:
        problem: of the fit.
        z: best estimate, (P,).
        jacobian: verified, at z, (P, N).
        weight: variance of one independent observation.
    """
    assumed = {**_shapes(problem), **_centers(problem), **_limits(problem, z)}
    if not assumed:
        return []
    wider = problem.with_parameters(ParameterSet((*problem.parameters, *assumed)))
    count = len(assumed)
    moves = _NEAR * np.eye(count, z.size + count, z.size)
    here = np.concatenate([z, [item.to_z(item.value) for item in assumed]])
    low, high = wider.parameters.bounds
    ends = np.stack([np.clip(here + sign * moves, low, high) for sign in (1.0, -1.0)])
    seen = np.empty((2, count, jacobian.shape[1]))
    # Drives saturate for moments that a larger time step does not see.
    short, fine = np.array([item.quantity == "torque_limit" for item in assumed]), wider.alone()
    for own, simulated in ((~short, wider.slopes), (short, fine.residuals)):
        if own.any():
            seen[:, own] = simulated(ends[:, own].reshape(-1, here.size)).reshape(2, -1, jacobian.shape[1])
    away = (ends[0] - ends[1])[np.arange(count), z.size + np.arange(count)]
    both = np.concatenate([jacobian, np.nan_to_num((seen[0] - seen[1]) / away[:, None])])
    norms = np.linalg.norm(both, axis=1)
    size = np.where(norms > 0, norms, 1.0)
    known = unseen(wider, here)
    slopes = np.zeros((len(known), jacobian.shape[1]))
    if short.any():
        # These moments have kinks, where single derivatives do not add up to what all torques do together.
        scale = invariant(wider.parameters, here)[:1]
        one, other = fine.residuals(np.concatenate([here + _NEAR * scale, here - _NEAR * scale]))
        known, slopes = np.concatenate([known, scale]), np.vstack([slopes, np.nan_to_num(one - other) / (2.0 * _NEAR)])
    known, unit = known * size, both / size[:, None]
    both = (unit + np.linalg.pinv(known) @ (slopes - known @ unit)) * size[:, None]
    own = precision_of(problem.parameters)
    prior = np.zeros((len(both), len(both)))
    prior[: z.size, : z.size], prior[z.size :, z.size :] = own, np.diag(np.array(list(assumed.values())) ** -2.0)
    more = _covariance(both, prior, weight)[: z.size, : z.size] - _covariance(jacobian, own, weight)
    values, vectors = np.linalg.eigh(0.5 * (more + more.T))
    return [np.sqrt(value) * vector for value, vector in zip(values, vectors.T, strict=True) if value > 0.0]


def _shapes(problem: Problem) -> dict[Parameter, float]:
    """The shapes of bodies whose mass was fitted, with standard deviations in z; of none whose shape was, too."""
    components = [f"inertia_{component}" for component in COMPONENTS]
    bodies = _weighed(problem, components)
    scaled = {body for body in bodies if f"inertia_scale[{body}]" in problem.parameters.names}
    shapes = dict.fromkeys(components, scaled) | {"inertia_scale": bodies - scaled}
    return {
        (item := quantity(name).parameter(problem.nominal, body)): _INERTIA
        if item.transform == "log"
        else _COMPONENT / item.scale
        for name, own in shapes.items()
        for body in quantity(name).holders(problem.nominal)
        if body in own
    }


def _centers(problem: Problem) -> dict[Parameter, float]:
    """Likewise the centers of mass of bodies whose mass was fitted."""
    names = ("com_x", "com_y", "com_z")
    found = {}
    for body in _weighed(problem, names):
        inertial = problem.nominal.inertial(body)
        radius = np.sqrt(0.5 * np.trace(inertial.inertia) / inertial.mass)
        for name in names if radius > 0.0 else ():
            item = quantity(name).parameter(problem.nominal, body)
            found[item] = _CENTER * float(radius) / item.scale
    return found


def _weighed(problem: Problem, names: Sequence[str]) -> set[str]:
    """Bodies whose mass was fitted, and nothing of these names."""
    bodies = {item.target for item in problem.parameters.free if item.quantity == "mass" and item.target}
    return bodies - {item.target for item in problem.parameters if item.quantity in names}


def _limits(problem: Problem, z: Float64[np.ndarray, "P"]) -> dict[Parameter, float]:
    """Likewise the largest torques of drives that come near it."""
    made, names = quantity("torque_limit"), problem.nominal.robot.joint_names
    held = {
        joint: made.parameter(problem.nominal, joint)
        for joint in made.holders(problem.nominal)
        if f"torque_limit[{joint}]" not in problem.parameters.names
    }
    if not held:
        return {}
    try:
        torques = [np.abs(course.torque).max(axis=(0, 1)) for course in problem.courses(z).values()]
    except DataError:
        return {}
    most = dict(zip(names, np.max(torques, axis=0).tolist(), strict=True))
    return {item: _LIMIT for joint, item in held.items() if most[joint] > (1.0 - _LIMIT) * item.value}


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
        if quantity(item.quantity).of == "body" or item.quantity == "armature" or item.quantity in _CARRIED
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
