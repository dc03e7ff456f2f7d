"""The physics engines by name."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, get_args

from trueup.errors import ConfigError
from trueup.robots import RobotSpec
from trueup.sim.dart_engine import DartSimulator
from trueup.sim.mujoco_engine import MujocoSimulator
from trueup.sim.warp_engine import WarpSimulator

Engine = Literal["mujoco", "dart", "warp"]
ENGINES: tuple[str, ...] = get_args(Engine)


def make_simulator(
    engine: str, robot: RobotSpec, model_path: Path, *, payload_kg: float = 0.0
) -> MujocoSimulator | DartSimulator:
    """The simulator of a robot in the engine of this name, with a payload [kg] where the robot holds one.

    Raises:
        ConfigError: no such engine; it is not installed; the model does not load, holds no payload, or is not matched.
        NameMismatch: a joint is not in the model.
    """
    if engine not in ENGINES:
        raise ConfigError(f"there is no engine {engine!r}", available=ENGINES)
    kinds: dict[str, type[MujocoSimulator] | type[DartSimulator]] = {
        "mujoco": MujocoSimulator,
        "dart": DartSimulator,
        "warp": WarpSimulator,
    }
    return kinds[engine].from_robot(robot, model_path, payload_kg=payload_kg)
