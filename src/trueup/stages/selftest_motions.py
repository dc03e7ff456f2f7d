"""Motions for a self-test where nothing was recorded: multisines, and moves from pose to pose with rests."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64

from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.timeseries import TimeSeries
from trueup.core.units import SI_UNIT, joint_unit
from trueup.record import ClockSettings, JointLimits, ReferenceSettings
from trueup.record.functions import multisine
from trueup.record.limits import limits_of, stated_rates
from trueup.record.profile import Profile
from trueup.record.references import INNER, amplitudes, scaled, shape
from trueup.record.urdf import urdf_velocity_limits

if TYPE_CHECKING:
    from trueup.identify import Nominal

RATE_HZ = 100.0
# More motion than this is designed for no fit [s].
MOST_S = 120.0
# Length of a motion [s], number of motions at least, and every so many train motions one of val.
_LENGTH_S, _LEAST_S, _FEWEST, _VAL_EVERY = 8.0, 4.0, 3, 4
# Where nobody has said a limit: how fast and how hard joints move [rad, s], a slide by so much of it, and how far.
_FAST, _HARD, _SLIDE, _FAR = 2.0, 15.0, 0.2, 1.2
# Share of a torque limit that accelerates.
_TORQUE_SHARE = 0.4
# A move between two poses, and the rest after it [s].
_REST_S = 0.4


def designed_motions(nominal: Nominal, path: Path, train_s: float, *, seed: int) -> dict[str, list[Episode]]:
    """About so much motion of all scored joints, by split, as it would be recorded of a robot that follows at once.

    Motions keep the limits that model and description state, and usual ones where they state none; obstacles are not
    looked at. Half of them are multisines up to 1 Hz, with which all that is in a robot shows at once; the others go
    from pose to pose and rest there, where gains and weights show.

    Args:
        nominal: the robot and its model.
        path: of the model, for limits that MuJoCo does not keep.
        train_s: length of all motions of train together [s].
        seed: of the draws.
    """
    limits, home = _limits(nominal, path)
    length_s = float(np.clip(train_s / _FEWEST, _LEAST_S, _LENGTH_S))
    count = max(_FEWEST, round(train_s / length_s))
    found: dict[str, list[Episode]] = {"train": [], "val": []}
    for number in range(count + max(1, count // _VAL_EVERY)):
        rng = np.random.default_rng([seed, number, 11])
        make = _multisines if number % 2 == 0 else _moves
        profile = make(nominal, limits, home, length_s, rng)
        split = "train" if number < count else "val"
        found[split].append(_episode(nominal, profile, f"designed/{number:02d}", split))
    return found


def _limits(nominal: Nominal, path: Path) -> tuple[JointLimits, Float64[np.ndarray, "J"]]:
    """What joints may do, and the pose around which they do it."""
    robot, model = nominal.robot, nominal.model
    names = [model.joint(row).name for row in range(model.njnt)]
    keys = {model.key(row).name: model.key(row).qpos for row in range(model.nkey)}
    pose = keys.get("home", model.qpos0)
    ranges, speeds, thrusts = [], {}, {}
    for joint in robot.joints:
        unit = 1.0 if nominal.length_unit(joint.name) == "rad" else _SLIDE
        row = names.index(joint.name)
        at = float(pose[model.jnt_qposadr[row]])
        low, high = joint.position_limits or (-np.inf, np.inf)
        if model.jnt_limited[row]:
            low, high = max(low, float(model.jnt_range[row, 0])), min(high, float(model.jnt_range[row, 1]))
        if np.isfinite([low, high]).all() and "home" not in keys:
            at = 0.5 * (low + high)
        ranges.append(replace(joint, position_limits=(max(low, at - unit * _FAR), min(high, at + unit * _FAR))))
        limit, size = nominal.simulator.torque_limits.get(joint.name), nominal.size(joint.name)
        hard = np.inf if limit is None else _TORQUE_SHARE * limit / size.inertia
        speeds[joint.name], thrusts[joint.name] = unit * _FAST, min(unit * _HARD, float(hard))
    speeds |= {name: own for name, own in _stated(nominal, path).items() if name in speeds}
    thrusts |= {name: own for name, own in stated_rates(model, names, "acceleration").items() if name in thrusts}
    limits = limits_of(replace(robot, joints=tuple(ranges)), model, velocity=speeds, acceleration=thrusts)
    return limits, 0.5 * (limits.low + limits.high)


def _stated(nominal: Nominal, path: Path) -> Mapping[str, float]:
    model = nominal.model
    names = [model.joint(row).name for row in range(model.njnt)]
    return {**urdf_velocity_limits(path), **stated_rates(model, names, "velocity")}


def _moving(nominal: Nominal) -> list[int]:
    robot = nominal.robot
    return [column for column, name in enumerate(robot.joint_names) if name in robot.scored_joints]


def _pose(limits: JointLimits, rng: np.random.Generator, share: float) -> Float64[np.ndarray, "J"]:
    middle, half = 0.5 * (limits.low + limits.high), 0.5 * (limits.high - limits.low)
    return np.asarray(middle + share * half * rng.uniform(-1.0, 1.0, middle.size))


def _multisines(
    nominal: Nominal,
    limits: JointLimits,
    home: Float64[np.ndarray, "J"],
    length_s: float,
    rng: np.random.Generator,
) -> Profile:
    """Every joint at once, at all frequencies up to 1 Hz, around a pose."""
    moving, clock = _moving(nominal), ClockSettings(RATE_HZ)
    reference = ReferenceSettings(duration_s=length_s, ramp_s=0.5)
    functions = {column: multisine(rng, base_hz=1.0 / length_s, highest_hz=1.0) for column in moving}
    unit = shape(functions, home.size, clock, reference)
    center = home.copy()
    center[moving] = _pose(limits, rng, INNER / 2)[moving]
    factor = amplitudes(unit, clock.timestep_s, center, limits, reference.position_share)
    return scaled(unit, factor, center)


def _moves(
    nominal: Nominal,
    limits: JointLimits,
    home: Float64[np.ndarray, "J"],
    length_s: float,
    rng: np.random.Generator,
) -> Profile:
    """From pose to pose, as quickly as the limits allow at times and slowly at others, with rests.

    Between two poses the position goes as s(x) = 10 x^3 - 15 x^4 + 6 x^5, whose largest slope is 1.875 and whose
    largest second derivative is 5.774.
    """
    moving, step_s = _moving(nominal), 1.0 / RATE_HZ
    count = round(length_s * RATE_HZ)
    at, rows = home.copy(), [np.zeros((3, 0, home.size))]
    at[moving] = _pose(limits, rng, INNER)[moving]
    done = 0
    while done < count:
        goal = at.copy()
        goal[moving] = _pose(limits, rng, INNER)[moving]
        change = goal - at
        fastest_s = max(
            float(np.max(1.875 * np.abs(change) / limits.velocity)),
            float(np.max(np.sqrt(5.774 * np.abs(change) / limits.acceleration))),
        )
        took_s = max(fastest_s, 5 * step_s) * float(rng.choice([1.0, 1.0, 2.5]))
        x = np.minimum(1.0, np.arange(1, round((took_s + _REST_S) * RATE_HZ) + 1) * step_s / took_s)[:, None]
        rows.append(
            np.stack(
                [
                    at + change * x**3 * (10 - 15 * x + 6 * x**2),
                    change / took_s * 30 * x**2 * (1 - x) ** 2,
                    change / took_s**2 * 60 * x * (1 - x) * (1 - 2 * x),
                ]
            )
        )
        done += len(x)
        at = goal
    return Profile(*np.concatenate(rows, axis=1))


def _episode(nominal: Nominal, profile: Profile, name: str, split: str) -> Episode:
    """The motion as measurement and command."""
    from trueup.identify.information import torque_along

    robot = nominal.robot
    lengths = [nominal.length_unit(joint) for joint in robot.joint_names]
    time_s = np.arange(len(profile.position)) / RATE_HZ
    way = {"position": profile.position, "velocity": profile.velocity}
    signal: str = robot.controller.signal
    if signal == "torque":
        motion = (profile.position, profile.velocity, profile.acceleration)
        told = {signal: torque_along(nominal.model, robot.joint_names, *motion)}
    else:
        told = {signal: way[signal]}
    told |= {"velocity": profile.velocity} if "velocity" in nominal.simulator.command_signals else {}

    def series(signals: Mapping[str, Float64[np.ndarray, "T J"]]) -> TimeSeries:
        units = {key: tuple(joint_unit(SI_UNIT[key], length) for length in lengths) for key in signals}
        return TimeSeries(time_s, robot.joint_names, dict(signals), units)

    return Episode(EpisodeMeta(name, robot=robot.name, split=split), series(way), series(told))
