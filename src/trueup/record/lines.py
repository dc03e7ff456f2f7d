"""Straight lines of the end effector in the xz, xy and yz planes (Realeasy, section IV-B)."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from jaxtyping import Float64

from trueup.errors import ConfigError, NoPlan
from trueup.record.kinematics import InverseKinematics
from trueup.record.motion import MotionSettings, as_plan, first_plan, random_pose
from trueup.record.plan import Plan
from trueup.record.scene import Scene
from trueup.record.timing import time_path

Plane = Literal["xz", "xy", "yz"]
PLANES: tuple[Plane, ...] = ("xz", "xy", "yz")
STRAIGHT_M = 1e-3

# Points of a line at which poses are computed [m]; between them joints are interpolated by a cubic spline.
_SPACING_M = 0.01


def cartesian_line(
    scene: Scene,
    start: Float64[np.ndarray, "J"],
    displacement_m: Float64[np.ndarray, "3"],
    *,
    velocity_share: float = 1.0,
    settings: MotionSettings | None = None,
    id: str = "",
) -> Plan:
    """Move the end effector along a straight line, its rotation held if the robot has six joints or more.

    Args:
        scene: robot and obstacles.
        start: pose to begin with, (J,) [rad or m].
        displacement_m: from the first to the last point, in the world [m].
        velocity_share: share of the velocity limits, above 0, up to 1.
        settings: clock and share of the acceleration limits.
        id: of the plan.

    Raises:
        ConfigError: a start out of limits, a line without length, a model without end effector.
        NoPlan: the line leaves the robot's reach, passes a singular pose, touches something, or is not straight
            within 1 mm.
    """
    from scipy.interpolate import make_interp_spline

    settings = settings or MotionSettings()
    limits = scene.limits.scaled(velocity_share, settings.acceleration_share)
    length = float(np.linalg.norm(displacement_m))
    if not (np.isfinite(length) and length > 0):
        raise ConfigError("a line needs a length", got=displacement_m.tolist())
    scene.require_free(start, "the start")
    origin, _ = scene.pose(start)
    share = np.linspace(0, 1, 1 + max(6, int(np.ceil(length / _SPACING_M))))
    solver = InverseKinematics(scene, hold_rotation=len(scene.joints) >= 6)
    poses = solver.follow(start, origin + share[1:, None] * displacement_m)
    path = make_interp_spline(share, np.vstack([start, poses]), k=3)
    profile = time_path(path, limits, settings.clock)
    details = {
        "velocity_share": velocity_share,
        "from_m": origin.tolist(),
        "to_m": (origin + displacement_m).tolist(),
    }
    plan = as_plan(profile, scene, settings.clock, kind="cartesian", moving=scene.joints, id=id, details=details)
    deviation = straightness_m(scene, plan)
    if deviation > STRAIGHT_M:
        raise NoPlan("the line is not straight", got=f"{1000 * deviation:.2f} mm", expected="1 mm")
    return replace(plan, details={**plan.details, "straightness_m": deviation})


def straightness_m(scene: Scene, plan: Plan) -> float:
    """How far the end effector is, at most, from the straight line between its first and last position [m]."""
    first, last = scene.pose(plan.start)[0], scene.pose(plan.goal)[0]
    along = (last - first) / np.linalg.norm(last - first)
    # A few samples per millimeter show the deviation as well as all of them: it changes over centimeters.
    rows = np.unique(np.linspace(0, len(plan.time_s) - 1, 400).astype(int))
    offsets = np.array([scene.pose(plan.position[row])[0] - first for row in rows])
    return float(np.linalg.norm(offsets - np.outer(offsets @ along, along), axis=1).max())


def random_line(
    scene: Scene,
    plane: Plane,
    rng: np.random.Generator,
    *,
    velocity_share: float,
    length_m: tuple[float, float] = (0.1, 0.4),
    settings: MotionSettings | None = None,
) -> Plan:
    """A line of random start, direction and length in a plane of the world.

    Raises:
        ConfigError: lengths without room.
        NoPlan: none of the attempts led to a line.
    """
    settings = settings or MotionSettings()
    if not 0 < length_m[0] <= length_m[1]:
        raise ConfigError("length_m must be a range of lengths", got=length_m)
    axes = ["xyz".index(axis) for axis in plane]

    def draw() -> tuple[Float64[np.ndarray, "J"], float, float]:
        return random_pose(scene, rng), rng.uniform(0, 2 * np.pi), rng.uniform(length_m[0], length_m[1])

    def plan(drawn: tuple[Float64[np.ndarray, "J"], float, float]) -> Plan:
        start, angle, length = drawn
        displacement = np.zeros(3)
        displacement[axes] = length * np.cos(angle), length * np.sin(angle)
        line = cartesian_line(scene, start, displacement, velocity_share=velocity_share, settings=settings)
        return replace(line, details={**line.details, "plane": plane, "length_m": length})

    return first_plan(draw, plan, settings.attempts, f"line in the {plane} plane")
