"""What a fit was given lies beside it, and is read back as what it was."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from trueup.core.fit_result import FIT_CONFIG, STOCK_ROBOT
from trueup.identify import IdentifyConfig
from trueup.identify.config import DataChoice
from trueup.robots import find_model, load_robot, shipped_robots
from trueup.stages.fit_given import keep_given

CONFIG = IdentifyConfig(fit={"kp": "all", "delay_s": {"shared": True}}, data=DataChoice(budget_s=12.0))


def told(robot):
    """All that a description says; the command that a controller follows by its kind is named when it is written."""
    return replace(robot, controller=replace(robot.controller, command=robot.controller.signal)).to_dict()


@pytest.mark.parametrize("name", [path.stem for path in shipped_robots()])
def test_a_shipped_robot_is_read_back(name, tmp_path):
    robot = load_robot(name)
    model = tmp_path / Path(robot.model).name  # some come without a model
    model.touch()
    keep_given(tmp_path, robot, model, None)
    found = load_robot(tmp_path / STOCK_ROBOT)
    assert told(replace(found, model=robot.model)) == told(robot)
    assert find_model(found).samefile(model)
    assert IdentifyConfig.load(tmp_path / FIT_CONFIG) == IdentifyConfig()


def test_a_model_of_ones_own_is_found_from_the_folder_and_moves_with_it(tmp_path):
    """Also where the robot is called like a shipped one."""
    shipped = load_robot("demo_arm")
    place = tmp_path / "here"
    (place / "models").mkdir(parents=True)
    (place / "out").mkdir()
    model = place / "models" / "demo_arm.xml"
    shutil.copyfile(find_model(shipped), model)
    keep_given(place / "out", replace(shipped, description="an edited copy"), model, CONFIG)
    shutil.move(place, tmp_path / "there")
    found = load_robot(tmp_path / "there" / "out" / STOCK_ROBOT)
    assert found.description == "an edited copy"
    assert find_model(found).samefile(tmp_path / "there" / "models" / "demo_arm.xml")
    assert IdentifyConfig.load(tmp_path / "there" / "out" / FIT_CONFIG) == CONFIG


def test_a_model_of_the_package_is_known_by_its_name(tmp_path):
    robot = load_robot("demo_arm")
    keep_given(tmp_path, robot, find_model(robot), CONFIG)
    assert load_robot(tmp_path / STOCK_ROBOT).model == robot.model
