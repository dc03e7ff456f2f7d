"""`trueup close`."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from trueup.cli import options
from trueup.cli.augment_train import progress_line
from trueup.cli.check import GO_ON, show_findings
from trueup.cli.console import answer, begins, note, out, problem, search_line, status_line, track, volume, warning
from trueup.cli.convert import show_flags, show_import
from trueup.cli.fit_tables import status_line as fit_status
from trueup.cli.gap import hold_bars
from trueup.cli.identify import UNUSABLE
from trueup.cli.tables import ladder_table, steps_table, verdicts
from trueup.core.close_result import StepName
from trueup.core.results import GapResult
from trueup.errors import ConfigError, TrueupError

if TYPE_CHECKING:
    from trueup.augment import Progress as TrainingProgress
    from trueup.identify import Progress as SearchProgress
    from trueup.stages import Closed, Watch

# A literal that typer can read; the same as `StepName`.
Step = Literal["import", "replay", "gap", "check", "explain", "identify", "augment"]
UntilStep = Annotated[Step, typer.Option("--until", help="The last step.")]
_BEGINS: dict[StepName, str] = {
    "import": "import: reading the logs",
    "replay": "replay: simulating the logged commands with the original model",
    "gap": "gap: comparing the simulation with the robot",
    "check": "check: comparing logs, robot.yaml and model",
    "explain": "explain: finding where the gap comes from",
    "identify": "identify: fitting the model",
    "augment": "augment: training networks on the remaining error",
}
_BEFORE_GAP: tuple[StepName, ...] = ("import", "replay")
# Notes at the end of everything: the report has the rest.
_MOST_NOTES = 5


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("close")(close)


def close(
    dataset: Annotated[Path, typer.Argument(help="Folder of a dataset, or logs of any known format.")],
    out_dir: options.Results = None,
    robot: options.RobotOrModel = None,
    until: UntilStep = "augment",
    budget: Annotated[
        str, typer.Option("--budget", help="Time for all steps together, e.g. 90s, 10m, 1h; `none` for no limit.")
    ] = "15m",
    config: Annotated[
        Path | None, typer.Option("--config", help="YAML that says what to fit; see docs/identification.md.")
    ] = None,
    method: Annotated[
        list[str] | None,
        typer.Option("--method", help="Network to train on the remaining error; repeatable; three if not given."),
    ] = None,
    model: options.Model = None,
    format: options.Format = None,
    mapping: options.Mapping = None,
    unit: options.Units = None,
    command_topic: options.CommandTopic = None,
    measured_topic: options.MeasuredTopic = None,
    splits: options.Splits = None,
    drop_flagged: options.TrainFlagged = None,
    fail_above: options.FailAbove = None,
    seed: options.Seed = 0,
    jobs: options.Jobs = None,
    overwrite: options.Overwrite = False,
    resume: options.Resume = False,
    force: options.Force = False,
    skip_bad: options.SkipBad = False,
) -> int:
    """From logs to a corrected simulator, in one go.

    Import, replay, gap, check, explain, identify, augment, and a report of it all.

    Exit code 3 if the set-up is certainly wrong, a step failed, the fit is of no use, or a bar was not met.
    """
    from trueup.identify import IdentifyConfig
    from trueup.measure import parse_bar, refuse_unknown
    from trueup.robots import load_robot
    from trueup.stages import close as run
    from trueup.stages import keep_draft
    from trueup.stages.close_networks import METHODS, possible_runs
    from trueup.stages.drafting import MAPPING_NAME

    out_dir = options.folder_for(out_dir, dataset)
    bars = [parse_bar(text) for text in fail_above or []]
    if bars and until in _BEFORE_GAP:
        raise ConfigError(
            "--fail-above is held against the gap", got=f"--until {until}", hint="Give --until gap, or a later step."
        )
    methods = tuple(method or METHODS)
    refuse_unknown(bars, runs=possible_runs(until, methods))
    choices = options.reading(mapping, unit, command_topic, measured_topic, robot)
    known = options.robot_or_model(robot, model)
    drafted = options.drafted_of(known, dataset, format, choices)
    described = load_robot(known) if drafted is None else drafted.robot
    with watching() as watch, tempfile.TemporaryDirectory() as place:
        if drafted is not None and drafted.mapping:
            choices = replace(choices, mapping=Path(place) / MAPPING_NAME)
            (Path(place) / MAPPING_NAME).write_text(drafted.mapping)
        closed = run(
            dataset,
            described,
            out_dir,
            model=model,
            format=format,
            options=choices,
            splits=options.splits_choice(splits),
            drop_flagged=drop_flagged,
            until=until,
            budget_s=options.budget_s(budget),
            config=IdentifyConfig.load(config) if config else None,
            methods=methods,
            seed=seed,
            jobs=jobs,
            overwrite=overwrite,
            resume=resume,
            force=force,
            track=track,
            watch=watch,
        )
    if drafted is not None:
        keep_draft(drafted, out_dir)
    show(closed, out_dir)
    if closed.measurement is not None:
        hold_bars(closed.measurement.gap, bars)
    return exit_code(closed, skip_bad=skip_bad)


def exit_code(closed: Closed, *, skip_bad: bool = False) -> int:
    """2 if motions were refused, 3 if something is lacking, which is said."""
    refused = bool(_not_replayed(closed)) or bool(closed.imported and closed.imported.refused)
    if refused and not skip_bad:
        return 2
    missing = lacking(closed)
    if closed.stopped:
        problem("nothing was fitted: the set-up is wrong, and a fit would hide that in wrong parameter values", GO_ON)
    elif missing:
        problem(
            "; ".join(missing),
            "The lines above say why. --resume repeats failed steps and keeps the fit; --overwrite fits again.",
        )
    return 3 if missing or closed.stopped else 0


@contextlib.contextmanager
def watching() -> Iterator[Watch]:
    """Shows which step is under way, and where searches and trainings stand."""
    from trueup.stages import Watch

    with contextlib.ExitStack() as stack:
        lines: list[Callable[[str], None]] = []

        def on_step(name: StepName) -> None:
            stack.close()  # a step has a line of its own
            begins(_BEGINS[name])
            lines[:] = [stack.enter_context(status_line())]

        def on_fit(model: str, progress: SearchProgress) -> None:
            lines[0](search_line(model, progress))

        def on_training(network: str, progress: TrainingProgress) -> None:
            lines[0](f"{network}: {progress_line(progress)}")

        yield Watch(on_step=on_step, on_import=show_import, on_fit=on_fit, on_training=on_training)


def _told(closed: Closed) -> dict[str, Any]:
    """Which comparisons are told: all of a single run; of more, those of the chosen one and of the fit, on test."""
    from trueup.stages import FITTED, STOCK

    if len(closed.ladder.rungs) <= 2:
        return {}
    labels = {"stock": STOCK, "fitted": FITTED, **{network.rung: network.label for network in closed.networks}}
    best = next((labels[rung.name] for rung in closed.ladder.rungs if rung.chosen and rung.name in labels), None)
    splits = set(closed.dataset.splits.values())
    split = next((name for name in ("test", "val", "train") if name in splits), None)
    return {"of": {label for label in (best, FITTED) if label is not None}, "split": split}


def _not_replayed(closed: Closed) -> list[tuple[str, TrueupError]]:
    """Motion, with the model if it is not the one that came, and why."""
    failed = list(closed.replayed.failed.items()) if closed.replayed else []
    if closed.identified is not None:
        own = closed.identified.replayed[1]
        failed += [(f"{name}, by {own.label},", error) for name, error in own.failed.items()]
    return failed


def lacking(closed: Closed) -> list[str]:
    """What was asked for and is not there, or of no use; a fit that the time has ended is what there was time for."""
    found = [f"{step.name} failed" for step in closed.result.failed]
    # No later step needs the explanation, so that its absence is a warning where another step was asked for.
    untimely = [step.name for step in closed.result.untimely]
    found += [f"no time was left for {name}" for name in untimely if name != "explain" or closed.result.until == name]
    fit = None if closed.identified is None else closed.identified.fit
    if fit is not None and fit.status in UNUSABLE and not fit.ended_by_time:
        found.append(f"the fit is of no use ({fit.status})")
    return found


def show(closed: Closed, out_dir: Path) -> None:
    """Steps, ladder, verdicts, and the report's path; without a gap, where the motions are."""
    from trueup.report import write_report

    answer(closed.result)
    if closed.measurement is not None and not closed.imported:
        show_flags(closed.measurement.quality)
    for name, error in _not_replayed(closed):
        problem(f"{name} was not replayed: {error.what}: {error.details}", error.hint)
    if closed.measurement is None:
        for line in closed.replayed.notes if closed.replayed else ():
            note(line)
        run = f", with the run {closed.replayed.label}" if closed.replayed else ""
        out.print(f"dataset: {closed.dataset.path}{run}", markup=False)
        if closed.checked is not None:
            show_findings(closed.checked)
        return
    if len(closed.result.steps) > 2:
        out.print(steps_table(closed.result))
    _show_ladder(closed, closed.measurement.gap)
    if closed.checked is not None:
        show_findings(closed.checked)
    _show_fit(closed)
    for step in closed.result.steps:
        if step.status in ("failed", "left out") and closed.result.is_asked(step.name) and not closed.stopped:
            warning(f"{step.name} {step.status}: {step.what}")
    told = len(closed.notes) if volume.verbose else _MOST_NOTES
    for line in closed.notes[:told]:
        note(line)
    if len(closed.notes) > told:
        note(f"{len(closed.notes) - told} more are in the report; --verbose prints them")
    out.print(f"report: {write_report(out_dir)}", markup=False)


def _show_ladder(closed: Closed, gap: GapResult) -> None:
    out.print(ladder_table(closed.ladder))
    if any(rung.chosen for rung in closed.ladder.rungs):
        common = ", of the motions that all have" if gap.settings["missing_episodes"] else ""
        out.print(f"* best on val{common}", markup=False)
    for line in verdicts(gap, **_told(closed)):
        out.print(line, markup=False)
    for line in gap.settings["warnings"]:
        note(line)


def _show_fit(closed: Closed) -> None:
    if closed.identified is None:
        return
    text, hint = fit_status(closed.identified.fit)
    if closed.identified.fit.status == "ok":
        out.print(text, markup=False)
    else:
        warning(text, hint)
