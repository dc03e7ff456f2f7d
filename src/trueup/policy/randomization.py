"""What differs from episode to episode: numbers drawn around a model, or from what an identification leaves open.

Each `Draw` changes a candidate of the model, which is compiled when all have; inertias stay such as bodies can have.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float64

from trueup.errors import ConfigError
from trueup.identify.candidate import Candidate, Nominal
from trueup.identify.quantities import quantity
from trueup.identify.quantities.servo import spec_actuators
from trueup.policy.posterior import Posterior
from trueup.robots.friction import LAWS
from trueup.sim import friction_of, set_friction

# Drawn inertias that no body can have are drawn again, as the ES thesis does (3.2.1, step 3).
_TRIES = 100


Draw = Callable[[Candidate, np.random.Generator], None]


def friction(share: float) -> Draw:
    """Every number of every joint's friction times 1 - share to 1 + share, each by itself (ES thesis, 4.1.1)."""

    def draw(candidate: Candidate, rng: np.random.Generator) -> None:
        for name in candidate.nominal.robot.joint_names:
            joint = candidate.spec.joint(name)
            joint.damping[0] *= _factor(rng, share)
            joint.frictionloss *= _factor(rng, share)
            laws = friction_of(candidate.spec, name)
            # A law is on if its first number is not zero.
            on = [law for law in LAWS.values() if getattr(laws, law.numbers[0].name)]
            if on:
                moved = {
                    number.name: getattr(laws, number.name) * _factor(rng, share)
                    for law in on
                    for number in law.numbers
                }
                set_friction(candidate.spec, name, replace(laws, **moved))

    return draw


def inertia(share: float) -> Draw:
    """The six numbers of each moving body's inertia times 1 - share to 1 + share, each by itself (ES thesis, 4.1.1)."""

    def draw(candidate: Candidate, rng: np.random.Generator) -> None:
        for body in candidate.nominal.bodies:
            own = candidate.inertial(body)
            for _ in range(_TRIES):
                factor = np.triu(1.0 + share * rng.uniform(-1, 1, (3, 3)))
                found = replace(own, inertia=own.inertia * (factor + np.triu(factor, 1).T))
                if np.linalg.eigvalsh(found.second_moment).min() >= 0:
                    candidate.inertials[body] = found
                    break

    return draw


def gains(share: float) -> Draw:
    """Torque per commanded torque of every joint times 1 - share to 1 + share."""
    gain = quantity("torque_gain")

    def draw(candidate: Candidate, rng: np.random.Generator) -> None:
        for joint in gain.holders(candidate.nominal):
            # Whatever a posterior has written there.
            spec_actuators(candidate, joint)[0].gainprm[0] *= _factor(rng, share)

    return draw


def delay(low_s: float, high_s: float) -> Draw:
    """Torques act later, all joints alike [s]."""

    def draw(candidate: Candidate, rng: np.random.Generator) -> None:
        later = float(rng.uniform(low_s, high_s))
        candidate.delay_s = dict.fromkeys(candidate.delay_s, later)

    return draw


def payload(low_kg: float, high_kg: float) -> Draw:
    """The robot carries something [kg], of which its compensation of gravity knows nothing."""

    def draw(candidate: Candidate, rng: np.random.Generator) -> None:
        candidate.payload["mass"] = float(rng.uniform(low_kg, high_kg))

    return draw


@dataclass(frozen=True)
class RandomizationConfig:
    """What is drawn anew for each episode; nothing by default.

    Attributes:
        friction: relative half-width of every number of the friction; 0.1 in the ES thesis (4.1.1).
        inertia: of every number of the inertias; 0.05 in the ES thesis.
        gains: of the torque that joints give for a commanded one.
        delay_s: least and largest delay of torques [s].
        payload_kg: least and largest payload [kg].
        posterior: folder of an identification (`fit.json`, `fit.samples.npz`), from which all its numbers are drawn
            together; it comes before the others.
        noise_rad: standard deviation of what is seen of positions [rad].
        noise_rad_s: and of velocities [rad/s].

    Raises:
        ConfigError: a width that is none.
    """

    friction: float = 0.0
    inertia: float = 0.0
    gains: float = 0.0
    delay_s: tuple[float, float] = (0.0, 0.0)
    payload_kg: tuple[float, float] = (0.0, 0.0)
    posterior: str = ""
    noise_rad: float = 0.0
    noise_rad_s: float = 0.0

    def __post_init__(self) -> None:
        """Refuse widths that are none."""
        for entry in fields(self):
            value = getattr(self, entry.name)
            if isinstance(value, tuple):
                if not 0 <= value[0] <= value[1] < np.inf:
                    raise ConfigError(f"randomization: {entry.name}", got=value, expected="0 <= least <= largest")
            elif not isinstance(value, str) and not 0 <= value < np.inf:
                raise ConfigError(f"randomization: {entry.name}", got=value, expected=">= 0")
        for name in ("friction", "inertia", "gains"):
            if getattr(self, name) >= 1:
                raise ConfigError(f"randomization: {name} is a share", got=getattr(self, name), expected="below 1")

    def draws(self, nominal: Nominal | None = None, *, force: bool = False) -> tuple[Draw, ...]:
        """The functions, in their order.

        Args:
            nominal: the model that they change; what an identification has numbers of is looked for in it.
            force: also draw from an identification whose status is not ok.

        Raises:
            ConfigError: the identification is not ok, and nobody forces it, or that of another fitted model.
            DataError: it has no samples.
            NameMismatch: it is of a robot with other joints or bodies.
        """
        found: list[Draw] = []
        if self.posterior:
            posterior = Posterior.load(Path(self.posterior), force=force)
            if nominal is not None:
                posterior.check(nominal)
            found.append(posterior)
        for name, make in (("friction", friction), ("inertia", inertia), ("gains", gains)):
            if share := getattr(self, name):
                found.append(make(share))
        if self.delay_s[1]:
            found.append(delay(*self.delay_s))
        if self.payload_kg[1]:
            found.append(payload(*self.payload_kg))
        return tuple(found)


# ES thesis, 4.1.1.
THESIS = RandomizationConfig(friction=0.1, inertia=0.05)


@dataclass(frozen=True, eq=False)
class Individuals:
    """Robots drawn around a model, one after the other.

    Attributes:
        nominal: the model.
        draws: what is drawn, one after the other.
    """

    nominal: Nominal
    draws: Sequence[Draw] = ()

    def __call__(self, rng: np.random.Generator) -> tuple[mujoco.MjModel, Float64[np.ndarray, "J"]]:
        """A compiled model, with all that MuJoCo derives from its numbers, and how much later torques act [s].

        Raises:
            ConfigError: what was drawn makes no model.
        """
        candidate = self.nominal.candidate()
        for draw in self.draws:
            draw(candidate, rng)
        # A negative delay is one of a log's stamps: in a loop, nothing acts before it is commanded.
        return candidate.compile(), np.maximum(candidate.delays, 0.0)


def _factor(rng: np.random.Generator, share: float) -> float:
    return float(rng.uniform(1.0 - share, 1.0 + share))
