"""Weights of a logged torque beside the position, from what a fit leaves of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from trueup.identify.config import IdentifyConfig
from trueup.identify.problem import Problem, Weights
from trueup.identify.solution import Solution

# A logged torque is that of the motors, in Nm, where the simulated one explains this share of it, times a factor within
# these bounds: with a position fit, the scale of all torques is only as good as the model's masses.
_HEARD, _SAME_UNIT = 0.5, (0.5, 2.0)
# Standard deviation of a moment that is anywhere between two commands, as a share of their distance.
_ANYWHERE = 12.0**-0.5
# No torque is simulated better than to this share of its size.
_SURE = 1e-3


def logged_torque(
    problem: Problem, found: Solution, config: IdentifyConfig, period_s: float
) -> tuple[Weights, str] | None:
    """Weights of the residual with the logged torque of each joint by what a fit leaves of it, and a sentence on it.

    Without torques in them where the logged one is not that of the simulation; None if none was logged.

    Args:
        problem: the fit.
        found: where it ended.
        config: with the weights of positions and of joints.
        period_s: usual time between two logged commands [s]; the torque is that of a moment between two of them.

    Raises:
        DataError: the fitted model cannot be simulated.
    """
    joints = problem.nominal.robot.joint_names
    delays = {item.target: found.values[item.name] for item in found.parameters if item.quantity == "delay_s"}
    late = {name: delays.get(name, delays.get("", 0.0)) for name in problem.nominal.robot.scored_joints}
    both = Weights({**config.weights, "torque": 1.0}, config.joints, torque_delay_s=late)
    heard = problem.with_weights(both)
    blocks = list(heard.by_segment(heard.residuals(found.z[None])[0] / heard.scale))
    rows = [
        (values, segment.plan.measured["torque"][segment.rows("torque", heard.columns)][:, heard.columns])
        for segment, signal, values in blocks
        if signal == "torque"
    ]
    if not rows:
        return None
    names = [joints[column] for column in heard.columns]
    left, measured = (np.concatenate(own) for own in zip(*rows, strict=True))
    left = left / np.array([config.joints.get(name, 1.0) for name in names])
    size = np.maximum(np.sqrt(np.mean(measured**2, axis=0)), 1e-300)
    one, other = ((left + measured) / size).ravel(), (measured / size).ravel()
    factor = float(one @ other) / max(float(one @ one), 1e-300)
    explained = 1.0 - float(np.mean((factor * one - other) ** 2)) / max(float(np.mean(other**2)), 1e-300)
    if not (explained > _HEARD and _SAME_UNIT[0] < factor < _SAME_UNIT[1]):
        said = (
            "the logged torque is not used: the best multiple of the simulated one "
            f"({factor:.3g} times) explains {max(0.0, 100 * explained):.0f} % of it; has it another sign, unit or "
            "place? (signals: {torque: …} weighs it nevertheless)"
        )
        return Weights(config.weights, config.joints), said
    away = np.maximum(np.sqrt(np.mean(left**2, axis=0)), _SURE * size)
    positions = np.concatenate([values for _, signal, values in blocks if signal == "position"])
    usual = float(np.sqrt(np.mean(positions**2)))
    own = {name: usual / float(std) for name, std in zip(names, away, strict=True)}
    said = "the logged torque is weighed, each joint's by what the fit leaves of it"
    candidate = problem.candidate(found.values)
    model = candidate.compile()
    drives = [candidate.drive(name, model) for name in names]
    follows = [drive.kv if problem.nominal.robot.controller.signal == "velocity" else drive.kp for drive in drives]
    slack = {
        name: _ANYWHERE * period_s * (gain or 0.0) / float(std)
        for name, gain, std in zip(names, follows, away, strict=True)
    }
    return replace(both, own={"torque": own}, torque_slack=slack), said
