"""What motions a data set is made of, and any one of them, planned alone."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from importlib import resources
from itertools import combinations
from pathlib import Path
from typing import Any, Literal

import numpy as np

from trueup.core.config import build, read_yaml
from trueup.dataset import SPLITS
from trueup.errors import ConfigError
from trueup.record.keyframes import Animation, animated
from trueup.record.lines import PLANES, random_line
from trueup.record.motion import MotionSettings, random_joint_motion
from trueup.record.plan import Plan
from trueup.record.references import FUNCTIONS, ReferenceSettings, random_reference
from trueup.record.scene import Scene
from trueup.record.splines import CONTROL_POINTS, EXTENT_M, ORDERS, SPAN_S, random_joint_spline, random_spline
from trueup.record.workspace import Workspace, load_workspace
from trueup.robots import RobotSpec

PLANS_SCHEMA = "trueup.plans/1"

_SHIPPED = Path(str(resources.files("trueup.record"))) / "plans"
# Months of a robot; a typing error makes more, and the draw of their splits alone fills the memory.
_MOST_MOTIONS = 1_000_000
# With more joints than this, sets of joints are drawn; with fewer, each of them has its turn.
_ALL_SUBSETS = 10


@dataclass(frozen=True)
class MotionGroup:
    """Motions of one kind.

    Attributes:
        name: for ids and as the condition of the episodes; letters, digits, `_ . -`.
        kind: `joint` (to a random goal), `cartesian` (lines), `b-spline` (of sites), `joint-b-spline`, `animation`
            (keyframes), or a function of time: `chirp`, `multisine`, `random-field`, `chebyshev`.
        count: number of motions.
        moving: `single` moves one joint at a time, each in its turn; `multi` two or more, all sets of them in turn;
            `all` all. Not for `cartesian`, `b-spline` and `animation`, which move what they must.
        joints: the joints that may be chosen; all if empty.
        split: the split of all of them; drawn by the set's fractions if empty.
        velocity_share: range from which the share of the velocity limits is drawn; not for `animation`.
        control_points: of each spline.
        range_share: of `joint-b-spline`: range from which the share of the position ranges is drawn that is used.
        pause_share: of `joint-b-spline`: share of the control points at which a joint rests, each for itself.
        span_s: of `joint-b-spline`: time from one knot to the next, at least [s].
        sites: of `b-spline`: those that follow a spline each; the end effector if empty.
        extent_m: of `b-spline`: half the edge of the cube that control points are drawn from [m].
        duration_s: of functions of time: range from which the length of the motion is drawn, without rest; the set's
            if None [s].
        length_s: of `random-field`: likewise the correlation length [s].
        from_home: of splines: begin at home, where no way before the motion has left anything in the joints.
        animations: of `animation`: those of the set that are played in turn; all if empty.
        speed: of `animation`: range from which the speed is drawn, 1 as it was made.
        amplitude: of `animation`: likewise the size of its movements.

    Raises:
        ConfigError: no name, a negative count, a range that is none, too few control points.
    """

    name: str
    kind: Literal[
        "joint",
        "cartesian",
        "b-spline",
        "joint-b-spline",
        "animation",
        "chirp",
        "multisine",
        "random-field",
        "chebyshev",
    ]
    count: int
    moving: Literal["single", "multi", "all"] = "multi"
    joints: tuple[str, ...] = ()
    split: Literal["", "train", "val", "test"] = ""
    velocity_share: tuple[float, float] = (0.2, 1.0)
    control_points: int = CONTROL_POINTS
    range_share: tuple[float, float] = (1.0, 1.0)
    pause_share: float = 0.0
    span_s: float = SPAN_S
    sites: tuple[str, ...] = ()
    extent_m: float = EXTENT_M
    duration_s: tuple[float, float] | None = None
    length_s: tuple[float, float] | None = None
    from_home: bool = False
    animations: tuple[str, ...] = ()
    speed: tuple[float, float] = (1.0, 1.0)
    amplitude: tuple[float, float] = (1.0, 1.0)

    @property
    def leads_end_effector(self) -> bool:
        """Whether a motion is one of the end effector, so that the model must have one."""
        return self.count > 0 and (self.kind == "cartesian" or (self.kind == "b-spline" and not self.sites))

    def __post_init__(self) -> None:
        """Refuse groups that cannot be planned."""
        if not self.name or not all(letter.isalnum() or letter in "_.-" for letter in self.name):
            raise ConfigError("this is no name for a group", got=repr(self.name), expected="letters, digits, _ . -")
        if self.count < 0:
            raise ConfigError(f"group {self.name!r} has a negative count", got=self.count)
        for name in ("velocity_share", "range_share"):
            low, high = getattr(self, name)
            if not 0 < low <= high <= 1:
                raise ConfigError(
                    f"{name} of group {self.name!r} is no range of shares", got=(low, high), expected="in (0, 1]"
                )
        for name in ("speed", "amplitude", "duration_s", "length_s"):
            low, high = getattr(self, name) or (1.0, 1.0)
            if not 0 < low <= high < np.inf:
                raise ConfigError(f"{name} of group {self.name!r} is no range", got=(low, high), expected="above 0")
        if not 0 <= self.pause_share < 1:
            raise ConfigError(f"pause_share of group {self.name!r}", got=self.pause_share, expected="a share below 1")
        if self.control_points <= max(ORDERS) or not all(0 < size < np.inf for size in (self.extent_m, self.span_s)):
            raise ConfigError(
                f"splines of group {self.name!r}",
                got=(self.control_points, self.extent_m, self.span_s),
                expected=f"more than {max(ORDERS)} control_points, extent_m and span_s above 0",
            )


@dataclass(frozen=True)
class PlanSetSpec:
    """A set of motions, as a function of a seed.

    Attributes:
        name: for people.
        groups: what it is made of.
        seed: of all draws. Motion k of a group is a function of the seed, the group's name and k, so that any of
            them can be planned alone, and a smaller set holds the first motions of a larger one.
        fractions: split -> share of each group that has no split of its own, drawn by whole motions.
        workspace: what stands around the robot.
        clearance_m: what planning keeps between things that must not touch [m].
        motion: clock, planner, attempts.
        reference: what functions of time are drawn.
        velocity_limits: joint -> largest speed, where the model has none [rad/s or m/s].
        acceleration_limits: joint -> largest acceleration, where the model has none [rad/s^2 or m/s^2].
        animations: name -> motion made by hand, for the groups of this kind.
        schema: `trueup.plans/1`.

    Raises:
        ConfigError: no motion, two groups of one name, an animation that there is not, fractions that do not add up to
            1, a negative seed.
    """

    name: str
    groups: tuple[MotionGroup, ...]
    seed: int = 0
    fractions: Mapping[str, float] = field(default_factory=lambda: {"train": 0.8, "val": 0.15, "test": 0.05})
    workspace: Workspace = field(default_factory=Workspace)
    clearance_m: float = 0.01
    motion: MotionSettings = field(default_factory=MotionSettings)
    reference: ReferenceSettings = field(default_factory=ReferenceSettings)
    velocity_limits: Mapping[str, float] = field(default_factory=dict)
    acceleration_limits: Mapping[str, float] = field(default_factory=dict)
    animations: Mapping[str, Animation] = field(default_factory=dict)
    schema: Literal["trueup.plans/1"] = "trueup.plans/1"

    def __post_init__(self) -> None:
        """Refuse sets that are none."""
        names = [group.name for group in self.groups]
        if len(set(names)) != len(names):
            raise ConfigError("groups of a plan set need different names", got=names)
        for group in self.groups:
            unknown = [name for name in group.animations if name not in self.animations]
            if unknown or (group.kind == "animation" and not self.animations):
                raise ConfigError(
                    f"group {group.name!r} plays animations that the set does not have",
                    got=unknown or "none at all",
                    available=list(self.animations),
                    hint="Describe them under `animations:` in the same file.",
                )
        if not 0 < len(self) <= _MOST_MOTIONS:
            raise ConfigError(
                "a plan set needs motions" if not len(self) else "a plan set of too many motions",
                got={group.name: group.count for group in self.groups},
                expected=f"1 to {_MOST_MOTIONS}",
            )
        if not set(self.fractions) <= set(SPLITS):
            raise ConfigError("fractions are of other splits", got=sorted(self.fractions), available=SPLITS)
        if abs(sum(self.fractions.values()) - 1) > 1e-9:
            raise ConfigError("fractions must add up to 1", got=dict(self.fractions))
        if min(self.fractions.values()) < 0 or self.seed < 0:
            raise ConfigError("fractions and seed must not be negative", got=(dict(self.fractions), self.seed))

    def __len__(self) -> int:
        """The number of motions."""
        return sum(group.count for group in self.groups)

    def scaled(self, scale: float) -> PlanSetSpec:
        """The same with `scale` times the motions of each group, at least one of each.

        Raises:
            ConfigError: a scale that is not positive.
        """
        if not (scale > 0 and np.isfinite(scale)):
            raise ConfigError("the scale must be positive", got=scale)
        groups = (replace(group, count=max(1, round(scale * group.count)) * (group.count > 0)) for group in self.groups)
        return replace(self, groups=tuple(groups))

    def place(self, number: int) -> tuple[MotionGroup, int]:
        """The group of a motion, and its place in it.

        Args:
            number: 0 to len - 1, through all groups.

        Raises:
            ConfigError: there is no such motion.
        """
        left = number
        for group in self.groups:
            if 0 <= left < group.count:
                return group, left
            left -= group.count
        raise ConfigError("there is no such motion", got=number, expected=f"0 to {len(self) - 1}")

    def id(self, number: int) -> str:
        """The id of a motion."""
        group, index = self.place(number)
        return f"{group.name}/{index:05d}"

    def number(self, id: str) -> int:
        """The number of a motion, from its id.

        Raises:
            ConfigError: there is no such motion.
        """
        name, _, digits = id.rpartition("/")
        before = 0
        for group in self.groups:
            if group.name == name and digits.isdecimal() and int(digits) < group.count:
                return before + int(digits)
            before += group.count
        raise ConfigError(f"there is no motion {id!r}", available=[group.name for group in self.groups])

    def split(self, number: int) -> str:
        """The split of a motion."""
        group, index = self.place(number)
        return group.split or self._splits[group.name][index]

    @cached_property
    def _splits(self) -> Mapping[str, list[str]]:
        splits = {}
        for group in self.groups:
            parts = _parts(group.count, self.fractions)
            ordered = [split for split, count in parts.items() for _ in range(count)]
            order = _rng(self.seed, f"{group.name} split", 0).permutation(group.count)
            splits[group.name] = [ordered[place] for place in order]
        return splits

    def scene(self, robot: RobotSpec, *, model: Path | None = None) -> Scene:
        """The robot in the set's workspace; see `Scene` for errors.

        Raises:
            ConfigError: a group leads an end effector, and the model has none.
        """
        scene = Scene(
            robot,
            workspace=self.workspace,
            model=model,
            clearance_m=self.clearance_m,
            velocity=self.velocity_limits,
            acceleration=self.acceleration_limits,
        )
        if any(group.leads_end_effector for group in self.groups):
            scene.require_site()
        return scene

    def plan(self, scene: Scene, number: int) -> Plan:
        """One motion; the same arguments give the same plan.

        Raises:
            ConfigError: there is no such motion.
            NameMismatch: a joint of its group is not the robot's.
            NoPlan: none of the attempts led to a motion.
        """
        group, index = self.place(number)
        rng = _rng(self.seed, group.name, index)
        plan = _planned(self, group, index, scene, rng)
        return replace(
            plan,
            id=self.id(number),
            condition=group.name,
            split=self.split(number),
            seed=self.seed,
            index=index,
        )

    def to_dict(self) -> dict[str, Any]:
        """JSON types only."""
        tree = asdict(self)
        for group in tree["groups"]:
            for name in ("duration_s", "length_s"):
                if group[name] is None:  # sets were made before there were these ranges
                    del group[name]
        return tree


def paper_plans() -> PlanSetSpec:
    """The motions of Realeasy (section IV-B) and the LSTM thesis (section 5.7).

    850 of several joints and 870 of a single one at 20 to 100 % of the velocity limits, split 80/15/5 by whole motions,
    and 50 Cartesian lines for testing only.
    """
    groups = (
        MotionGroup("multi-joint", "joint", 850, moving="multi"),
        MotionGroup("single-joint", "joint", 870, moving="single"),
        MotionGroup("cartesian", "cartesian", 50, split="test"),
    )
    return PlanSetSpec("paper", groups, workspace=load_workspace("cell"))


def load_plans(name_or_path: str | Path) -> PlanSetSpec:
    """A description by the name of a shipped one (`paper`, `kickbot-splines`, ...), or from a YAML file.

    `workspace` in the file is a mapping, the name of a shipped workspace, or the path of a file beside it.

    Raises:
        ConfigError: there is none, or its content is wrong.
    """
    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml"):
        if str(name_or_path) == "paper":
            return paper_plans()
        shipped = {file.stem: file for file in sorted(_SHIPPED.glob("*.yaml"))}
        if str(name_or_path) not in shipped:
            raise ConfigError(
                f"there is no plan set {str(name_or_path)!r}",
                available=["paper", *shipped],
                hint="Give one of these names, a YAML file with `groups`, or a folder with a plans.json.",
            )
        path = shipped[str(name_or_path)]
    tree = read_yaml(path)
    workspace = tree.get("workspace")
    if isinstance(workspace, str):
        is_file = workspace.endswith((".yaml", ".yml"))
        loaded = load_workspace(path.parent / workspace if is_file else workspace)
        tree = {**tree, "workspace": asdict(loaded)}
    return build(PlanSetSpec, tree, str(path))


def _rng(seed: int, name: str, index: int) -> np.random.Generator:
    return np.random.default_rng([seed, zlib.crc32(name.encode()), index])


def _parts(count: int, fractions: Mapping[str, float]) -> dict[str, int]:
    """Whole numbers in the ratio of the fractions, by largest remainder."""
    exact = {split: count * share for split, share in fractions.items()}
    parts = {split: int(value + 1e-9) for split, value in exact.items()}
    by_rest = sorted(exact, key=lambda split: parts[split] - exact[split])
    for split in by_rest[: count - sum(parts.values())]:
        parts[split] += 1
    return parts


def _planned(spec: PlanSetSpec, group: MotionGroup, index: int, scene: Scene, rng: np.random.Generator) -> Plan:
    share = float(rng.uniform(*group.velocity_share))
    settings = spec.motion
    if group.kind == "cartesian":
        return random_line(scene, PLANES[index % len(PLANES)], rng, velocity_share=share, settings=settings)
    order = ORDERS[index % len(ORDERS)]
    if group.kind == "b-spline":
        return random_spline(
            scene,
            order,
            rng,
            velocity_share=share,
            sites=group.sites,
            control_points=group.control_points,
            extent_m=group.extent_m,
            from_home=group.from_home,
            settings=settings,
        )
    if group.kind == "animation":
        names = group.animations or tuple(spec.animations)
        speed, amplitude = float(rng.uniform(*group.speed)), float(rng.uniform(*group.amplitude))
        name = names[index % len(names)]
        plan = animated(scene, spec.animations[name], speed=speed, amplitude=amplitude, settings=settings)
        return replace(plan, details={"animation": name, **plan.details})
    moving = _moving(spec, group, index, scene, rng)
    if group.kind == "joint-b-spline":
        return random_joint_spline(
            scene,
            moving,
            order,
            rng,
            velocity_share=share,
            control_points=group.control_points,
            range_share=float(rng.uniform(*group.range_share)),
            pause_share=group.pause_share,
            span_s=group.span_s,
            from_home=group.from_home,
            settings=settings,
        )
    if group.kind in FUNCTIONS:
        return random_reference(
            scene,
            group.kind,
            moving,
            rng,
            velocity_share=share,
            reference=_reference(spec, group, rng),
            settings=settings,
        )
    return random_joint_motion(scene, moving, rng, velocity_share=share, settings=settings)


def _reference(spec: PlanSetSpec, group: MotionGroup, rng: np.random.Generator) -> ReferenceSettings:
    """The set's functions, with what the group draws for each motion."""

    def drawn(ends: tuple[float, float] | None, otherwise: float) -> float:
        return float(rng.uniform(*ends)) if ends else otherwise

    own = spec.reference
    return replace(
        own, duration_s=drawn(group.duration_s, own.duration_s), length_s=drawn(group.length_s, own.length_s)
    )


def _moving(
    spec: PlanSetSpec, group: MotionGroup, index: int, scene: Scene, rng: np.random.Generator
) -> tuple[str, ...]:
    joints = group.joints or scene.joints
    scene.limits.columns(joints)
    if group.moving == "all":
        return joints
    if group.moving == "single":
        return (joints[index % len(joints)],)
    if len(joints) < 2:
        raise ConfigError(f"group {group.name!r} moves several joints and may choose from {list(joints)}")
    if len(joints) > _ALL_SUBSETS:
        size = int(rng.integers(2, len(joints) + 1))
        return tuple(joints[row] for row in sorted(rng.choice(len(joints), size, replace=False)))
    subsets = [subset for size in range(2, len(joints) + 1) for subset in combinations(joints, size)]
    order = _rng(spec.seed, f"{group.name} joints", 0).permutation(len(subsets))
    return tuple(subsets[int(order[index % len(subsets)])])
