"""Correct: a simulated run through a trained network, stored as a run of its own beside it."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from trueup.align import JointMap
from trueup.augment.correction import corrected
from trueup.core.atomic import as_read_back
from trueup.core.episode import Episode
from trueup.core.model_card import ModelCard
from trueup.core.provenance import provenance
from trueup.core.timeseries import TimeSeries
from trueup.dataset import Dataset, RunWriter
from trueup.errors import MissingSignal, TrueupError
from trueup.stages.progress import Track, silent

if TYPE_CHECKING:
    from trueup.deploy import Predictor

# What a corrected run has in common with the run that it corrects.
_INHERITED = ("engine", "joint_map", "joints", "scored_joints", "command_signal", "torque_limits", "settings", "notes")


@dataclass(frozen=True)
class CorrectionSummary:
    """What a correction did.

    Attributes:
        label: of the corrected run.
        corrected: number of motions that were corrected now.
        kept: number of motions that the run had already.
        failed: motion -> why it could not be corrected.
        seconds: wall-clock time that it took to make the run, with earlier calls unless they were interrupted [s].
    """

    label: str
    corrected: int
    kept: int
    failed: Mapping[str, TrueupError] = field(default_factory=dict)
    seconds: float = 0.0


def corrected_label(run: str, card: ModelCard) -> str:
    """The label of a run after correction, e.g. `mujoco/stock+panda-realeasy-rt`."""
    return f"{run}+{card.name}"


def in_run_names(episode: Episode, info: Mapping[str, Any]) -> Episode:
    """The episode in the joint names of a run, given its run.json; the run's own series are in them already."""
    return JointMap.from_dict(info["joint_map"]).of_episode(episode) if "joint_map" in info else episode


def correct_unless_same(
    dataset: Dataset, predictor: Predictor, *, run: str, ids: Sequence[str], track: Track = silent
) -> CorrectionSummary:
    """The corrected run, kept if nothing that it was made from has changed, and made again otherwise.

    Args:
        dataset: with the run in it.
        predictor: the network.
        run: label of the run to correct.
        ids: motions; those that a kept run lacks are added to it.
        track: shows progress.

    Raises:
        MissingSignal: there are no motions.
        TrueupError: no motion could be corrected; what is wrong with the first.
    """
    card, base = predictor.card, dataset.run_info(run)

    def made(episode: Episode) -> TimeSeries:
        return corrected(in_run_names(episode, base), run, card, predictor.run)

    network = {"name": card.name, "method": card.method, "sha256": card.to_json()["sha256"], "files": dict(card.files)}
    # A run that was made again holds other samples even if it was told the same.
    corrects = {"run": run, "created": base.get("provenance", {}).get("created")}
    inputs = {**base.get("inputs", {}), "corrects": corrects, "network": network}
    return make_unless_same(dataset, corrected_label(run, card), run, inputs, made, ids=ids, track=track)


def make_unless_same(
    dataset: Dataset,
    label: str,
    run: str,
    inputs: Mapping[str, Any],
    make: Callable[[Episode], TimeSeries],
    *,
    ids: Sequence[str],
    track: Track = silent,
) -> CorrectionSummary:
    """A run that is made of another one, motion by motion; kept if nothing that it was made from has changed.

    Args:
        dataset: with the other run in it.
        label: of the run to make.
        run: label of the other one.
        inputs: what decides about the run that is made.
        make: from an episode with the other run to the series.
        ids: motions; those that a kept run lacks are added to it.
        track: shows progress.

    Raises:
        MissingSignal: there are no motions.
        TrueupError: of no motion it could be made; what is wrong with the first.
    """
    if not ids:
        raise MissingSignal(f"there is no motion whose run {run!r} could be corrected", available=dataset.ids)
    started = time.perf_counter()
    info = _info(dataset, dataset.run_info(run), inputs)
    earlier = dataset.run_info(label) if label in dataset.runs else None
    keeping = earlier is not None and earlier.get("inputs") == as_read_back(info["inputs"])
    before_s = float(earlier.get("seconds", 0.0)) if keeping and earlier is not None else 0.0
    there = set(dataset.run_ids(label)) if keeping else set()
    missing = [name for name in ids if name not in there]
    failed: dict[str, TrueupError] = {}
    with contextlib.ExitStack() as stack:
        writer = None
        for name in track(missing, "correct", len(missing)):
            try:
                series = make(dataset.episode(name, runs=[run]))
            except TrueupError as error:  # one bad motion must not hide the others
                failed[name] = error
                continue
            if writer is None:  # only now, so that a correction of which nothing comes leaves the run alone
                again = {"resume": True} if keeping else {"overwrite": True}
                writer = stack.enter_context(RunWriter(dataset.path, label, run_info=info, **again))
            writer.append(name, series)
        seconds = before_s + (time.perf_counter() - started if missing else 0.0)
        if writer is not None:
            writer.update_info({**info, "seconds": seconds})
    if len(failed) == len(ids):
        raise next(iter(failed.values()))
    dataset.reload()
    return CorrectionSummary(label, len(missing) - len(failed), len(ids) - len(missing), failed, seconds)


def _info(dataset: Dataset, base: Mapping[str, Any], inputs: Mapping[str, Any]) -> dict[str, Any]:
    made_from = {key: inputs[key] for key in ("corrects", "network", "projects") if key in inputs}
    return {
        **{key: base[key] for key in _INHERITED if key in base},
        "inputs": dict(inputs),
        "provenance": provenance(config=made_from, data_hash=dataset.hash),
    }
