import pickle
from dataclasses import replace

import numpy as np
import pytest

from sim.arms import two_links
from sim.test_replay import SERVO, logged_motion
from trueup.errors import BarNotMet, ConfigError, DataError, NameMismatch, TrueupError
from trueup.robots import ControllerSpec, find_model, load_robot
from trueup.sim import ENGINES, DartSimulator, ReplaySettings, make_simulator, replay


def test_every_engine_makes_the_robot():
    robot = load_robot("panda")
    robot = replace(robot, controller=ControllerSpec(kind="position", kp=100.0, kv=5.0))  # without plugins
    simulators = [make_simulator(engine, robot, find_model(robot)) for engine in ENGINES]
    assert len({simulator.fingerprint for simulator in simulators}) == len(ENGINES)
    for simulator in simulators:
        assert simulator.joints == robot.joint_names
        assert (simulator.timestep_s, simulator.command_signals) == (robot.simulation.timestep_s, ("position",))
        assert tuple(simulator.torque_limits.values()) == (87.0,) * 4 + (12.0,) * 3


def test_an_engine_that_is_none_is_named_with_those_that_are():
    robot = load_robot("panda")
    with pytest.raises(ConfigError, match=r"no engine 'gazebo'.*available: mujoco, dart"):
        make_simulator("gazebo", robot, find_model(robot))


@pytest.mark.long
def test_processes_give_what_threads_give_errors_included(tmp_path):
    simulator = two_links(tmp_path, SERVO, timestep_s=0.005)
    logs = [logged_motion(simulator, seed=seed) for seed in range(3)]
    logs[1].measured.signals["position"][0] = np.nan
    dart = DartSimulator(simulator.model, simulator.robot, simulator.channels)
    threads, processes = (
        list(replay(logs, dart.clone, ReplaySettings(), jobs=2, processes=processes)) for processes in (False, True)
    )
    for (name, one), (other_name, other) in zip(threads, processes, strict=True):
        assert name == other_name
        if isinstance(one, TrueupError):
            assert (type(other), str(other)) == (type(one), str(one))
        else:
            np.testing.assert_array_equal(other["position"], one["position"])
    assert isinstance(processes[1][1], DataError)


@pytest.mark.long
def test_a_worker_that_cannot_start_is_an_error_of_two_lines(tmp_path):
    with pytest.raises(ConfigError, match=r"a worker process ended.*\n.*__main__"):
        list(replay([logged_motion(two_links(tmp_path, SERVO))], _die, ReplaySettings(), jobs=2, processes=True))


def _die():
    import os

    os._exit(1)


@pytest.mark.parametrize(
    "error",
    [
        DataError("what", got=1, expected="2", hint="next"),
        NameMismatch("joints", left=["a"], right=["b"]),
        BarNotMet("bar"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_errors_survive_the_way_from_a_worker(error):
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), str(again), again.what, again.hint) == (type(error), str(error), error.what, error.hint)
    assert again.details == error.details
