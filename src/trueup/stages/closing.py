"""Close: all rungs that there are, on one dataset."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from trueup.core.atomic import make_folder
from trueup.core.results import Ladder
from trueup.dataset import Dataset, is_dataset
from trueup.dataset.importers.base import ImportOptions
from trueup.errors import OutputExists
from trueup.robots import RobotSpec, find_model
from trueup.stages.folder import forget_explanation, forget_fit, refuse_other_fit
from trueup.stages.importing import ImportSummary, import_logs, refuse_nesting
from trueup.stages.ladder import ladder_of
from trueup.stages.measuring import Measurement, gap
from trueup.stages.progress import Track, silent
from trueup.stages.replaying import STOCK, ReplaySummary, replay_unless_same


@dataclass(frozen=True)
class Closed:
    """What `close` made.

    Attributes:
        dataset: the dataset, imported if need be.
        imported: the import, None if the dataset was there.
        replayed: the replay of the stock model.
        measurement: gap, analysis, traces, quality.
        ladder: the rungs.
    """

    dataset: Dataset
    imported: ImportSummary | None
    replayed: ReplaySummary
    measurement: Measurement
    ladder: Ladder


def close(
    source: Path | str,
    robot: RobotSpec,
    out: Path | str,
    *,
    model: Path | None = None,
    format: str | None = None,
    options: ImportOptions | None = None,
    splits: Path | Mapping[str, float] | None = None,
    drop_flagged: bool = False,
    metrics: Sequence[str] | None = None,
    seed: int = 0,
    jobs: int | None = None,
    overwrite: bool = False,
    resume: bool = False,
    track: Track = silent,
    on_import: Callable[[ImportSummary], None] = lambda _: None,
) -> Closed:
    """From logs to a ladder: import if needed, check, replay, measure.

    Writes gap.json, ladder.json, analysis.json, quality.json and traces into `out`; logs are imported into
    `out/dataset`. The stock run of a dataset is made anew only if data, robot or model changed.

    Args:
        source: a dataset, or logs of any known format.
        robot: its description.
        out: folder for the results.
        model: MJCF or URDF; looked for beside the data and in the package if None.
        format: of the logs; detected if None.
        options: for the import.
        splits: split.json or fractions, for the import.
        drop_flagged: leave out episodes with warnings.
        metrics: names; a sensible set per signal if None.
        seed: of all draws.
        jobs: threads; the number of cores if None.
        overwrite: replace the results that are in `out`.
        resume: go on where an earlier call was interrupted.
        track: shows progress.
        on_import: called when logs were imported, before the rest, which takes longer.

    Raises:
        OutputExists: `out` holds results, and neither `overwrite` nor `resume` is given.
        TrueupError: what any step raises.
    """
    source, out = Path(source), Path(out)
    if not is_dataset(source):
        refuse_nesting(source, out / "dataset")
    if model is not None:
        find_model(robot, given=Path(model))
    make_folder(out)
    if any(out.iterdir()) and not (overwrite or resume):
        raise OutputExists(f"{out} is not empty", hint="Give --overwrite or --resume, or choose another --out.")
    imported = None
    dataset_path = source
    if not is_dataset(source):
        dataset_path = out / "dataset"
        imported = import_logs(
            source,
            dataset_path,
            format=format,
            options=options,
            robot=robot,
            splits=splits,
            seed=seed,
            overwrite=overwrite,
            resume=resume,
            track=track,
        )
        on_import(imported)
    dataset = Dataset(dataset_path)
    if not overwrite:
        refuse_other_fit(out, dataset.hash)
    replayed = replay_unless_same(dataset, robot, model=model, label=STOCK, jobs=jobs, track=track)
    measurement = gap(dataset, runs=[STOCK], drop_flagged=drop_flagged, metrics=metrics, seed=seed, track=track)
    ladder = ladder_of(measurement, {"stock": (STOCK, replayed.seconds)})
    forget_explanation(out, unless_of=None if overwrite else dataset.hash)
    if overwrite:
        forget_fit(out)
    measurement.save(out)
    ladder.save(out / "ladder.json")
    return Closed(dataset, imported, replayed, measurement, ladder)
