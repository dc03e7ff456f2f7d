"""A robot among obstacles: distances, edges and end-effector poses, computed by MuJoCo's geometry."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Float64, Int

from trueup.errors import ConfigError, NoPlan
from trueup.record.limits import JointLimits, limits_of
from trueup.record.urdf import urdf_velocity_limits
from trueup.record.workspace import Workspace
from trueup.robots import RobotSpec, find_model

if TYPE_CHECKING:
    import mujoco

# Distances are known up to here [m]: farther makes MuJoCo look at more pairs, nearer makes steps along edges shorter.
_HORIZON_M = 0.10
# Along an edge, contact is never looked for more finely than this [m].
_LEAST_STEP_M = 1e-3
# At home, links may overlap by so much, and stand so deep in the floor; and so many joints apart are neighbours.
_OVERLAP_M, _STANDS_M, _NEIGHBOURS = 0.01, 0.005, 2
# Names of the geoms that the workspace adds begin so.
_WORKSPACE = "workspace/"


class Scene:
    """A robot's model with a workspace around it.

    Nothing moves here and nothing is integrated: a pose goes in, distances and poses come out. Not for use by
    several threads at once.

    Attributes:
        robot: the robot.
        joints: names of its J joints.
        length_units: `rad` or `m` for each of them, (J,).
        limits: what they can do.
        clearance_m: what planning keeps between things that must not touch [m].
        home: a pose to go back to, (J,); the model's keyframe `home`, else the middle of the ranges.
        site: name of the end-effector's site; empty if the model has none.

    Args:
        robot: the robot.
        workspace: floor and boxes; what stands in the model itself counts anyway.
        model: MJCF or URDF; the robot's own if not given.
        clearance_m: what planning keeps between things that must not touch [m], >= 0.
        site: site of the end effector; `end_effector`, or the only site, if not given.
        velocity: joint -> largest speed, where the model has none or another one; a URDF has them.
        acceleration: joint -> largest acceleration, where the model has none; a URDF never has any.

    Raises:
        ConfigError: the model cannot be read (its meshes must be there, since they collide), has joints other than
            hinges and slides, or lacks limits.
        NameMismatch: a joint is not in the model.
    """

    def __init__(
        self,
        robot: RobotSpec,
        *,
        workspace: Workspace | None = None,
        model: Path | None = None,
        clearance_m: float = 0.01,
        site: str = "",
        velocity: Mapping[str, float] | None = None,
        acceleration: Mapping[str, float] | None = None,
    ) -> None:
        import mujoco  # loaded when planning begins: what executes plans needs no engine

        if not 0 <= clearance_m < _HORIZON_M:
            raise ConfigError("clearance_m cannot be kept", got=clearance_m, expected=f"0 to {_HORIZON_M}")
        path = find_model(robot, given=model)
        self._mujoco = mujoco
        self._model = _compile(path, robot, workspace or Workspace(floor_m=None))
        self._data = mujoco.MjData(self._model)
        self.robot = robot
        self.joints = robot.joint_names
        speeds = {**_own(urdf_velocity_limits(path), robot), **(velocity or {})}
        self.limits: JointLimits = limits_of(robot, self._model, velocity=speeds, acceleration=acceleration)
        self.clearance_m = clearance_m
        numbers = [self._model.joint(name).id for name in self.joints]
        slide = int(mujoco.mjtJoint.mjJNT_SLIDE)
        hinges = [int(mujoco.mjtJoint.mjJNT_HINGE), slide]
        if not np.isin(self._model.jnt_type, hinges).all():
            raise ConfigError(
                f"{path} has joints other than hinges and slides",
                hint="Balls and bodies that move freely are not planned.",
            )
        self.length_units = tuple("m" if self._model.jnt_type[number] == slide else "rad" for number in numbers)
        self._addresses = self._model.jnt_qposadr[numbers]
        self._reach = np.array([_reach(self._model, number) for number in numbers])
        keys = [self._model.key(row).name for row in range(self._model.nkey)]
        if "home" in keys:
            self._rest_pose = self._model.key("home").qpos.copy()
            self.home: Float64[np.ndarray, "J"] = self._rest_pose[self._addresses]
        else:
            self._rest_pose = self._model.qpos0.copy()
            self.home = (self.limits.low + self.limits.high) / 2
        self._data.qpos[:] = self._rest_pose
        self._at_rest: frozenset[tuple[int, int]] = frozenset()
        self._at_rest = self._touching_at_rest()
        self.site = _site(self._model, site, path)

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled model, obstacles included; for kinematics, with margins on its geoms."""
        return self._model

    @property
    def qpos_columns(self) -> Any:
        """Where the J joints stand in the model's qpos, (J,)."""
        return self._addresses

    def qpos(self, position: Float[np.ndarray, "J"]) -> Float64[np.ndarray, "Q"]:
        """The model's qpos in this pose; joints that are not the robot's stay where the model has them."""
        full: Float64[np.ndarray, "Q"] = self._rest_pose.copy()
        full[self._addresses] = position
        return full

    def _place(self, position: Float[np.ndarray, "J"]) -> None:
        data = self._data
        data.qpos[self._addresses] = position
        self._mujoco.mj_kinematics(self._model, data)
        self._mujoco.mj_comPos(self._model, data)
        self._mujoco.mj_collision(self._model, data)

    def _near(self, position: Float[np.ndarray, "J"]) -> tuple[Float64[np.ndarray, "C"], Int[np.ndarray, "C 2"]]:
        """Distances and geoms of the pairs that are near each other and must not touch."""
        self._place(position)
        contact = self._data.contact
        distances, pairs = contact.dist, contact.geom
        if self._at_rest and distances.size:
            counted = [tuple(sorted(pair)) not in self._at_rest for pair in pairs.tolist()]
            distances, pairs = distances[counted], pairs[counted]
        return distances, pairs

    def _touching_at_rest(self) -> frozenset[tuple[int, int]]:
        """Pairs of geoms that are near each other at home because they are made so.

        These are a first link and the base that carries it, which MuJoCo leaves out where the base moves only; other
        links at most two joints apart; neighbours that overlap a little, such as fingers; and what stands on the floor.
        """
        model = self._model
        distances, pairs = self._near(self.home)
        found = set()
        for distance, (one, other) in zip(distances, np.sort(pairs, axis=1).tolist(), strict=True):
            if distance > self.clearance_m:
                continue
            bodies = [int(model.body_weldid[model.geom_bodyid[geom]]) for geom in (one, other)]
            if any(self._is_placed(geom) for geom in (one, other)):
                made = distance > -_STANDS_M
            else:
                made = distance > -_OVERLAP_M or _joints_between(model, *bodies) <= _NEIGHBOURS
            if made:
                found.add((one, other))
        return frozenset(found)

    def _is_placed(self, geom: int) -> bool:
        return str(self._model.geom(geom).name).startswith(_WORKSPACE)

    @property
    def in_workspace(self) -> str:
        """What of the robot is in the floor or a box at home, and what it is in; empty if nothing is."""
        distances, pairs = self._near(self.home)
        inside = [
            (float(distance), pair)
            for distance, pair in zip(distances, pairs.tolist(), strict=True)
            if distance <= 0.0 and any(map(self._is_placed, pair))
        ]
        return " and ".join(map(self._thing, min(inside)[1])) if inside else ""

    def distance_m(self, position: Float[np.ndarray, "J"]) -> float:
        """The smallest distance between things that must not touch [m], negative in contact.

        Distances beyond 0.1 m are not looked for; they count as 0.1 m.
        """
        distances, _ = self._near(position)
        return float(min(_HORIZON_M, distances.min(initial=_HORIZON_M)))

    def free(self, position: Float[np.ndarray, "J"]) -> bool:
        """Whether the clearance is kept in this pose."""
        return self.distance_m(position) > self.clearance_m

    def touching(self, position: Float[np.ndarray, "J"]) -> str:
        """The two things that are nearest to one another, in words; for messages."""
        distances, pairs = self._near(position)
        if not distances.size:
            return "nothing"
        return " and ".join(self._thing(int(geom)) for geom in pairs[int(np.argmin(distances))])

    def _thing(self, geom: int) -> str:
        name = self._model.geom(geom).name
        return str(name or self._model.body(self._model.geom_bodyid[geom]).name)

    def require_free(self, position: Float64[np.ndarray, "J"], what: str) -> None:
        """Refuse a pose that is out of limits or in collision.

        Raises:
            ConfigError: out of limits.
            NoPlan: in collision, or nearer than the clearance.
        """
        self.limits.require_inside(position, what)
        if not self.free(position):
            raise NoPlan(
                f"{what} is in collision",
                got=f"{self.touching(position)} {1000 * self.distance_m(position):.0f} mm apart",
                expected=f"more than {1000 * self.clearance_m:.0f} mm",
                hint="Choose another pose, or correct the workspace.",
            )

    def edge_free(self, start: Float64[np.ndarray, "J"], goal: Float64[np.ndarray, "J"]) -> bool:
        """Whether the clearance is kept on the straight line in joint space between two poses.

        Steps are as long as the distance allows: between two poses no point of the robot moves, relative to another,
        farther than the sum over joints of its reach times the change of the joint. So nothing is missed in between.
        """
        travel = float(np.abs(goal - start) @ self._reach)
        done = 0.0
        while done < travel:
            room = self.distance_m(start + done / travel * (goal - start)) - self.clearance_m
            if room <= 0:
                return False
            done += max(room, _LEAST_STEP_M)
        return self.free(goal)

    def first_collision(self, positions: Float64[np.ndarray, "T J"], *, clearance_m: float = 0.0) -> int | None:
        """The first of T successive poses in which something is nearer than `clearance_m`; None if there is none.

        Poses that the distance at an earlier one proves free are not computed; see `edge_free`.
        """
        steps = np.abs(np.diff(positions, axis=0)) @ self._reach
        travelled = np.concatenate([[0.0], np.cumsum(steps)])
        row = 0
        while row < len(positions):
            room = self.distance_m(positions[row]) - clearance_m
            if room <= 0:
                return row
            row = max(row + 1, int(np.searchsorted(travelled, travelled[row] + room)))
        return None

    def pose(self, position: Float[np.ndarray, "J"]) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3 3"]]:
        """Position [m] and rotation of the end effector's site in the world.

        Raises:
            ConfigError: the model has no such site.
        """
        self.require_site()
        self._data.qpos[self._addresses] = position
        self._mujoco.mj_kinematics(self._model, self._data)
        site = self._data.site(self.site)
        return site.xpos.copy(), site.xmat.reshape(3, 3).copy()

    def require_site(self) -> None:
        """Refuse Cartesian work without an end effector.

        Raises:
            ConfigError: the model has no site that could be one.
        """
        if not self.site:
            raise ConfigError(
                f"the model of robot {self.robot.name!r} has no site for the end effector",
                available=[self._model.site(row).name for row in range(self._model.nsite)],
                hint="Add <site name='end_effector'/> to the model, or name one of its sites.",
            )


