"""Pieces of motions for training: which ones, and the batches that they make."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int

from trueup.augment.config import WindowConfig
from trueup.augment.pairs import Pairs

# Rows of whole motions, padding included, that are predicted at once.
_ROWS_AT_ONCE = 64_000
_MANY = 16


@dataclass(frozen=True, eq=False)
class Batch:
    """Pieces side by side, padded with zeros behind their ends.

    Attributes:
        x: inputs, (T, B, I).
        y: measured outputs, (T, B, K).
        lengths: valid samples, (B,).
    """

    x: Float32[np.ndarray, "T B I"]
    y: Float32[np.ndarray, "T B K"]
    lengths: Int[np.ndarray, "B"]


class Windows:
    """Draws the batches of an epoch.

    Args:
        pairs: the train split.
        config: rule, length, number of draws.
        batch: pieces in a batch.
    """

    def __init__(self, pairs: Pairs, config: WindowConfig, batch: int) -> None:
        self._pairs = pairs
        self._config = config
        self._batch = batch
        self._rows = np.array([motion.rows for motion in pairs.motions])

    def __len__(self) -> int:
        """Batches in an epoch."""
        if self._config.rule == "half-shortest":
            return self._config.draws * int(np.ceil(self._rows.size / self._batch))
        pieces = self._config.draws * self._rows.sum() / self._config.samples
        return max(1, round(float(pieces) / self._batch))

    def epoch(self, rng: np.random.Generator) -> Iterator[Batch]:
        """The batches of one epoch."""
        yield from self._half_shortest(rng) if self._config.rule == "half-shortest" else self._fixed(rng)

    def _half_shortest(self, rng: np.random.Generator) -> Iterator[Batch]:
        """Each motion `draws` times, as long as half the shortest of its batch (LSTM thesis, 3.2)."""
        for _ in range(self._config.draws):
            order = rng.permutation(self._rows.size)
            for start in range(0, order.size, self._batch):
                chosen = order[start : start + self._batch]
                length = max(2, int(self._rows[chosen].min()) // 2)
                starts = rng.integers(0, np.maximum(self._rows[chosen] - length, 0) + 1)
                yield self._cut(chosen, starts, length)

    def _fixed(self, rng: np.random.Generator) -> Iterator[Batch]:
        """Motions drawn by their length; see `WindowConfig` for where windows lie."""
        length = self._config.samples
        share = self._rows / self._rows.sum()
        for _ in range(len(self)):
            chosen = rng.choice(self._rows.size, self._batch, p=share)
            starts = rng.integers(-(length // 4), np.maximum(self._rows[chosen] - 3 * length // 4, 1))
            yield self._cut(chosen, np.maximum(starts, 0), length)

    def _cut(self, chosen: Int[np.ndarray, "B"], starts: Int[np.ndarray, "B"], length: int) -> Batch:
        width = len(self._pairs.inputs)
        lengths = np.minimum(length, self._rows[chosen] - starts)
        both = np.zeros((int(lengths.max()), chosen.size, width + len(self._pairs.outputs)), np.float32)
        for place, (number, start, rows) in enumerate(zip(chosen, starts, lengths, strict=True)):
            both[:rows, place] = self._pairs.read(self._pairs.motions[number].start + int(start), int(rows))
        return Batch(both[..., :width], both[..., width:], lengths)


def whole_motions(
    pairs: Pairs, batch: int, *, one_by_one: bool = False
) -> Iterator[tuple[Int[np.ndarray, "B"], Batch]]:
    """All motions whole, those of similar length together, with their numbers; fewer at once where they are long.

    For a network that takes them sample by sample, many more: such a step takes as long for hundreds of motions as for
    one, and keeps nothing.
    """
    batch, at_once = (_MANY * batch, _MANY * _ROWS_AT_ONCE) if one_by_one else (batch, _ROWS_AT_ONCE)
    rows = np.array([motion.rows for motion in pairs.motions])
    order = np.argsort(rows, kind="stable")
    start = 0
    while start < order.size:
        many = min(batch, max(1, at_once // int(rows[order[min(start + batch, order.size) - 1]])))
        chosen = order[start : start + many]
        start += many
        parts = [pairs.motion(pairs.motions[number]) for number in chosen]
        lengths = np.array([len(x) for x, _ in parts])
        x = np.zeros((lengths.max(), chosen.size, len(pairs.inputs)), np.float32)
        y = np.zeros((lengths.max(), chosen.size, len(pairs.outputs)), np.float32)
        for place, (rows_x, rows_y) in enumerate(parts):
            x[: len(rows_x), place], y[: len(rows_y), place] = rows_x, rows_y
        yield chosen, Batch(x, y, lengths)
