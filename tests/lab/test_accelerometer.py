"""The accelerometer of a virtual robot's base: it says what pulls on the robot, and a simulation that hears it follows."""

from dataclasses import replace

import numpy as np
import pytest

from trueup.core.episode import Episode, EpisodeMeta
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter
from trueup.errors import ConfigError
from trueup.lab import VirtualRobot, draw_truth, load_lab
from trueup.lab.spec import Base, Inertial, Markers
from trueup.record.following import follow
from trueup.robots import Setup, find_model, load_robot
from trueup.sim import MujocoSimulator, ReplaySettings, replay_episode
from trueup.sim.moving_base import SPECIFIC_FORCE

LAB = load_lab("upper_body")
EXACT = Inertial("torso", 0.0, 0.0)
DOWN = np.array([0.0, 0.0, -9.81])


def robot(condition="gait", inertial=EXACT, *, effects=True, seed=3, payload_kg=0.0):
    spec = replace(LAB, base=Base(condition=condition), inertial=inertial)
    return VirtualRobot(draw_truth(spec if effects else spec.only("base")), seed=seed, payload_kg=payload_kg)


def waiting(it, steps):
    return {"position": np.tile(it._plant.home, (steps, 1))}


@pytest.mark.parametrize("condition", ["squat", "gait"])
def test_it_says_what_pulls(condition):
    it = robot(condition)
    done = it.execute(waiting(it, 800), every=10)
    felt = done.measured[SPECIFIC_FORCE]
    assert felt.shape == (81, 1, 3)
    assert done.measured.bodies == ("torso",)
    np.testing.assert_allclose(-felt[:, 0], it._base.gravity(done.measured.time_s, DOWN), atol=1e-12)
    np.testing.assert_array_equal(done.truth[SPECIFIC_FORCE], felt)
    assert felt.std(axis=0).max() > 0.05


def test_a_base_at_rest_says_gravity():
    it = robot("stance")
    np.testing.assert_allclose(it.execute(waiting(it, 50)).measured[SPECIFIC_FORCE][:, 0] + DOWN, 0.0, atol=1e-12)


@pytest.mark.long
def test_its_errors_are_those_that_were_asked_for():
    errors, biases = [], []
    for seed in range(40):
        it = robot("gait", Inertial("torso", 0.2, 0.5), effects=False, seed=seed)
        done = it.execute(waiting(it, 400))
        error = done.measured[SPECIFIC_FORCE] - done.truth[SPECIFIC_FORCE]
        biases.append(error.mean(axis=0))
        errors.append(error - error.mean(axis=0))
    assert np.std(errors) == pytest.approx(0.2, rel=0.02)
    assert np.std(biases) == pytest.approx(0.5, rel=0.2)


def test_the_robot_is_the_same_with_and_without():
    command = waiting(robot(), 300)
    with_it, without = (robot(inertial=own).execute(command).measured for own in (Inertial("torso"), Inertial()))
    assert set(with_it.signals) - set(without.signals) == {SPECIFIC_FORCE}
    for name, values in without.signals.items():
        np.testing.assert_array_equal(with_it[name], values)


def test_a_motion_in_pieces_is_felt_as_the_whole():
    whole, pieces = (robot(inertial=Inertial("torso")) for _ in range(2))
    expected = whole.execute(waiting(whole, 200)).measured[SPECIFIC_FORCE]
    parts = [pieces.execute(waiting(pieces, steps)).measured[SPECIFIC_FORCE] for steps in (70, 130)]
    np.testing.assert_array_equal(np.concatenate([parts[0], parts[1][1:]]), expected)


def test_a_recording_has_it_and_a_simulation_follows(tmp_path):
    """Hardware without effects: what is left between it and its simulator is what the base does."""
    it = robot(effects=False, payload_kg=2.0)
    done = follow(it, waiting(it, 3000), step_s=0.001, every=5, silent_s=5.0)
    with DatasetWriter.create(tmp_path / "data", DatasetInfo(robot="upper_body")) as writer:
        writer.append(Episode(EpisodeMeta("one", payload_kg=2.0), done.measured, done.command))
    log = Dataset(tmp_path / "data").episode("one")
    assert log.measured.units[SPECIFIC_FORCE] == ("m/s^2",)
    plain = load_robot("upper_body")
    gaps = []
    for own in (plain, replace(plain, simulation=replace(plain.simulation, base_sensor="torso"))):
        simulator = MujocoSimulator.from_robot(own, find_model(own), setup=Setup(2.0))
        simulator.model.dof_frictionloss[:] = simulator.model.dof_damping[:] = 0.0  # the hardware has none
        simulated = replay_episode(log, simulator, ReplaySettings.of(own))
        # The robot began in its pose and sagged; the simulation began where it hangs.
        rows = slice(len(simulated) // 2, None)
        gap = simulated["position"][rows] - log.measured["position"][-len(simulated) :][rows]
        gaps.append(float((gap - gap.mean(axis=0)).std()))
    assert gaps[1] < 0.1 * gaps[0]


def test_what_does_not_go_together_is_refused():
    with pytest.raises(ConfigError, match="not both"):
        replace(LAB, inertial=EXACT, markers=Markers(bodies=("left_hand",)))
    for body, why in (("left_hand", "moves with"), ("head", "no body")):
        with pytest.raises(ConfigError, match=why):
            robot(inertial=Inertial(body))
    with pytest.raises(ConfigError, match="noise_m_s2"):
        replace(LAB, inertial=Inertial("torso", noise_m_s2=-1.0))
