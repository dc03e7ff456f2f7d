"""Many robots of one kind, each closed by itself, side by side in processes or on a Ray cluster; one table of all."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from trueup.core.close_result import CLOSE_NAME, STEPS, StepName
from trueup.core.fit_result import FitResult, FittedParameter
from trueup.core.fleet_result import FLEET_NAME, FleetParameter, FleetResult, FleetUnit, UnitValue
from trueup.core.provenance import provenance
from trueup.core.ray_workers import connected
from trueup.core.results import Ladder
from trueup.core.sole_writer import sole_writer
from trueup.core.spread import here, spread
from trueup.dataset import Dataset, DatasetWriter, is_dataset
from trueup.errors import ConfigError, DataError, OutputExists, TrueupError
from trueup.measure.population import population
from trueup.robots import RobotSpec
from trueup.stages.close_networks import METHODS
from trueup.stages.closing import close
from trueup.stages.progress import Track, silent

if TYPE_CHECKING:
    from trueup.identify import IdentifyConfig

_DATA = "dataset"
_Z95 = 1.959963984540054
# Letters of the name of a folder; others become one of them.
_PLAIN = "-_."


@dataclass(frozen=True)
class _Task:
    """One unit: where its data are, and all that `close` is asked."""

    name: str
    data: Path
    folder: Path
    robot: RobotSpec
    model: Path | None
    config: IdentifyConfig | None
    until: StepName
    budget_s: float | None
    methods: tuple[str, ...]
    seed: int


@dataclass(frozen=True)
class _Outcome:
    """What became of it."""

    unit: FleetUnit
    fit: FitResult | None = None
    signal: str = ""


def fleet(
    datasets: Sequence[Path | str],
    robot: RobotSpec,
    out: Path | str,
    *,
    model: Path | None = None,
    config: IdentifyConfig | None = None,
    until: StepName = "identify",
    budget_s: float | None = None,
    methods: Sequence[str] = METHODS,
    seed: int = 0,
    jobs: int | None = None,
    ray: str | None = None,
    overwrite: bool = False,
    resume: bool = False,
    track: Track = silent,
) -> FleetResult:
    """Close each of many robots by itself, and say what they have in common and which is not like the others.

    A dataset of several units is taken apart; each unit has a folder below `out` with all that `close` leaves. A unit
    that fails is listed, and the others go on. What an earlier call has finished is kept, and a worker of a cluster
    that is killed is replaced; its unit goes on where it was.

    Args:
        datasets: of one or more units each; on a cluster, in a folder that all its machines have.
        robot: their description.
        out: folder for the results; likewise.
        model: MJCF or URDF; looked for beside the data and in the package if None.
        config: what is fitted; the default for the robot's controller if None.
        until: the last step of each, see `close`.
        budget_s: time for each [s].
        methods: of networks, where `until` is `augment`.
        seed: of all draws; the same for each.
        jobs: units at a time; the number of cores, or of the cluster's processors, if None.
        ray: address of a Ray cluster, `local` for one on this machine; processes of this machine if None.
        overwrite: replace the results that are in `out`.
        resume: go on where an earlier call was interrupted.
        track: shows progress.

    Raises:
        OutputExists: `out` holds results, and neither `overwrite` nor `resume` is given.
        ConfigError: no such step, no data, or no such cluster.
        DataError: nothing could be done with any unit, or a dataset is broken.
    """
    if until not in STEPS[2:]:
        raise ConfigError("there is no such last step of a fleet", got=until, available=STEPS[2:])
    if not datasets:
        raise ConfigError("a fleet needs data", got="no dataset")
    if jobs is not None and jobs < 1:
        raise ConfigError("jobs must be at least 1", got=jobs)
    out = Path(out)
    with connected(ray, jobs), sole_writer(out):
        if any(out.iterdir()) and not (overwrite or resume):
            raise OutputExists(f"{out} is not empty", hint="Give --overwrite or --resume, or choose another --out.")
        tasks = [
            _Task(name, data, out / name, robot, model, config, until, budget_s, tuple(methods), seed)
            for name, data in _units([Path(path) for path in datasets], out, overwrite=overwrite)
        ]
        outcomes: dict[str, _Outcome] = {}
        for task, outcome in track(_ended(tasks, jobs, ray), "fleet", len(tasks)):
            outcomes[task.name] = outcome
        done = [outcomes[task.name] for task in tasks]
        if all(outcome.unit.status == "failed" for outcome in done):
            raise DataError("nothing could be done with any unit, the first because", got=done[0].unit.reason)
        asked = {"until": until, "budget_s": budget_s, "methods": list(methods), "robot": robot.name}
        result = FleetResult(
            tuple(outcome.unit for outcome in done),
            summarized({outcome.unit.name: outcome.fit for outcome in done if outcome.fit is not None}),
            next((outcome.signal for outcome in done if outcome.signal), ""),
            until,
            provenance(config=asked, seed=seed),
        )
        result.save(out / FLEET_NAME)
        return result


def summarized(fits: dict[str, FitResult]) -> tuple[FleetParameter, ...]:
    """Each parameter over the units whose data determine it, as a population; logarithms of what cannot be negative."""
    names: dict[str, FittedParameter] = {
        parameter.name: parameter for fit in fits.values() for parameter in fit.parameters if not parameter.frozen
    }
    rows = []
    for name, first in names.items():
        known = {
            unit: parameter
            for unit, fit in fits.items()
            for parameter in fit.parameters
            if parameter.name == name and parameter.identified == "yes" and not parameter.at_bound
        }
        relative = first.transform == "log"
        scaled = {unit: scale for unit, parameter in known.items() if (scale := _scaled(parameter, relative))}
        if not scaled:
            continue
        values, deviations = np.array(list(scaled.values())).T
        found = population(values, deviations)
        ends = np.array([found.mean, found.mean - found.half_width, found.mean + found.half_width])
        mean, low, high = (np.exp(ends) if relative else ends).tolist()
        rows.append(
            FleetParameter(
                *(name, first.unit, first.label, relative, len(scaled), mean, low, high, first.nominal, found.spread),
                uncertainty=float(np.median(deviations)),
                apart=tuple(unit for unit, apart in zip(scaled, found.apart, strict=True) if apart),
            )
        )
    return tuple(rows)


def _scaled(parameter: FittedParameter, relative: bool) -> tuple[float, float] | None:  # noqa: FBT001
    """Value and standard deviation on the scale on which the interval is symmetric; None where there is none."""
    ends = np.array([parameter.value, *parameter.interval], float)
    if relative:
        if not (ends > 0).all():
            return None
        ends = np.log(ends)
    value, low, high = ends.tolist()
    deviation = (high - low) / (2 * _Z95)
    return (value, deviation) if np.isfinite(ends).all() and deviation > 0 else None


def _units(paths: Sequence[Path], out: Path, *, overwrite: bool) -> list[tuple[str, Path]]:
    """Each unit with its data: the dataset itself, or a part of it below `out`."""
    found: dict[str, Path] = {}
    for path in paths:
        dataset = Dataset(path)
        own = dict.fromkeys(meta.unit for meta in dataset.metas)
        for unit in own:
            name = _plain(unit or path.resolve().name)
            if name in found:
                name = _plain(f"{path.resolve().name}-{unit}")
            if name in found:
                raise ConfigError(
                    f"two units are called {name!r}", got=path, hint="Give their datasets folders with other names."
                )
            _clear(out / name, overwrite=overwrite)
            found[name] = path if len(own) == 1 else _part(dataset, unit, out / name / _DATA)
    return list(found.items())


def _plain(name: str) -> str:
    kept = "".join(letter if letter.isalnum() or letter in _PLAIN else "_" for letter in name)
    return kept.lstrip(".") or "unit"


def _clear(folder: Path, *, overwrite: bool) -> None:
    """Remove what an earlier call has left of a unit, and nothing else."""
    if not overwrite or not folder.exists():
        return
    if not ((folder / CLOSE_NAME).is_file() or (folder / _DATA).is_dir()):
        raise OutputExists(f"{folder} holds no results of a fleet", hint="Choose another --out.")
    shutil.rmtree(folder)


def _part(dataset: Dataset, unit: str, path: Path) -> Path:
    """The motions of one unit as a dataset, with what the whole one says."""
    info = replace(dataset.info, notes=(*dataset.info.notes, f"unit {unit} of {dataset.path.name}"))
    ids = [meta.id for meta in dataset.metas if meta.unit == unit]
    if not is_dataset(path) or set(Dataset(path).ids) != set(ids):
        with DatasetWriter.create(path, info, overwrite=True) as writer:
            for name in ids:
                writer.append(dataset.episode(name))
    models = dataset.path / "model"
    if models.is_dir():
        shutil.copytree(models, path / "model", dirs_exist_ok=True)
    return path


def _ended(tasks: Sequence[_Task], jobs: int | None, ray: str | None) -> Iterator[tuple[_Task, _Outcome]]:
    if ray is None:
        jobs = min(jobs or os.cpu_count() or 1, len(tasks))
    return spread(_closed, tasks, jobs=jobs, ray=ray, begin=_begin, with_args=here())


def _begin(folder: str) -> None:
    """Paths mean what they mean for whoever has started it, where the folder is there."""
    if Path(folder).is_dir():
        os.chdir(folder)


def _closed(task: _Task) -> _Outcome:
    """One unit, on one processor; what is finished of it is kept."""
    name, folder = task.name, task.folder.name
    try:
        done = close(
            task.data,
            task.robot,
            task.folder,
            model=task.model,
            config=task.config,
            until=task.until,
            budget_s=task.budget_s,
            methods=task.methods,
            seed=task.seed,
            jobs=1,
            resume=True,
        )
    except TrueupError as error:
        return _Outcome(FleetUnit(name, folder, "failed", reason=error.summary))
    seconds = sum(step.seconds for step in done.result.steps)
    signal, errors = _errors(done.ladder)
    motions = len(done.dataset)
    step = done.result.step("identify")
    path = task.folder / "fit.json"
    if step is None or step.status == "failed" or not path.is_file():
        status, reason = ("measured", "") if step is None else ("failed", step.what)
        return _Outcome(FleetUnit(name, folder, status, motions, seconds, reason, errors), None, signal)
    fit = FitResult.load(path)
    values = {
        parameter.name: UnitValue(parameter.value, *parameter.interval, parameter.identified)
        for parameter in fit.parameters
        if not parameter.frozen
    }
    return _Outcome(FleetUnit(name, folder, fit.status, motions, seconds, "", errors, values), fit, signal)


def _errors(ladder: Ladder) -> tuple[str, dict[str, dict[str, float]]]:
    """Signal with its unit, and rung -> split -> RMSE of it."""
    signals = [signal for rung in ladder.rungs for split in rung.splits.values() for signal in split]
    if not signals:
        return "", {}
    signal = "position" if "position" in signals else signals[0]
    errors: dict[str, dict[str, float]] = {}
    unit = ""
    for rung in ladder.rungs:
        for split, measured in rung.splits.items():
            if "rmse" not in measured.get(signal, {}):
                continue
            total = measured[signal]["rmse"].total
            unit = total.unit
            errors.setdefault(rung.name, {})[split] = total.value
    return f"{signal} [{unit}]", errors
