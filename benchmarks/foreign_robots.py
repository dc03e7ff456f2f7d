"""Robots of other people, held: one arm, leg or hand cut out of a model, with the drive that its user would have.

Nothing of trueup is imported: this makes data whose answer is known and that no code of the project has made.
"""

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np

Drive = Literal["position", "torque", "velocity"]
STEP_S = 0.002  # of the model that a user has
OWN = Path(__file__).resolve().parents[1] / "src" / "trueup" / "robots" / "models"
_WITHOUT_FRICTION = mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_DAMPER


@dataclass(frozen=True)
class Robot:
    """One held robot.

    Attributes:
        name: short name.
        file: MJCF, in `shared/data/foreign` or among the project's own models.
        joints: joints that stay; all others are welded, and branches that do not move are left out.
        home: middle of the motions [rad or m], (J,).
        amplitude: largest distance from there [rad or m], (J,).
        kp: gains of position servos, (J,) or one [Nm/rad]; the model's own actuators if not given.
        kv: their damping, (J,) or one [Nm s/rad].
        velocity_kv: gains of velocity servos, (J,) or one [Nm s/rad].
        limit: torque limits of drives that the model does not have, (J,) or one [Nm].
        frictionloss: dry friction in the nominal model [Nm]; the model's own if not given.
        damping: viscous friction there, (J,) [Nm s/rad]; likewise.
        own: whether the model is the project's.
    """

    name: str
    file: str
    joints: tuple[str, ...]
    home: tuple[float, ...]
    amplitude: tuple[float, ...]
    kp: tuple[float, ...] | float | None = None
    kv: tuple[float, ...] | float = 0.0
    velocity_kv: tuple[float, ...] | float | None = None
    limit: tuple[float, ...] | float | None = None
    frictionloss: float | None = None
    damping: tuple[float, ...] | None = None
    own: bool = False

    def path(self) -> Path:
        """The original model. Raises FileNotFoundError, with what to set, if it is not there."""
        path = (OWN if self.own else foreign_folder()) / self.file
        if not path.is_file():
            raise FileNotFoundError(f"no model {path}: set TRUEUP_SHARED, or put `shared` beside the project")
        return path

    def nominal(self, drive: Drive) -> mujoco.MjSpec:
        """The model that a user has: original numbers, a step of 2 ms, one named actuator for each joint."""
        spec = mujoco.MjSpec.from_file(str(self.path()))
        spec.option.timestep = STEP_S
        _cut(spec, set(self.joints))
        self._drive(spec, drive)
        for index, name in enumerate(self.joints):
            if self.frictionloss is not None:
                spec.joint(name).frictionloss = self.frictionloss
            if self.damping is not None:
                spec.joint(name).damping[0] = self.damping[index]
        spec.compile()
        return spec

    def _drive(self, spec: mujoco.MjSpec, drive: Drive) -> None:
        published = {a.target: a for a in spec.actuators if a.target in self.joints}
        servos = all(a.biastype == mujoco.mjtBias.mjBIAS_AFFINE for a in published.values()) and bool(published)
        keep = self.kp is None and drive == ("position" if servos else "torque") and bool(published)
        for actuator in list(spec.actuators):
            if not keep or actuator.target not in self.joints:
                spec.delete(actuator)
            else:
                actuator.name = actuator.target
        if keep:
            return
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST  # damping of servos on light links
        kp, kv, velocity, limit = (
            np.broadcast_to(np.nan if value is None else value, len(self.joints))
            for value in (self.kp, self.kv, self.velocity_kv, self.limit)
        )
        for index, joint in enumerate(self.joints):
            actuator = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            actuator.ctrllimited = mujoco.mjtLimited.mjLIMITED_FALSE  # whatever the model's defaults are
            actuator.gainprm[0] = {"position": kp[index], "velocity": velocity[index], "torque": 1.0}[drive]
            if drive != "torque":
                actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
                actuator.biasprm[1] = -kp[index] if drive == "position" else 0.0
                actuator.biasprm[2] = -(kv if drive == "position" else velocity)[index]
            if np.isnan(actuator.gainprm[0]):
                raise ValueError(f"robot {self.name} has no gains for drive {drive}")
            if np.isfinite(limit[index]):
                actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
                actuator.forcerange = [-limit[index], limit[index]]