def _own(limits: Mapping[str, float], robot: RobotSpec) -> dict[str, float]:
    return {name: limit for name, limit in limits.items() if name in robot.joint_names}


def _compile(path: Path, robot: RobotSpec, workspace: Workspace) -> mujoco.MjModel:
    import mujoco

    from trueup.robots.holding import Holding
    from trueup.robots.model import compile_spec, load_whole_spec

    spec = load_whole_spec(path)
    for geom in spec.geoms:
        geom.margin = 0.0
    _furnish(spec, workspace)
    model = compile_spec(Holding.of(spec, robot, origin=path).applied(spec), path)
    # Contacts are wanted whatever the model says, from a distance on: the margins of two geoms add up.
    model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    model.geom_margin[:] = _HORIZON_M / 2
    model.pair_margin[:] = _HORIZON_M
    return model


def _furnish(spec: mujoco.MjSpec, workspace: Workspace) -> None:
    import mujoco

    if workspace.floor_m is not None:
        floor = spec.worldbody.add_geom()
        floor.name, floor.type = f"{_WORKSPACE}floor", mujoco.mjtGeom.mjGEOM_PLANE
        floor.size, floor.pos = [0.0, 0.0, 1.0], [0.0, 0.0, workspace.floor_m]
        floor.contype = floor.conaffinity = 1
    for box in workspace.boxes:
        geom = spec.worldbody.add_geom()
        geom.name, geom.type = f"{_WORKSPACE}{box.name}", mujoco.mjtGeom.mjGEOM_BOX
        geom.size, geom.pos = [length / 2 for length in box.size_m], list(box.center_m)
        geom.quat = [np.cos(box.yaw_rad / 2), 0.0, 0.0, np.sin(box.yaw_rad / 2)]
        geom.contype = geom.conaffinity = 1


