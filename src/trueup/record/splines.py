"""References drawn from random B-splines of degree 0 to 4 (SAT, section IV-C): of sites, or of the joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float64

from trueup.errors import ConfigError, NoPlan
from trueup.record.kinematics import InverseKinematics
from trueup.record.limits import JointLimits
from trueup.record.motion import MotionSettings, as_plan, first_plan, random_pose
from trueup.record.plan import Plan
from trueup.record.posing import SiteKinematics
from trueup.record.profile import ClockSettings, Profile, averaged
from trueup.record.scene import Scene

ORDERS = (0, 1, 2, 3, 4)
# Of random splines: control points, and half the length of the edges of the cube that they are drawn from [m].
CONTROL_POINTS, EXTENT_M = 8, 0.2
# Poses are computed at so many points of each span; a spline of degree 0 needs one.
_POINTS = 24
# What jumps or bends is smoothed over this share of a span, twice: velocities and accelerations have limits.
_SMOOTHED = 0.5
# Time from one knot to the next, at least [s].
SPAN_S = 0.6


def b_spline(points: Float64[np.ndarray, "K D"], order: int) -> Any:
    """The clamped uniform B-spline of degree `order` over [0, 1] with these control points, as scipy's `BSpline`.

    Raises:
        ConfigError: an order other than 0 to 4, or too few points for it.
    """
    from scipy.interpolate import BSpline

    if order not in ORDERS:
        raise ConfigError("there is no such order of B-splines", got=order, available=ORDERS)
    if len(points) < max(2, order + 1):
        raise ConfigError(f"a B-spline of order {order} needs more control points", got=len(points))
    inner = np.linspace(0, 1, len(points) - order + 1)
    return BSpline(np.concatenate([np.zeros(order), inner, np.ones(order)]), points, order)


def spline_reference(
    scene: Scene,
    start: Float64[np.ndarray, "J"],
    points: Float64[np.ndarray, "K 3"],
    order: int,
    *,
    velocity_share: float = 1.0,
    settings: MotionSettings | None = None,
    id: str = "",
) -> Plan:
    """Joint references whose end effector follows a B-spline.

    The end effector's rotation is free. The joint references are smoothed by moving averages, since a spline of degree
    0 jumps and one of degree 1 has corners, and the whole is slowed down until the limits are kept.

    Args:
        scene: robot and obstacles.
        start: pose from which inverse kinematics begins, (J,) [rad or m].
        points: control points, relative to the end effector in `start` [m].
        order: degree of the spline, 0 to 4.
        velocity_share: share of the velocity limits, above 0, up to 1.
        settings: clock and share of the acceleration limits.
        id: of the plan.

    Raises:
        ConfigError: an unknown order, too few points.
        NoPlan: a point is out of reach, or something is in the way.
    """
    curve = b_spline(points, order)
    spans = len(points) - order
    origin, _ = scene.pose(start)
    solver = InverseKinematics(scene, hold_rotation=False)
    where = _parameters(spans, order)
    poses = solver.follow(start, origin + curve(where), jumps=True)
    details = {"points_m": (origin + points).tolist()}
    return _as_plan(
        _reference(where, poses, order), scene, spans, velocity_share, settings, id=id, order=order, details=details
    )


def limbs_reference(
    scene: Scene,
    start: Float64[np.ndarray, "J"],
    points: Mapping[str, Float64[np.ndarray, "K 3"]],
    order: int,
    *,
    velocity_share: float = 1.0,
    settings: MotionSettings | None = None,
    id: str = "",
) -> Plan:
    """Joint references whose sites follow a B-spline each, as near as their limbs reach; else as `spline_reference`.

    Args:
        scene: robot and obstacles.
        start: pose from which inverse kinematics begins, (J,) [rad or m].
        points: site -> its control points, relative to where it is in `start` [m].
        order: degree of the splines, 0 to 4.
        velocity_share: share of the velocity limits, above 0, up to 1.
        settings: clock and share of the acceleration limits.
        id: of the plan.

    Raises:
        ConfigError: an unknown order or site, too few points.
        NoPlan: a closed chain would have to open, or something is in the way.
    """
    spans = len(next(iter(points.values()))) - order
    solver = SiteKinematics(scene, tuple(points))
    where = _parameters(spans, order)
    targets = {}
    for site, (position, rotation) in solver.poses(start).items():
        targets[site] = np.tile(np.eye(4), (len(where), 1, 1))
        targets[site][:, :3, :3], targets[site][:, :3, 3] = rotation, position + b_spline(points[site], order)(where)
    poses = solver.follow(start, targets)
    if not any(own[0].any() for own in points.values()):
        poses[0] = start  # to rounding it is
    details = {"points_m": {site: own.tolist() for site, own in points.items()}}
    return _as_plan(
        _reference(where, poses, order), scene, spans, velocity_share, settings, id=id, order=order, details=details
    )


def joint_spline(
    scene: Scene,
    points: Mapping[str, Float64[np.ndarray, "K"]],
    order: int,
    *,
    velocity_share: float = 1.0,
    span_s: float = SPAN_S,
    settings: MotionSettings | None = None,
    id: str = "",
) -> Plan:
    """Joints that follow a B-spline each, smoothed and slowed down as in `spline_reference`; the others stay at home.

    Args:
        scene: robot and obstacles.
        points: joint -> its control points [rad or m].
        order: degree of the splines, 0 to 4.
        velocity_share: share of the velocity limits, above 0, up to 1.
        span_s: time from one knot to the next, at least [s].
        settings: clock and share of the acceleration limits.
        id: of the plan.

    Raises:
        ConfigError: an unknown order, too few points.
        NameMismatch: an unknown joint.
        NoPlan: something is in the way.
    """
    columns = scene.limits.columns(tuple(points))
    rows = np.tile(scene.home, (len(next(iter(points.values()))), 1))
    rows[:, columns] = np.stack(list(points.values()), axis=1)
    curve, spans = b_spline(rows, order), len(rows) - order
    details = {"points": {joint: own.tolist() for joint, own in points.items()}}
    # The last point of a spline of order 0 is at its end, where scipy would begin a span that there is not.
    reference = _reference(_parameters(spans, 0), rows, 0) if order == 0 else curve
    return _as_plan(
        reference,
        scene,
        spans,
        velocity_share,
        settings,
        span_s=span_s,
        id=id,
        order=order,
        details=details,
        kind="joint-b-spline",
        moving=tuple(points),
    )


def _as_plan(
    reference: Any,
    scene: Scene,
    spans: int,
    velocity_share: float,
    settings: MotionSettings | None,
    *,
    id: str,
    order: int,
    details: Mapping[str, Any],
    kind: str = "b-spline",
    moving: Sequence[str] = (),
    span_s: float = SPAN_S,
) -> Plan:
    settings = settings or MotionSettings()
    limits = scene.limits.scaled(velocity_share, settings.acceleration_share)
    profile, span_s = _within(reference, limits, settings.clock, spans, span_s)
    drawn = {"velocity_share": velocity_share, "order": order, **details, "span_s": span_s}
    return as_plan(profile, scene, settings.clock, kind=kind, moving=moving or scene.joints, id=id, details=drawn)


def _parameters(spans: int, order: int) -> Float64[np.ndarray, "N"]:
    if order == 0:
        return (np.arange(spans) + 0.5) / spans
    return np.linspace(0, 1, _POINTS * spans + 1)


def _reference(where: Float64[np.ndarray, "N"], poses: Float64[np.ndarray, "N J"], order: int) -> Any:
    """Joint positions as a function of the spline's parameter, as smooth as the spline itself."""
    from scipy.interpolate import make_interp_spline

    if order == 0:
        spans = len(where)
        return lambda u: poses[np.clip((u * spans).astype(int), 0, spans - 1)]
    return make_interp_spline(where, poses, k=1 if order == 1 else 3)


