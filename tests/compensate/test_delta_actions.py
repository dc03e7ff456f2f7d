"""Delta actions from derivatives: what was injected is found."""

import numpy as np
import pytest

from compensate.arm_cases import arm_of, states, transitions_of
from trueup.compensate.delta_actions import delta_actions


@pytest.mark.parametrize("delay_s", [0.0, 0.008])
@pytest.mark.parametrize("payload_kg", [0.0, 1.5])
def test_an_injected_offset_is_found(tmp_path, payload_kg, delay_s):
    transitions = transitions_of(*arm_of(tmp_path, friction=False), payload_kg=payload_kg, delay_s=delay_s)
    state, before, command = states(20)
    offset = np.random.default_rng(1).normal(0, 0.05, command.shape)
    after = transitions.next(state, before, command + offset)
    found = delta_actions(transitions, state, before, command, after, damping=0.0, iterations=4)
    assert found == pytest.approx(offset, abs=1e-6)


def test_damping_shrinks_and_a_robot_that_is_the_simulator_needs_nothing(tmp_path):
    transitions = transitions_of(*arm_of(tmp_path, friction=False))
    state, before, command = states(10)
    after = transitions.next(state, before, command)
    assert np.abs(delta_actions(transitions, state, before, command, after)).max() < 1e-9
    there = transitions.next(state, before, command + 0.05)
    sizes = [
        np.abs(delta_actions(transitions, state, before, command, there, damping=own)).max() for own in (0.0, 1.0, 1e6)
    ]
    assert sizes[0] > sizes[1] > sizes[2]
    assert sizes[2] < 1e-3
