"""Plan sets on disk, read: JSON for what was planned, Parquet for the samples.

plans.json             what was asked for: description (or ids and origin of plans that were made elsewhere), robot,
hash of the model; how many were planned
blocks/00000.json      rows of the first block of motions: ids, joints, splits, draws; which were skipped, and why
blocks/00000.parquet   their samples, one row group a motion
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from trueup.core.atomic import read_json
from trueup.core.config import build, build_versioned
from trueup.dataset.columns import from_table
from trueup.dataset.shards import ShardReader
from trueup.errors import ConfigError, DataError, MissingSignal
from trueup.record.plan import Plan
from trueup.record.planset import PLANS_SCHEMA, PlanSetSpec
from trueup.record.scene import Scene
from trueup.record.workspace import Workspace
from trueup.robots import RobotSpec

PLANS_NAME = "plans.json"
BLOCKS = "blocks"
BLOCK_SCHEMA = "trueup.plan-block/1"
# Motions of one block: what is planned again after an interruption, and the unit of work of a process.
BLOCK = 16

_OPEN_BLOCKS = 8
# What plans.json says about what decided about the plans.
_ASKED = ("spec", "ids", "origin", "robot", "joints", "model")
_AGAIN = "Plan the set again into the same folder: what is there is kept."


@dataclass(frozen=True)
class _Record:
    """The content of plans.json."""

    robot: str
    joints: tuple[str, ...]
    model: Mapping[str, str]
    complete: bool
    spec: PlanSetSpec | None = None
    ids: tuple[str, ...] = ()
    origin: Mapping[str, Any] = field(default_factory=dict)
    planned: int = 0
    skipped: int = 0
    provenance: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class _Limits:
    """What `origin` says of the joints, in their order; as many numbers as there are joints, or none."""

    velocity: tuple[float, ...] = ()
    acceleration: tuple[float, ...] = ()
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()


@dataclass(frozen=True)
class _Row:
    """What a block says of a plan; `Plan` has the meaning."""

    id: str
    kind: str
    moving: tuple[str, ...]
    samples: int
    start_s: float
    end_s: float
    condition: str
    split: str
    seed: int | None
    index: int | None
    details: Mapping[str, Any]


@dataclass(frozen=True)
class _Skipped:
    id: str
    reason: str


@dataclass(frozen=True)
class _Block:
    """The content of a block's JSON."""

    plans: tuple[_Row, ...]
    skipped: tuple[_Skipped, ...]


