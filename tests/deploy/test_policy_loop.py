"""A policy in a loop of 1 kHz on virtual hardware: asked at its own rate, within limits, and stopped whatever happens."""

import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from trueup.augment.graph import Graph
from trueup.core.policy_card import POLICY_CARD, POLICY_GRAPH, PolicyCard
from trueup.deploy.policy import Policy
from trueup.deploy.policy_loop import DONE, PolicyLoop
from trueup.errors import ConfigError, DataError, MissingSignal, NameMismatch
from trueup.lab import Fault, LabSpec, VirtualRobot, draw_truth
from trueup.lab.spec import Controller
from trueup.policy.workspace import Chain
from trueup.robots import find_model, load_robot
from trueup.sim import MujocoSimulator
from trueup.stages.policy_driving import guard_settings

PANDA = load_robot("panda_torque")
MODEL = MujocoSimulator.from_robot(PANDA, find_model(PANDA)).model
CHAIN = Chain(MODEL, PANDA.joint_names, "end_effector")
GOAL = np.array([0.4, 0.2, 0.5])
TRUTH = draw_truth(replace(LabSpec(), controller=Controller(kind="torque")), unit=1)
MOST = (2.0, 3.0, 2.5, 4.0, 2.0, 1.0, 1.0)


def policy_of(folder, torque):
    """One that always says the same; with `weights`, (24, 7), also something of what it sees."""
    weights, bias = np.zeros((24, 7), np.float32), np.asarray(torque, np.float32)
    graph = Graph()
    value = graph.input("seen", ("N", 24))
    graph.output(
        graph.add("Add", graph.add("MatMul", value, graph.floats(weights)), graph.floats(bias)), "torque", ("N", 7)
    )
    folder.mkdir(exist_ok=True)
    (folder / POLICY_GRAPH).write_bytes(graph.serialized({}))
    PolicyCard("constant", PANDA.name, PANDA.joint_names, 25.0, MOST, CHAIN.kinematics, "end_effector").save(folder)
    return Policy.load(folder, joints=PANDA.joint_names, rate_hz=25.0)


def lab(**options):
    return VirtualRobot(TRUTH, **options)


def loop_of(policy, robot=None, **options):
    changes = {name: options.pop(name) for name in list(options) if name != "rate_hz"}
    settings = replace(guard_settings(policy.card, PANDA, MODEL), **changes)
    return PolicyLoop(lab() if robot is None else robot, policy, settings, **options)


@pytest.mark.long
def test_a_policy_that_says_nothing_leaves_the_arm_where_it_is(tmp_path):
    run = loop_of(policy_of(tmp_path / "p", np.zeros(7))).run(GOAL, 0.5)
    assert (run.reason, run.phase) == (DONE, "stopped")
    np.testing.assert_allclose(run.time_s, np.arange(len(run.time_s)) * 0.001, atol=1e-9)
    assert run.braked_from == 500
    # Its compensation of gravity is wrong by less than what makes it slip.
    assert np.abs(run.position - run.position[0]).max() < 0.02
    assert run.report.cycles == len(run.time_s)
    assert run.final_m == pytest.approx(np.linalg.norm(CHAIN.place(run.position[499:500])[0] - GOAL), abs=1e-9)


@pytest.mark.long
def test_the_policy_is_asked_at_its_own_rate_and_torques_go_up_by_the_rate_limit(tmp_path):
    policy = policy_of(tmp_path / "p", [1.0, 0, 0, 0, 0, 0, 0.5])
    asked = []
    step = policy.step
    policy.step = lambda *given: asked.append(1) or step(*given)
    run = loop_of(policy, torque_rate=(100.0,) * 7).run(GOAL, 0.4)
    assert len(asked) == 10
    np.testing.assert_allclose(run.sent[:10, 0], 0.1 * np.arange(1, 11), atol=1e-9)
    assert np.abs(np.diff(run.sent, axis=0)).max() <= 0.1 + 1e-9
    assert run.shares["rate"] > 0.02


