"""docs/ros2.md: its commands run beside each other as it says, in less time, and its Python runs."""

import re
import shlex
import signal
from pathlib import Path

import pytest

from deploy.compensation_cases import compensation
from ros2.ros2_cases import network, state, wait_for
from ros2.test_commands import ended, started
from ros2.test_robot import RATE_HZ, Served
from trueup.lab import SimulatedRobot
from trueup.robots import find_model, load_robot
from trueup.ros2 import JointState, Network, Node, RobotTopics
from trueup.sim import MujocoSimulator

TEXT = (Path(__file__).parent.parent.parent / "docs" / "ros2.md").read_text()
PANDA = load_robot("panda")


def command(*words):
    """The one command line of the page with these words, as arguments."""
    lines = re.findall(r"^trueup .*$", "".join(re.findall(r"^```sh\n(.*?)^```$", TEXT, re.M | re.S)), re.M)
    (line,) = [line for line in lines if all(word in line for word in words)]
    return shlex.split(line)[1:]


def test_three_terminals(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    domain = network().number
    arm = started(*command("deploy serve"), domain=domain)
    bridge = started(*command("deploy ros2", "zoo:"), domain=domain)
    record = command("record", "--scale 0.001")
    record[record.index("0.001")] = "0.0003"
    code, out, err = ended(started(*record, domain=domain), seconds=120)
    assert code == 0, err
    assert "motions recorded" in out
    assert (tmp_path / "data" / "live").is_dir()
    code, out, err = ended(bridge, number=signal.SIGINT)
    assert code == 0, err
    assert "joint states are corrected: /joint_states -> /joint_states_corrected" in err
    code, out, err = ended(arm, number=signal.SIGINT)
    assert code == 0, err
    followed = re.search(r"(\d+) commands followed", out)
    assert int(followed.group(1)) > 1000


def test_corrected_commands(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    compensation(tmp_path / "models" / "compensation", PANDA.joint_names, rate_hz=100.0)
    where = network()
    bridge = started(*command("deploy ros2", "--commands /joint_targets"), "--seconds", 8, domain=where.number)
    with Node(where) as node:
        targets = node.publish("/joint_targets", JointState)
        states = node.publish("/joint_states", JointState)
        commands = node.listen("/joint_commands", JointState)
        wait_for(lambda: targets.readers and states.readers and commands.writers, seconds=20.0)
        got, number = [], 0
        while len(got) < 50:
            states.send(state(number / 100.0, names=PANDA.joint_names))
            targets.send(state(number / 100.0, names=PANDA.joint_names, signals=("position",)))
            node.wait(0.01)
            got, number = got + commands.take(), number + 1
            assert number < 2000
    assert all(list(message.name) == list(PANDA.joint_names) for message in got)
    code, _, err = ended(bridge)
    assert code == 0, err
    assert "commands are corrected" in err


def test_a_robot_of_ros2_control(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    domain = network().number
    record = command("record", "--form array")
    record[record.index("0.01")] = "0.0003"
    topics = ("--commands", record[record.index("--commands") + 1], "--form", "array")
    arm = started("deploy", "serve", "--robot", "panda", "--hz", 500, *topics, domain=domain)
    code, _, err = ended(started(*record, domain=domain), seconds=120)
    assert code == 0, err
    assert (tmp_path / "data" / "robot").is_dir()
    assert ended(arm, number=signal.SIGINT)[0] == 0


def test_the_python_of_the_page_runs(capsys, monkeypatch):
    monkeypatch.setenv("ROS_LOCALHOST_ONLY", "1")
    (body,) = re.findall(r"^```python\n(.*?)^```$", TEXT, re.M | re.S)
    (number,) = re.findall(r"domain=(\d+)", body)
    robot = SimulatedRobot(MujocoSimulator.from_robot(PANDA, find_model(PANDA)), steps_per_control=1)
    names = {}
    with Served(RobotTopics(commands="/targets", network=Network(int(number))), rate_hz=RATE_HZ, robot=robot):
        exec(compile(body, "ros2.md", "exec"), names)
    names["robot"].close()
    assert re.search(r"\[.*\d", capsys.readouterr().out)


def test_what_it_adds_is_what_was_measured():
    from benchmarks.pages.__main__ import ROOT, with_parts

    assert with_parts("ros2.md") == (ROOT / "docs" / "ros2.md").read_text()


@pytest.mark.parametrize("option", ["--states", "--publish", "--hz", "--measured", "--reliable", "--domain"])
def test_options_are_explained(option):
    assert f"`{option}" in TEXT or f", `{option}" in TEXT
