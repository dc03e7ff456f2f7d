"""`trueup experiment` on recordings as users have them: any split, a late drive, a log that is of no use."""

from dataclasses import replace

import numpy as np
import pytest

from identify.experiment_robots import Friction, log, recordings
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter
from trueup.errors import MissingSignal, NotIdentifiable
from trueup.robots import ControllerSpec, JointSpec, RobotSpec
from trueup.stages.experimenting import experiment

RATE, DELAY_S, SLOPE = 500.0, 0.04, 2.0
ROBOT = RobotSpec("rig", (JointSpec("joint1"),), "rig.xml", controller=ControllerSpec(kind="torque", delay_s=DELAY_S))


def ramps(folder, splits=("val", "test", "")):
    """Ramps of a joint that starts to move at 0.5 and -0.4 Nm; every command acts 40 ms late."""
    late = round(DELAY_S * RATE)
    with DatasetWriter.create(folder, DatasetInfo(robot="rig")) as writer:
        for number, split in enumerate(splits):
            for way, sign, most in (("up", 1, 0.5), ("down", -1, 0.4)):
                asked = sign * SLOPE * np.maximum(np.arange(600) / RATE - 0.5, 0.0)
                asked[np.abs(asked) > most + SLOPE * (DELAY_S + 0.05)] = 0.0
                acting = np.concatenate([np.zeros(late), asked[:-late]])
                position, velocity = recordings(Friction(), acting, RATE, [number])
                episode = log(f"joint1_{way}-{number}", RATE, asked, position[0], velocity[0])
                writer.append(replace(episode, meta=replace(episode.meta, split=split)))
    return Dataset(folder)


def pushes(folder):
    """Constant torques that move the same joint in both directions, each released after a second and a half."""
    late, rows = round(DELAY_S * RATE), np.arange(3000) / RATE
    with DatasetWriter.create(folder, DatasetInfo(robot="rig")) as writer:
        for number, size in enumerate((0.7, 0.9, 1.1, 1.3)):
            for way, sign in (("up", 1), ("down", -1)):
                asked = sign * size * ((rows >= 0.5) & (rows < 2.0))
                acting = np.concatenate([np.zeros(late), asked[:-late]])
                position, velocity = recordings(Friction(), acting, RATE, [number])
                writer.append(log(f"joint1_{way}-{number}", RATE, asked, position[0], velocity[0]))
    return Dataset(folder)


def test_splits_do_not_matter_and_the_delay_of_the_robot_is_taken_off(tmp_path):
    data = ramps(tmp_path / "data")
    found = experiment(data, ROBOT, "breakaway")
    assert len(found.runs) == 6
    assert found.joints["joint1"]["positive"].estimate.value == pytest.approx(0.5, abs=0.02)
    assert found.joints["joint1"]["negative"].estimate.value == pytest.approx(-0.4, abs=0.02)
    assert found.settings["delay_s"] == {"joint1": DELAY_S}
    blind = experiment(data, ROBOT, "breakaway", delay_s=0.0)
    assert blind.joints["joint1"]["positive"].estimate.value == pytest.approx(0.5 + SLOPE * DELAY_S, abs=0.02)


@pytest.mark.parametrize("kind", ["constant-torque", "coast"])
def test_the_delay_reaches_the_other_experiments(tmp_path, kind):
    found = experiment(pushes(tmp_path / "data"), ROBOT, kind)
    assert found.settings["delay_s"] == {"joint1": DELAY_S}


@pytest.mark.parametrize("kind", ["constant-torque", "coast"])
def test_ramps_isolate_nothing_for_the_other_experiments(tmp_path, kind):
    with pytest.raises(NotIdentifiable, match="no recording could be used"):
        experiment(ramps(tmp_path / "data"), ROBOT, kind)


def test_a_recording_without_a_command_is_rejected_by_name(tmp_path):
    data = ramps(tmp_path / "data", ("train",))
    with DatasetWriter.create(tmp_path / "more", data.info) as writer:
        first = data.episode(data.ids[0])
        writer.append(replace(first, command=None, meta=replace(first.meta, id="bare")))
        for name in data.ids:
            writer.append(data.episode(name))
    found = experiment(Dataset(tmp_path / "more"), ROBOT, "breakaway")
    assert found.rejected[0].episode == "bare"
    assert any(line.startswith("bare: ") and "command" in line for line in found.problems)


def test_recordings_of_which_none_has_a_command_say_so(tmp_path):
    data = ramps(tmp_path / "data", ("train",))
    with DatasetWriter.create(tmp_path / "bare", data.info) as writer:
        for name in data.ids:
            writer.append(replace(data.episode(name), command=None))
    with pytest.raises(MissingSignal, match="command"):
        experiment(Dataset(tmp_path / "bare"), ROBOT, "breakaway")