def _within(
    reference: Any, limits: JointLimits, clock: ClockSettings, spans: int, span_s: float
) -> tuple[Profile, float]:
    """The reference, smoothed, and slow enough for the limits; and the time of a span that this takes."""
    for _ in range(20):
        count = max(1, round(spans * span_s * clock.rate_hz))
        steps = max(1, round(_SMOOTHED * span_s * clock.rate_hz))
        # A cubic through poses may swing beyond them, a little outside of the ranges.
        position = np.clip(reference(np.arange(count + 1) / count), limits.low, limits.high)
        still = np.zeros_like(position)
        # The average's own velocities are differences of positions: those of a reference that jumps are not needed.
        once = averaged(Profile(position, still, still), steps, clock.timestep_s)
        profile = averaged(once, steps, clock.timestep_s)
        usage = profile.usage(limits, clock.timestep_s)
        if usage <= 1:
            return profile, span_s
        span_s *= usage * 1.001
    raise NoPlan("the reference cannot be slowed down to the limits", got=f"{span_s:.1f} s a span")


def random_spline(
    scene: Scene,
    order: int,
    rng: np.random.Generator,
    *,
    velocity_share: float,
    sites: Sequence[str] = (),
    control_points: int = CONTROL_POINTS,
    extent_m: float = EXTENT_M,
    from_home: bool = False,
    settings: MotionSettings | None = None,
) -> Plan:
    """A B-spline whose control points are drawn from a cube around the end effector in a random pose.

    Args:
        scene: robot and obstacles.
        order: degree of the spline, 0 to 4.
        rng: of all draws.
        velocity_share: share of the velocity limits.
        sites: a spline for each of these instead, as near as their limbs reach.
        control_points: of each spline.
        extent_m: half the length of the edges of the cube [m].
        from_home: begin at home, with home as the first control point, instead of in a random pose; for `sites`.
        settings: clock, share of the acceleration limits, attempts.

    Raises:
        ConfigError: an unknown order or site.
        NoPlan: none of the attempts led to a motion.
    """
    settings = settings or MotionSettings()
    b_spline(np.zeros((control_points, 3)), order)

    def draw() -> tuple[Float64[np.ndarray, "J"], Float64[np.ndarray, "S K 3"]]:
        shape = (max(1, len(sites)), control_points, 3)
        start = scene.home if from_home else random_pose(scene, rng)
        points = rng.uniform(-extent_m, extent_m, shape)
        if from_home:
            points[:, 0] = 0.0
        return start, points

    def plan(drawn: tuple[Float64[np.ndarray, "J"], Float64[np.ndarray, "S K 3"]]) -> Plan:
        start, offsets = drawn
        if not sites:
            return spline_reference(scene, start, offsets[0], order, velocity_share=velocity_share, settings=settings)
        points = dict(zip(sites, offsets, strict=True))
        return limbs_reference(scene, start, points, order, velocity_share=velocity_share, settings=settings)

    return first_plan(draw, plan, settings.attempts, f"B-spline of order {order}")


