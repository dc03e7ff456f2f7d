"""Physics engines behind one protocol, controllers, friction laws, and replay of logged commands."""

from trueup.sim.blocks import blocks_of as blocks_of
from trueup.sim.dart_engine import DartSimulator as DartSimulator
from trueup.sim.delayed import DelayedSimulator as DelayedSimulator
from trueup.sim.engines import ENGINES as ENGINES
from trueup.sim.engines import make_simulator as make_simulator
from trueup.sim.friction import friction_of as friction_of
from trueup.sim.friction import install as install_friction
from trueup.sim.friction import set_friction as set_friction
from trueup.sim.mujoco_engine import MujocoSimulator as MujocoSimulator
from trueup.sim.payload import attach_payload as attach_payload
from trueup.sim.perturbation import Perturbation as Perturbation
from trueup.sim.perturbation import perturbed as perturbed
from trueup.sim.replay import replay as replay
from trueup.sim.replay import replay_episode as replay_episode
from trueup.sim.replay_plan import ReplayPlan as ReplayPlan
from trueup.sim.replay_settings import ReplaySettings as ReplaySettings

__all__ = [
    "ENGINES",
    "DartSimulator",
    "DelayedSimulator",
    "MujocoSimulator",
    "Perturbation",
    "ReplayPlan",
    "ReplaySettings",
    "attach_payload",
    "blocks_of",
    "friction_of",
    "install_friction",
    "make_simulator",
    "perturbed",
    "replay",
    "replay_episode",
    "set_friction",
]
