"""What a robot carries, by its motion: a fit of it without the payload, and motions with it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64
from threadpoolctl import threadpool_limits

from trueup.core.episode import Episode
from trueup.core.fit_result import FitResult
from trueup.core.parameters import Parameter, ParameterSet
from trueup.errors import DataError
from trueup.identify.candidate import Nominal
from trueup.identify.config import DataChoice, IdentifyConfig, make_parameters
from trueup.identify.knowledge import parameter_of
from trueup.identify.problem import Problem
from trueup.identify.quantities import quantity
from trueup.identify.search import Search, Stopwatch
from trueup.identify.simulated_logs import SimulatedLogs
from trueup.identify.solution import SolveSettings
from trueup.identify.solve import solve
from trueup.identify.uncertainty import Posterior, noise_of, posterior_of, precision_of
from trueup.robots import RobotSpec

CARRIED = ("payload_mass", "payload_x", "payload_y", "payload_z", "payload_inertia")
# Of what carries it, the mass by which the slope of the residual is taken, and the payload that a search may take away:
# below zero, since an estimate that cannot be would be off to one side. Of the first, what a search begins at at least.
_SLOPE, _LEAST, _LITTLE = 0.1, -0.5, 0.25
# Distance for the slope by the place [m]; what is believed of mass [kg] and first moments [kg m] before: nothing.
_ASIDE, _MASS, _MOMENT = 0.05, 10.0, 1.0
# Joint steps of all numbers; shares of one that are tried; the gain that is not worth another, in observations.
_ROUNDS, _SHARES, _SETTLED = 3, (1.0, 0.5, 0.2), 0.3
# A number that no sample moves is known to this, in z; and what rounding leaves of correlations.
_EXACT, _ROUNDING = 1e-6, 1e-9
# The place is looked for so far from where the search begins [m].
_FAR = 0.6


@dataclass(frozen=True, eq=False)
class Load:
    """A payload, and what is known about it.

    Attributes:
        nominal: the fitted model without it.
        parameters: all numbers: those of the robot, of the recordings, and of the payload.
        posterior: of the free ones, with what the motions without a payload have told.
        mass: [kg].
        center: in the frame of the body that carries it, (3,) [m].
        covariance: of mass and center, (4, 4) [kg, m].
        rms: position error that is left on the fitted motions [rad or m].
    """

    nominal: Nominal
    parameters: ParameterSet
    posterior: Posterior
    mass: float
    center: Float64[np.ndarray, "3"]
    covariance: Float64[np.ndarray, "4 4"]
    rms: float

    @property
    def values(self) -> dict[str, float]:
        """Name -> value of all numbers."""
        return self.parameters.values(self.posterior.z)

    def errors(self, logs: Sequence[Episode], config: IdentifyConfig, *, jobs: int, seed: int) -> tuple[float, float]:
        """Position RMSE of motions without and with the payload [rad or m], over scored joints and motions."""
        own = ParameterSet(tuple(item for item in self.parameters if quantity(item.quantity).of != "motion"))
        problem = _problem(self.nominal, logs, config, own, jobs=jobs, seed=seed)
        empty = own.at({"payload_mass": 0.0}).start
        residuals = problem.residuals(np.stack([empty, own.at(self.values).start]))
        without, with_it = np.sqrt((residuals**2).sum(axis=1))
        return float(without), float(with_it)


def weigh(
    fit: FitResult,
    samples: Mapping[str, Float64[np.ndarray, "S"]],
    robot: RobotSpec,
    model: Path,
    logs: Sequence[Episode],
    *,
    at: str = "",
    config: IdentifyConfig | None = None,
    jobs: int = 1,
    seed: int = 0,
) -> Load:
    """Mass and place of what a robot carries in these motions.

    The numbers of the robot, theta, are known by the fit: around theta_a, with covariance S. With r the residual of the
    motions with the payload phi, and w the variance of one independent observation,

        |r(theta, phi)|^2 + w (theta - theta_a)^T S^-1 (theta - theta_a) + w |phi / sigma|^2

    is as small as can be. So what the fit does not know of the robot widens the interval of the payload, along with its
    correlations, and what the motions with the payload say of the robot counts, too.

    Args:
        fit: of the robot without the payload.
        samples: of what the fit knows, as fit.samples.npz has them: name -> draws, (S,).
        robot: the fitted description that goes with the fit.
        model: the fitted model.
        logs: motions with the payload, in the robot's names.
        at: body or site that carries it; the site `payload`, or the last body, if empty.
        config: which parts of the logs are used; the default if None.
        jobs: threads.
        seed: of the draws of pieces.

    Raises:
        ConfigError: nothing that moves is called `at`.
        DataError: no motion can be simulated.
    """
    nominal = Nominal(robot, model, hard_friction=False, payload_at=at)
    config = (config or IdentifyConfig()).resolved(nominal)
    known, precision = _known(fit, samples, nominal)
    fits = {"encoder_zero": "all"} if fit.data.get("encoder_zeros") else {}
    own = make_parameters(fits, nominal, [log.id for log in logs])
    load = _payload(nominal)
    parameters = ParameterSet((*known, *own, *load))
    before = np.zeros((len(parameters.free),) * 2)
    before[: len(known), : len(known)] = precision
    rest = precision_of(ParameterSet((*own, *load)))
    before[len(known) :, len(known) :] = rest
    with threadpool_limits(1, "blas"):
        problem = _problem(nominal, logs, config, parameters, jobs=jobs, seed=seed)
        begun = parameters.at(_first_look(problem))
        held = begun.hold([item.name for item in known])
        alone = solve(problem.with_parameters(held), SolveSettings(solver="gauss-newton", seed=seed))
        z, residual, jacobian = _with_all(problem, begun.at(alone.values).start, before)
        posterior = posterior_of(problem, z, residual, jacobian, before)
    return _load(nominal, parameters, posterior, float(np.linalg.norm(residual)))


def _problem(
    nominal: Nominal,
    logs: Sequence[Episode],
    config: IdentifyConfig,
    parameters: ParameterSet,
    *,
    jobs: int,
    seed: int,
) -> Problem:
    """Positions alone: whether a logged torque is one, is another question."""
    config = replace(config, signals={"position": 1.0}).resolved(nominal)
    return SimulatedLogs(nominal, {"train": logs}, config, jobs=jobs, seed=seed).problem(parameters)


def _known(
    fit: FitResult, samples: Mapping[str, Float64[np.ndarray, "S"]], nominal: Nominal
) -> tuple[list[Parameter], Float64[np.ndarray, "K K"]]:
    """The numbers of the robot, around what the fitted model has, and the inverse of their covariance, in z.

    The covariance is that of samples: what is known of combinations, such as a gain over a mass, is lost where small
    correlations are left out, as in fit.json. What belongs to a payload that the fit itself has found is in the model,
    and known as well as the model says.
    """
    known, rows = [], []
    for fitted in fit.free:
        item = parameter_of(fitted)
        if item.quantity in CARRIED:
            continue
        drawn = samples[item.name]
        rows.append(np.log(np.maximum(drawn, 1e-300)) if item.transform == "log" else drawn / item.scale)
        kind = quantity(item.quantity)
        if kind.relative:  # a change of what the model says, which by now is in the model
            value = kind.parameter(nominal, item.target).value
            if item.transform == "log":
                low, high = item.low / item.value * value, item.high / item.value * value
            else:
                low, high = item.low - item.value + value, item.high - item.value + value
            item = replace(item, value=value, low=low, high=high, nominal=value)
        known.append(item)
    if not known:
        return [], np.zeros((0, 0))
    covariance = np.atleast_2d(np.cov(np.stack(rows)))
    scale = np.sqrt(np.maximum(np.diag(covariance), _EXACT**2))
    # Samples that all lie on a bound have no spread.
    alike = covariance / np.outer(scale, scale) + _ROUNDING * np.eye(len(known))
    return known, np.asarray(np.linalg.inv(alike) / np.outer(scale, scale))


def _payload(nominal: Nominal) -> tuple[Parameter, ...]:
    """The numbers of the payload; its mass may be a little below zero where the link that carries it allows that."""
    made = make_parameters(dict.fromkeys(CARRIED, "all"), nominal)
    link = _link_kg(nominal)
    least = 0.0 if nominal.hangs_payloads else _LEAST * link
    mass = replace(made["payload_mass"], value=0.0, low=least)
    places = [
        replace(item, low=item.value - _FAR, high=item.value + _FAR)
        for item in (made[f"payload_{axis}"] for axis in "xyz")
    ]
    return (mass, *places, made["payload_inertia"])


def _link_kg(nominal: Nominal) -> float:
    body, _ = nominal.payload_place
    return float(nominal.model.body(body).mass[0])


def _first_look(problem: Problem) -> dict[str, float]:
    """Mass and place by one linear step from no payload.

    A residual is nearly linear in the mass m and the first moments m c of a small payload, though not in c: at m = 0 no
    place shows. Both are taken from how much a small mass at four places changes it.
    """
    parameters = problem.parameters
    small = max(_SLOPE * _link_kg(problem.nominal), 0.02)
    center = np.array([parameters[f"payload_{axis}"].value for axis in "xyz"])
    places = np.concatenate([center[None], center + _ASIDE * np.eye(3)])
    rows = [parameters.start]
    for place in places:
        at = dict(zip(CARRIED, (small, *map(float, place)), strict=False))
        rows.append(parameters.at(at).start)
    residuals = problem.residuals(np.stack(rows))
    if not np.isfinite(residuals).all():
        raise DataError(
            "the fitted model cannot be simulated with the motions that carry a payload",
            hint="Are they of the same robot, and driven the same way?",
        )
    rest = residuals[0]
    mass = (residuals[1] - rest) / small
    moments = (residuals[2:] - residuals[1]) / (small * _ASIDE)
    slopes = np.vstack([mass, moments])  # of m and m (c - center)
    weight = noise_of(problem, rest).weight
    prior = weight * np.diag([_MASS**-2.0, *([_MOMENT**-2.0] * 3)])
    found = -np.linalg.solve(slopes @ slopes.T + prior, slopes @ rest)
    mass = parameters["payload_mass"]
    begun, least = float(np.clip(found[0], 0.9 * mass.low, 0.9 * mass.high)), _LITTLE * small
    # Where the step is too long, a payload of another size amid the link may be nearer.
    starts = [(kg, center) for kg in (0.9 * mass.low, 0.5 * mass.low, least, small, 4.0 * small)]
    if abs(begun) > least:  # with less, no place shows
        starts.append((begun, center + np.clip(found[1:] / begun, -0.5 * _FAR, 0.5 * _FAR)))
    named = [dict(zip(CARRIED, (kg, *map(float, place)), strict=False)) for kg, place in starts]
    costs = (problem.residuals(np.stack([parameters.at(own).start for own in named])) ** 2).sum(axis=1)
    return named[int(np.argmin(np.where(np.isfinite(costs), costs, np.inf)))]


def _with_all(
    problem: Problem, z: Float64[np.ndarray, "P"], before: Float64[np.ndarray, "P P"]
) -> tuple[Float64[np.ndarray, "P"], Float64[np.ndarray, "N"], Float64[np.ndarray, "P N"]]:
    """A few steps of Gauss-Newton of all numbers from z; where they end, the residual and its derivatives there."""
    mean, (low, high) = problem.parameters.start, problem.parameters.bounds
    search = Search(problem, SolveSettings(), Stopwatch(), checkpoint=None, on_progress=None)
    problem.restart(z)
    residual = problem.residuals(z[None])[0]
    for _ in range(_ROUNDS):
        jacobian = np.nan_to_num(search.certain_jacobian(z))
        weight = noise_of(problem, residual).weight
        bread = jacobian @ jacobian.T + weight * before
        step = -np.linalg.solve(bread, jacobian @ residual + weight * (before @ (z - mean)))
        tried = np.stack([np.clip(z + share * step, low, high) for share in _SHARES])
        residuals = problem.residuals(tried)
        off = tried - mean
        costs = (residuals**2).sum(axis=1) + weight * np.einsum("ci,ij,cj->c", off, before, off)
        now = float(residual @ residual + weight * (z - mean) @ before @ (z - mean))
        best = int(np.argmin(np.where(np.isfinite(costs), costs, np.inf)))
        if not costs[best] < now:
            break
        z, residual = tried[best], residuals[best]
        if now - costs[best] < _SETTLED * weight:
            break
    return z, residual, jacobian


def _load(nominal: Nominal, parameters: ParameterSet, posterior: Posterior, rms: float) -> Load:
    values = parameters.values(posterior.z)
    _, site = nominal.payload_place
    names = [item.name for item in parameters.free]
    rows = [names.index(name) for name in CARRIED[:4]]
    scale = np.array([parameters[name].scale for name in CARRIED[:4]])
    covariance = posterior.covariance[np.ix_(rows, rows)] * np.outer(scale, scale)
    center = np.array(site) + [values[name] for name in CARRIED[1:4]]
    return Load(nominal, parameters, posterior, values["payload_mass"], center, covariance, rms)


def within(config: IdentifyConfig, budget_s: float) -> IdentifyConfig:
    """The same that looks at no more motion than this [s]."""
    data: DataChoice = replace(config.data, budget_s=min(config.data.budget_s, budget_s))
    return replace(config, data=data)