def random_joint_spline(
    scene: Scene,
    moving: Sequence[str],
    order: int,
    rng: np.random.Generator,
    *,
    velocity_share: float,
    control_points: int = CONTROL_POINTS,
    range_share: float = 1.0,
    pause_share: float = 0.0,
    span_s: float = SPAN_S,
    from_home: bool = False,
    settings: MotionSettings | None = None,
) -> Plan:
    """Joints that follow B-splines whose control points are drawn from a part of their ranges, itself drawn.

    Args:
        scene: robot and obstacles.
        moving: the joints.
        order: degree of the splines, 0 to 4.
        rng: of all draws.
        velocity_share: share of the velocity limits.
        control_points: of each spline.
        range_share: how large that part is; the smaller, the faster the joints turn back.
        pause_share: share of the control points that are the one before them again, each joint's own: it rests there.
        span_s: time from one knot to the next, at least [s].
        from_home: whether the first control point is home.
        settings: clock, share of the acceleration limits, attempts.

    Raises:
        ConfigError: an unknown order.
        NameMismatch: an unknown joint.
        NoPlan: none of the attempts led to a motion.
    """
    settings = settings or MotionSettings()
    columns = scene.limits.columns(tuple(moving))
    low, high = scene.limits.low[columns], scene.limits.high[columns]

    def draw() -> Float64[np.ndarray, "K M"]:
        least = low + rng.uniform(0, 1 - range_share, len(columns)) * (high - low)
        points = rng.uniform(least, least + range_share * (high - low), (control_points, len(columns)))
        if pause_share:
            pauses = rng.random(points.shape) < pause_share
            pauses[0] = False
            rows = np.maximum.accumulate(np.where(pauses, 0, np.arange(control_points)[:, None]))
            points = np.take_along_axis(points, rows, axis=0)
        if from_home:
            points[0] = scene.home[columns]
        return points

    def plan(drawn: Float64[np.ndarray, "K M"]) -> Plan:
        points = dict(zip(moving, drawn.T, strict=True))
        return joint_spline(scene, points, order, velocity_share=velocity_share, span_s=span_s, settings=settings)

    return first_plan(draw, plan, settings.attempts, f"B-spline of order {order} of {list(moving)}")
