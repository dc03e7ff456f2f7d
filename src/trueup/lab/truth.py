"""What is true of one individual virtual robot. It is kept apart from what the robot records, where no fit reads it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float64

from trueup.core.atomic import read_json, write_json
from trueup.core.config import build
from trueup.errors import ConfigError
from trueup.lab.spec import EFFECTS, LabSpec, Winding
from trueup.robots import RobotSpec, find_model, load_robot
from trueup.robots.holding import Holding
from trueup.robots.model import compile_spec, load_spec

_SCHEMA = "trueup.truth/1"


@dataclass(frozen=True)
class BodyTruth:
    """The inertia of one body.

    Attributes:
        mass: [kg].
        com: center of mass in the body's axes [m].
        inertia: about the center of mass, in the body's axes: M11, M22, M33, M12, M13, M23 [kg m2].
    """

    mass: float
    com: tuple[float, float, float]
    inertia: tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class JointTruth:
    """The numbers of one joint; zero where an effect is off. `LabSpec` has the formulas.

    Attributes:
        motor_inertia: of motor and gear, at the joint [kg m2].
        static_nm: F_s, mean of the breakaway torques in both directions [Nm].
        coulomb_nm: F_c [Nm].
        asymmetry: a, share by which friction is higher in the positive direction [-].
        stribeck_velocity: [rad/s].
        load: [-].
        viscous: [Nm s/rad].
        sigmoid_level: [Nm].
        sigmoid_slope: [s/rad].
        sigmoid_shift: [rad/s].
        bristle_stiffness: how stiff a joint sticks [Nm/rad].
        motor_friction_nm: dry friction of the motor [Nm].
        gravity_error: of the compensation, relative [-].
        gravity_offset_nm: of the compensation [Nm].
        stiffness: between motor and link [Nm/rad]; 0 is rigid.
        damping: of that spring [Nm s/rad].
        ripple_nm: amplitude [Nm].
        ripple_phase: of the first harmonic [rad].
        ripple_phase_second: of the second [rad].
        torque_bias_nm: of the torque sensor [Nm].
        resistance_ohm: of a servo's winding [ohm]; 0 for any other joint.
        torque_constant_nm_a: torque of the joint per current [Nm/A].
        back_emf_v_s_rad: [V s/rad].
        voltage_limit: what the supply gives [V].
    """

    motor_inertia: float
    static_nm: float = 0.0
    coulomb_nm: float = 0.0
    asymmetry: float = 0.0
    stribeck_velocity: float = 0.05
    load: float = 0.0
    viscous: float = 0.0
    sigmoid_level: float = 0.0
    sigmoid_slope: float = 10.0
    sigmoid_shift: float = 0.0
    bristle_stiffness: float = 0.0
    motor_friction_nm: float = 0.0
    gravity_error: float = 0.0
    gravity_offset_nm: float = 0.0
    stiffness: float = 0.0
    damping: float = 0.0
    ripple_nm: float = 0.0
    ripple_phase: float = 0.0
    ripple_phase_second: float = 0.0
    torque_bias_nm: float = 0.0
    resistance_ohm: float = 0.0
    torque_constant_nm_a: float = 0.0
    back_emf_v_s_rad: float = 0.0
    voltage_limit: float = 0.0


@dataclass(frozen=True)
class MountTruth:
    """Where a body sits, seen from where the model has it on the body that carries it.

    Attributes:
        offset: in the axes of the body that carries it [m].
        turn: axis times angle, in the body's own axes [rad].
    """

    offset: tuple[float, float, float]
    turn: tuple[float, float, float]


@dataclass(frozen=True)
class Truth:
    """One individual.

    Attributes:
        spec: what it was drawn from; numbers that all individuals share are read there.
        unit: its number.
        bodies: name -> inertia, without payload.
        joints: name -> numbers, in the robot's order.
        mounts: name -> where a body sits; of those that sit where the model has them nothing.
        schema: `trueup.truth/1`.
    """

    spec: LabSpec
    unit: int
    bodies: Mapping[str, BodyTruth]
    joints: Mapping[str, JointTruth]
    mounts: Mapping[str, MountTruth] = field(default_factory=dict)
    schema: str = _SCHEMA

    def save(self, path: Path) -> None:
        """Write it as JSON; keep that file away from the robot's data.

        Raises:
            DataError: it cannot be written.
        """
        write_json(path, asdict(self))

    @staticmethod
    def load(path: Path) -> Truth:
        """Read what `save` wrote.

        Raises:
            DataError: missing, or no JSON.
            ConfigError: no truth of this release.
        """
        truth = build(Truth, read_json(path), str(path))
        if truth.schema != _SCHEMA:
            raise ConfigError(f"{path} was written by another release", got=truth.schema, expected=_SCHEMA)
        return truth


def draw_truth(spec: LabSpec | None = None, *, unit: int = 1) -> Truth:
    """Draw an individual: the same numbers for the same spec and unit, and others for any other unit.

    Every effect has draws of its own, so that switching one off leaves the others as they are.

    Args:
        spec: sizes of the effects; a Panda with all of them if None.
        unit: number of the individual, >= 0.

    Raises:
        ConfigError: the number is negative, or a tuple of the spec fits neither one nor all joints.
    """
    spec = spec or LabSpec()
    if unit < 0:
        raise ConfigError("the unit of a virtual robot must not be negative", got=unit)
    robot = load_robot(spec.robot)
    path = find_model(robot)
    model = held_model(robot, path)
    streams = {name: np.random.default_rng([4, unit, index]) for index, name in enumerate(EFFECTS)}
    armature = np.array([model.dof_armature[model.joint(name).dofadr[0]] for name in robot.joint_names])
    bodies, motor_inertia = _bodies(spec, model, armature, streams["inertia"])
    columns = {
        "motor_inertia": motor_inertia,
        **_friction(spec, robot, streams["friction"]),
        **_gravity(spec, robot, streams["gravity"]),
        **_elasticity(spec, robot, streams["elasticity"]),
        **_ripple(spec, robot, streams["ripple"]),
        **_bias(spec, robot, streams["readings"]),
        **_winding(spec, robot, streams["winding"]),
    }
    joints = {
        name: JointTruth(**{key: float(values[index]) for key, values in columns.items()})
        for index, name in enumerate(robot.joint_names)
    }
    mounts = _mounts(spec, model, streams["mounting"])
    return Truth(spec=spec, unit=unit, bodies=bodies, joints=joints, mounts=mounts)


def held_model(robot: RobotSpec, path: Path) -> mujoco.MjModel:
    """The robot's model, compiled, with all held in it that its description says.

    Raises:
        ConfigError: it does not load or compile, or see `Holding.of`.
    """
    spec = load_spec(path)
    return compile_spec(Holding.of(spec, robot, origin=path).applied(spec), path)


def per_joint(values: tuple[float, ...], robot: RobotSpec, name: str) -> Float64[np.ndarray, "J"]:
    """One number per joint from a tuple of the spec.

    Raises:
        ConfigError: it has neither one number nor one per joint.
    """
    count = len(robot.joints)
    if len(values) not in (1, count):
        raise ConfigError(
            f"lab: {name} needs one number, or one per joint of {robot.name!r}",
            got=len(values),
            expected=f"1 or {count}",
        )
    return np.broadcast_to(np.array(values, np.float64), (count,)).copy()


def body_of(model: mujoco.MjModel, name: str) -> BodyTruth:
    """The inertia of a body of a compiled model."""
    index = model.body(name).id
    flat = np.empty(9)
    mujoco.mju_quat2Mat(flat, model.body_iquat[index])
    axes = flat.reshape(3, 3)
    return _body(
        float(model.body_mass[index]), model.body_ipos[index], axes @ np.diag(model.body_inertia[index]) @ axes.T
    )


def with_ball(body: BodyTruth, mass: float, place: Float64[np.ndarray, "3"], radius_m: float) -> BodyTruth:
    """The body with a massive ball that is fixed to it at `place` (in its own axes) [m]."""
    total = body.mass + mass
    com = (body.mass * np.array(body.com) + mass * place) / total
    inertia = tensor(body) + _steiner(body.mass, np.array(body.com) - com)
    inertia = inertia + _steiner(mass, place - com) + 0.4 * mass * radius_m**2 * np.eye(3)
    return _body(total, com, inertia)


def tensor(body: BodyTruth) -> Float64[np.ndarray, "3 3"]:
    """Its inertia about the center of mass, as a matrix [kg m2]."""
    xx, yy, zz, xy, xz, yz = body.inertia
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _body(mass: float, com: Float64[np.ndarray, "3"], inertia: Float64[np.ndarray, "3 3"]) -> BodyTruth:
    rows, columns = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
    m11, m22, m33, m12, m13, m23 = (float(value) for value in inertia[rows, columns])
    return BodyTruth(mass, _three(com), (m11, m22, m33, m12, m13, m23))


def _steiner(mass: float, arm: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3 3"]:
    return np.asarray(mass * (arm @ arm * np.eye(3) - np.outer(arm, arm)))


def _bodies(
    spec: LabSpec, model: mujoco.MjModel, armature: Float64[np.ndarray, "J"], rng: np.random.Generator
) -> tuple[dict[str, BodyTruth], Float64[np.ndarray, "J"]]:
    size = spec.inertia
    moving = [model.body(index).name for index in range(model.nbody) if model.body_weldid[index]]
    bodies = {name: body_of(model, name) for name in moving if model.body(name).mass[0] > 0}
    if not size.enabled:
        return bodies, armature
    for name, body in bodies.items():
        mass = body.mass * np.exp(size.mass * rng.standard_normal())
        com = np.array(body.com) + size.com_m * rng.standard_normal(3)
        shear = np.eye(3) + 0.5 * size.shape * rng.standard_normal((3, 3))
        # The second moment of a mass distribution, S = tr(I) / 2 - I, stays possible under A S A^T.
        moment = 0.5 * np.trace(tensor(body)) * np.eye(3) - tensor(body)
        moment = mass / body.mass * shear @ moment @ shear.T
        bodies[name] = _body(float(mass), com, np.trace(moment) * np.eye(3) - moment)
    return bodies, armature * np.exp(size.armature * rng.standard_normal(armature.size))


def _friction(spec: LabSpec, robot: RobotSpec, rng: np.random.Generator) -> dict[str, Float64[np.ndarray, "J"]]:
    size = spec.friction
    if not size.enabled:
        return {}
    names = ("breakaway_positive", "breakaway_negative", "viscous", "sigmoid_level", "motor")
    drawn = {}
    for name in names:
        base = per_joint(getattr(size, name), robot, f"friction.{name}")
        drawn[name] = base * np.exp(size.spread * rng.standard_normal(base.size))
    static = 0.5 * (drawn["breakaway_positive"] + drawn["breakaway_negative"])
    difference = 0.5 * (drawn["breakaway_positive"] - drawn["breakaway_negative"])
    ones = np.ones(len(robot.joints))
    return {
        "static_nm": static,
        "coulomb_nm": size.sliding * static,
        "asymmetry": np.divide(difference, static, out=np.zeros_like(static), where=static > 0),
        "stribeck_velocity": size.stribeck_velocity * ones,
        "load": size.load * ones,
        "viscous": drawn["viscous"],
        "sigmoid_level": drawn["sigmoid_level"],
        "sigmoid_slope": per_joint(size.sigmoid_slope, robot, "friction.sigmoid_slope"),
        "sigmoid_shift": per_joint(size.sigmoid_shift, robot, "friction.sigmoid_shift"),
        "bristle_stiffness": np.maximum(static, 0.1) / size.presliding_rad,
        "motor_friction_nm": drawn["motor"],
    }


def _gravity(spec: LabSpec, robot: RobotSpec, rng: np.random.Generator) -> dict[str, Float64[np.ndarray, "J"]]:
    size = spec.gravity
    if not size.enabled:
        return {}
    offset = per_joint(size.offset_nm, robot, "gravity.offset_nm")
    return {
        "gravity_error": size.error * rng.standard_normal(offset.size),
        "gravity_offset_nm": offset + size.spread_nm * rng.standard_normal(offset.size),
    }


def _elasticity(spec: LabSpec, robot: RobotSpec, rng: np.random.Generator) -> dict[str, Float64[np.ndarray, "J"]]:
    size = spec.elasticity
    if not size.enabled:
        return {}
    stiffness = per_joint(size.stiffness, robot, "elasticity.stiffness")
    damping = per_joint(size.damping, robot, "elasticity.damping")
    return {
        "stiffness": stiffness * np.exp(size.spread * rng.standard_normal(stiffness.size)),
        "damping": damping * np.exp(size.spread * rng.standard_normal(damping.size)),
    }


def _ripple(spec: LabSpec, robot: RobotSpec, rng: np.random.Generator) -> dict[str, Float64[np.ndarray, "J"]]:
    size = spec.ripple
    if not size.enabled:
        return {}
    amplitude = per_joint(size.amplitude_nm, robot, "ripple.amplitude_nm")
    return {
        "ripple_nm": amplitude * np.exp(size.spread * rng.standard_normal(amplitude.size)),
        "ripple_phase": rng.uniform(0.0, 2 * np.pi, amplitude.size),
        "ripple_phase_second": rng.uniform(0.0, 2 * np.pi, amplitude.size),
    }


def _bias(spec: LabSpec, robot: RobotSpec, rng: np.random.Generator) -> dict[str, Float64[np.ndarray, "J"]]:
    if not spec.readings.enabled:
        return {}
    return {"torque_bias_nm": spec.readings.torque_bias_nm * rng.standard_normal(len(robot.joints))}


def _winding(spec: LabSpec, robot: RobotSpec, rng: np.random.Generator) -> dict[str, Float64[np.ndarray, "J"]]:
    if spec.controller.kind != "servo":
        return {}
    motor, size, ones = robot.motor, spec.winding, np.ones(len(robot.joints))
    if motor is None:
        raise ConfigError(f"lab: a servo needs the motor of {robot.name!r}", hint="Write `motor` into its robot.yaml.")
    resistance, magnets, gear = np.exp(rng.standard_normal((3, ones.size)) * _spreads(size))
    return {
        "resistance_ohm": motor.resistance_ohm * resistance,
        "torque_constant_nm_a": motor.torque_constant_nm_a * magnets * gear,
        "back_emf_v_s_rad": motor.back_emf_v_s_rad * magnets,
        "voltage_limit": (motor.voltage_v + (size.supply_v * rng.standard_normal() if size.enabled else 0.0)) * ones,
    }


def _spreads(size: Winding) -> Float64[np.ndarray, "3 1"]:
    """Of resistance, magnets and gear; the last two make the torque constant."""
    share = size.torque_constant / np.sqrt(2)
    return np.array([[size.resistance], [share], [share]]) if size.enabled else np.zeros((3, 1))


def _mounts(spec: LabSpec, model: mujoco.MjModel, rng: np.random.Generator) -> dict[str, MountTruth]:
    size = spec.mounting
    if not size.enabled or (size.position_m == 0 and size.rotation_rad == 0):
        return {}
    if model.neq:
        raise ConfigError(
            f"lab: the parts of {spec.robot!r} cannot be mounted elsewhere: its chains are closed",
            got=f"mounting: position_m: {size.position_m:g}, rotation_rad: {size.rotation_rad:g}",
            expected="0 and 0",
        )
    mounts = {}
    for number in range(1, model.nbody):
        offset = size.position_m * rng.standard_normal(3)
        turn = size.rotation_rad * rng.standard_normal(3)
        if model.body_jntnum[number]:  # what has no joint is a part of the body that carries it
            mounts[model.body(number).name] = MountTruth(_three(offset), _three(turn))
    return mounts


def _three(values: Float64[np.ndarray, "3"]) -> tuple[float, float, float]:
    x, y, z = map(float, values)
    return x, y, z


def loaded(truth: Truth, model: mujoco.MjModel, payload_kg: float) -> dict[str, BodyTruth]:
    """The bodies with a payload at each site that the spec names.

    Raises:
        ConfigError: more than the limit or less than nothing, or the model has no such site.
    """
    spec, bodies = truth.spec, dict(truth.bodies)
    if not 0 <= payload_kg <= spec.payload_limit_kg:
        raise ConfigError(
            "the payload is out of range", got=f"{payload_kg} kg", expected=f"0 to {spec.payload_limit_kg}"
        )
    if payload_kg == 0:
        return bodies
    sites = {model.site(index).name: index for index in range(model.nsite)}
    for site in (spec.payload_site,) if isinstance(spec.payload_site, str) else spec.payload_site:
        if site not in sites:
            raise ConfigError(f"the model has no site {site!r} for a payload", available=sites)
        index = sites[site]
        axes = np.empty(9)
        mujoco.mju_quat2Mat(axes, model.site_quat[index])
        place = model.site_pos[index] + spec.payload_offset_m * axes.reshape(3, 3)[:, 2]
        name = model.body(model.site_bodyid[index]).name
        bodies[name] = with_ball(bodies.get(name) or body_of(model, name), payload_kg, place, spec.payload_radius_m)
    return bodies
