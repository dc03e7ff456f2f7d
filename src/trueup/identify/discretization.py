"""What a simulation adds of its own: time step, dry friction's rigidity, and the command between two stamps."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from trueup.identify.problem import Problem
from trueup.identify.uncertainty import noise_of, precision_of
from trueup.robots import CommandTiming, RobotSpec

# A time step is halved down to this part of the model's.
_LAST = 8
# MuJoCo's own damping comes near the trapezoidal rule in this part of the step.
_PLAIN = 4
# Twice the difference of logarithmic likelihoods above which data have decided between two ways.
DECIDED = 10.0
# A number that another damping moves by more than so many of its standard deviations is worth it; a step of zero, by so
# many.
_MATTERS, _WIDENS = 0.5, 1.0

# Parameters in z, and the residual there, where a fit that is simulated in some way has its minimum.
Minimum = tuple[Float64[np.ndarray, "P"], Float64[np.ndarray, "N"]]


@dataclass(frozen=True)
class Discretization:
    """One way to simulate logs.

    Attributes:
        divisor: of the model's time step.
        trapezoidal: whether damping follows the trapezoidal rule, whose error is of the second order of the step, or is
            as MuJoCo takes it, of the first. A model's own step is simulated as the model has it.
        command: `held` from stamp to stamp, or `linear` or `smooth` between them.
        rigid: whether dry friction holds a joint as if it were rigid, or as softly as the model's constraint solver
            has it, which lets it creep.
    """

    divisor: int = 1
    command: CommandTiming = "held"
    rigid: bool = True
    trapezoidal: bool = False

    @property
    def plain(self) -> Discretization:
        """As a fitted model is simulated outside of the fit: with a step at which MuJoCo's own damping is near."""
        return replace(self, divisor=_PLAIN * self.divisor, trapezoidal=False) if self.trapezoidal else self

    @property
    def retimed(self) -> Discretization:
        """The same with a command that moves on where it is held now, and the other way round."""
        return replace(self, command="linear" if self.command == "held" else "held")

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
        lowers: share of the sum of squares that it takes away; negative where it is worse.
        candidate_s: time that one simulation of all logs took that way [s].
    """

    way: Discretization
    shift: Float64[np.ndarray, "P"]
    gain: float
    lowers: float = 0.0
    candidate_s: float = 0.0

    def matters(self, now: Discretization, std: Float64[np.ndarray, "P"]) -> bool:
        """Whether what is of higher order, or finer, is worth its time: it moves a number, and data do not object.

        By more than half of its standard deviation where a model is simulated as it came. Then, what is left to a step
        of zero is in the intervals: by more than one, and data have to ask for it.

        Args:
            now: the present way.
            std: standard deviations of the parameters, (P,), in z.
        """
        moved = np.max(np.abs(self.shift) / np.maximum(std, 1e-12), initial=0.0)
        if not now.trapezoidal:
            return bool(self._possible and moved > _MATTERS)
        return bool(self.gain > DECIDED and moved > _WIDENS and self.way.divisor <= _LAST)

    def unknown(self, now: Discretization) -> Float64[np.ndarray, "P"] | float:
        """One standard deviation of what is not known of the change by the time step, in z.

        That is all of it: a robot has none, even where a finer step explains the logs a little worse, since what else
        the model lacks decides that. As the model came, the logs may be those of its simulation, if they ask for it.
        """
        return self.shift if now.trapezoidal or self._possible else 0.0

    @property
    def _possible(self) -> bool:
        return self.gain > -DECIDED


def probability(gain: float) -> float:
    """Of one way against another as likely before, by twice the difference of their logarithmic likelihoods."""
    return float(1.0 / (1.0 + np.exp(-0.5 * np.clip(gain, -200.0, 200.0))))


def alternative(
    now: Problem,
    other: Problem,
    here: Minimum,
    there: Minimum,
    weight: float,
    way: Discretization,
) -> Alternative:
    """Compare the present way with another one, each at its own minimum.

    Args:
        now: the fit as it is simulated now.
        other: the same fit simulated the other way.
        here: parameters and residual at the minimum of `now`, as `Search.polished` has them.
        there: likewise of `other`.
        weight: of the prior, the variance of one observation.
        way: the other way.
    """
    mean, _ = now.parameters.prior
    precision = precision_of(now.parameters)
    noise = noise_of(now, here[1]).weight, noise_of(other, there[1]).weight
    present, instead = (
        float(own @ own + weight * (place - mean) @ precision @ (place - mean)) for place, own in (here, there)
    )
    least = noise[1] if instead < present else noise[0]
    lowers = 1.0 - instead / max(present, 1e-300)
    candidate_s = other.seconds / max(1, other.evaluations)
    return Alternative(way, there[0] - here[0], (present - instead) / max(least, 1e-300), lowers, candidate_s)


def extrapolated(
    now: Problem,
    coarse: Problem,
    here: Minimum,
    there: Minimum,
    way: Discretization,
) -> Alternative:
    """What a step of zero would find, told from a larger one, which takes a fraction of the time.

    The error of a step h is proportional to h^2 (`damp_by_trapezoid`), in numbers z as in residuals r: what they change
    by from a step H to h they change by h^2 / (H^2 - h^2) times as much from h to zero. Numbers follow this well. A
    part of the residual jumps from step to step, and its square would count as if it grew: so the gain is that of the
    first order, with the noise of one observation w, -2 r . dr / w.

    Args:
        now: the fit as it is simulated now.
        coarse: the same fit with the larger step.
        here: parameters and residual at the minimum of `now`, as `Search.polished` has them.
        there: likewise of `coarse`.
        way: the present way.
    """
    larger, half = coarser(way), finer(way)
    share = 1.0 / ((way.divisor / larger.divisor) ** 2 - 1.0)
    shift, change = (share * (own - other) for own, other in zip(here, there, strict=True))
    less = -2.0 * float(here[1] @ change)
    candidate_s = coarse.seconds / max(1, coarse.evaluations) * half.divisor / larger.divisor
    return Alternative(
        half,
        np.asarray(shift),
        less / max(noise_of(now, here[1]).weight, 1e-300),
        less / max(float(here[1] @ here[1]), 1e-300),
        candidate_s,
    )


def finer(now: Discretization) -> Discretization:
    """The next one with less error: damping by the trapezoidal rule, then half of the step."""
    return replace(now, divisor=2 * now.divisor) if now.trapezoidal else replace(now, trapezoidal=True)


def coarser(now: Discretization) -> Discretization:
    """The next larger time step."""
    return replace(now, divisor=now.divisor // 2)


def in_words(way: Discretization, before: Discretization, timestep_s: float) -> tuple[str, ...]:
    """What was changed, for people; `timestep_s` is that of the model as it came [s]."""
    said = []
    if way.plain.divisor != before.divisor:
        said.append(
            f"robot.fitted.yaml has a time step of {1e3 * timestep_s / way.plain.divisor:.3g} ms instead of "
            f"{1e3 * timestep_s:.3g} ms, which would change parameters by more than their intervals"
        )
    if way.command != before.command:
        what = {"linear": "is interpolated", "smooth": "is interpolated smoothly", "held": "is held"}[way.command]
        said.append(
            f"the command {what} between its stamps: this fits the logs better (replay: {{command: "
            f"{way.command}}} in robot.fitted.yaml)"
        )
    if not way.rigid:
        said.append(
            "dry friction creeps as the model's solreffriction allows: this fits the logs better than friction that "
            "holds the joint rigidly"
        )
    return tuple(said)
