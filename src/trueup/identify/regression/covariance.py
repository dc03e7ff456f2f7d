"""Covariance of least-squares coefficients whose errors are not independent from row to row.

Residuals of a robot's motions are autocorrelated: what the equation lacks lasts for many samples. The textbook formula
would then give intervals that are too narrow by a factor of three to ten.

- With enough episodes, each is left out in turn (the cluster jackknife, CR3): whatever happens within an episode is
  covered, and episodes with leverage are not trusted too much. Quantiles are those of Student's t with G - 1 degrees.
- With few, the long-run variance of the scores is estimated within the episodes (Newey and West 1987, Econometrica 55,
  703-708; bandwidth of Andrews 1991, Econometrica 59, 817-858, eq. 6.2 and 6.4). The estimate itself is noisy: it has
  the equivalent degrees of freedom of a Bartlett window, 3 N / bandwidth.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float64, Int
from scipy.special import stdtrit

ENOUGH_EPISODES = 10
_WORST_CONDITION = 1e10
_MOST_SHARE = 0.25  # the bandwidth is at most this share of the longest episode

Method = Literal["cluster", "hac"]


class Covariance(NamedTuple):
    """What is known about the error of P coefficients.

    Attributes:
        matrix: covariance, (P, P).
        degrees: degrees of freedom of Student's t for intervals.
        method: `cluster` (episodes left out in turn) or `hac` (autocorrelation within episodes).
    """

    matrix: Float64[np.ndarray, "P P"]
    degrees: float
    method: Method

    @property
    def standard_error(self) -> Float64[np.ndarray, "P"]:
        """Square roots of the diagonal."""
        return np.sqrt(np.maximum(np.diag(self.matrix), 0.0))

    def half_width(self, level: float = 0.95) -> Float64[np.ndarray, "P"]:
        """Half the width of the interval of each coefficient."""
        return np.asarray(-stdtrit(self.degrees, 0.5 * (1.0 - level)) * self.standard_error)


def robust_covariance(
    grams: Float64[np.ndarray, "G P P"], scores: Float64[np.ndarray, "N P"], episode: Int[np.ndarray, "N"]
) -> Covariance:
    """Covariance of the coefficients of a (weighted) least-squares fit.

    Args:
        grams: X' W X of each episode; their sum must be regular.
        scores: X_t' W_t residual_t of each row (of all outputs at that time), in the order of time.
        episode: number of the episode of each row, 0 to G - 1, not decreasing.
    """
    scale = 1.0 / np.sqrt(np.diag(grams.sum(axis=0)))
    grams, scores = grams * scale[:, None] * scale, scores * scale
    result = _jackknife(grams, scores, episode) if len(grams) >= ENOUGH_EPISODES else None
    if result is None:
        result = _newey_west(grams.sum(axis=0), scores, episode)
    return result._replace(matrix=result.matrix * scale[:, None] * scale)


def _jackknife(
    grams: Float64[np.ndarray, "G P P"], scores: Float64[np.ndarray, "N P"], episode: Int[np.ndarray, "N"]
) -> Covariance | None:
    """None where one episode alone carries a coefficient."""
    count = len(grams)
    sums = np.stack([np.bincount(episode, weights=column, minlength=count) for column in scores.T], axis=1)
    without = grams.sum(axis=0) - grams
    if np.linalg.cond(without).max() > _WORST_CONDITION:
        return None
    shifts = -np.linalg.solve(without, sums[:, :, None])[:, :, 0]
    return Covariance((count - 1) / count * shifts.T @ shifts, float(count - 1), "cluster")


def _newey_west(
    gram: Float64[np.ndarray, "P P"], scores: Float64[np.ndarray, "N P"], episode: Int[np.ndarray, "N"]
) -> Covariance:
    rows, width = scores.shape
    influence = np.linalg.solve(gram, scores.T).T
    influence = influence * np.sqrt(rows / max(rows - width, 1))
    starts = np.flatnonzero(np.diff(episode, prepend=-1))
    lengths = np.diff(np.append(starts, rows))
    window = _bandwidth(influence, episode, int(lengths.max()))
    total = np.zeros((width, width))
    for begin, length in zip(starts, lengths, strict=True):
        # Summed over all windows that touch the episode, squares of window sums weigh a lag k by 1 - k / window.
        padded = np.zeros((length + 2 * window, width))
        np.cumsum(influence[begin : begin + length], axis=0, out=padded[window : window + length])
        padded[window + length :] = padded[window + length - 1]
        sums = padded[window:] - padded[:-window]
        total += sums.T @ sums / window
    return Covariance(total, max(3.0 * rows / window, 2.0), "hac")


def _bandwidth(influence: Float64[np.ndarray, "N P"], episode: Int[np.ndarray, "N"], longest: int) -> int:
    """Andrews' bandwidth for the Bartlett kernel from first-order autoregressions, all coefficients weighing alike."""
    inside = (episode[1:] == episode[:-1])[:, None]
    squares = (influence[:-1] ** 2 * inside).sum(axis=0)
    rho = (influence[:-1] * influence[1:] * inside).sum(axis=0) / np.where(squares > 0.0, squares, 1.0)
    rho = np.clip(rho, -0.995, 0.995)
    spread = ((influence[1:] - rho * influence[:-1]) ** 2 * inside).mean(axis=0)
    long_run = spread / (1.0 - rho) ** 2
    weight = 1.0 / np.where(long_run > 0.0, long_run, np.inf) ** 2
    bend = (4.0 * rho**2 * spread**2 / ((1.0 - rho) ** 6 * (1.0 + rho) ** 2) * weight).sum()
    alpha = bend / max((long_run**2 * weight).sum(), 1e-300)
    window = 1.1447 * (alpha * len(influence)) ** (1.0 / 3.0)
    return int(np.clip(np.ceil(window), 1, max(1, _MOST_SHARE * longest)))
