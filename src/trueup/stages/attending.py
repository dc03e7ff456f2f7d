"""Where networks with attention look in the past, on the motions that are evaluated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from trueup.core.attention import AttentionProfile
from trueup.core.augment_result import AugmentResult
from trueup.core.model_card import ModelCard
from trueup.dataset import Dataset
from trueup.errors import TrueupError
from trueup.stages.progress import Track, silent

# A profile hardly changes with more motions, and a motion takes as long as its correction by torch.
_MOST_MOTIONS = 32


def with_attention(
    result: AugmentResult,
    dataset: Dataset,
    folders: Mapping[str, Path],
    ids: Sequence[str],
    *,
    draws: int,
    seed: int,
    track: Track = silent,
) -> tuple[AugmentResult, list[str]]:
    """The result with the attention profile of each network that has one; and what hindered.

    Args:
        result: of these motions.
        dataset: with the run in it.
        folders: name of a network -> its folder.
        ids: motions; of many, some that are evenly spread.
        draws: of the bootstrap.
        seed: of the bootstrap.
        track: shows progress.
    """
    rows = np.unique(np.linspace(0, len(ids) - 1, min(len(ids), _MOST_MOTIONS)).round().astype(int))
    some = [ids[row] for row in rows]
    models, notes = list(result.models), []
    for place, model in enumerate(models):
        folder = folders.get(model.name)
        if folder is None or not _says_attention(ModelCard.load(folder)):
            continue
        try:
            profile = _profile(folder, dataset, result.run, some, draws, seed, track)
        except ImportError:
            notes.append(f"where {model.name} looks in the past is not shown: torch is not installed")
        except TrueupError as error:
            notes.append(f"where {model.name} looks in the past is not shown: {error.summary}")
        else:
            models[place] = replace(model, attention=profile)
    return replace(result, models=tuple(models)), notes


def _says_attention(card: ModelCard) -> bool:
    """Whether the card is of a network with attention; weights are read of those only, since that takes torch."""
    config = card.provenance.get("config")
    network = config.get("network") if isinstance(config, Mapping) else None
    return isinstance(network, Mapping) and network.get("kind") == "sat" and network.get("attention") is True


def _profile(
    folder: Path, dataset: Dataset, run: str, ids: Sequence[str], draws: int, seed: int, track: Track
) -> AttentionProfile | None:
    from trueup.augment.attention import attention_profile
    from trueup.augment.augmentation import Augmentation

    episodes = (dataset.episode(name, runs=[run]) for name in track(ids, "attention", len(ids)))
    return attention_profile(Augmentation.load(folder), episodes, run, draws=draws, seed=seed)
