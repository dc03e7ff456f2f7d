"""In which state the windows of a fit really begin: nobody has measured that as well as the motion that follows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
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
# Steps to the best starts, at most; a share of the squares: after one that takes less away, there is no other;
# the shares of each that are tried, and how many standard deviations of its measurement a start may easily be away.
_ROUNDS, _GAINED, _SHARES, _EASILY = 6, 0.02, (1.0, 0.3), 3.0


@dataclass(frozen=True, eq=False)
class WindowStarts:
    """Where the windows of one segment begin, and what of their residual a start could explain.

    Attributes:
        position: beside the measured one, (W, J) [rad or m].
        velocity: likewise, (W, J) [rad/s or m/s].
        pieces: for each window, which residuals are its own, (M,), and an orthonormal basis of what a change of its
            start does to them, (M, K).
        lasting: whether they are good enough wherever a search goes from here.
    """

    position: Float64[np.ndarray, "W J"]
    velocity: Float64[np.ndarray, "W J"]
    pieces: tuple[tuple[Int[np.ndarray, "_"], Float64[np.ndarray, "_ _"]], ...] = ()
    lasting: bool = False

    def without(self, residuals: Float64[np.ndarray, "C N"]) -> Float64[np.ndarray, "C N"]:
        """Residuals of the segment without what a change of the starts explains of them.

        One candidate after the other, since how the product of a batch is rounded depends on its size.
        """
        left = residuals.copy()
        for own in left:
            for rows, basis in self.pieces:
                own[rows] -= basis @ (basis.T @ own[rows])
        return left


def window_starts(
    problem: Problem,
    z: Float64[np.ndarray, "P"],
    begun: Mapping[Segment, WindowStarts] | None = None,
    *,
    whole: bool = False,
) -> dict[Segment, WindowStarts]:
    """The starts of all windows that explain the logs best, with the parameters z.

    A window begins in the measured state, whose velocity is a difference of two noisy positions: at 100 Hz and 0.3
    mrad, 0.02 rad/s, which are 10 mrad after half a second. So the start x of each window is a parameter like the
    others, and since it changes this window alone, it is eliminated: with r the residual of a window and S = dr/dx,
    the residual of the best start is r - S (S^T S)^-1 S^T r, which is linear in r.

    Dry friction makes S itself depend on x. So S is that of the best start, found by a few steps of Gauss-Newton, each
    window's taken where it explains the window better. Where the problem has a larger time step for its derivatives, S
    is taken with that.

    A servo forgets where a whole motion began, and rests there: S is that of the measured start, and is kept. The first
    reading would be off by its noise, for good where a velocity is followed.

    Source: Golub, Pereyra 1973, "The differentiation of pseudo-inverses and nonlinear least squares problems whose
    variables separate"; multiple shooting with free states as by Bock 1983, "Recent advances in parameter
    identification techniques for ODE".

    Args:
        problem: with windows; its own `starts` do not count.
        z: of the free parameters, (P,).
        begun: starts that were the best of parameters nearby, from which one step is enough, with S as it is there;
            None begins where it was measured.
        whole: whether windows are whole motions of a servo.

    Returns:
        Starts by segment; of none whose motion cannot be simulated.
    """
    coarse = problem.coarse
    if whole and coarse is not None and coarse.size == problem.size and coarse.starts:
        # Slopes are taken there in any case.
        return {own: coarse.starts[other] for own, other in zip(problem.segments, coarse.segments, strict=True)}
    windows = _windows(problem)
    begun = begun or {}
    shifts = {
        segment: np.stack([begun[segment].position, begun[segment].velocity])
        if segment in begun
        else np.zeros((2, segment.plan.starts.size, _joints(problem)))
        for segment in problem.segments
    }
    known = {} if whole else {segment: _known(segment) for segment in problem.segments}
    last = np.inf
    for _ in range(0 if whole else 1 if begun else _ROUNDS):
        base, sensitivity = _residuals(problem, z, shifts), _slopes(problem, z, shifts)
        if not np.isfinite(base).all() or not np.isfinite(sensitivity).all():
            return {}
        variance = float(np.mean(base**2))
        if variance > (1.0 - _GAINED) * last:
            break
        last = variance
        moves = {}
        for segment, rows, window in _placed(windows):
            moves[segment] = np.zeros_like(shifts[segment])
            for number in range(segment.plan.starts.size):
                mine = np.flatnonzero(window == number)
                slope, left = sensitivity[rows][mine], base[rows][mine]
                held = np.diag(variance / (_EASILY * known[segment]) ** 2)
                pull = held @ shifts[segment][:, number].ravel()
                step = -np.linalg.solve(slope.T @ slope + held, slope.T @ left + pull)
                moves[segment][:, number] = step.reshape(2, -1)
        for share in _SHARES:
            tried = {segment: own + share * moves[segment] for segment, own in shifts.items()}
            found = _residuals(problem, z, tried)
            for segment, rows, window in _placed(windows):
                before, after = (np.bincount(window, own[rows] ** 2, segment.plan.starts.size) for own in (base, found))
                better = np.flatnonzero(after < before)
                shifts[segment][:, better] = tried[segment][:, better]
                moves[segment][:, better] = 0.0
    else:
        if whole or not begun:
            sensitivity = _slopes(problem, z, shifts)
    if not np.isfinite(sensitivity).all():
        return {}
    starts = {}
    for segment, rows, window in _placed(windows):
        pieces = []
        for number in range(segment.plan.starts.size):
            mine = np.flatnonzero(window == number)
            left, sizes, _ = np.linalg.svd(sensitivity[rows][mine], full_matrices=False)
            kept = sizes > _LEAST * sizes.max(initial=0.0)
            if kept.any():
                pieces.append((mine, left[:, kept]))
        starts[segment] = WindowStarts(shifts[segment][0], shifts[segment][1], tuple(pieces), whole)
    return starts


def _joints(problem: Problem) -> int:
    return len(problem.nominal.robot.joint_names)


def _known(segment: Segment) -> Float64[np.ndarray, "K"]:
    """How well the start of a window is measured: standard deviations of its positions, then of its velocities, (2 J,).

    White noise of variance s^2 has third differences of variance 20 s^2, and slopes over two samples of s^2 / (2 T^2).
    """
    measured = segment.plan.measured

    def noise(values: np.ndarray) -> np.ndarray:
        return np.asarray(np.sqrt(np.nanmean(np.diff(values.astype(np.float64), 3, axis=0) ** 2, axis=0) / 20.0))

    position = np.maximum(noise(measured["position"]), _POSITION)
    if "velocity" in measured:
        velocity = noise(measured["velocity"])
    else:
        velocity = position / (np.sqrt(2.0) * float(np.median(np.diff(measured.time_s))))
    return np.concatenate([position, np.maximum(velocity, _VELOCITY)])


def _residuals(
    problem: Problem, z: Float64[np.ndarray, "P"], shifts: Mapping[Segment, Float64[np.ndarray, "2 W J"]]
) -> Float64[np.ndarray, "N"]:
    starts = {segment: WindowStarts(position, velocity) for segment, (position, velocity) in shifts.items()}
    return np.asarray(problem.with_starts(starts).residuals(z[None])[0])


def _slopes(
    problem: Problem, z: Float64[np.ndarray, "P"], shifts: Mapping[Segment, Float64[np.ndarray, "2 W J"]]
) -> Float64[np.ndarray, "N K"]:
    """Derivatives of the residual by positions and then velocities of the starts."""
    coarse = problem.coarse
    if coarse is not None and coarse.size == problem.size:
        pairs = zip(coarse.segments, problem.segments, strict=True)
        problem, shifts = coarse, {other: shifts[own] for other, own in pairs}
    base, slopes = _residuals(problem, z, shifts), []
    for kind, step in enumerate((_POSITION, _VELOCITY)):
        for joint in range(_joints(problem)):
            moved = {segment: own.copy() for segment, own in shifts.items()}
            for own in moved.values():
                own[kind, :, joint] += step
            slopes.append((_residuals(problem, z, moved) - base) / step)
    return np.stack(slopes, axis=1)


def _placed(windows: Mapping[Segment, Int[np.ndarray, "M"]]) -> Iterator[tuple[Segment, slice, Int[np.ndarray, "M"]]]:
    """Each segment with its place in the residual, and the window of each of its rows."""
    begin = 0
    for segment, window in windows.items():
        yield segment, slice(begin, begin + window.size), window
        begin += window.size


def _windows(problem: Problem) -> dict[Segment, Int[np.ndarray, "M"]]:
    """The window of each residual, by segment."""
    found: dict[Segment, list[np.ndarray]] = {}
    for segment, signal, values in problem.by_segment(np.empty(problem.size)):
        window = (
            np.searchsorted(segment.plan.starts, np.flatnonzero(segment.rows(signal, problem.columns)), "right") - 1
        )
        found.setdefault(segment, []).append(np.repeat(window, values.shape[1]))
    return {segment: np.concatenate(own) for segment, own in found.items()}
