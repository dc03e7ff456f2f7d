"""A grid of trainings: which numbers of a configuration are tried with which values, and the points that this makes."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

from trueup.core.atomic import as_read_back, json_hash
from trueup.core.config import build
from trueup.errors import ConfigError
from trueup.policy.config import Algorithm, LearnerConfig, PolicyConfig

_LEARNER = tuple(item.name for item in fields(LearnerConfig))
_COUNTS = ("arms", "steps", "rounds")
NAMES = (*(f"learner.{name}" for name in _LEARNER), *_COUNTS, "seed")
# Trainings that anybody waits for; a typing error makes more.
_LARGEST = 10_000


@dataclass(frozen=True)
class Axis:
    """What changes together from point to point.

    Attributes:
        names: of numbers, from `NAMES`.
        rows: what they are, together, at each step of the axis; JSON values.
    """

    names: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]

    @property
    def title(self) -> str:
        """The names on one line."""
        return ", ".join(self.names)


@dataclass(frozen=True)
class Point:
    """One training of a grid.

    Attributes:
        values: name -> value, of all axes; JSON values.
        config: what is trained.
        seed: of all its draws.
    """

    values: Mapping[str, Any]
    config: PolicyConfig
    seed: int

    @property
    def id(self) -> str:
        """Name that depends on the values alone: 12 hexadecimal digits."""
        return json_hash(dict(self.values))[:12]


@dataclass(frozen=True)
class Grid:
    """Every step of every axis with every step of the others.

    Attributes:
        axes: in the order in which points are counted, the last one fastest.
    """

    axes: tuple[Axis, ...]

    def __len__(self) -> int:
        return math.prod(len(axis.rows) for axis in self.axes)

    def points(self, base: PolicyConfig, seed: int = 0) -> tuple[Point, ...]:
        """The trainings, with everything that the axes do not say from a configuration.

        Args:
            base: the configuration.
            seed: of all draws, where no axis says it.

        Raises:
            ConfigError: values that make no configuration, two points that are the same training, or too many.
        """
        if len(self) > _LARGEST:
            raise ConfigError("the grid has too many points", got=len(self), expected=f"at most {_LARGEST}")
        made = tuple(self._made(base, seed))
        seen: dict[str, Point] = {}
        for point in made:
            same = seen.setdefault(_training(point), point)
            if same is not point:
                raise ConfigError(
                    "two points of the grid are the same training",
                    got=f"{said(same.values)}, and {said(point.values)}",
                    hint='What means something only together is one axis: "noise, sigma": [[none, 0.1], [ou, 0.2]].',
                )
        return made

    def _made(self, base: PolicyConfig, seed: int) -> Iterator[Point]:
        for rows in itertools.product(*(axis.rows for axis in self.axes)):
            values = {name: v for axis, row in zip(self.axes, rows, strict=True) for name, v in _pairs(axis, row)}
            learner = {n.removeprefix("learner."): value for n, value in values.items() if n.startswith("learner.")}
            counts = {name: value for name, value in values.items() if name in _COUNTS}
            try:
                own = build(LearnerConfig, {**vars(base.learner), **learner}, "learner")
                config = replace(base, learner=own, **counts)
            except ConfigError as error:
                raise ConfigError(f"no training with {said(values)}: {error.summary}", hint=error.hint) from error
            yield Point(values, config, values.get("seed", seed))


def said(values: Mapping[str, Any]) -> str:
    """Values of a point on one line."""
    return ", ".join(f"{name.removeprefix('learner.')} {value}" for name, value in values.items())


def read_grid(tree: Mapping[Any, Any], where: str) -> Grid:
    """A grid from a mapping of names to lists of values.

    Names are those of `NAMES`; `learner.` may be left out. A name such as `noise, sigma` is one axis of several
    numbers, whose values are lists.

    Args:
        tree: the mapping.
        where: it comes from, for messages.

    Raises:
        ConfigError: unknown names, or values that a number cannot have.
    """
    if not tree:
        raise ConfigError(f"{where} has no names", available=NAMES)
    axes = tuple(_axis(key, rows, where) for key, rows in tree.items())
    names = [name for axis in axes for name in axis.names]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ConfigError(f"{where} has names twice", got=", ".join(twice))
    return Grid(axes)


def _axis(key: Any, rows: Any, where: str) -> Axis:
    shorts = [name.strip() for name in str(key).split(",")]
    names = tuple(f"learner.{name}" if name in _LEARNER else name for name in shorts)
    if strangers := [name for name in names if name not in NAMES]:
        raise ConfigError(f"{where} has unknown names {strangers}", available=NAMES)
    if not isinstance(rows, list | tuple) or not rows:
        raise ConfigError(f"{where}: {key} must be a list of values", got=repr(rows))
    if len(names) > 1 and not all(isinstance(row, list | tuple) and len(row) == len(names) for row in rows):
        raise ConfigError(
            f"{where}: {key} must be a list of lists", got=repr(rows), expected=f"{len(names)} values each"
        )
    together = [row if len(names) > 1 else [row] for row in rows]
    return Axis(names, tuple(tuple(_value(n, v, where) for n, v in zip(names, row, strict=True)) for row in together))


def _value(name: str, value: Any, where: str) -> Any:
    """As the configuration has it: 1 is 1.0 where it says how fast something is learned.

    Raises:
        ConfigError: it cannot be the value of this name.
    """
    if name.startswith("learner."):
        short = name.removeprefix("learner.")
        try:
            return as_read_back(getattr(build(LearnerConfig, {short: value}, "learner"), short))
        except ConfigError as error:
            raise ConfigError(f"{where}: {error.summary}", hint=error.hint) from error
    least = 0 if name == "seed" else 1
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise ConfigError(f"{where}: {name}", got=repr(value), expected=f"a whole number, at least {least}")
    return value


def _pairs(axis: Axis, row: Sequence[Any]) -> Iterator[tuple[str, Any]]:
    return zip(axis.names, row, strict=True)


def _training(point: Point) -> str:
    """Hash of what is trained: a noise that is none has no width."""
    config = point.config
    if config.learner.noise == "none":
        config = replace(config, learner=replace(config.learner, sigma=LearnerConfig.sigma))
    return json_hash([asdict(config), point.seed])


# ES thesis, 2.3.2, and the noises of 2.3; sigma is the width of a noise. For TQC the thesis varies neither: noise kept
# it from minima (2.3.1).
_TAU = (0.005, 0.01, 0.02)
_NOISE = [["none", 0.1], ["normal", 0.2], ["normal", 0.1], ["ou", 0.2], ["ou", 0.1]]
_VARIED: Mapping[Algorithm, Mapping[str, Sequence[Any]]] = {
    "ddpg": {"gamma": (0.99, 0.97, 0.95), "noise, sigma": _NOISE, "tau": _TAU},
    "sac": {"gamma": (0.99, 0.95), "noise, sigma": _NOISE, "tau": _TAU},
    "td3": {"gamma": (0.99, 0.95), "noise, sigma": _NOISE, "tau": _TAU},
    "tqc": {"gamma": (0.99, 0.95), "tau": (0.9, 0.8)},
}
THESIS: Mapping[Algorithm, Grid] = {
    algorithm: read_grid({"rate": (0.005, 0.002, 0.001), **others}, f"grid of {algorithm}")
    for algorithm, others in _VARIED.items()
}
