"""What a robot carries, from the first second of a motion: torques that its model without a payload leaves open.

Torques that bodies need are linear in the mass of a payload: measured - without = mass x (with 1 kg - without). The
mass is that of least squares over all samples and joints. What is wrong with the model and the sensors of one joint
stays the same over a second, so that samples say nothing of how far off it is; joints do, by the jackknife over them.
Friction may hold a part of every weight; so the interval has in it what that could be.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float, Float64

from trueup.errors import ConfigError, DataError
from trueup.robots import RobotSpec, Setup
from trueup.sim import MujocoSimulator

FIRST_S = 1.0
_COVERAGE, _WITHIN = 0.9, 1.645
_FEWEST = 8
# What the friction of a gear may take of its joint's largest torque, a standard deviation.
_FRICTION = 0.1
# Joints that feel this little of a kilogram say nothing of it [Nm/kg or N/kg].
_FELT = 1e-3


@dataclass(frozen=True)
class PayloadEstimate:
    """What a robot seems to carry.

    Attributes:
        payload_kg: not negative [kg].
        low_kg: lower end of the interval.
        high_kg: upper end.
        coverage: of the interval, as far as joints err independently.
    """

    payload_kg: float
    low_kg: float
    high_kg: float
    coverage: float = _COVERAGE


class PayloadEstimator:
    """For one kind of robot.

    Args:
        robot: its description, which says where a payload hangs.
        model: its MJCF or URDF.

    Raises:
        ConfigError: the robot carries nothing, or does not say its largest torques.
    """

    def __init__(self, robot: RobotSpec, model: Path) -> None:
        limits = [joint.torque_limit for joint in robot.joints if joint.torque_limit is not None]
        if len(limits) < len(robot.joints):
            raise ConfigError(
                f"robot {robot.name!r} does not say what its joints can do at most",
                hint="torque_limit of each joint in robot.yaml",
            )
        self._friction = _FRICTION * np.array(limits, float)
        self._models = [MujocoSimulator.from_robot(robot, model, setup=Setup(mass)).model for mass in (0.0, 1.0)]
        self.joints = robot.joint_names

    def of(
        self,
        time_s: Float[np.ndarray, "N"],
        position: Float[np.ndarray, "N J"],
        velocity: Float[np.ndarray, "N J"],
        torque: Float[np.ndarray, "N J"],
        *,
        first_s: float = FIRST_S,
    ) -> PayloadEstimate:
        """The payload of a log's first second.

        Args:
            time_s: increasing, (N,) [s].
            position: measured, joints in the robot's order, (N, J) [rad or m].
            velocity: likewise [rad/s or m/s].
            torque: likewise, between motor and link [Nm or N].
            first_s: how much of it is looked at [s].

        Raises:
            DataError: hardly a sample, values that are not finite, or joints that feel nothing of a payload.
        """
        shapes = {values.shape for values in (position, velocity, torque)}
        if shapes != {(len(time_s), len(self.joints))} or len(time_s) < _FEWEST:
            raise DataError(
                "a log for a payload", got=sorted(shapes), expected=f"({_FEWEST} or more, {len(self.joints)}) of each"
            )
        rows = slice(0, max(_FEWEST, int(np.searchsorted(time_s, time_s[0] + first_s, side="right"))))
        clock, given = time_s[rows], [values[rows].astype(np.float64) for values in (position, velocity, torque)]
        if not (np.isfinite(clock).all() and (np.diff(clock) > 0).all() and all(np.isfinite(g).all() for g in given)):
            raise DataError("a log for a payload", expected="increasing times and finite values")
        place, speed, measured = given
        acceleration = np.gradient(speed, clock, axis=0)
        without, loaded = (self._needed(model, place, speed, acceleration) for model in self._models)
        felt, unexplained = loaded - without, measured - without
        held = np.abs(felt).sum(axis=0) * self._friction
        return _least_squares((felt * unexplained).sum(axis=0), (felt**2).sum(axis=0), held, len(clock))

    def _needed(
        self,
        model: mujoco.MjModel,
        position: Float64[np.ndarray, "N J"],
        velocity: Float64[np.ndarray, "N J"],
        acceleration: Float64[np.ndarray, "N J"],
    ) -> Float64[np.ndarray, "N J"]:
        """Torques that the bodies need for a motion; friction and the motors' own inertia are on the other side."""
        data = mujoco.MjData(model)
        places = [int(model.joint(name).qposadr[0]) for name in self.joints]
        freedoms = [int(model.joint(name).dofadr[0]) for name in self.joints]
        out, whole = np.zeros(position.shape), np.zeros(model.nv)
        for row, pose in enumerate(position):
            data.qpos[places], data.qvel[freedoms] = pose, velocity[row]
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_fwdVelocity(model, data)
            data.qacc[freedoms] = acceleration[row]
            mujoco.mj_rne(model, data, 1, whole)
            out[row] = whole[freedoms]
        return out


def _least_squares(
    product: Float64[np.ndarray, "J"], square: Float64[np.ndarray, "J"], held: Float64[np.ndarray, "J"], samples: int
) -> PayloadEstimate:
    """From sums over samples, of each joint; `held` is how far friction could move its product."""
    feeling = square > samples * _FELT**2
    count = int(feeling.sum())
    if count < 2:
        raise DataError(
            "hardly a joint feels a payload in this second",
            got=f"{count} joints",
            expected="2 or more",
            hint="Move the arms away from where they hang straight down, or say what the robot carries.",
        )
    product, square, held = product[feeling], square[feeling], held[feeling]
    mass = product.sum() / square.sum()
    left_out = (product.sum() - product) / (square.sum() - square)
    apart = (count - 1) / count * np.sum((left_out - left_out.mean()) ** 2)
    error = np.sqrt(apart + np.sum(held**2) / square.sum() ** 2)
    half = _WITHIN * float(error)
    return PayloadEstimate(float(max(0.0, mass)), float(max(0.0, mass - half)), float(max(0.0, mass + half)))
