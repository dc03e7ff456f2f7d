"""Where a recording gets its robots from: virtual hardware, or an engine that plays the robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from trueup.core.model_card import ModelCard
from trueup.core.protocols import Hardware
from trueup.errors import ConfigError, NameMismatch
from trueup.robots import RobotSpec, load_robot

if TYPE_CHECKING:
    from trueup.deploy import Limits
    from trueup.lab import Fault, LabSpec, Truth, VirtualRobot

# What `make_rig` knows.
HARDWARE = ("lab", "mujoco", "dart")
# A recording of many motions takes a working robot about this long each; it is switched off every two hours.
_MOTION_S = 8.0
_DAY_S = 7200.0
# Something goes wrong in the first seconds of a motion or of the way to it.
_FAULT_WITHIN_S = 4.0


@runtime_checkable
class Rig(Protocol):
    """Robots for a recording. Each motion is a session of its own, so that motions do not depend on their order."""

    @property
    def unit(self) -> str:
        """Which individual it is."""
        ...

    @property
    def condition(self) -> str:
        """What it stands on; empty where nothing is to be said."""
        ...

    def describe(self) -> dict[str, Any]:
        """What decides about what it does, JSON types only."""
        ...

    def session(self, number: int, payload_kg: float) -> Hardware:
        """The robot at home, ready for motion `number` with this payload."""
        ...


def _said(spec: LabSpec) -> dict[str, Any]:
    """The sizes of a lab; those on a fixed base, or without a sensor on it, were recorded before there was another."""
    tree = asdict(spec)
    if spec.base.condition == "fixed":
        del tree["base"]
    if not spec.inertial.body:
        del tree["inertial"]
    return tree


@dataclass
class LabRig:
    """One individual of virtual hardware.

    Attributes:
        spec: sizes of its effects.
        number: which individual.
        seed: of noise, jitter and faults.
        fault_share: share of the motions in which something goes wrong: a stop, lost readings, or a stalled joint.

    Raises:
        ConfigError: a share that is none.
    """

    spec: LabSpec
    number: int = 1
    seed: int = 0
    fault_share: float = 0.0
    _robots: dict[float, VirtualRobot] = field(default_factory=dict, repr=False, compare=False)

    def __getstate__(self) -> dict[str, Any]:
        """What another process needs; it makes a robot of its own."""
        return {**self.__dict__, "_robots": {}}

    def __post_init__(self) -> None:
        """Refuse a share that is none."""
        if not 0 <= self.fault_share <= 1:
            raise ConfigError(
                "the share of motions with faults is out of range", got=self.fault_share, expected="0 to 1"
            )

    @property
    def unit(self) -> str:
        """Which individual it is."""
        return f"lab-{self.number}"

    @property
    def condition(self) -> str:
        """The condition of its base; empty where it is fixed."""
        base = self.spec.base
        return base.condition if base.enabled and base.condition != "fixed" else ""

    def truth(self) -> Truth:
        """What is true of it."""
        from trueup.lab import draw_truth

        return draw_truth(self.spec, unit=self.number)

    def describe(self) -> dict[str, Any]:
        """What decides about what it does; its numbers are not said here."""
        return {
            "hardware": "lab",
            "unit": self.number,
            "seed": self.seed,
            "fault_share": self.fault_share,
            "spec": _said(self.spec),
        }

    def session(self, number: int, payload_kg: float) -> VirtualRobot:
        """The robot at home, as warm as the motions before left it."""
        from trueup.lab import VirtualRobot

        if payload_kg not in self._robots:
            self._robots.clear()  # payloads come one after the other
            self._robots[payload_kg] = VirtualRobot(self.truth(), payload_kg=payload_kg)
        robot = self._robots[payload_kg]
        robot.restart(
            seed=(self.seed, number), faults=self._faults(number, robot), worked_s=number * _MOTION_S % _DAY_S
        )
        return robot

    def _faults(self, number: int, robot: VirtualRobot) -> tuple[Fault, ...]:
        from trueup.lab import Fault

        rng = np.random.default_rng([self.seed, number, 1])
        if rng.uniform() >= self.fault_share:
            return ()
        at_s, joint = float(rng.uniform(0.0, _FAULT_WITHIN_S)), str(rng.choice(robot.joints))
        kinds = (
            Fault("stop", at_s=at_s),
            Fault("drop", at_s=at_s, duration_s=1.0),
            Fault("stall", at_s=at_s, duration_s=1.0, joint=joint),
        )
        return (kinds[int(rng.integers(len(kinds)))],)


@dataclass
class CompensatedRig:
    """A robot whose commands are corrected by a network before they reach it.

    Attributes:
        inner: where the robot comes from.
        network: folder of a network for the robot itself.
        limits: of its positions, which no corrected command leaves.
        control_hz: rate of its commands [Hz].
    """

    inner: Rig
    network: Path
    limits: Limits
    control_hz: float

    @staticmethod
    def of(inner: Rig, robot: RobotSpec, network: Path, *, control_hz: float) -> CompensatedRig:
        """With the limits of a robot's description.

        Raises:
            ConfigError: a joint has no limits of its position.
        """
        return CompensatedRig(inner, network, position_limits(robot), control_hz)

    @property
    def unit(self) -> str:
        """Which individual it is."""
        return self.inner.unit

    @property
    def condition(self) -> str:
        """What the robot stands on."""
        return self.inner.condition

    def describe(self) -> dict[str, Any]:
        """What decides about what it does."""
        return {**self.inner.describe(), "network": ModelCard.load(self.network).to_json()["sha256"]}

    def session(self, number: int, payload_kg: float) -> Hardware:
        """The robot at home, with a compensation that knows its payload and nothing else of it."""
        from trueup.deploy import CompensatedRobot, Compensator

        robot = self.inner.session(number, payload_kg)
        compensator = Compensator.load(
            self.network,
            joints=robot.joints,
            limits=self.limits,
            loop_hz=self.control_hz,
            payload_kg=payload_kg,
        )
        return CompensatedRobot(robot, compensator)


@dataclass
class ServoedRig:
    """A robot that takes torques, led along positions by springs and dampers at its joints.

    Attributes:
        inner: where the robot comes from.
        robot: its description, with the largest torques.
        model: its MJCF or URDF, for the inertias.
        frequency_hz: of the springs [Hz].
        control_hz: rate of the torques [Hz].

    Raises:
        ConfigError: a joint without a largest torque.
    """

    inner: LabRig | EngineRig
    robot: RobotSpec
    model: Path
    frequency_hz: float
    control_hz: float
    _springs: Any = field(default=None, repr=False, compare=False)

    def __getstate__(self) -> dict[str, Any]:
        """What another process needs; it makes springs of its own."""
        return {**self.__dict__, "_springs": None}

    def __post_init__(self) -> None:
        """Refuse robots whose torques would know no limit."""
        if missing := [joint.name for joint in self.robot.joints if not joint.torque_limit]:
            raise ConfigError(
                f"robot {self.robot.name!r} has joints whose torques would know no limit",
                got=missing,
                hint="Give them torque_limit in robot.yaml.",
            )

    @property
    def unit(self) -> str:
        """Which individual it is."""
        return self.inner.unit

    @property
    def condition(self) -> str:
        """What the robot stands on."""
        return self.inner.condition

    def truth(self) -> Truth:
        """What is true of the lab's robot.

        Raises:
            ConfigError: it is none of the lab's.
        """
        if not isinstance(self.inner, LabRig):
            raise ConfigError("only the lab's robots have a truth to write down", got=self.inner.unit)
        return self.inner.truth()

    def describe(self) -> dict[str, Any]:
        """What decides about what it does."""
        return {**self.inner.describe(), "servo_hz": self.frequency_hz, "servo_rate_hz": self.control_hz}

    def session(self, number: int, payload_kg: float) -> Hardware:
        """The robot at home, held there."""
        from trueup.record import Springs, TorqueServo
        from trueup.sim import MujocoSimulator

        if self._springs is None:
            most = np.array([joint.torque_limit for joint in self.robot.joints], np.float64)
            compiled = MujocoSimulator.from_robot(self.robot, self.model).model
            self._springs = Springs(compiled, self.robot.joint_names, most, frequency_hz=self.frequency_hz)
        return TorqueServo(self.inner.session(number, payload_kg), self._springs, step_s=1.0 / self.control_hz)


@dataclass
class EngineRig:
    """An engine that plays the robot (LSTM thesis, Algorithm 4: a saved plan, executed in simulation).

    Attributes:
        robot: its description.
        engine: `mujoco` or `dart`.
        model: its MJCF or URDF.
        control_hz: rate of the commands [Hz].
    """

    robot: RobotSpec
    engine: str
    model: Path
    control_hz: float = 1000.0
    _simulator: Any = field(default=None, repr=False, compare=False)

    def __getstate__(self) -> dict[str, Any]:
        """What another process needs; it makes a simulator of its own."""
        return {**self.__dict__, "_simulator": None}

    @property
    def unit(self) -> str:
        """There is one of it."""
        return self.engine

    @property
    def condition(self) -> str:
        """It is fixed."""
        return ""

    def describe(self) -> dict[str, Any]:
        """Which engine and robot."""
        return {"hardware": self.engine, "robot": self.robot.to_dict(), "control_hz": self.control_hz}

    def session(self, number: int, payload_kg: float) -> Hardware:  # noqa: ARG002 - it has no days
        """The robot at home.

        Raises:
            ConfigError: a payload, which the model has no place for.
        """
        from trueup.lab import SimulatedRobot
        from trueup.sim import make_simulator

        if payload_kg:
            raise ConfigError("an engine's model carries no payload", got=f"{payload_kg:g} kg", expected="0")
        if self._simulator is None:
            self._simulator = make_simulator(self.engine, self.robot, self.model)
        model = self._simulator.model
        # Where the control step is no whole number of physics steps, commands and readings come at the next of these.
        ratio = 1.0 / (self.control_hz * self._simulator.timestep_s)
        steps = round(ratio) if ratio >= 1 and abs(ratio - round(ratio)) < 1e-6 else 1
        home = _home(model, self.robot.joint_names)
        return SimulatedRobot(self._simulator, position=home, steps_per_control=steps)


def position_limits(robot: RobotSpec) -> Limits:
    """Where the joints of a robot may be commanded to be.

    Raises:
        ConfigError: a joint has no limits of its position.
    """
    from trueup.deploy import Limits

    known = {joint.name: joint.position_limits for joint in robot.joints if joint.position_limits}
    if missing := [name for name in robot.joint_names if name not in known]:
        raise ConfigError(
            f"robot {robot.name!r} has joints whose corrected commands would know no limits",
            got=missing,
            hint="Give them position_limits in robot.yaml.",
        )
    low, high = zip(*(known[name] for name in robot.joint_names), strict=True)
    return Limits(low=low, high=high)


def _home(model: Any, joints: Sequence[str]) -> np.ndarray:
    """The keyframe `home`, or the pose of zeros of a model that has none."""
    homes = {model.key(row).name: model.key_qpos[row] for row in range(model.nkey)}
    pose = homes.get("home", model.qpos0)
    return np.array([pose[model.joint(name).qposadr[0]] for name in joints], np.float64)


def make_rig(
    hardware: str,
    robot: RobotSpec,
    model: Path,
    *,
    unit: int = 1,
    seed: int = 0,
    lab: LabSpec | None = None,
    fault_share: float = 0.0,
    control_hz: float = 1000.0,
    base: str | None = None,
    servo_hz: float | None = None,
) -> LabRig | EngineRig | ServoedRig:
    """A rig by the name of its hardware; a robot that takes torques is led along positions by springs and dampers.

    Args:
        hardware: `lab`, or an engine: `mujoco`, `dart`.
        robot: its description.
        model: its MJCF or URDF.
        unit: which individual of the lab.
        seed: of noise, jitter and faults.
        lab: sizes of its effects.
        fault_share: share of the motions in which something goes wrong.
        control_hz: rate of the commands, or of the readings if it is higher [Hz]; of engines.
        base: condition of the base, over what the lab says.
        servo_hz: natural frequency of the springs for a robot that takes torques [Hz]; `record.SERVO_HZ` if None.

    Raises:
        ConfigError: there is no such hardware or condition, only the lab has units, faults, bases or a lab file, or
            `servo_hz` is given for a robot that takes no torques.
        NameMismatch: the lab is of another robot; both lists are printed.
    """
    torques = robot.controller.kind == "torque"
    if servo_hz is not None and not torques:
        raise ConfigError(
            f"robot {robot.name!r} follows positions by itself", got=f"servo_hz {servo_hz:g}", hint="Leave it out."
        )
    rig: LabRig | EngineRig
    if hardware == "lab":
        rig = LabRig(_lab_of(robot, lab, base, torques=torques), unit, seed, fault_share)
    elif hardware not in HARDWARE:
        raise ConfigError(f"there is no hardware {hardware!r}", available=HARDWARE)
    elif lab is not None or fault_share or base is not None:
        raise ConfigError(f"{hardware} has no faults, no base and no lab file", hint="Give --hardware lab.")
    else:
        rig = EngineRig(robot, hardware, model, control_hz)
    if not torques:
        return rig
    from trueup.record import SERVO_HZ

    return ServoedRig(rig, robot, model, SERVO_HZ if servo_hz is None else servo_hz, control_hz)


def _lab_of(robot: RobotSpec, lab: LabSpec | None, base: str | None, *, torques: bool) -> LabSpec:
    """Sizes of the lab's effects, for this robot on this base."""
    from trueup.core.config import build
    from trueup.lab import LabSpec
    from trueup.lab.spec import Base, Controller

    spec = lab or LabSpec()
    if base is not None:
        spec = replace(spec, base=build(Base, {**asdict(spec.base), "condition": base}, "base"))
    own = load_robot(spec.robot)
    if own.joint_names != robot.joint_names:
        raise NameMismatch(
            f"the lab's {own.name!r} is no {robot.name!r}",
            left=own.joint_names,
            right=robot.joint_names,
            hint="Give --lab: xm430 for servos, or a YAML file with this robot and the sizes of its effects.",
        )
    return replace(spec, controller=Controller(kind="torque")) if torques else spec
