"""Robots whose truth is known, their logs with noise, and wrong models to start from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.parameters import ParameterSet
from trueup.core.timeseries import TimeSeries, same_units
from trueup.identify import Nominal, Problem, SegmentRule, make_segments
from trueup.identify.config import make_parameters
from trueup.robots import ControllerSpec, JointGains, find_model, load_robot
from trueup.sim import MujocoSimulator, ReplaySettings, replay_episode

POSITION_NOISE = 1e-4  # rad; velocities have ten times that in rad/s
_SECONDS, _RATE_HZ, _LOGS = 2.0, 1000.0, 4
_POSE = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])
# Gains of the joint impedance example that comes with the real arm's driver.
_KP = (600.0, 600.0, 600.0, 600.0, 250.0, 150.0, 50.0)
_KV = (50.0, 50.0, 50.0, 50.0, 30.0, 25.0, 15.0)
_PANDA = {
    "frictionloss": (0.9, 0.8, 0.7, 0.8, 0.4, 0.3, 0.25),
    "damping": (3.0, 2.5, 2.0, 2.2, 0.9, 0.6, 0.4),
    "armature": (0.35, 0.4, 0.3, 0.3, 0.12, 0.1, 0.06),
}
_PANDA_FIT = {
    "frictionloss": {"low": 1e-3, "high": 50.0},
    "damping": {"low": 1e-3, "high": 100.0},
    "armature": {"low": 1e-3, "high": 10.0},
}


@dataclass(frozen=True)
class Case:
    """One problem of identification.

    Attributes:
        nominal: the model that everybody starts from.
        true: parameter name -> value that made the logs.
        start: the parameters at their wrong start.
        logs: what was measured.
    """

    nominal: Nominal
    true: Mapping[str, float]
    start: ParameterSet
    logs: tuple[Episode, ...]

    def problem(self, *, jobs: int, window_s: float | None = None) -> Problem:
        """All logs, whole or in windows."""
        segments, _ = make_segments(self.logs, self.nominal.simulator, SegmentRule(window_s=window_s))
        return Problem(self.nominal, self.start, segments, jobs=jobs)

    def errors(self, values: Mapping[str, float]) -> np.ndarray:
        """Relative error of each parameter."""
        return np.array([abs(values[name] / true - 1.0) for name, true in self.true.items()])


def panda_case(seed: int, *, torque: bool = False) -> Case:
    """21 parameters of a Panda, 4 motions of 2 s by position servos or torques, from a start 2 to 5 times off.

    The servos leave the arm's weight to the controller, as the real one does; the torques carry it.
    """
    robot = load_robot("panda_torque")
    if torque:
        robot = replace(robot, simulation=replace(robot.simulation, gravity_compensation=False))
    else:
        servos = {joint: JointGains(kp=kp, kv=kv) for joint, kp, kv in zip(robot.joint_names, _KP, _KV, strict=True)}
        robot = replace(robot, controller=ControllerSpec(kind="position", kp=_KP[0], kv=_KV[0], per_joint=servos))
    nominal = Nominal(robot, find_model(robot))
    true = {
        f"{name}[{joint}]": value
        for name, values in _PANDA.items()
        for joint, value in zip(robot.joint_names, values, strict=True)
    }
    rng = np.random.default_rng(seed)
    wrong = {name: value * rng.uniform(2.0, 5.0) ** rng.choice([-1.0, 1.0]) for name, value in true.items()}
    parameters = make_parameters(_PANDA_FIT, nominal)
    # Without a prior, so that all solvers look for the same minimum.
    parameters = ParameterSet(tuple(replace(parameter, prior_std=None) for parameter in parameters.at(wrong)))
    simulator, _ = true_simulator(nominal, parameters, true)
    make_log = _torque_log if torque else _servo_log
    logs = tuple(make_log(simulator, np.random.default_rng([seed, number])) for number in range(_LOGS))
    return Case(nominal, true, parameters, logs)


def true_simulator(
    nominal: Nominal, parameters: ParameterSet, true: Mapping[str, float]
) -> tuple[MujocoSimulator, tuple[float, ...]]:
    """The robot as it really is, and its delays."""
    candidate = Problem(nominal, parameters, ()).candidate(true)
    delays = tuple(float(delay_s) for delay_s in candidate.delays)
    return MujocoSimulator(candidate.compile(), nominal.robot, nominal.simulator.channels), delays


def record(
    simulator: MujocoSimulator,
    command: TimeSeries,
    rng: np.random.Generator,
    *,
    position: np.ndarray,
    noise: float,
    rate_hz: float,
    delays: Sequence[float] = (),
) -> Episode:
    """What the robot does from rest at `position` (J,) under a command, measured with noise."""
    time_s = np.arange(round(command.duration_s * rate_hz) + 1) / rate_hz
    joints = command.joints
    place = np.tile(position, (time_s.size, 1))
    units = same_units({"position": "rad", "velocity": "rad/s"}, joints)
    seen = TimeSeries(time_s, joints, {"position": place, "velocity": np.zeros_like(place)}, units)
    meta = EpisodeMeta(f"log{rng.integers(1 << 30)}", split="train")
    settings = ReplaySettings(delay_s=tuple(delays) or 0.0)
    true = replay_episode(Episode(meta, seen, command), simulator, settings)
    signals = {
        "position": true["position"] + noise * rng.standard_normal(place.shape),
        "velocity": true["velocity"] + 10.0 * noise * rng.standard_normal(place.shape),
        "torque": true["torque"],
    }
    return Episode(meta, replace(true, signals=signals), command)


def commanded(time_s: np.ndarray, joints: Sequence[str], signal: str, values: np.ndarray) -> TimeSeries:
    """A command of one signal."""
    unit = {"position": "rad", "torque": "Nm"}[signal]
    return TimeSeries(time_s, tuple(joints), {signal: values}, same_units({signal: unit}, tuple(joints)))


def _servo_log(simulator: MujocoSimulator, rng: np.random.Generator) -> Episode:
    time_s, motion = _motion(rng)
    command = commanded(time_s, simulator.joints, "position", motion)
    return record(simulator, command, rng, position=motion[0], noise=POSITION_NOISE, rate_hz=_RATE_HZ)


def _torque_log(simulator: MujocoSimulator, rng: np.random.Generator) -> Episode:
    """Torques found by following a smooth motion with some excitation, and then applied open loop."""
    time_s, motion = _motion(rng)
    velocity = np.gradient(motion, time_s, axis=0)
    stiff, damped = np.array(_KP) / 4.0, np.array(_KV) / 4.0
    limits = np.array([simulator.torque_limits[joint] for joint in simulator.joints])
    noise = 0.03 * limits * _band(rng, time_s, low_hz=3.0, high_hz=8.0)
    torques = np.zeros_like(motion)
    simulator.reset(motion[:1], np.zeros((1, motion.shape[1])))
    state = {"position": motion[:1], "velocity": np.zeros((1, motion.shape[1]))}
    for row in range(time_s.size):
        error = motion[row] - state["position"][0]
        torque = stiff * error + damped * (velocity[row] - state["velocity"][0]) + noise[row]
        torques[row] = np.clip(torque, -0.9 * limits, 0.9 * limits)
        state = simulator.step({"torque": torques[row][None]})
    command = commanded(time_s, simulator.joints, "torque", torques)
    return record(simulator, command, rng, position=motion[0], noise=POSITION_NOISE, rate_hz=_RATE_HZ)


def _motion(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A smooth motion that starts at rest in the middle of the range; (T,) and (T, 7)."""
    time_s = np.arange(round(_SECONDS * _RATE_HZ) + 1) / _RATE_HZ
    begin = np.minimum(time_s / 0.25, 1.0)[:, None] ** 2
    return time_s, _POSE + 0.35 * begin * _band(rng, time_s, low_hz=0.4, high_hz=2.0)


def _band(rng: np.random.Generator, time_s: np.ndarray, *, low_hz: float, high_hz: float) -> np.ndarray:
    """Three sines per joint between two frequencies, largest value 1, zero at the beginning; (T, 7)."""
    frequency, phase = rng.uniform(low_hz, high_hz, (3, 1, 7)), rng.uniform(0.0, 2 * np.pi, (3, 1, 7))
    size = rng.uniform(0.4, 1.0, (3, 1, 7))
    waves = size * (np.sin(2 * np.pi * frequency * time_s[None, :, None] + phase) - np.sin(phase))
    total: np.ndarray = waves.sum(axis=0)
    return total / np.abs(total).max(axis=0)
