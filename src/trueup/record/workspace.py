"""What stands around a robot: a floor and boxes, from a small YAML."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Literal

from trueup.core.config import build, read_yaml
from trueup.errors import ConfigError


@dataclass(frozen=True)
class Box:
    """A box that must not be touched.

    Attributes:
        name: for messages.
        center_m: its center in the frame of the robot's world [m].
        size_m: full lengths along x, y, z [m].
        yaw_rad: rotation about the vertical axis [rad].

    Raises:
        ConfigError: a length that is not positive.
    """

    name: str
    center_m: tuple[float, float, float]
    size_m: tuple[float, float, float]
    yaw_rad: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a box without volume."""
        if not min(self.size_m) > 0:
            raise ConfigError(f"box {self.name!r} has no volume", got=self.size_m)


@dataclass(frozen=True)
class Workspace:
    """A floor and boxes.

    Attributes:
        schema: `trueup.workspace/1`.
        floor_m: height of the floor [m]; None for no floor.
        boxes: walls, tables, and what else is within reach.

    Raises:
        ConfigError: two boxes of one name.
    """

    schema: Literal["trueup.workspace/1"] = "trueup.workspace/1"
    floor_m: float | None = 0.0
    boxes: tuple[Box, ...] = ()

    def __post_init__(self) -> None:
        """Refuse names that would be ambiguous in messages."""
        names = [box.name for box in self.boxes]
        if len(set(names)) != len(names):
            raise ConfigError("two boxes of the workspace have one name", got=names)

    def to_dict(self) -> Mapping[str, Any]:
        """JSON types only."""
        return asdict(self)


def load_workspace(name_or_path: str | Path) -> Workspace:
    """A workspace by the name of a shipped one (`cell`, `floor`, `empty`), or from a YAML file.

    Raises:
        ConfigError: there is none, or its content is wrong.
    """
    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml"):
        folder = Path(str(resources.files("trueup.record"))) / "workspaces"
        shipped = {file.stem: file for file in sorted(folder.glob("*.yaml"))}
        if str(name_or_path) not in shipped:
            raise ConfigError(
                f"there is no workspace {str(name_or_path)!r}",
                available=shipped,
                hint="Give one of these names, or the path of a YAML file with `floor_m` and `boxes`.",
            )
        path = shipped[str(name_or_path)]
    return build(Workspace, read_yaml(path), str(path))
