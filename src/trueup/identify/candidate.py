"""A model under construction: what parameters write into, and what a simulation needs of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np

from trueup.errors import ConfigError
from trueup.identify.drive import Drive, drive_of
from trueup.identify.inertial import Inertial, apply_inertial, inertial_of, name_bodies, settle
from trueup.robots import AS_DESCRIBED, ControllerSpec, RobotSpec, Setup
from trueup.robots.model import compile_spec, load_spec
from trueup.sim import MujocoSimulator, attach_payload
from trueup.sim.controllers import Channel, scale_kp
from trueup.sim.friction import harden_friction, has_friction, install
from trueup.sim.payload import PREFIX

# Poses in which the size of a joint is looked at, and an acceleration that robots have [rad/s^2 or m/s^2].
_POSES, _USUAL_ACCELERATION = 32, 10.0
# Bandwidth of servos [rad/s].
_USUAL_RAD_S = 90.0
# The body of a payload that hangs by itself.
CARRIED = f"{PREFIX}carried"


@dataclass
class Candidate:
    """One choice of parameters, on its way to a compiled model.

    Attributes:
        spec: editable copy of the nominal model, controller included, and what is held in simulations.
        nominal: what the model said before.
        delay_s: joint name -> how much later its commands act [s].
        inertials: body name -> mass, centre of mass and inertia so far.
        deformations: body name -> log-Cholesky components of its inertia.
        payload: mass and place of what is carried, in the frame of its body.
        encoder_zeros: `MOTION:JOINT` -> what the joint's encoder read too little in that recording [rad or m]; not
            part of the model.
    """

    spec: mujoco.MjSpec
    nominal: Nominal
    delay_s: dict[str, float]
    inertials: dict[str, Inertial] = field(default_factory=dict)
    deformations: dict[str, dict[str, float]] = field(default_factory=dict)
    payload: dict[str, float] = field(default_factory=dict)
    encoder_zeros: dict[str, float] = field(default_factory=dict)

    def inertial(self, body: str) -> Inertial:
        """Mass, centre of mass and inertia of a body, as far as they have been written."""
        return self.inertials.get(body) or self.nominal.inertial(body)

    def finish(self) -> None:
        """Write the inertials into the spec; the last thing before it is compiled."""
        inertials = dict(self.inertials)
        for body, theta in self.deformations.items():
            inertials[body] = self.inertial(body).deformed(theta)
        if self.payload:
            body, _ = self.nominal.payload_place
            carried = self.nominal.carried(self.payload)
            if self.nominal.hangs_payloads:
                ball = self.spec.body(CARRIED) or self.spec.body(body).add_body(name=CARRIED)
                ball.explicitinertial, ball.mass, ball.ipos = True, carried.mass, carried.com
                ball.inertia = np.diag(carried.inertia)
            else:
                inertials[body] = (inertials.get(body) or self.inertial(body)).plus(carried)
        for body, inertial in inertials.items():
            apply_inertial(self.spec, body, inertial)

    def compile(self, setup: Setup = AS_DESCRIBED) -> mujoco.MjModel:
        """The finished model as it is in a motion; MuJoCo calls its friction laws from here on, if it has any.

        Raises:
            ConfigError: MuJoCo refuses it, it holds no payload, or has no gains to set.
        """
        self.finish()
        spec = self.spec
        if setup != AS_DESCRIBED:
            spec = spec.copy()
            attach_payload(spec, self.nominal.robot, setup.payload_kg)
        if setup.kp_factor != 1.0:
            scale_kp(spec, self.nominal.simulator.channels, setup.kp_factor, model=self.nominal.model)
        model = compile_spec(self.nominal.holding.applied(spec), self.nominal.path)
        if has_friction(model):
            install()
        return model

    def drive(self, joint: str, model: mujoco.MjModel) -> Drive:
        """What drives a joint of this candidate, compiled to `model`."""
        return drive_of(self.spec, model, self.nominal.channels(joint))

    @property
    def delays(self) -> np.ndarray:
        """Delays in the robot's joint order, (J,) [s]."""
        return np.array([self.delay_s[joint] for joint in self.nominal.robot.joint_names])


@dataclass(frozen=True)
class JointSize:
    """How large the numbers of a joint are, whatever the robot.

    Attributes:
        inertia: of what the joint turns, without its rotor, the mean over poses; or of what a servo of this stiffness
            moves at a usual bandwidth, if that is more, as behind the gears of a wrist [kg m^2 or kg].
        torque: usual torque: of the weight in the worst pose, or of an acceleration of 10 rad/s^2 (or m/s^2) if that is
            more [Nm or N].
    """

    inertia: float
    torque: float


