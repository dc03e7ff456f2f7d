"""Curves inside the page: base64 float32, within a budget of bytes."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

from trueup.core.traces import EpisodeTraces

# plotly.js takes 1.9 MB, packed, and base64 makes 4 bytes of 3: the page stays below 12 MB.
BUDGET_BYTES = 6_500_000
# Below this a curve no longer looks like itself, so rather fewer motions.
MIN_POINTS = 240
_FLOAT_BYTES = 4


@dataclass(frozen=True)
class Embedded:
    """What fits into the page.

    Attributes:
        episodes: the episodes, in the order given.
        max_points: rows per curve at most.
        left_out: number of episodes for which there was no room.
    """

    episodes: Sequence[EpisodeTraces]
    max_points: int
    left_out: int

    @property
    def thinned(self) -> bool:
        """Whether any curve shows fewer samples than were recorded."""
        return any(trace.time_s.size < trace.samples for episode in self.episodes for trace in episode.traces)


def fit_to_budget(episodes: Sequence[EpisodeTraces], *, budget_bytes: int = BUDGET_BYTES) -> Embedded:
    """Thin all curves to the largest common number of points that fits; if that is too few, drop the last episodes.

    Args:
        episodes: most important first.
        budget_bytes: size of all curves before base64.
    """
    sizes = [_sizes(episode) for episode in episodes]
    longest = max((int(size[:, 0].max()) for size in sizes if size.size), default=MIN_POINTS)
    low, high = min(MIN_POINTS, longest), longest
    kept = _fitting(sizes, low, budget_bytes)
    while low < high:
        middle = (low + high + 1) // 2
        if _fitting(sizes, middle, budget_bytes) == len(episodes):
            low = middle
        else:
            high = middle - 1
    chosen = [episode.thinned(low) for episode in episodes[:kept]]
    return Embedded(chosen, low, len(episodes) - kept)


def to_base64(values: Float32[np.ndarray, "N"]) -> str:
    """Little-endian float32 as text."""
    return base64.b64encode(values.astype("<f4").tobytes()).decode("ascii")


def _sizes(episode: EpisodeTraces) -> np.ndarray:
    """Rows and columns (time and curves) of every trace, (N, 2)."""
    return np.array([(trace.time_s.size, 1 + len(trace.curves)) for trace in episode.traces]).reshape(-1, 2)


def _fitting(sizes: Sequence[np.ndarray], points: int, budget_bytes: int) -> int:
    """How many of the first episodes fit at `points` rows per curve."""
    bytes_each = [int((np.minimum(size[:, 0], points) * size[:, 1]).sum()) * _FLOAT_BYTES for size in sizes]
    return int(np.searchsorted(np.cumsum(bytes_each), budget_bytes, side="right"))
