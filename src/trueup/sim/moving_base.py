"""A base that moves under the robot: in its own frame, all that changes is what pulls on the bodies.

A base that accelerates by a has, in its axes, the gravity g - a in place of g, and one that is tilted has it turned:
minus the specific force that an accelerometer on the base says. What turning adds besides (centrifugal, Coriolis and
Euler forces) is left out.
"""

from __future__ import annotations

import mujoco
import numpy as np
from jaxtyping import Float, Float64

from trueup.core.episode import Episode
from trueup.core.interpolation import columns_at
from trueup.errors import ConfigError, DataError, MissingSignal
from trueup.robots.model import gravity_of

SPECIFIC_FORCE = "body.specific_force"


class MovingBase:
    """How a model's gravity changes with what pulls on it in the axes of its base.

    Args:
        model: compiled.
        body: the base; the axes are those of the world if empty.

    Raises:
        ConfigError: see `base_axes`.
    """

    def __init__(self, model: mujoco.MjModel, body: str = "") -> None:
        self._standing = gravity_of(model)
        self._axes = base_axes(model, body, "simulation: base_sensor") if body else np.eye(3)

    def change(self, gravity: Float[np.ndarray, "B N 3"]) -> Float64[np.ndarray, "B N 3"]:
        """What pulls on every kilogram more than with a base at rest, in the axes of the world [m/s2]."""
        return np.asarray(gravity @ self._axes.T - self._standing, np.float64)


def base_axes(model: mujoco.MjModel, body: str, what: str) -> Float64[np.ndarray, "3 3"]:
    """The axes of the body that a robot stands on, as columns, in those of the model's world.

    Args:
        model: compiled.
        body: its name.
        what: for messages, who names it.

    Raises:
        ConfigError: there is no such body, or it moves by itself.
    """
    known = [model.body(number).name for number in range(1, model.nbody)]
    if body not in known:
        raise ConfigError(f"{what}: {body!r} is no body of the model", available=known)
    number = model.body(body).id
    if model.body_weldid[number] != 0:
        raise ConfigError(
            f"{what}: {body!r} moves with the robot's own joints", expected="the body that the robot stands on"
        )
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return np.array(data.xmat[number].reshape(3, 3))


def gravity_at(episode: Episode, body: str, time_s: Float64[np.ndarray, "*N"]) -> Float64[np.ndarray, "*N 3"]:
    """What pulled on the robot, in the axes of its base, from the sensor on it: linear between its samples.

    Args:
        episode: a log.
        body: the base.
        time_s: on the log's clock; before its first sample and after its last one, those are held.

    Raises:
        MissingSignal: the log has nothing of such a sensor.
        DataError: what it says is not finite.
    """
    measured = episode.measured
    if SPECIFIC_FORCE not in measured or body not in measured.bodies:
        raise MissingSignal(
            f"episode {episode.id!r} does not say how its base moved: {SPECIFIC_FORCE} of {body!r}",
            available=[*measured.signals, *measured.bodies],
            hint="Leave simulation: {base_sensor: ...} out of robot.yaml for a base at rest.",
        )
    felt = measured[SPECIFIC_FORCE][:, measured.bodies.index(body)].astype(np.float64)
    if not np.isfinite(felt).all():
        row = int(np.argmin(np.isfinite(felt).all(axis=1)))
        raise DataError(
            f"episode {episode.id!r}: {SPECIFIC_FORCE} of {body!r} is not finite",
            got=f"{measured.time_s[row]:.3f} s",
        )
    return -columns_at(time_s.ravel(), measured.time_s, felt).reshape(*time_s.shape, 3)