class Nominal:
    """The model as it came, with its controller put into it, so that every number stands in one place: the model.

    Args:
        robot: its description.
        path: MJCF or URDF.
        hard_friction: let the constraint solver hold dry friction as if it were rigid. MuJoCo's default is soft: a
            joint creeps under a load that it should hold, and standing errors disappear that a robot has.
        payload_at: body or site that carries what a fit hangs on; the site `payload`, or the last body, if empty.

    Attributes:
        robot: the description, with controller kind `model`.
        simulator: of the nominal model.
        spec: the model, editable, with all that is held in simulations; copy it before writing.
        holding: what that is.
        hard_friction: as given.
    """

    def __init__(self, robot: RobotSpec, path: Path, *, hard_friction: bool = True, payload_at: str = "") -> None:
        self.path = path
        self.given = robot
        self.hard_friction = hard_friction
        self.payload_at = payload_at
        self.spec = load_spec(path, shapes=robot.simulation.contacts)
        name_bodies(self.spec)
        self.simulator = MujocoSimulator.from_spec(self.spec, robot, origin=path)
        self.holding = self.simulator.holding
        changed = settle(self.spec, self.simulator.model)
        if hard_friction:
            harden_friction(self.spec, robot.joint_names)
        if hard_friction or changed:
            model = compile_spec(self.holding.applied(self.spec), path)
            self.simulator = MujocoSimulator(model, robot, self.simulator.channels, self.holding)
        self.robot = _with_model_controller(robot)
        self._inertials: dict[str, Inertial] = {}

    @property
    def model(self) -> mujoco.MjModel:
        """The nominal model, compiled."""
        return self.simulator.model

    def candidate(self) -> Candidate:
        """A fresh copy of the nominal model."""
        joints = self.robot.joint_names
        return Candidate(
            spec=self.spec.copy(),
            nominal=self,
            delay_s=dict(zip(joints, self.given.replay_delay_s, strict=True)),
        )

    def inertial(self, body: str) -> Inertial:
        """Mass, centre of mass and inertia of a body of the nominal model."""
        if body not in self._inertials:
            self._inertials[body] = inertial_of(self.model, body)
        return self._inertials[body]

    def channels(self, joint: str) -> tuple[Channel, ...]:
        """How the commands of a joint reach its actuators."""
        return tuple(channel for channel in self.simulator.channels if channel.joint == joint)

    def drive(self, joint: str) -> Drive:
        """What drives a joint of the nominal model."""
        return drive_of(self.spec, self.model, self.channels(joint))

    def size(self, joint: str) -> JointSize:
        """How large the numbers of a joint are."""
        dof = int(self.model.jnt_dofadr[self.model.joint(joint).id])
        inertia, weight = self._poses
        # Of a joint that turns next to nothing, something that can be divided by.
        own = max(float(inertia[dof]), (self.drive(joint).kp or 0.0) / _USUAL_RAD_S**2, 1e-7)
        return JointSize(own, max(float(weight[dof]), _USUAL_ACCELERATION * own))

    @cached_property
    def _poses(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean diagonal of the mass matrix without rotors, and largest weight, over poses; (V,) each."""
        model, data = self.model, mujoco.MjData(self.model)
        rng = np.random.default_rng(0)
        inertia, weight = np.zeros(model.nv), np.zeros(model.nv)
        low, high = np.full(model.njnt, -np.pi / 2), np.full(model.njnt, np.pi / 2)
        limited = model.jnt_limited.astype(bool)
        low[limited], high[limited] = model.jnt_range[limited].T
        turning = np.isin(model.jnt_type, (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)))
        column, unit = np.zeros(model.nv), np.eye(model.nv)
        for _ in range(_POSES):
            mujoco.mj_resetData(model, data)
            data.qpos[model.jnt_qposadr[turning]] = rng.uniform(low, high)[turning]
            mujoco.mj_forward(model, data)
            for dof in range(model.nv):
                mujoco.mj_mulM(model, data, column, unit[dof])
                inertia[dof] += (column[dof] - model.dof_armature[dof]) / _POSES
            weight = np.maximum(weight, np.abs(data.qfrc_bias - data.qfrc_gravcomp))
        return inertia, weight

    @property
    def commanded_limits(self) -> dict[str, float]:
        """Joint name -> largest commanded torque that reaches the joint [Nm or N], where it is limited."""
        limits = self.simulator.torque_limits
        return {joint: limit / (self.drive(joint).torque_gain or 1.0) for joint, limit in limits.items()}

    def length_unit(self, joint: str) -> Literal["rad", "m"]:
        """Unit of a joint's position."""
        return "m" if self.model.joint(joint).type[0] == mujoco.mjtJoint.mjJNT_SLIDE else "rad"

    @property
    def bodies(self) -> tuple[str, ...]:
        """Bodies that move with a joint of the robot, in the model's order.

        What lies about in the scene is not among them: a tree of bodies without such a joint, unless constraints or
        tendons tie trees to each other.
        """
        model = self.model
        own = {int(model.body_treeid[model.joint(name).bodyid[0]]) for name in self.robot.joint_names}
        tied = model.neq + model.ntendon > 0
        return tuple(
            model.body(body).name
            for body in range(1, model.nbody)
            if (tree := int(model.body_treeid[body])) >= 0
            and (tied or tree in own)
            and not model.body(body).name.startswith(PREFIX)
        )

    @cached_property
    def rigid_groups(self) -> tuple[tuple[str, ...], ...]:
        """The moving bodies, those together that are welded to each other, of which only the sum can be seen.

        First in its group is the one that stands for it in a fit: the one with the joint if that has mass, else the
        heaviest.
        """
        model = self.model
        groups: dict[int, list[str]] = {}
        for name in self.bodies:
            groups.setdefault(int(model.body_weldid[model.body(name).id]), []).append(name)
        return tuple(tuple(_leading(model, group)) for group in groups.values())

    @property
    def _payload_site(self) -> int:
        """The site that says where a payload hangs; -1 without."""
        name = self.payload_at or "payload"
        if name in self.bodies:
            return -1
        return int(mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_SITE, name))

    @cached_property
    def payload_place(self) -> tuple[str, tuple[float, float, float]]:
        """Body that carries the payload and where in its frame: the site `payload`, or the last body's origin.

        Raises:
            ConfigError: no body moves, or nothing that moves has the name that was given.
        """
        model, site = self.model, self._payload_site
        if self.payload_at in self.bodies:
            return self.payload_at, (0.0, 0.0, 0.0)
        body = model.body(int(model.site_bodyid[site])).name if site >= 0 else ""
        if site >= 0 and (not self.payload_at or body in self.bodies):
            x, y, z = map(float, model.site_pos[site])
            return body, (x, y, z)
        if self.payload_at:
            sites = [model.site(number).name for number in range(model.nsite)]
            raise ConfigError(
                f"{self.path}: nothing that moves can carry a payload at {self.payload_at!r}",
                expected="a body or site of the model that moves with a joint of the robot",
                available=[*self.bodies, *(name for name in sites if name and not name.startswith("trueup."))],
            )
        if not self.bodies:
            raise ConfigError(f"{self.path}: no body moves, so nothing can carry a payload")
        return self.bodies[-1], (0.0, 0.0, 0.0)

    @property
    def carrier(self) -> str:
        """The body that stands in a fit for those which a payload hangs on."""
        body, _ = self.payload_place
        return next(group[0] for group in self.rigid_groups if body in group)

    @cached_property
    def payload_start(self) -> tuple[float, float, float]:
        """How far from its place a payload is looked for first: at the site `payload`, or amid what carries it [m].

        The origin of the last body is at its joint, with what is carried far outside: from there, a search may
        end on the wrong side.
        """
        model, (body, _) = self.model, self.payload_place
        last = model.body(body).id
        welded = np.flatnonzero(model.body_weldid == model.body_weldid[last])
        masses = model.body_mass[welded]
        if self._payload_site >= 0 or not masses.any():
            return (0.0, 0.0, 0.0)
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        center = masses @ data.xipos[welded] / masses.sum()
        x, y, z = map(float, data.xmat[last].reshape(3, 3).T @ (center - data.xpos[last]))
        return x, y, z

    @property
    def hangs_payloads(self) -> bool:
        """Whether a payload is a body of its own: it weighs, also where the weight of what carries it does not."""
        body, _ = self.payload_place
        return bool(self.model.body_gravcomp[self.model.body(body).id])

    def carried(self, payload: Mapping[str, float]) -> Inertial:
        """A payload in the frame of the body that carries it.

        Args:
            payload: its `mass` [kg], how far it is from its place along `x`, `y` and `z` [m], and its `inertia` about
                each axis per mass: its radius of gyration, squared [m2].
        """
        _, site = self.payload_place
        mass, place = payload.get("mass", 0.0), np.array(site) + [payload.get(axis, 0.0) for axis in "xyz"]
        return Inertial(mass, place, mass * payload.get("inertia", 0.0) * np.eye(3))


def _leading(model: mujoco.MjModel, group: list[str]) -> list[str]:
    """The same bodies, first the one that stands for all."""
    masses = [float(model.body(name).mass[0]) for name in group]
    first = 0 if masses[0] > 0 else int(np.argmax(masses))
    return [group[first], *group[:first], *group[first + 1 :]]


def _with_model_controller(robot: RobotSpec) -> RobotSpec:
    """The description of what stands in the model by now: its controller, and its laws of friction."""
    if robot.controller.kind == "model":
        return replace(robot, friction={})
    delays = {name: gains for name, gains in robot.controller.per_joint.items() if gains.delay_s is not None}
    controller = ControllerSpec(
        kind="model",
        command=robot.controller.signal,
        delay_s=robot.controller.delay_s,
        source=robot.controller.source,
        kp_setting=robot.controller.kp_setting,
        per_joint={name: replace(gains, kp=None, kv=None, ki=None) for name, gains in delays.items()},
    )
    return replace(robot, controller=controller, friction={})
