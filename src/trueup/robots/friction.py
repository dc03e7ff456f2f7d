"""Friction laws of a joint beyond viscous and Coulomb friction, as plain numbers."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float64

from trueup.errors import ConfigError


@dataclass(frozen=True)
class JointFriction:
    """What MuJoCo's `damping` and `frictionloss` of a joint cannot say; a zero switches a law off.

    With v the joint velocity and g the torque that the transmission carries (gravity and the motion of the other
    joints, MuJoCo's `qfrc_bias`), a joint that moves is braked by

        (1 + asymmetry * sign(v)) * (dry + smooth + damping * |v|)
        dry = frictionloss + stribeck * exp(-(v / stribeck_velocity)^2) + load * |g|
        smooth = tanh_coulomb * tanh(|v| / tanh_velocity)
                 + sigmoid_level * sign(v) * (1 / (1 + exp(-s (v + v0))) - 1 / (1 + exp(-s v0))),

    with s `sigmoid_slope` and v0 `sigmoid_shift` (phi_1, phi_2 and phi_3 of the ES thesis, eq. 2.1). Dry and smooth
    friction are held by MuJoCo's constraint solver: dry friction lets a joint stick instead of creep, smooth friction
    is zero at rest, and neither ever drives a joint (a negative sum counts as zero). (Coulomb friction that depends on
    the direction alone moves a joint exactly as a torque offset does; the asymmetry matters through the terms that
    grow with speed or load.)

    Attributes:
        stribeck: static friction above Coulomb friction [Nm].
        stribeck_velocity: where that excess has fallen to 1/e [rad/s].
        load: friction per transmitted torque [-]; 1 and more cannot be driven from the output side.
        asymmetry: share by which friction is higher in the positive direction and lower in the negative one [-].
        tanh_coulomb: smoothed Coulomb friction [Nm].
        tanh_velocity: smoothing [rad/s]; small is sharp.
        sigmoid_level: phi_1 [Nm].
        sigmoid_slope: phi_2 [s/rad].
        sigmoid_shift: phi_3 [rad/s].
        dead_band: position errors up to this make no torque in the joint's servo [rad].
        static_positive: a commanded torque in (-static_negative, static_positive) does not move a joint that
            stands still, i.e. is taken as zero [Nm] (ES thesis, 3.1.2).
        static_negative: see there, given as a positive number [Nm].
        static_velocity: slower than this counts as standing still [rad/s]; 0.03 in the thesis.

    Raises:
        ConfigError: a number is not finite, or negative where only the size counts.
    """

    stribeck: float = 0.0
    stribeck_velocity: float = 0.1
    load: float = 0.0
    asymmetry: float = 0.0
    tanh_coulomb: float = 0.0
    tanh_velocity: float = 0.05
    sigmoid_level: float = 0.0
    sigmoid_slope: float = 10.0
    sigmoid_shift: float = 0.0
    dead_band: float = 0.0
    static_positive: float = 0.0
    static_negative: float = 0.0
    static_velocity: float = 0.03

    def __post_init__(self) -> None:
        """Refuse numbers that make no friction law."""
        for field in fields(self):
            value = getattr(self, field.name)
            signed = field.name in ("asymmetry", "sigmoid_level", "sigmoid_shift")
            if not np.isfinite(value) or (value < 0 and not signed):
                raise ConfigError(
                    f"friction: {field.name}", got=value, expected="a finite number" if signed else ">= 0 and finite"
                )
        for name in ("stribeck_velocity", "tanh_velocity"):
            if getattr(self, name) == 0:
                raise ConfigError(f"friction: {name} must be positive", got=0.0)
        if abs(self.asymmetry) >= 1:
            raise ConfigError("friction: asymmetry must lie between -1 and 1", got=self.asymmetry)

    def dry(self, velocity: Float64[np.ndarray, "*shape"], load: Float64[np.ndarray, "*shape"]) -> np.ndarray:
        """Dry friction on top of `frictionloss` [Nm], at velocities [rad/s] and transmitted torques [Nm]."""
        excess = self.stribeck * np.exp(-((velocity / self.stribeck_velocity) ** 2))
        return np.asarray(excess + self.load * np.abs(load))

    def smooth(self, velocity: Float64[np.ndarray, "*shape"]) -> np.ndarray:
        """Smooth friction [Nm] without asymmetry; it acts against the motion."""
        # A logistic curve is half a tanh of half its argument, which does not overflow.
        slope, shift = 0.5 * self.sigmoid_slope, self.sigmoid_shift
        sigmoid = 0.5 * (np.tanh(slope * (velocity + shift)) - np.tanh(slope * shift))
        return np.asarray(self.tanh_coulomb * np.tanh(velocity / self.tanh_velocity) + self.sigmoid_level * sigmoid)
