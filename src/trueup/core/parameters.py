"""What a fit may change: named numbers with unit, bounds, transform and prior."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Float64

from trueup.errors import ConfigError, NameMismatch


def split_name(name: str) -> tuple[str, str]:
    """`damping[elbow]` -> quantity and target; the target is empty for what the robot has once."""
    about, _, target = name.partition("[")
    return about, target.removesuffix("]")


# By how much a bound that is hit moves at most, of what is positive by nature.
_WIDER = 30.0


@dataclass(frozen=True)
class SearchRange:
    """Where and how far a kind of number is looked for, if nobody says.

    Attributes:
        transform: `log` for what is positive by nature.
        start: where the fit starts if the model says less, `log` only: next to zero there is no way up.
        low: smallest lower bound; lower only if the model's value is.
        high: largest upper bound; higher only if the model's value is.
        span: bounds reach from start / span to start * span, `log` only.
        scale: what counts as a large change, `linear` only.
        prior_std: width of the default prior, in z.
    """

    transform: Literal["linear", "log"] = "linear"
    start: float = 0.0
    low: float = 1e-9
    high: float = 1e9
    span: float = 100.0
    scale: float = 1.0
    prior_std: float = 2.0


@dataclass(frozen=True)
class Parameter:
    """One number that a fit may change.

    Solvers see z, not the value: z = log(value) for transform `log`, z = value / scale for `linear`, so that a step
    of 1 is a large one for every parameter.

    Attributes:
        name: `QUANTITY[TARGET]`, e.g. `damping[joint1]`.
        value: where the fit starts; of a frozen parameter, what it is kept at.
        unit: of value and bounds.
        low: lower bound, inclusive.
        high: upper bound, inclusive.
        transform: `log` for what is positive by nature, `linear` otherwise.
        scale: what counts as a large change, `linear` only [unit].
        prior_std: standard deviation of the prior around `prior_mean`, in z; None for no prior. 1.0 on a `log`
            parameter says: within a factor of e, most likely.
        prior_mean: centre of the prior [unit]; the start if None.
        frozen: kept at `value`.
        nominal: what the model says, outside the bounds and 0 on a `log` scale too; None if it has no such number.

    Raises:
        ConfigError: bounds contradict each other, the transform, or the start.
    """

    name: str
    value: float
    unit: str
    low: float
    high: float
    transform: Literal["linear", "log"] = "linear"
    scale: float = 1.0
    prior_std: float | None = None
    prior_mean: float | None = None
    frozen: bool = False
    nominal: float | None = None

    def __post_init__(self) -> None:
        """Refuse what no solver could work with."""
        if not all(np.isfinite(number) for number in (self.value, self.low, self.high, self.scale)):
            raise ConfigError(f"parameter {self.name!r} has numbers that are not finite", got=asdict(self))
        if self.low >= self.high and not self.frozen:
            raise ConfigError(
                f"parameter {self.name!r}: the bounds contradict each other",
                got=f"low {self.low:g}, high {self.high:g} {self.unit}",
                expected="low < high",
                hint="To keep a parameter at its value, set frozen: true.",
            )
        if self.transform == "log" and not self.frozen and (self.low <= 0 or self.value <= 0):
            raise ConfigError(
                f"parameter {self.name!r} is positive by nature",
                got=f"value {self.value:g}, low {self.low:g} {self.unit}",
                expected="both above zero",
            )
        if not self.frozen and not self.low <= self.value <= self.high:
            raise ConfigError(
                f"parameter {self.name!r} starts outside its bounds",
                got=f"{self.value:g} {self.unit}",
                expected=f"{self.low:g} to {self.high:g}",
            )
        if self.scale <= 0 or (self.prior_std is not None and self.prior_std <= 0):
            raise ConfigError(f"parameter {self.name!r}: scale and prior_std must be positive", got=asdict(self))

    @property
    def quantity(self) -> str:
        """The part of the name before the bracket."""
        return split_name(self.name)[0]

    @property
    def target(self) -> str:
        """The part of the name in brackets: a joint, a body, or empty."""
        return split_name(self.name)[1]

    @property
    def untouched(self) -> bool:
        """Whether the model keeps its own number."""
        return self.frozen and self.value == self.nominal

    def to_z(self, value: float) -> float:
        """The value as solvers see it."""
        return float(np.log(value)) if self.transform == "log" else value / self.scale

    def from_z(self, z: float) -> float:
        """The value of a solver's number, kept inside the bounds in spite of rounding."""
        value = float(np.exp(z)) if self.transform == "log" else z * self.scale
        return min(max(value, self.low), self.high) if not self.frozen else self.value

    def to_json(self) -> dict[str, Any]:
        """A dictionary that `Parameter(**d)` reads back."""
        return asdict(self)


