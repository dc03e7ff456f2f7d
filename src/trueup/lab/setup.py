"""From an individual's truth to the arrays that the compiled loop works on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Bool, Float64

from trueup.errors import ConfigError
from trueup.lab.plant import JOINT_STATE, NUMBERS, Engine, Settings, State
from trueup.lab.spec import LabSpec
from trueup.lab.truth import BodyTruth, Truth, held_model, loaded, per_joint
from trueup.robots import RobotSpec, find_model, load_robot
from trueup.robots.holding import Holding
from trueup.robots.model import compile_spec, load_spec
from trueup.sim.closed_chains import open_by
from trueup.sim.stepping import addresses

# Makes an editable model of something that carries the robot, in which the robot has its own names.
Carrier = Callable[[], mujoco.MjSpec]
# Ends of closed chains that are no further apart are together [m or rad].
_CLOSED = 1e-4
# Explicit springs are stable up to frequency times step = 2; half of that is still accurate.
_STIFFEST = 1.0


@dataclass(frozen=True, eq=False)
class Plant:
    """A robot ready to be run: MuJoCo's model and data, and what is around them.

    Attributes:
        model: the links, with payload.
        data: their state.
        engine: both as arrays.
        numbers: of the joints, (J,) of NUMBERS.
        settings: what is no joint's own.
        state: what changes besides MuJoCo's own state.
        home: the model's keyframe `home`, or zero, (J,) [rad or m].
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    engine: Engine
    numbers: np.ndarray
    settings: Settings
    state: State
    home: Float64[np.ndarray, "J"]

    def position(self) -> Float64[np.ndarray, "J"]:
        """Of the links [rad or m]."""
        return np.asarray(self.data.qpos[self.engine.place])

    def velocity(self) -> Float64[np.ndarray, "J"]:
        """Of the links [rad/s or m/s]."""
        return np.asarray(self.data.qvel[self.engine.freedom])

    def place(self, position: Float64[np.ndarray, "J"]) -> None:
        """Put links and motors at rest into a pose, with springs that carry the weight.

        Raises:
            ConfigError: the pose would open a closed chain.
        """
        mujoco.mj_resetData(self.model, self.data)
        state = self.state
        self.data.qpos[self.engine.place] = position
        mujoco.mj_forward(self.model, self.data)
        apart = open_by(self.data)
        if apart > _CLOSED:
            raise ConfigError(
                "this pose opens a closed chain", got=f"{apart:.3g} m or rad", hint="Start from the model's own pose."
            )
        state.joints["spring"][:] = self.data.qfrc_bias[self.engine.freedom]
        stiffness = self.numbers["stiffness"]
        twist = np.divide(state.joints["spring"], stiffness, out=np.zeros_like(stiffness), where=stiffness > 0)
        state.joints["motor_position"][:] = position + twist
        state.joints["motor_velocity"][:] = 0.0
        state.joints["bristle"][:] = 0.0
        self._refuse_too_stiff()

    def warmth(self, speed: float, time_s: float) -> Float64[np.ndarray, "J"]:
        """How warm the joints are after moving at a speed about this pose, from cold, (J,) [K].

        Args:
            speed: of every joint [rad/s or m/s].
            time_s: [s].
        """
        windings = self.numbers["copper"] * np.square(self.state.joints["weight"])
        power = windings + self.numbers["coulomb_nm"] * speed
        share = -np.expm1(-time_s / self.settings.time_constant_s)
        return np.asarray(share * self.settings.rise_k_per_w * power)

    def _refuse_too_stiff(self) -> None:
        numbers, dt = self.numbers, self.settings.physics_step_s
        if not numbers["stiffness"].any():
            return
        inverse = np.empty((self.model.nv, self.model.nv))
        mujoco.mj_solveM(self.model, self.data, inverse, np.eye(self.model.nv))
        mobility = inverse[np.ix_(self.engine.freedom, self.engine.freedom)]
        link = np.linalg.eigvals(mobility * numbers["stiffness"]).real.max()
        motor = ((numbers["stiffness"] + numbers["kp"]) / numbers["motor_inertia"]).max()
        if dt * np.sqrt(max(link, motor)) > _STIFFEST:
            raise ConfigError(
                "lab: the joints' springs are too stiff for the physics step",
                got=f"{np.sqrt(max(link, motor)):.0f} rad/s at {dt} s",
                expected=f"at most {_STIFFEST / dt:.0f} rad/s",
                hint="Take a smaller physics_step_s, or softer springs.",
            )


