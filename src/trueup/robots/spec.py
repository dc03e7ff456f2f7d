"""What trueup must know of a robot beyond its MJCF or URDF: `robot.yaml`."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import numpy as np

from trueup.core.atomic import is_inside, where_missing
from trueup.core.config import build, read_yaml
from trueup.errors import ConfigError
from trueup.robots.friction import JointFriction
from trueup.robots.known import GRIPPERS, NAMESAKES, where_model_is

ControllerKind = Literal["model", "position", "pd", "pid", "servo", "torque", "velocity", "velocity-integrator"]
CommandSignal = Literal["position", "velocity", "torque"]
CommandTiming = Literal["held", "linear", "smooth"]

# The signal of the command series that each controller follows.
COMMAND_SIGNAL: Mapping[str, CommandSignal] = {
    "position": "position",
    "pd": "position",
    "pid": "position",
    "servo": "position",
    "torque": "torque",
    "velocity": "velocity",
    "velocity-integrator": "velocity",
}


# No robot waits longer for its motion, and no command arrives later [s].
_LONGEST_S = 3600.0


@dataclass(frozen=True)
class CommandSpec:
    """How logs speak of the commands of a joint, where they speak of its measurement otherwise.

    What is not given is as it is for the measurement.

    Attributes:
        log: name of the joint in the commands.
        sign: as in `JointSpec`, of the commands alone; likewise the others.
        scale: see `sign`.
        offset: see `sign`.
        log_unit: see `sign`.
    """

    log: str | None = None
    sign: Literal[1, -1] | None = None
    scale: float | None = None
    offset: float | None = None
    log_unit: str | None = None

    @property
    def given(self) -> dict[str, Any]:
        """What differs from the measurement."""
        return {key: value for key, value in asdict(self).items() if value is not None}


@dataclass(frozen=True)
class ClockSpec:
    """What is wrong with the stamps of logs.

    Attributes:
        scale: seconds per second of the stamps, e.g. 0.001 where milliseconds were taken for seconds.
        command_shift_s: added to the stamps of the commands [s]; for two computers whose clocks differ by a constant.

    Raises:
        ConfigError: a clock that does not run forwards.
    """

    scale: float = 1.0
    command_shift_s: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a clock that stands or runs backwards."""
        if not (0 < self.scale < float("inf") and abs(self.command_shift_s) < float("inf")):
            raise ConfigError("clock", got=asdict(self), expected="scale > 0, and a finite shift")


@dataclass(frozen=True)
class JointSpec:
    """One joint: its name in the model, and how logs speak of it.

    Attributes:
        name: joint name in the MJCF or URDF.
        log: name in the logs; empty when it is the same.
        sign: +1 or -1.
        scale: model value per log value, after conversion to SI.
        offset: model value at log value 0 [rad or m].
        log_unit: unit of the position in the logs where the log does not say or says wrongly, e.g. `1` for a
            gripper in 0..1 of its range.
        position_limits: range [rad or m] that the quality checks hold the log against; not checked if absent.
        torque_limit: largest torque [Nm or N]; limits the controller and the quality checks.
        torque_constant_nm_a: torque of the joint per current of its motor, gear included [Nm/A, of a slide N/A]; that
            of `motor` if absent.
        command: what differs in the logs' commands of this joint.
    """

    name: str
    log: str = ""
    sign: Literal[1, -1] = 1
    scale: float = 1.0
    offset: float = 0.0
    log_unit: str | None = None
    position_limits: tuple[float, float] | None = None
    torque_limit: float | None = None
    command: CommandSpec | None = None
    torque_constant_nm_a: float | None = None

    def __post_init__(self) -> None:
        """Refuse a motor that does nothing."""
        if self.torque_constant_nm_a is not None and not 0 < self.torque_constant_nm_a < float("inf"):
            raise ConfigError(
                f"torque_constant_nm_a of joint {self.name!r}", got=self.torque_constant_nm_a, expected="above 0"
            )