@pytest.mark.long
def test_an_arm_that_leaves_its_workspace_is_stopped_and_stands_soon(tmp_path):
    policy = policy_of(tmp_path / "p", MOST)
    start = CHAIN.place(lab().read()["position"][None])[0]
    box = (tuple((start - 0.05).tolist()), tuple((start + 0.05).tolist()))
    run = loop_of(policy, workspace_m=box).run(GOAL, 4.0)
    assert "left its workspace" in run.reason
    assert run.phase == "stopped"
    assert run.time_s[-1] - run.time_s[run.braked_from] < 0.5
    places = CHAIN.place(np.ascontiguousarray(run.position))
    outside = (np.abs(places - start) > 0.05).any(axis=1)
    assert np.argmax(outside) == run.braked_from
    # It goes some centimeters on while it brakes.
    assert (np.abs(places - start) < 0.12).all()
    # Without torque it creeps: its compensation of gravity is wrong.
    assert np.abs(run.velocity[-1]).max() < 0.05
    assert (run.sent[-1] == 0).all()


@pytest.mark.long
def test_joints_stay_within_their_ends_whatever_the_policy_says(tmp_path):
    for sign in (1.0, -1.0):
        policy = policy_of(tmp_path / f"p{sign}", sign * np.array(MOST))
        run = loop_of(policy).run(GOAL, 3.0)
        settings = guard_settings(policy.card, PANDA, MODEL)
        assert (run.position < np.array(settings.high) + settings.beyond_rad).all()
        assert (run.position > np.array(settings.low) - settings.beyond_rad).all()
        assert (np.abs(run.velocity) < settings.too_fast * np.array(settings.velocity)).all()
        assert run.shares["velocity"] + run.shares["position"] > 0.01


@pytest.mark.long
def test_a_policy_that_says_no_numbers_stops_the_arm(tmp_path):
    run = loop_of(policy_of(tmp_path / "p", np.full(7, np.nan))).run(GOAL, 4.0)
    assert "has said no number for 0.2" in run.reason
    assert run.phase == "stopped"
    assert (run.sent == 0).all() or np.abs(run.sent).max() < 0.5
    assert len(run.time_s) < 500


@pytest.mark.long
def test_a_robot_that_stops_by_itself_ends_the_run_and_what_was_measured_is_kept(tmp_path):
    robot = lab(faults=(Fault("stop", at_s=0.3),))
    run = loop_of(policy_of(tmp_path / "p", np.zeros(7)), robot).run(GOAL, 2.0)
    assert run.reason.startswith("the robot has stopped")
    assert len(run.time_s) == pytest.approx(301, abs=1)
    assert np.isfinite(run.position).all()


@pytest.mark.long
def test_readings_that_are_lost_stop_the_arm(tmp_path):
    robot = lab(faults=(Fault("drop", at_s=0.2, duration_s=3.0),))
    run = loop_of(policy_of(tmp_path / "p", [0.2, 0, 0, 0, 0, 0, 0]), robot).run(GOAL, 3.0)
    assert "readings have not changed" in run.reason
    assert 0.6 < run.time_s[run.braked_from] < 0.8


@pytest.mark.long
def test_a_policy_that_fails_is_braked_and_says_why(tmp_path):
    policy = policy_of(tmp_path / "p", 0.5 * np.array(MOST))
    step, asked = policy.step, []

    def failing(*given):
        asked.append(1)
        if len(asked) > 10:
            raise RuntimeError("out of memory")
        return step(*given)

    policy.step = failing
    run = loop_of(policy).run(GOAL, 2.0)
    assert run.reason == "the policy has failed: RuntimeError: out of memory"
    assert run.braked_from == 400
    assert run.phase == "stopped"
    assert len(asked) == 11


