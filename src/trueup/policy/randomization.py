"""What differs from episode to episode: numbers drawn around a model, or from what an identification leaves open.

Each `Draw` changes a candidate of the model, which is compiled when all have; inertias stay such as bodies can have.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float64

from trueup.core.atomic import read_json
from trueup.core.fit_result import FitResult
from trueup.core.npz import read_arrays
from trueup.errors import ConfigError, DataError, NameMismatch
from trueup.identify.candidate import Candidate, Nominal
from trueup.identify.export import SAMPLES_FILE
from trueup.identify.quantities import QUANTITIES, quantity
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
        nominal = candidate.nominal
        for joint in gain.holders(nominal):
            said = gain.read(nominal, joint)
            assert said is not None
            gain.write(candidate, joint, said * _factor(rng, share))

    return draw


def delay(low_s: float, high_s: float) -> Draw:
    """Torques act later, all joints alike [s]."""

    def draw(candidate: Candidate, rng: np.random.Generator) -> None:
        later = float(rng.uniform(low_s, high_s))
        candidate.delay_s = dict.fromkeys(candidate.delay_s, later)

    return draw


def payload(low_kg: float, high_kg: float) -> Draw:
    """The robot carries something [kg]."""

    def draw(candidate: Candidate, rng: np.random.Generator) -> None:
        candidate.payload["mass"] = float(rng.uniform(low_kg, high_kg))

    return draw


def posterior(samples: Mapping[str, Float64[np.ndarray, "S"]]) -> Draw:
    """All numbers of an identification together, as it has drawn them: what it does not know, with its correlations.

    Args:
        samples: parameter -> its values, of the same draws.

    Raises:
        NameMismatch: a parameter is none.
    """
    names = [name for name in samples if quantity(name.partition("[")[0]).of != "motion"]
    count = min((len(samples[name]) for name in names), default=0)

    def draw(candidate: Candidate, rng: np.random.Generator) -> None:
        row = int(rng.integers(count))
        for name in names:
            about, target = quantity(name.partition("[")[0]), name.partition("[")[2].removesuffix("]")
            for place in about.places(candidate.nominal, target):
                about.write(candidate, place, float(samples[name][row]))

    if count == 0:
        raise ConfigError("the posterior has no samples to draw from")
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

    def draws(
        self, nominal: Nominal | None = None, *, control_s: float = np.inf, force: bool = False
    ) -> tuple[Draw, ...]:
        """The functions, in their order.

        Args:
            nominal: the model that they change; what an identification has numbers of is looked for in it.
            control_s: control step, which no delay may exceed [s].
            force: also draw from an identification whose status is not ok.

        Raises:
            ConfigError: the identification is not ok, and nobody forces it, or a delay is too long.
            DataError: it has no samples.
            NameMismatch: it is of a robot with other joints or bodies.
        """
        found: list[Draw] = []
        latest_s = self.delay_s[1]
        if self.posterior:
            samples = posterior_samples(Path(self.posterior), force=force)
            if not latest_s:
                late = (values for name, values in samples.items() if name.partition("[")[0] == "delay_s")
                latest_s = max((float(values.max()) for values in late), default=0.0)
            if nominal is not None:
                _refuse_another_robot(samples, nominal, self.posterior)
            found.append(posterior(samples))
        # Drawn one day, it would end a training in the middle.
        if latest_s > control_s:
            raise ConfigError(
                "randomization: torques may be late by a control step at most",
                got=f"{latest_s:g} s",
                expected=f"at most {control_s:g} s",
            )
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


def posterior_samples(folder: Path, *, force: bool = False) -> dict[str, Float64[np.ndarray, "S"]]:
    """What an identification left open, as draws.

    Args:
        folder: where `fit.json` and `fit.samples.npz` are.
        force: also those of a fit whose status is not ok.

    Raises:
        ConfigError: the fit is not ok.
        DataError: the samples are not there, or are none.
    """
    fit = FitResult.from_json(read_json(folder / "fit.json"), str(folder / "fit.json"))
    if fit.status != "ok" and not force:
        said = fit.statements[0] if fit.statements else "see its report"
        raise ConfigError(
            f"{folder}: the identification is {fit.status}: {said}",
            expected="status ok",
            hint="Record what it asks for, or force it if you accept what it says.",
        )
    path = folder / SAMPLES_FILE
    if not path.is_file():
        raise DataError(f"{path} is not there", hint="Run trueup identify again; it writes them beside fit.json.")
    try:
        samples = {name: np.asarray(values, np.float64) for name, values in read_arrays(path).items()}
    except (DataError, ValueError) as error:
        raise DataError(f"{path} holds no samples", got=error) from error
    strangers = [name for name in samples if name.partition("[")[0] not in QUANTITIES]
    if strangers:
        raise NameMismatch(f"{path}: unknown parameters", left=strangers, right=sorted(QUANTITIES))
    if any(values.ndim != 1 or not np.isfinite(values).all() for values in samples.values()):
        raise DataError(f"{path}: samples that are not finite numbers")
    for item in fit.parameters:
        drawn = samples.get(item.name)
        if drawn is not None and not (
            drawn.min(initial=item.low) >= item.low and drawn.max(initial=item.high) <= item.high
        ):
            raise DataError(
                f"{path}: samples of {item.name} outside its bounds",
                got=f"{drawn.min():g} to {drawn.max():g}",
                expected=f"{item.low:g} to {item.high:g}, as fit.json says",
            )
    if len({len(values) for values in samples.values()}) > 1:
        raise DataError(f"{path}: parameters with different numbers of samples")
    return samples


def _refuse_another_robot(samples: Mapping[str, Float64[np.ndarray, "S"]], nominal: Nominal, folder: str) -> None:
    """Refuse, by NameMismatch, numbers of joints and bodies that the model does not have."""
    for name in samples:
        about, target = quantity(name.partition("[")[0]), name.partition("[")[2].removesuffix("]")
        known = about.targets(nominal)
        if about.of != "motion" and target and target not in known:
            raise NameMismatch(
                f"{folder} is the identification of another robot: {name}",
                left=[target],
                right=list(known),
                left_name="it has",
                right_name="robot has",
            )


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
        return candidate.compile(), candidate.delays


def _factor(rng: np.random.Generator, share: float) -> float:
    return float(rng.uniform(1.0 - share, 1.0 + share))
