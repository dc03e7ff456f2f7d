"""Draws of a training that depend on its seed and on where it stands, and on nothing else."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch


@contextmanager
def own_draws() -> Iterator[None]:
    """Stable-Baselines3 draws from the generators of numpy and torch that everybody shares; they are put back."""
    numpys, torchs = np.random.get_state(), torch.get_rng_state()  # noqa: NPY002
    try:
        yield
    finally:
        np.random.set_state(numpys)  # noqa: NPY002
        torch.set_rng_state(torchs)


def draw_from(seed: int, number: int) -> int:
    """Seed these generators for a part of a training; returns the seed of everything else in it."""
    own = int(np.random.SeedSequence([seed, number]).generate_state(1)[0])
    np.random.seed(own)  # noqa: NPY002
    torch.manual_seed(own)
    return own
