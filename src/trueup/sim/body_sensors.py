"""Bodies of a rollout in MuJoCo: pose, velocity and the wrench on each, read from sensors in the engine (SAT, IV-A).

The same as `blocks.blocks_of` works out from states, for the frame's origin in place of the center of mass.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from jaxtyping import Float64

from trueup.core.timeseries import BODY_PREFIX
from trueup.errors import NameMismatch
from trueup.robots.model import gravity_of

# Quantity -> kind of sensor, and the frame that it is of: that of the body, or that of its center of mass.
_SENSORS = {
    "position": (mujoco.mjtSensor.mjSENS_FRAMEPOS, mujoco.mjtObj.mjOBJ_XBODY),
    "quaternion": (mujoco.mjtSensor.mjSENS_FRAMEQUAT, mujoco.mjtObj.mjOBJ_XBODY),
    "velocity": (mujoco.mjtSensor.mjSENS_FRAMELINVEL, mujoco.mjtObj.mjOBJ_XBODY),
    "angular_velocity": (mujoco.mjtSensor.mjSENS_FRAMEANGVEL, mujoco.mjtObj.mjOBJ_XBODY),
    "inertial": (mujoco.mjtSensor.mjSENS_FRAMEQUAT, mujoco.mjtObj.mjOBJ_BODY),
    "acceleration": (mujoco.mjtSensor.mjSENS_FRAMELINACC, mujoco.mjtObj.mjOBJ_BODY),
    "angular_acceleration": (mujoco.mjtSensor.mjSENS_FRAMEANGACC, mujoco.mjtObj.mjOBJ_BODY),
}
BODY_SIGNALS = tuple(
    f"{BODY_PREFIX}{name}" for name in ("position", "rotation", "velocity", "angular_velocity", "force", "torque")
)


def add_body_sensors(spec: mujoco.MjSpec, bodies: Sequence[str]) -> None:
    """Put sensors on these bodies.

    Raises:
        NameMismatch: there is no such body; both lists are printed.
    """
    known = [body.name for body in spec.bodies if body is not spec.worldbody]
    missing = [name for name in bodies if name not in known]
    if missing:
        raise NameMismatch(
            f"simulation: bodies {missing} are not in the model", left=bodies, right=known, right_name="model has"
        )
    for name in bodies:
        for quantity, (kind, frame) in _SENSORS.items():
            spec.add_sensor(name=_name(name, quantity), type=kind, objtype=frame, objname=name)


class BodySensors:
    """Reads what `add_body_sensors` has put into a model.

    Args:
        model: compiled.
        bodies: names of M bodies.
    """

    def __init__(self, model: mujoco.MjModel, bodies: Sequence[str]) -> None:
        numbers = [model.body(name).id for name in bodies]
        self._model = model
        self._still = model.body_weldid[numbers] == 0
        self._mass = model.body_mass[numbers]
        self._inertia = model.body_inertia[numbers]
        self._columns = {}
        for quantity, (kind, _) in _SENSORS.items():
            first = [int(model.sensor_adr[model.sensor(_name(name, quantity)).id]) for name in bodies]
            width = 4 if kind == mujoco.mjtSensor.mjSENS_FRAMEQUAT else 3
            self._columns[quantity] = np.array(first)[:, None] + np.arange(width)

    def read(self, sensors: Float64[np.ndarray, "*B D"]) -> dict[str, Float64[np.ndarray, "*B M ..."]]:
        """`BODY_SIGNALS` of all samples: rotations (..., M, 3, 3), all else (..., M, 3), in the axes of the world.

        Force and torque are what everything but gravity does to a body, the torque about its center of mass; they are
        worked out from its motion: m (a - g), and I dw/dt + w x I w.
        """
        found = {quantity: sensors[..., columns] for quantity, columns in self._columns.items()}
        # MuJoCo's linear acceleration has what holds a body against gravity in it, but not of bodies that cannot move.
        felt = np.where(self._still[:, None], -gravity_of(self._model), found["acceleration"])
        wrench = body_wrench(
            self._mass,
            self._inertia,
            matrices_of(found["inertial"]),
            felt=felt,
            spin=found["angular_velocity"],
            turning=found["angular_acceleration"],
        )
        pose = found["position"], matrices_of(found["quaternion"])
        values = (*pose, found["velocity"], found["angular_velocity"], *wrench)
        return dict(zip(BODY_SIGNALS, values, strict=True))


def body_wrench(
    mass: Float64[np.ndarray, "M"],
    inertia: Float64[np.ndarray, "M 3"],
    axes: Float64[np.ndarray, "*B M 3 3"],
    *,
    felt: Float64[np.ndarray, "*B M 3"],
    spin: Float64[np.ndarray, "*B M 3"],
    turning: Float64[np.ndarray, "*B M 3"],
) -> tuple[Float64[np.ndarray, "*B M 3"], Float64[np.ndarray, "*B M 3"]]:
    """Force and torque about the center of mass that move bodies as they move; gravity is not among them.

    Args:
        mass: (M,) [kg].
        inertia: about the principal axes, (M, 3) [kg m2].
        axes: the principal axes as columns, (..., M, 3, 3).
        felt: acceleration of the center of mass minus gravity, (..., M, 3) [m/s2].
        spin: angular velocity, (..., M, 3) [rad/s].
        turning: angular acceleration, (..., M, 3) [rad/s2].
    """
    world = np.einsum("...ij,...j,...kj->...ik", axes, inertia, axes)
    momentum = np.einsum("...ij,...j->...i", world, spin)
    torque = np.einsum("...ij,...j->...i", world, turning) + np.cross(spin, momentum)
    return mass[:, None] * felt, torque


def matrices_of(quaternion: Float64[np.ndarray, "*B 4"]) -> Float64[np.ndarray, "*B 3 3"]:
    """Rotations of quaternions, the real part first."""
    from scipy.spatial.transform import Rotation  # takes 0.1 s that robots without such sensors do not need

    matrices = Rotation.from_quat(quaternion.reshape(-1, 4), scalar_first=True).as_matrix()
    return np.asarray(matrices).reshape(*quaternion.shape[:-1], 3, 3)


def _name(body: str, quantity: str) -> str:
    return f"trueup.body.{quantity}.{body}"
