"""An arm in MuJoCo as an environment of others, and networks that add a constant."""

from dataclasses import replace
from typing import ClassVar

import numpy as np
from gymnasium.envs.mujoco import MujocoEnv
from gymnasium.spaces import Box

from augment.evaluation_cases import card_of, shift_folder
from trueup.core.model_card import Input, Output

XML = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <body name="upper"><joint name="a" axis="0 1 0" damping="0.5"/><geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/>
      <body pos="0.3 0 0"><joint name="b" axis="0 1 0" damping="0.5"/><geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.02"/>
        <site name="tip" pos="0.2 0 0"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="ma" joint="a" ctrlrange="-1 1"/><motor name="mb" joint="b" ctrlrange="-1 1"/></actuator>
</mujoco>
"""


class Arm(MujocoEnv):
    """Two links; it sees its joints and where its tip is."""

    metadata: ClassVar = {"render_modes": ["human", "rgb_array", "depth_array", "rgbd_tuple"], "render_fps": 100}

    def __init__(self, xml, frame_skip=5, **options):
        space = Box(-np.inf, np.inf, (7,), np.float64)
        super().__init__(str(xml), frame_skip, observation_space=space, **options)

    def _get_obs(self):
        return np.concatenate([self.data.qpos, self.data.qvel, self.data.site("tip").xpos])

    def reset_model(self):
        self.set_state(np.array([0.3, -0.2]), np.zeros(2))
        return self._get_obs()

    def step(self, action):
        self.do_simulation(action, self.frame_skip)
        return self._get_obs(), -float(np.abs(self.data.qpos).sum()), False, False, {}


SHIFT = np.array([0.02, -0.03, 0.1, -0.2])  # of positions and velocities of a and b


def shifting(folder, shift, joints=("a", "b"), signals=("position", "velocity"), series="simulated", **about):
    """A network that adds a constant to positions and velocities."""
    units = {"position": "rad", "velocity": "rad/s", "torque": "Nm"}
    channels = [(signal, joint, units[signal]) for signal in signals for joint in joints]
    card = replace(
        card_of(joints=joints, signals=("position",), **about),
        inputs=tuple(Input(*channel, series=series) for channel in channels),
        outputs=tuple(Output(*channel, base=number) for number, channel in enumerate(channels)),
    )
    return shift_folder(folder, card, shift)
