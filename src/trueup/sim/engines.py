"""The physics engines by name."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, get_args

from trueup.errors import ConfigError
from trueup.robots import AS_DESCRIBED, RobotSpec, Setup
from trueup.sim.dart_engine import DartSimulator
from trueup.sim.mujoco_engine import MujocoSimulator
from trueup.sim.warp_engine import WarpSimulator

Engine = Literal["mujoco", "dart", "warp"]
ENGINES: tuple[str, ...] = get_args(Engine)


def make_simulator(
    engine: str, robot: RobotSpec, model_path: Path, *, setup: Setup = AS_DESCRIBED
) -> MujocoSimulator | DartSimulator:
    """The simulator of a robot in the engine of this name, with what it carries and how its gains are set.

    Raises:
        ConfigError: no such engine; it is not installed; the model does not load, holds no payload or has no gains
            to set, or is not matched.
        NameMismatch: a joint is not in the model.
    """
    if engine not in ENGINES:
        raise ConfigError(f"there is no engine {engine!r}", available=ENGINES)
    kinds: dict[str, type[MujocoSimulator] | type[DartSimulator]] = {
        "mujoco": MujocoSimulator,
        "dart": DartSimulator,
        "warp": WarpSimulator,
    }
    return kinds[engine].from_robot(robot, model_path, setup=setup)
