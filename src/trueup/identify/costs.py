"""What candidates cost, for solvers that see nothing else of the residual."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float64

from trueup.core.parameters import Parameter
from trueup.identify.problem import Problem
from trueup.identify.quantities import quantity, split_motion_target
from trueup.identify.solvers import Evaluation, Roles
from trueup.identify.uncertainty import noise_of

# Far from the data everything looks like noise with a long memory: few observations, and a prior that outweighs
# them. Near the data there are up to a hundred times as many.
_MORE_OBSERVATIONS = 100.0
# Keeps the exponential finite.
_MOST_AWAY = 500.0


class PenalizedSquares:
    """Sum of squares S and prior in one number that does not change as the search goes on: S exp(L / n).

    L is the prior's sum of squares, and n a number of independent observations. Where the noise is unknown, minus
    twice the logarithm of the posterior is n log S + L, so the prior always counts against the residual that is
    left: its weight is S / n, that of one observation (`Noise.weight`), at the start as at the end.

    Args:
        problem: what to simulate.
        observations: n; if None, taken from the first candidate that can be simulated.

    Attributes:
        observations: n, None while no candidate could be simulated.
    """

    def __init__(self, problem: Problem, observations: float | None = None) -> None:
        self._problem = problem
        self.observations = observations

    def __call__(self, z: Float64[np.ndarray, "C P"], residuals: Float64[np.ndarray, "C N"]) -> Evaluation:
        """Candidates to costs."""
        square = np.einsum("cn,cn->c", residuals, residuals)
        finite = np.flatnonzero(np.isfinite(square))
        if self.observations is None and finite.size:
            effective = noise_of(self._problem, residuals[finite[0]]).effective
            self.observations = min(float(self._problem.size), _MORE_OBSERVATIONS * effective)
        mean, std = self._problem.parameters.prior
        away = ((z - mean) ** 2) @ std**-2.0 / (self.observations or 1.0)
        return Evaluation(square * np.exp(np.minimum(away, _MOST_AWAY)))


def joint_errors(problem: Problem) -> Callable[[Float64[np.ndarray, "C P"], Float64[np.ndarray, "C N"]], Evaluation]:
    """Candidates to costs by joint, as the evolution strategy of the ES thesis wants them (3.2.1).

    Its error of a joint is the sum of absolute position differences at regular intervals; the signed one takes the
    differences in the direction of motion, so that it is positive where the simulation lags behind: too much
    friction.
    """
    joints = len(problem.nominal.robot.joint_names)
    directions = [
        np.sign(np.gradient(segment.plan.measured["position"], axis=0))[segment.counts][:, problem.columns]
        for segment in problem.segments
    ]

    def evaluate(z: Float64[np.ndarray, "C P"], residuals: Float64[np.ndarray, "C N"]) -> Evaluation:
        signed, absolute = np.full((2, z.shape[0], joints), np.nan)
        for row in np.flatnonzero(np.isfinite(residuals).all(axis=1)):
            signed[row], absolute[row] = _of_joints(problem, residuals[row], directions)
        return Evaluation(absolute.sum(axis=1), signed, absolute)

    return evaluate


def _of_joints(
    problem: Problem, residual: Float64[np.ndarray, "N"], directions: list[np.ndarray]
) -> tuple[Float64[np.ndarray, "J"], Float64[np.ndarray, "J"]]:
    signed, absolute = np.zeros((2, len(problem.nominal.robot.joint_names)))
    blocks = [values for _, signal, values in problem.by_segment(residual) if signal == "position"]
    for values, direction in zip(blocks, directions, strict=True):
        absolute[problem.columns] += np.abs(values).sum(axis=0)
        signed[problem.columns] -= (values * direction).sum(axis=0)
    return signed, absolute


def roles_of(problem: Problem) -> Roles:
    """Which joint a parameter acts on, and whether it brakes it."""
    free = problem.parameters.free
    effect = [int(quantity(item.quantity).brakes) for item in free]
    return Roles(np.array([_joint_of(problem, item) for item in free]), np.array(effect))


def _joint_of(problem: Problem, parameter: Parameter) -> int:
    """The joint that a parameter belongs to, -1 for what belongs to the whole robot."""
    match quantity(parameter.quantity).of if parameter.target else "":
        case "joint":
            return problem.nominal.robot.joint_names.index(parameter.target)
        case "motion":
            return problem.nominal.robot.joint_names.index(split_motion_target(parameter.target)[1])
        case _:
            return _joint_of_body(problem, parameter.target)


def _joint_of_body(problem: Problem, body: str) -> int:
    """The joint that moves a body, -1 for what belongs to the whole robot."""
    model, joints = problem.nominal.model, problem.nominal.robot.joint_names
    if not body:
        return -1
    index = int(model.body(body).id)
    while index and model.body_jntnum[index] == 0:
        index = int(model.body_parentid[index])
    name = model.joint(int(model.body_jntadr[index])).name if index else ""
    return joints.index(name) if name in joints else -1