@dataclass(frozen=True)
class MotorSpec:
    """A brushed DC motor behind a gear, as its output shaft feels it; all joints have the same.

    With V the voltage at the motor and w the velocity of the shaft, the current is i = (V - back_emf w) / resistance,
    and the torque torque_constant i. The inductance is left out: its time constant is below a millisecond.

    Attributes:
        resistance_ohm: of the winding [ohm].
        torque_constant_nm_a: torque of the shaft per current, what the gear loses taken off [Nm/A].
        back_emf_v_s_rad: voltage per velocity of the shaft [V s/rad].
        voltage_v: largest voltage in both directions [V].

    Raises:
        ConfigError: a number that makes no motor.
    """

    resistance_ohm: float
    torque_constant_nm_a: float
    back_emf_v_s_rad: float
    voltage_v: float

    def __post_init__(self) -> None:
        """Refuse what turns nothing."""
        for name, value in asdict(self).items():
            if not 0 < value < float("inf"):
                raise ConfigError(f"motor: {name}", got=value, expected="a positive number")

    @property
    def torque_per_volt(self) -> float:
        """Of a shaft at rest [Nm/V]."""
        return self.torque_constant_nm_a / self.resistance_ohm


# The gain without which a controller does nothing.
_NEEDED_GAIN: Mapping[str, Literal["kp", "kv"]] = {
    "position": "kp",
    "pd": "kp",
    "pid": "kp",
    "servo": "kp",
    "velocity": "kv",
    "velocity-integrator": "kp",
}


@dataclass(frozen=True)
class JointGains:
    """Gains and delay of one joint; what is not given is the controller's common value.

    Attributes:
        kp: position gain [Nm/rad].
        kv: velocity gain [Nm s/rad].
        ki: integral gain [Nm/(rad s)].
        delay_s: commands of this joint act this much later [s].
    """

    kp: float | None = None
    kv: float | None = None
    ki: float | None = None
    delay_s: float | None = None


@dataclass(frozen=True)
class ControllerSpec:
    """How commands become joint torques; gains per joint name override the common ones.

    Attributes:
        kind: `model` uses the actuators of the MJCF as they are; `position` is a servo with gain kp and damping
            kv on the measured velocity; `pd` follows position and, if the command has it, velocity (GapONet
            eq. 10); `pid` is an effort controller with integral, whose derivative acts on the measured velocity
            (no kick when the command jumps); `servo` is the same PID with a voltage in place of a torque, which goes
            into the robot's `motor`; `torque` passes torque through; `velocity` is a velocity servo;
            `velocity-integrator` integrates the velocity into a position target.
        command: signal of the command that is followed; needed for `model` only.
        kp: position gain [Nm/rad; a `servo`'s V/rad]; higher is stiffer, too high for the time step is unstable.
        kv: velocity gain [Nm s/rad; a `servo`'s V s/rad]; higher damps more.
        ki: integral gain [Nm/(rad s); a `servo`'s V/(rad s)], `pid` and `servo` only.
        integral_limit: largest torque of the integral [Nm; a `servo`'s V], `pid` and `servo` only.
        delay_s: the command acts this much later [s], >= 0.
        source: of the torques that are followed: what was `commanded`, or what the drives `measured`. The second is for
            logs whose commanded torque is a plan, to which a controller inside the robot added what nobody recorded.
        per_joint: joint name -> gains and delay of a joint that differs.
        kp_setting: of the drives' position gain, in the unit of their firmware, at which kp (that of the model's
            actuators with `model`) holds: a motion that was recorded at another setting is simulated with kp in
            proportion.

    Raises:
        ConfigError: `model` without `command`, or another kind with a command that it does not follow; a `kp_setting`
            that is none, or where there is no kp.
    """

    kind: ControllerKind = "model"
    command: Literal["position", "velocity", "torque", ""] = ""
    kp: float = 0.0
    kv: float = 0.0
    ki: float = 0.0
    integral_limit: float | None = None
    delay_s: float = 0.0
    source: Literal["commanded", "measured"] = "commanded"
    per_joint: Mapping[str, JointGains] = field(default_factory=dict)
    kp_setting: float | None = None

    def __post_init__(self) -> None:
        """Refuse a controller that would silently do something else."""
        if self.kind == "model" and not self.command:
            raise ConfigError(
                "controller kind 'model' needs to know what it is told",
                expected="command: position, velocity or torque",
                hint="Name the signal of the logs that goes into the model's actuators.",
            )
        if self.kind != "model" and self.command not in ("", COMMAND_SIGNAL[self.kind]):
            raise ConfigError(f"controller kind {self.kind!r} follows {COMMAND_SIGNAL[self.kind]}", got=self.command)
        if self.source == "measured" and self.signal != "torque":
            raise ConfigError(
                f"controller kind {self.kind!r} follows a {self.signal}, which is what simulations are to find out",
                expected="source: commanded",
                hint="Only a torque can be followed as it was measured.",
            )
        if self.kp_setting is None:
            return
        if not 0 < self.kp_setting < float("inf"):
            raise ConfigError("controller: kp_setting", got=self.kp_setting, expected="a finite number above 0")
        if self.signal == "torque" or self.kind == "velocity":
            raise ConfigError(
                f"controller: a {self.signal} that is commanded goes around the position gain of a drive",
                got=f"kp_setting: {self.kp_setting:g}",
                hint="Leave kp_setting out of robot.yaml; what motions say of it is ignored then.",
            )

    def gain(self, name: Literal["kp", "kv", "ki", "delay_s"], joint: str) -> float:
        """The gain (or delay) of one joint."""
        own = getattr(self.per_joint[joint], name) if joint in self.per_joint else None
        return float(getattr(self, name) if own is None else own)

    @property
    def signal(self) -> CommandSignal:
        """The signal of the command series that is followed."""
        return self.command or COMMAND_SIGNAL[self.kind]

    @property
    def has_kp(self) -> bool:
        """Whether commands pass a position gain."""
        return self.signal == "position" or self.kind == "velocity-integrator" or self.kp_setting is not None


