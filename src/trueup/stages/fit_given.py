"""What a fit was given, kept beside it so that another can be asked for: the robot as it came, the configuration."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import yaml

from trueup.core.atomic import as_read_back, write_text
from trueup.core.fit_result import FIT_CONFIG, STOCK_ROBOT
from trueup.errors import ConfigError
from trueup.robots import RobotSpec, find_model

if TYPE_CHECKING:
    from trueup.identify import IdentifyConfig


def keep_given(folder: Path, robot: RobotSpec, model: Path, config: IdentifyConfig | None) -> None:
    """Write robot.stock.yaml, which finds the model where it lies, and fit.config.yaml.

    Args:
        folder: of the fit.
        robot: as it was given.
        model: its MJCF or URDF.
        config: as it was given; the default if None.
    """
    from trueup.identify import IdentifyConfig
    from trueup.identify.export import robot_yaml

    write_text(folder / STOCK_ROBOT, robot_yaml(replace(robot, model=_place(robot, model, folder), folder=None)))
    plain = as_read_back((config or IdentifyConfig()).to_json())
    write_text(folder / FIT_CONFIG, yaml.safe_dump(plain, sort_keys=False))


def _place(robot: RobotSpec, model: Path, folder: Path) -> str:
    """The model as seen from the folder, so that both can be moved together; by its name where it is the package's."""
    try:
        shipped = find_model(replace(robot, folder=None)).samefile(model)
    except ConfigError:
        shipped = False
    # Of a link the place of the link counts: names of meshes are seen from there.
    place = model.parent.resolve() / model.name
    return robot.model if shipped else Path(os.path.relpath(place, folder.resolve())).as_posix()
