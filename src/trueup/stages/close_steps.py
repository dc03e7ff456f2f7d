"""The steps of a close after the import: each is the command of its name, and all results lie in one folder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from trueup.core.attribution import UNEXPLAINED, Attribution
from trueup.core.augment_result import AUGMENT_NAME
from trueup.core.close_result import CloseResult, StepName
from trueup.core.results import Ladder
from trueup.dataset import Dataset
from trueup.errors import TrueupError
from trueup.robots import RobotSpec
from trueup.stages.close_budget import Budget, fitted_motion
from trueup.stages.close_folder import CloseFolder, StepOutcome
from trueup.stages.close_networks import Trained, corrected_everywhere, plan_of, train_each
from trueup.stages.evaluating import judge
from trueup.stages.folder import forget_explanation, forget_fit, refuse_other_fit
from trueup.stages.identifying import FITTED, Identified, explain, explain_inputs, fit
from trueup.stages.importing import ImportSummary
from trueup.stages.ladder import CHOICE, ladder_of
from trueup.stages.measuring import Measurement, gap
from trueup.stages.progress import Track, silent
from trueup.stages.replaying import STOCK, ReplaySummary, replay_unless_same

if TYPE_CHECKING:
    from trueup.augment import Progress
    from trueup.identify import IdentifyConfig, OnModel

EXPLAIN_NAME = "explain.json"
# Less than this is no time for a step that searches or trains [s].
_LEAST_S = 2.0


@dataclass(frozen=True)
class Watch:
    """Who is told where a close stands.

    Attributes:
        on_step: called when a step begins.
        on_import: called when logs were imported, before the rest, which takes longer.
        on_fit: called after every iteration of every model.
        on_training: called after every batch and epoch of a network, with its name.
    """

    on_step: Callable[[StepName], None] = lambda _: None
    on_import: Callable[[ImportSummary], None] = lambda _: None
    on_fit: OnModel | None = None
    on_training: Callable[[str, Progress], None] | None = None


@dataclass(frozen=True)
class Closed:
    """What `close` made.

    Attributes:
        dataset: the dataset, imported if need be.
        replayed: the replay of the stock model.
        measurement: gap, analysis, traces, quality, of all runs.
        ladder: the rungs.
        result: the steps, as in close.json.
        imported: the import, None if the dataset was there.
        attribution: where the gap comes from; None if that was not asked for or failed.
        identified: the fit; likewise.
        networks: those that were trained.
        notes: what was left out, and what must be known besides.
    """

    dataset: Dataset
    replayed: ReplaySummary
    measurement: Measurement
    ladder: Ladder
    result: CloseResult
    imported: ImportSummary | None = None
    attribution: Attribution | None = None
    identified: Identified | None = None
    networks: tuple[Trained, ...] = ()
    notes: tuple[str, ...] = field(default=())


@dataclass(frozen=True, kw_only=True)
class CloseSteps:
    """Arguments as of `closing.close`; `folder` and `budget` are those of the call."""

    dataset: Dataset
    robot: RobotSpec
    model: Path | None
    config: IdentifyConfig | None
    methods: Sequence[str]
    metrics: Sequence[str] | None
    drop_flagged: bool
    seed: int
    jobs: int | None
    overwrite: bool
    folder: CloseFolder
    budget: Budget
    track: Track = silent
    watch: Watch = field(default_factory=Watch)

    def climb(self) -> Closed:
        """All steps that were asked for, one after the other."""
        out, asked = self.folder.path, self.folder.asked
        if not self.overwrite:
            refuse_other_fit(out, self.dataset.hash)
        replayed = self._replay()
        forget_explanation(out, unless_of=None if self.overwrite else self.dataset.hash)
        if self.overwrite:
            forget_fit(out)
        rungs = {"stock": (STOCK, replayed.seconds)}
        self.watch.on_step("gap")
        with self.folder.step("gap") as step:
            measurement = self._measure(rungs)
            step.what = _main_number(measurement, STOCK)
            ladder = self._save(measurement, rungs)
        attribution = self._explain(replayed.seconds) if asked("explain") else None
        identified = self._identify(replayed) if asked("identify") else None
        trained = self._augment(identified) if asked("augment") else ()
        notes: list[str] = []
        if trained or identified is not None:
            rungs |= _corrected(trained, "stock", replayed.seconds)
            if identified is not None:
                seconds = sum(row.seconds for row in identified.fit.models) + identified.replayed[1].seconds
                rungs |= {"fitted": (FITTED, seconds), **_corrected(trained, "fitted", seconds)}
            measurement = self._measure(rungs)
            ladder = self._save(measurement, rungs)
            notes = self._judge(trained)
        if attribution is not None:
            notes += attribution.statements
        if identified is not None:
            notes += [*identified.fit.statements, *identified.notes]
        return Closed(
            dataset=self.dataset,
            replayed=replayed,
            measurement=measurement,
            ladder=ladder,
            result=self.folder.result,
            attribution=attribution,
            identified=identified,
            networks=trained,
            notes=tuple(dict.fromkeys(notes)),
        )

    def _replay(self) -> ReplaySummary:
        robot = self.robot
        if self.folder.asked("identify"):
            from trueup.identify import judged

            # In the windows of the fit, where it has some: nothing else can be compared with it.
            robot = judged(robot, self.config)
        self.watch.on_step("replay")
        with self.folder.step("replay") as step:
            done = replay_unless_same(
                self.dataset, robot, model=self.model, label=STOCK, jobs=self.jobs, track=self.track
            )
            step.what = f"{done.replayed + done.kept} motions simulated by the model as it came"
            step.status = "done" if done.replayed else "kept"
        return done

    def _measure(self, rungs: dict[str, tuple[str, float]]) -> Measurement:
        return gap(
            self.dataset,
            runs=[label for label, _ in rungs.values()],
            drop_flagged=self.drop_flagged,
            metrics=self.metrics,
            seed=self.seed,
            blocks=len(rungs) == 1,
            track=self.track,
        )

    def _save(self, measurement: Measurement, rungs: dict[str, tuple[str, float]]) -> Ladder:
        ladder = ladder_of(measurement, rungs)
        measurement.save(self.folder.path)
        ladder.save(self.folder.path / "ladder.json")
        return ladder

    def _explain(self, replay_s: float) -> Attribution | None:
        from trueup.identify import IdentifyConfig

        path = self.folder.path / EXPLAIN_NAME
        found: Attribution | None = None
        limit = self.budget.of("explain")
        if limit is not None and limit.left_s < _LEAST_S:
            self.folder.leave_out("explain", "no time was left")
            return None
        self.watch.on_step("explain")
        with self.folder.step("explain", may_fail=True) as step:
            step.inputs = explain_inputs(self.dataset, self.robot, model=self.model, config=self.config, seed=self.seed)
            earlier = self.folder.earlier("explain")
            if earlier is not None and earlier.inputs == step.inputs and path.is_file() and not self.overwrite:
                found, step.status = Attribution.load(path), "kept"
            else:
                found = explain(
                    self.dataset,
                    self.robot,
                    model=self.model,
                    config=fitted_motion(self.config or IdentifyConfig(), self.robot, self.dataset, replay_s, limit),
                    seed=self.seed,
                    jobs=self.jobs,
                    on_progress=self.watch.on_fit,
                    limit=limit,
                )
                found.save(path)
                step.status = "cut short" if limit is not None and limit.over else "done"
            step.what = _shares(found)
        return found

    def _identify(self, replayed: ReplaySummary) -> Identified | None:
        from trueup.identify import IdentifyConfig

        limit = self.budget.of("identify")
        if limit is not None and limit.left_s < _LEAST_S:
            self.folder.leave_out("identify", "no time was left")
            return None
        found: Identified | None = None
        self.watch.on_step("identify")
        with self.folder.step("identify", may_fail=True) as step:
            kept = (self.folder.path / "fit.json").is_file()
            config = self.folder.identify_config(
                lambda: fitted_motion(
                    self.config or IdentifyConfig(), self.robot, self.dataset, replayed.seconds, limit
                ),
                anew=self.overwrite,
            )
            found = fit(
                self.dataset,
                self.robot,
                self.folder.path,
                model=self.model,
                config=config,
                seed=self.seed,
                jobs=self.jobs,
                resume=True,
                track=self.track,
                on_progress=self.watch.on_fit,
                limit=limit,
            )
            _say_fit(step, found, kept=kept)
        return found

    def _augment(self, identified: Identified | None) -> tuple[Trained, ...]:
        limit = self.budget.of("augment")
        if limit is not None and limit.left_s < _LEAST_S:
            self.folder.leave_out("augment", "no time was left")
            return ()
        trained: list[Trained] = []
        self.watch.on_step("augment")
        with self.folder.step("augment", may_fail=True) as step:
            # A fit that is no better than the model as it came is nothing to build on.
            fitted = identified is not None and identified.fit.status != "no-better"
            failed: dict[str, TrueupError] = {}
            for made in train_each(
                plan_of(self.methods, fitted=fitted),
                self.dataset,
                self.robot,
                self.folder.networks,
                drop_flagged=self.drop_flagged,
                seed=self.seed,
                jobs=self.jobs,
                overwrite=self.overwrite,
                limit=limit,
                track=self.track,
                on_training=self.watch.on_training,
                failed=failed,
            ):
                trained.append(corrected_everywhere(made, self.dataset, track=self.track))
                self.folder.add_network(made.label, made.folder)
            if failed and not trained:
                raise next(iter(failed.values()))
            words = [network.words for network in trained]
            words += [f"{name} failed: {error.summary}" for name, error in failed.items()]
            step.what = "; ".join(words)
            if all(network.kept for network in trained):
                step.status = "kept"
            elif any(network.cut_short for network in trained):
                step.status = "cut short"
        return tuple(trained)

    def _judge(self, trained: Sequence[Trained]) -> list[str]:
        """Write augment.json, of the networks that correct the best model; what must be known of it."""
        bases = [network.base for network in trained]
        base = "fitted" if "fitted" in bases else "stock"
        splits = [split for split in ("test", "val") if split in self.dataset.splits.values()]
        own = [network for network in trained if network.base == base]
        if not own or not splits:
            return []
        try:
            judged = judge(
                self.dataset,
                [network.folder for network in own],
                run=own[0].run,
                split=splits[0],
                drop_flagged=self.drop_flagged,
                seed=self.seed,
                track=self.track,
            )
        except TrueupError as error:  # the ladder has them all the same
            return [f"no tables of the networks: {error.summary}"]
        judged.result.save(self.folder.path / AUGMENT_NAME)
        return [*judged.warnings, *judged.notes]


def _corrected(trained: Sequence[Trained], base: str, seconds: float) -> dict[str, tuple[str, float]]:
    """Rung -> label and seconds, of the networks that correct one; what that took is part of what they took."""
    return {item.rung: (item.label, seconds + item.seconds) for item in trained if item.base == base}


def _main_number(measurement: Measurement, run: str) -> str:
    """The number by which rungs are chosen, on what is nearest to a test."""
    signal, metric = CHOICE
    splits = measurement.gap.runs.get(run, {})
    for split in ("test", "val", "train", "all"):
        if metric in splits.get(split, {}).get(signal, {}):
            total = splits[split][signal][metric].total
            return f"{signal} {metric} {total.value:.4g} {total.unit} on {split}"
    return "no positions to compare"


def _shares(attribution: Attribution) -> str:
    labels = {step.cause: step.label for step in attribution.steps} | {UNEXPLAINED: UNEXPLAINED}
    shares = sorted(attribution.shares_total.items(), key=lambda item: -item[1])
    return ", ".join(f"{labels[cause]} {100 * share:.0f} %" for cause, share in shares if share >= 0.005)


def _say_fit(step: StepOutcome, found: Identified, *, kept: bool) -> None:
    fitted = found.fit
    sure = sum(item.identified == "yes" for item in fitted.free)
    stopped = fitted.solver["stop"] == "time"
    step.status = "kept" if kept else "cut short" if stopped else "done"
    chosen = next((row.name for row in fitted.models if row.chosen), "")
    step.what = f"{sure} of {len(fitted.free)} parameters determined, status {fitted.status}, model {chosen!r}"