@dataclass(frozen=True)
class SimulationSpec:
    """How the engine is run.

    Attributes:
        timestep_s: physics step [s]; None takes the model's.
        contacts: whether bodies collide; an arm in free space is faster and calmer without.
        gravity_compensation: whether the weight of every body is carried by something that the model leaves out,
            such as the robot's own controller (Franka's does so in torque control).
        load: also say what each joint gives on to the parts that it moves (SAT, IV-A): the torque of its actuators
            without what friction and the motor's own inertia take.
        bodies: those whose pose, velocity and wrench are also said.
        base_sensor: the body that the robot stands on, if an inertial sensor is on it: what the logs have of its
            `body.specific_force` takes the place of gravity. A base at rest if empty.

    Raises:
        ConfigError: what a moving base leaves wrong is asked for.
    """

    timestep_s: float | None = None
    contacts: bool = False
    gravity_compensation: bool = False
    load: bool = False
    bodies: tuple[str, ...] = ()
    base_sensor: str = ""

    def __post_init__(self) -> None:
        """Refuse wrenches in the axes of a base that moves."""
        if self.base_sensor and (self.load or self.bodies):
            raise ConfigError(
                "simulation: loads and bodies are said of robots on a base at rest",
                got=f"base_sensor: {self.base_sensor}",
                hint="Leave base_sensor out, or load and bodies.",
            )


@dataclass(frozen=True)
class PayloadSpec:
    """What a robot carries when a log says that it carries something; how much is the log's `payload_kg`.

    Attributes:
        sites: of the model; at each hangs the whole payload.
        offset_m: from a site to the payload's center of mass, along the site's z axis [m].
        radius_m: it is a ball of this radius [m].
    """

    sites: tuple[str, ...]
    offset_m: float = 0.05
    radius_m: float = 0.04

    def __post_init__(self) -> None:
        """Refuse what hangs nowhere."""
        if not self.sites or len(set(self.sites)) != len(self.sites):
            raise ConfigError("payload: sites must be there and differ", got=list(self.sites))
        if not (0 < self.radius_m < np.inf and np.isfinite(self.offset_m)):
            raise ConfigError(
                "payload: no ball", got=f"radius {self.radius_m} m, offset {self.offset_m} m", expected="radius > 0"
            )


@dataclass(frozen=True)
class BaseSpec:
    """Where a base that floats in the model is held; in YAML also as one word, `base: held`.

    Attributes:
        held: where the model has the base, or a keyframe of the model that says where.
        position: of its body in the world [m], in place of that.
        rotation: of its body in the world as a quaternion w, x, y, z of any length, in place of that.

    Raises:
        ConfigError: a base that is not held, or a rotation that is none.
    """

    held: bool | str = True
    position: tuple[float, float, float] | None = None
    rotation: tuple[float, float, float, float] | None = None

    def __post_init__(self) -> None:
        """Refuse what would fall."""
        if not self.held:
            raise ConfigError(
                "base: it is held, or left out of robot.yaml for a model whose base is fixed",
                got=f"held: {self.held}",
                expected="held: true, or the name of a keyframe",
            )
        if self.rotation is not None and not 0 < float(np.linalg.norm(self.rotation)) < np.inf:
            raise ConfigError("base: rotation is no quaternion", got=list(self.rotation), expected="w, x, y, z")

    @staticmethod
    def of_word(word: str) -> dict[str, Any]:
        """What one word stands for in YAML."""
        if word != "held":
            raise ConfigError("base", got=repr(word), expected="held, or {held: KEYFRAME}, {position: [x, y, z], ...}")
        return {}

    def to_plain(self) -> str | dict[str, Any]:
        """As in YAML, JSON types only."""
        stated = {key: list(value) for key in ("position", "rotation") if (value := getattr(self, key)) is not None}
        return "held" if self.held is True and not stated else {"held": self.held, **stated}


