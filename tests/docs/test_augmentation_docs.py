"""docs/augmentation.md: its Python runs, and what a command reads was made by one above it."""

import re
import shlex
from pathlib import Path
from typing import ClassVar

import gymnasium
import mujoco
import numpy as np
import pytest
from benchmarks.networks import JOINTS, real_time
from gymnasium.envs.mujoco import MujocoEnv
from gymnasium.spaces import Box

import trueup.zoo
from augment.augment_cases import make_dataset
from trueup.augment.config import FEWEST_FOR_CHANCE
from trueup.augment.networks import METHODS, method
from trueup.core.protocols import Simulator
from trueup.deploy.agreement import RATE_TOLERANCE
from trueup.robots import find_model, load_robot

TEXT = (Path(__file__).parent.parent.parent / "docs" / "augmentation.md").read_text()


@pytest.mark.long
def test_the_python_of_the_page_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    real_time(Path("models/panda-rt"), hidden=(8, 5), rate_hz=100.0)
    make_dataset(Path("data/unit2"), joints=JOINTS)
    zoo, simulator, environment = re.findall(r"^```python\n(.*?)^```$", TEXT, re.M | re.S)
    names = {}
    exec(compile(zoo, "augmentation.md", "exec"), names)
    run = names["episode"].run("mujoco/stock")
    assert np.abs(names["corrected"]["torque"] - run["torque"]).max() > 0.01
    exec(compile(simulator, "augmentation.md", "exec"), names)
    assert isinstance(names["corrected"], Simulator)
    assert names["reading"]["torque"].shape == (64, 7)
    inside = names["simulator"].step({"position": names["pose"]})  # one step on, at rest
    assert np.abs(names["reading"]["position"] - inside["position"]).max() > 0.01
    monkeypatch.setitem(
        gymnasium.registry, "MyArm-v0", gymnasium.envs.registration.EnvSpec("MyArm-v0", entry_point=Arm)
    )
    assert "100_000" in environment  # a page's training is long, a test's is not
    exec(compile(environment.replace("100_000", "130"), "augmentation.md", "exec"), names)
    assert names["env"].unwrapped.data.time > 0


class Arm(MujocoEnv):
    """A Panda of somebody's own, 100 steps a second."""

    metadata: ClassVar = {"render_modes": ["human", "rgb_array", "depth_array", "rgbd_tuple"], "render_fps": 100}

    def __init__(self):
        file = find_model(load_robot("panda"))
        skip = round(0.01 / mujoco.MjModel.from_xml_path(str(file)).opt.timestep)
        super().__init__(str(file), skip, observation_space=Box(-np.inf, np.inf, (14,), np.float64))

    def _get_obs(self):
        return np.concatenate([self.data.qpos[:7], self.data.qvel[:7]])

    def reset_model(self):
        self.set_state(self.init_qpos, self.init_qvel)
        return self._get_obs()

    def step(self, action):
        self.do_simulation(action, self.frame_skip)
        return self._get_obs(), -float(np.abs(self.data.qvel).sum()), False, self.data.time > 0.5, {}


def test_what_a_command_reads_was_made_by_one_above_it():
    """Followed from top to bottom, no command misses a dataset or a model."""
    made, read = set(), []
    shell = "".join(re.findall(r"^```sh\n(.*?)^```$", TEXT, re.M | re.S))
    for line in shell.splitlines():
        words = shlex.split(line)
        if words[:2] == ["trueup", "record"]:
            made.add(words[words.index("--out") + 1])
            continue
        for word in words:
            if word.startswith(("data/", "models/")) and words[words.index(word) - 1] != "--out":
                read.append(word)
                assert word in made, line
            if word.startswith("zoo:"):
                assert trueup.zoo.folder_of(word).is_dir()
        if "--out" in words:
            made.add(words[words.index("--out") + 1])
    assert {"data/panda", "models/panda-rt", "models/panda-average"} <= set(read)


def test_the_numbers_of_the_page_are_those_of_the_code():
    assert FEWEST_FOR_CHANCE == 10
    said = " ".join(TEXT.split())
    assert "With fewer than ten val motions" in said
    assert f"than the network was trained at, by more than {100 * RATE_TOLERANCE:g} %" in said
    assert all(f'load("{name}")' in TEXT for name in trueup.zoo.names())
    ahead = [f"`{name}`" for name in METHODS if method(name).config.network.bidirectional]
    assert f"All but {' and '.join(ahead)} work in a control loop" in said
