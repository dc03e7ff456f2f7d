"""Recordings of a robot whose commands a network corrects: the same targets, another motion, at any rate that fits."""

from dataclasses import replace

import numpy as np
import pytest

from deploy.compensation_cases import compensation
from trueup.dataset import Dataset
from trueup.errors import ConfigError
from trueup.lab import LabSpec
from trueup.record import ClockSettings, MotionGroup, MotionSettings, PlanSetSpec, RecordSettings
from trueup.robots import load_robot
from trueup.stages import CompensatedRig, LabRig, record

PANDA = load_robot("panda")
PLANS = PlanSetSpec(
    "two",
    (MotionGroup("multi", "joint", 2, velocity_share=(0.8, 1.0)),),
    seed=3,
    motion=MotionSettings(clock=ClockSettings(rate_hz=200.0, rest_s=0.1)),
)


@pytest.fixture(scope="module")
def network(tmp_path_factory):
    folder = tmp_path_factory.mktemp("models")
    compensation(folder, PANDA.joint_names, size=0.02)
    return folder


def recorded(out, rig, control_hz):
    record(out, PANDA, rig, PLANS, settings=RecordSettings(control_hz=control_hz, record_hz=50.0))
    return {episode.id: episode for episode in Dataset(out)}


@pytest.mark.long
def test_a_corrected_robot_has_the_same_targets_and_moves_otherwise(network, tmp_path):
    control_hz = 200.0  # the network's rate is 50 Hz
    lab = LabRig(LabSpec(), seed=3)
    plain = recorded(tmp_path / "plain", lab, control_hz)
    helped = recorded(tmp_path / "helped", CompensatedRig.of(lab, PANDA, network, control_hz=control_hz), control_hz)
    assert plain.keys() == helped.keys()
    for name, episode in plain.items():
        other = helped[name]
        np.testing.assert_array_equal(episode.commanded()["position"], other.commanded()["position"])
        apart = np.abs(episode.measured["position"] - other.measured["position"]).max()
        # The network says about 20 mrad; the stiff arm goes where it is told.
        assert 0.005 < apart < 0.2
        assert not other.meta.warned


def test_a_rate_that_does_not_fit_is_refused_not_passed_over(network, tmp_path):
    with pytest.raises(ConfigError, match="fits no loop of this rate"):
        CompensatedRig.of(LabRig(LabSpec(), seed=3), PANDA, network, control_hz=75.0).session(0, 0.0)


def test_joints_without_limits_are_refused(network):
    free = replace(PANDA, joints=(replace(PANDA.joints[0], position_limits=None), *PANDA.joints[1:]))
    with pytest.raises(ConfigError, match="would know no limits"):
        CompensatedRig.of(LabRig(LabSpec(), seed=3), free, network, control_hz=50.0)


def test_a_robot_behind_ros_2_stays_one_when_its_commands_are_corrected(network, tmp_path):
    """Several payloads would be wrong labels of what it carries, and other processes cannot drive it."""
    pytest.importorskip("cyclonedds")
    from trueup.ros2 import RobotTopics
    from trueup.stages.recording import _is_live
    from trueup.stages.ros2_rig import Ros2Rig

    lab, live = LabRig(LabSpec(), seed=3), Ros2Rig(PANDA.joint_names, RobotTopics())
    corrected = CompensatedRig.of(live, PANDA, network, control_hz=200.0)
    assert _is_live(live)
    assert _is_live(corrected)
    assert not _is_live(CompensatedRig.of(lab, PANDA, network, control_hz=200.0))
    with pytest.raises(ConfigError, match="with what it carries"):
        record(tmp_path / "data", PANDA, corrected, PLANS, payloads_kg=(0.0, 1.0))
    assert not (tmp_path / "data").exists()
