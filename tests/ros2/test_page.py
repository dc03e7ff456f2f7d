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


def wait_for_states(where, seconds=90.0):
    """Until somebody publishes joint states: a person looks at the first terminal before the third is opened."""
    with Node(where) as node:
        states = node.listen("/joint_states", JointState)
        wait_for(states.take, seconds)


@pytest.mark.long
def test_three_terminals(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    where = network()
    arm = started(*command("deploy serve"), domain=where.number)
    bridge = started(*command("deploy ros2", "zoo:"), domain=where.number)
    wait_for_states(where)
    record = command("record", "--scale 0.001")
    record[record.index("0.001")] = "0.0003"
    code, out, err = ended(started(*record, domain=where.number), seconds=120)
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


@pytest.mark.long
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


@pytest.mark.long
def test_a_robot_of_ros2_control(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    where = network()
    record = command("record", "--form array")
    record[record.index("0.01")] = "0.0003"
    topics = ("--commands", record[record.index("--commands") + 1], "--form", "array")
    arm = started("deploy", "serve", "--robot", "panda", "--hz", 500, *topics, domain=where.number)
    wait_for_states(where)
    code, _, err = ended(started(*record, domain=where.number), seconds=120)
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


HOUR = {
    "provenance": {"config": {"machine": {"name": "a computer"}}},
    "seconds": 3600.0,
    "rate_hz": 1000.0,
    "published": 3600000,
    "answers": 3599990,
    "memory_mb": [150.04, 150.39, 150.3],
    "bridge": {
        "received": 3600000,
        "sent": 3599999,
        "most_waiting": 12,
        "counts": {"ok": 3590000, "warming": 9000, "fallback": 999},
        "added": {"p99_us": 412.0, "max_us": 22800.0},
    },
}


def test_an_hour_is_a_part_of_the_page():
    from benchmarks.pages import ros2_hour
    from benchmarks.pages.markdown import with_section

    page = with_section(TEXT, ros2_hour.part(HOUR))
    part = page[page.index("## For an hour") :]
    assert "for 60 minutes at 1000 Hz on a computer" in part
    cells = dict(re.findall(r"^\| (.+?) \| (.+?) \|$", part, re.M))
    assert cells["messages published"] == cells["of these delivered to the bridge"] == "3600000"
    assert cells["of these answered"] == "3599999"
    assert cells["of these corrected"] == "3590000"
    assert cells["longest"] == "22.80 ms"
    assert cells["memory of the bridge after a minute"] == "150.0 MB"
    assert cells["memory at the end"] == "150.3 MB"
    assert (
        "It lost 1. 9999 answers carried the simulator's own values, mostly while the network warmed up again. "
        "Its memory grew by 0.35 MB at most, and by 0.26 MB at the end; the limit of 1 MB is met" in part
    )
    all_ok = {**HOUR["bridge"], "counts": {"ok": 3599999}}
    assert "It lost 1. Its memory grew" in ros2_hour.part({**HOUR, "bridge": all_ok})
    grown = ros2_hour.part({**HOUR, "memory_mb": [150.0, 150.5, 151.6, 150.1]})
    assert "grew by 1.60 MB at most, and by 0.10 MB at the end; the limit of 1 MB is missed" in grown
    assert page.split("## For an hour")[0] == TEXT.split("## For an hour")[0]


def test_the_table_of_what_it_adds_has_a_row_for_each_time():
    from benchmarks.pages import ros2_bridge

    quantiles = ("p50", "p99", "p999", "max")
    own = {
        **{name: HOUR[name] for name in ("seconds", "rate_hz", "published")},
        **{name: dict.fromkeys(quantiles, value) for name, value in (("added_ms", 0.3), ("direct_ms", 0.2))},
        "whole_ms": dict.fromkeys(quantiles, 0.5),
        "delivered": 3600000,
        "lost": 0,
        "bridge": {name: dict.fromkeys((f"{at}_us" for at in quantiles), 100.0) for name in ("added", "way")},
    }
    ways = {"states": own, "commands": {**own, "lost": 3, "whole_ms": dict.fromkeys(quantiles, 0.7)}}
    part = ros2_bridge.part({"provenance": HOUR["provenance"], "ways": ways})
    firsts = re.findall(r"^\| .+? \| ([\d.]+) \|", part, re.M)
    assert firsts == ["0.30", "0.10", "0.10", "0.20", "0.50", "0.30", "0.10", "0.10", "0.20", "0.70"]
    assert "all of these were answered" in part
    assert "3 of these were not answered" in part


@pytest.mark.parametrize("option", ["--states", "--publish", "--hz", "--measured", "--reliable", "--domain"])
def test_options_are_explained(option):
    assert f"`{option}" in TEXT or f", `{option}" in TEXT
