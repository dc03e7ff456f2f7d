"""From a profile to a plan, and motions from one pose to another."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float64

from trueup.errors import ConfigError, NoPlan
from trueup.record.check import require_valid
from trueup.record.paths import PathSettings, plan_path
from trueup.record.plan import Plan
from trueup.record.profile import ClockSettings, Profile
from trueup.record.scene import Scene
from trueup.record.timing import rounded, time_path

Drawn = TypeVar("Drawn")

# Corners are rounded over such spacings of control points [rad or m], the next one where the wider one touches.
_ROUNDING = (0.3, 0.1, 0.03)


@dataclass(frozen=True)
class MotionSettings:
    """What all motions have in common.

    Attributes:
        clock: samples, rest, smoothing.
        path: how paths are looked for.
        acceleration_share: share of the acceleration limits that is used, above 0, up to 1.
        attempts: draws of a goal, a line or a reference before a motion is given up.

    Raises:
        ConfigError: no attempt, or a share that is none.
    """

    clock: ClockSettings = field(default_factory=ClockSettings)
    path: PathSettings = field(default_factory=PathSettings)
    acceleration_share: float = 1.0
    attempts: int = 50

    def __post_init__(self) -> None:
        """Refuse what can make no motion."""
        if self.attempts < 1:
            raise ConfigError("attempts must be at least 1", got=self.attempts)
        if not 0 < self.acceleration_share <= 1:
            raise ConfigError(
                "acceleration_share is no share", got=self.acceleration_share, expected="above 0, up to 1"
            )


def as_plan(
    profile: Profile,
    scene: Scene,
    clock: ClockSettings,
    *,
    kind: str,
    moving: Sequence[str],
    id: str,
    details: Mapping[str, Any],
) -> Plan:
    """A profile with rest around it, as a plan that has passed every check.

    Raises:
        NoPlan: the plan breaks a limit, moves a joint that must not move, or touches something.
    """
    rest = round(clock.rest_s * clock.rate_hz)
    whole = profile.with_rest(rest)
    count = len(whole.position)
    plan = Plan(
        id=id or kind,
        kind=kind,
        joints=scene.joints,
        moving=tuple(name for name in scene.joints if name in moving),
        time_s=np.arange(count) * clock.timestep_s,
        position=whole.position,
        velocity=whole.velocity,
        acceleration=whole.acceleration,
        start_s=rest * clock.timestep_s,
        end_s=(count - 1 - rest) * clock.timestep_s,
        condition=kind,
        details=dict(details),
        length_units=scene.length_units,
    )
    return require_valid(plan, scene.limits, scene)


def joint_motion(
    scene: Scene,
    start: Float64[np.ndarray, "J"],
    goal: Float64[np.ndarray, "J"],
    *,
    moving: Sequence[str] | None = None,
    velocity_share: float = 1.0,
    seed: int = 0,
    settings: MotionSettings | None = None,
    id: str = "",
) -> Plan:
    """A motion in joint space from one pose to another, around what is in the way; also the way home.

    Args:
        scene: robot and obstacles.
        start: pose to begin with, (J,) [rad or m].
        goal: pose to end with, (J,).
        moving: the joints that may move; all if not given.
        velocity_share: share of the velocity limits, above 0, up to 1.
        seed: of the planner.
        settings: clock, planner, share of the acceleration limits.
        id: of the plan.

    Raises:
        ConfigError: a pose out of limits, a goal that moves another joint or none, a share that is none.
        NameMismatch: an unknown joint.
        NoPlan: a pose in collision, or no path within the planner's attempts.
    """
    settings = settings or MotionSettings()
    limits = scene.limits.scaled(velocity_share, settings.acceleration_share)
    joints = tuple(scene.joints if moving is None else moving)
    way = plan_path(scene, start, goal, moving=joints, seed=seed, settings=settings.path)
    details = {"velocity_share": velocity_share, "way_points": len(way)}
    for spacing in _ROUNDING:
        profile = time_path(rounded(way, spacing), limits, settings.clock)
        try:
            return as_plan(profile, scene, settings.clock, kind="joint", moving=joints, id=id, details=details)
        except NoPlan:
            if len(way) == 2 or spacing == _ROUNDING[-1]:
                raise
    raise AssertionError("a spacing was tried last")


def random_pose(
    scene: Scene, rng: np.random.Generator, *, share: float = 1.0, attempts: int = 1000
) -> Float64[np.ndarray, "J"]:
    """A pose drawn evenly from within the limits, free of collision.

    Args:
        scene: robot and obstacles.
        rng: of the draws.
        share: of each range that is drawn from, around its middle; less leaves room for motions around the pose.
        attempts: draws before it is given up.

    Raises:
        NoPlan: none was found.
    """
    edge = (1 - share) / 2 * (scene.limits.high - scene.limits.low)
    for _ in range(attempts):
        pose: Float64[np.ndarray, "J"] = rng.uniform(scene.limits.low + edge, scene.limits.high - edge)
        if scene.free(pose):
            return pose
    raise NoPlan("no pose is free of collision", got=f"{attempts} draws", hint="Does the robot stand in an obstacle?")


def first_plan(draw: Callable[[], Drawn], plan: Callable[[Drawn], Plan | None], attempts: int, wanted: str) -> Plan:
    """The plan of the first draw that leads to one; its details say how many it took.

    Args:
        draw: draws a motion; what it raises is not caught.
        plan: plans it; None or `NoPlan` where the draw is of no use.
        attempts: draws before it is given up.
        wanted: what was looked for, as it stands behind "no".

    Raises:
        NoPlan: none of the attempts led to a motion.
    """
    last: NoPlan | None = None
    for number in range(attempts):
        drawn = draw()
        try:
            found = plan(drawn)
        except NoPlan as error:
            last = error
            continue
        if found is not None:
            return replace(found, details={**found.details, "attempts": number + 1})
    raise NoPlan(f"no {wanted} in {attempts} attempts", got=last.summary if last else None)


def random_joint_motion(
    scene: Scene,
    moving: Sequence[str],
    rng: np.random.Generator,
    *,
    velocity_share: float,
    settings: MotionSettings | None = None,
) -> Plan:
    """A motion of some joints from a random pose to a random goal (LSTM thesis, algorithm 3).

    The start is drawn, too, not taken from the motion before: so each motion can be planned alone.

    Raises:
        ConfigError: no joint, or a share that is none.
        NameMismatch: an unknown joint.
        NoPlan: none of the attempts led to a motion.
    """
    settings = settings or MotionSettings()
    columns = scene.limits.columns(tuple(moving))
    if not columns:
        raise ConfigError("a motion needs at least one joint", available=scene.joints)
    scene.limits.scaled(velocity_share, settings.acceleration_share)
    inner = scene.limits

    def draw() -> tuple[Float64[np.ndarray, "J"], Float64[np.ndarray, "J"], int]:
        start = random_pose(scene, rng)
        goal = start.copy()
        goal[columns] = rng.uniform(inner.low[columns], inner.high[columns])
        return start, goal, int(rng.integers(2**32 - 1))

    def plan(drawn: tuple[Float64[np.ndarray, "J"], Float64[np.ndarray, "J"], int]) -> Plan | None:
        start, goal, seed = drawn
        # A motion that hardly moves one of its joints is of no use to whoever wants that joint moved.
        if np.any(np.abs(goal - start)[columns] < 0.02 * (inner.high - inner.low)[columns]):
            return None
        return joint_motion(
            scene, start, goal, moving=moving, velocity_share=velocity_share, seed=seed, settings=settings
        )

    return first_plan(draw, plan, settings.attempts, f"motion of {list(moving)}")
