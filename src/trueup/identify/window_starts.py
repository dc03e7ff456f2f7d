"""In which state the windows of a fit really begin: nobody has measured that as well as the motion that follows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64, Int

if TYPE_CHECKING:
    from trueup.identify.problem import Problem
    from trueup.identify.segments import Segment

# Steps of the differences [rad or m] and [rad/s or m/s].
_POSITION, _VELOCITY = 1e-4, 1e-3
# A direction of a start that changes the motion by less than this share of the others (the speed of a joint that
# sticks, say) is left.
_LEAST = 1e-3
_ROUNDS = 2


@dataclass(frozen=True, eq=False)
class WindowStarts:
    """Where the windows of one segment begin, and what of their residual a start could explain.

    Attributes:
        position: beside the measured one, (W, J) [rad or m].
        velocity: likewise, (W, J) [rad/s or m/s].
        pieces: for each window, which residuals are its own, (M,), and an orthonormal basis of what a change of its
            start does to them, (M, K).
    """

    position: Float64[np.ndarray, "W J"]
    velocity: Float64[np.ndarray, "W J"]
    pieces: tuple[tuple[Int[np.ndarray, "M"], Float64[np.ndarray, "M K"]], ...] = ()

    def without(self, residuals: Float64[np.ndarray, "C N"]) -> Float64[np.ndarray, "C N"]:
        """Residuals of the segment without what a change of the starts explains of them."""
        left = residuals.copy()
        for rows, basis in self.pieces:
            left[:, rows] -= (residuals[:, rows] @ basis) @ basis.T
        return left


def window_starts(problem: Problem, z: Float64[np.ndarray, "P"]) -> dict[Segment, WindowStarts]:
    """The starts of all windows that explain the logs best, with the parameters z.

    A window begins in the measured state, whose velocity is a difference of two noisy positions: at 100 Hz and 0.3
    mrad, 0.02 rad/s, which are 10 mrad after half a second. So the start x of each window is a parameter like the
    others, and since it changes this window alone, it is eliminated: with r the residual of a window and S = dr/dx,
    the residual of the best start is r - S (S^T S)^-1 S^T r, which is linear in r.

    Source: Golub, Pereyra 1973, "The differentiation of pseudo-inverses and nonlinear least squares problems whose
    variables separate"; multiple shooting with free states as by Bock 1983, "Recent advances in parameter
    identification techniques for ODE".

    Args:
        problem: with windows; its own `starts` do not count.
        z: of the free parameters, (P,).

    Returns:
        Starts by segment; of none whose motion cannot be simulated.
    """
    joints = len(problem.nominal.robot.joint_names)
    shifts = {segment: np.zeros((2, segment.plan.starts.size, joints)) for segment in problem.segments}
    found: dict[Segment, WindowStarts] = {}
    for last in range(_ROUNDS):
        base = _residuals(problem, z, shifts)
        slopes = []
        for kind, step in enumerate((_POSITION, _VELOCITY)):
            for joint in range(joints):
                moved = {segment: own.copy() for segment, own in shifts.items()}
                for own in moved.values():
                    own[kind, :, joint] += step
                slopes.append((_residuals(problem, z, moved) - base) / step)
        sensitivity = np.stack(slopes, axis=1)
        if not np.isfinite(sensitivity).all() or not np.isfinite(base).all():
            return {}
        begin = 0
        for segment, window in _windows(problem).items():
            rows = slice(begin, begin + window.size)
            begin += window.size
            pieces, own = [], shifts[segment]
            for number in range(segment.plan.starts.size):
                mine = np.flatnonzero(window == number)
                left, sizes, right = np.linalg.svd(sensitivity[rows][mine], full_matrices=False)
                kept = sizes > _LEAST * sizes.max(initial=0.0)
                if not kept.any():
                    continue
                pieces.append((mine, left[:, kept]))
                if last < _ROUNDS - 1:
                    change = -(right[kept].T / sizes[kept]) @ (left[:, kept].T @ base[rows][mine])
                    own[:, number] += change.reshape(2, joints)
            found[segment] = WindowStarts(own[0], own[1], tuple(pieces))
    return found


def _residuals(
    problem: Problem, z: Float64[np.ndarray, "P"], shifts: Mapping[Segment, Float64[np.ndarray, "2 W J"]]
) -> Float64[np.ndarray, "N"]:
    starts = {segment: WindowStarts(position, velocity) for segment, (position, velocity) in shifts.items()}
    return np.asarray(problem.with_starts(starts).residuals(z[None])[0])


def _windows(problem: Problem) -> dict[Segment, Int[np.ndarray, "M"]]:
    """The window of each residual, by segment."""
    found: dict[Segment, list[np.ndarray]] = {}
    for segment, signal, values in problem.by_segment(np.empty(problem.size)):
        window = (
            np.searchsorted(segment.plan.starts, np.flatnonzero(segment.rows(signal, problem.columns)), "right") - 1
        )
        found.setdefault(segment, []).append(np.repeat(window, values.shape[1]))
    return {segment: np.concatenate(own) for segment, own in found.items()}
