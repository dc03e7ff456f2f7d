"""What is held still in a simulated model: a base that floats, loose objects, and joints that robot.yaml does not name.

A joint is held by taking it out of the compiled model, with its pose in that of its body: nothing gives way, and what
is held costs no step. The editable model keeps all of it, so that a model that is written loads elsewhere as it came.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float64

from trueup.errors import ConfigError
from trueup.robots.coupling import Coupling
from trueup.robots.model import compile_spec
from trueup.robots.pose import Pose, move, turn, unit
from trueup.robots.spec import RobotSpec

_FREE, _BALL = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)
_SLIDE, _HINGE = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)
_JOINT, _TENDON = int(mujoco.mjtEq.mjEQ_JOINT), int(mujoco.mjtEq.mjEQ_TENDON)
_WIDTH = {_FREE: (7, 6), _BALL: (4, 3), _SLIDE: (1, 1), _HINGE: (1, 1)}
_HOME = "home"
_MOST_NAMES = 6


@dataclass(frozen=True, eq=False)
class _Body:
    """What changes of one body with joints: of its place, and of its joints by their number in it.

    Attributes:
        moved: its place, in that which it had; None where that stays.
        dropped: joints that are taken out.
        turned: how axis and anchor of a joint that stays are written in the body as it then is.
        starts: where a joint that stays is at first, its position in the model's own pose from now on [rad or m].
    """

    moved: Pose | None
    dropped: tuple[int, ...]
    turned: Mapping[int, Pose]
    starts: Mapping[int, float]


@dataclass(frozen=True, eq=False)
class Holding:
    """What is held in a robot's model, for copies of it that differ in numbers.

    Attributes:
        notes: what is held or swings, for people.
        swinging: joints that robot.yaml does not name, that stay, and that no named one leads.
        bodies: number of a body among those with joints -> what changes.
        gone: kind of element -> numbers of those that are taken out with the joints.
        forces: number of an actuator whose input is held -> its force: a constant, per position, per velocity.
        keys: of each keyframe, positions, velocities, activations and inputs of what is left.
    """

    notes: tuple[str, ...] = ()
    swinging: tuple[str, ...] = ()
    bodies: Mapping[int, _Body] = field(default_factory=dict)
    gone: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    forces: Mapping[int, tuple[float, float, float]] = field(default_factory=dict)
    keys: tuple[tuple[np.ndarray, ...], ...] = ()

    @staticmethod
    def of(spec: mujoco.MjSpec, robot: RobotSpec, *, origin: Path) -> Holding:
        """What a robot's description holds in a model.

        Args:
            spec: the model, with the robot's controller if it has one by now; it stays as it is.
            robot: its description.
            origin: of the model, for messages.

        Raises:
            ConfigError: the base floats and robot.yaml does not hold it, or it names joints or keyframes that the model
                does not have, or MuJoCo refuses the model.
        """
        asked = robot.base is not None or bool(robot.unlisted.pose or robot.unlisted.joints or robot.unlisted.keyframe)
        if not asked and {joint.name for joint in spec.joints} <= set(robot.joint_names):
            return Holding()
        return _Search(compile_spec(spec, origin), robot).holding()

    def applied(self, spec: mujoco.MjSpec) -> mujoco.MjSpec:
        """A copy of the model in which it is held; the model itself where there is nothing to hold."""
        if not (self.bodies or self.gone or self.forces):
            return spec
        held = spec.copy()
        jointed = [body for body in held.bodies if body.joints]
        lists = {kind: list(getattr(held, kind)) for kind in self.gone}
        for number, force in self.forces.items():
            # What an input adds all the time is a part of the force itself, for whoever steps the model.
            actuator = held.actuators[number]
            actuator.gainprm[0], actuator.biasprm[:3] = 0.0, force
            actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        for number, change in self.bodies.items():
            body = jointed[number]
            if change.moved is not None:
                move(held, body, change.moved)
            for row, joint in enumerate(list(body.joints)):
                if row in change.turned:
                    turn(held, joint, change.turned[row])
                if row in change.starts:
                    degrees = joint.compiler.degree and joint.type == mujoco.mjtJoint.mjJNT_HINGE
                    joint.ref = np.rad2deg(change.starts[row]) if degrees else change.starts[row]
                if row in change.dropped:
                    held.delete(joint)
        # Sensors and constraints before what they are about.
        for kind in ("tuples", "sensors", "equalities", "actuators", "tendons"):
            for number in self.gone.get(kind, ()):
                held.delete(lists[kind][number])
        for key, values in zip(held.keys, self.keys, strict=False):
            key.qpos, key.qvel, key.act, key.ctrl = values
        held.compiler.fusestatic = False  # bodies keep their names where they no longer move
        return held


def driven_inputs(spec: mujoco.MjSpec, robot: RobotSpec, *, origin: Path) -> dict[int, list[float]]:
    """Actuators of a model that `unlisted: drive` leaves in it: their numbers, and the input of each at each keyframe.

    Raises:
        ConfigError: MuJoCo refuses the model, or there are joints or keyframes that it does not have.
    """
    if "drive" not in (robot.unlisted.rule, *robot.unlisted.joints.values()):
        return {}
    model = compile_spec(spec, origin)
    return {
        row: model.key_ctrl[:, model.actuator_ctrladr[row]].tolist() for row in sorted(_Search(model, robot).driving)
    }


class _Search:
    """What becomes of each joint of a compiled model.

    Args:
        model: compiled.
        robot: the robot's description.
    """

    def __init__(self, model: mujoco.MjModel, robot: RobotSpec) -> None:
        self._model, self._robot = model, robot
        self._tied = Coupling(model, robot.joint_names)
        self._key = self._keyframe(robot.unlisted.keyframe)
        self._refuse_strangers()

    def holding(self) -> Holding:
        """See `Holding.of`."""
        bases = self._tied.bases()
        if self._robot.base is None:
            for row in bases:
                if not self._tied.is_welded(row):
                    raise self._floating(row)
        fates: dict[str, list[int]] = {"follow": [], "lock": [], "drive": [], "free": []}
        for row in range(len(self._tied.names)):
            if row not in self._tied.named and row not in bases:
                fates[self._fate(row)].append(row)
        held = bases if self._robot.base is not None else []
        dropped = {*held, *fates["lock"]}
        swinging = [*fates["drive"], *fates["free"]]
        gone = self._gone(dropped)
        return Holding(
            notes=tuple(self._notes(held, fates["lock"], fates["drive"], fates["free"])),
            swinging=tuple(self._label(row) for row in swinging),
            bodies=self._bodies(dropped, set(held), {row for row in swinging if self._starts_elsewhere(row)}),
            gone=gone,
            forces=self._forces(set(gone.get("actuators", ()))),
            keys=self._keys(dropped, set(gone.get("actuators", ()))),
        )

    @cached_property
    def driving(self) -> set[int]:
        """Actuators whose inputs are held at those of the keyframe: of joints that are not named and not locked."""
        found = set()
        for row, joints in enumerate(self._tied.drives):
            fates = {"named" if joint in self._tied.named else self._fate(joint) for joint in joints}
            rules = {self._robot.unlisted.rule_of(self._tied.names[joint]) for joint in joints}
            if "drive" in rules and fates <= {"drive", "free", "follow"}:
                found.add(row)
        return found

    def _floating(self, base: int) -> ConfigError:
        body = self._model.body(int(self._model.jnt_bodyid[base])).name
        return ConfigError(
            f"the base of robot {self._robot.name!r} floats: its joints hang on body {body!r}, which has a free joint, "
            "and nothing would carry it",
            hint="Write `base: held` into robot.yaml to hold it where the model has it, `base: {held: KEYFRAME}`, or "
            "`base: {position: [x, y, z], rotation: [w, x, y, z]}` (docs/robots.md); or take a model on a fixed base.",
        )

    def _fate(self, row: int) -> str:
        """`lock`, `drive` or `free`; `follow` of one that is coupled to a named one."""
        group = self._tied.groups[row]
        if group & self._tied.named:
            return "follow"
        rules = {self._robot.unlisted.rule_of(self._tied.names[other]) for other in group}
        moved = any(joints & group for joints in self._tied.drives)
        return "free" if "free" in rules else "drive" if "drive" in rules and moved else "lock"

    def _starts_elsewhere(self, row: int) -> bool:
        """Whether a joint that stays starts in another pose than the model's own, which is then moved there.

        Not where constraints and tendons are relative to that, and not balls, whose own pose is always 0.
        """
        model, position = self._model, self._position(row)
        first = int(model.jnt_qposadr[row])
        tied = any(row in joints for joints in (*self._tied.links, *self._tied.tendons))
        same = np.array_equal(position, model.qpos0[first : first + len(position)])
        return not (tied or same or int(model.jnt_type[row]) == _BALL)

    def _keyframe(self, name: str) -> int | None:
        names = [self._model.key(row).name for row in range(self._model.nkey)]
        if name:
            if name not in names:
                raise ConfigError(
                    f"robot {self._robot.name!r}: the model has no keyframe {name!r}", available=[n for n in names if n]
                )
            return names.index(name)
        if _HOME in names:
            return names.index(_HOME)
        return 0 if len(names) == 1 else None

    def _position(self, row: int) -> Float64[np.ndarray, "W"]:
        """Where a joint that is not named is."""
        model = self._model
        width, first = _WIDTH[int(model.jnt_type[row])][0], int(model.jnt_qposadr[row])
        stated = self._robot.unlisted.pose.get(self._tied.names[row])
        if stated is not None:
            return np.array([stated])
        whole = model.qpos0 if self._key is None else model.key_qpos[self._key]
        return np.array(whole[first : first + width])

    def _refuse_strangers(self) -> None:
        """Refuse rules and poses of joints that do not take them."""
        unlisted = self._robot.unlisted
        known = {name: row for row, name in enumerate(self._tied.names) if name and row not in self._tied.named}
        if strangers := [name for name in (*unlisted.pose, *unlisted.joints) if name not in known]:
            raise ConfigError(f"robot {self._robot.name!r}: unlisted: the model has no {strangers}", available=known)
        for name in unlisted.pose:
            row = known[name]
            if int(self._model.jnt_type[row]) not in (_HINGE, _SLIDE) or self._tied.groups[row] & self._tied.named:
                raise ConfigError(
                    f"robot {self._robot.name!r}: unlisted: the pose of {name!r} is not one number of its own",
                    expected="a hinge or slide that is not coupled to joints of the robot",
                )
        base = self._robot.base
        bases = self._tied.bases()
        if base is not None and len(bases) != 1 and (base.held is not True or base.position or base.rotation):
            raise ConfigError(
                f"robot {self._robot.name!r}: base: a pose is that of one floating base",
                got=f"{len(bases)} free joints that carry joints of the robot",
                hint="Write `base: held`, or give the bodies their poses in the model.",
            )

    # The changes.

    def _bodies(self, dropped: set[int], bases: set[int], starts: set[int]) -> dict[int, _Body]:
        model, found = self._model, dict[int, _Body]()
        jointed = np.flatnonzero(model.body_jntnum)
        for number, body in enumerate(jointed.tolist()):
            first = int(model.body_jntadr[body])
            rows = range(first, first + int(model.body_jntnum[body]))
            if not any(row in dropped or row in starts for row in rows):
                continue
            fixed: list[Pose] = []
            turned, begin = dict[int, Pose](), dict[int, float]()
            # From the last to the first: what is fixed behind a joint that stays is put in front of it.
            for row in reversed(rows):
                if row not in dropped and fixed and int(model.jnt_type[row]) != _FREE:
                    behind = reduce(Pose.__matmul__, fixed)
                    if not behind.is_none:
                        turned[row - first] = behind
                if row in bases:
                    fixed.insert(0, self._base_moved(row, body))
                elif row in dropped or row in starts:
                    position = self._position(row)
                    fixed.insert(0, self._moved(row, body, position))
                    if row not in dropped and int(model.jnt_type[row]) in (_HINGE, _SLIDE):
                        begin[row - first] = float(position[0])
            out = tuple(row - first for row in rows if row in dropped)
            moved = reduce(Pose.__matmul__, fixed)
            found[number] = _Body(None if moved.is_none else moved, out, turned, begin)
        return found

    def _moved(self, row: int, body: int, position: Float64[np.ndarray, "W"]) -> Pose:
        """What a joint adds to the pose of its body where it is."""
        model = self._model
        kind, anchor, axis = int(model.jnt_type[row]), model.jnt_pos[row], model.jnt_axis[row]
        first = int(model.jnt_qposadr[row])
        if np.array_equal(position, model.qpos0[first : first + len(position)]):
            return Pose()
        if kind == _FREE:
            return self._place(body).inverse() @ Pose(position[:3].copy(), unit(position[3:]))
        if kind == _SLIDE:
            return Pose(position=float(position[0] - model.qpos0[first]) * axis)
        if kind == _BALL:
            turned = unit(position)
        else:
            turned = np.empty(4)
            mujoco.mju_axisAngle2Quat(turned, axis, float(position[0] - model.qpos0[first]))
        about = Pose(position=np.array(anchor))
        return about @ Pose(rotation=turned) @ about.inverse()

    def _base_moved(self, row: int, body: int) -> Pose:
        base, model = self._robot.base, self._model
        assert base is not None
        place = self._place(body)
        pose = place
        if base.held is True and base.position is None and base.rotation is None:
            return Pose()
        if isinstance(base.held, str):
            first = int(model.jnt_qposadr[row])
            stated = model.key_qpos[self._keyframe(base.held) or 0, first : first + 7]
            pose = Pose(stated[:3].copy(), unit(stated[3:]))
        if base.position is not None:
            pose = replace(pose, position=np.array(base.position))
        if base.rotation is not None:
            pose = replace(pose, rotation=unit(np.array(base.rotation)))
        return place.inverse() @ pose

    def _place(self, body: int) -> Pose:
        return Pose(np.array(self._model.body_pos[body]), np.array(self._model.body_quat[body]))

    def _gone(self, dropped: set[int]) -> dict[str, tuple[int, ...]]:
        """Elements that are about joints that are taken out, or move nothing that is named or left to them."""
        model = self._model
        wrapped = model.wrap_type == int(mujoco.mjtWrap.mjWRAP_JOINT)
        tendons = {
            row
            for row, joints in enumerate(self._tied.tendons)
            if joints & dropped and (joints <= dropped or wrapped[int(model.tendon_adr[row])])
        }
        equalities = set()
        for row, joints in enumerate(self._tied.links):
            kind = int(model.eq_type[row])
            ends = {int(model.eq_obj1id[row]), int(model.eq_obj2id[row])}
            torn = (kind == _JOINT and joints & dropped) or (kind == _TENDON and ends & tendons)
            if torn or (joints and joints <= dropped):
                equalities.add(row)
        actuators = {
            row
            for row, joints in enumerate(self._tied.drives)
            if joints and not joints & self._tied.named and row not in self.driving
        }
        lost = {
            mujoco.mjtObj.mjOBJ_JOINT: dropped,
            mujoco.mjtObj.mjOBJ_TENDON: tendons,
            mujoco.mjtObj.mjOBJ_ACTUATOR: actuators,
            mujoco.mjtObj.mjOBJ_EQUALITY: equalities,
        }
        about = {(int(kind), number) for kind, numbers in lost.items() for number in numbers}
        sensors = [
            row
            for row in range(model.nsensor)
            if (int(model.sensor_objtype[row]), int(model.sensor_objid[row])) in about
        ]
        about |= {(int(mujoco.mjtObj.mjOBJ_SENSOR), row) for row in sensors}
        tuples = []
        for row in range(model.ntuple):
            own = range(int(model.tuple_adr[row]), int(model.tuple_adr[row] + model.tuple_size[row]))
            if any((int(model.tuple_objtype[item]), int(model.tuple_objid[item])) in about for item in own):
                tuples.append(row)
        every = {
            "tuples": tuples,
            "sensors": sensors,
            "equalities": sorted(equalities),
            "actuators": sorted(actuators),
            "tendons": sorted(tendons),
        }
        return {kind: tuple(rows) for kind, rows in every.items() if rows}

    def _forces(self, gone: set[int]) -> dict[int, tuple[float, float, float]]:
        model, found = self._model, dict[int, tuple[float, float, float]]()
        for row in sorted(self.driving - gone):
            name = model.actuator(row).name
            if self._key is None:
                raise ConfigError(
                    f"robot {self._robot.name!r}: unlisted: drive needs a keyframe, whose ctrl the actuators hold",
                    got=[model.key(key).name for key in range(model.nkey)] or "no keyframe in the model",
                    hint="Name one, `unlisted: {rule: drive, keyframe: NAME}`, or write `unlisted: lock`.",
                )
            affine = model.actuator_biastype[row] == mujoco.mjtBias.mjBIAS_AFFINE
            if (
                model.actuator_gaintype[row] != mujoco.mjtGain.mjGAIN_FIXED
                or not (affine or model.actuator_biastype[row] == mujoco.mjtBias.mjBIAS_NONE)
                or model.actuator_dyntype[row] != mujoco.mjtDyn.mjDYN_NONE
                or model.actuator_ctrlnum[row] != 1
            ):
                raise ConfigError(
                    f"robot {self._robot.name!r}: unlisted: actuator {name!r} cannot be held at one input",
                    expected="a fixed gain, an affine bias or none, and no state of its own",
                    hint="Lock its joint: `unlisted: {rule: drive, joints: {JOINT: lock}}`, or write `unlisted: lock`.",
                )
            low, high = model.actuator_ctrlrange[row] if model.actuator_ctrllimited[row] else (-np.inf, np.inf)
            given = float(np.clip(model.key_ctrl[self._key, model.actuator_ctrladr[row]], low, high))
            bias = model.actuator_biasprm[row, :3] if affine else np.zeros(3)
            constant = float(bias[0] + model.actuator_gainprm[row, 0] * given)
            found[row] = (constant, float(bias[1]), float(bias[2]))
        return found

    def _keys(self, dropped: set[int], actuators: set[int]) -> tuple[tuple[np.ndarray, ...], ...]:
        model = self._model
        keeps = [np.ones(size, bool) for size in (model.nq, model.nv, model.na, model.nu)]
        for row in dropped:
            for keep, first, width in zip(
                keeps, (model.jnt_qposadr[row], model.jnt_dofadr[row]), _WIDTH[int(model.jnt_type[row])], strict=False
            ):
                keep[first : first + width] = False
        for row in actuators:
            for keep, first, count in (
                (keeps[2], model.actuator_actadr[row], model.actuator_actnum[row]),
                (keeps[3], model.actuator_ctrladr[row], model.actuator_ctrlnum[row]),
            ):
                keep[first : first + count] = False
        whole = (model.key_qpos, model.key_qvel, model.key_act, model.key_ctrl)
        return tuple(
            tuple(values[key][keep] for values, keep in zip(whole, keeps, strict=True)) for key in range(model.nkey)
        )

    # What is said.

    def _notes(
        self, bases: Sequence[int], locked: Sequence[int], driven: Sequence[int], swinging: Sequence[int]
    ) -> Iterator[str]:
        base, model = self._robot.base, self._model
        if bases and base is not None:
            body = _listed(repr(model.body(int(model.jnt_bodyid[row])).name) for row in bases)
            where = f"at keyframe {base.held!r}" if isinstance(base.held, str) else "where the model has it"
            stated = [name for name in ("position", "rotation") if getattr(base, name) is not None]
            if stated:
                where = (
                    "in the pose of robot.yaml" if len(stated) == 2 else f"{where}, in the {stated[0]} of robot.yaml"
                )
            yield f"the base floats in the model and is held {where}: {body}"
        key = "" if self._key is None else model.key(self._key).name
        frame = f"keyframe {key!r}" if key else "the model's keyframe"
        pose = "in the model's own pose" if self._key is None else f"at {frame}"
        if self._robot.unlisted.pose:
            pose += " or as robot.yaml says"
        loose = [row for row in locked if int(model.jnt_type[row]) == _FREE]
        if loose:
            bodies = _listed(model.body(int(model.jnt_bodyid[row])).name for row in loose)
            yield f"bodies with a free joint that carry no joint of the robot are held {pose}: {bodies}"
        if joints := [row for row in locked if row not in loose]:
            yield (
                f"{_counted(joints)} of the model that robot.yaml does not name {_are(joints)} locked {pose}: "
                f"{self._listed(joints)}"
            )
        if driven:
            yield (
                f"{_counted(driven)} of the model that robot.yaml does not name {_are(driven)} driven by the model's "
                f"actuators, held at the inputs of {frame}: {self._listed(driven)}"
            )
        if swinging:
            yield (
                f"{_counted(swinging)} of the model that robot.yaml does not name {_are(swinging)} free to swing, as "
                f"unlisted says, and {'starts' if len(swinging) == 1 else 'start'} {pose}: {self._listed(swinging)}"
            )

    def _label(self, row: int) -> str:
        body = self._model.body(int(self._model.jnt_bodyid[row])).name
        return (
            self._tied.names[row] or f"the {'free ' if int(self._model.jnt_type[row]) == _FREE else ''}joint of {body}"
        )

    def _listed(self, rows: Iterable[int]) -> str:
        return _listed(self._label(row) for row in rows)


def _listed(names: Iterable[str]) -> str:
    every = list(names)
    more = f" and {len(every) - _MOST_NAMES} more" if len(every) > _MOST_NAMES else ""
    return ", ".join(every[:_MOST_NAMES]) + more


def _counted(rows: Sequence[int]) -> str:
    return f"{len(rows)} joint{'' if len(rows) == 1 else 's'}"


def _are(rows: Sequence[int]) -> str:
    return "is" if len(rows) == 1 else "are"
