"""The policies in folders and below them, as their cards tell how they were trained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from trueup.core.policy_card import POLICY_CARD, PolicyCard
from trueup.core.trials import Trial
from trueup.errors import ConfigError, DataError


def find_trials(folders: Sequence[Path | str]) -> list[Trial]:
    """The trained policies in folders, or anywhere below them, in the order of their names.

    Raises:
        DataError: there is none in a folder, a card is broken, or says nothing of the training.
        ConfigError: they are of robots with other joints, or act at other rates: rewards of control steps cannot be
            compared.
    """
    paths: dict[Path, None] = {}
    for folder in map(Path, folders):
        found = sorted(card.parent for card in folder.rglob(POLICY_CARD)) if folder.is_dir() else []
        if not found:
            raise DataError(f"{folder} holds no policy ({POLICY_CARD}), nor does a folder below it")
        paths |= dict.fromkeys(path.resolve() for path in found)
    cards = {path: PolicyCard.load(path) for path in paths}
    first_path, first = next(iter(cards.items()))
    trials = []
    for path, card in cards.items():
        if (card.joints, card.rate_hz) != (first.joints, first.rate_hz):
            raise ConfigError(
                f"{path} and {first_path} are of different robots or rates",
                got=f"{len(card.joints)} joints of {card.robot} at {card.rate_hz:g} Hz",
                expected=f"{len(first.joints)} joints of {first.robot} at {first.rate_hz:g} Hz",
                hint="Look at them one by one.",
            )
        trial = Trial.of(card, path)
        if not trial.history:
            raise DataError(f"{path / POLICY_CARD} says nothing of the training: it has no `history`")
        trials.append(trial)
    labels = [trial.label for trial in trials]
    return [
        trial if labels.count(trial.label) == 1 else replace(trial, label=f"{path.parent.name}/{path.name}")
        for path, trial in zip(cards, trials, strict=True)
    ]
