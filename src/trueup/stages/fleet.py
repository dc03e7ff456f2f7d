"""Many robots of one kind, each closed by itself, side by side in processes or on a Ray cluster; one table of all."""

from __future__ import annotations

import contextlib
import os
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from trueup.core.atomic import remove, write_bytes
from trueup.core.close_result import CLOSE_NAME, STEPS, StepName
from trueup.core.fit_result import FitResult, FittedParameter
from trueup.core.fleet_result import FLEET_NAME, FleetParameter, FleetResult, FleetUnit, UnitValue
from trueup.core.provenance import provenance
from trueup.core.ray_workers import connected
from trueup.core.results import Ladder
from trueup.core.sole_writer import sole_writer
from trueup.core.spread import go_to, here, spread
from trueup.errors import ConfigError, DataError, OutputExists, TrueupError
from trueup.measure.population import population
from trueup.robots import RobotSpec
from trueup.stages.close_networks import METHODS
from trueup.stages.closing import close
from trueup.stages.fleet_units import TRACEBACK, units_of
from trueup.stages.progress import Track, silent

if TYPE_CHECKING:
    from trueup.identify import IdentifyConfig

_Z95 = 1.959963984540054


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
    that fails is listed, whatever the reason, and the others go on; so is a dataset that cannot be read, and a unit
    whose process was killed twice, the second time while it was the only one. What an earlier call has finished is
    kept, and a worker of a cluster that is killed is replaced; its unit goes on where it was.

    Args:
        datasets: of one or more units each, which are as many robots: those of two datasets are two, also if they have
            the same name. On a cluster, in a folder that all its machines have.
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
        TrueupError: there is nothing where a dataset should be, or none of them can be read.
        ConfigError: no such step, no data, a dataset that is given twice, or no such cluster.
        DataError: nothing could be done with any unit, or machines of the cluster do not share the disk of `out`.
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
        units = units_of([Path(path) for path in datasets], out, model=model, overwrite=overwrite)
        outcomes = {unit.name: _failed(unit.name, unit.reason) for unit in units if unit.reason}
        tasks = [
            _Task(unit.name, unit.data, out / unit.name, *(robot, model, config, until, budget_s, tuple(methods), seed))
            for unit in units
            if not unit.reason
        ]
        for task, outcome in track(_ended(tasks, jobs, ray), "fleet", len(tasks)):
            outcomes[task.name] = outcome
        done = [outcomes[unit.name] for unit in units]
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
            if parameter.name == name and parameter.identified in ("yes", "effective") and not parameter.at_bound
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


def _ended(tasks: Sequence[_Task], jobs: int | None, ray: str | None) -> Iterator[tuple[_Task, _Outcome]]:
    if ray is None:
        jobs = min(jobs or os.cpu_count() or 1, len(tasks))
    ended = spread(_closed, tasks, jobs=jobs, ray=ray, begin=go_to, with_args=here(), lost=_lost)
    for task, outcome in ended:
        if outcome.unit.status != "failed" and not (task.folder / CLOSE_NAME).is_file():
            raise DataError(
                f"what was found of a unit is not in {task.folder}",
                hint="--out must be on a file system that all machines of the Ray cluster share, under the same path.",
            )
        yield task, outcome


def _failed(name: str, reason: str) -> _Outcome:
    return _Outcome(FleetUnit(name, name, "failed", reason=reason))


def _lost(task: _Task, error: ConfigError) -> _Outcome:
    return _failed(task.name, error.summary)


def _closed(task: _Task) -> _Outcome:
    """One unit, on one processor; whatever is wrong with it, the others go on."""
    path = task.folder / TRACEBACK
    try:
        remove(path)
        return _outcome(task)
    except TrueupError as error:
        return _failed(task.name, error.summary)
    except Exception as error:
        with contextlib.suppress(TrueupError, MemoryError):
            write_bytes(path, traceback.format_exc().encode(errors="replace"))
        # Said as our own errors are: on one line, printable and short.
        said = DataError(f"{type(error).__name__}: {error}").summary
        return _failed(task.name, f"{said}; where it was raised stands in {path}")


def _outcome(task: _Task) -> _Outcome:
    """What is finished of it is kept.

    Raises:
        TrueupError: what `close` raises.
    """
    name, folder = task.name, task.folder.name
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