UnlistedRule = Literal["lock", "drive", "free"]


@dataclass(frozen=True)
class UnlistedSpec:
    """What becomes of joints of the model that robot.yaml does not name; in YAML also as one word, the rule.

    Joints that equality constraints or tendons couple to named ones stay, whatever the rule: they follow those.

    Attributes:
        rule: `lock` takes them out of the simulated model, at their pose; `drive` leaves those that have actuators to
            these, whose inputs are held at those of the keyframe, and locks the others; `free` lets them swing, without
            actuators.
        keyframe: of the model, where they are; the one called `home`, or the only one, if empty, and the model's own
            pose where there is none.
        pose: joint -> position [rad or m], in place of that.
        joints: joint -> rule of a joint that differs.
    """

    rule: UnlistedRule = "lock"
    keyframe: str = ""
    pose: Mapping[str, float] = field(default_factory=dict)
    joints: Mapping[str, UnlistedRule] = field(default_factory=dict)

    @staticmethod
    def of_word(word: str) -> dict[str, Any]:
        """What one word stands for in YAML."""
        return {"rule": word}

    def rule_of(self, joint: str) -> UnlistedRule:
        """That of one joint."""
        return self.joints.get(joint, self.rule)

    def to_plain(self) -> str | dict[str, Any]:
        """As in YAML, JSON types only."""
        tree = {key: value for key, value in asdict(self).items() if value}
        return self.rule if list(tree) == ["rule"] else tree


@dataclass(frozen=True)
class ReplaySpec:
    """How logs are replayed.

    Attributes:
        window_s: restart from the measured state this often [s]; None replays whole motions. Torque-driven and
            chaotic systems need short windows (0.2 to 0.5 s): their open-loop error says nothing after that.
        initial_velocity: start with `zero` velocity (a robot at rest) or the `measured` one; if not given, windows
            start with the measured one and whole motions with zero.
        settle_s: hold the first command for this long before a whole motion begins [s]. A robot that waited for its
            motion hangs in its controller; a simulation that is put into its pose first sags. Windows begin in the
            middle and need none.
        command: what acts between two stamps of the command: the last one is `held`, or it moves on to the next,
            `linear`ly or as a `smooth` (cubic) curve. The latter are for logs that hold fewer commands than the robot
            was sent.
        command_shift_s: commands act this much earlier than their stamps say [s], >= 0: the stamps are late. It is a
            property of the log; `delay_s` is one of the robot.
    """

    window_s: float | None = None
    initial_velocity: Literal["zero", "measured"] | None = None
    settle_s: float = 0.0
    command: CommandTiming = "held"
    command_shift_s: float = 0.0