def foreign_folder() -> Path:
    """Where the models of other people are: in TRUEUP_SHARED, or in `shared` beside the project."""
    beside = Path(__file__).resolve().parents[2] / "shared"
    return Path(os.environ.get("TRUEUP_SHARED", beside)) / "data" / "foreign"


def _cut(spec: mujoco.MjSpec, joints: set[str]) -> None:
    """Weld all other joints, and take out what neither moves nor carries what moves."""
    for group in (spec.keys, spec.equalities, spec.tendons, spec.excludes, spec.sensors):
        for element in list(group):
            spec.delete(element)
    for actuator in list(spec.actuators):
        if actuator.trntype != mujoco.mjtTrn.mjTRN_JOINT or actuator.target not in joints:
            spec.delete(actuator)
    for joint in list(spec.joints):
        if joint.name not in joints:
            spec.delete(joint)

    def prune(body: Any) -> None:
        for child in list(body.bodies):
            if any(joint.name in joints for joint in child.joints):
                continue  # it moves, with all that hangs at it
            if child.find_all("joint"):
                prune(child)
            else:
                spec.delete(child)

    prune(spec.worldbody)


def joint_dofs(model: mujoco.MjModel, joints: tuple[str, ...]) -> list[int]:
    """Index of each joint's degree of freedom; its position has the same in a held robot."""
    return [int(model.jnt_dofadr[model.joint(name).id]) for name in joints]


def torque_limits(model: mujoco.MjModel, joints: tuple[str, ...]) -> np.ndarray:
    """Largest torque of each joint's actuator, (J,); infinite where the model has no limit."""
    limits = np.full(len(joints), np.inf)
    for index, name in enumerate(joints):
        actuator = model.actuator(name).id
        if model.actuator_forcelimited[actuator]:
            limits[index] = model.actuator_forcerange[actuator, 1]
        elif model.actuator_biastype[actuator] == 0 and model.actuator_ctrllimited[actuator]:
            limits[index] = model.actuator_ctrlrange[actuator, 1]
    return limits


def inverse_dynamics(model: mujoco.MjModel, joints: tuple[str, ...], *track: np.ndarray) -> np.ndarray:
    """Torques along positions, velocities and accelerations, each (T, J), without any friction, (T, J)."""
    dofs, data = joint_dofs(model, joints), mujoco.MjData(model)
    flags = model.opt.disableflags
    model.opt.disableflags = flags | _WITHOUT_FRICTION
    torques = np.empty_like(track[0])
    for row, (q, v, a) in enumerate(zip(*track, strict=True)):
        data.qpos[dofs], data.qvel[dofs], data.qacc[dofs] = q, v, a
        mujoco.mj_inverse(model, data)
        torques[row] = data.qfrc_inverse[dofs]
    model.opt.disableflags = flags
    return torques


