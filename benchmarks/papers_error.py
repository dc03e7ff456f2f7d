"""How long our trainings take to the error on val that the papers' configuration ends with, over what that takes.

`python -m benchmarks papers_error` trains the four networks that are missing under runs/augment (`benchmarks.
augment_models`; an hour and a half on two cores if none is there).
"""

from __future__ import annotations

import math
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch
from torch import nn

from benchmarks.augment_models import train
from benchmarks.table import Row, at_most, shown
from benchmarks.training import corrector_of, made, paired
from trueup.augment import AugmentConfig
from trueup.augment.loss import Loss
from trueup.augment.pairs import Pairs
from trueup.augment.windows import Windows
from trueup.core.config import build
from trueup.core.model_card import ModelCard


def run() -> list[Row]:
    """Both networks of the papers."""
    return [row for method in ("realeasy", "realeasy-rt") for row in _to_the_papers_error(method)]


def _to_the_papers_error(method: str) -> list[Row]:
    """How long ours takes to the error on val that the papers' configuration ends with, over what that takes.

    Epochs are counted in the trainings of the comparison, which share their machine with others; what an epoch of each
    costs is measured here, in turn, by the time of a batch.
    """
    paper = ModelCard.load(train("paper" if method == "realeasy" else "paper-rt"))
    ours = ModelCard.load(train(method))
    rms = np.array([output.far / 2 for output in ours.outputs])  # far off is twice the simulator's error on train
    names = [(output.signal, output.joint) for output in ours.outputs]
    end = [paper.metrics["val"][signal][joint]["corrected"] for signal, joint in names]
    target = float(np.mean((np.array(end) / rms) ** 2))
    history = ours.provenance["training"]["history"]
    reached = next((item["number"] for item in history if item["val"] <= target), None)
    with TemporaryDirectory() as name:
        pairs = made(Path(name) / "train.f32", 160)
        steps = paired(
            lambda: _batch_seconds(_config(ours), pairs),
            lambda: _batch_seconds(_config(paper), pairs),
        )
    took = paper.provenance["training"]["history"]
    seconds = [per_batch * _batches(card) for per_batch, card in zip(steps, (ours, paper), strict=True)]
    share = math.inf if reached is None else reached * seconds[0] / (len(took) * seconds[1])
    return [
        at_most(f"{method}: time to the papers' error on val over the papers' time", share, 0.5, "x"),
        shown(f"{method}: epochs to the papers' error, of {len(history)}", reached or math.nan, ""),
    ]


def _config(card: ModelCard) -> AugmentConfig:
    return build(AugmentConfig, card.provenance["config"], card.name)


def _batches(card: ModelCard) -> int:
    """Batches in an epoch of a training."""
    config, motions = _config(card), card.provenance["training"]["motions"]["train"]
    if config.window.rule == "half-shortest":
        return config.window.draws * math.ceil(motions / config.batch)
    rows = card.provenance["training"]["rows"]["train"]
    return round(config.window.draws * rows / config.window.samples / config.batch)


def _batch_seconds(config: AugmentConfig, pairs: Pairs) -> float:
    """Median time of a batch, as training runs it."""
    corrector = corrector_of(config)
    kind = torch.optim.RMSprop if config.optimizer.name == "rmsprop" else torch.optim.AdamW
    optimizer = kind(corrector.parameters(), lr=1e-4)
    of = Loss(config.loss, pairs.outputs, pairs.rate_hz)
    times = []
    for batch, _ in zip(
        Windows(pairs, config.window, config.batch).epoch(np.random.default_rng(0)), range(40), strict=False
    ):
        started = time.perf_counter()
        loss = of.of(corrector, batch)
        optimizer.zero_grad()
        loss.backward()
        if config.optimizer.clip:
            nn.utils.clip_grad_norm_(corrector.parameters(), config.optimizer.clip)
        optimizer.step()
        times.append(time.perf_counter() - started)
    return float(np.median(times))
