"""A robot.yaml from a model alone: joints, what drives them, gains where nobody states any, and the base."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco

from trueup.draft.gains import Gains, stable_gains
from trueup.errors import ConfigError
from trueup.robots import BaseSpec, ControllerSpec, JointGains, JointSpec, RobotSpec
from trueup.robots.coupling import Coupling
from trueup.robots.extent import root_tag
from trueup.robots.model import compile_spec, load_spec, lost_meshes
from trueup.robots.repair import unweighed
from trueup.robots.spec import CommandSignal
from trueup.sim.actuator_inputs import followed_signals

_MOVING = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
_OF_JOINTS = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
# Of several signals that an actuator may follow, the one that most logs have.
_SIGNALS: tuple[CommandSignal, ...] = ("position", "velocity", "torque")
# Names of files that say nothing about the robot.
_PLAIN_NAMES = ("scene", "robot", "model", "main", "assembly", "xml", "urdf")
# Windows in which a simulation that is driven by torques stays near the robot [s].
_WINDOW_S = 0.5
_MOST_NAMES = 6


@dataclass(frozen=True)
class RobotDraft:
    """A robot's description that a model suggests.

    Attributes:
        robot: the description; its model is the file's whole path.
        taken: what was taken from where, a line each.
        unsure: what nobody could know from the model, a line each.
        invented: whether the gains are nobody's: a fit has to find them.
    """

    robot: RobotSpec
    taken: tuple[str, ...]
    unsure: tuple[str, ...]
    invented: bool = False


def draft_robot(model: Path, *, signal: CommandSignal | None = None, joints: Sequence[str] = ()) -> RobotDraft:
    """The description of a robot that is known by its model.

    Joints are those that an actuator of the model drives; without actuators, all hinges and slides that do not follow
    another one. Commands go into the model's actuators if these follow them, else into a controller whose gains are
    `stable_gains`.

    Args:
        model: MJCF or URDF.
        signal: that logs command; what the model's actuators follow if None, and positions where it has none.
        joints: names of the joints that are wanted, in their order; those of the model if empty.

    Raises:
        ConfigError: MuJoCo cannot read the model, it has no joint that could be driven, or not those that are wanted.
    """
    return _Draft(model, signal, joints).draft()


class _Draft:
    """One model; see `draft_robot`."""

    def __init__(self, path: Path, signal: CommandSignal | None, joints: Sequence[str]) -> None:
        self._path, self._wanted = path, tuple(joints)
        self._spec = load_spec(path)
        self._model = compile_spec(self._spec.copy(), path)
        self._driven = self._followed()
        self._signal = signal or self._usual()
        self._taken: list[str] = []
        self._unsure: list[str] = []

    def draft(self) -> RobotDraft:
        names = self._names()
        follows = all(self._signal in self._driven.get(name, ()) for name in names)
        robot = RobotSpec(
            name=_robot_name(self._path, self._spec.modelname),
            joints=tuple(self._joint(name) for name in names),
            model=str(self._path.absolute()),
            controller=ControllerSpec(kind="model" if follows else "torque", command=self._signal if follows else ""),
            base=self._base(names),
        )
        if follows:
            self._taken.append(f"commands are a {self._signal}, which the model's actuators follow")
        elif self._signal != "torque":
            robot = self._with_gains(robot)
        else:
            self._taken.append("commands are a torque, which acts on the joints as it is")
        if self._signal == "torque":
            robot = replace(robot, replay=replace(robot.replay, window_s=_WINDOW_S))
        if lost := lost_meshes(self._path):
            self._unsure.append(lost)
        if root_tag(self._path) == "robot" and (bare := unweighed(self._path)):
            self._unsure.append(
                f"the file states no mass for {_listed(bare)}: what MuJoCo takes from shapes is a guess, as are gains "
                "and torques; write the masses into it"
            )
        invented = not follows and self._signal != "torque"
        return RobotDraft(robot, tuple(self._taken), tuple(self._unsure), invented)

    # What the model has.

    def _followed(self) -> dict[str, tuple[CommandSignal, ...]]:
        """Joint -> what its only actuator follows; nothing where it has several or one that follows nothing."""
        own = [actuator for actuator in self._spec.actuators if actuator.trntype in _OF_JOINTS]
        counts = Counter(actuator.target for actuator in own)
        return {actuator.target: followed_signals(actuator) if counts[actuator.target] == 1 else () for actuator in own}

    def _usual(self) -> CommandSignal:
        """What most of the model's actuators follow."""
        counts = Counter(next((one for one in _SIGNALS if one in own), "") for own in self._driven.values())
        counts.pop("", None)
        return max(_SIGNALS, key=lambda one: (counts[one], -_SIGNALS.index(one)))

    def _names(self) -> tuple[str, ...]:
        """The robot's joints, in the order of the model."""
        moving = [joint.name for joint in self._spec.joints if joint.type in _MOVING]
        if self._wanted:
            strangers = [name for name in self._wanted if name not in moving]
            if strangers:
                raise ConfigError(f"{self._path} has no hinge or slide {strangers}", available=moving)
            return self._wanted
        tied = Coupling(self._model, moving)
        followers = {
            self._model.joint(int(self._model.eq_obj1id[row])).name
            for row in range(self._model.neq)
            if int(self._model.eq_type[row]) == int(mujoco.mjtEq.mjEQ_JOINT) and self._model.eq_obj2id[row] >= 0
        }
        by_tendon = {
            tied.names[joint]
            for row, joints in enumerate(tied.drives)
            if int(self._model.actuator_trntype[row]) == int(mujoco.mjtTrn.mjTRN_TENDON)
            for joint in joints
        }
        if not moving:
            raise ConfigError(f"{self._path} has no joint that moves", expected="hinges or slides")
        driven = [name for name in moving if self._signal in self._driven.get(name, ())]
        other = [name for name in moving if name in self._driven and name not in driven]
        if driven:
            if other:
                self._unsure.append(f"{_listed(other)}: driven otherwise than by a {self._signal}, so left out")
            rest = [name for name in moving if name not in driven and name not in other]
            if rest:
                self._taken.append(f"{_listed(rest)}: no actuator of their own, so left out")
            self._taken.append(f"{len(driven)} joints have actuators: {_listed(driven)}")
            return tuple(driven)
        free = other or [name for name in moving if name not in followers and name not in by_tendon] or moving
        self._taken.append(f"{len(free)} joints: {_listed(free)}")
        return tuple(free)

    def _joint(self, name: str) -> JointSpec:
        row = self._model.joint(name).id
        limited = bool(self._model.jnt_limited[row])
        low, high = (_rounded(value) for value in self._model.jnt_range[row])
        return JointSpec(name, position_limits=(low, high) if limited and low < high else None)

    def _base(self, names: Sequence[str]) -> BaseSpec | None:
        tied = Coupling(self._model, names)
        bases = [row for row in tied.bases() if not tied.is_welded(row)]
        if not bases:
            return None
        keys = [self._model.key(row).name for row in range(self._model.nkey)]
        key = "home" if "home" in keys else next((one for one in keys if one), "")
        body = self._model.body(int(self._model.jnt_bodyid[bases[0]])).name
        if len(bases) > 1 or not key:
            self._unsure.append(f"the base ({body}) floats in the model: it is held where the model has it")
            return BaseSpec()
        self._unsure.append(f"the base ({body}) floats in the model: it is held where keyframe {key!r} has it")
        return BaseSpec(held=key)

    def _with_gains(self, robot: RobotSpec) -> RobotSpec:
        found = stable_gains(robot, self._spec.copy(), origin=self._path)
        if self._signal == "velocity":
            per_joint = {name: JointGains(kv=own.kv) for name, own in found.items()}
            controller = ControllerSpec(kind="velocity", per_joint=per_joint)
        else:
            per_joint = {name: JointGains(kp=own.kp, kv=own.kv) for name, own in found.items()}
            controller = ControllerSpec(kind="position", per_joint=per_joint)
        why = "its actuators follow something else" if self._driven else "it has no actuators"
        self._unsure.append(
            f"gains of {self._signal} servos are not in the model ({why}): they are invented from the mass matrix, "
            f"{_span(found)}"
        )
        return replace(robot, controller=controller)


def _span(found: Mapping[str, Gains]) -> str:
    kp = [own.kp for own in found.values()]
    return f"kp {min(kp):.3g} to {max(kp):.3g}"


def _robot_name(path: Path, said: str) -> str:
    """The file's name, or that of the model or the folder where it says nothing."""
    plain = ("MuJoCo Model", "")
    candidates = (path.stem, *(() if said in plain else (said,)), path.absolute().parent.name)
    return next((name for name in candidates if name.lower() not in _PLAIN_NAMES), path.stem)


def _rounded(value: float) -> float:
    return float(f"{value:.7g}")


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(names[:_MOST_NAMES])
    return shown + (f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else "")
