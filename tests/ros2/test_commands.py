"""The commands, each in a process of its own, as people start them."""

import json
import os
import signal
import subprocess
import sys

import numpy as np
import pytest
from benchmarks.networks import inputs_of, outputs_of, real_time

from deploy.compensation_cases import compensation
from ros2.ros2_cases import Publishing, network
from trueup.cli.main import main
from trueup.cli.ros2 import _asked_to_stop as asked_to_stop
from trueup.core.model_card import Input
from trueup.dataset import Dataset
from trueup.errors import ConfigError, DataError
from trueup.robots import load_robot
from trueup.ros2 import Network, Node
from trueup.stages.bridging import bridge

ARM = load_robot("demo_arm")
RATE_HZ = 100.0
PLANS = """
name: two
seed: 3
motion: {clock: {rate_hz: 100.0, rest_s: 0.1}}
groups:
  - {name: single, kind: joint, count: 2, moving: single, velocity_share: [0.5, 0.6]}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("network")
    names = ARM.joint_names
    real_time(folder, hidden=(8, 5), rate_hz=RATE_HZ, joints=names, inputs=inputs_of(names), outputs=outputs_of(names))
    return folder


def started(*arguments, domain, **environment):
    own = {**os.environ, "ROS_DOMAIN_ID": str(domain), "ROS_LOCALHOST_ONLY": "1", "COLUMNS": "200", **environment}
    command = [sys.executable, "-m", "trueup.cli.main", *map(str, arguments)]
    return subprocess.Popen(command, env=own, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def ended(process, *, number=None, seconds=60.0):
    """Exit code and what it printed."""
    if number is not None:
        process.send_signal(number)
    out, err = process.communicate(timeout=seconds)
    return process.returncode, out, err


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_simulation_and_a_bridge_find_each_other_and_stop_cleanly(folder, tmp_path, number):
    domain = network().number
    arm = started("deploy", "serve", "--robot", "demo_arm", "--hardware", "mujoco", "--hz", 100, domain=domain)
    bridge = started("deploy", "ros2", folder, "--out", tmp_path / "live", domain=domain)
    listener = started("deploy", "ros2", folder, "--states", "/joint_states_corrected", "--seconds", 4, domain=domain)
    code, out, err = ended(listener)
    assert code == 0, err
    assert "answered" in out
    code, out, err = ended(bridge, number=number)
    assert code == 0, err
    assert "99 %" in out
    assert "joint states are corrected: /joint_states -> /joint_states_corrected" in err
    code, out, err = ended(arm, number=number)
    assert code == 0, err
    assert "0 refused" in out
    tree = json.loads((tmp_path / "live" / "bridge.json").read_text())
    assert tree["received"] == tree["sent"] == sum(tree["counts"].values()) == tree["added"]["count"] > 100
    assert tree["topics"]["publish"] == "/joint_states_corrected"


@pytest.mark.long
def test_nothing_came_is_an_error_that_says_where_it_listened(folder):
    code, out, err = ended(started("deploy", "ros2", folder, "--seconds", 0.5, domain=network().number))
    assert code == 2
    assert "0 messages" in out
    assert "/joint_states" in err
    assert "--domain" in err
    assert "Traceback" not in err


@pytest.mark.long
def test_motions_are_recorded_over_topics(tmp_path):
    domain = network().number
    (tmp_path / "two.yaml").write_text(PLANS)
    arm = started("deploy", "serve", "--robot", "panda", "--hardware", "mujoco", "--hz", 200, domain=domain)
    try:
        options = ("--robot", "panda", "--hardware", "ros2", "--plan", tmp_path / "two.yaml")
        rates = ("--control-hz", 100, "--record-hz", 100)
        code, out, err = ended(started("record", *options, *rates, "--out", tmp_path / "D", domain=domain), seconds=120)
        assert code == 0, err
        assert "2 motions recorded" in out
    finally:
        assert ended(arm, number=signal.SIGINT)[0] == 0
    data = Dataset(tmp_path / "D")
    assert data.info.provenance["config"]["rig"]["hardware"] == "ros2"
    for episode in data:
        assert episode.meta.unit == "ros2-1"
        assert np.ptp(episode.command["position"], axis=0).max() > 0.05
        moved = np.abs(episode.measured["position"][-1] - episode.command["position"][-1])
        assert moved.max() < 0.05


@pytest.mark.long
def test_options_of_the_lab_say_nothing_of_a_real_robot(tmp_path):
    options = ("--hardware", "ros2", "--faults", 0.1, "--out", tmp_path / "D")
    code, _, err = ended(started("record", *options, domain=network().number))
    assert code == 2
    assert "--faults" in err
    assert not (tmp_path / "D").exists()


@pytest.mark.long
def test_a_robot_that_is_not_there_is_said_before_anything_is_written(tmp_path):
    (tmp_path / "two.yaml").write_text(PLANS)
    options = ("--robot", "panda", "--hardware", "ros2", "--plan", tmp_path / "two.yaml", "--control-hz", 100)
    code, _, err = ended(started("record", *options, "--out", tmp_path / "D", domain=network().number))
    assert code == 2
    assert "no joint states on /joint_states" in err
    assert not (tmp_path / "D").exists()


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--publish", "/joint_states"), "answer itself"),
        (("--states", "/bad name"), "no name of a topic"),
        (("--domain", "400"), "domain"),
        (("--hz", "130"), "fits no loop"),
        (("--payload-kg", "1"), "Leave --payload-kg out"),
    ],
)
def test_what_cannot_be_is_refused_in_a_line(folder, options, told):
    code, _, err = ended(started("deploy", "ros2", folder, *options, "--seconds", 1, domain=network().number))
    assert code == 2, err
    assert told in err
    assert "Traceback" not in err


@pytest.mark.long
def test_what_is_no_network_or_has_no_model_is_said_with_what_to_give(tmp_path):
    (tmp_path / "empty").mkdir()
    for given, is_a in (("zoo:panda-reach", "a policy"), (tmp_path / "empty", "an empty folder")):
        code, _, err = ended(started("deploy", "ros2", given, domain=network().number))
        assert code == 2
        assert f"holds no network: got {is_a}" in err
        assert "zoo:panda-realeasy-rt" in err
    code, _, err = ended(started("deploy", "serve", "--robot", "so101", domain=network().number))
    assert code == 2
    assert "next: Give its path with --model.\nIt is robotstudio_so101/so101.xml of MuJoCo Menagerie" in err


@pytest.mark.long
def test_compensations_need_limits_and_correct_commands(tmp_path):
    domain = network().number
    compensation(tmp_path / "net", load_robot("panda").joint_names, rate_hz=RATE_HZ)
    code, _, err = ended(started("deploy", "ros2", tmp_path / "net", "--payload-kg", 0, "--seconds", 1, domain=domain))
    assert code == 2
    assert "--robot" in err
    code, _, err = ended(
        started(
            "deploy", "ros2", tmp_path / "net", "--robot", "panda", "--payload-kg", 0, "--seconds", 1, domain=domain
        )
    )
    assert code == 2  # nobody has sent a target
    assert "commands are corrected: /joint_targets -> /joint_commands, by /joint_states" in err


@pytest.mark.long
@pytest.mark.parametrize(
    ("direction", "options", "told"),
    [
        ("simulator", ("--payload-kg", 1), "corrects the commands of a simulator"),
        ("robot", ("--payload-kg", 1, "--direction", "simulator"), "corrects the commands of a robot"),
        ("robot", (), "--payload-kg"),
    ],
)
def test_compensations_of_the_other_side_or_an_unknown_payload_are_refused(tmp_path, direction, options, told):
    """What makes a simulator move like the robot makes the robot worse by as much."""
    compensation(tmp_path, load_robot("panda").joint_names, rate_hz=RATE_HZ, direction=direction)
    where = ("--robot", "panda", "--seconds", 1)
    code, _, err = ended(started("deploy", "ros2", tmp_path, *where, *options, domain=network().number))
    assert code == 2
    assert told in err
    assert "are corrected" not in err


def test_states_of_a_payload_that_nobody_said_are_refused(tmp_path):
    names = ARM.joint_names
    inputs = (*inputs_of(names), Input("payload", "", "kg", "condition", low=0.0, high=3.0))
    real_time(tmp_path, hidden=(8, 5), rate_hz=RATE_HZ, joints=names, inputs=inputs, outputs=outputs_of(names))
    with pytest.raises(ConfigError, match="what the robot carries") as refused:
        bridge(tmp_path, network=network(), seconds=0.0)
    assert "--payload-kg" in refused.value.hint
    assert bridge(tmp_path, network=network(), seconds=0.0, payload_kg=0.0).report.received == 0


@pytest.mark.long
def test_a_simulator_whose_joints_are_called_otherwise_is_an_error(folder):
    domain = network().number
    bridging = started("deploy", "ros2", folder, "--seconds", 6, domain=domain)
    with Node(Network(domain, localhost=True)) as node, Publishing(node, names=("left", "right")):
        code, out, err = ended(bridging)
    assert code == 2, err
    assert "messages on /joint_states are of other joints" in err
    assert "messages were of other joints, such as ['left', 'right']" in err
    for name in ARM.joint_names:
        assert name in err
    assert "not of these joints" in out


@pytest.mark.long
def test_what_was_counted_is_shown_where_its_file_cannot_be_written(folder, tmp_path, monkeypatch, capsys):
    def full(path, _):
        raise DataError(f"cannot write {path}", got="No space left on device")

    monkeypatch.setattr("trueup.stages.bridging.write_json", full)
    where = ("--domain", str(network().number), "--localhost")
    with pytest.raises(SystemExit) as left:
        main(["deploy", "ros2", str(folder), "--seconds", "0.2", "--out", str(tmp_path / "live"), *where])
    out, err = capsys.readouterr()
    assert left.value.code == 2
    assert "0 messages in " in out
    assert "No space left" in err


def test_a_second_interrupt_does_not_wait():
    with asked_to_stop() as stop:
        signal.raise_signal(signal.SIGINT)
        assert stop.is_set()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


@pytest.mark.long
def test_results_that_are_there_are_not_replaced_unasked(folder, tmp_path):
    (tmp_path / "bridge.json").write_text("{}")
    options = ("deploy", "ros2", folder, "--seconds", 0.2, "--out", tmp_path)
    code, _, err = ended(started(*options, domain=network().number))
    assert code == 2
    assert "--overwrite" in err
    assert (tmp_path / "bridge.json").read_text() == "{}"