def carried_inertia(model: mujoco.MjModel, joints: tuple[str, ...], home: tuple[float, ...]) -> np.ndarray:
    """Inertia that each joint moves when the others are locked, without armature, (J,)."""
    dofs, data = joint_dofs(model, joints), mujoco.MjData(model)
    data.qpos[dofs] = home
    mujoco.mj_forward(model, data)
    full = np.empty((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return np.diag(full)[dofs] - model.dof_armature[dofs]


_UR5E = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
_H1_LEG = tuple(f"left_{part}" for part in ("hip_yaw", "hip_roll", "hip_pitch", "knee", "ankle"))
_H1_ARM = tuple(f"left_{part}" for part in ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow"))
_G1_ARM = tuple(
    f"left_{part}_joint"
    for part in ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow", "wrist_roll", "wrist_pitch", "wrist_yaw")
)
_G1_LEG = tuple(
    f"left_{part}_joint" for part in ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")
)
_GR1_ARM = tuple(
    f"r_{part}"
    for part in (
        *("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow_pitch"),
        *("wrist_yaw", "wrist_roll", "wrist_pitch"),
    )
)
_TIDYBOT = tuple(f"joint_{number}" for number in range(1, 8))
_VX300S = Robot(
    name="vx300s",
    file="vx300s.xml",
    joints=tuple(
        f"vx300s_left/{part}" for part in ("waist", "shoulder", "elbow", "forearm_roll", "wrist_angle", "wrist_rotate")
    ),
    home=(0.0, -0.6, 0.5, 0.0, -0.2, 0.0),
    amplitude=(0.7, 0.5, 0.5, 0.7, 0.6, 0.8),
)
_FINGER_HOME, _FINGER_AMPLITUDE = (0.0, 0.7, 0.75, 0.7), (0.3, 0.55, 0.55, 0.55)

ROBOTS: dict[str, Robot] = {
    robot.name: robot
    for robot in (
        Robot(
            name="ur5e",
            file="ur5e.xml",
            joints=_UR5E,
            home=(-1.57, -1.57, 1.57, -1.57, -1.57, 0.0),
            amplitude=(0.9, 0.6, 0.7, 0.9, 0.9, 1.1),
            limit=(150.0, 150.0, 150.0, 28.0, 28.0, 28.0),
            velocity_kv=(300.0, 300.0, 150.0, 25.0, 20.0, 15.0),
        ),
        Robot(
            name="iiwa14",
            file="iiwa14.xml",
            joints=tuple(f"joint{number}" for number in range(1, 8)),
            home=(0.0, 0.3, 0.0, -1.2, 0.0, 0.8, 0.0),
            amplitude=(0.8, 0.55, 0.8, 0.6, 0.9, 0.7, 1.0),
            limit=(320.0, 320.0, 176.0, 176.0, 110.0, 40.0, 40.0),
        ),
        _VX300S,
        # The model's 30 to 60 Nm of dry friction stand for damping.
        replace(_VX300S, name="vx300s_smooth", frictionloss=0.0, damping=(4.0, 8.0, 4.0, 0.1, 0.4, 0.15)),
        Robot(
            name="h1_leg",
            file="h1.xml",
            joints=_H1_LEG,
            home=(0.0, 0.0, -0.4, 0.8, -0.2),
            amplitude=(0.3, 0.3, 0.6, 0.6, 0.4),
        ),
        Robot(
            name="h1_legs",
            file="h1.xml",
            joints=_H1_LEG + tuple(name.replace("left", "right") for name in _H1_LEG),
            home=(0.0, 0.0, -0.4, 0.8, -0.2) * 2,
            amplitude=(0.3, 0.3, 0.6, 0.6, 0.4) * 2,
            kp=(150.0, 150.0, 200.0, 200.0, 40.0) * 2,
            kv=(5.0, 5.0, 5.0, 5.0, 2.0) * 2,
            limit=(200.0, 200.0, 200.0, 300.0, 40.0) * 2,
        ),
        Robot(
            name="h1_arms",
            file="h1.xml",
            joints=_H1_ARM + tuple(name.replace("left", "right") for name in _H1_ARM),
            home=(0.2, 0.5, 0.3, 0.6, 0.2, -0.5, -0.3, 0.6),
            amplitude=(0.8, 0.5, 0.7, 0.7) * 2,
            kp=(100.0, 100.0, 50.0, 50.0) * 2,
            kv=(2.0, 2.0, 2.0, 2.0) * 2,
            limit=(40.0, 40.0, 18.0, 18.0) * 2,
        ),
        Robot(
            name="g1_arm",
            file="g1.xml",
            joints=_G1_ARM,
            home=(0.0, 0.5, 0.0, 0.6, 0.0, 0.0, 0.0),
            amplitude=(0.8, 0.6, 0.8, 0.7, 0.8, 0.7, 0.7),
            kp=(40.0, 40.0, 40.0, 40.0, 20.0, 20.0, 20.0),
            kv=(1.0, 1.0, 1.0, 1.0, 0.5, 0.5, 0.5),
            limit=(25.0, 25.0, 25.0, 25.0, 25.0, 5.0, 5.0),
        ),
        Robot(
            name="g1_leg",
            file="g1.xml",
            joints=_G1_LEG,
            home=(-0.3, 0.3, 0.0, 0.7, -0.2, 0.0),
            amplitude=(0.6, 0.4, 0.6, 0.6, 0.4, 0.15),
            kp=(100.0, 100.0, 100.0, 150.0, 40.0, 40.0),
            kv=(2.0, 2.0, 2.0, 4.0, 2.0, 2.0),
            limit=(88.0, 139.0, 88.0, 139.0, 50.0, 50.0),
        ),
        Robot(
            name="gr1_arm",
            file="gr1.xml",
            joints=_GR1_ARM,
            home=(0.0, -0.65, 0.0, -1.2, 0.0, 0.0, 0.0),
            amplitude=(0.8, 0.45, 0.8, 0.7, 0.9, 0.7, 0.7),
            kp=(90.0, 90.0, 60.0, 60.0, 20.0, 15.0, 15.0),
            kv=(6.0, 6.0, 4.0, 4.0, 1.0, 0.6, 0.6),
            velocity_kv=(25.0, 25.0, 12.0, 12.0, 3.0, 2.0, 2.0),
            limit=(38.0, 38.0, 30.0, 30.0, 10.2, 4.0, 4.0),
        ),
        Robot(
            name="allegro",
            file="allegro.xml",
            joints=tuple(f"{finger}j{number}" for finger in ("ff", "mf", "rf", "th") for number in range(4)),
            home=_FINGER_HOME * 3 + (0.83, 0.53, 0.7, 0.75),
            amplitude=_FINGER_AMPLITUDE * 3 + (0.4, 0.45, 0.55, 0.55),
        ),
        Robot(
            name="tidybot_arm",
            file="tidybot.xml",
            joints=_TIDYBOT,
            home=(0.0, 0.4, 3.14, -1.9, 0.0, 0.9, 1.57),
            amplitude=(0.8, 0.5, 0.7, 0.5, 0.8, 0.6, 0.9),
        ),
        Robot(
            name="tidybot",
            file="tidybot.xml",
            joints=("joint_x", "joint_y", "joint_th", *_TIDYBOT),
            home=(0.0, 0.0, 0.0, 0.0, 0.4, 3.14, -1.9, 0.0, 0.9, 1.57),
            amplitude=(0.35, 0.35, 0.8, 0.8, 0.5, 0.7, 0.5, 0.8, 0.6, 0.9),
            velocity_kv=(900.0, 900.0, 60.0, 60.0, 60.0, 40.0, 40.0, 12.0, 12.0, 8.0),
            limit=(900.0, 900.0, 300.0, 105.0, 105.0, 105.0, 105.0, 52.0, 52.0, 52.0),
        ),
        Robot(
            name="panda",
            file="panda.xml",
            joints=tuple(f"joint{number}" for number in range(1, 8)),
            home=(0.0, -0.6, 0.0, -2.0, 0.0, 1.7, 0.8),
            amplitude=(0.8, 0.5, 0.7, 0.6, 0.8, 0.7, 0.9),
            kp=(600.0, 600.0, 600.0, 600.0, 250.0, 150.0, 50.0),
            kv=(50.0, 50.0, 50.0, 50.0, 30.0, 25.0, 15.0),
            velocity_kv=(120.0, 160.0, 80.0, 80.0, 30.0, 20.0, 10.0),
            limit=(87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0),
            own=True,
        ),
        Robot(
            name="demo_arm",
            file="demo_arm.xml",
            joints=("yaw", "shoulder", "elbow"),
            home=(0.0, -0.6, 0.7),
            amplitude=(0.9, 0.7, 0.9),
            own=True,
        ),
    )
}
