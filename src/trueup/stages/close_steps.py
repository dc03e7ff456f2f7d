"""The steps of a close after the import: each is the command of its name, and all results lie in one folder."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from trueup.core.attribution import Attribution
from trueup.core.augment_result import AUGMENT_NAME
from trueup.core.check_result import CHECK_NAME, CheckResult
from trueup.core.close_result import NO_TIME, STEPS, CloseResult, StepName
from trueup.core.fit_result import FitResult
from trueup.core.results import Ladder
from trueup.core.time_limit import TimeLimit
from trueup.dataset import Dataset
from trueup.errors import DataError, TrueupError
from trueup.robots import RobotSpec
from trueup.stages import close_words as words
from trueup.stages.checking import check_inputs, check_setup
from trueup.stages.close_asked import asked_of_data
from trueup.stages.close_budget import Budget, fitted_motion
from trueup.stages.close_folder import EXPLAIN_CONFIG, EXPLAIN_NAME, LADDER_NAME, CloseFolder
from trueup.stages.close_networks import Trained, corrected_everywhere, plan_of, train_each
from trueup.stages.evaluating import judge
from trueup.stages.folder import forget_explanation, refuse_other_fit
from trueup.stages.identifying import FITTED, Identified, explain, explain_inputs, fit
from trueup.stages.importing import ImportSummary
from trueup.stages.ladder import ladder_of
from trueup.stages.measuring import Measurement, gap
from trueup.stages.progress import Track, silent
from trueup.stages.replaying import STOCK, ReplaySummary, replay_unless_same

if TYPE_CHECKING:
    from trueup.augment import Progress
    from trueup.identify import IdentifyConfig, OnModel

FIT_NAME = "fit.json"
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
        result: the steps, as in close.json.
        ladder: the rungs; none before the step gap.
        replayed: the replay of the stock model; None if that was not asked for.
        measurement: gap, analysis, traces, quality, of all runs; likewise.
        imported: the import, None if the dataset was there.
        checked: what was found wrong with the set-up; None if that was not asked for or failed.
        stopped: whether the call ended there, for something is certainly wrong.
        attribution: where the gap comes from; None if that was not asked for or failed.
        identified: the fit; likewise.
        networks: those that were trained.
        notes: what was left out, and what must be known besides.
    """

    dataset: Dataset
    result: CloseResult
    ladder: Ladder = field(default_factory=lambda: Ladder(()))
    replayed: ReplaySummary | None = None
    measurement: Measurement | None = None
    imported: ImportSummary | None = None
    checked: CheckResult | None = None
    stopped: bool = False
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
    drop_flagged: bool | None
    seed: int
    jobs: int | None
    folder: CloseFolder
    budget: Budget
    force: bool = False
    track: Track = silent
    watch: Watch = field(default_factory=Watch)

    def climb(self) -> Closed:
        """All steps that were asked for, one after the other."""
        out, asked = self.folder.path, self.folder.result.is_asked
        if not self.folder.overwrite:
            refuse_other_fit(out, self.dataset.hash)
        self.folder.agree(asked_of_data(self.dataset, self.robot, self.model), data_hash=self.dataset.hash)
        try:
            replayed = self._replay()
        except DataError:
            # Of degrees for radians, no simulation comes back: what is wrong is the set-up, if the check is sure of it.
            checked = check_setup(self.dataset, self.robot, model=self.model) if asked("check") else None
            if checked is None or not checked.certain or self.force:
                raise
            return Closed(self.dataset, self.folder.result, checked=checked, stopped=True)
        forget_explanation(out, unless_of=None if self.folder.overwrite else self.dataset.hash)
        if not asked("gap"):
            return Closed(self.dataset, self.folder.result, replayed=replayed, notes=replayed.notes)
        self.budget.took(replay_s=replayed.seconds)
        rungs = {"stock": (STOCK, replayed.seconds)}
        self.watch.on_step("gap")
        with self.folder.step("gap") as step:
            began = time.perf_counter()
            measurement, ladder = self._measure(rungs)
            self.budget.took(measure_s=time.perf_counter() - began)
            step.what = words.main_number(measurement, STOCK)
        checked = self._check() if asked("check") else None
        if checked is not None and checked.certain and not self.force:
            closed = Closed(self.dataset, self.folder.result, ladder, replayed, measurement, checked=checked)
            return self._stopped(closed, checked)
        identified = self._identify(replayed) if asked("identify") else None
        trained = self._augment(identified) if asked("augment") else ()
        notes = [*([] if asked("check") else self._what_a_check_says()), *replayed.command_notes]
        if trained or identified is not None:
            began = time.perf_counter()
            rungs |= _corrected(trained, "stock", replayed.seconds)
            if identified is not None:
                seconds = sum(row.seconds for row in identified.fit.models) + identified.replayed[1].seconds
                rungs |= {"fitted": (FITTED, seconds), **_corrected(trained, "fitted", seconds)}
            measurement, ladder = self._measured_again(rungs, identified)
            if not self._holds_more(rungs):
                notes += self._judge(trained)
            self.folder.measured(time.perf_counter() - began)
        # Last, so that the steps that were asked for have their time first.
        attribution = self._explain(replayed, identified) if asked("explain") else None
        if attribution is not None:
            notes += attribution.statements
        if identified is not None:
            notes += [*identified.fit.statements, *identified.notes]
        return Closed(
            dataset=self.dataset,
            result=self.folder.result,
            ladder=ladder,
            replayed=replayed,
            measurement=measurement,
            checked=checked,
            attribution=attribution,
            identified=identified,
            networks=trained,
            notes=tuple(dict.fromkeys(line for line in notes if line not in measurement.gap.settings["warnings"])),
        )

    def _replay(self) -> ReplaySummary:
        robot, folder = self.robot, self.folder
        if folder.result.is_asked("identify") or (not folder.overwrite and (folder.path / FIT_NAME).is_file()):
            from trueup.identify import judged

            # In the windows of the fit, where it has some: nothing else can be compared with it.
            robot = judged(robot, self.config)
        self.watch.on_step("replay")
        with folder.step("replay") as step:
            done = replay_unless_same(
                self.dataset, robot, model=self.model, label=STOCK, jobs=self.jobs, track=self.track
            )
            step.what = f"{done.replayed + done.kept} motions simulated with the original model"
            if done.replaced:
                step.what += f", in place of the run {STOCK} of another robot, model, setting or version"
            step.made = bool(done.replayed)
            # The run is the dataset's: it may be there before the first close of this folder.
            step.kept = not step.made and folder.earlier("replay") is not None
            if not step.made and not step.kept:
                step.what += ", as the dataset has them"
            if folder.overwrite:  # only now, when nothing speaks against data, robot and model
                folder.begin_anew()
        return done

    def _measured_again(
        self, rungs: Mapping[str, tuple[str, float]], identified: Identified | None
    ) -> tuple[Measurement, Ladder]:
        """All runs together; what the fit has measured need not be measured again."""
        plain = self.metrics is None and not self.drop_flagged
        if identified is None or set(rungs) != {"stock", "fitted"} or not plain:
            return self._measure(rungs)
        measurement, ladder = identified.measurement, ladder_of(identified.measurement, rungs)
        if not self._holds_more(rungs):
            measurement.save(self.folder.path)
            ladder.save(self.folder.path / LADDER_NAME)
        return measurement, ladder

    def _measure(self, rungs: Mapping[str, tuple[str, float]]) -> tuple[Measurement, Ladder]:
        """Measure these runs; what the folder has of them and of others stays."""
        measurement = gap(
            self.dataset,
            runs=[label for label, _ in rungs.values()],
            drop_flagged=bool(self.drop_flagged),
            metrics=self.metrics,
            seed=self.seed,
            blocks=len(rungs) == 1,
            track=self.track,
        )
        ladder = ladder_of(measurement, rungs)
        if not self._holds_more(rungs):
            measurement.save(self.folder.path)
            ladder.save(self.folder.path / LADDER_NAME)
        return measurement, ladder

    def _holds_more(self, rungs: Collection[str]) -> bool:
        return self.folder.holds_more(rungs, self.dataset.hash)

    def _check(self) -> CheckResult | None:
        path = self.folder.path / CHECK_NAME
        inputs, earlier = check_inputs(self.dataset, self.robot, model=self.model), self.folder.earlier("check")
        kept = earlier is not None and earlier.inputs == inputs and path.is_file()
        found: CheckResult | None = None
        self.watch.on_step("check")
        with self.folder.step("check", may_fail=True) as step:
            step.inputs, step.kept = inputs, kept
            found = CheckResult.load(path) if kept else check_setup(self.dataset, self.robot, model=self.model)
            if not kept:
                found.save(path)
            step.what = words.of_findings(found)
        return found

    def _what_a_check_says(self) -> list[str]:
        """Of a gap alone: a number that says nothing if the set-up is wrong."""
        try:
            checked = check_setup(self.dataset, self.robot, model=self.model)
        except TrueupError:
            return []
        if not checked.certain:
            return []
        found = " ".join(finding.evidence for finding in checked.certain)
        return [
            f"this gap says little, since the set-up is wrong: {found} `trueup check` prints the lines that mend it"
        ]

    def _stopped(self, closed: Closed, checked: CheckResult) -> Closed:
        """What there is where a fit would only hide what is wrong."""
        why = f"the set-up is wrong ({words.of_certain(checked)}); --force goes on as it is"
        for name in STEPS[STEPS.index("check") + 1 :]:
            done = self.folder.result.step(name)
            if self.folder.result.is_asked(name) and (done is None or not done.finished):
                self.folder.leave_out(name, why)
        return replace(closed, result=self.folder.result, stopped=True)

    def _explain(self, replayed: ReplaySummary, identified: Identified | None) -> Attribution | None:
        path, limit = self.folder.path / EXPLAIN_NAME, self.budget.of("explain")
        # A fit that is no better than the model as it came says nothing of where the gap comes from.
        fitted = None if identified is None or identified.fit.status == "no-better" else identified.fit
        inputs = explain_inputs(
            self.dataset, self.robot, model=self.model, config=self.config, seed=self.seed, fitted=fitted
        )
        earlier = self.folder.earlier("explain")
        kept = earlier is not None and earlier.inputs == inputs and path.is_file()
        # What was asked for is not left out so that there is time to explain.
        if not kept and (_no_time(limit) or self.folder.result.untimely):
            self.folder.leave_out("explain", NO_TIME)
            return None
        found: Attribution | None = None
        self.watch.on_step("explain")
        with self.folder.step("explain", may_fail=True) as step:
            step.inputs, step.kept = inputs, kept
            if kept:
                found = Attribution.load(path)
            else:
                config = self.config
                if fitted is None:
                    config = self.folder.keep_config(EXPLAIN_CONFIG, self._fitted_motion(replayed.seconds, limit))
                found = explain(
                    self.dataset,
                    self.robot,
                    model=self.model,
                    fitted=fitted,
                    config=config,
                    seed=self.seed,
                    jobs=self.jobs,
                    on_progress=self.watch.on_fit,
                    limit=limit,
                )
            if not found.causes:  # there was time to look at the model as it came, and no more
                step.status, step.what, found = "left out", NO_TIME, None
            else:
                if not kept:
                    found.save(path)
                step.status = "cut short" if found.short_of_time else "done"
                step.what = words.shares(found)
        return found

    def _fitted_motion(self, replay_s: float, limit: TimeLimit | None) -> IdentifyConfig:
        from trueup.identify import IdentifyConfig

        return fitted_motion(self.config or IdentifyConfig(), self.robot, self.dataset, replay_s, limit)

    def _identify(self, replayed: ReplaySummary) -> Identified | None:
        path, limit = self.folder.path / FIT_NAME, self.budget.of("identify")
        earlier = FitResult.load(path) if path.is_file() else None
        if _no_time(limit) and earlier is None:
            self.folder.leave_out("identify", NO_TIME)
            return None
        found: Identified | None = None
        self.watch.on_step("identify")
        with self.folder.step("identify", may_fail=True) as step:
            found = fit(
                self.dataset,
                self.robot,
                self.folder.path,
                model=self.model,
                config=self.folder.identify_config(lambda: self._fitted_motion(replayed.seconds, limit)),
                seed=self.seed,
                jobs=self.jobs,
                resume=True,
                keep_gap=self._holds_more(("stock", "fitted")),
                track=self.track,
                on_progress=self.watch.on_fit,
                limit=limit,
            )
            step.kept = earlier is not None and earlier.data.get("inputs") == found.fit.data["inputs"]
            step.status = "cut short" if found.fit.short_of_time else "done"
            step.what = words.of_fit(found.fit)
        return found

    def _augment(self, identified: Identified | None) -> tuple[Trained, ...]:
        from trueup.identify import IdentifyConfig

        limit = self.budget.of("augment")
        # A fit that is no better than the model as it came is nothing to build on.
        fitted = identified is not None and identified.fit.status != "no-better"
        plan, untried = plan_of(self.methods, fitted=fitted), []
        if _no_time(limit):
            untried = [item.rung for item in plan if not item.is_there(self.folder.networks)]
            plan = [item for item in plan if item.rung not in untried]
            if not plan:
                self.folder.leave_out("augment", NO_TIME)
                return ()
        trained: list[Trained] = []
        self.watch.on_step("augment")
        with self.folder.step("augment", may_fail=True) as step:
            failed: dict[str, TrueupError] = {}
            for made in train_each(
                plan,
                self.dataset,
                self.robot,
                self.folder.networks,
                drop_flagged=(self.config or IdentifyConfig()).data.drop,
                seed=self.seed,
                jobs=self.jobs,
                overwrite=self.folder.overwrite,
                limit=limit,
                track=self.track,
                on_training=self.watch.on_training,
                failed=failed,
            ):
                trained.append(corrected_everywhere(made, self.dataset, track=self.track))
                self.folder.add_network(made.label, made.folder)
            if failed and not trained:
                raise next(iter(failed.values()))
            step.kept = all(network.kept for network in trained)
            step.status = "cut short" if untried or any(network.cut_short for network in trained) else "done"
            step.what = words.of_networks(trained, failed, untried)
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
                drop_flagged=bool(self.drop_flagged),
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


def _no_time(limit: TimeLimit | None) -> bool:
    return limit is not None and limit.left_s < _LEAST_S
