"""Estimate of the lag between a command and the motion that it causes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int

from trueup.core.timeseries import TimeSeries
from trueup.errors import DataError, NameMismatch, NotIdentifiable

_DRAWS = 400
_BLOCKS = 30
_SEED = 0
# The parabola through three points of a sampled peak is not better than this share of the grid step.
_RESOLUTION = 0.1


@dataclass(frozen=True)
class DelayEstimate:
    """How much later the measured motion is: measured(t) = source(t - delay_s).

    Attributes:
        delay_s: lag [s].
        low_s: lower end of its 95 % interval [s].
        high_s: upper end [s].
        correlation: normalized correlation at the lag, 1 for an exact copy; below about 0.5 the lag means little.
        at_limit: the best lag lies at an end of the searched range (0 or `max_delay_s`): the truth may be beyond.
        per_joint: the same for every joint that moves on both sides.
    """

    delay_s: float
    low_s: float
    high_s: float
    correlation: float
    at_limit: bool
    per_joint: Mapping[str, DelayEstimate] = field(default_factory=dict)


def estimate_delay(
    measured: TimeSeries,
    command: TimeSeries,
    *,
    max_delay_s: float,
    signal: str = "position",
    hold: bool = False,
    seed: int = _SEED,
) -> DelayEstimate:
    """Estimate the constant lag from command to motion.

    Maximizes the normalized cross-correlation of the two velocities on a common grid (twice the faster of the two
    rates), pooled over the joints in their own units, then refines by a parabola. The interval comes from a
    bootstrap over blocks of time that are longer than the lag, and is never narrower than a tenth of a grid step.

    What a position servo does to a command is not a pure delay: its lag depends on frequency and gains, and this is
    the one constant that fits best. It says how far to shift for a comparison, not how long the bus takes.

    Args:
        measured: what the robot did, (T, J), on its own clock.
        command: what was asked, on its own clock; joints are matched by name.
        max_delay_s: search limit [s]; must exceed the true lag, or the result is flagged `at_limit`. With a periodic
            command keep it below half a period.
        signal: `position` (compared by its velocities), or another signal of both, compared as it is.
        hold: the command acts as steps held between its stamps, as it does when it is replayed. Without, the
            command counts as smooth between its stamps, and half of its period is seen as lag on top.
        seed: of the bootstrap.

    Raises:
        NotIdentifiable: the command is constant, or no joint that is commanded moves.
        DataError: the two clocks have less than four times `max_delay_s` in common.
        NameMismatch: the two have no joint in common.
        MissingSignal: one of the two lacks the signal.
    """
    joints = [name for name in measured.joints if name in command.joints]
    if not joints:
        raise NameMismatch("no joint in common", left=command.joints, right=measured.joints, left_name="command")
    if not max_delay_s > 0.0:
        raise DataError("max_delay_s", got=max_delay_s, expected="above 0")
    if len(measured) < 2 or len(command) < 2:
        raise DataError("a lag needs two samples", got=f"{len(measured)} measured, {len(command)} commanded")
    step_s = 0.5 / max(measured.rate_hz, command.rate_hz)
    start, end = max(measured.time_s[0], command.time_s[0]), min(measured.time_s[-1], command.time_s[-1])
    if end - start < 4.0 * max_delay_s or end - start < 8.0 * step_s:
        raise DataError(
            "too short for this search limit",
            got=f"{max(end - start, 0.0):.3g} s in common",
            expected=f"at least {max(4.0 * max_delay_s, 8.0 * step_s):.3g} s",
        )
    # Half a step off the stamps: a step that falls exactly on a window's end would count on one side only.
    grid = np.arange(start + 0.5 * step_s, end, step_s)
    # Both sides get the same symmetric window, which shifts neither; one period turns steps into slopes again.
    width_s = 1.0 / min(measured.rate_hz, command.rate_hz)
    done = _on_grid(measured.select(joints), signal, grid, width_s=width_s, hold=False)
    asked = _on_grid(command.select(joints), signal, grid, width_s=width_s, hold=hold)
    moving = _moves(done) & _moves(asked)
    if not moving.any():
        which = "the command is constant" if not _moves(asked).any() else "no commanded joint moves"
        raise NotIdentifiable(
            f"the delay cannot be told: {which}", available=joints, hint="Use a motion with movement."
        )
    lags = int(np.ceil(max_delay_s / step_s)) + 1
    sums = np.stack([_block_sums(done[:, j], asked[:, j], lags) for j in np.flatnonzero(moving)])
    blocks = sums.shape[1]
    draws = np.random.default_rng(seed).multinomial(blocks, np.full(blocks, 1.0 / blocks), size=_DRAWS)
    names = [joints[j] for j in np.flatnonzero(moving)]
    per_joint = {name: _estimate(one, draws, step_s) for name, one in zip(names, sums, strict=True)}
    return replace(_estimate(sums.sum(axis=0), draws, step_s), per_joint=per_joint)


def _on_grid(
    series: TimeSeries, signal: str, grid: Float[np.ndarray, "N"], *, width_s: float, hold: bool
) -> Float[np.ndarray, "N J"]:
    """The signal at the grid, for positions its mean velocity over `width_s` around it; NaN is bridged."""
    ends = (grid - 0.5 * width_s, grid + 0.5 * width_s) if signal == "position" else (grid,)
    columns = []
    for column in series[signal].T.astype(np.float64):
        known = np.isfinite(column)
        if not known.any():
            columns.append(np.zeros(grid.size))
            continue
        time_s, values = series.time_s[known], column[known]
        if hold:
            at = [values[np.maximum(np.searchsorted(time_s, end, side="right") - 1, 0)] for end in ends]
        else:
            at = [np.interp(end, time_s, values) for end in ends]
        columns.append((at[1] - at[0]) / width_s if signal == "position" else at[0] - at[0].mean())
    return np.stack(columns, axis=1)


def _moves(values: Float[np.ndarray, "N J"]) -> Bool[np.ndarray, "J"]:
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)) > 1e-9)


def _block_sums(
    done: Float[np.ndarray, "N"], asked: Float[np.ndarray, "N"], lags: int
) -> Float[np.ndarray, "blocks 3 L"]:
    """Sums of done * asked, done^2 and asked^2 over blocks of time, for lags of -1 to `lags` samples."""
    from scipy.signal import correlate  # takes 0.3 s to load, which most commands do not need

    count = done.size - lags - 1
    blocks = int(np.clip(count // (2 * lags), 4, _BLOCKS))
    edges = np.linspace(0, count, blocks + 1).astype(int)
    sums = np.empty((blocks, 3, lags + 2))
    energy = np.concatenate([[0.0], np.cumsum(asked**2)])
    shift = np.arange(lags, -2, -1)
    for block, (low, high) in enumerate(pairwise(edges)):
        part = done[low + lags : high + lags]
        # asked[low : high + lags + 1] holds every shifted copy of the block; "valid" runs from the largest lag to -1.
        sums[block, 0] = correlate(asked[low : high + lags + 1], part, mode="valid", method="auto")[::-1]
        sums[block, 1] = np.dot(part, part)
        sums[block, 2] = (energy[high + lags - shift] - energy[low + lags - shift])[::-1]
    return sums


def _estimate(
    sums: Float[np.ndarray, "blocks 3 L"], draws: Int[np.ndarray, "D blocks"], step_s: float
) -> DelayEstimate:
    lag, correlation, at_limit = _peak(sums.sum(axis=0)[None])
    sampled, _, _ = _peak(np.tensordot(draws, sums, axes=(1, 0)))
    low, high = np.quantile(sampled, (0.025, 0.975)) - lag[0]
    # A bootstrap over few blocks understates the spread, as the normal distribution does beside Student's t.
    widen = 1.0 + 2.0 / (len(sums) - 1)
    low, high = min(low * widen, -_RESOLUTION), max(high * widen, _RESOLUTION)
    delay, low, high = (max(float(value), 0.0) * step_s for value in (lag[0], lag[0] + low, lag[0] + high))
    return DelayEstimate(delay, low, high, float(correlation[0]), bool(at_limit[0]))


def _peak(
    sums: Float[np.ndarray, "D 3 L"],
) -> tuple[Float[np.ndarray, "D"], Float[np.ndarray, "D"], Bool[np.ndarray, "D"]]:
    """Lag in samples, correlation there, and whether it is the first or last lag searched, for each of D draws."""
    norm = np.sqrt(np.maximum(sums[:, 1] * sums[:, 2], np.finfo(float).tiny))
    score = sums[:, 0] / norm
    inner = np.argmax(score[:, 1:-1], axis=1) + 1
    row = np.arange(len(score))
    before, here, after = score[row, inner - 1], score[row, inner], score[row, inner + 1]
    bend = before - 2.0 * here + after
    peaked = (bend < 0.0) & (here >= before) & (here >= after)
    offset = np.where(peaked, 0.5 * (before - after) / np.where(peaked, bend, -1.0), 0.0)
    lag = np.maximum(inner - 1 + offset, 0.0)  # column 0 is a lag of -1 sample
    return lag, here - 0.25 * (before - after) * offset, ~peaked
