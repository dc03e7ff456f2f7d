"""Currents of motors as torques: factors that are known, and factors that the model's masses tell."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from jaxtyping import Float64, Int

from trueup.core.episode import Episode
from trueup.identify.regression.covariance import robust_covariance
from trueup.identify.regression.mass_regression import choose_cutoff, model_torque
from trueup.identify.regression.samples import TORQUE_UNIT, SampleSettings, gather

_LEAST_SPEED = 0.2  # of a joint's RMS velocity
_EPSILON = 0.05  # width of the smoothed sign of the velocity [rad/s or m/s]
_WORST_CONDITION = 1e10


@dataclass(frozen=True)
class Factor:
    """Torque per current of a joint.

    Attributes:
        value: [Nm/A or N/A].
        low: lower end of the 95 % interval.
        high: upper end.
    """

    value: float
    low: float
    high: float


def as_torque(
    episode: Episode, signal: str, factors: Mapping[str, float], *, unmeasured: Collection[str] = ()
) -> Episode:
    """An episode whose measured torque is a factor times one of its signals.

    Args:
        episode: in the robot's names and units.
        signal: that was measured, `torque` or `current`.
        factors: joint -> [Nm/A or N/A]; 1 where none is known, so that amperes stand for torques.
        unmeasured: joints whose torque is set to zero.
    """
    measured = episode.measured
    factor = np.array([0.0 if name in unmeasured else factors.get(name, 1.0) for name in measured.joints])
    values = np.asarray(measured[signal], np.float64)
    units = tuple(TORQUE_UNIT.get(unit, "Nm") for unit in measured.units["position"])
    if signal == "torque" and not unmeasured and not factors:
        return episode
    torque = np.where(factor == 0.0, 0.0, factor * values)
    signals = {**measured.signals, "torque": torque}
    kept = units if signal == "current" else measured.units["torque"]
    return replace(episode, measured=replace(measured, signals=signals, units={**measured.units, "torque": kept}))


def factors_by_mass(
    episodes: Sequence[Episode], model: mujoco.MjModel, *, joints: Sequence[str], wanted: Collection[str]
) -> dict[str, Factor]:
    """Torque per current with which links weigh what the model says.

    Joint by joint, the current is i = c tau(q, dq, ddq) + a ddq + d dq + f tanh(dq / epsilon) + o, where tau is what
    the model's links take; the factor is 1 / c. Friction and rotors are free. A joint that carries no weight, so that
    its rotor could stand for its links, is left out, and so is one whose interval of c includes 0.

    Args:
        episodes: whose torques are currents [A].
        model: of the robot.
        joints: that move.
        wanted: those of which the factor is asked for.

    Raises:
        ConfigError: a joint is neither hinge nor slide.
        DataError: too few rows.
    """
    plain = SampleSettings(smooth_torque=True)
    cutoff_hz = choose_cutoff(episodes, model, plain, joints)
    samples = gather(episodes, replace(plain, cutoff_hz=cutoff_hz), joints=joints)
    rigid = model_torque(model, samples, rigid=True)
    found = {}
    for number, joint in enumerate(joints):
        if joint not in wanted:
            continue
        velocity, acceleration = samples.velocity[:, number], samples.acceleration[:, number]
        smooth_sign = np.tanh(velocity / _EPSILON)
        columns = [rigid[:, number], acceleration, velocity, smooth_sign, np.ones_like(velocity)]
        table, current = np.stack(columns, axis=1), samples.torque[:, number]
        usable = np.isfinite(table).all(axis=1) & np.isfinite(current)
        usable &= np.abs(velocity) >= _LEAST_SPEED * np.sqrt(np.nanmean(velocity**2))
        own = _factor(table[usable], current[usable], samples.motion[usable])
        if own is not None:
            found[joint] = own
    return found


def _factor(
    table: Float64[np.ndarray, "N 5"], current: Float64[np.ndarray, "N"], motion: Int[np.ndarray, "N"]
) -> Factor | None:
    sizes = np.linalg.norm(table, axis=0)
    if len(table) < 10 * table.shape[1] or not np.all(sizes > 0.0):
        return None
    scaled = table / sizes
    if np.linalg.cond(scaled.T @ scaled) > _WORST_CONDITION:
        return None
    values = np.linalg.lstsq(scaled, current, rcond=None)[0]
    _, group = np.unique(motion, return_inverse=True)
    grams = np.stack([scaled[group == item].T @ scaled[group == item] for item in range(int(group.max()) + 1)])
    covariance = robust_covariance(grams, scaled * (current - scaled @ values)[:, None], group)
    value, half = values[0] / sizes[0], covariance.half_width()[0] / sizes[0]
    if not value - half > 0.0:
        return None
    return Factor(float(1.0 / value), float(1.0 / (value + half)), float(1.0 / (value - half)))