def _joints_between(model: mujoco.MjModel, one: int, other: int) -> int:
    """Moving bodies on the way from one body to another through the tree."""

    def above(body: int) -> list[int]:
        chain = [int(model.body_weldid[body])]
        while chain[-1]:
            chain.append(int(model.body_weldid[model.body_parentid[chain[-1]]]))
        return chain

    chains = above(one), above(other)
    shared = set(chains[0]) & set(chains[1])
    return sum(body not in shared for chain in chains for body in chain)


def _reach(model: mujoco.MjModel, joint: int) -> float:
    """How far any point of a geom can move for each unit of a joint: 1 for a slide, else the largest lever arm."""
    import mujoco

    if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE:
        return 1.0
    root = int(model.jnt_bodyid[joint])
    # Distance of each body's origin from that of the joint's body, whatever the pose: offsets add up along the chain.
    far = {root: float(np.linalg.norm(model.jnt_pos[joint]))}
    for body in range(root + 1, model.nbody):
        parent = int(model.body_parentid[body])
        if parent in far:
            far[body] = far[parent] + float(np.linalg.norm(model.body_pos[body])) + _slide(model, body)
    levers = [
        far[body] + float(np.linalg.norm(model.geom_pos[geom]) + model.geom_rbound[geom])
        for geom, body in enumerate(model.geom_bodyid.tolist())
        if body in far
    ]
    return max(levers, default=0.0)


def _slide(model: mujoco.MjModel, body: int) -> float:
    """What joints between a body and its parent add to the distance of their origins."""
    import mujoco

    first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    total = 0.0
    for joint in range(first, first + count):
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE:
            total += float(np.abs(model.jnt_range[joint]).max())
        else:
            total += 2 * float(np.linalg.norm(model.jnt_pos[joint]))
    return total


def _site(model: mujoco.MjModel, wanted: str, path: Path) -> str:
    names = [model.site(row).name for row in range(model.nsite)]
    if wanted:
        if wanted not in names:
            raise ConfigError(f"{path} has no site {wanted!r}", available=names)
        return wanted
    if "end_effector" in names:
        return "end_effector"
    return str(names[0]) if len(names) == 1 else ""
