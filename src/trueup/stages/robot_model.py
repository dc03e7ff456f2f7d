"""The model file of a dataset's robot."""

from __future__ import annotations

from pathlib import Path

from trueup.dataset import Dataset
from trueup.robots import RobotSpec, find_model


def model_file(robot: RobotSpec, dataset: Dataset, *, given: Path | None = None) -> Path:
    """The file that is given, else that which the dataset names or holds, else that of the package.

    Raises:
        ConfigError: there is none.
    """
    return find_model(robot, given=given, folder=dataset.info.model_path(dataset.path) or dataset.path / "model")
