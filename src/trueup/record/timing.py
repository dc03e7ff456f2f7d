"""When a robot is where on a path: the fastest motion within limits, by TOPP-RA.

Pham, Pham: A New Approach to Time-Optimal Path Parameterization Based on Reachability Analysis, T-RO 2018.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float64

from trueup.errors import ConfigError, NoPlan
from trueup.record.limits import JointLimits
from trueup.record.packages import load
from trueup.record.profile import ClockSettings, Profile, averaged

# The constraints are held at so many points of a path, and a little more tightly than asked for in between.
_POINTS = 120
_MARGIN = 1 - 1e-6


def rounded(way: Float64[np.ndarray, "K J"], spacing: float) -> Any:
    """A path through the ends of a polyline and around its corners, as a cubic B-spline that has a curvature.

    The polyline is cut into pieces of at most `spacing` [rad or m]; their ends are the control points. Thus the path
    leaves the polyline only within about two spacings of a corner, and never its convex hull: a joint that does not
    move along the polyline does not move here.
    """
    from scipy.interpolate import BSpline

    least = 3 if len(way) == 2 else 2  # a cubic needs four points
    pieces = []
    for a, b in pairwise(way):
        count = max(least, int(np.ceil(np.linalg.norm(b - a) / spacing)))
        pieces.append(a + np.linspace(0, 1, count + 1)[1:, None] * (b - a))
    points = np.vstack([way[:1], *pieces])
    inner = np.linspace(0, 1, len(points) - 2)
    return BSpline(np.concatenate([np.zeros(3), inner, np.ones(3)]), points, 3)


def time_path(path: Any, limits: JointLimits, clock: ClockSettings) -> Profile:
    """Follow a path as fast as the limits allow, from rest to rest.

    Args:
        path: scipy's `BSpline` over [0, 1] with values (J,), twice differentiable.
        limits: what to keep; those of `JointLimits.scaled` for a slower motion.
        clock: step and smoothing.

    Raises:
        NoPlan: TOPP-RA finds no parameterization.
        ConfigError: the path does not move.
    """
    toppra, algorithm = load("toppra"), load("toppra.algorithm")
    constraint, interpolator = load("toppra.constraint"), load("toppra.interpolator")
    if not np.ptp(path.c, axis=0).any():
        raise ConfigError("the path does not move", hint="Choose a goal that differs from the start.")

    class Geometry(interpolator.AbstractGeometricPath):  # type: ignore[misc, name-defined]
        dof = path.c.shape[1]
        path_interval = np.array([0.0, 1.0])
        waypoints = None

        def __call__(self, where: Any, order: int = 0) -> Any:
            return path(where, nu=order)

    # Joints that do not move have no limits to keep, and would only be rows of zeros.
    moves = np.ptp(path.c, axis=0) > 0
    speed = np.where(moves, _MARGIN * limits.velocity, 1e6)
    thrust = np.where(moves, _MARGIN * limits.acceleration, 1e6)
    toppra.setup_logging("ERROR")
    method = algorithm.TOPPRA(
        [
            constraint.JointVelocityConstraint(np.stack([-speed, speed], axis=1)),
            constraint.JointAccelerationConstraint(
                np.stack([-thrust, thrust], axis=1),
                discretization_scheme=constraint.DiscretizationType.Interpolation,
            ),
        ],
        Geometry(),
        gridpoints=np.linspace(0, 1, max(_POINTS, 4 * len(path.c)) + 1),
        parametrizer="ParametrizeConstAccel",
    )
    _, rate, _ = method.compute_parameterization(0, 0)
    if rate is None or not np.isfinite(rate).all() or not (rate[1:] + rate[:-1] > 0).all():
        raise NoPlan("no timing keeps the limits along the path", hint="Choose another goal or higher limits.")
    schedule = _Schedule(method.problem_data.gridpoints, rate)
    least = schedule.least_steps(clock)
    profile = schedule.sampled(path, clock, least)
    usage = profile.usage(limits, clock.timestep_s)
    if usage > 1:  # between the points at which the constraints are held
        profile = schedule.sampled(path, clock, 1 + int(np.ceil(usage * least)))
    return averaged(profile, round(clock.smoothing_s * clock.rate_hz), clock.timestep_s)


class _Schedule:
    """Where on the path the robot is when: the path's parameter accelerates evenly between grid points.

    Args:
        grid: values of the parameter, (G,).
        rate: its derivative with respect to time at these, (G,).
    """

    def __init__(self, grid: Float64[np.ndarray, "G"], rate: Float64[np.ndarray, "G"]) -> None:
        self._grid, self._rate = grid, rate
        self._times = np.concatenate([[0.0], np.cumsum(2 * np.diff(grid) / (rate[1:] + rate[:-1]))])
        self._thrust = (rate[1:] ** 2 - rate[:-1] ** 2) / (2 * np.diff(grid))

    def least_steps(self, clock: ClockSettings) -> int:
        """The number of the clock's steps that is no faster than the schedule."""
        return max(1, int(np.ceil(float(self._times[-1]) * clock.rate_hz - 1e-9)))

    def sampled(self, path: Any, clock: ClockSettings, count: int) -> Profile:
        """The motion in `count` steps of the clock, as much slower as it must be for that."""
        duration = float(self._times[-1])
        slower = count * clock.timestep_s / duration
        time_s = np.linspace(0, duration, count + 1)
        piece = np.clip(np.searchsorted(self._times, time_s, side="right") - 1, 0, len(self._thrust) - 1)
        since = time_s - self._times[piece]
        where = self._grid[piece] + since * (self._rate[piece] + since * self._thrust[piece] / 2)
        rate = ((self._rate[piece] + since * self._thrust[piece]) / slower)[:, None]
        thrust = (self._thrust[piece] / slower**2)[:, None]
        where = np.clip(where, 0.0, 1.0)
        slope, bend = path(where, nu=1), path(where, nu=2)
        profile = Profile(path(where), slope * rate, bend * rate**2 + slope * thrust)
        profile.velocity[[0, -1]] = 0.0
        profile.position[-1] = path.c[-1]
        # Splines of a constant are constant up to rounding; a joint that does not move does not move at all.
        still = np.ptp(path.c, axis=0) == 0
        profile.position[:, still] = path.c[0, still]
        profile.velocity[:, still] = profile.acceleration[:, still] = 0.0
        return profile
