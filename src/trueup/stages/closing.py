"""Close: from logs to a corrected simulator, rung by rung, on one dataset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from trueup.augment.networks import METHODS as KNOWN_METHODS
from trueup.core.close_result import STEPS, StepName
from trueup.core.provenance import provenance
from trueup.core.sole_writer import sole_writer
from trueup.dataset import Dataset, is_dataset, refuse_results
from trueup.dataset.importers.base import ImportOptions
from trueup.errors import ConfigError
from trueup.robots import RobotSpec, find_model
from trueup.stages.close_asked import asked_beforehand
from trueup.stages.close_budget import Budget
from trueup.stages.close_folder import CloseFolder, may_begin
from trueup.stages.close_networks import METHODS
from trueup.stages.close_steps import Closed, CloseSteps, Watch
from trueup.stages.importing import import_logs, is_whole, refuse_nesting, split_anew
from trueup.stages.progress import Track, silent

if TYPE_CHECKING:
    from trueup.identify import IdentifyConfig


def close(
    source: Path | str,
    robot: RobotSpec,
    out: Path | str,
    *,
    model: Path | None = None,
    format: str | None = None,
    options: ImportOptions | None = None,
    splits: Path | Mapping[str, float] | None = None,
    drop_flagged: bool | None = None,
    metrics: Sequence[str] | None = None,
    until: StepName = STEPS[-1],
    budget_s: float | None = None,
    config: IdentifyConfig | None = None,
    methods: Sequence[str] = METHODS,
    seed: int = 0,
    jobs: int | None = None,
    overwrite: bool = False,
    resume: bool = False,
    force: bool = False,
    track: Track = silent,
    watch: Watch | None = None,
) -> Closed:
    """From logs to a corrected simulator: import, replay, gap, check, explain, identify, augment.

    Every step is the command of its name, with the same results, and its files lie in `out`: those of `gap`, `explain`
    and `fit`, `networks/`, ladder.json with all rungs, close.json with the steps. Logs are imported into `out/dataset`.
    Everything is fitted on train and chosen on val. A step that fails (nothing can be learned from these motions, no
    torch) is noted, and the others go on without it. What an earlier call has done is kept, however little time it had.

    Args:
        source: a dataset, or logs of any known format.
        robot: its description.
        out: folder for the results.
        model: MJCF or URDF; looked for beside the data and in the package if None.
        format: of the logs; detected if None.
        options: for the import.
        splits: split.json or fractions, written into the dataset; where nothing says what to hold out, 70/15/15 of
            the logs of six motions or more.
        drop_flagged: leave out episodes with warnings, from all that is measured, fitted and trained. None leaves those
            whose measurement is broken out of what is fitted and trained (`config` may say otherwise), False none.
        metrics: names; a sensible set per signal if None.
        until: the last step; `import` for logs only.
        budget_s: time for this call [s]. Steps that search and train end with the best so far; with little time, less
            motion is fitted. What takes as long as it takes (reading, replays, measuring) is not cut.
        config: what is fitted; the default for the robot's controller if None.
        methods: of the networks that are trained on what is left.
        seed: of all draws.
        jobs: threads; the number of cores if None.
        overwrite: replace the results that are in `out`. They stay until there is a replay for new ones.
        resume: go on where an earlier call was interrupted, or ended, that asked for the same robot, model,
            configuration, seed and motions. Other methods add networks. One that was to replace results does so.
        force: go on where the check is certain that the set-up is wrong; without it the call ends there.
        track: shows progress.
        watch: who is told more.

    Raises:
        OutputExists: `out` holds results, and neither `overwrite` nor `resume` is given; or those of other inputs, or
            of fewer logs.
        ConfigError: there is no such step or method, nothing to import, options that would count for nothing, or a
            time that is not positive.
        TrueupError: what import, replay and gap raise.
    """
    from trueup.identify import IdentifyConfig

    if until not in STEPS:
        raise ConfigError("there is no such step", got=until, available=STEPS)
    if budget_s is not None and not budget_s > 0:
        raise ConfigError("the budget must be positive", got=f"{budget_s:g} s")
    methods = tuple(dict.fromkeys(methods))
    for method in methods:
        if method not in KNOWN_METHODS:
            raise ConfigError("there is no such method", got=method, available=KNOWN_METHODS)
    source, out, watch = Path(source), Path(out), watch or Watch()
    refuse_results(source)
    if not is_dataset(source):
        refuse_nesting(source, out / "dataset")
    elif format is not None or (options or ImportOptions()) != ImportOptions():
        raise ConfigError(
            f"{source} is a dataset, so import options do not apply",
            expected="none of --format, --mapping, --unit and topics",
            hint="Leave them out, or give the logs that it was imported from.",
        )
    elif until == "import":
        raise ConfigError(
            f"{source} is a dataset: there is nothing to import", hint="Give --until replay, or a later step."
        )
    if model is not None:
        find_model(robot, given=Path(model))
    if drop_flagged is not None:
        given = config or IdentifyConfig()
        data = replace(given.data, keep_flagged=not drop_flagged, drop_flagged=drop_flagged)
        config = replace(given, data=data)
    asked_for = asked_beforehand(robot, config, seed=seed, drop_flagged=drop_flagged, metrics=metrics, splits=splits)
    with sole_writer(out):
        may_begin(out, overwrite=overwrite, resume=resume)
        asked = {"until": until, "budget_s": budget_s, "methods": list(methods), "drop_flagged": drop_flagged}
        folder = CloseFolder(
            out,
            until=until,
            budget_s=budget_s,
            overwrite=overwrite,
            provenance=provenance(config=asked, seed=seed),
        )
        folder.agree(asked_for)
        budget = Budget(budget_s, [step for step in STEPS if folder.result.is_asked(step)])
        with folder.replacing():
            imported, path = None, source
            if is_dataset(source):
                if splits is not None:
                    split_anew(Dataset(source), splits, seed=seed)
            else:
                path = out / "dataset"
                watch.on_step("import")
                with folder.step("import") as step:
                    # What was to be replaced when an earlier call was interrupted is not gone on with.
                    old = folder.overwrite and folder.earlier("import") is None
                    anew = overwrite or (old and is_whole(path))
                    imported = import_logs(
                        source,
                        path,
                        format=format,
                        options=options,
                        robot=robot,
                        refuse_others=not resume,
                        refuse_more=folder.earlier("replay") is not None,
                        splits=splits,
                        hold_out=True,
                        seed=seed,
                        overwrite=anew,
                        resume=not anew and resume,
                        track=track,
                    )
                    step.what = f"{len(Dataset(path))} motions"
                    step.kept = not imported.imported
                watch.on_import(imported)
            if until == "import":
                if folder.overwrite:
                    folder.begin_anew()
                return Closed(Dataset(path), folder.result, imported=imported)
            steps = CloseSteps(
                dataset=Dataset(path),
                robot=robot,
                model=model,
                config=config,
                methods=methods,
                metrics=metrics,
                drop_flagged=drop_flagged,
                seed=seed,
                jobs=jobs,
                track=track,
                watch=watch,
                folder=folder,
                budget=budget,
                force=force,
            )
            return replace(steps.climb(), imported=imported)
