"""Curves inside the page: 14 bits a value, packed by gzip, within a budget of bytes."""

from __future__ import annotations

import base64
import gzip
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int64

from trueup.core.traces import MEASURED, EpisodeTraces, Trace

# Beside plotly.js, which takes 1.9 MB, the page stays below 5 MB.
BUDGET_BYTES = 2_400_000
# Below this a curve no longer looks like itself, so rather fewer motions.
MIN_POINTS = 240
# The largest code of a value, a twentieth of a pixel where a curve fills its figure; the code of none.
_LARGEST, _NO_VALUE = 8_191, -32_768
# Share of the budget that a guess of the number of points aims at.
_AIM = 0.97


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


@dataclass(frozen=True)
class Packed:
    """Curves as the page holds them.

    Attributes:
        text: all curves, one after the other: for each trace its clock and its curves, in base64.
        index: for each episode what `EpisodeTraces.pack` says of it, and for each of its traces `codes`: middle and
            step of the clock and of each curve.
    """

    text: str
    index: list[dict[str, Any]]


def packed(data: bytes) -> str:
    """By gzip, in base64, which report.js unpacks; equal data give equal text."""
    return base64.b64encode(gzip.compress(data, mtime=0)).decode("ascii")


def fit_to_budget(episodes: Sequence[EpisodeTraces], *, budget_bytes: int = BUDGET_BYTES) -> Embedded:
    """Thin all curves to a common number of points at which they fit; if that is too few, drop the last episodes.

    Args:
        episodes: most important first.
        budget_bytes: size of all curves in the page.
    """
    points = max((trace.time_s.size for episode in episodes for trace in episode.traces), default=MIN_POINTS)
    kept = len(episodes)
    while True:
        chosen = [episode.thinned(points) for episode in episodes[:kept]]
        size = len(pack(chosen).text)
        if size <= budget_bytes or not kept:
            return Embedded(chosen, points, len(episodes) - kept)
        share = _AIM * budget_bytes / size
        if points > MIN_POINTS:
            points = max(MIN_POINTS, int(share * points))
        else:
            kept = min(kept - 1, int(share * kept))


def pack(episodes: Sequence[EpisodeTraces]) -> Packed:
    """Curves as integers: a value is middle + step * code.

    The measured curve is coded by itself, the others by their difference from it, which is drawn, too; where it has no
    value, by that from its middle. Each code stands as its change from the one before, with the sign in the last bit;
    first the low bytes of all, then the high ones, which are mostly zero.
    """
    changes: list[Int64[np.ndarray, "K"]] = []
    index = []
    for episode in episodes:
        _, about = episode.pack()
        for item, trace in zip(about["traces"], episode.traces, strict=True):
            item["codes"] = []
            for values in _coded_of(trace):
                codes, scale = _codes(values)
                item["codes"].append(scale)
                steps = np.diff(codes, prepend=0)
                steps = (steps - _NO_VALUE) % 65_536 + _NO_VALUE  # the reader counts in 16 bits
                changes.append(np.where(steps < 0, -2 * steps - 1, 2 * steps))
        index.append(about)
    every = np.concatenate([np.empty(0, np.int64), *changes])
    planes = np.concatenate([every % 256, every // 256]).astype(np.uint8)
    return Packed(packed(planes.tobytes()), index)


def _coded_of(trace: Trace) -> Iterator[Float[np.ndarray, "K"]]:
    """The clock, and for each curve what is coded of it, in the order of `trace.curves`."""
    yield trace.time_s.astype(np.float64)
    measured = trace.curves[MEASURED].astype(np.float64)
    _, (middle, _) = _codes(measured)
    base = np.where(np.isfinite(measured), measured, middle)
    for label, values in trace.curves.items():
        yield measured if label == MEASURED else values - base


def _codes(values: Float[np.ndarray, "K"]) -> tuple[Int64[np.ndarray, "K"], list[float]]:
    """Codes, (K,), and middle and step of the values."""
    known = np.isfinite(values)
    low, high = (float(values[known].min()), float(values[known].max())) if known.any() else (0.0, 0.0)
    middle, step = 0.5 * low + 0.5 * high, 0.5 * (high / _LARGEST - low / _LARGEST)
    codes = np.round((np.where(known, values, middle) - middle) / (step or 1.0)).astype(np.int64)
    return np.where(known, codes.clip(-_LARGEST, _LARGEST), _NO_VALUE), [middle, step]