@dataclass(frozen=True)
class RobotSpec:
    """A robot as trueup sees it.

    Attributes:
        name: short name.
        joints: the controlled joints, in the order of results.
        model: file name of the MJCF or URDF; looked for beside the dataset, beside the YAML and in the package.
        schema: `trueup.robot/1`.
        scored: joints that enter the mean of a metric; all if empty.
        ignore: log joints that have no counterpart in the model.
        controller: how commands become torques.
        simulation: how the engine is run.
        replay: how logs are replayed.
        friction: joint name -> friction law beyond the model's own `damping` and `frictionloss`.
        motor: of every joint, for the current and voltage in what is replayed; a `servo` needs it.
        payload: where the payload of a log hangs; if not given, simulations leave it out.
        base: where a base is held that floats in the model; such a model is refused if not given.
        unlisted: what becomes of the model's joints that are not among `joints`.
        clock: what is wrong with the stamps of the logs.
        description: for people.
        folder: where the YAML was read from.
    """

    name: str
    joints: tuple[JointSpec, ...]
    model: str
    schema: Literal["trueup.robot/1"] = "trueup.robot/1"
    scored: tuple[str, ...] = ()
    ignore: tuple[str, ...] = ()
    controller: ControllerSpec = field(default_factory=lambda: ControllerSpec(command="position"))
    simulation: SimulationSpec = field(default_factory=SimulationSpec)
    replay: ReplaySpec = field(default_factory=ReplaySpec)
    friction: Mapping[str, JointFriction] = field(default_factory=dict)
    motor: MotorSpec | None = None
    payload: PayloadSpec | None = None
    base: BaseSpec | None = None
    unlisted: UnlistedSpec = field(default_factory=UnlistedSpec)
    clock: ClockSpec = field(default_factory=ClockSpec)
    description: str = ""
    folder: Path | None = None

    def __post_init__(self) -> None:
        """Refuse contradictions."""
        names = self.joint_names
        if not names or len(set(names)) != len(names):
            raise ConfigError(f"robot {self.name!r}: joints must be there and have different names", got=list(names))
        strangers = [name for name in (*self.scored, *self.controller.per_joint, *self.friction) if name not in names]
        if strangers:
            raise ConfigError(f"robot {self.name!r}: {strangers} are not joints", available=names)
        if named := [name for name in (*self.unlisted.pose, *self.unlisted.joints) if name in names]:
            raise ConfigError(
                f"robot {self.name!r}: unlisted: {named} are among the joints of the robot",
                expected="joints of the model that `joints` does not name",
            )
        if self.controller.kind == "servo" and self.motor is None:
            raise ConfigError(
                f"robot {self.name!r}: a servo needs a motor",
                hint="motor: {resistance_ohm: …, torque_constant_nm_a: …, back_emf_v_s_rad: …, voltage_v: …}",
            )
        needed = _NEEDED_GAIN.get(self.controller.kind)
        for name in names:
            gains = {gain: self.controller.gain(gain, name) for gain in ("kp", "kv", "ki")}
            if not all(0 <= value < float("inf") for value in gains.values()) or (needed and gains[needed] == 0):
                raise ConfigError(
                    f"robot {self.name!r}: the gains of joint {name!r} make no {self.controller.kind} controller",
                    got=gains,
                    expected=f"{needed} > 0, none negative" if needed else "none negative",
                )
        delays = np.append(self.delay_s, self.controller.delay_s)
        if not np.all((delays >= 0) & (delays <= _LONGEST_S)):
            got = ", ".join(f"{delay:g}" for delay in delays)
            raise ConfigError(f"robot {self.name!r}: delay_s must be >= 0", got=got, expected=f"0 to {_LONGEST_S:g} s")
        for label, value in (("timestep_s", self.simulation.timestep_s), ("window_s", self.replay.window_s)):
            if value is not None and not 0 < value < np.inf:
                raise ConfigError(f"robot {self.name!r}: {label} must be positive", got=value)
        for label, value in (("settle_s", self.replay.settle_s), ("command_shift_s", self.replay.command_shift_s)):
            if not 0 <= value <= _LONGEST_S:
                raise ConfigError(f"robot {self.name!r}: {label}", got=f"{value:g}", expected=f"0 to {_LONGEST_S:g} s")

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the J controlled joints, in the model's words."""
        return tuple(joint.name for joint in self.joints)

    @property
    def delay_s(self) -> tuple[float, ...]:
        """How much later commands act, one per joint [s]."""
        return tuple(self.controller.gain("delay_s", name) for name in self.joint_names)

    @property
    def replay_delay_s(self) -> tuple[float, ...]:
        """How much later than their stamps commands of a log act, one per joint [s]; negative where stamps are late."""
        return tuple(delay - self.replay.command_shift_s for delay in self.delay_s)

    @property
    def scored_joints(self) -> tuple[str, ...]:
        """The joints that enter the mean."""
        return self.scored or self.joint_names

    def torque_constant_nm_a(self, joint: str) -> float | None:
        """Torque of a joint per current of its motor [Nm/A or N/A]; None where nobody says."""
        own = next(item.torque_constant_nm_a for item in self.joints if item.name == joint)
        return own if own is not None or self.motor is None else self.motor.torque_constant_nm_a

    def carried_kg(self, payload_kg: float | None) -> float:
        """What of a log's payload simulations carry [kg]: none where nobody has said where it hangs."""
        return 0.0 if self.payload is None else payload_kg or 0.0

    def joint_rules(self) -> dict[str, Any]:
        """The map from log names to model names, as `align.JointMap.from_dict` reads it."""
        rules: dict[str, dict[str, Any]] = {}
        for joint in self.joints:
            rules[joint.name] = {
                "log": joint.log or joint.name,
                "sign": joint.sign,
                "scale": joint.scale,
                "offset": joint.offset,
            }
            if joint.log_unit is not None:
                rules[joint.name]["log_unit"] = joint.log_unit
            if joint.command is not None and joint.command.given:
                rules[joint.name]["command"] = joint.command.given
        clock = {} if self.clock == ClockSpec() else {"clock": asdict(self.clock)}
        measured = {"measured_command": self.controller.signal} if self.controller.source == "measured" else {}
        return {"joints": rules, "ignore": list(self.ignore), **measured, **clock}

    def to_dict(self) -> dict[str, Any]:
        """The resolved configuration, JSON types only."""
        tree = asdict(self)
        del tree["folder"]
        if self.payload is None:
            del tree["payload"]  # runs of robots that carry nothing were made before there was one
        if not self.simulation.base_sensor:
            del tree["simulation"]["base_sensor"]  # and those on a base at rest likewise
        if self.replay.command == "held":
            del tree["replay"]["command"]
        if not self.replay.command_shift_s:
            del tree["replay"]["command_shift_s"]
        if self.controller.source == "commanded":
            del tree["controller"]["source"]
        if self.controller.kp_setting is None:
            del tree["controller"]["kp_setting"]
        for name, own in (("base", self.base), ("unlisted", self.unlisted)):
            tree[name] = None if own is None else own.to_plain()
            if own in (None, UnlistedSpec()):
                del tree[name]
        if self.clock == ClockSpec():
            del tree["clock"]
        for joint in tree["joints"]:
            if joint["torque_constant_nm_a"] is None:
                del joint["torque_constant_nm_a"]
            if joint["command"] is None:
                del joint["command"]
            else:
                joint["command"] = {key: value for key, value in joint["command"].items() if value is not None}
        return tree


