"""Evaluation of corrections: motions in one by one, sums per motion kept, tables with paired intervals out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64

from trueup.augment.components import POSITION, ROTATION
from trueup.augment.pooling import Column, Pooling, Totals
from trueup.augment.reliability import Calibration
from trueup.augment.rotations import refuse_no_rotation
from trueup.core.augment_result import (
    ALL_JOINTS,
    ANY_CONDITION,
    AugmentResult,
    GatedOutput,
    ModelEvaluation,
    ModelPair,
)
from trueup.core.episode import EpisodeMeta
from trueup.core.model_card import ModelCard
from trueup.core.step_times import StepTimes
from trueup.core.timeseries import BODY_PREFIX, TimeSeries
from trueup.deploy import Confidence
from trueup.errors import DataError, NameMismatch
from trueup.measure import Comparison, executed_of
from trueup.measure.metrics.body import position_distance, rotation_distance

# The conditions of the papers' data set stand in their order, others after them.
_CONDITIONS = ("multi-joint", "single-joint", "cartesian")
_SIGNALS = ("position", "velocity", "torque")
_DISTANCES = {POSITION: position_distance, ROTATION: rotation_distance}


@dataclass(frozen=True)
class Candidate:
    """A network that is evaluated.

    Attributes:
        run: label of the run that it corrected.
        card: what it says of itself.
        latency: of its steps, if somebody took the time.
    """

    run: str
    card: ModelCard
    latency: StepTimes | None = None


class _Tally:
    """Sums of one network, one item per motion, one number per column."""

    def __init__(self, card: ModelCard, columns: Sequence[Column]) -> None:
        self.squares: list[Float64[np.ndarray, "C"]] = []
        self.inside: list[Float64[np.ndarray, "C"]] = []
        self.widths: list[Float64[np.ndarray, "C"]] = []
        self.covered: list[Float64[np.ndarray, "C"]] = []
        self.calibration = Calibration()
        self._confidence = Confidence(card)
        self._outputs = card.outputs
        places = {(column.signal, column.joint): number for number, column in enumerate(columns)}
        # Outputs that were not measured cannot be judged, and the intervals of components say nothing of distances.
        self._at = {
            number: places[output.signal, output.joint]
            for number, output in enumerate(card.outputs)
            if (output.signal, output.joint) in places
        }

    def add(
        self,
        valid: Bool[np.ndarray, "T C"],
        gap: Float64[np.ndarray, "T C"],
        correction: Float64[np.ndarray, "T C"],
        left: Float64[np.ndarray, "T C"],
    ) -> None:
        """Take one motion: what counts, measured - simulated, corrected - simulated, measured - corrected."""
        given = np.zeros((len(correction), len(self._outputs)))
        given[:, list(self._at)] = correction[:, list(self._at.values())]
        half = np.full(correction.shape, np.inf)
        half[:, list(self._at.values())] = self._confidence.half_width(given)[:, list(self._at)]
        known = valid & np.isfinite(half)
        self.squares.append((left**2).sum(axis=0))
        self.covered.append(known.sum(axis=0).astype(np.float64))
        self.inside.append((known & (np.abs(left) <= half)).sum(axis=0).astype(np.float64))
        self.widths.append(np.where(known, half, 0.0).sum(axis=0))
        # An output that is switched off says the same everywhere.
        telling = {
            number: column
            for number, column in self._at.items()
            if (output := self._outputs[number]).far is not None and output.far_correction and output.gate > 0.0
        }
        limits = np.array([self._outputs[number].far for number in telling], np.float64)
        columns = list(telling.values())
        self.calibration.add(
            [self._outputs[number].signal for number in telling],
            valid[:, columns],
            self._confidence.far_off(given)[:, list(telling)],
            np.abs(gap[:, columns]) > limits,
        )


class EvaluationBuilder:
    """Takes comparisons one by one, keeps their sums and forgets their samples.

    Args:
        run: label of the run that is corrected.
        candidates: the networks; a comparison must have the runs of all of them.
        scored_joints: joints that stand for all together; None for all.
    """

    def __init__(
        self, run: str, candidates: Sequence[Candidate], *, scored_joints: Sequence[str] | None = None
    ) -> None:
        self._run = run
        self._candidates = tuple(candidates)
        self._scored = scored_joints
        self._metas: list[EpisodeMeta] = []
        self._joints: tuple[str, ...] = ()
        self._columns: list[Column] = []
        self._samples: list[Float64[np.ndarray, "C"]] = []
        self._squares: list[Float64[np.ndarray, "C"]] = []
        self._tallies: dict[str, _Tally] = {}

    def add(self, comparison: Comparison) -> None:
        """Reduce one motion.

        Samples that were not measured, or not simulated, do not count.

        Raises:
            MissingSignal: a run is not there.
            NameMismatch: its joints, signals or units are not those of the motions before.
            DataError: a corrected run has values that are not finite.
        """
        measured, simulated = comparison.measured, comparison.run(self._run)
        self._refuse_others(comparison.meta.id, measured, simulated)
        away = self._differences(measured, simulated)
        valid = np.isfinite(away)
        gap = np.where(valid, away, 0.0)
        judged = {}
        for label, corrected in ((item.run, comparison.run(item.run)) for item in self._candidates):
            correction, left = self._differences(corrected, simulated), self._differences(measured, corrected)
            if not np.isfinite(correction[valid]).all():
                raise DataError(f"episode {comparison.meta.id!r}: the run {label!r} is not finite")
            judged[label] = np.where(valid, correction, 0.0), np.where(valid, left, 0.0)
        self._metas.append(comparison.meta)
        self._samples.append(valid.sum(axis=0).astype(np.float64))
        self._squares.append((gap**2).sum(axis=0))
        for label, (correction, left) in judged.items():
            self._tallies[label].add(valid, gap, correction, left)

    def _differences(self, first: TimeSeries, second: TimeSeries) -> Float64[np.ndarray, "T C"]:
        """First - second for each column; of bodies the distance between the two, and the angle."""
        names = dict.fromkeys(column.signal for column in self._columns)
        parts = []
        for name in names:
            ends = [np.asarray(series[name], np.float64) for series in (first, second)]
            parts.append(_DISTANCES[name](*ends) if name in _DISTANCES else ends[0] - ends[1])
        return np.concatenate(parts, axis=1)

    def _refuse_others(self, episode: str, measured: TimeSeries, simulated: TimeSeries) -> None:
        # Bodies are compared where somebody corrects them.
        asked = {output.quantity for candidate in self._candidates for output in candidate.card.outputs}
        both = [
            name
            for name in measured.signals
            if name in simulated and (not name.startswith(BODY_PREFIX) or (name in asked and name in _DISTANCES))
        ]
        names = sorted(both, key=lambda name: (name not in _SIGNALS, _SIGNALS.index(name) if name in _SIGNALS else 0))
        columns = [
            Column(name, owner, "rad" if name == ROTATION else unit)
            for name in names
            for owner, unit in zip(
                measured.bodies if name.startswith(BODY_PREFIX) else measured.joints, measured.units[name], strict=True
            )
        ]
        if ROTATION in names:
            refuse_no_rotation(measured[ROTATION], f"episode {episode!r}, measured")
        if not columns:
            raise DataError(f"episode {episode!r}: measurement and {self._run!r} have no signal in common")
        if not self._columns:
            self._columns, self._joints = columns, measured.joints
            self._tallies = {candidate.run: _Tally(candidate.card, columns) for candidate in self._candidates}
        elif columns != self._columns:
            raise NameMismatch(
                f"episode {episode!r} has other signals, joints or units than the motions before",
                left=(f"{item.signal}.{item.joint} [{item.unit}]" for item in columns),
                right=(f"{item.signal}.{item.joint} [{item.unit}]" for item in self._columns),
            )

    def result(
        self,
        *,
        split: str,
        draws: int = 2000,
        seed: int = 0,
        notes: Sequence[str] = (),
        provenance: Mapping[str, Any] | None = None,
    ) -> AugmentResult:
        """The tables.

        Args:
            split: split that was evaluated, in words.
            draws: bootstrap resamples.
            seed: of the pooling.
            notes: what must be said.
            provenance: versions, hashes and configuration, stored as they are.

        Raises:
            DataError: no motion was added.
        """
        if not self._metas:
            raise DataError("there is no motion to evaluate")
        scored = self._joints if self._scored is None else tuple(self._scored)
        groups = _groups(self._metas)
        sums = Totals(self._columns, scored)
        samples, squares = sums.of(self._samples), sums.of(self._squares)
        executed = executed_of(self._metas)
        pooling = {name: Pooling(sums.columns, draws, seed, executed[rows]) for name, rows in groups.items()}
        own = {run: sums.of(tally.squares) for run, tally in self._tallies.items()}
        return AugmentResult(
            run=self._run,
            split=split,
            joints=self._joints,
            scored_joints=scored,
            motions={name: int(rows.sum()) for name, rows in groups.items()},
            simulated={
                name: pooling[name].tree(pooling[name].pooled(squares[rows], samples[rows]))
                for name, rows in groups.items()
            },
            models=tuple(
                self._model(candidate, groups, sums, pooling, samples, squares) for candidate in self._candidates
            ),
            pairs=tuple(self._pairs(groups, pooling, own)),
            conditions_of={meta.id: meta.condition for meta in self._metas},
            notes=tuple(notes),
            settings={"bootstrap_draws": draws, "seed": seed, "bins": Calibration.bins},
            provenance=dict(provenance or {}),
        )

    def _model(
        self,
        candidate: Candidate,
        groups: Mapping[str, Bool[np.ndarray, "E"]],
        sums: Totals,
        pooling: Mapping[str, Pooling],
        samples: Float64[np.ndarray, "E S"],
        squares: Float64[np.ndarray, "E S"],
    ) -> ModelEvaluation:
        card, tally = candidate.card, self._tallies[candidate.run]
        own = sums.of(tally.squares)
        inside, widths, covered = sums.of(tally.inside), sums.of(tally.widths), sums.of(tally.covered)
        return ModelEvaluation(
            name=card.name,
            method=card.method,
            run=candidate.run,
            trained_run=card.run,
            trained_robot=card.robot,
            causal=card.causal,
            signals=tuple(dict.fromkeys(output.quantity for output in card.outputs)),
            cuts={
                name: pooling[name].tree(pooling[name].cuts(own[rows], squares[rows], samples[rows]))
                for name, rows in groups.items()
            },
            gated=tuple(
                dict.fromkeys(
                    GatedOutput(item.quantity, item.joint, item.reason) for item in card.outputs if item.gate == 0.0
                )
            ),
            coverage={
                name: pooling[name].tree(pooling[name].coverage(inside[rows], widths[rows], covered[rows]))
                for name, rows in groups.items()
                if covered[rows].any()
            },
            coverage_target=card.coverage,
            coverage_note=card.coverage_note,
            reliability={
                name: found
                for name, rows in groups.items()
                if (
                    found := tally.calibration.result(
                        rows, motions=pooling[name].motions, draws=pooling[name].draws, seed=pooling[name].seed
                    )
                )
            },
            latency=candidate.latency,
        )

    def _pairs(
        self,
        groups: Mapping[str, Bool[np.ndarray, "E"]],
        pooling: Mapping[str, Pooling],
        own: Mapping[str, Float64[np.ndarray, "E S"]],
    ) -> list[ModelPair]:
        pairs = []
        for number, candidate in enumerate(self._candidates):
            for other in self._candidates[:number]:
                for name, rows in groups.items():
                    found = pooling[name].factors(own[candidate.run][rows], own[other.run][rows])
                    pairs += [
                        ModelPair(candidate.card.name, other.card.name, name, column.signal, factor, verdict)
                        for column, (factor, verdict) in zip(pooling[name].columns, found, strict=True)
                        if column.joint == ALL_JOINTS
                    ]
        return pairs


def _groups(metas: Sequence[EpisodeMeta]) -> dict[str, Bool[np.ndarray, "E"]]:
    """All motions, and those of each condition."""
    names = {meta.condition for meta in metas} - {ANY_CONDITION}
    ordered = [name for name in _CONDITIONS if name in names] + sorted(names.difference(_CONDITIONS))
    everything = np.ones(len(metas), dtype=bool)
    return {
        ANY_CONDITION: everything,
        **{name: np.array([meta.condition == name for meta in metas]) for name in ordered},
    }
