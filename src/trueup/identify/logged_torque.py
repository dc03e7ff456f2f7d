"""A logged torque beside the position: how it is compared, and what it weighs, from what a fit leaves of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float64, Int

from trueup.identify.segments import Segment

if TYPE_CHECKING:
    from trueup.identify.config import IdentifyConfig
    from trueup.identify.problem import Problem, Weights
    from trueup.identify.solution import Solution

# A logged torque is that of the motors, in Nm, where the simulated one explains this share of it, times a factor within
# these bounds: with a position fit, the scale of all torques is only as good as the model's masses.
_HEARD, _SAME_UNIT = 0.5, (0.5, 2.0)
# No torque is simulated better than to this share of its size.
_SURE = 1e-3
# Of a difference that shows how a command changes [s].
_LATER_S = 0.002
# Standard deviation of the moment of a command, as a share of the time between two that are logged: it is anywhere
# between them.
_ANYWHERE = 12.0**-0.5
# How far from its stamp the position may be that a logged torque answers to, one standard deviation [s]: a drive of
# 1 kHz may log that of its last cycle. Its damping and that of the joint are told apart up to this times kp.
READ_S = 0.0005


@dataclass(frozen=True)
class LoggedTorque:
    """What is known of the logged torque of one joint.

    Attributes:
        delay_s: how late commands act [s].
        kp: torque per position error.
        kv: torque per velocity.
        noise: standard deviation of its noise [Nm or N]; where it is not known, 0, commands may be of any moment, and
            sensors are read at the stamps.
    """

    delay_s: float = 0.0
    kp: float = 0.0
    kv: float = 0.0
    noise: float = 0.0


class Moments:
    """The moments at which the drives read what makes the logged torques of a segment.

    A drive's torque at a stamp, kp (c - q) - kv v, is that of a command, a position and a velocity which it has read
    before. It takes more commands than are logged, and reads its sensors in a loop of its own. If one of them is of a
    time t earlier, the torque is off by kp c' t, kp q' t or kv v' t, which may be more than its noise. So with white
    noise of variance w, and the effects G (R, 3) of these times with the variance w each, the torque's residual r has
    the covariance C = w (I + G G'). With G = U D W', w r' C^-1 r is the square of r - U (1 - (1 + D^2)^(-1/2)) U' r. A
    time is the same in all of some segments, so that its variance counts once for each of them.

    Args:
        segment: a part of the logs.
        rows: its stamps that count, (T,).
        columns: numbers of the K joints, among those of the robot.
        signal: that the robot follows.
        torque: joint name -> what is known of its torque; the moments of others are those of the stamps.
        segments: how many have the same moments.
    """

    def __init__(
        self,
        segment: Segment,
        rows: Bool[np.ndarray, "T"],
        columns: Int[np.ndarray, "K"],
        signal: str,
        torque: Mapping[str, LoggedTorque],
        segments: int,
    ) -> None:
        plan = segment.plan
        self._known = [torque.get(plan.measured.joints[column]) for column in columns]
        own = [known or LoggedTorque() for known in self._known]
        stiff, damped = segment.setup.kp_factor * np.array([one.kp for one in own]), np.array([one.kv for one in own])
        delays = np.zeros(len(plan.measured.joints))
        delays[columns] = [one.delay_s for one in own]
        later, sooner = (plan.told(signal, delays + shift)[rows][:, columns] for shift in (-_LATER_S, _LATER_S))
        told_s, read_s = _ANYWHERE * plan.command_period_s, READ_S
        noise = np.array([one.noise for one in own])
        certain = np.sqrt(segments) / np.maximum(noise, 1e-9)
        follows = stiff if signal == "position" else damped
        self._told = told_s * certain * follows * (later - sooner) / (2.0 * _LATER_S)
        self._of_position, self._of_velocity = (read_s * certain * (noise > 0) * gain for gain in (stiff, damped))

    def without(
        self,
        residual: Float64[np.ndarray, "R K"],
        velocity: Float64[np.ndarray, "R K"],
        acceleration: Float64[np.ndarray, "R K"],
    ) -> Float64[np.ndarray, "R K"]:
        """The residual of the torques without what other moments would explain of it."""
        left = residual.copy()
        effects = self._told, self._of_position * velocity, self._of_velocity * acceleration
        for column, known in enumerate(self._known):
            if known is None:
                continue
            axes, sizes, _ = np.linalg.svd(np.stack([own[:, column] for own in effects], axis=1), full_matrices=False)
            left[:, column] -= axes @ ((1.0 - 1.0 / np.sqrt(1.0 + sizes**2)) * (axes.T @ residual[:, column]))
        return left


def logged_torque(problem: Problem, found: Solution, config: IdentifyConfig) -> tuple[Weights, str] | None:
    """Weights of the residual with the logged torque of each joint by what a fit leaves of it, and a sentence on it.

    Without torques in them where the logged one is not that of the simulation; None if none was logged.

    Args:
        problem: the fit.
        found: where it ended.
        config: with the weights of positions and of joints.

    Raises:
        DataError: the fitted model cannot be simulated.
    """
    joints = problem.nominal.robot.joint_names
    plain = replace(problem.weights, signals=config.weights, own={}, torque={})
    candidate = problem.candidate(found.values)
    model = candidate.compile()
    known = {
        name: LoggedTorque(late, drive.kp or 0.0, drive.kv or 0.0)
        for name, late in zip(joints, candidate.delays.tolist(), strict=True)
        if name in problem.nominal.robot.scored_joints
        for drive in [candidate.drive(name, model)]
    }
    both = replace(plain, signals={**config.weights, "torque": 1.0}, torque=known)
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
            f"the logged torque is not used: {factor:.3g} times the simulated torque, the best match, explains "
            f"{max(0.0, 100 * explained):.0f} % of it; check its sign, unit and where it is measured "
            "(signals: {torque: …} uses it anyway)"
        )
        return plain, said
    away = np.maximum(np.sqrt(np.mean(left**2, axis=0)), _SURE * size)
    positions = np.concatenate([values for _, signal, values in blocks if signal == "position"])
    usual = float(np.sqrt(np.mean(positions**2)))
    own = {name: usual / float(std) for name, std in zip(names, away, strict=True)}
    said = "the logged torque is fitted too, each joint weighted by its remaining torque error"
    known |= {name: replace(known[name], noise=float(std)) for name, std in zip(names, away, strict=True)}
    return replace(both, own={"torque": own}, torque=known), said
