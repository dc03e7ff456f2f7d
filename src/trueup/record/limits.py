"""How far, how fast and how hard each joint may move."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Float64

from trueup.errors import ConfigError, NameMismatch
from trueup.robots import RobotSpec

# Where a model has them; a URDF has no accelerations.
_PLACE = {
    "velocity": "<custom><numeric name='velocity_limit' data='…'/> in the MJCF, or <limit velocity='…'/> in the URDF",
    "acceleration": "<custom><numeric name='acceleration_limit' data='…'/> in the MJCF",
}


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Limits of J joints.

    Attributes:
        joints: names, in order.
        low: lowest positions, (J,) [rad or m].
        high: highest positions, (J,) [rad or m].
        velocity: largest speeds, (J,) [rad/s or m/s].
        acceleration: largest accelerations, (J,) [rad/s^2 or m/s^2].

    Raises:
        ConfigError: a range without room, or a speed or an acceleration that is not positive.
    """

    joints: tuple[str, ...]
    low: Float64[np.ndarray, "J"]
    high: Float64[np.ndarray, "J"]
    velocity: Float64[np.ndarray, "J"]
    acceleration: Float64[np.ndarray, "J"]

    def __post_init__(self) -> None:
        """Refuse limits that leave no motion."""
        for joint, low, high in zip(self.joints, self.low, self.high, strict=True):
            if not (np.isfinite([low, high]).all() and low < high):
                raise ConfigError(f"the range of joint {joint!r} has no room", got=(float(low), float(high)))
        for name, values in (("velocity", self.velocity), ("acceleration", self.acceleration)):
            wrong = ~((values > 0) & np.isfinite(values))
            if wrong.any():
                row = int(np.argmax(wrong))
                raise ConfigError(f"the {name} limit of joint {self.joints[row]!r} must be positive", got=values[row])

    def scaled(self, velocity: float, acceleration: float) -> JointLimits:
        """The same with shares of the speeds and accelerations.

        Raises:
            ConfigError: a share that is not in (0, 1].
        """
        for name, share in (("velocity", velocity), ("acceleration", acceleration)):
            if not 0 < share <= 1:
                raise ConfigError(f"the {name} share is no share of a limit", got=share, expected="above 0, up to 1")
        return replace(self, velocity=velocity * self.velocity, acceleration=acceleration * self.acceleration)

    def require_inside(self, position: Float64[np.ndarray, "J"], what: str) -> None:
        """Refuse a pose outside of the ranges.

        Raises:
            ConfigError: a joint is beyond its range, or the pose has another length or is not finite.
        """
        if position.shape != self.low.shape or not np.isfinite(position).all():
            raise ConfigError(f"{what} is no pose of these joints", got=position.tolist(), expected=self.joints)
        outside = (position < self.low) | (position > self.high)
        if outside.any():
            row = int(np.argmax(outside))
            raise ConfigError(
                f"{what} is out of the limits of joint {self.joints[row]!r}",
                got=f"{position[row]:.4f}",
                expected=f"{self.low[row]:.4f} to {self.high[row]:.4f}",
            )

    def columns(self, joints: tuple[str, ...]) -> list[int]:
        """Where these joints stand.

        Raises:
            NameMismatch: a joint is not there.
        """
        unknown = [name for name in joints if name not in self.joints]
        if unknown:
            raise NameMismatch(
                f"joints {unknown} are not of this robot",
                left=joints,
                right=self.joints,
                left_name="asked for",
                right_name="robot has",
            )
        return [self.joints.index(name) for name in joints]


def limits_of(
    robot: RobotSpec,
    model: Any,
    *,
    velocity: Mapping[str, float] | None = None,
    acceleration: Mapping[str, float] | None = None,
) -> JointLimits:
    """The limits of a robot's joints.

    Positions come from `robot.yaml` and the model, whichever is tighter; speeds and accelerations from the model's
    custom numerics `velocity_limit` and `acceleration_limit` (one number for each joint of the model, in its order),
    where the caller does not give them.

    Args:
        robot: the robot.
        model: a compiled `mujoco.MjModel`.
        velocity: joint -> largest speed [rad/s or m/s].
        acceleration: joint -> largest acceleration [rad/s^2 or m/s^2].

    Raises:
        ConfigError: a joint has no limit of some kind.
        NameMismatch: a joint is not in the model or not of the robot.
    """
    names = [model.joint(row).name for row in range(model.njnt)]
    missing = [name for name in robot.joint_names if name not in names]
    if missing:
        raise NameMismatch(
            f"joints {missing} are not in the model",
            left=robot.joint_names,
            right=names,
            left_name="robot",
            right_name="model",
        )
    low, high = np.empty(len(robot.joints)), np.empty(len(robot.joints))
    for row, joint in enumerate(robot.joints):
        number = names.index(joint.name)
        ranges = [joint.position_limits] if joint.position_limits else []
        if model.jnt_limited[number]:
            ranges.append(tuple(model.jnt_range[number]))
        if not ranges:
            raise ConfigError(
                f"joint {joint.name!r} has no position limits",
                hint="Give position_limits in robot.yaml, or a range in the model.",
            )
        low[row], high[row] = max(pair[0] for pair in ranges), min(pair[1] for pair in ranges)
    return JointLimits(
        robot.joint_names,
        low,
        high,
        _rates(robot.joint_names, names, model, "velocity", velocity or {}),
        _rates(robot.joint_names, names, model, "acceleration", acceleration or {}),
    )


def stated_rates(
    model: Any, names: Sequence[str], kind: Literal["velocity", "acceleration", "torque_rate"]
) -> dict[str, float]:
    """Joint -> largest speed, acceleration, or change of torque that a model states in its custom numerics, if it does.

    Args:
        model: a compiled `mujoco.MjModel`.
        names: all its joints, in its order.
        kind: which of them.
    """
    numerics = {model.numeric(row).name: model.numeric(row).data for row in range(model.nnumeric)}
    values = numerics.get(f"{kind}_limit", np.empty(0))
    return dict(zip(names, map(float, values), strict=True)) if len(values) == len(names) else {}


def _rates(
    joints: tuple[str, ...],
    names: list[str],
    model: Any,
    kind: Literal["velocity", "acceleration"],
    given: Mapping[str, float],
) -> Float64[np.ndarray, "J"]:
    unknown = [name for name in given if name not in joints]
    if unknown:
        raise NameMismatch(f"{kind} limits for {unknown}, which are no joints", left=given, right=joints)
    found = {**stated_rates(model, names, kind), **given}
    missing = [name for name in joints if name not in found]
    if missing:
        raise ConfigError(
            f"joints {missing} have no {kind} limit",
            hint=f"Give {kind}_limits for each joint, or {_PLACE[kind]}.",
        )
    return np.array([float(found[name]) for name in joints])