def build_plant(truth: Truth, payload_kg: float, *, carrier: Carrier | None = None) -> Plant:
    """The robot of a truth, with a payload.

    Args:
        truth: the individual.
        payload_kg: [kg].
        carrier: makes a model of the robot on something that moves; held as in its own model if None.

    Raises:
        ConfigError: truth and model do not fit together, or the payload is out of range.
    """
    spec = truth.spec
    robot = load_robot(spec.robot)
    path = find_model(robot)
    editable = carrier() if carrier else load_spec(path)
    plain = held_model(robot, path)
    _refuse_other_robot(truth, robot, plain)
    bodies = loaded(truth, plain, payload_kg)
    known_share = spec.gravity.payload_known if spec.gravity.enabled else 1.0
    known = loaded(truth, plain, known_share * payload_kg)
    for name, body in bodies.items():
        own = editable.body(name)
        # However the model writes an inertia down (diagonal, turned), the full tensor takes its place.
        own.explicitinertial = True
        own.inertia = [0, 0, 0]
        own.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        own.mass, own.ipos, own.iquat, own.fullinertia = body.mass, body.com, [1, 0, 0, 0], body.inertia
    for actuator in list(editable.actuators):
        editable.delete(actuator)
    for key in editable.keys:
        key.act, key.ctrl = [], []
    for name, joint in truth.joints.items():
        own = editable.joint(name)
        own.damping[0] = 0.0
        own.frictionloss = 0.0
        # A motor behind a spring has a velocity of its own; a rigid one turns with the link.
        own.armature = 0.0 if joint.stiffness else joint.motor_inertia
    editable.option.timestep = spec.physics_step_s
    editable.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    editable.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    if not carrier:
        editable.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    holding = Holding() if carrier else Holding.of(editable, robot, origin=path)
    model = compile_spec(holding.applied(editable), path)
    _mount(model, truth)
    data = mujoco.MjData(model)
    homes = {plain.key(index).name: plain.key_qpos[index] for index in range(plain.nkey)}
    own = np.array([plain.joint(name).qposadr[0] for name in truth.joints])
    return Plant(
        model=model,
        data=data,
        engine=_engine(model, data, tuple(truth.joints), known),
        numbers=_numbers(truth, robot),
        settings=_settings(spec),
        state=_state(spec, len(truth.joints)),
        home=np.array(homes["home"][own] if "home" in homes else np.zeros(own.size)),
    )


def _mount(model: mujoco.MjModel, truth: Truth) -> None:
    """Move the bodies to where they sit."""
    for name, mount in truth.mounts.items():
        number = model.body(name).id
        turn, angle = np.array(mount.turn), float(np.linalg.norm(mount.turn))
        quaternion, before = np.empty(4), model.body_quat[number].copy()
        mujoco.mju_axisAngle2Quat(quaternion, turn / angle if angle else np.array([1.0, 0.0, 0.0]), angle)
        mujoco.mju_mulQuat(model.body_quat[number], before, quaternion)
        model.body_pos[number] += mount.offset
    if truth.mounts:
        mujoco.mj_setConst(model, mujoco.MjData(model))  # masses and inverse inertias that follow from the places


def _refuse_other_robot(truth: Truth, robot: RobotSpec, model: mujoco.MjModel) -> None:
    own = [model.joint(index).name for index in range(model.njnt)]
    kinds = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
    # Joints without a motor are those of closed chains; others would fall.
    others = [name for name in own if name not in robot.joint_names]
    if (
        not set(robot.joint_names) <= set(own)
        or (others and not model.neq)
        or not all(kind in kinds for kind in model.jnt_type)
    ):
        raise ConfigError(
            f"a virtual {robot.name!r} needs a model with its own hinges and slides, others in closed chains",
            got=own,
            expected=list(robot.joint_names),
        )
    bodies = [model.body(index).name for index in range(model.nbody)]
    if tuple(truth.joints) != robot.joint_names or not {*truth.bodies, *truth.mounts} <= set(bodies):
        raise ConfigError(
            f"the truth is not that of a {robot.name!r}", got=[*truth.joints, *truth.bodies], available=[*own, *bodies]
        )
    strange = [name for name in truth.spec.markers.bodies if name not in bodies[1:]]
    if strange:
        raise ConfigError(
            f"lab: {robot.name!r} has no body {strange[0]!r}, on which markers or mounting are", available=bodies[1:]
        )


