"""The units of a fleet: what each is called, and where its motions are; datasets of several are taken apart."""

from __future__ import annotations

import shutil
from collections.abc import Container, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from trueup.core.atomic import is_inside
from trueup.core.close_result import CLOSE_NAME
from trueup.dataset import Dataset, DatasetWriter
from trueup.errors import ConfigError, DataError, OutputExists, TrueupError
from trueup.stages.robot_model import copy_model, model_folder

# Where the folder of a unit has its part of a dataset, and why nothing came of it, if that was none of our own errors.
DATA, TRACEBACK = "dataset", "failed.txt"
# Letters of the name of a folder; others become one of them.
_PLAIN = "-_."
# Columns of an index that results depend on.
_DECIDING = ("hash", "split", "flags", "payload_kg", "kp_setting", "condition")


@dataclass(frozen=True)
class Unit:
    """One robot.

    Attributes:
        name: its own, or that of its dataset where it has none; its folder is called so, too.
        data: the dataset of its motions.
        reason: why nothing can be done with them; empty if something can.
    """

    name: str
    data: Path
    reason: str = ""


@dataclass(frozen=True, eq=False)
class _Source:
    """A unit in the dataset that was given; `whole` is that, where it has others, too."""

    path: Path
    unit: str
    whole: Dataset | None = None
    reason: str = ""


def units_of(paths: Sequence[Path], out: Path, *, model: Path | None, overwrite: bool) -> list[Unit]:
    """Each unit with its data: the dataset itself, or a part of it below `out`.

    Args:
        paths: of the datasets.
        out: folder for the results, of which earlier ones of these units are removed with `overwrite`.
        model: that all units are given; None if theirs go with their data.
        overwrite: see `out`.

    Raises:
        TrueupError: there is nothing where a dataset should be, or none of them can be read.
        ConfigError: a dataset is given twice, two units have the same name, or a dataset is one of the results that are
            to be replaced.
        OutputExists: a folder that is to be replaced holds something else.
    """
    named = _named(paths)
    earlier = [out / name for name, source in named.items() if overwrite and not source.reason]
    earlier = [folder for folder in earlier if folder.exists()]
    places = [source.path.resolve() for source in named.values()]
    given = {folder for place in places for folder in (place, *place.parents)}
    for folder in earlier:
        _refuse_others(folder, given)
    for folder in earlier:
        shutil.rmtree(folder)
    units = []
    for name, source in named.items():
        data, reason = source.path, source.reason
        if source.whole is not None:
            try:
                data = _part(source.whole, source.unit, out / name, model)
            except (TrueupError, OSError) as error:
                reason = _as_ours(error).summary
        units.append(Unit(name, data, reason))
    return units


def _named(paths: Sequence[Path]) -> dict[str, _Source]:
    """Name -> unit; nothing is written yet."""
    found: dict[str, _Source] = {}
    places: set[Path] = set()
    broken: list[TrueupError] = []
    for path in paths:
        place = path.resolve()
        if place in places:
            raise ConfigError(
                "a dataset is given twice", got=path, hint="Give it once: its robots would count as two each."
            )
        places.add(place)
        units, reason = [""], ""
        whole: Dataset | None = None
        try:
            dataset = Dataset(path)
            units = list(dict.fromkeys(meta.unit for meta in dataset.metas))
            whole = dataset if len(units) > 1 else None
            if not units:
                units, reason = [""], f"{path} has no motions"
        except (TrueupError, OSError) as error:
            if not path.exists():  # a word that was mistyped, not a robot
                raise
            broken.append(_as_ours(error))
            reason = broken[-1].summary
        for unit in units:
            name = _plain(unit or place.name)
            if name in found:
                name = _plain(f"{place.name}-{unit}")
            if name in found:
                raise ConfigError(
                    f"two units are called {name!r}", got=path, hint="Give their datasets folders with other names."
                )
            found[name] = _Source(path, unit, whole, reason)
    if len(broken) == len(paths):
        raise broken[0]
    return found


def _as_ours(error: TrueupError | OSError) -> TrueupError:
    return error if isinstance(error, TrueupError) else DataError(str(error))


def _plain(name: str) -> str:
    kept = "".join(letter if letter.isalnum() or letter in _PLAIN else "_" for letter in name)
    return kept.lstrip(".") or "unit"


def _refuse_others(folder: Path, given: Container[Path]) -> None:
    """Only what an earlier call has left of a unit is removed; `given`: datasets, and all folders that they are in."""
    if not ((folder / CLOSE_NAME).is_file() or (folder / DATA).is_dir() or (folder / TRACEBACK).is_file()):
        raise OutputExists(f"{folder} holds no results of a fleet", hint="Choose another --out.")
    if folder.resolve() in given:
        raise ConfigError(
            f"a dataset that was given lies in {folder}, which --overwrite would remove", hint="Choose another --out."
        )


def _part(dataset: Dataset, unit: str, folder: Path, model: Path | None) -> Path:
    """The motions of one unit as a dataset, with what the whole one says, and its model.

    Raises:
        OutputExists: the unit's results were made from other motions, or from the same with other splits or flags.
        ConfigError: the model is too large to go with every unit.
        TrueupError: the motions cannot be read, or written.
    """
    path = folder / DATA
    wanted, there = _motions(dataset, unit), _there(path, unit)
    if there != wanted:
        # Fewer of the same are what an interruption has left, or what there was before there were more.
        if not there.items() <= wanted.items() and (folder / CLOSE_NAME).is_file():
            raise OutputExists(
                f"{folder} holds results of other motions of {unit!r} than {dataset.path} has now, or of the same with "
                "other splits, flags or payloads; remove that folder and resume, to begin the unit anew"
            )
        info = replace(dataset.info, model="", notes=(*dataset.info.notes, f"unit {unit} of {dataset.path.name}"))
        with DatasetWriter.create(path, info, overwrite=True) as writer:
            for name in wanted:
                writer.append(dataset.episode(name))
    models = model_folder(dataset)
    if models.is_dir() and is_inside(dataset.path, models):
        info = copy_model(models, path, replace(Dataset(path).info, model=""))
        if not info.model and model is None:
            raise ConfigError(f"the model in {models} is too large to go with each unit", hint="Give it with --model.")
    return path


def _there(path: Path, unit: str) -> dict[str, tuple[Any, ...]]:
    """What an earlier call has taken of a unit; a part that is broken is made anew from the whole."""
    try:
        return _motions(Dataset(path), unit)
    except TrueupError:
        return {}


def _motions(dataset: Dataset, unit: str) -> dict[str, tuple[Any, ...]]:
    """Id -> what results of a unit depend on."""
    columns = (dataset.index.column(name).to_pylist() for name in _DECIDING)
    rows = zip(dataset.metas, zip(*columns, strict=True), strict=True)
    return {meta.id: row for meta, row in rows if meta.unit == unit}
