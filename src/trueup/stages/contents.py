"""What a path holds: logs, a dataset, a fit, or what `close` made."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import mujoco
import numpy as np

from trueup.core.close_result import CLOSE_NAME, CloseResult
from trueup.core.episode import Episode, EpisodeMeta, warning_kinds
from trueup.core.fit_result import FitResult
from trueup.core.timeseries import TimeSeries
from trueup.dataset import Dataset, is_dataset
from trueup.dataset.importers.base import ImportOptions, ImportPlan
from trueup.dataset.importers.table import suggested
from trueup.errors import ConfigError, DataError, FormatError
from trueup.robots import RobotSpec, find_model, load_robot, shipped_robots
from trueup.robots.known import NAMESAKES
from trueup.robots.model import compile_spec, load_spec
from trueup.stages.close_steps import FIT_NAME
from trueup.stages.importing import plan_import

INFO_SCHEMA = "trueup.info/1"
_MODELS = (".urdf", ".xml", ".mjcf")


def contents_of(path: Path | str, *, format: str | None = None, options: ImportOptions | None = None) -> dict[str, Any]:
    """What a file or folder holds, JSON types only: `kind` is `close`, `fit`, `dataset`, `model`, `logs`.

    Of logs, one motion is read, the rest is listed.

    Args:
        path: to look at.
        format: of logs; detected if None.
        options: of logs: mapping, units, topics.

    Raises:
        TrueupError: it is nothing of these, or damaged.
    """
    path = Path(path)
    found: dict[str, Any] = {"schema": INFO_SCHEMA, "path": str(path)}
    if (path / CLOSE_NAME).is_file():
        return {**found, "kind": "close", **_of_close(path)}
    if path.name == FIT_NAME or (path / FIT_NAME).is_file():
        file = path if path.name == FIT_NAME else path / FIT_NAME
        return {**found, "kind": "fit", **_of_fit(FitResult.load(file))}
    if is_dataset(path):
        return {**found, "kind": "dataset", **_of_dataset(Dataset(path))}
    if path.suffix.lower() in _MODELS and path.is_file():
        return {**found, "kind": "model", **_of_model(path)}
    return {**found, "kind": "logs", **_of_logs(path, format, options or ImportOptions())}


def robots() -> list[dict[str, Any]]:
    """The robots that are known by a name: joints, how they are driven, and whether their model comes with trueup."""
    names = sorted({*(path.stem for path in shipped_robots()), *NAMESAKES})
    return [
        {
            "name": name,
            "joints": list(spec.joint_names),
            "command": spec.controller.signal,
            "model": spec.model,
            "model_shipped": _is_shipped(spec),
            "description": spec.description,
        }
        for name in names
        for spec in [load_robot(name)]
    ]


def _is_shipped(spec: RobotSpec) -> bool:
    try:
        find_model(spec)
    except ConfigError:
        return False
    return True


def _of_close(path: Path) -> dict[str, Any]:
    result = CloseResult.load(path / CLOSE_NAME)
    steps = [{"name": step.name, "status": step.status, "what": step.what} for step in result.steps]
    fit = {"fit": _of_fit(FitResult.load(path / FIT_NAME))} if (path / FIT_NAME).is_file() else {}
    return {"steps": steps, "until": result.until, "networks": dict(result.networks), **fit}


def _of_fit(fit: FitResult) -> dict[str, Any]:
    counts = Counter(str(item.identified) for item in fit.parameters if not item.frozen)
    errors = {
        run: {split: {"value": own.value, "unit": own.unit} for split, own in splits.items()}
        for run, splits in fit.errors.items()
    }
    values = [
        {"name": item.name, "value": item.value, "interval": list(item.interval), "unit": item.unit}
        | {"identified": item.identified}
        for item in fit.free
    ]
    return {
        "status": fit.status,
        "parameters": dict(counts),
        "values": values,
        "errors": errors,
        "statements": list(fit.statements),
    }


def _of_model(path: Path) -> dict[str, Any]:
    model = compile_spec(load_spec(path), path)
    moving = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
    return {
        "joints": [model.joint(number).name for number in range(model.njnt) if model.jnt_type[number] in moving],
        "free": int(np.count_nonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE))),
        "actuators": model.nu,
        "mass_kg": round(float(model.body_mass.sum()), 6),
        "timestep_s": float(model.opt.timestep),
    }


def _of_dataset(dataset: Dataset) -> dict[str, Any]:
    first = dataset[0] if len(dataset) else None
    seconds = float(sum(dataset.index.column("duration_s").to_pylist()))
    return {
        "robot": dataset.info.robot,
        "motions": len(dataset),
        "seconds": round(seconds, 3),
        "splits": dict(Counter(dataset.splits.values())),
        "warnings": _warnings(dataset.metas),
        **({} if first is None else _of_series(first.measured, first.command)),
        "runs": list(dataset.runs),
    }


def _of_logs(path: Path, format: str | None, options: ImportOptions) -> dict[str, Any]:
    try:
        plan, first = _planned(path, format, options)
    except (FormatError, DataError):
        suggestion = None if options.mapping or format not in (None, "table") else suggested(path)
        if suggestion is None:
            raise
        with TemporaryDirectory() as folder:
            mapping = Path(folder) / "mapping.yaml"
            mapping.write_text(suggestion.text)
            plan, first = _planned(path, "table", replace(options, mapping=mapping))
        said = "columns are read as their names suggest; `trueup init MODEL LOGS` writes that into mapping.yaml"
        plan = replace(plan, notes=(said, *plan.notes[1:]))
    return {
        "format": plan.format,
        "robot": plan.robot,
        "motions": len(plan.episodes),
        "splits": dict(Counter(plan.splits.values())),
        **({} if first is None else _of_series(first.measured, first.command)),
        "notes": list(plan.notes),
    }


def _planned(path: Path, format: str | None, options: ImportOptions) -> tuple[ImportPlan, Episode | None]:
    """What there is to import, and the first motion of it that can be read."""
    plan, error = plan_import(path, format=format, options=options), None
    for source in plan.episodes:
        try:
            return plan, source.load()
        except DataError as own:
            error = error or own
    if error is not None:
        raise error
    return plan, None


def _warnings(metas: Iterable[EpisodeMeta]) -> dict[str, int]:
    return dict(Counter(kind for meta in metas for kind in warning_kinds(meta.flags)))


def _of_series(measured: TimeSeries, command: TimeSeries | None) -> dict[str, Any]:
    found: dict[str, Any] = {"joints": list(measured.joints)}
    for name, series in (("measured", measured), ("command", command)):
        if series is not None:
            step_s = float(np.median(np.diff(series.time_s))) if len(series) > 1 else 0.0
            signals = {signal: sorted(set(series.units[signal])) for signal in series.signals}
            found[name] = {"signals": signals, "rate_hz": round(1.0 / step_s, 3) if step_s > 0 else None}
    return found
