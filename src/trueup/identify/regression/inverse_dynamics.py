"""Regression of joint torques on all that a rigid robot's equation of motion is linear in."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from jaxtyping import Float, Float64, Int

from trueup.core.episode import Episode
from trueup.errors import ConfigError, DataError
from trueup.identify.inertial import Inertial
from trueup.identify.regression.base_parameters import BaseStructure
from trueup.identify.regression.base_regression import Solution, solve_base
from trueup.identify.regression.consistent import Consistent, Extras, consistent_bodies
from trueup.identify.regression.equation import (
    JOINT_TERMS,
    mechanism_structure,
    nominal_terms,
    term_columns,
    term_names,
    term_units,
)
from trueup.identify.regression.inverse_dynamics_result import (
    BaseParameter,
    BodyEstimate,
    InverseDynamicsFit,
    JointTerms,
)
from trueup.identify.regression.linkage import Linkage
from trueup.identify.regression.mass_regression import choose_cutoff
from trueup.identify.regression.pseudo_inertia import PARAMETER_UNITS, parameters_of
from trueup.identify.regression.samples import Samples, SampleSettings, TorqueSource, gather

_WEAK = 1.0 / 3.0


@dataclass(frozen=True)
class InverseDynamicsSettings:
    """How the torques are fitted.

    Attributes:
        epsilon: width of the smoothed sign of the velocity in Coulomb friction [rad/s or m/s].
        least_speed: share of a joint's RMS velocity below which its torque is left out: a joint that sticks follows no
            function of its velocity, and what dry friction does there would be taken for inertia. 0 keeps all.
        prior_deviation: how far bodies may easily go from the model, in log-Cholesky coordinates (0.5: a mass 2.7
            times as large or small); only what the torques do not tell depends on it.
        seed: of the random states from which the structure is read.
    """

    epsilon: float = 0.05
    least_speed: float = 0.2
    prior_deviation: float = 0.5
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse what cannot be meant."""
        for name in ("epsilon", "prior_deviation"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise ConfigError(f"{name} must be above 0", got=getattr(self, name))
        if not 0.0 <= self.least_speed < 1.0:
            raise ConfigError("least_speed is a share of the RMS velocity", got=self.least_speed, expected="0 to 1")


def fit_inverse_dynamics(
    model: mujoco.MjModel,
    position: Float[np.ndarray, "T J"],
    velocity: Float[np.ndarray, "T J"],
    acceleration: Float[np.ndarray, "T J"],
    torque: Float[np.ndarray, "T J"],
    *,
    joints: Sequence[str] | None = None,
    weight: Float[np.ndarray, "T J"] | None = None,
    motion: Int[np.ndarray, "T"] | None = None,
    settings: InverseDynamicsSettings | None = None,
) -> InverseDynamicsFit:
    """Base parameters by weighted least squares, and physically consistent bodies near the model.

    tau = Y(q, dq, ddq) p + armature ddq + damping dq + frictionloss tanh(dq / epsilon) + offset, minus the torque of
    the model's joint springs. Joints are weighed by their residual; intervals allow for autocorrelation.

    Args:
        model: hinges and slides on a fixed base; its inertias are the nominal ones.
        position: as in `qpos` [rad or m]; rows with a value that is not finite are left out.
        velocity: [rad/s or m/s].
        acceleration: [rad/s^2 or m/s^2], of a signal that was low-passed.
        torque: of the motors, low-passed alike [Nm or N].
        joints: names of the J columns; all joints of the model if None. Others rest at their reference position.
        weight: 0 leaves a value out, 1 counts it, e.g. to leave out saturated samples.
        motion: number of the motion of each row, not decreasing; one motion if None.
        settings: smoothing of the sign, prior and seed.

    Raises:
        ConfigError: a joint is neither hinge nor slide.
        DataError: shapes disagree, or too few rows.
        MissingDependency: Pinocchio is not installed.
        NameMismatch: the model lacks a joint.
    """
    settings = settings or InverseDynamicsSettings()
    linkage = Linkage(model, joints)
    arrays = [np.asarray(values, np.float64) for values in (position, velocity, acceleration, torque)]
    count = np.ones(arrays[0].shape) if weight is None else np.asarray(weight, np.float64)
    shape = (len(arrays[0]), len(linkage.joints))
    if any(values.shape != shape for values in (*arrays, count)):
        raise DataError("the arrays of an inverse dynamics disagree in shape", got=[a.shape for a in arrays])
    complete = np.all([np.isfinite(values).all(axis=1) for values in arrays], axis=0) & count.any(axis=1)
    q, dq, ddq, tau = (values[complete] for values in arrays)
    count = count[complete] * (np.abs(dq) >= settings.least_speed * np.sqrt(np.mean(dq**2, axis=0)))
    group = np.zeros(shape[0], np.int64) if motion is None else np.asarray(motion, np.int64)
    _, group = np.unique(group[complete], return_inverse=True)
    names = term_names(linkage)
    if len(q) < 2 * len(names):
        raise DataError("too few rows for an inverse dynamics", got=len(q), expected=f"at least {2 * len(names)}")
    structural = mechanism_structure(linkage, seed=settings.seed)
    full = term_columns(linkage, q, dq, ddq, settings.epsilon)
    load = tau + linkage.spring(q)
    solution = solve_base(full, load, count, group, structural)
    bodies = _consistent(linkage, solution, settings)
    parameters = _parameters_of(bodies, linkage)
    deviation = (solution.structure.groups @ parameters - solution.values) / solution.covariance.standard_error
    base_torque = full[:, :, list(solution.structure.kept)] @ solution.values
    return InverseDynamicsFit(
        base=_base(linkage, solution),
        structural_rank=structural.rank,
        rank=solution.structure.rank,
        condition=solution.condition,
        rmse=_rmse(linkage, load - base_torque, count),
        rmse_consistent=_rmse(linkage, load - full @ parameters, count),
        bodies=_bodies(bodies),
        joints=_joints(linkage, bodies),
        largest_deviation=float(np.abs(deviation).max()),
        interval_method=solution.covariance.method,
        samples=len(q),
        notes=_notes(structural, solution.structure),
    )


def inverse_dynamics_from_episodes(
    episodes: Iterable[Episode],
    model: mujoco.MjModel,
    *,
    joints: Sequence[str] | None = None,
    torque: TorqueSource = "measured",
    unmeasured: Collection[str] = (),
    delay_s: float = 0.0,
    cutoff_hz: float | None = None,
    max_rows: int = 20_000,
    settings: InverseDynamicsSettings | None = None,
) -> InverseDynamicsFit:
    """The same from logs, whose positions and torques are low-passed and differentiated.

    Args:
        episodes: those to fit, in the joint names and units of the robot.
        model: of the robot.
        joints: joints of the log that are fitted; those of the first episode if None.
        torque: the measured torque, or the commanded one.
        unmeasured: joints that move, and whose torque says nothing.
        delay_s: the commanded torque acts this much later [s].
        cutoff_hz: of the low-pass [Hz]; None takes the one that explains most of the torque. Too high, all inertias
            and weights come out too small, by more than the intervals say.
        max_rows: rows are thinned evenly to this number.
        settings: as in `fit_inverse_dynamics`.
    """
    logs = list(episodes)
    if not logs:
        raise DataError("there are no episodes to fit", expected="at least one")
    rows = SampleSettings(delay_s=delay_s, smooth_torque=True, torque=torque)
    if cutoff_hz is None:
        cutoff_hz = choose_cutoff(logs, model, rows, joints)
    samples = gather(logs, replace(rows, cutoff_hz=cutoff_hz), joints=joints)
    every = slice(None, None, max(1, -(-len(samples.time_s) // max_rows)))
    fit = fit_inverse_dynamics(
        model,
        samples.position[every],
        samples.velocity[every],
        samples.acceleration[every],
        samples.torque[every],
        joints=samples.joints,
        weight=np.tile([float(name not in unmeasured) for name in samples.joints], (len(samples.time_s[every]), 1)),
        motion=samples.motion[every],
        settings=settings,
    )
    return replace(fit, notes=(f"position and torque were low-passed at {cutoff_hz:g} Hz", *fit.notes))


def predict_inverse_dynamics(
    fitted: InverseDynamicsFit, linkage: Linkage, samples: Samples, *, epsilon: float
) -> Float64[np.ndarray, "T J"]:
    """The torque that the found bodies take for a motion [Nm or N]; NaN where the motion is not known.

    Those of the possible bodies near the model's, not the base parameters: what the fitted motions hardly show would be
    noise in others.

    Args:
        fitted: to other motions.
        linkage: of the same model and joints.
        samples: the motion, low-passed as those that were fitted.
        epsilon: as in the fit.
    """
    values = _found_terms(fitted, linkage)
    states = samples.position, samples.velocity, samples.acceleration
    known = np.all([np.isfinite(own).all(axis=1) for own in states], axis=0)
    result = np.full(samples.position.shape, np.nan)
    for motion in range(len(samples.motions)):  # the columns of all motions at once may not fit into memory
        rows = np.flatnonzero(known & (samples.motion == motion))
        if rows.size:
            q, dq, ddq = (own[rows] for own in states)
            result[rows] = term_columns(linkage, q, dq, ddq, epsilon) @ values - linkage.spring(q)
    return result


def _found_terms(fitted: InverseDynamicsFit, linkage: Linkage) -> Float64[np.ndarray, "P"]:
    """The parameters of links and joints that the bodies of a fit have."""
    total = np.zeros((len(linkage.links), len(PARAMETER_UNITS)))
    for body in linkage.bodies:
        own = fitted.bodies.get(body.name)
        if own is None:
            continue
        a, b, c, d, e, f = own.fullinertia_kg_m2
        inertia = np.array([[a, d, e], [d, b, f], [e, f, c]])
        inertial = Inertial(own.mass_kg, np.array(own.com_m), inertia)
        total[body.link] += parameters_of(body.pose.carried(inertial.pseudo_inertia))
    joints = [[getattr(fitted.joints[name], term) for name in linkage.joints] for term in JOINT_TERMS]
    return np.concatenate([total.ravel(), np.ravel(joints)])


def _base(linkage: Linkage, solution: Solution) -> tuple[BaseParameter, ...]:
    structure, covariance = solution.structure, solution.covariance
    error, half = covariance.standard_error, covariance.half_width()
    nominal = structure.groups @ nominal_terms(linkage)
    usual = _usual_sizes(linkage)
    units = term_units(linkage)
    result = []
    for number, kept in enumerate(structure.kept):
        value, width = float(solution.values[number]), float(half[number])
        # For friction there is no usual size: one of zero is found, not missed.
        share = width / usual[kept] if kept < usual.size and usual[kept] > 0.0 else 0.0
        result.append(
            BaseParameter(
                name=structure.names[kept],
                expression=structure.expression(number),
                unit=units[kept],
                value=value,
                low=value - width,
                high=value + width,
                standard_error=float(error[number]),
                nominal=float(nominal[number]),
                status="not identifiable" if share > 1.0 else "weak" if share > _WEAK else "ok",
                note=f"uncertain by {share:.2g} times its usual size: these motions hardly show it"
                if share > _WEAK
                else "",
            )
        )
    return tuple(result)


def _usual_sizes(linkage: Linkage) -> Float64[np.ndarray, "P"]:
    """Mass, mass times radius and mass times squared radius of each link, for its ten parameters."""
    table = linkage.nominal.reshape(len(linkage.links), -1)
    mass = table[:, 0]
    squared = 0.5 * (table[:, 4] + table[:, 6] + table[:, 9]) / np.maximum(mass, 1e-300)
    first = np.repeat((mass * np.sqrt(squared))[:, None], 3, axis=1)
    second = np.repeat((mass * squared)[:, None], 6, axis=1)
    return np.concatenate([mass[:, None], first, second], axis=1).ravel()


def _consistent(linkage: Linkage, solution: Solution, settings: InverseDynamicsSettings) -> Consistent:
    # Autocorrelated residuals say less than their number: without this the prior would hardly weigh at all.
    plain = np.diag(np.linalg.inv(solution.information))
    inflation = max(1.0, float(np.median(np.diag(solution.covariance.matrix) / plain)))
    root = np.linalg.cholesky(solution.information / inflation).T
    first = len(linkage.parameter_names)
    start = nominal_terms(linkage)[first:]
    found = np.zeros(len(solution.structure.names))
    found[list(solution.structure.kept)] = solution.values
    low = np.repeat([0.0, 0.0, 0.0, -np.inf], len(linkage.joints))
    deviation = np.maximum(np.maximum(np.abs(start), np.abs(found[first:])), 1e-3)
    return consistent_bodies(
        root @ solution.structure.groups,
        root @ solution.values,
        linkage.bodies,
        Extras(start, deviation, low),
        links=len(linkage.links),
        prior_deviation=settings.prior_deviation,
    )


def _parameters_of(solution: Consistent, linkage: Linkage) -> Float64[np.ndarray, "P"]:
    total = np.zeros((len(linkage.links), len(PARAMETER_UNITS)))
    for body, inertial in zip(solution.bodies, solution.inertials, strict=True):
        total[body.link] += parameters_of(body.pose.carried(inertial.pseudo_inertia))
    return np.concatenate([total.ravel(), solution.extras])


def _bodies(solution: Consistent) -> dict[str, BodyEstimate]:
    result = {}
    for body, inertial in zip(solution.bodies, solution.inertials, strict=True):
        i, com = inertial.inertia, inertial.com
        result[body.name] = BodyEstimate(
            mass_kg=inertial.mass,
            com_m=(float(com[0]), float(com[1]), float(com[2])),
            fullinertia_kg_m2=(
                *(float(i[0, 0]), float(i[1, 1]), float(i[2, 2])),
                *(float(i[0, 1]), float(i[0, 2]), float(i[1, 2])),
            ),
        )
    return result


def _joints(linkage: Linkage, solution: Consistent) -> dict[str, JointTerms]:
    table = solution.extras.reshape(len(JOINT_TERMS), -1)
    return {joint: JointTerms(*map(float, table[:, number])) for number, joint in enumerate(linkage.joints)}


def _rmse(
    linkage: Linkage, residual: Float64[np.ndarray, "T J"], count: Float64[np.ndarray, "T J"]
) -> dict[str, float]:
    mean = (count * residual**2).sum(axis=0) / np.maximum(count.sum(axis=0), 1e-300)
    return {joint: float(value) for joint, value in zip(linkage.joints, np.sqrt(mean), strict=True)}


def _notes(structural: BaseStructure, shown: BaseStructure) -> tuple[str, ...]:
    lost = [structural.names[number] for number in structural.kept if number not in shown.kept]
    if not lost:
        return ()
    return (
        f"these motions show {shown.rank} of {structural.rank} base parameters; not told apart from the others: "
        + ", ".join(lost),
    )
