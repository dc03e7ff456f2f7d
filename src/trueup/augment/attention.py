"""Where a SAT looks in the past: its attention over whole motions (SAT, Fig. 11)."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch
from jaxtyping import Float64

from trueup.augment.augmentation import Augmentation
from trueup.augment.channels import Grid, gather
from trueup.augment.networks.sat import Sat
from trueup.core.attention import AttentionProfile
from trueup.core.episode import Episode
from trueup.core.results import Estimate
from trueup.errors import DataError
from trueup.measure import bootstrap_interval, motion_numbers


def attention_profile(
    made: Augmentation, episodes: Iterable[Episode], run: str, *, draws: int = 2000, seed: int = 0
) -> AttentionProfile | None:
    """The profile over motions that are longer than the history.

    Args:
        made: with the weights.
        episodes: with the run in them.
        run: label of the run that is corrected.
        draws: of the bootstrap over motions; repetitions are drawn together.
        seed: of the bootstrap.

    Returns:
        None of a network without attention.

    Raises:
        TrueupError: what `augment.channels.gather` raises.
        DataError: no motion is long enough.
    """
    network = made.corrector.network
    if not isinstance(network, Sat) or network.attention is None:
        return None
    found, executed = [], []
    for episode in episodes:
        own = _of_motion(made, network, episode, run)
        if own is not None:
            found.append(own)
            executed.append(episode.meta.executed)
    if not found:
        raise DataError("no motion is longer than the history", expected=f"more than {network.history} samples")
    shares = np.stack(found)
    lags_s = np.array([_half(own) for own in shares]) / made.card.rate_hz
    oldest = shares[:, -max(1, network.history // 4) :].sum(axis=1)
    motions = motion_numbers(executed)
    ends = bootstrap_interval(np.stack([lags_s, oldest], axis=1), motions=motions, draws=draws, seed=seed)
    half, rest = (
        Estimate(float(values.mean()), unit, *(None if np.isnan(end) else float(end) for end in (left, right)))
        for values, unit, left, right in zip((lags_s, oldest), ("s", "1"), *ends, strict=True)
    )
    columns = shares.mean(axis=0), *np.percentile(shares, (5, 95), axis=0)
    mean, low, high = (tuple(float(share) for share in values) for values in columns)
    return AttentionProfile(made.card.rate_hz, mean, low, high, len(found), half, rest)


def _of_motion(made: Augmentation, network: Sat, episode: Episode, run: str) -> Float64[np.ndarray, "L"] | None:
    """Share of each sample, the present one first; None of a motion without a sample whose whole history is there."""
    series = episode.run(run)
    card = made.card.of_joints(made.card.blocks_of(series))
    grid = Grid.of(series.time_s, card.rate_hz)
    if len(grid.time_s) <= network.history:
        return None
    x = torch.from_numpy(gather(episode, run, card.inputs, grid.time_s))
    network.eval()
    with torch.no_grad():
        read = made.corrector.read(x.reshape(len(x), -1, len(made.card.inputs)))
        # What the encoder is told of past errors is what the network has said of them.
        fed = network(read) if network.feedback == "own" else read.new_zeros(*read.shape[:2], network.outputs)
        shares = network.profile(read, fed).double().numpy()[::-1]
    return np.asarray(shares / shares.sum())


def _half(shares: Float64[np.ndarray, "L"]) -> float:
    """The lag in samples within which half of the attention lies, interpolated between samples."""
    return float(np.interp(0.5, np.cumsum(shares), np.arange(len(shares))))
