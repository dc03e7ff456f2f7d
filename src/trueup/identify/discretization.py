"""What a simulation adds of its own: its time step, and what it takes the command to do between two stamps."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from trueup.identify.problem import Problem
from trueup.identify.uncertainty import noise_of, precision_of
from trueup.robots import CommandTiming, RobotSpec

# The time step is compared with a quarter of it; once it is a quarter, with half of that.
_QUARTER = 4
# Twice the difference of logarithmic likelihoods above which data have decided between two ways.
DECIDED = 10.0
# A number that a quarter of the time step moves by more than this many of its standard deviations is worth it.
_MATTERS = 0.5
# Of a change that is extrapolated to a time step of zero, this share is unknown.
_UNSURE = 0.25
# Steps towards the minimum of another way, at most. Where the data do not ask for more, a step goes about this far, in
# z, and one that leads upwards is tried again with a share of it: along numbers that make up for each other,
# derivatives hold next to where they were taken only.
_CHORDS, _REACH, _SHORTER = 10, 0.1, 0.3
# Steps that lower twice the logarithmic likelihood by less than this are the last.
_SETTLED = 0.5
# Linearized changes further than this, in z, are only known to be large.
_LINEAR = 1.0


@dataclass(frozen=True)
class Discretization:
    """One way to simulate logs.

    Attributes:
        divisor: of the model's time step.
        command: `held` from stamp to stamp, or `linear` between them.
    """

    divisor: int = 1
    command: CommandTiming = "held"

    def of(self, robot: RobotSpec, timestep_s: float) -> RobotSpec:
        """The robot simulated this way; `timestep_s` is the time step that is divided [s]."""
        simulation = robot.simulation
        if self.divisor > 1:
            simulation = replace(simulation, timestep_s=timestep_s / self.divisor)
        return replace(robot, simulation=simulation, replay=replace(robot.replay, command=self.command))


@dataclass(frozen=True, eq=False)
class Alternative:
    """What a fit would find if the logs were simulated in another way, linearized about the present fit.

    Attributes:
        way: the other way.
        shift: change of the estimate, (P,), in z.
        gain: by how much it explains the data better: twice the difference of logarithmic likelihoods, each sample
            counted as often as the better residual's memory allows; negative where it is worse.
    """

    way: Discretization
    shift: Float64[np.ndarray, "P"]
    gain: float

    def matters(self, now: Discretization, std: Float64[np.ndarray, "P"]) -> bool:
        """Whether a finer step moves a number by more than half of its standard deviation, and data do not object.

        Args:
            now: the present way.
            std: standard deviations of the parameters, (P,), in z.
        """
        moved = np.max(np.abs(self.shift) / np.maximum(std, 1e-12), initial=0.0)
        return bool(now.divisor == 1 and self._possible and moved > _MATTERS)

    def to_step_zero(self, now: Discretization) -> Float64[np.ndarray, "P"] | float:
        """How the estimate would change from the present step to one of zero, in z (Richardson's extrapolation).

        The error of a step h is taken as proportional to h, so that of a change d from h to h / k there is d k / (k -
        1) in all. Nothing at the model's own step, and where the data prefer the present one.
        """
        if now.divisor == 1 or not self._possible:
            return 0.0
        ratio = self.way.divisor / now.divisor
        return np.asarray(self.shift * ratio / (ratio - 1.0))

    def unknown(self, now: Discretization) -> Float64[np.ndarray, "P"] | float:
        """What is not known of the change by the time step, in z: a quarter of what was extrapolated, or all of it."""
        if not self._possible:
            return 0.0
        return _UNSURE * self.to_step_zero(now) if now.divisor > 1 else self.shift

    @property
    def _possible(self) -> bool:
        return self.gain > -DECIDED


def probability(gain: float) -> float:
    """Of one way against another as likely before, by twice the difference of their logarithmic likelihoods."""
    return float(1.0 / (1.0 + np.exp(-0.5 * np.clip(gain, -200.0, 200.0))))


def alternative(
    problem: Problem,
    z: Float64[np.ndarray, "P"],
    residual: Float64[np.ndarray, "N"],
    jacobian: Float64[np.ndarray, "P N"],
    other: Problem,
    way: Discretization,
) -> Alternative | None:
    """Compare the present way with another one by a few simulations.

    With r the residual at z, J the derivatives of the present way and L the precision of the prior, the minimum of
    |r + J^T d|^2 + w |z + d - mean|_L^2 is at d = -(J J^T + w L)^-1 (J r + w L (z - mean)). One such step says how far
    the present fit is from its own minimum; several, each from the residual of the other way where the last has led,
    go to that of the other, since both have nearly the same derivatives (a chord method). These are damped as by a
    prior of standard deviation 0.1 around where they begin, a narrower one where that leads upwards (Levenberg's
    method), so that they follow a curved valley of numbers that make up for each other instead of leaving it.

    Args:
        problem: the fit as it is simulated now.
        z: best parameters, (P,).
        residual: at z, (N,).
        jacobian: at z, (P, N).
        other: the same fit simulated the other way.
        way: what that is.

    Returns:
        None where the other simulation fails or has other samples.
    """
    mean, _ = problem.parameters.prior
    low, high = problem.parameters.bounds
    precision = precision_of(problem.parameters)
    weight = noise_of(problem, residual).weight
    normal = jacobian @ jacobian.T + weight * precision

    def step(
        place: Float64[np.ndarray, "P"], own: Float64[np.ndarray, "N"], reach: float = np.inf
    ) -> Float64[np.ndarray, "P"]:
        inverse = np.linalg.pinv(normal + weight / reach**2 * np.eye(z.size), hermitian=True)
        move = -inverse @ (jacobian @ own + weight * precision @ (place - mean))
        # Shortened as a whole: numbers that make up for each other go together.
        move *= min(1.0, _LINEAR / max(float(np.abs(move).max()), 1e-300))
        return np.asarray(np.clip(place + move, low, high) - place)

    def cost(place: Float64[np.ndarray, "P"], own: Float64[np.ndarray, "N"]) -> float:
        return float(own @ own + weight * (place - mean) @ precision @ (place - mean))

    found = other.residuals(z[None])[0]
    if found.shape != residual.shape or not np.isfinite(found).all():
        return None
    first = step(z, residual)
    best, left, reach = z, found, _REACH
    for _ in range(_CHORDS):
        place = best + step(best, left, reach)
        tried = other.residuals(place[None])[0]
        gained = cost(best, left) - cost(place, tried)
        if not gained > 0.0:  # NaN where the simulation fails
            reach *= _SHORTER
            continue
        best, left = place, tried
        if gained < _SETTLED * weight:
            break
    present = cost(z + first, residual + first @ jacobian)
    there = cost(best, left)
    least = noise_of(problem, left if there < present else residual).weight
    return Alternative(way, best - z - first, float((present - there) / max(least, 1e-300)))


def finer(now: Discretization) -> Discretization:
    """What a way is compared with, to tell what its time step does."""
    return replace(now, divisor=_QUARTER if now.divisor == 1 else 2 * now.divisor)


def in_words(way: Discretization, before: Discretization, timestep_s: float) -> tuple[str, ...]:
    """What was changed, for people; `timestep_s` is that of the model as it came [s]."""
    said = []
    if way.divisor != before.divisor:
        said.append(
            f"fitted with a time step of {1e3 * timestep_s / way.divisor:.3g} ms instead of {1e3 * timestep_s:.3g} ms, "
            "at which numbers would change by more than their intervals; robot.fitted.yaml says so"
        )
    if way.command != before.command:
        what = "moves on between its stamps" if way.command == "linear" else "is held between its stamps"
        said.append(
            f"the command {what}: this explains the logs better (replay: {{command: {way.command}}} in "
            "robot.fitted.yaml)"
        )
    return tuple(said)