@dataclass(frozen=True)
class ParameterSet:
    """Parameters in a fixed order; solvers see the P that are not frozen.

    Raises:
        NameMismatch: a name occurs twice.
    """

    parameters: tuple[Parameter, ...]

    def __post_init__(self) -> None:
        """Refuse names that stand twice."""
        names = [parameter.name for parameter in self.parameters]
        if len(set(names)) != len(names):
            raise NameMismatch("a parameter occurs twice", left=names, right=sorted(set(names)))

    def __iter__(self) -> Iterator[Parameter]:
        """All parameters, frozen ones too."""
        return iter(self.parameters)

    def __len__(self) -> int:
        """How many there are, frozen ones too."""
        return len(self.parameters)

    def __getitem__(self, name: str) -> Parameter:
        """The parameter of that name.

        Raises:
            NameMismatch: there is none.
        """
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise NameMismatch(f"there is no parameter {name!r}", left=[name], right=self.names)

    @property
    def names(self) -> tuple[str, ...]:
        """All names."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The P parameters that a solver may change."""
        return tuple(parameter for parameter in self.parameters if not parameter.frozen)

    @property
    def start(self) -> Float64[np.ndarray, "P"]:
        """Where the solver starts, in z."""
        return np.array([parameter.to_z(parameter.value) for parameter in self.free])

    @property
    def bounds(self) -> tuple[Float64[np.ndarray, "P"], Float64[np.ndarray, "P"]]:
        """Lower and upper bounds in z."""
        low = np.array([parameter.to_z(parameter.low) for parameter in self.free])
        return low, np.array([parameter.to_z(parameter.high) for parameter in self.free])

    @property
    def prior(self) -> tuple[Float64[np.ndarray, "P"], Float64[np.ndarray, "P"]]:
        """Mean and standard deviation of the prior in z; infinite where there is none."""
        mean = [
            parameter.to_z(parameter.value if parameter.prior_mean is None else parameter.prior_mean)
            for parameter in self.free
        ]
        std = [np.inf if parameter.prior_std is None else parameter.prior_std for parameter in self.free]
        return np.array(mean), np.array(std)

    def values(self, z: Float64[np.ndarray, "P"]) -> dict[str, float]:
        """Name -> value for a solver's vector, frozen parameters included."""
        found = dict(zip((parameter.name for parameter in self.free), map(float, z), strict=True))
        return {
            parameter.name: parameter.value if parameter.frozen else parameter.from_z(found[parameter.name])
            for parameter in self.parameters
        }

    def at(self, values: Mapping[str, float]) -> ParameterSet:
        """The same parameters started from other values; those that are not named keep theirs.

        A value outside the bounds is moved onto them. The prior stays where it was.
        """
        moved = []
        for parameter in self.parameters:
            if parameter.name not in values or parameter.frozen:
                moved.append(parameter)
                continue
            value = min(max(values[parameter.name], parameter.low), parameter.high)
            mean = parameter.value if parameter.prior_mean is None else parameter.prior_mean
            moved.append(replace(parameter, value=value, prior_mean=mean))
        return ParameterSet(tuple(moved))

    def within(self, bounds: Mapping[str, tuple[float, float]]) -> ParameterSet:
        """The same parameters with other bounds; those that are not named keep theirs, and so do frozen ones."""
        return ParameterSet(
            tuple(
                replace(item, low=bounds[item.name][0], high=bounds[item.name][1])
                if item.name in bounds and not item.frozen
                else item
                for item in self
            )
        )

    def freeze(self, names: Iterable[str]) -> ParameterSet:
        """The same parameters with the free ones among these left as the model has them.

        What the model does not have at all is left out. Those that were frozen before keep their value.
        """
        chosen = set(names)
        left = (_as_the_model(parameter) if parameter.name in chosen else parameter for parameter in self)
        return ParameterSet(tuple(parameter for parameter in left if parameter is not None))

    def hold(self, names: Iterable[str]) -> ParameterSet:
        """The same parameters with these kept at their value."""
        chosen = set(names)
        return ParameterSet(
            tuple(replace(parameter, frozen=True) if parameter.name in chosen else parameter for parameter in self)
        )


def widened(parameter: Parameter, bound: str) -> tuple[float, float]:
    """Bounds with room beyond the `low` or the `high` one: half of their distance, in z, or a factor of 30 at most."""
    low, high = parameter.to_z(parameter.low), parameter.to_z(parameter.high)
    reach = 0.5 * (high - low)
    if parameter.transform == "log":
        factor = float(np.exp(min(reach, np.log(_WIDER))))
        return (parameter.low / factor, parameter.high) if bound == "low" else (parameter.low, parameter.high * factor)
    change = reach * parameter.scale
    return (parameter.low - change, parameter.high) if bound == "low" else (parameter.low, parameter.high + change)


def _as_the_model(parameter: Parameter) -> Parameter | None:
    if parameter.frozen:
        return parameter
    return None if parameter.nominal is None else replace(parameter, value=parameter.nominal, frozen=True)