def load_robot(name_or_path: str | Path) -> RobotSpec:
    """A robot by the name of a shipped one, or from a YAML file.

    Raises:
        ConfigError: no such file or robot, or its content is wrong.
    """
    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml"):
        return _shipped(str(name_or_path))
    spec = build(RobotSpec, read_yaml(path), str(path))
    return replace(spec, folder=path.parent.resolve())


def _shipped(name: str) -> RobotSpec:
    files = {file.stem: file for file in shipped_robots()}
    if name in files:
        return load_robot(files[name])
    if name not in NAMESAKES:
        raise ConfigError(
            f"{name!r} is no shipped robot and no .yaml file",
            available=sorted((*files, *NAMESAKES)),
            hint="Give one of these names, or the path of a robot.yaml, which names the model (docs/robots.md).",
        )
    other = NAMESAKES[name]
    spec = load_robot(files[other.description])
    joints = spec.joints
    if other.degrees:
        joints = tuple(
            joint if (joint.log or joint.name) in GRIPPERS else replace(joint, log_unit="deg", scale=1.0)
            for joint in joints
        )
    return replace(spec, name=name, model=other.model or spec.model, joints=joints)


def shipped_robots() -> list[Path]:
    """The robot files that come with the package."""
    folder = Path(str(resources.files("trueup.robots")))
    return sorted(folder.glob("*.yaml"))


def find_model(spec: RobotSpec, *, given: Path | None = None, folder: Path | None = None) -> Path:
    """The robot's MJCF or URDF.

    Args:
        spec: the robot.
        given: path from `--model`, first choice.
        folder: the dataset's folder of models; a link out of it is not followed.

    Raises:
        ConfigError: found nowhere; the message lists where it was looked for.
    """
    if given is not None:
        if not given.is_file():
            raise ConfigError(f"there is no model at {given}", hint=where_missing(given))
        return given
    folders = [folder] if folder and is_inside(folder, folder / spec.model) else []
    if spec.folder:
        folders.append(spec.folder)
    folders.append(Path(str(resources.files("trueup.robots"))) / "models")
    for place in folders:
        if os.path.isfile(place / spec.model):  # noqa: PTH113 - of any name
            return place / spec.model
    raise ConfigError(
        f"the model {spec.model!r} of robot {spec.name!r} was not found in {', '.join(map(str, folders))}",
        hint="Give its path with --model"
        + ("." if folder is None else ", or put it into the folder `model/` of the dataset.")
        + (f"\n{known}" if (known := where_model_is(spec.model)) else ""),
    )
