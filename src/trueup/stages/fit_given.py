"""What a fit was given, kept beside it so that another can be asked for: the robot as it came, the configuration."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import yaml

from trueup.core.atomic import as_read_back, write_text
from trueup.core.fit_result import FIT_CONFIG, STOCK_ROBOT
from trueup.robots import RobotSpec
from trueup.robots.written import robot_yaml
from trueup.stages.robot_model import model_beside

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

    write_text(folder / STOCK_ROBOT, robot_yaml(replace(robot, model=model_beside(robot, model, folder), folder=None)))
    plain = as_read_back((config or IdentifyConfig()).to_json())
    write_text(folder / FIT_CONFIG, yaml.safe_dump(plain, sort_keys=False))