def _engine(
    model: mujoco.MjModel, data: mujoco.MjData, joints: tuple[str, ...], known: Mapping[str, BodyTruth]
) -> Engine:
    column = np.array([model.joint(name).id for name in joints])
    mass, com = np.zeros(model.nbody), np.zeros((model.nbody, 3))
    for name, body in known.items():
        mass[model.body(name).id], com[model.body(name).id] = body.mass, body.com
    own, there = addresses(model, data)
    return Engine(
        model=own,
        data=there,
        qpos=data.qpos,
        qvel=data.qvel,
        qacc=data.qacc,
        applied=data.qfrc_applied,
        xpos=data.xpos,
        xmat=data.xmat,
        anchor=data.xanchor,
        axis=data.xaxis,
        column=column,
        place=model.jnt_qposadr[column].astype(np.int64),
        freedom=model.jnt_dofadr[column].astype(np.int64),
        hinge=np.array(model.jnt_type[column] == int(mujoco.mjtJoint.mjJNT_HINGE)),
        carries=_carries(model)[column],
        known_mass=mass,
        known_com=com,
        gravity=np.array(model.opt.gravity),
        pull=model.opt.gravity,
    )


def _carries(model: mujoco.MjModel) -> Bool[np.ndarray, "J B"]:
    """Whether a joint moves a body."""
    carries = np.zeros((model.njnt, model.nbody), bool)
    for body in range(1, model.nbody):
        ancestor = body
        while ancestor:
            first = model.body_jntadr[ancestor]
            carries[first : first + model.body_jntnum[ancestor], body] = True
            ancestor = model.body_parentid[ancestor]
    return carries


def _numbers(truth: Truth, robot: RobotSpec) -> np.ndarray:
    spec, joints = truth.spec, list(truth.joints.values())
    control, limits, warming = spec.controller, spec.saturation, spec.warming
    unlimited = np.full(len(joints), np.inf)
    torque = per_joint(limits.torque_nm, robot, "saturation.torque_nm")
    rate = per_joint(limits.torque_rate_nm_s, robot, "saturation.torque_rate_nm_s") * spec.control_step_s
    speed = per_joint(limits.no_load_speed, robot, "saturation.no_load_speed")
    shared = {
        "torque_limit": torque if limits.enabled else unlimited,
        "torque_rate": np.where(rate > 0, rate, np.inf) if limits.enabled and control.kind == "torque" else unlimited,
        "no_load_speed": np.where(speed > 0, speed, np.inf) if limits.enabled else unlimited,
        "brake_nm": 2.0 * torque,
        "copper": per_joint(warming.copper_w_per_nm2, robot, "warming.copper_w_per_nm2"),
        "kp": per_joint(control.stiffness, robot, "controller.stiffness"),
        "kd": per_joint(control.damping, robot, "controller.damping"),
    }
    numbers = np.zeros(len(joints), NUMBERS)
    for name in NUMBERS.names or ():
        numbers[name] = shared[name] if name in shared else [getattr(joint, name) for joint in joints]
    return numbers


def _settings(spec: LabSpec) -> Settings:
    delay, warming = spec.delay, spec.warming
    return Settings(
        physics_step_s=spec.physics_step_s,
        steps=round(spec.control_step_s / spec.physics_step_s),
        torque_control=spec.controller.kind == "torque",
        servo=spec.controller.kind == "servo",
        pd=spec.controller.kind == "pd",
        smoothing=float(-np.expm1(-2 * np.pi * spec.controller.cutoff_hz * spec.control_step_s)),
        delay=delay.delay_s / spec.control_step_s if delay.enabled else 0.0,
        jitter=delay.jitter_s / spec.control_step_s if delay.enabled else 0.0,
        ripple_periods=spec.ripple.periods_per_turn,
        rise_k_per_w=warming.rise_k_per_w if warming.enabled else 0.0,
        time_constant_s=warming.time_constant_s,
        softening=warming.softening if warming.enabled else 0.0,
    )


def _state(spec: LabSpec, joints: int) -> State:
    settings = _settings(spec)
    slots = int(np.ceil(settings.delay + settings.jitter)) + 2
    return State(
        joints=np.zeros(joints, JOINT_STATE),
        active=np.zeros((2, joints)),
        follows_velocity=np.zeros(1, np.int64),
        ring=np.zeros((slots, 2, joints)),
        ring_velocity=np.zeros(slots, np.int64),
        arrival=np.zeros(slots, np.int64),
        counters=np.zeros(3, np.int64),
    )
