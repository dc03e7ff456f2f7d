"""Where a fit starts: a coarse look at each kind of parameter, for all joints at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from trueup.core.episode import Episode
from trueup.core.parameters import ParameterSet
from trueup.core.time_limit import OutOfTime, TimeLimit
from trueup.errors import TrueupError
from trueup.identify.candidate import Nominal
from trueup.identify.problem import Problem
from trueup.identify.quantities import QUANTITIES, quantity
from trueup.identify.regression import servo_start, torque_start
from trueup.robots import setup_of

# The order matters: stiffness first, then what brakes, then what is heavy, then what is late.
_BRAKES = tuple(item.name for item in QUANTITIES.values() if item.brakes and item.search.transform == "log")
_SWEPT = ("kp", *_BRAKES, "armature", "delay_s", "torque_limit")
_FACTORS = 4.0 ** np.arange(-4, 5)
_DELAYS_S = np.array([0.0, 0.005, 0.01, 0.02, 0.03, 0.05, 0.08])
_DAMPING_SHARE = 0.05
# A start on a bound has a one-sided view and often stays there.
_OFF_BOUND = 0.01
# What is left of a mass at least, where others that are welded to it keep theirs.
_LEAST_SHARE = 0.2


def begun_start(problem: Problem, episodes: Sequence[Episode], limit: TimeLimit | None = None) -> ParameterSet:
    """Where a search from afar begins: by inverse dynamics along the motions, and of servos also by simulation.

    Args:
        problem: the fit.
        episodes: the motions that are fitted to.
        limit: when looking for a start has to end.
    """
    if problem.nominal.robot.controller.signal == "torque":
        return regressed_start(problem, episodes)
    return swept_start(problem.with_parameters(servo_regressed(problem, episodes)), limit)


def swept_start(problem: Problem, limit: TimeLimit | None = None) -> ParameterSet:
    """Better start values, one kind of parameter after the other.

    All joints move through the same factors at once and each keeps the one at which its own residual is smallest:
    joints of an arm influence each other little enough for a first guess, and the cost is that of one Jacobian.

    Args:
        problem: logs, model and parameters.
        limit: when to end with the kinds that were looked at until then.
    """
    parameters = problem.parameters
    for name in _SWEPT:
        swept = [p for p in parameters.free if p.quantity == name and quantity(name).of == "joint"]
        if not swept:
            continue
        grid = _DELAYS_S if name == "delay_s" else _FACTORS
        rows = np.array(
            [
                parameters.at({p.name: float(step if name == "delay_s" else p.value * step) for p in swept}).start
                for step in grid
            ]
        )
        try:
            with problem.ending(limit):
                costs = joint_costs(problem, problem.residuals(rows))
        except OutOfTime:
            break
        for p in swept:
            own = costs[:, problem.nominal.robot.joint_names.index(p.target)] if p.target else costs.sum(axis=1)
            if np.isfinite(own).any():
                step = grid[int(np.nanargmin(own))]
                value = float(step if name == "delay_s" else p.value * step)
                parameters = parameters.at({p.name: value})
        problem = problem.with_parameters(parameters)
    return off_bounds(parameters)


def regressed_start(problem: Problem, episodes: Sequence[Episode]) -> ParameterSet:
    """Start values for torque-driven logs from a regression of the torque on the equation of motion.

    Open-loop simulations from far-off parameters leave the robot so quickly that they show no way back; accelerations
    do not. The regression's values are taken if they simulate the logs better than the model's.
    """
    parameters = off_bounds(problem.parameters)
    try:
        # What is commanded is the motors'; what is regressed is the joints'.
        gains = {name: problem.nominal.drive(name).torque_gain or 1.0 for name in problem.nominal.robot.joint_names}
        episodes = [_with_torques(episode, gains) for episode in episodes]
        found = torque_start(episodes, problem.nominal.model, joints=problem.nominal.robot.joint_names)
    except TrueupError:
        return parameters
    terms = {
        "armature": found.armature,
        "damping": found.damping,
        "frictionloss": found.frictionloss,
        "torque_offset": found.offset,
    }
    values = {f"{name}[{joint}]": value for name, own in terms.items() for joint, value in own.items()}
    values |= _masses(problem.nominal, found.mass_scale)
    regressed = off_bounds(parameters.at({name: values[name] for name in parameters.names if name in values}))
    costs = np.sum(problem.residuals(np.array([parameters.start, regressed.start])) ** 2, axis=1)
    return regressed if costs[1] < costs[0] or not np.isfinite(costs[0]) else parameters


def servo_regressed(problem: Problem, episodes: Sequence[Episode]) -> ParameterSet:
    """Start values for servos from a regression along the measured motion, if they simulate the logs better."""
    parameters = off_bounds(problem.parameters)
    nominal = problem.nominal
    signal = nominal.robot.controller.signal
    drives = {joint: nominal.drive(joint) for joint in nominal.robot.scored_joints}
    gains = {joint: (own.kp if signal == "position" else own.kv) or 0.0 for joint, own in drives.items()}
    if not all(gains.values()):
        return parameters
    try:
        found = servo_start(
            episodes,
            nominal.model,
            joints=nominal.robot.scored_joints,
            signal=signal,
            gains=gains,
            limits=nominal.simulator.torque_limits,
            kp_factors=[setup_of(nominal.robot, episode.meta).kp_factor for episode in episodes],
        )
    except TrueupError:
        return parameters
    values: dict[str, float] = {}
    for joint, total in found.kv.items() if signal == "position" else ():
        # Of two numbers that add up, the one that the model has most of keeps its share, within reason.
        damping = parameters[f"damping[{joint}]"].value if f"damping[{joint}]" in parameters.names else 0.0
        share = min(max(damping, _DAMPING_SHARE * total), 0.5 * total)
        values |= {f"damping[{joint}]": share, f"kv[{joint}]": total - share}
    for name in ("kp", "kv", "damping", "frictionloss", "armature", "delay_s"):
        values |= (
            {f"{name}[{joint}]": value for joint, value in getattr(found, name).items()}
            if name != "kv" or signal != "position"
            else {}
        )
    if "delay_s" in parameters.names:
        values["delay_s"] = float(np.median(list(found.delay_s.values())))
    regressed = off_bounds(parameters.at({name: values[name] for name in parameters.names if name in values}))
    costs = np.sum(problem.residuals(np.array([parameters.start, regressed.start])) ** 2, axis=1)
    return regressed if costs[1] < costs[0] or not np.isfinite(costs[0]) else parameters


def _with_torques(episode: Episode, gains: Mapping[str, float]) -> Episode:
    """The episode with its commanded torques times these factors, by joint."""
    command = episode.commanded()
    factors = np.array([gains.get(joint, 1.0) for joint in command.joints])
    if "torque" not in command or np.all(factors == 1.0):
        return episode
    return replace(
        episode, command=replace(command, signals={**command.signals, "torque": command["torque"] * factors})
    )


def _masses(nominal: Nominal, scales: Mapping[str, float]) -> dict[str, float]:
    """Mass parameters that make the sum of each rigid group `scales` times as heavy.

    Args:
        nominal: the model as it came.
        scales: by the body with the joint.
    """
    found = {}
    for group in nominal.rigid_groups:
        scale = next((scales[body] for body in group if body in scales), 1.0)
        masses = [nominal.inertial(body).mass for body in group]
        found[f"mass[{group[0]}]"] = max(masses[0] + (scale - 1.0) * sum(masses), _LEAST_SHARE * masses[0])
    return found


def off_bounds(parameters: ParameterSet) -> ParameterSet:
    """The same start, a hundredth of the range away from every bound."""
    low, high = parameters.bounds
    z = parameters.start
    margin = np.minimum(_OFF_BOUND * (high - low), 0.25)
    inside = np.clip(z, low + margin, high - margin)
    moved = {
        parameter.name: parameter.from_z(float(new))
        for parameter, old, new in zip(parameters.free, z, inside, strict=True)
        if new != old
    }
    return parameters.at(moved)


def joint_costs(problem: Problem, residuals: Float64[np.ndarray, "C N"]) -> Float64[np.ndarray, "C J"]:
    """Sum of squares per candidate and joint; infinite for candidates that failed, zero for uncounted joints."""
    costs = np.zeros((residuals.shape[0], len(problem.nominal.robot.joint_names)))
    for row, residual in enumerate(residuals):
        if not np.isfinite(residual).all():
            costs[row] = np.inf
            continue
        for _, _, values in problem.by_segment(residual):
            costs[row, problem.columns] += np.sum(values**2, axis=0)
    return costs


def idle_names(problem: Problem, jacobian: Float64[np.ndarray, "P N"], weight: float) -> list[str]:
    """Free parameters of the model about which the data say less than the prior, even if all others were known."""
    _, std = problem.parameters.prior
    gain = np.sum(jacobian**2, axis=1) * np.where(np.isfinite(std), std, 1.0) ** 2 / weight
    return [
        parameter.name
        for parameter, own in zip(problem.parameters.free, gain, strict=True)
        if own < 1.0 and quantity(parameter.quantity).of != "motion"
    ]
