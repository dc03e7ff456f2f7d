"""How far a correction can be trusted: intervals, the probability of "far off", and the length of the warm-up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float64
from scipy.optimize import isotonic_regression

from trueup.augment.corrector import Corrector
from trueup.augment.pairs import Pairs
from trueup.augment.training import predictions, side_by_side

# Ratios of an error to what is expected are counted in bins of 2 %.
_RATIO_EDGES = np.geomspace(1e-3, 1e3, 700)
# A simulator that is off by more than this many times its RMS error is far off.
_FAR = 2.0
_FAR_BINS = 40
_FEWEST_IN_A_BIN = 30
_LONGEST_WARMUP_S = 1.0
_WARM = 1.1


@dataclass(frozen=True)
class Intervals:
    """Half widths `base + slope * |correction|` per output.

    Attributes:
        base: (K,) [unit of the output].
        slope: (K,).
        note: what limits their coverage; empty if nothing does.
    """

    base: tuple[float, ...]
    slope: tuple[float, ...]
    note: str


def intervals_of(corrector: Corrector, pairs: Pairs, coverage: float) -> Intervals:
    """Intervals that cover a share of the samples of a new motion, on average over motions.

    The width grows with the correction as absolute errors on val do. Its factor is chosen by conformal risk control
    (Angelopoulos et al., 2022) over whole motions: the smallest one for which (n R + 1) / (n + 1) <= 1 - coverage,
    where R is the mean over the n motions of the share of samples outside. With fewer than coverage / (1 - coverage)
    motions there is none; then the share on val itself is taken, and the note says so.
    """
    base, slope = _shape(corrector, pairs)
    motions = pairs.episodes
    share = 1 / len(pairs.motions)
    risk = np.zeros((base.size, _RATIO_EDGES.size))  # of the factor at each edge
    for _, simulated, corrected, measured in predictions(corrector, pairs):
        error = np.abs(measured.astype(float) - corrected)
        ratio = error / (base + slope * np.abs(corrected.astype(float) - simulated))
        for output in range(base.size):
            counts = np.bincount(np.searchsorted(_RATIO_EDGES, ratio[:, output]), minlength=_RATIO_EDGES.size + 1)
            risk[output] += (1 - np.cumsum(counts)[:-1] / len(ratio)) * share
    allowed = 1 - coverage
    needed = int(np.ceil(coverage / allowed - 1e-9))  # 0.9 / (1 - 0.9) is a little more than 9
    enough = motions >= needed
    bound = ((motions * risk + 1) / (motions + 1) if enough else risk) <= allowed + 1e-12
    factor = _RATIO_EDGES[np.where(bound.any(axis=1), bound.argmax(axis=1), _RATIO_EDGES.size - 1)]
    note = "" if enough else f"{motions} val motions; {needed} are needed to promise {100 * coverage:.0f} % coverage"
    return Intervals(tuple((factor * base).tolist()), tuple((factor * slope).tolist()), note)


def _shape(corrector: Corrector, pairs: Pairs) -> tuple[Float64[np.ndarray, "K"], Float64[np.ndarray, "K"]]:
    """Least-squares line of absolute errors over absolute corrections, with no negative slope or width."""
    sums = np.zeros((5, len(pairs.outputs)))
    for _, simulated, corrected, measured in predictions(corrector, pairs):
        error = np.abs(measured.astype(float) - corrected)
        size = np.abs(corrected.astype(float) - simulated)
        sums += [np.full(sums.shape[1], len(error)), *(v.sum(axis=0) for v in (size, error, size**2, size * error))]
    count, size, error, squares, products = sums
    spread = count * squares - size**2
    slope = np.where(spread > 0, (count * products - size * error) / np.where(spread > 0, spread, 1), 0.0)
    slope = np.maximum(slope, 0.0)
    base = (error - slope * size) / count
    # A line through zero would promise exactness where nothing is corrected.
    floor = 0.2 * error / count
    return np.maximum(np.maximum(base, floor), 1e-12), slope


@dataclass(frozen=True)
class FarOff:
    """When the simulator is far off, per output.

    Attributes:
        threshold: an error beyond this is far off, (K,) [unit].
        correction: sizes of corrections, increasing, (K, N) [unit].
        probability: of "far off" there, not decreasing, (K, N).
    """

    threshold: tuple[float, ...]
    correction: tuple[tuple[float, ...], ...]
    probability: tuple[tuple[float, ...], ...]


def far_off(corrector: Corrector, pairs: Pairs, simulator_rms: Float64[np.ndarray, "K"]) -> FarOff:
    """How likely the simulator is off by more than twice its RMS error, given the size of a correction.

    Shares of val samples in bins of the correction's size, made monotone (isotonic regression).

    Args:
        corrector: trained, with its gate.
        pairs: val.
        simulator_rms: error of the simulator on train, (K,).
    """
    width = simulator_rms.size
    threshold = _FAR * simulator_rms
    edges = np.geomspace(0.02, 5.0, _FAR_BINS)[:, None] * np.maximum(threshold, 1e-12)
    total, far = np.zeros((_FAR_BINS + 1, width)), np.zeros((_FAR_BINS + 1, width))
    sizes = np.zeros((_FAR_BINS + 1, width))
    for _, simulated, corrected, measured in predictions(corrector, pairs):
        size = np.abs(corrected.astype(float) - simulated)
        off = np.abs(measured.astype(float) - simulated) > threshold
        for output in range(width):
            bins = np.searchsorted(edges[:, output], size[:, output])
            total[:, output] += np.bincount(bins, minlength=_FAR_BINS + 1)
            far[:, output] += np.bincount(bins, off[:, output], minlength=_FAR_BINS + 1)
            sizes[:, output] += np.bincount(bins, size[:, output], minlength=_FAR_BINS + 1)
    corrections, probabilities = [], []
    for output in range(width):
        counts, hits, sums = (_merged(part[:, output], total[:, output]) for part in (total, far, sizes))
        fitted = isotonic_regression(hits / counts, weights=counts).x
        corrections.append(tuple((sums / counts).tolist()))
        probabilities.append(tuple(np.clip(fitted, 0.0, 1.0).tolist()))
    return FarOff(tuple(threshold.tolist()), tuple(corrections), tuple(probabilities))


def _merged(values: Float64[np.ndarray, "N"], counts: Float64[np.ndarray, "N"]) -> Float64[np.ndarray, "M"]:
    """Neighboring bins put together until each has enough samples."""
    sums: list[float] = []
    held, held_count = 0.0, 0.0
    for value, count in zip(values, counts, strict=True):
        held, held_count = held + value, held_count + count
        if held_count >= _FEWEST_IN_A_BIN:
            sums.append(held)
            held, held_count = 0.0, 0.0
    if held_count and sums:
        sums[-1] += held
    elif held_count:
        sums.append(held)
    return np.array(sums)


def warmup_steps(corrector: Corrector, pairs: Pairs, rate_hz: float) -> int:
    """Samples after which a stream that starts in the middle of a motion is as good as one from the motion's start.

    The first sample from which on its squared error, over outputs in units of the loss and over motions, stays within
    10 % of the other's; at most one second.
    """
    if not corrector.network.causal or not corrector.states:
        return 0
    longest = max(1, round(_LONGEST_WARMUP_S * rate_hz))
    late, early = np.zeros(longest), np.zeros(longest)
    scale = corrector.loss_scale.cpu().numpy()
    place = corrector.center.device
    used = corrector.gate.cpu().numpy() > 0
    if not used.any():
        return 0
    corrector.eval()
    with torch.no_grad():
        for _, batch in side_by_side(corrector, pairs):
            starts = batch.lengths // 3
            many = np.minimum(longest, batch.lengths - starts)
            ends = starts + many
            seen = batch.x[: ends.max()]  # of a causal network, no more counts
            rest = np.zeros((many.max(), *seen.shape[1:]), np.float32)
            for motion, (start, end) in enumerate(zip(starts, ends, strict=True)):
                rest[: end - start, motion] = seen[start:end, motion]
            whole, cold = (
                corrector(torch.from_numpy(x).to(place), torch.from_numpy(lengths).to(place)).cpu().numpy()
                for x, lengths in ((seen, ends), (rest, many))
            )
            for motion, (start, end) in enumerate(zip(starts, ends, strict=True)):
                for sums, values in ((late, cold[: end - start]), (early, whole[start:end])):
                    error = (values[:, motion] - batch.y[start:end, motion]) / scale
                    sums[: end - start] += (error[:, used] ** 2).sum(axis=1)
    behind = late > _WARM * early + 1e-12
    return int(np.flatnonzero(behind)[-1]) + 1 if behind.any() else 0
