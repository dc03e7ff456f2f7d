"""What to fit, to what, and how: the YAML of `trueup identify`, and a sensible default that needs none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any, Literal

from trueup.core.config import as_number, build, read_yaml
from trueup.core.parameters import Parameter, ParameterSet
from trueup.errors import ConfigError
from trueup.identify.candidate import Nominal
from trueup.identify.quantities import Quantity, quantity
from trueup.identify.segments import SegmentRule
from trueup.identify.solution import SolverName, SolveSettings
from trueup.identify.solvers.gauss_newton import GaussNewtonSettings
from trueup.robots import RobotSpec
from trueup.robots.friction import LAWS

_LAWS = {name: tuple(number.name for number in law.numbers if number.excite) for name, law in LAWS.items() if law.tried}
# Gains are what somebody had to invent; masses are what CAD has weighed, and stay near it.
_WEIGHED = {"prior_std": 0.1}
# Closed loop: the servo holds the joint near its command, so whole motions can be compared.
_SERVO_FIT: Mapping[str, Any] = {
    **dict.fromkeys(("delay_s", "kp", "kv", "damping", "frictionloss", "armature", "torque_offset"), "all"),
    "mass": _WEIGHED,
}
_SERVO_MODELS = {
    "payload": ("payload_mass", "payload_x", "payload_y", "payload_z", "payload_inertia"),
    "limits": ("torque_limit",),
    "integral": ("ki",),
    **_LAWS,
}
# A velocity servo has no other gain, and its error in speed tells it from friction.
_VELOCITY_FIT = {name: choice for name, choice in _SERVO_FIT.items() if name != "kp"}
_VELOCITY_MODELS = _SERVO_MODELS
# Open loop: the torque is known, so masses and inertias can be told from friction.
# (Incremental encoders are zeroed where the arm happens to hang: each recording has zeros of its own.)
_TORQUE_FIT: Mapping[str, Any] = {
    **dict.fromkeys(("delay_s", "damping", "frictionloss", "armature", "encoder_zero"), "all"),
    **dict.fromkeys(("mass", "com_x", "com_y", "com_z", "inertia_scale"), "all"),
}
_TORQUE_MODELS = {
    "torque-offset": ("torque_offset",),
    "torque-gain": ("torque_gain",),
    **_LAWS,
}
# Over longer than this, open-loop motion has no usable slope.
_OPEN_LOOP_S = 0.5
# Weighed by its own noise.
AUTO = "auto"
_CHOICE_KEYS = ("targets", "shared", "start", "low", "high", "prior_std", "frozen")


@dataclass(frozen=True)
class DataChoice:
    """Which parts of the logs are used.

    Attributes:
        window_s: restart from the measured state this often [s]. If not given: none for servos, at most 0.5 s for
            torque-driven robots (and what `replay.window_s` says if that is shorter).
        cut_s: piece taken from each motion [s]; as long as the budget allows if not given.
        budget_s: motion that is simulated per candidate [s]; more is slower and more certain.
        burn_in_s: left out at the beginning of a piece [s].
        keep_flagged: fit motions whose measurement is broken, too (frozen, missing or jumping positions, gaps, …).
        drop_flagged: leave out all motions with quality warnings, also those that describe the motion (blocked, …).
    """

    window_s: float | None = None
    cut_s: float | None = None
    budget_s: float = 200.0
    burn_in_s: float = 1.0
    keep_flagged: bool = False
    drop_flagged: bool = False

    def __post_init__(self) -> None:
        """Refuse to keep and to drop the same motions."""
        if self.keep_flagged and self.drop_flagged:
            raise ConfigError("data: keep_flagged and drop_flagged exclude each other", expected="one of them")

    @property
    def drop(self) -> bool | None:
        """Which motions are left out, as `EpisodeMeta.why_dropped` takes it."""
        return self.drop_flagged or (False if self.keep_flagged else None)

    def rule(self, robot: RobotSpec, seed: int) -> SegmentRule:
        """How to cut logs accordingly."""
        return SegmentRule(
            self.window_s,
            self.cut_s,
            self.budget_s,
            self.burn_in_s,
            seed,
            robot.replay.settle_s,
            robot.simulation.base_sensor,
            robot.replay.command,
        )


@dataclass(frozen=True)
class SolverChoice:
    """How to search.

    Attributes:
        name: `auto`, `gauss-newton`, `cma-es` or `evolution`.
        max_iterations: of Gauss-Newton.
        max_evaluations: of the derivative-free solvers.
        max_seconds: per model that is tried [s].
        tolerance: relative decrease at which Gauss-Newton stops.
        loss: `linear`, or `soft_l1` where single motions are bad.
        starts: number of starts; they must agree.
    """

    name: SolverName = "auto"
    max_iterations: int = 40
    max_evaluations: int = 4000
    max_seconds: float | None = None
    tolerance: float = 1e-3
    loss: Literal["linear", "soft_l1"] = "linear"
    starts: int = 1

    def settings(self, seed: int) -> SolveSettings:
        """The same for `solve`."""
        return SolveSettings(
            solver=self.name,
            gauss_newton=GaussNewtonSettings(
                max_iterations=self.max_iterations, tolerance=self.tolerance, loss=self.loss
            ),
            max_evaluations=self.max_evaluations,
            max_seconds=self.max_seconds,
            starts=self.starts,
            seed=seed,
        )


@dataclass(frozen=True)
class IdentifyConfig:
    """The whole of it.

    Attributes:
        fit: quantity -> `all`, a list of joints or bodies, or `{targets, shared, start, low, high, prior_std,
            frozen}`; the default for the robot's controller if empty. `shared: true` makes it one number for all
            joints (or bodies), as with a delay that lies in the bus.
        models: name -> further quantities, tried one after the other on top of what has been kept so far; kept if
            they make motions better that were not fitted (val). The default for the controller if not given.
        signals: signal -> weight of the residual, or `auto` to weigh it by its own noise where it is logged.
        joints: joint -> weight; unnamed joints have 1, unscored ones 0.
        data: which parts of the logs.
        solver: how to search.
        schema: `trueup.identify/1`.
    """

    fit: Mapping[str, Any] = field(default_factory=dict)
    models: Mapping[str, tuple[str, ...]] | None = None
    signals: Mapping[str, Any] = field(default_factory=lambda: {"position": 1.0, "torque": AUTO})
    joints: Mapping[str, float] = field(default_factory=dict)
    data: DataChoice = field(default_factory=DataChoice)
    solver: SolverChoice = field(default_factory=SolverChoice)
    schema: Literal["trueup.identify/1"] = "trueup.identify/1"

    def __post_init__(self) -> None:
        """Refuse names that do not exist."""
        for name in self.fit:
            quantity(name)
        for extra in (self.models or {}).values():
            for name in extra:
                quantity(name)
        for name, weight in self.signals.items():
            if isinstance(weight, bool) or not (isinstance(weight, int | float) or weight == AUTO):
                raise ConfigError(f"signals: {name}", got=repr(weight), expected=f"a number, or {AUTO}")
        if not self.weights.get("position"):
            raise ConfigError("signals must weigh position", got=dict(self.signals), expected="position: 1.0")

    @property
    def weights(self) -> dict[str, float]:
        """Signal -> weight, of those that have a number."""
        return {name: float(weight) for name, weight in self.signals.items() if weight != AUTO}

    @staticmethod
    def load(path: Path) -> IdentifyConfig:
        """Read the YAML.

        Raises:
            ConfigError: missing, not YAML, an unknown key or quantity.
        """
        return build(IdentifyConfig, read_yaml(path), str(path))

    def resolved(self, nominal: Nominal) -> IdentifyConfig:
        """With the defaults for this robot's controller filled in: of what its drives and its model have.

        Raises:
            ConfigError: `models` names a quantity that no scored joint has.
        """
        usual_fit, usual_models = _usual(nominal)
        fit = self.fit or usual_fit
        models = self.models
        if models is None:
            models = {} if self.fit else usual_models
        make_parameters(dict.fromkeys(chain.from_iterable(models.values()), "all"), nominal)
        data = replace(self.data, window_s=self.window_s(nominal.robot))
        return replace(self, fit=fit, models=models, data=data)

    def window_s(self, robot: RobotSpec) -> float | None:
        """How often the fit restarts from the measured state [s]; None never."""
        if self.data.window_s is not None or robot.controller.signal != "torque":
            return self.data.window_s
        return min(robot.replay.window_s or _OPEN_LOOP_S, _OPEN_LOOP_S)

    def to_json(self) -> dict[str, Any]:
        """JSON types only."""
        return asdict(self)


def _usual(nominal: Nominal) -> tuple[dict[str, Any], dict[str, tuple[str, ...]]]:
    """What is fitted, and what is tried on top, if nobody says."""
    fit: Mapping[str, Any]
    if nominal.robot.controller.signal == "torque":
        fit, models = _TORQUE_FIT, _TORQUE_MODELS
    elif _all(quantity("kp"), nominal):
        fit, models = _SERVO_FIT, _SERVO_MODELS
    else:
        fit, models = _VELOCITY_FIT, _VELOCITY_MODELS
    there = {name: _there(own, nominal) for name, own in models.items()}
    return {name: fit[name] for name in _there(tuple(fit), nominal)}, {name: own for name, own in there.items() if own}


def _there(names: Sequence[str], nominal: Nominal) -> tuple[str, ...]:
    """Those that the model and its drives have."""
    return tuple(name for name in names if quantity(name).of == "motion" or _all(quantity(name), nominal))


def make_parameters(fit: Mapping[str, Any], nominal: Nominal, motions: Sequence[str] = ()) -> ParameterSet:
    """The parameters that a `fit:` section asks for, started from what the model says.

    Args:
        fit: quantity -> choice, see `IdentifyConfig`.
        nominal: the model as it came.
        motions: ids of the motions, for what differs from recording to recording.

    Raises:
        ConfigError: an unknown quantity, target or key, one that a joint's drive does not have, or bounds that
            contradict each other.
    """
    return ParameterSet(
        tuple(
            parameter for name, choice in fit.items() for parameter in _chosen(quantity(name), choice, nominal, motions)
        )
    )


def _chosen(kind: Quantity, choice: Any, nominal: Nominal, motions: Sequence[str]) -> list[Parameter]:
    options = dict(choice) if isinstance(choice, Mapping) else {"targets": choice}
    unknown = [key for key in options if key not in _CHOICE_KEYS]
    if unknown:
        raise ConfigError(f"fit: {kind.name} has unknown keys {unknown}", available=_CHOICE_KEYS)
    choice, shared = options.pop("targets", "all"), options.pop("shared", False)
    frozen = options.pop("frozen", False)
    if not isinstance(frozen, bool):
        raise ConfigError(f"fit: {kind.name}: frozen", got=repr(frozen), expected="true or false")
    numbers: dict[str, Any] = {key: _number(kind, key, value) for key, value in options.items()}
    start = numbers.pop("start", None)
    able = kind.holders(nominal, motions)
    if kind.addable and start is not None:
        able = kind.targets(nominal, motions)
    parameters = []
    for target in _targets(kind, choice, nominal, motions, able, shared=shared):
        parameter = kind.parameter(nominal, target, start=start)
        low, high = numbers.get("low", parameter.low), numbers.get("high", parameter.high)
        if start is not None:
            value = start
        elif frozen:
            if parameter.nominal is None:
                continue  # Joints that share the number differ in it: each is left as it is.
            value = parameter.nominal
        else:
            # A start that only the default put outside the user's bounds follows them.
            value = min(max(parameter.value, low), high) if low <= high else parameter.value
        parameters.append(replace(parameter, value=value, frozen=frozen, **numbers))
    return parameters


def _number(kind: Quantity, key: str, value: Any) -> float:
    value = as_number(value) if isinstance(value, str) else value
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ConfigError(f"fit: {kind.name}: {key} must be a number", got=repr(value))
    return float(value)


def _all(kind: Quantity, nominal: Nominal, able: Sequence[str] | None = None) -> list[str]:
    """What `all` means: those of `able` (of what the model has, if None) that enter the score.

    Of bodies that are welded together, one: no motion tells them apart.
    """
    names = kind.holders(nominal) if able is None else able
    if kind.of == "body":
        return [name for name in names if name in {group[0] for group in nominal.rigid_groups}]
    return [name for name in names if kind.of != "joint" or name in nominal.robot.scored_joints]


def _targets(
    kind: Quantity, choice: Any, nominal: Nominal, motions: Sequence[str], able: Sequence[str], *, shared: Any
) -> Sequence[str]:
    known = kind.targets(nominal, motions)
    if not isinstance(shared, bool) or (shared and choice not in ("all", None)):
        raise ConfigError(
            f"fit: {kind.name}: shared",
            got=f"shared: {shared!r} with targets: {choice!r}",
            expected="true or false, and no targets, since the whole robot shares it",
        )
    if shared and kind.of == "motion":
        raise ConfigError(
            f"fit: {kind.name}: shared", got="shared: true", hint="Every recording has its own; joint_offset is shared."
        )
    if choice in ("all", None):
        found = _all(kind, nominal, able)
        if not found and kind.needs:
            raise ConfigError(f"fit: {kind.name} needs {kind.needs}", got="no scored joint that has one")
        return [""] if shared else found
    wanted = [choice] if isinstance(choice, str) else choice
    if not isinstance(wanted, list | tuple) or not all(isinstance(name, str) for name in wanted):
        raise ConfigError(f"fit: {kind.name}", got=repr(choice), expected="`all`, a list of names, or a mapping")
    strangers = [name for name in wanted if name not in known]
    if strangers:
        raise ConfigError(f"fit: {kind.name}: {strangers} are not a {kind.of} of the robot", available=known)
    without = [name for name in wanted if name not in able]
    if without:
        raise ConfigError(
            f"fit: {kind.name} needs {kind.needs}", got=f"{without}", available=_all(kind, nominal, able) or None
        )
    return list(wanted)