@pytest.mark.long
@pytest.mark.parametrize("brakes", [True, False])
def test_a_mistake_in_a_driver_leaves_no_torque(tmp_path, brakes):
    robot = lab()
    read, wrote, stopped = robot.read, [], []

    def failing():
        if len(wrote) > 300:
            raise KeyError("position")
        return read()

    robot.read, robot.write = failing, wrote.append
    robot.stop = (lambda: stopped.append(1)) if brakes else None
    loop = loop_of(policy_of(tmp_path / "p", 0.5 * np.array(MOST)), robot)
    with pytest.raises(KeyError):
        loop.run(GOAL, 2.0)
    assert bool(stopped) == brakes
    assert brakes or not wrote[-1]["torque"].any()
    assert np.abs(wrote[300]["torque"]).max() > 0.1


@pytest.mark.long
def test_asked_to_stop_by_another_thread_s_signal_it_brakes_and_returns(tmp_path):
    loop = loop_of(policy_of(tmp_path / "p", [1.0, 0, 0, 0, 0, 0, 0]), lab(real_time=True), late_s=10.0)
    timer = threading.Timer(0.5, lambda: os.kill(os.getpid(), signal.SIGINT))
    before = signal.getsignal(signal.SIGINT)  # a background process may have been started with it ignored
    timer.start()
    began = time.monotonic()
    run = loop.run(GOAL, 30.0)
    assert run.reason == "asked to stop"
    assert run.phase == "stopped"
    assert time.monotonic() - began < 20
    assert signal.getsignal(signal.SIGINT) is before


def test_what_does_not_fit_is_refused(tmp_path):
    policy = policy_of(tmp_path / "p", np.zeros(7))
    with pytest.raises(ConfigError, match="whole multiple"):
        loop_of(policy, rate_hz=990.0)
    with pytest.raises(ConfigError, match="takes no torques"):
        loop_of(policy, VirtualRobot(draw_truth(unit=1)))
    with pytest.raises(NameMismatch):
        loop_of(replace_joints(policy, tmp_path))

    class Blind(VirtualRobot):
        def read(self):
            return {"position": super().read()["position"]}

    with pytest.raises(MissingSignal, match="velocity"):
        loop_of(policy, Blind(TRUTH))
    with pytest.raises(DataError, match="a place"):
        loop_of(policy).run(np.array([np.nan, 0, 0]), 1.0)
    with pytest.raises(ConfigError, match="seconds"):
        loop_of(policy).run(GOAL, 0.0)


def replace_joints(policy, tmp_path):
    names = tuple(reversed(PANDA.joint_names))
    folder = tmp_path / "other"
    folder.mkdir()
    (folder / POLICY_GRAPH).write_bytes((tmp_path / "p" / POLICY_GRAPH).read_bytes())
    replace(policy.card, joints=names).save(folder)
    return Policy.load(folder, joints=names, rate_hz=25.0)


DRIVE = """
import sys
from trueup.cli.main import main
main(["deploy", "run", sys.argv[1], "--goals", "50", "--real-time", "--late-ms", "1e4", "--out", sys.argv[2]])
"""


@pytest.mark.long
def test_ctrl_c_on_the_command_line_stops_the_arm_and_keeps_what_was_recorded(tmp_path):
    from trueup.dataset import Dataset

    policy_of(tmp_path / "p", np.zeros(7))
    assert (tmp_path / "p" / POLICY_CARD).is_file()
    process = subprocess.Popen(
        [sys.executable, "-c", DRIVE, str(tmp_path / "p"), str(tmp_path / "data")],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 120
    while not (tmp_path / "data" / "journal.bin").is_file() and time.monotonic() < deadline:
        time.sleep(0.2)
    time.sleep(5.0)  # in the middle of a run
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 2
    assert "stopped: asked to stop; the arm stands" in err
    data = Dataset(tmp_path / "data")
    assert len(data) >= 1
    last = data.episode(data.ids[-1])
    assert [flag.kind for flag in last.meta.flags if flag.kind == "stopped"] == ["stopped"]
    assert "torque" in last.commanded()
