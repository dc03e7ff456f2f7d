"""One control step of a simulator: against its rollouts, and against derivatives that MuJoCo takes itself."""

import mujoco
import numpy as np
import pytest

from compensate.arm_cases import CONTROL_S, arm_of, states, transitions_of
from trueup.core.protocols import RolloutRequest
from trueup.errors import ConfigError
from trueup.sim import MujocoSimulator
from trueup.sim.transitions import Transitions


@pytest.mark.parametrize("payload_kg", [0.0, 1.5])
def test_steps_one_after_the_other_are_a_rollout(tmp_path, payload_kg):
    transitions = transitions_of(*arm_of(tmp_path), payload_kg=payload_kg)
    state, before, command = states(3)
    once = transitions.next(state, before, command)
    twice = transitions.next(once, command, 0.5 * command)
    steps = round(CONTROL_S / transitions.simulator.timestep_s)
    held = np.concatenate([np.repeat(part[:, None], steps, axis=1) for part in (command, 0.5 * command)], axis=1)
    whole = transitions.simulator.rollout(RolloutRequest(state[:, :2], state[:, 2:], {"position": held}))
    assert twice[:, :2] == pytest.approx(whole.position[:, -1], abs=1e-12)
    assert twice[:, 2:] == pytest.approx(whole.velocity[:, -1], abs=1e-12)


def test_slopes_are_those_of_mujoco_chained_over_the_physics_steps(tmp_path):
    robot, path = arm_of(tmp_path, friction=False)
    transitions = transitions_of(robot, path)
    state, before, command = states(2, seed=1)
    slopes = transitions.slopes(state, before, command)
    model = transitions.simulator.model
    for row in range(2):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = np.split(state[row], 2)
        data.ctrl[:] = command[row]
        by_state, by_command = np.eye(4), np.zeros((4, 2))
        for _ in range(transitions.steps):
            a, b = np.zeros((4, 4)), np.zeros((4, 2))
            mujoco.mjd_transitionFD(model, data, 1e-6, True, a, b, None, None)
            by_state, by_command = a @ by_state, a @ by_command + b
            mujoco.mj_step(model, data)
        assert slopes.state[row] == pytest.approx(by_state, abs=2e-5, rel=1e-4)
        assert slopes.command[row] == pytest.approx(by_command, abs=2e-5, rel=1e-4)
    assert not slopes.before.any()


@pytest.mark.parametrize("delay_s", [0.008, (0.0, 0.02)])
def test_a_delay_is_the_command_before_held_longer(tmp_path, delay_s):
    robot, path = arm_of(tmp_path)
    transitions = transitions_of(robot, path, delay_s=delay_s)
    state, before, command = states(2, seed=2)
    late = np.broadcast_to(np.round(np.asarray(delay_s) / 0.004).astype(int), (2,))
    held = np.where(np.arange(5)[:, None] < late, before[:, None], command[:, None])
    plain = transitions.simulator.rollout(RolloutRequest(state[:, :2], state[:, 2:], {"position": held}))
    after = transitions.next(state, before, command)
    assert after == pytest.approx(np.concatenate([plain.position[:, -1], plain.velocity[:, -1]], axis=1), abs=1e-12)
    slopes = transitions.slopes(state, before, command)
    assert slopes.before.any()
    if np.ndim(delay_s):
        assert not slopes.command[:, :, 1].any(), "a joint that is late by a whole step does not feel the command"


def test_a_delay_between_physics_steps_is_a_mean_of_both_neighbours(tmp_path):
    robot, path = arm_of(tmp_path)
    state, before, command = states(4, seed=3)
    shorter, between, longer = (
        transitions_of(robot, path, delay_s=delay_s).next(state, before, command) for delay_s in (0.004, 0.006, 0.008)
    )
    assert between == pytest.approx((shorter + longer) / 2, abs=1e-3)
    assert np.abs(shorter - longer).max() > 2e-2


@pytest.mark.parametrize(
    ("control_s", "delay_s", "message"),
    [
        (0.0, 0.0, "number of physics steps"),
        (0.005, 0.0, "number of physics steps"),
        (0.02, 0.021, "late by a control"),
    ],
)
def test_what_is_no_control_step_is_refused(tmp_path, control_s, delay_s, message):
    robot, path = arm_of(tmp_path)
    with pytest.raises(ConfigError, match=message):
        Transitions(MujocoSimulator.from_robot(robot, path), control_s, delay_s)


def test_without_dry_friction_a_stuck_joint_moves_again(tmp_path):
    transitions = transitions_of(*arm_of(tmp_path))
    rest = np.zeros((1, 4))
    sag = np.zeros((1, 2))
    for _ in range(200):
        rest = transitions.next(rest, sag, sag)
    stuck = transitions.slopes(rest, sag, sag, size=1e-5)
    free = transitions.without_dry_friction().slopes(rest, sag, sag, size=1e-5)
    assert np.abs(stuck.command).max() < 0.1 * np.abs(free.command).max()
    assert transitions.simulator.model.dof_frictionloss.all(), "the simulator itself keeps its friction"
