"""The upper body on wheels as a model: names, sizes, and the base's state in MuJoCo."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float64

ROBOT = "upper_body"
BASE = "base"
WHEELS = ("left_wheel", "right_wheel")
MODEL = Path(str(resources.files("trueup.robots"))) / "models" / "balancing_body.xml"


def load_body() -> mujoco.MjSpec:
    """An editable model of the whole, in which the upper body has the names that it has alone."""
    spec = mujoco.MjSpec.from_file(str(MODEL))
    for element in (*spec.bodies, *spec.joints, *spec.sites, *spec.keys, *spec.numerics):
        element.name = element.name.removeprefix(f"{ROBOT}/")
    return spec


@dataclass(frozen=True)
class Axle:
    """Sizes that the wheels' encoders are read with.

    Attributes:
        radius_m: of the wheels [m].
        track_m: between them [m].
    """

    radius_m: float
    track_m: float

    @staticmethod
    def of(model: mujoco.MjModel) -> Axle:
        """That of a compiled model."""
        left, right = (model.body(name).id for name in WHEELS)
        return Axle(
            radius_m=float(model.geom_size[model.body_geomadr[left], 2]),
            track_m=float(model.body_pos[left, 1] - model.body_pos[right, 1]),
        )


@dataclass(frozen=True)
class BaseReading:
    """What the base's sensors say.

    Attributes:
        wheels: angles of the left and of the right wheel against the base [rad].
        wheel_rates: their speeds [rad/s].
        pitch: how far the base leans forward [rad].
        pitch_rate: [rad/s].
        yaw_rate: to the left [rad/s].
    """

    wheels: Float64[np.ndarray, "2"]
    wheel_rates: Float64[np.ndarray, "2"]
    pitch: float
    pitch_rate: float
    yaw_rate: float

    def stance(self, axle: Axle) -> Float64[np.ndarray, "6"]:
        """What is balanced: way [m], pitch and heading [rad], and their rates, as wheels that do not slip have them."""
        turned, rate = self.wheels.mean() + self.pitch, self.wheel_rates.mean() + self.pitch_rate
        heading = (self.wheels[1] - self.wheels[0]) * axle.radius_m / axle.track_m
        return np.array(
            [axle.radius_m * turned, self.pitch, heading, axle.radius_m * rate, self.pitch_rate, self.yaw_rate]
        )


class Chassis:
    """The base in MuJoCo's state of a whole body.

    Args:
        model: of a whole body.
        data: its state.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self.axle = Axle.of(model)
        self._model, self._data = model, data
        self._body = model.body(BASE).id
        joints = np.array([model.joint(name).id for name in WHEELS])
        self._wheels, self._freedoms = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        first = model.joint(BASE)
        self._place, self._motion = int(first.qposadr[0]), int(first.dofadr[0])

    def stand(self, pitch: float) -> None:
        """Put the base at its start, leaning forward by `pitch` [rad], the wheels as if it had leaned over at rest."""
        turned = [np.cos(0.5 * pitch), 0.0, np.sin(0.5 * pitch), 0.0]
        self._data.qpos[self._place : self._place + 7] = [0.0, 0.0, self.axle.radius_m, *turned]
        self._data.qvel[self._motion : self._motion + 6] = 0.0
        self._data.qpos[self._wheels], self._data.qvel[self._freedoms] = -pitch, 0.0
        mujoco.mj_forward(self._model, self._data)

    def drive(self, torque: Float64[np.ndarray, "2"]) -> None:
        """Torque of the left and of the right wheel, from now on [Nm]."""
        self._data.qfrc_applied[self._freedoms] = torque

    def position(self) -> Float64[np.ndarray, "3"]:
        """The middle of the axle in the axes of the world [m]."""
        return np.array(self._data.qpos[self._place : self._place + 3])

    def rotation(self) -> Float64[np.ndarray, "3 3"]:
        """From the axes of the base to those of the world."""
        flat = np.empty(9)
        mujoco.mju_quat2Mat(flat, self._data.qpos[self._place + 3 : self._place + 7])
        return flat.reshape(3, 3)

    def reading(self) -> BaseReading:
        """What perfect sensors would say."""
        turned = self.rotation()
        # A free joint has its angular velocity in the axes of its body.
        rates = self._data.qvel[self._motion + 3 : self._motion + 6]
        return BaseReading(
            wheels=np.array(self._data.qpos[self._wheels]),
            wheel_rates=np.array(self._data.qvel[self._freedoms]),
            pitch=float(np.arctan2(-turned[2, 0], np.hypot(turned[0, 0], turned[1, 0]))),
            pitch_rate=float(rates[1]),
            yaw_rate=float(turned[2] @ rates),
        )
