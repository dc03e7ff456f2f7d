"""References of the end effector drawn from random B-splines of degree 0 to 4 (SAT, section IV-C)."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float64

from trueup.errors import ConfigError, NoPlan
from trueup.record.kinematics import InverseKinematics
from trueup.record.limits import JointLimits
from trueup.record.motion import MotionSettings, as_plan, first_plan, random_pose
from trueup.record.plan import Plan
from trueup.record.profile import ClockSettings, Profile, averaged
from trueup.record.scene import Scene

ORDERS = (0, 1, 2, 3, 4)
# Of random splines: control points, and half the length of the edges of the cube that they are drawn from [m].
_CONTROL_POINTS, _EXTENT_M = 8, 0.2
# Poses are computed at so many points of each span; a spline of degree 0 needs one.
_POINTS = 24
# What jumps or bends is smoothed over this share of a span, twice: velocities and accelerations have limits.
_SMOOTHED = 0.5
# Time from one knot to the next, at least [s].
_SPAN_S = 0.6


def b_spline(points: Float64[np.ndarray, "K 3"], order: int) -> Any:
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
    settings = settings or MotionSettings()
    limits = scene.limits.scaled(velocity_share, settings.acceleration_share)
    curve = b_spline(points, order)
    spans = len(points) - order
    origin, _ = scene.pose(start)
    solver = InverseKinematics(scene, hold_rotation=False)
    where = _parameters(spans, order)
    poses = solver.follow(start, origin + curve(where), jumps=True)
    profile, span_s = _within(_reference(where, poses, order), limits, settings.clock, spans)
    details = {
        "velocity_share": velocity_share,
        "order": order,
        "points_m": (origin + points).tolist(),
        "span_s": span_s,
    }
    return as_plan(profile, scene, settings.clock, kind="b-spline", moving=scene.joints, id=id, details=details)


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


def _within(reference: Any, limits: JointLimits, clock: ClockSettings, spans: int) -> tuple[Profile, float]:
    """The reference, smoothed, and slow enough for the limits; and the time of a span that this takes."""
    span_s = _SPAN_S
    for _ in range(20):
        count = max(1, round(spans * span_s * clock.rate_hz))
        steps = max(1, round(_SMOOTHED * span_s * clock.rate_hz))
        position = reference(np.arange(count + 1) / count)
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
    settings: MotionSettings | None = None,
) -> Plan:
    """A B-spline whose control points are drawn from a cube around the end effector in a random pose.

    Args:
        scene: robot and obstacles.
        order: degree of the spline, 0 to 4.
        rng: of all draws.
        velocity_share: share of the velocity limits.
        settings: clock, share of the acceleration limits, attempts.

    Raises:
        ConfigError: an unknown order.
        NoPlan: none of the attempts led to a motion.
    """
    settings = settings or MotionSettings()
    b_spline(np.zeros((_CONTROL_POINTS, 3)), order)

    def draw() -> tuple[Float64[np.ndarray, "J"], Float64[np.ndarray, "K 3"]]:
        return random_pose(scene, rng), rng.uniform(-_EXTENT_M, _EXTENT_M, (_CONTROL_POINTS, 3))

    def plan(drawn: tuple[Float64[np.ndarray, "J"], Float64[np.ndarray, "K 3"]]) -> Plan:
        start, offsets = drawn
        return spline_reference(scene, start, offsets, order, velocity_share=velocity_share, settings=settings)

    return first_plan(draw, plan, settings.attempts, f"B-spline of order {order}")
