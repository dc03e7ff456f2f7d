"""The model file of a dataset's robot."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path

from trueup.core.atomic import replacing
from trueup.dataset import Dataset, DatasetInfo
from trueup.errors import ConfigError
from trueup.robots import RobotSpec, find_model

# A model folder with meshes is copied whole; beyond this size it is somebody's asset library.
_MAX_BYTES = 200 * 2**20


def model_file(robot: RobotSpec, dataset: Dataset, *, given: Path | None = None) -> Path:
    """The model file that is given, else that which the dataset names or holds, else that of the package.

    Raises:
        ConfigError: there is none.
    """
    return find_model(robot, given=given, folder=model_folder(dataset))


def model_folder(dataset: Dataset) -> Path:
    """The folder of models that a dataset names, or where one is looked for that it does not name.

    Raises:
        ConfigError: it is not inside the dataset's folder.
    """
    return dataset.info.model_path(dataset.path) or dataset.path / "model"


def copy_model(folder: Path, out: Path, info: DatasetInfo) -> DatasetInfo:
    """The robot's model goes with the data, into `out/model`, so that a replay needs nothing else.

    Links are not followed, and a folder of more than 200 MB is not copied.

    Args:
        folder: with the model and its meshes.
        out: the dataset that gets it.
        info: its dataset.json.

    Returns:
        What dataset.json says from now on; `info` if the model was not copied.
    """
    files = [path for path in sorted(folder.rglob("*")) if path.is_file() and not path.is_symlink()]
    if sum(path.stat().st_size for path in files) > _MAX_BYTES:
        return info
    for path in files:
        with replacing(out / "model" / path.relative_to(folder)) as temporary:
            shutil.copyfile(path, temporary)
    info = replace(info, model="model")
    info.save(out)
    return info


def model_beside(robot: RobotSpec, model: Path, folder: Path) -> str:
    """The model as seen from a folder, so that both can be moved together.

    By its name where it is the package's, and by its whole path where the two have no folder in common.
    """
    try:
        shipped = not Path(robot.model).is_absolute() and find_model(replace(robot, folder=None)).samefile(model)
    except ConfigError:
        shipped = False
    # Of a link the place of the link counts: names of meshes are seen from there.
    place = model.parent.resolve() / model.name
    if shipped:
        return robot.model
    if os.path.commonpath([place, folder.resolve()]) == place.anchor:
        return place.as_posix()
    return Path(os.path.relpath(place, folder.resolve())).as_posix()