class PlanSet:
    """A plan set on disk, read one motion at a time; neither the planner nor an engine is needed.

    Attributes:
        path: its folder.
        spec: what was asked for; None for plans that were made elsewhere and stored.
        origin: what decided about those; empty where there is a spec.
        joints: the robot's joints.
        robot: the robot's name.
        complete: whether planning went through.

    Raises:
        FormatError: the folder holds no plan set, or one of another version.
        DataError: it is damaged.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        where = str(self.path / PLANS_NAME)
        tree = read_json(self.path / PLANS_NAME)
        record = build_versioned(_Record, tree, where, schema=PLANS_SCHEMA, what="plan set")
        if not record.ids and record.spec is None:
            raise DataError(f"{where} says nothing of what is planned", expected="spec, or ids")
        self.spec = None if record.ids else record.spec
        self._ids = record.ids
        self.origin = record.origin
        self._asked = {name: tree[name] for name in _ASKED if name in tree}
        self.joints, self.robot, self.complete = record.joints, record.robot, record.complete
        self._blocks: OrderedDict[int, dict[str, Any]] = OrderedDict()
        self._shards = ShardReader(self.path / BLOCKS)

    def __len__(self) -> int:
        """The number of motions that were asked for, skipped ones included."""
        return len(self._ids) if self.spec is None else len(self.spec)

    def __getitem__(self, id: str) -> Plan:
        """One plan.

        Raises:
            ConfigError: the set has no such motion.
            MissingSignal: it was skipped, or is not planned yet.
            DataError: it is damaged.
        """
        number = self.number(id)
        rows = self._block(number // BLOCK)
        for group, row in enumerate(rows["plans"]):
            if row["id"] == id:
                return self._plan(number // BLOCK, group, row)
        reasons = {item["id"]: item["reason"] for item in rows["skipped"]}
        if id not in reasons:
            raise MissingSignal(f"{self.path} is not complete", got=f"no motion {id!r}", hint=_AGAIN)
        raise MissingSignal(f"motion {id!r} was skipped when the set was planned", got=reasons.get(id))

    def __iter__(self) -> Iterator[Plan]:
        """All plans in order, one at a time; skipped motions are left out."""
        for block in range(-(-len(self) // BLOCK)):
            for group, row in enumerate(self._block(block)["plans"]):
                yield self._plan(block, group, row)

    def ids(self) -> Iterator[str]:
        """Ids of the plans in order."""
        for block in range(-(-len(self) // BLOCK)):
            yield from (row["id"] for row in self._block(block)["plans"])

    def there(self) -> Iterator[Plan]:
        """The plans of a set that is perhaps not complete, up to the first block that is missing."""
        for block in range(-(-len(self) // BLOCK)):
            if not block_path(self.path, block).exists():
                return
            for group, row in enumerate(self._block(block)["plans"]):
                yield self._plan(block, group, row)

    def scene(self, robot: RobotSpec, *, model: Path | None = None, clearance_share: float = 1.0) -> Scene:
        """The surroundings that the motions were planned in, for the ways between them; see `Scene` for errors.

        Args:
            robot: the robot.
            model: its MJCF or URDF; found as for replay if not given.
            clearance_share: of the clearance that the plans keep.
        """
        if self.spec is not None:
            spec = replace(self.spec, clearance_m=clearance_share * self.spec.clearance_m)
            return spec.scene(robot, model=model)
        limits = build(_Limits, self.origin.get("limits", {}), f"{self.path / PLANS_NAME}: limits")
        for name, values in vars(limits).items():
            if values and len(values) != len(self.joints):
                raise DataError(
                    f"{self.path / PLANS_NAME}: limits: {name}", got=values, expected=f"{len(self.joints)} numbers"
                )
        return Scene(
            robot,
            workspace=build(Workspace, self.origin.get("workspace", {}), str(self.path / PLANS_NAME)),
            model=model,
            clearance_m=clearance_share * PlanSetSpec.clearance_m,
            velocity=dict(zip(self.joints, limits.velocity, strict=False)),
            acceleration=dict(zip(self.joints, limits.acceleration, strict=False)),
        )

    def skipped(self) -> dict[str, str]:
        """Id -> why no plan was found."""
        found: dict[str, str] = {}
        for block in range(-(-len(self) // BLOCK)):
            found |= {item["id"]: item["reason"] for item in self._block(block)["skipped"]}
        return found

    @property
    def seed(self) -> int | None:
        """The seed of its draws, if a description made it."""
        return None if self.spec is None else self.spec.seed

    def to_dict(self) -> dict[str, Any]:
        """All that decides about the plans, JSON types only."""
        return dict(self._asked)

    def number(self, id: str) -> int:
        """The number of a motion, from its id, skipped ones included.

        Raises:
            ConfigError: there is no such motion.
        """
        if self.spec is not None:
            return self.spec.number(id)
        if id not in self._ids:
            raise ConfigError(f"there is no motion {id!r}", available=self._ids)
        return self._ids.index(id)

    def _id(self, number: int) -> str:
        return self._ids[number] if self.spec is None else self.spec.id(number)

    def _block(self, number: int) -> dict[str, Any]:
        if number in self._blocks:
            self._blocks.move_to_end(number)
            return self._blocks[number]
        if not block_path(self.path, number).exists():
            raise MissingSignal(
                f"{self.path} is not complete",
                got=f"no block {number}",
                hint=_AGAIN,
            )
        rows = read_block(self.path, number)
        known = [self._id(place) for place in range(number * BLOCK, min(len(self), (number + 1) * BLOCK))]
        plans, skipped = ([row["id"] for row in rows[name]] for name in ("plans", "skipped"))
        # Plans that are given one by one fill a block from its beginning.
        ids = [name for name in known if name in {*plans, *skipped}]
        whole = ids == known[: len(plans) + len(skipped)] and len(ids) == len(plans) + len(skipped)
        if not whole or plans != [name for name in ids if name in plans]:
            path = block_path(self.path, number)
            raise DataError(f"{path} holds other motions than the set", got=[*plans, *skipped], hint=_AGAIN)
        self._blocks[number] = rows
        if len(self._blocks) > _OPEN_BLOCKS:
            self._blocks.popitem(last=False)
        return self._blocks[number]

    def _plan(self, block: int, group: int, row: Mapping[str, Any]) -> Plan:
        table, layout = self._shards.read(block, group, int(row["samples"]))
        return Plan.from_row(row, from_table(table, layout))

    def close(self) -> None:
        """Close the open files; reading opens them again."""
        self._shards.close()


def block_path(folder: Path, number: int) -> Path:
    """The JSON file of a block."""
    return folder / BLOCKS / f"{number:05d}.json"


def read_block(folder: Path, number: int) -> dict[str, Any]:
    """The rows of a block: `plans` and `skipped`.

    Raises:
        FormatError: it is no block, or of another version.
        DataError: it cannot be read.
    """
    path = block_path(folder, number)
    data: dict[str, Any] = read_json(path)
    build_versioned(_Block, data, str(path), schema=BLOCK_SCHEMA, what="block of plans")
    return data
