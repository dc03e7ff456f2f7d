"""Physics engines behind one protocol, controllers, and replay of logged commands."""

from trueup.sim.mujoco_engine import MujocoSimulator as MujocoSimulator
from trueup.sim.replay import ReplaySettings as ReplaySettings
from trueup.sim.replay import hold as hold
from trueup.sim.replay import replay as replay
from trueup.sim.replay import replay_episode as replay_episode

__all__ = ["MujocoSimulator", "ReplaySettings", "hold", "replay", "replay_episode"]
