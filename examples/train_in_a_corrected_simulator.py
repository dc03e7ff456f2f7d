"""How do I train my own agent in a corrected simulator?

One line corrects the observations of a Gymnasium environment based on MuJoCo.

    python examples/train_in_a_corrected_simulator.py [STEPS]
"""

import sys
from typing import Any, ClassVar

import mujoco
import numpy as np
from gymnasium.envs.mujoco import MujocoEnv
from gymnasium.spaces import Box
from stable_baselines3 import SAC

import trueup.zoo
from trueup.policy import ResidualEnv
from trueup.robots import find_model, load_robot

STEPS = int(sys.argv[1]) if len(sys.argv) > 1 else 2000


class HoldStill(MujocoEnv):
    """A Panda driven by torques that is to stay where it is, 100 steps a second: an environment as people have them."""

    metadata: ClassVar = {"render_modes": ["human", "rgb_array", "depth_array", "rgbd_tuple"], "render_fps": 100}

    def __init__(self) -> None:
        model = find_model(load_robot("panda"))
        skip = round(0.01 / mujoco.MjModel.from_xml_path(str(model)).opt.timestep)
        super().__init__(str(model), skip, observation_space=Box(-np.inf, np.inf, (14,), np.float64))

    def _get_obs(self) -> np.ndarray:
        return np.concatenate([self.data.qpos[:7], self.data.qvel[:7]])

    def reset_model(self) -> np.ndarray:
        self.set_state(self.init_qpos, self.init_qvel)
        return self._get_obs()

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        self.do_simulation(action, self.frame_skip)
        return self._get_obs(), -float(np.abs(self.data.qvel).sum()), False, self.data.time > 1.0, {}


env = ResidualEnv(HoldStill(), trueup.zoo.folder("panda-realeasy-rt"))  # the one line
agent = SAC("MlpPolicy", env, learning_starts=100, seed=0)
agent.learn(STEPS)
seen, _ = env.reset(seed=0)
said = []
for _ in range(50):
    seen, _, _, _, info = env.step(agent.predict(seen, deterministic=True)[0])
    said.append(info["residual"])
print(f"{STEPS} steps of training; in the last 50 the network said: {', '.join(sorted(set(map(str, said))))}")
