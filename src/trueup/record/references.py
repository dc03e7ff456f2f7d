"""Functions of time as references of joints: scaled to the limits, at rest at both ends, around a pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float64

from trueup.errors import ConfigError, NoPlan
from trueup.record.functions import Chirp, Function, multisine, random_chebyshev, random_field, taper
from trueup.record.limits import JointLimits
from trueup.record.motion import MotionSettings, as_plan, first_plan, random_pose
from trueup.record.plan import Plan
from trueup.record.profile import ClockSettings, Profile
from trueup.record.scene import Scene

FunctionKind = Literal["chirp", "multisine", "random-field", "chebyshev"]
FUNCTIONS: tuple[FunctionKind, ...] = ("chirp", "multisine", "random-field", "chebyshev")

# Where something is in the way, amplitudes shrink by this factor, so often.
_SHRINK, _SHRINKS = 0.7, 8
_MARGIN = 1 - 1e-9
# Centers are drawn from this share of the ranges: beside a limit, there is no room for a reference.
INNER = 0.6


@dataclass(frozen=True)
class ReferenceSettings:
    """What functions are drawn.

    Attributes:
        duration_s: length of the motion without rest [s].
        ramp_s: time over which the amplitude grows and falls [s].
        lowest_hz: where chirps begin, and the base of multisines [Hz].
        highest_hz: where chirps end, and the highest harmonic [Hz]; higher means smaller amplitudes within the limits.
        length_s: correlation length of Gaussian random fields [s].
        degree: of Chebyshev polynomials.
        position_share: share of the room to the nearer position limit that may be used.

    Raises:
        ConfigError: a number that is not positive, ramps longer than the motion, a share above 1.
    """

    duration_s: float = 10.0
    ramp_s: float = 1.0
    lowest_hz: float = 0.1
    highest_hz: float = 1.0
    length_s: float = 0.6
    degree: int = 8
    position_share: float = 0.9

    def __post_init__(self) -> None:
        """Refuse settings that describe no function."""
        for name in ("duration_s", "ramp_s", "lowest_hz", "highest_hz", "length_s", "degree", "position_share"):
            value = getattr(self, name)
            if not (value > 0 and np.isfinite(value)):
                raise ConfigError(f"{name} of a reference must be positive", got=value)
        if 2 * self.ramp_s > self.duration_s:
            raise ConfigError("the ramps are longer than the motion", got=self.ramp_s, expected=self.duration_s / 2)
        if self.lowest_hz > self.highest_hz or self.position_share > 1:
            raise ConfigError(
                "lowest_hz must be at most highest_hz, and position_share at most 1",
                got=(self.lowest_hz, self.highest_hz, self.position_share),
            )


def draw_function(kind: FunctionKind, rng: np.random.Generator, settings: ReferenceSettings) -> Function:
    """One function of a kind.

    Raises:
        ConfigError: an unknown kind.
    """
    if kind == "chirp":
        phase = float(rng.uniform(0, 2 * np.pi))
        ends = (settings.lowest_hz, settings.highest_hz)
        return Chirp(*(ends if rng.random() < 0.5 else ends[::-1]), settings.duration_s, phase)
    if kind == "multisine":
        return multisine(rng, base_hz=settings.lowest_hz, highest_hz=settings.highest_hz)
    if kind == "random-field":
        return random_field(rng, length_s=settings.length_s, duration_s=settings.duration_s)
    if kind == "chebyshev":
        return random_chebyshev(rng, degree=settings.degree, duration_s=settings.duration_s)
    raise ConfigError("there is no such kind of reference", got=repr(kind), available=FUNCTIONS)


def shape(functions: Mapping[int, Function], joints: int, clock: ClockSettings, settings: ReferenceSettings) -> Profile:
    """Tapered functions as columns of a profile around zero; columns without a function stay zero."""
    count = max(2, round(settings.duration_s * clock.rate_hz))
    time_s = np.arange(count + 1) * clock.timestep_s
    end = float(time_s[-1])
    window, dwindow, ddwindow = taper(time_s, end, settings.ramp_s)
    columns = np.zeros((3, count + 1, joints))
    for column, function in functions.items():
        value, first, second = function(time_s)
        columns[0, :, column] = window * value
        columns[1, :, column] = dwindow * value + window * first
        columns[2, :, column] = ddwindow * value + 2 * dwindow * first + window * second
    return Profile(*columns)


def amplitudes(
    unit: Profile, timestep_s: float, center: Float64[np.ndarray, "J"], limits: JointLimits, position_share: float
) -> Float64[np.ndarray, "J"]:
    """The largest factor of each column of a profile around zero that keeps every limit around a center, (J,).

    Columns that do not move get 0.
    """
    speed, thrust = unit.largest(timestep_s)
    with np.errstate(divide="ignore", invalid="ignore"):
        factors = np.stack(
            [
                position_share * (limits.high - center) / unit.position.max(axis=0).clip(min=0),
                position_share * (center - limits.low) / (-unit.position.min(axis=0)).clip(min=0),
                limits.velocity / speed,
                limits.acceleration / thrust,
            ]
        )
    moves = np.ptp(unit.position, axis=0) > 0
    return np.where(moves, _MARGIN * np.nanmin(np.where(np.isfinite(factors), factors, np.inf), axis=0), 0.0)


def scaled(unit: Profile, factor: Float64[np.ndarray, "J"], center: Float64[np.ndarray, "J"]) -> Profile:
    """Each column of a profile around zero times its factor, around a center."""
    return Profile(center + factor * unit.position, factor * unit.velocity, factor * unit.acceleration)


def function_reference(
    scene: Scene,
    functions: Mapping[str, Function],
    center: Float64[np.ndarray, "J"],
    *,
    kind: str,
    velocity_share: float = 1.0,
    reference: ReferenceSettings | None = None,
    settings: MotionSettings | None = None,
    id: str = "",
) -> Plan:
    """Joints that follow functions of time around a pose, as large as limits and obstacles allow.

    Args:
        scene: robot and obstacles.
        functions: joint -> its function; only its shape counts.
        center: pose around which the joints move, (J,) [rad or m].
        kind: of the plan.
        velocity_share: share of the velocity limits, above 0, up to 1.
        reference: duration, ramps, share of the position ranges.
        settings: clock and share of the acceleration limits.
        id: of the plan.

    Raises:
        ConfigError: a center out of limits, no function.
        NameMismatch: an unknown joint.
        NoPlan: the center is in collision, or something is in the way of motions of every size.
    """
    reference, settings = reference or ReferenceSettings(), settings or MotionSettings()
    limits = scene.limits.scaled(velocity_share, settings.acceleration_share)
    moving = tuple(functions)
    if not moving:
        raise ConfigError("a reference needs at least one joint", available=scene.joints)
    columns = dict(zip(limits.columns(moving), functions.values(), strict=True))
    scene.require_free(center, "the center of the reference")
    unit = shape(columns, len(scene.joints), settings.clock, reference)
    factor = amplitudes(unit, settings.clock.timestep_s, center, limits, reference.position_share)
    for _ in range(_SHRINKS):
        profile = scaled(unit, factor, center)
        if scene.first_collision(profile.position, clearance_m=scene.clearance_m) is None:
            details: dict[str, Any] = {
                "velocity_share": velocity_share,
                "amplitude": {
                    scene.joints[column]: float(np.ptp(profile.position[:, column]) / 2) for column in columns
                },
            }
            return as_plan(profile, scene, settings.clock, kind=kind, moving=moving, id=id, details=details)
        factor = factor * _SHRINK
    raise NoPlan("something is in the way of the reference, however small", hint="Choose another center.")


def random_reference(
    scene: Scene,
    kind: FunctionKind,
    moving: Sequence[str],
    rng: np.random.Generator,
    *,
    velocity_share: float,
    reference: ReferenceSettings | None = None,
    settings: MotionSettings | None = None,
) -> Plan:
    """Random functions of one kind around a random pose.

    Raises:
        ConfigError: an unknown kind, no joint.
        NameMismatch: an unknown joint.
        NoPlan: none of the attempts led to a motion.
    """
    reference, settings = reference or ReferenceSettings(), settings or MotionSettings()
    functions_of_pose = tuple[Float64[np.ndarray, "J"], dict[str, Function]]

    def draw() -> functions_of_pose:
        center = random_pose(scene, rng, share=INNER)
        return center, {joint: draw_function(kind, rng, reference) for joint in moving}

    def plan(drawn: functions_of_pose) -> Plan:
        center, functions = drawn
        return function_reference(
            scene, functions, center, kind=kind, velocity_share=velocity_share, reference=reference, settings=settings
        )

    return first_plan(draw, plan, settings.attempts, f"{kind} reference")
