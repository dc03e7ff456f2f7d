"""Evaluate: trained networks in, what each of their corrections is worth on the motions of a dataset out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from trueup.augment.channels import Grid
from trueup.core.atomic import make_folder
from trueup.core.augment_result import ANY_CONDITION, AUGMENT_NAME, AugmentResult
from trueup.core.model_card import ONNX_NAME, ModelCard
from trueup.core.provenance import provenance
from trueup.core.results import Ladder
from trueup.core.sole_writer import writes_alone
from trueup.core.step_times import LATENCY_NAME, StepTimes
from trueup.dataset import Dataset
from trueup.deploy.agreement import RATE_TOLERANCE
from trueup.errors import ConfigError, DataError, MissingSignal, OutputExists, TrueupError
from trueup.stages.attending import with_attention
from trueup.stages.comparing import comparison_of, frame_of
from trueup.stages.correcting import CorrectionSummary, correct_unless_same, corrected_label
from trueup.stages.folder import forget_explanation, refuse_other_fit
from trueup.stages.joining import corrects_bodies, project_unless_same, projected_card, with_gaps
from trueup.stages.ladder import ladder_of
from trueup.stages.measuring import Measurement, gap
from trueup.stages.progress import Track, silent

if TYPE_CHECKING:
    from trueup.augment.evaluation import EvaluationBuilder

EVERY_SPLIT = "all"
_TEST = "test"


@dataclass(frozen=True)
class Evaluated:
    """What `evaluate` made.

    Attributes:
        result: the tables.
        corrected: what was corrected now, what was there, what failed; one item per network.
        measurement: gap of the run and of its corrections.
        ladder: command, the run, one rung per network.
        warnings: what must not be overlooked.
        notes: what else is to be known.
    """

    result: AugmentResult
    corrected: tuple[CorrectionSummary, ...]
    measurement: Measurement
    ladder: Ladder
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Judged:
    """What `judge` found: `result`, `corrected`, `warnings` and `notes` as in `Evaluated`."""

    result: AugmentResult
    corrected: tuple[CorrectionSummary, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]


@writes_alone()
def evaluate(
    dataset: Dataset,
    models: Sequence[Path | str],
    out: Path | str,
    *,
    run: str | None = None,
    split: str = _TEST,
    drop_flagged: bool = False,
    project: bool = False,
    draws: int = 2000,
    seed: int = 0,
    overwrite: bool = False,
    track: Track = silent,
) -> Evaluated:
    """Correct a simulated run by trained networks, and measure what that is worth.

    Every correction becomes a run of the dataset (`mujoco/stock+NAME`), which is kept as long as nothing that it was
    made from changes. Writes augment.json, ladder.json and the files of `gap` for the run and its corrections.

    Args:
        dataset: with the run in it.
        models: folders of trained networks.
        out: folder for the results.
        run: label of the run to correct; the one that all networks were trained for if None.
        split: motions to evaluate; `all` for every motion.
        drop_flagged: leave out motions with warnings.
        project: also measure the robot that is nearest to corrected bodies, a run `...-projected` of its own.
        draws: bootstrap resamples.
        seed: of the bootstrap.
        overwrite: replace the results that are in `out`.
        track: shows progress.

    Raises:
        OutputExists: `out` holds results and `overwrite` is not given.
        ConfigError: no network, two of one name, none of bodies to project, or it is not clear which run they correct.
        MissingSignal: the run or split is not there.
        NameMismatch: a network is for other joints; both lists are printed.
        DataError: the run has too few samples per second for a network, or no motion is left.
        MissingDependency: onnxruntime is not installed.
    """
    out = Path(out)
    make_folder(out)
    if not overwrite and any((out / name).exists() for name in ("gap.json", AUGMENT_NAME)):
        raise OutputExists(f"{out} holds results", hint="Give --overwrite to replace them, or choose another --out.")
    refuse_other_fit(out, dataset.hash)
    judged = judge(
        dataset,
        models,
        run=run,
        split=split,
        drop_flagged=drop_flagged,
        project=project,
        draws=draws,
        seed=seed,
        track=track,
    )
    run = judged.result.run
    measurement = gap(
        dataset,
        runs=[run, *(item.label for item in judged.corrected)],
        split=None if split == EVERY_SPLIT else split,
        drop_flagged=drop_flagged,
        draws=draws,
        seed=seed,
        blocks=False,
        track=track,
    )
    ladder = _ladder(dataset, measurement, run, judged.corrected)
    forget_explanation(out, unless_of=None if overwrite else dataset.hash)
    measurement.save(out)
    ladder.save(out / "ladder.json")
    judged.result.save(out / AUGMENT_NAME)
    notes = (*judged.notes, *measurement.gap.settings["warnings"])
    return Evaluated(judged.result, judged.corrected, measurement, ladder, judged.warnings, notes)


def judge(
    dataset: Dataset,
    models: Sequence[Path | str],
    *,
    run: str | None = None,
    split: str = _TEST,
    drop_flagged: bool = False,
    project: bool = False,
    draws: int = 2000,
    seed: int = 0,
    track: Track = silent,
) -> Judged:
    """The tables of `evaluate`, without its measurement; arguments and errors as there. Nothing but runs is written."""
    from trueup.deploy import Predictor

    predictors = [Predictor.load(Path(folder)) for folder in models]
    cards = [predictor.card for predictor in predictors]
    timed = [_timed(Path(folder), card) for folder, card in zip(models, cards, strict=True)]
    _refuse_same_names(cards, models)
    if project and not any(corrects_bodies(card) for card in cards):
        raise ConfigError("--project is for networks that correct bodies", got=[card.name for card in cards])
    run = _run_of(dataset, cards) if run is None else run
    ids = _motions(dataset, run, split, drop_flagged=drop_flagged)
    # From here on, modular networks are for the joints, or bodies, of this robot.
    first = dataset.episode(ids[0], runs=[run]).run(run)
    predictors = [predictor.of_joints(predictor.card.blocks_of(first)) for predictor in predictors]
    cards = [predictor.card for predictor in predictors]
    corrections = tuple(
        correct_unless_same(dataset, predictor, run=run, ids=ids, track=track) for predictor in predictors
    )
    latencies = [times for times, _ in timed]
    if project:
        nearest = [
            (project_unless_same(dataset, item.label, ids=_there(dataset, item.label, ids), track=track), card)
            for item, card in zip(corrections, cards, strict=True)
            if corrects_bodies(card)
        ]
        corrections = (*corrections, *(item for item, _ in nearest))
        judged = [*cards, *(projected_card(card) for _, card in nearest)]
    else:
        judged = cards
    labels = [run, *(item.label for item in corrections)]
    warnings = _foreign(dataset, run, split, cards)
    notes = [line for item in corrections for line in _failed(item)]
    notes += [line for card in cards for line in _resampled(dataset, run, ids, card)]
    notes += [line for _, lines in timed for line in lines]
    notes += _unpromised(dataset, ids, cards)
    latencies += [None] * (len(judged) - len(cards))
    builder, left_out, measured = _reduced(dataset, labels, judged, latencies, ids, track)
    notes += left_out
    config = {
        "run": run,
        "split": split,
        "drop_flagged": drop_flagged,
        "project": project,
        "networks": {card.name: card.to_json()["sha256"] for card in cards},
    }
    result = builder.result(
        split=split,
        draws=draws,
        seed=seed,
        notes=[*warnings, *notes],
        provenance=provenance(config=config, seed=seed, data_hash=dataset.hash),
    )
    result, unknown = with_gaps(result, dataset, measured, draws=draws, seed=seed, track=track)
    notes += unknown
    folders = {card.name: Path(folder) for card, folder in zip(cards, models, strict=True)}
    result, unknown = with_attention(result, dataset, folders, measured, draws=draws, seed=seed, track=track)
    notes += unknown
    return Judged(result, corrections, tuple(warnings), tuple(notes))


def _refuse_same_names(cards: Sequence[ModelCard], folders: Sequence[Path | str]) -> None:
    if not cards:
        raise ConfigError("there is no network to evaluate", hint="Give --model FOLDER, once per network.")
    for name in {card.name for card in cards}:
        same = [str(folder) for card, folder in zip(cards, folders, strict=True) if card.name == name]
        if len(same) > 1:
            raise ConfigError(
                f"two networks are called {name!r}", got=", ".join(same), hint="Train one of them with another --name."
            )


def _run_of(dataset: Dataset, cards: Sequence[ModelCard]) -> str:
    """The run that all networks were trained to correct."""
    trained = list(dict.fromkeys(card.run for card in cards))
    if len(trained) == 1 and trained[0] in dataset.runs:
        return trained[0]
    raise ConfigError(
        "which run is to be corrected?",
        got=f"networks trained for {', '.join(trained)}",
        available=[label for label in dataset.runs if "corrects" not in dataset.run_info(label).get("inputs", {})],
        hint="Name it with --run; trueup replay makes one.",
    )


def _motions(dataset: Dataset, run: str, split: str, *, drop_flagged: bool) -> list[str]:
    present = sorted(set(dataset.splits.values()))
    if split != EVERY_SPLIT and split not in present:
        raise MissingSignal(
            f"{dataset.path} has no split {split!r}",
            available=[*present, EVERY_SPLIT],
            hint="Give --split, or assign splits when importing.",
        )
    kept = dataset.select(split=None if split == EVERY_SPLIT else split, drop_flagged=drop_flagged)
    simulated = set(dataset.run_ids(run))
    ids = [name for name in kept if name in simulated]
    if not ids:
        raise MissingSignal(
            f"the run {run!r} has none of the {len(kept)} motions to evaluate",
            available=dataset.run_ids(run),
            hint="Replay them: trueup replay DATASET --robot ROBOT --resume.",
        )
    return ids


def _reduced(
    dataset: Dataset,
    labels: Sequence[str],
    cards: Sequence[ModelCard],
    latencies: Sequence[StepTimes | None],
    ids: Sequence[str],
    track: Track,
) -> tuple[EvaluationBuilder, list[str], list[str]]:
    """The sums of all motions that every network could correct, what was left out, and these motions."""
    from trueup.augment.evaluation import Candidate, EvaluationBuilder

    run, *others = labels
    frame = frame_of(dataset, labels, None)
    candidates = [Candidate(*item) for item in zip(others, cards, latencies, strict=True)]
    builder = EvaluationBuilder(run, candidates, scored_joints=frame.scored)
    covered = [set(dataset.run_ids(label)) for label in labels]
    everywhere = [name for name in ids if all(name in there for there in covered)]
    notes = []
    if len(everywhere) < len(ids):
        notes.append(
            f"{len(ids) - len(everywhere)} of {len(ids)} motions are not in the tables: not every network could "
            "correct them"
        )
    added: list[str] = []
    for name in track(everywhere, "evaluate", len(everywhere)):
        episode = dataset.episode(name, runs=labels)
        try:
            comparison = comparison_of(episode, frame, align=False)
        except TrueupError as error:
            notes.append(f"{name} was left out: {error.what}")
            continue
        builder.add(comparison)
        added.append(name)
    if not added:
        raise DataError("no motion could be corrected by every network", got="; ".join(notes))
    return builder, notes, added


def _there(dataset: Dataset, label: str, ids: Sequence[str]) -> list[str]:
    """The motions that a run has."""
    there = set(dataset.run_ids(label))
    return [name for name in ids if name in there]


def _ladder(dataset: Dataset, measurement: Measurement, run: str, corrections: Sequence[CorrectionSummary]) -> Ladder:
    base_s = float(dataset.run_info(run).get("seconds", 0.0))
    seconds = {run: base_s, **{item.label: base_s + item.seconds for item in corrections}}
    return ladder_of(measurement, {label.rpartition("/")[2]: (label, spent) for label, spent in seconds.items()})


def _foreign(dataset: Dataset, run: str, split: str, cards: Sequence[ModelCard]) -> list[str]:
    """What makes a number say something else than what the training promised."""
    robot = dataset.run_info(run).get("inputs", {}).get("robot", {}).get("name") or dataset.info.robot
    trained: dict[str, list[str]] = {}
    for card in cards:
        if card.run != run or (card.robot and robot and card.robot != robot):
            trained.setdefault(f"{card.run}{f' of {card.robot}' if card.robot else ''}", []).append(card.name)
    here = f"{run}{f' of {robot}' if robot else ''}"
    lines = [f"trained to correct {what}, used here on {here}: {', '.join(names)}" for what, names in trained.items()]
    if split != _TEST:
        lines.append(f"{split!r} may hold motions that a network was trained or chosen on, which would flatter it")
    return lines


def _unpromised(dataset: Dataset, ids: Sequence[str], cards: Sequence[ModelCard]) -> list[str]:
    """Where the intervals of a network promise nothing: too few val motions, or none of the kind that is evaluated."""
    chosen = set(ids)
    conditions = {meta.condition for meta in dataset.metas if meta.id in chosen} - {ANY_CONDITION}
    lines: list[str] = []
    unseen: dict[str, list[str]] = {}
    for card in cards:
        if all(output.interval is None for output in card.outputs):
            continue
        if card.coverage_note:
            lines.append(f"{card.name}: its intervals promise nothing: {card.coverage_note}")
            continue
        chose = set(card.provenance.get("training", {}).get("val_conditions", ()))
        if chose and ANY_CONDITION not in chose:  # older cards do not say, and motions without a condition may be any
            for condition in sorted(conditions - chose):
                unseen.setdefault(condition, []).append(card.name)
    return lines + [
        f"{condition} motions: no such motions chose the intervals of {', '.join(names)}; they may cover less"
        for condition, names in unseen.items()
    ]


def _failed(summary: CorrectionSummary) -> list[str]:
    if not summary.failed:
        return []
    name, error = next(iter(summary.failed.items()))
    return [f"{summary.label}: {len(summary.failed)} motions could not be corrected, {name} because {error.summary}"]


def _resampled(dataset: Dataset, run: str, ids: Sequence[str], card: ModelCard) -> list[str]:
    series = dataset.episode(ids[0], runs=[run]).run(run)
    if Grid.of(series.time_s, card.rate_hz).own:
        return []
    same = abs(series.rate_hz / card.rate_hz - 1) <= RATE_TOLERANCE
    has = "samples at uneven times" if same else f"{series.rate_hz:.4g} samples per second"
    line = (
        f"{corrected_label(run, card)}: {run} has {has}, and the network sees {card.rate_hz:g} per second; "
        "its correction is interpolated between them"
    )
    return [line]


def _timed(folder: Path, card: ModelCard) -> tuple[StepTimes | None, list[str]]:
    """What `latency.json` says of this network; a note if it is about another."""
    path = folder / LATENCY_NAME
    times = StepTimes.load(path) if path.is_file() else None
    if times is None or times.network == card.files[ONNX_NAME]:
        return times, []
    line = (
        f"{card.name}: its {LATENCY_NAME} is not about this network; take the time again: trueup augment time {folder}"
    )
    return None, [line]
