"""How large the effects of a virtual robot are, and which of them are there: `LabSpec`, from YAML or as it comes.

The numbers that come with it are those of a Franka Panda, from the papers where they give them. A tuple has one number
per joint, or one for all joints.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, is_dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import numpy as np

from trueup.core.config import build, read_yaml
from trueup.errors import ConfigError
from trueup.lab.simulated_robot import Sensors

PerJoint = tuple[float, ...]
_SHIPPED = Path(str(resources.files("trueup.lab"))) / "labs"
# Of a relative spread: five units drawn from it already differ by a factor of thousands, and a wider one overflows.
_WIDEST = 5.0
# Beyond these no unit makes sense of a number, and products of two are no numbers any more.
_SMALLEST, _LARGEST = 1e-12, 1e12
_SPREADS = ("mass", "shape", "armature", "spread", "error")


@dataclass(frozen=True)
class Inertia:
    """The bodies are not those of the model.

    Attributes:
        enabled: whether the effect is there.
        mass: spread of the masses, relative.
        com_m: spread of the centers of mass, each axis [m].
        shape: spread of the inertia tensors, relative.
        armature: spread of the motors' inertias, relative.
    """

    enabled: bool = True
    mass: float = 0.04
    com_m: float = 0.003
    shape: float = 0.04
    armature: float = 0.15


@dataclass(frozen=True)
class Friction:
    """Friction of the joints: it sticks, breaks away, and slides.

    With v the joint velocity, s its sign, and t the torque that the transmission carries, a joint that slides is
    braked on the side of the link by

        (1 + a s) (F_c + (F_s - F_c) exp(-(v / stribeck_velocity)^2) + load |t| + viscous |v| + s sigmoid(v)),

    where F_s (1 + a) and F_s (1 - a) are the breakaway torques, F_c is `sliding` F_s, and sigmoid(v) is eq. 2.1 of the
    ES thesis. A joint that sticks gives way like a spring, by `presliding_rad` until it breaks away, and does not
    creep. The motor has dry friction of its own besides.

    Attributes:
        enabled: whether the effect is there.
        breakaway_positive: ES thesis, Table 3.2 [Nm].
        breakaway_negative: likewise, as positive numbers [Nm].
        sliding: share of the breakaway torque that is left when the joint slides.
        stribeck_velocity: where the excess has fallen to 1/e [rad/s].
        load: friction per torque that the transmission carries [-].
        viscous: [Nm s/rad].
        sigmoid_level: phi_1 of ES thesis, Table 2.3 [Nm].
        sigmoid_slope: phi_2 [s/rad].
        sigmoid_shift: phi_3 [rad/s].
        motor: dry friction on the motor's side, as far as the robot's own observer leaves it [Nm].
        presliding_rad: how far a joint gives way before it breaks away [rad].
        spread: of each number from unit to unit, relative.
    """

    enabled: bool = True
    breakaway_positive: PerJoint = (0.65, 0.88, 0.51, 0.61, 0.44, 0.40, 0.32)
    breakaway_negative: PerJoint = (0.62, 0.81, 0.42, 0.51, 0.67, 0.23, 0.35)
    sliding: float = 0.7
    stribeck_velocity: float = 0.05
    load: float = 0.005
    viscous: PerJoint = (0.3, 0.3, 0.2, 0.2, 0.1, 0.1, 0.1)
    sigmoid_level: PerJoint = (0.5462, 0.8722, 0.6407, 1.2794, 0.8390, 0.3030, 0.5649)
    sigmoid_slope: PerJoint = (5.1181, 9.0657, 10.1360, 5.5903, 8.3469, 17.1330, 10.3360)
    sigmoid_shift: PerJoint = (0.0395, 0.0259, -0.0461, 0.0362, 0.0262, -0.0210, 0.0036)
    motor: PerJoint = (0.05, 0.05, 0.05, 0.05, 0.02, 0.02, 0.02)
    presliding_rad: float = 2e-4
    spread: float = 0.1


@dataclass(frozen=True)
class Gravity:
    """What the robot's own gravity compensation gets wrong; without this effect, it is exact.

    Attributes:
        enabled: whether the effect is there.
        error: spread of the error relative to the weight that a joint carries.
        offset_nm: constant error; the thesis adds the opposite by hand (ES thesis, Table 3.1) [Nm].
        spread_nm: of the offset from unit to unit [Nm].
        payload_known: share of the payload that the compensation knows of.
    """

    enabled: bool = True
    error: float = 0.01
    offset_nm: PerJoint = (0.127, 0.725, -0.027, -0.53, 0.0, 0.06, 0.0)
    spread_nm: float = 0.03
    payload_known: float = 0.9


@dataclass(frozen=True)
class Elasticity:
    """A spring between motor and link.

    Attributes:
        enabled: whether the effect is there; without it, motor and link are one.
        stiffness: [Nm/rad]; too stiff for the physics step is refused.
        damping: [Nm s/rad].
        spread: of both from unit to unit, relative.
    """

    enabled: bool = True
    stiffness: PerJoint = (14000.0, 14000.0, 12000.0, 12000.0, 6000.0, 5000.0, 4000.0)
    damping: PerJoint = (4.0, 4.0, 4.0, 4.0, 1.0, 1.0, 0.5)
    spread: float = 0.1


@dataclass(frozen=True)
class Ripple:
    """Torque that comes and goes with the angle of the motor: of the magnets and of the gear's wave generator.

    Attributes:
        enabled: whether the effect is there.
        amplitude_nm: at the joint [Nm]; the second harmonic has half of it.
        periods_per_turn: periods in one turn of the joint; a gear of 1:100 with two lobes has 200.
        spread: of the amplitude from unit to unit, relative; phases are drawn from the whole circle.
    """

    enabled: bool = True
    amplitude_nm: PerJoint = (0.12, 0.12, 0.12, 0.12, 0.05, 0.05, 0.04)
    periods_per_turn: float = 200.0
    spread: float = 0.2


@dataclass(frozen=True)
class Saturation:
    """What the motors can give.

    Attributes:
        enabled: whether the effect is there.
        torque_nm: largest torque (ES thesis, Table 2.1) [Nm].
        torque_rate_nm_s: fastest change of a commanded torque (ES thesis, Table 2.1) [Nm/s]; 0 for no such limit. The
            robot's own impedance controller is not bound by it.
        no_load_speed: speed at which a motor has nothing left to drive with [rad/s]; 0 for no such limit.
    """

    enabled: bool = True
    torque_nm: PerJoint = (87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0)
    torque_rate_nm_s: PerJoint = (1000.0,)
    no_load_speed: PerJoint = (6.0,)


@dataclass(frozen=True)
class Delay:
    """Time from the write of a command to the control step that follows it. Commands do not overtake one another.

    Attributes:
        enabled: whether the effect is there.
        delay_s: least time [s].
        jitter_s: on top of it, evenly distributed from 0 to this [s].
    """

    enabled: bool = True
    delay_s: float = 0.003
    jitter_s: float = 0.001


@dataclass(frozen=True)
class Readings:
    """What the sensors make of the truth: link position, link velocity, torque between motor and link.

    Attributes:
        enabled: whether the effect is there.
        sensors: noise and resolution.
        torque_bias_nm: spread of the torque sensors' bias [Nm].
    """

    enabled: bool = True
    sensors: Sensors = field(
        default_factory=lambda: Sensors(
            position_noise_rad=3e-5,
            position_step_rad=2 * np.pi / 2**17,
            velocity_noise_rad_s=2e-3,
            torque_noise_nm=0.05,
            torque_step_nm=0.01,
        )
    )
    torque_bias_nm: float = 0.2


@dataclass(frozen=True)
class Winding:
    """The motors of servos are not those of the data sheet.

    Attributes:
        enabled: whether the effect is there.
        resistance: spread of the resistances, relative.
        torque_constant: spread of torque per current, relative; half of it is the magnets', and goes into the back-EMF.
        supply_v: what the supply is off by, from unit to unit [V].
    """

    enabled: bool = True
    resistance: float = 0.08
    torque_constant: float = 0.05
    supply_v: float = 0.3


@dataclass(frozen=True)
class Mounting:
    """The parts are not mounted where the model has them: prints and assembly are not exact.

    A part of a closed chain is held from two sides, and could not be assembled: such robots have no such effect.

    Attributes:
        enabled: whether the effect is there; as it comes, its sizes are 0.
        position_m: spread of where a body sits on the one that carries it, each axis [m].
        rotation_rad: spread of how it is turned there, about each axis [rad].
    """

    enabled: bool = True
    position_m: float = 0.0
    rotation_rad: float = 0.0


@dataclass(frozen=True)
class Warming:
    """Joints warm up by the power that friction and windings dissipate, and warm grease brakes less.

    dT/dt = (rise_k_per_w P - T) / time_constant_s with T above the surroundings; friction is multiplied by
    exp(-softening T).

    Attributes:
        enabled: whether the effect is there.
        rise_k_per_w: what one watt warms a joint in the end [K/W].
        copper_w_per_nm2: power lost in the windings per squared torque [W/Nm2].
        time_constant_s: [s].
        softening: [1/K].
    """

    enabled: bool = True
    rise_k_per_w: float = 1.5
    copper_w_per_nm2: PerJoint = (0.01, 0.01, 0.01, 0.01, 0.1, 0.1, 0.1)
    time_constant_s: float = 900.0
    softening: float = 0.012


@dataclass(frozen=True)
class Markers:
    """Bodies that a motion capture follows beside the robot's own sensors. Not an effect: it changes no motion.

    Attributes:
        bodies: of the model; none if empty.
        position_noise_m: standard deviation of where a body's frame is seen, each axis [m].
        position_step_m: resolution [m]; 0 for none.
        rotation_noise_rad: standard deviation of how it is seen turned, about each axis [rad].
    """

    bodies: tuple[str, ...] = ()
    position_noise_m: float = 0.0
    position_step_m: float = 0.0
    rotation_noise_rad: float = 0.0


@dataclass(frozen=True)
class Inertial:
    """An accelerometer on the base. Not an effect: robots are the same with and without.

    Attributes:
        body: of the model, on which it sits; none if empty.
        noise_m_s2: standard deviation of its noise [m/s2].
        bias_m_s2: standard deviation of its bias, which stays the same in a recording [m/s2].
    """

    body: str = ""
    noise_m_s2: float = 0.05
    bias_m_s2: float = 0.03


@dataclass(frozen=True)
class Base:
    """What the robot stands on, which its simulator takes for fixed.

    In the frame of the base, its acceleration is a change of gravity, and its tilt turns gravity. Forces that turning
    adds besides are left out. Each recording begins somewhere in the period.

    Attributes:
        enabled: whether the effect is there.
        condition: `fixed` to the ground; `stance`, on legs that stand still: the same, by name; `squat`, slowly up and
            down with a lean; `gait`, walking on the spot: up and down and to and fro with each step, from side to side
            with every second one.
        squat_hz: squats per second [Hz].
        squat_m: how deep they are [m].
        squat_lean_rad: how far the robot leans forward at the deepest [rad].
        step_hz: steps per second [Hz].
        bob_m: amplitude of up and down, each step [m].
        sway_m: from side to side, every second step [m].
        surge_m: to and fro, each step [m].
        strike_m: to and fro, of the feet that strike: twice each step [m].
        sway_rad: tilt to the sides, every second step [rad].
        nod_rad: tilt forward and back, each step [rad].
        gait_lean_rad: how far the robot leans forward all the while [rad].
        spread: of rate and size from recording to recording, relative.
    """

    enabled: bool = True
    condition: Literal["fixed", "stance", "squat", "gait"] = "fixed"
    squat_hz: float = 0.25
    squat_m: float = 0.2
    squat_lean_rad: float = 0.25
    step_hz: float = 2.0
    bob_m: float = 0.015
    sway_m: float = 0.025
    surge_m: float = 0.008
    strike_m: float = 0.001
    sway_rad: float = 0.02
    nod_rad: float = 0.01
    gait_lean_rad: float = 0.05
    spread: float = 0.1


@dataclass(frozen=True)
class Controller:
    """The controller inside the robot, which runs at the control rate. Not an effect.

    Attributes:
        kind: `impedance` follows positions, and velocities if they are written, and carries the arm's weight; `torque`
            adds commanded torques to the weight; `pd` turns the error of the position into torque, brakes by the
            velocity and knows no weight; `servo` turns the error of the position into the voltage of a DC motor, and
            knows no weight either: the `motor` is that of the robot's description.
        stiffness: of the impedance [Nm/rad], or gain of the servo [V/rad]; those that come with libfranka.
        damping: likewise [Nm s/rad; V s/rad].
        cutoff_hz: low-pass of positions that come without velocities; libfranka's is 100 Hz.
    """

    kind: Literal["impedance", "torque", "servo", "pd"] = "impedance"
    stiffness: PerJoint = (3000.0, 3000.0, 3000.0, 2500.0, 2500.0, 2000.0, 2000.0)
    damping: PerJoint = (60.0, 60.0, 50.0, 50.0, 30.0, 25.0, 20.0)
    cutoff_hz: float = 100.0


@dataclass(frozen=True)
class LabSpec:
    """A kind of virtual robot; `draw_truth` makes individuals of it.

    Attributes:
        robot: name of a shipped robot or path of a robot.yaml, whose model the individuals differ from.
        inertia: other bodies.
        friction: joint friction.
        gravity: errors of the gravity compensation.
        elasticity: springs between motors and links.
        ripple: torque ripple.
        saturation: limits of the motors.
        delay: of commands.
        readings: sensors.
        warming: friction that changes with temperature.
        winding: motors of servos.
        mounting: where the parts sit on one another.
        base: what the robot stands on.
        markers: bodies that a motion capture follows.
        inertial: accelerometer on the base.
        controller: inside the robot.
        payload_site: site of the model that a payload hangs on; several, such as both hands, each hold one.
        payload_offset_m: from the site to the payload's center of mass, along the site's z axis [m].
        payload_radius_m: a payload is a ball of this radius [m].
        payload_limit_kg: heavier ones are refused.
        physics_step_s: [s].
        control_step_s: a whole number of physics steps [s].

    Raises:
        ConfigError: a number that makes no robot.
    """

    robot: str = "panda"
    inertia: Inertia = field(default_factory=Inertia)
    friction: Friction = field(default_factory=Friction)
    gravity: Gravity = field(default_factory=Gravity)
    elasticity: Elasticity = field(default_factory=Elasticity)
    ripple: Ripple = field(default_factory=Ripple)
    saturation: Saturation = field(default_factory=Saturation)
    delay: Delay = field(default_factory=Delay)
    readings: Readings = field(default_factory=Readings)
    warming: Warming = field(default_factory=Warming)
    winding: Winding = field(default_factory=Winding)
    mounting: Mounting = field(default_factory=Mounting)
    base: Base = field(default_factory=Base)
    markers: Markers = field(default_factory=Markers)
    inertial: Inertial = field(default_factory=Inertial)
    controller: Controller = field(default_factory=Controller)
    payload_site: str | tuple[str, ...] = "payload"
    payload_offset_m: float = 0.05
    payload_radius_m: float = 0.04
    payload_limit_kg: float = 3.0
    physics_step_s: float = 0.0005
    control_step_s: float = 0.001

    def __post_init__(self) -> None:
        """Refuse what makes no robot."""
        for name, value in _numbers(self):
            signed = name in ("friction.sigmoid_shift", "gravity.offset_nm", "payload_offset_m")
            if not np.isfinite(value) or (value < 0 and not signed):
                raise ConfigError(f"lab: {name}", got=value, expected="a finite number" if signed else ">= 0")
            if name.rpartition(".")[2] in _SPREADS and value > _WIDEST:
                raise ConfigError(f"lab: {name} is a relative spread", got=value, expected=f"at most {_WIDEST:g}")
            if not (value == 0 or _SMALLEST <= abs(value) <= _LARGEST):
                raise ConfigError(
                    f"lab: {name} is no size of a robot's", got=value, expected=f"0, or {_SMALLEST:g} to {_LARGEST:g}"
                )
        positive = ("friction.presliding_rad", "friction.stribeck_velocity", "warming.time_constant_s")
        for name, value in _numbers(self):
            if value == 0 and name in (*positive, "physics_step_s", "saturation.torque_nm", "payload_radius_m"):
                raise ConfigError(f"lab: {name} must be positive", got=value)
        if len(set(self.markers.bodies)) != len(self.markers.bodies):
            raise ConfigError("lab: markers.bodies names a body twice", got=list(self.markers.bodies))
        if self.inertial.body and self.markers.bodies:
            raise ConfigError(
                "lab: markers or an inertial sensor, not both", got=[self.inertial.body, *self.markers.bodies]
            )
        steps = self.control_step_s / self.physics_step_s
        if not 0.5 < steps < 1e9 or abs(steps - round(steps)) > 1e-6:
            raise ConfigError("lab: control_step_s must be a whole number of physics steps", got=f"{steps:g} steps")

    def only(self, *effects: str) -> LabSpec:
        """The same kind of robot with these effects and no others; none at all if no name is given.

        Raises:
            ConfigError: there is no such effect.
        """
        return self._switched({name: name in self._known(effects) for name in EFFECTS})

    def without(self, *effects: str) -> LabSpec:
        """The same kind of robot with these effects switched off.

        Raises:
            ConfigError: there is no such effect.
        """
        return self._switched(dict.fromkeys(self._known(effects), False))

    @staticmethod
    def _known(effects: tuple[str, ...]) -> tuple[str, ...]:
        for name in effects:
            if name not in EFFECTS:
                raise ConfigError(f"a lab has no effect {name!r}", available=EFFECTS)
        return effects

    def _switched(self, on: dict[str, bool]) -> LabSpec:
        return replace(self, **{name: replace(getattr(self, name), enabled=value) for name, value in on.items()})


# Each has a stream of draws by its place here: new ones come last.
EFFECTS = (
    *("inertia", "friction", "gravity", "elasticity", "ripple", "saturation", "delay", "readings", "warming"),
    *("winding", "mounting", "base"),
)


def load_lab(name_or_path: str | Path, *, robot: str | None = None) -> LabSpec:
    """A lab by the name of a shipped one, such as `xm430`, or from a YAML file; what it leaves out is as in `LabSpec`.

    Args:
        name_or_path: of the lab.
        robot: whose effects they are, where the file names no robot.

    Raises:
        ConfigError: no such lab or file, unknown keys, wrong types or numbers.
    """
    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml"):
        shipped = {file.stem: file for file in sorted(_SHIPPED.glob("*.yaml"))}
        if str(name_or_path) not in shipped:
            raise ConfigError(
                f"there is no lab {str(name_or_path)!r}",
                available=shipped,
                hint="Give one of these names, or a YAML file with the sizes of a lab's effects.",
            )
        path = shipped[str(name_or_path)]
    tree = read_yaml(path)
    return build(LabSpec, tree if robot is None else {"robot": robot, **tree}, str(path))


def _numbers(tree: Any, prefix: str = "") -> list[tuple[str, float]]:
    """Every number of a dataclass with the name of its field."""
    found = []
    for entry in fields(tree):
        value, name = getattr(tree, entry.name), prefix + entry.name
        if is_dataclass(value):
            found += _numbers(value, f"{name}.")
        elif isinstance(value, tuple):
            found += [(name, float(item)) for item in value if not isinstance(item, str)]
        elif isinstance(value, float):
            found.append((name, value))
    return found
