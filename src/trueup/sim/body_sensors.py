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
    known = [body.name for body in spec.bodies]
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
        spin, axes = found["angular_velocity"], _matrices(found["inertial"])
        inertia = np.einsum("...ij,...j,...kj->...ik", axes, self._inertia, axes)
        momentum = np.einsum("...ij,...j->...i", inertia, spin)
        turning = np.einsum("...ij,...j->...i", inertia, found["angular_acceleration"])
        # MuJoCo's linear acceleration has what holds a body against gravity in it.
        values = (
            found["position"],
            _matrices(found["quaternion"]),
            found["velocity"],
            spin,
            self._mass[:, None] * found["acceleration"],
            turning + np.cross(spin, momentum),
        )
        return dict(zip(BODY_SIGNALS, values, strict=True))


def _name(body: str, quantity: str) -> str:
    return f"trueup.body.{quantity}.{body}"


def _matrices(quaternion: Float64[np.ndarray, "*B 4"]) -> Float64[np.ndarray, "*B 3 3"]:
    from scipy.spatial.transform import Rotation  # takes 0.1 s that robots without such sensors do not need

    matrices = Rotation.from_quat(quaternion.reshape(-1, 4), scalar_first=True).as_matrix()
    return np.asarray(matrices).reshape(*quaternion.shape[:-1], 3, 3)
