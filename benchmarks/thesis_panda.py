"""The experiment of the ES thesis (3.2): a published model of the Panda, and a hidden robot that differs from it.

The model has the friction of its Table 2.3 and the inertias of Gaz et al. (its [23]); the robot's friction and
inertias lie about those that the thesis found (Tables 3.4 and 3.5), and it has effects that the model cannot
express at all. Whoever fits gets the model and the recordings, never the robot.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import mujoco
import numpy as np
from jaxtyping import Float64

from trueup.core.atomic import write_text
from trueup.lab.simulated_robot import Sensors, SimulatedRobot
from trueup.policy.thesis_friction import PUBLISHED
from trueup.robots import JointFriction, RobotSpec, find_model, load_robot
from trueup.robots.model import compile_spec, load_spec
from trueup.sim import MujocoSimulator

# In the middle of every joint's range, so that no motion of the study ends at a limit of the robot [rad].
HOME = MappingProxyType(
    {"joint1": 0.0, "joint2": -0.3, "joint3": 0.0, "joint4": -1.7, "joint5": 0.0, "joint6": 1.8, "joint7": 0.0}
)

# ES thesis, Table 3.4, new values.
FOUND_FRICTION = (
    (3.40395, 9.67118, 6.748e-05),
    (1.97802, 28.66575, 0.00012),
    (2.51351, 9.82965, -0.00050),
    (2.43842, 18.77921, 0.00057),
    (2.59531, 4.19342, 0.00541),
    (1.19220, 5.74691, -0.00048),
    (1.54853, 1.69810, 0.00169),
)
# ES thesis, Table 3.5: new over old, the same for all six elements of a link up to rounding.
FOUND_INERTIA_SCALES = (0.728, 1.368, 1.137, 0.977, 1.206, 0.755, 1.184)

# Of the usual size for this arm, as it looks to the user of libfranka.
SENSORS = Sensors(
    position_noise_rad=3e-5,
    position_step_rad=2 * np.pi / 2**17,
    velocity_noise_rad_s=2e-3,
    torque_noise_nm=0.02,
)

_PHYSICS_STEP_S = 0.0005
_CONTROL_STEP_S = 0.001


@dataclass(frozen=True)
class HiddenPanda:
    """What is true of the hidden robot; one number per joint or link, in their order.

    Attributes:
        friction: the sigmoid of eq. 2.1.
        inertia_scale: factor on the inertia of each link.
        inertia_shear: entries of a matrix near the identity that deforms each link's mass distribution, (7, 3, 3).
        armature_scale: factor on the model's armature.
        frictionloss: dry friction on top of the sigmoid [Nm]; the model has none.
        damping: viscous friction on top of it [Nm s/rad]; the model has none.
        torque_offset: what hand-made gravity compensation (3.1.1) leaves [Nm]; the model has none.
        sensors: noise and resolution.
    """

    friction: tuple[JointFriction, ...]
    inertia_scale: tuple[float, ...]
    inertia_shear: tuple[tuple[tuple[float, ...], ...], ...]
    armature_scale: tuple[float, ...]
    frictionloss: tuple[float, ...]
    damping: tuple[float, ...]
    torque_offset: tuple[float, ...]
    sensors: Sensors = SENSORS

    @staticmethod
    def draw(seed: int) -> HiddenPanda:
        """A robot about as far from the published one as the thesis's, no two seeds alike."""
        rng = np.random.default_rng([2024, seed])
        level, slope, shift = np.array(FOUND_FRICTION).T
        level = level * np.exp(0.1 * rng.standard_normal(7))
        slope = slope * np.exp(0.2 * rng.standard_normal(7))
        shift = shift + 0.003 * rng.standard_normal(7)
        scale = np.array(FOUND_INERTIA_SCALES) * np.exp(0.05 * rng.standard_normal(7))
        shear = np.eye(3) + 0.03 * rng.standard_normal((7, 3, 3))
        return HiddenPanda(
            friction=tuple(
                JointFriction(sigmoid_level=float(a), sigmoid_slope=float(b), sigmoid_shift=float(c))
                for a, b, c in zip(level, slope, shift, strict=True)
            ),
            inertia_scale=_floats(scale),
            inertia_shear=tuple(tuple(_floats(row) for row in link) for link in shear),
            armature_scale=_floats(rng.uniform(0.9, 1.1, 7)),
            frictionloss=_floats(rng.uniform(0.02, 0.04, 7)),
            damping=_floats(rng.uniform(0.01, 0.05, 7)),
            torque_offset=_floats(rng.uniform(-0.01, 0.01, 7)),
        )

    def simulator(self) -> MujocoSimulator:
        """The true arm, simulated with half the time step of the model."""
        robot = load_robot("panda_torque")
        path = find_model(robot)
        spec = load_spec(path)
        for index, joint in enumerate(robot.joint_names):
            own = spec.joint(joint)
            own.damping[0] = self.damping[index]  # the other entries are coefficients of higher powers
            own.frictionloss = self.frictionloss[index]
            own.armature *= self.armature_scale[index]
            _deform(spec.body(f"link{index + 1}"), self.inertia_scale[index], np.array(self.inertia_shear[index]))
        simulation = replace(robot.simulation, timestep_s=_PHYSICS_STEP_S)
        friction = dict(zip(robot.joint_names, self.friction, strict=True))
        robot = replace(robot, friction=friction, simulation=simulation)
        simulator = MujocoSimulator.from_spec(spec, robot, origin=path)
        for channel, offset in zip(simulator.channels, self.torque_offset, strict=True):
            actuator = spec.actuator(channel.actuator)
            actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
            actuator.biasprm[0] = offset
        return MujocoSimulator(compile_spec(spec, path), robot, simulator.channels)

    def robot(self, *, seed: int = 0) -> SimulatedRobot:
        """The robot at rest in its home pose, with a control loop of 1 kHz; `seed` is that of the sensor noise."""
        simulator = self.simulator()
        return SimulatedRobot(
            simulator,
            position=np.array([HOME[joint] for joint in simulator.joints]),
            steps_per_control=round(_CONTROL_STEP_S / _PHYSICS_STEP_S),
            sensors=self.sensors,
            seed=seed,
        )


def published_panda(folder: Path) -> tuple[RobotSpec, Path]:
    """The model that a fit starts from: published friction and inertias, no other friction (ES thesis 2.4.2).

    Args:
        folder: where its MJCF is written.

    Returns:
        The robot and the file.
    """
    robot = load_robot("panda_torque")
    spec = load_spec(find_model(robot))
    for joint in spec.joints:
        joint.damping[0] = 0.0
        joint.frictionloss = 0.0
    path = folder / "panda.xml"
    write_text(path, spec.to_xml())
    friction = {
        joint: JointFriction(sigmoid_level=level, sigmoid_slope=slope, sigmoid_shift=shift)
        for joint, (level, slope, shift) in zip(robot.joint_names, PUBLISHED, strict=True)
    }
    return replace(robot, friction=friction, model=path.name), path


def _deform(body: mujoco.MjsBody, scale: float, shear: Float64[np.ndarray, "3 3"]) -> None:
    """Another inertia of the same mass about the same center.

    The second moment of a mass distribution, S = tr(I) / 2 - I, stays positive definite under A S A^T.
    """
    xx, yy, zz, xy, xz, yz = body.fullinertia
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    moment = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    moment = scale * shear @ moment @ shear.T
    inertia = np.trace(moment) * np.eye(3) - moment
    body.fullinertia = [inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2]]


def _floats(values: Float64[np.ndarray, "N"]) -> tuple[float, ...]:
    return tuple(map(float, values))
