"""A small arm that carries something, and motions of a robot that is the arm with its commands changed."""

from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import torch

from trueup.augment.config import NetworkConfig
from trueup.compensate.config import CompensateConfig
from trueup.compensate.correctors import corrector_for
from trueup.compensate.linear import Linear
from trueup.compensate.tracks import Track
from trueup.compensate.windows import Windows
from trueup.robots import ControllerSpec, JointSpec, PayloadSpec, RobotSpec, SimulationSpec
from trueup.sim import MujocoSimulator
from trueup.sim.payload import attach_payload
from trueup.sim.transitions import Transitions

ARM = """
<mujoco>
  <worldbody>
    <body>
      <joint name="a" axis="0 1 0" damping="0.2" frictionloss="0.05"/>
      <inertial pos="0 0 -0.2" mass="1" diaginertia="0.02 0.02 0.001"/>
      <body pos="0 0 -0.4">
        <joint name="b" axis="0 1 0" damping="0.1" armature="0.02"/>
        <inertial pos="0 0 -0.15" mass="0.6" diaginertia="0.01 0.01 0.001"/>
        <site name="grip" pos="0 0 -0.3"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
ROBOT = RobotSpec(
    name="arm",
    joints=(JointSpec("a"), JointSpec("b")),
    model="arm.xml",
    controller=ControllerSpec("position", kp=40.0, kv=2.0),
    payload=PayloadSpec(("grip",)),
    simulation=SimulationSpec(timestep_s=0.004),
)
CONTROL_S = 0.02


@cache
def transitions(payload_kg, delay_s=0.0, control_s=CONTROL_S):
    spec = mujoco.MjSpec.from_string(ARM)
    attach_payload(spec, ROBOT, payload_kg)
    return Transitions(MujocoSimulator.from_spec(spec, ROBOT, origin=Path("arm.xml")), control_s, delay_s)


def changes(count, seed):
    """Smooth delta actions that nothing knows, (count, 2) [rad]."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(count)[:, None] * CONTROL_S
    return 0.1 * np.sin(rng.uniform(1, 4, 2) * time_s + rng.uniform(0, 6, 2))


def tracks(*, count=120, payloads=(0.0, 1.0), of_each=2, changed=changes, delay_s=0.0, seed=0):
    """Motions of robots that are the arm, but that add `changed(count, seed)` to their commands; and what they add."""
    made, added = [], []
    for number, payload_kg in enumerate(np.repeat(payloads, of_each).tolist()):
        rng = np.random.default_rng([seed, number])
        time_s = np.arange(count) * CONTROL_S
        command = np.sin(rng.uniform(0.5, 2, 2) * time_s[:, None] + rng.uniform(0, 6, 2)).astype(np.float32)
        delta = changed(count, 100 * seed + number)
        own, sent = transitions(payload_kg, delay_s), command.astype(np.float64) + delta
        state = [np.concatenate([sent[0], np.zeros(2)])]
        for step in range(count - 1):
            before = sent[max(step - 1, 0)]
            state.append(own.next(state[-1][None], before[None], sent[step][None])[0])
        made.append(Track(f"m{number}", payload_kg, np.array(state, np.float32), command, time_s))
        added.append(delta)
    return made, added


def corrector(motions, *, seed=0, network=None):
    """A network with random weights for the arm; an action of 1 is 0.05 rad."""
    config = CompensateConfig(network=network or NetworkConfig("mlp", (16,), history=2))
    zeros = [np.zeros((len(track) - 1, *shape), np.float32) for track in motions for shape in ((4,), (4, 4), (4, 2))]
    parts = [
        Linear(track, zeros[3 * k], zeros[3 * k + 1], zeros[3 * k + 2], zeros[3 * k + 2])
        for k, track in enumerate(motions)
    ]
    torch.manual_seed(seed)
    return corrector_for(config, Windows(parts, config.network.history - 1), rate_hz=1 / CONTROL_S, size=0.05)
