"""The hardware behind `trueup demo`: the demo arm with other gains, friction, delay and payload than its model."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Float64

from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.timeseries import TimeSeries, same_units
from trueup.robots import ControllerSpec, RobotSpec, find_model, load_robot
from trueup.robots.model import load_spec
from trueup.sim import MujocoSimulator, ReplaySettings, replay_episode
from trueup.sim.friction import harden_friction

_RATE_HZ = 100.0
_MOTION_S = 10.0
_REST_S = 0.5  # at both ends of a motion
_SETTLE_S = 1.0  # before recording starts
_UNITS = {"position": "rad", "velocity": "rad/s", "torque": "Nm"}


@dataclass(frozen=True)
class DemoHardware:
    """What the demo arm's model does not know.

    Attributes:
        kp: servo gain [Nm/rad]; the model says 60.
        kv: servo damping [Nm s/rad]; the model says 1.5.
        damping: viscous friction [Nm s/rad]; the model says 0.4.
        frictionloss: Coulomb friction [Nm]; the model says 0.05.
        delay_s: from command to servo [s]; the model says 0.
        position_step_rad: encoder resolution [rad].
        velocity_noise: standard deviation of the velocity signal [rad/s].
        torque_noise_nm: standard deviation of the torque signal [Nm].
        hard_friction: dry friction holds a joint, as it does in reality; MuJoCo's default lets it creep.
    """

    kp: float = 38.0
    kv: float = 1.0
    damping: float = 0.9
    frictionloss: float = 0.45
    delay_s: float = 0.024
    position_step_rad: float = 0.0015
    velocity_noise: float = 0.01
    torque_noise_nm: float = 0.05
    hard_friction: bool = True

    def simulator(self, robot: RobotSpec, *, payload_kg: float) -> MujocoSimulator:
        """The true arm, with a payload at the tool."""
        path = find_model(robot)
        spec = load_spec(path)
        for joint in spec.joints:
            joint.damping[0] = self.damping  # the other entries are coefficients of higher powers
            joint.frictionloss = self.frictionloss
        if self.hard_friction:
            harden_friction(spec, robot.joint_names)
        spec.body("tool").mass += payload_kg
        servo = ControllerSpec(kind="position", kp=self.kp, kv=self.kv)
        joints = tuple(replace(joint, torque_limit=12.0) for joint in robot.joints)
        return MujocoSimulator.from_spec(spec, replace(robot, controller=servo, joints=joints), origin=path)


# Each row: name, split, payload [kg].
_MOTIONS = (
    ("reach_a", "train", 0.0),
    ("reach_b", "train", 0.4),
    ("multisine_slow", "train", 0.0),
    ("multisine_fast", "train", 0.4),
    ("chirp", "train", 0.0),
    ("steps", "train", 0.0),
    ("reach_c", "val", 0.0),
    ("multisine_mid", "val", 0.4),
    ("reach_d", "test", 0.0),
    ("reach_e", "test", 0.4),
    ("multisine_wide", "test", 0.0),
    ("waves", "test", 0.4),
)


def record_demo(*, seed: int = 0, hardware: DemoHardware | None = None, loads: bool = True) -> Iterator[Episode]:
    """Twelve motions of the demo arm's hardware: 10 s each at 100 Hz, at rest at both ends.

    Args:
        seed: of the motions and the sensor noise.
        hardware: what differs from the model; the default if None.
        loads: whether some motions carry something that the model does not know.

    Yields:
        Episodes with `command` (position) and `measured` (position, velocity, torque); 6 train, 2 val, 4 test,
        payloads 0 and, with `loads`, 0.4 kg.
    """
    hardware = hardware or DemoHardware()
    robot = load_robot("demo_arm")
    settings = ReplaySettings(delay_s=hardware.delay_s)
    simulators = {payload: hardware.simulator(robot, payload_kg=payload) for payload in (0.0, 0.4)}
    for index, (name, split, carried_kg) in enumerate(_MOTIONS):
        payload_kg = carried_kg if loads else 0.0
        rng = np.random.default_rng([seed, index])
        time_s = np.arange(round(-_SETTLE_S * _RATE_HZ), round(_MOTION_S * _RATE_HZ) + 1) / _RATE_HZ
        command = TimeSeries(
            time_s,
            robot.joint_names,
            {"position": _motion(name, time_s, len(robot.joints), rng)},
            same_units({"position": "rad"}, robot.joint_names),
        )
        meta = EpisodeMeta(
            id=name, robot=robot.name, unit="demo-1", payload_kg=payload_kg, split=split, source="trueup.lab"
        )
        # The command stands in for the pose at the start; recording begins when the arm has settled under gravity.
        truth = replay_episode(Episode(meta, command, command), simulators[payload_kg], settings)
        recorded = slice(int(np.searchsorted(time_s, 0.0)), None)
        yield Episode(meta, _sensed(truth.rows(recorded), hardware, rng), command.rows(recorded))


def _sensed(truth: TimeSeries, hardware: DemoHardware, rng: np.random.Generator) -> TimeSeries:
    """What the sensors make of the true motion."""
    step = hardware.position_step_rad
    signals = {
        "position": np.round(truth["position"] / step) * step,
        "velocity": truth["velocity"] + hardware.velocity_noise * rng.standard_normal(truth["velocity"].shape),
        "torque": truth["torque"] + hardware.torque_noise_nm * rng.standard_normal(truth["torque"].shape),
    }
    return replace(truth, signals=signals, units=same_units(_UNITS, truth.joints))


def _motion(
    name: str, time_s: Float64[np.ndarray, "T"], joints: int, rng: np.random.Generator
) -> Float[np.ndarray, "T J"]:
    """A commanded motion, (T, J) [rad], resting for half a second at both ends."""
    moving = np.clip((time_s - _REST_S) / (_MOTION_S - 2 * _REST_S), 0.0, 1.0)
    home = np.array([0.0, -0.6, 1.0])[:joints]
    kind = name.split("_")[0]
    if kind == "reach":
        return _through_waypoints(moving, home + rng.uniform(-0.9, 0.9, (5, joints)), smooth=True)
    if kind == "steps":
        return _through_waypoints(moving, home + rng.uniform(-0.4, 0.4, (7, joints)), smooth=False)
    # A smooth envelope brings the oscillation to rest at both ends.
    envelope = np.sin(np.pi * moving)[:, None] ** 2
    seconds = moving[:, None] * (_MOTION_S - 2 * _REST_S)
    if kind == "chirp":
        wave = np.sin(2 * np.pi * (0.2 * seconds + 0.5 * (2.0 - 0.2) / seconds[-1] * seconds**2))
        waves = 0.35 * envelope * wave * np.array([1.0, -0.8, 0.9])[:joints]
        return np.asarray(home + waves)
    top_hz = {"slow": 0.6, "fast": 1.4, "mid": 1.2, "wide": 0.9}.get(name.split("_")[-1], 1.5)
    waves = np.zeros((time_s.size, joints))
    for _ in range(4):
        frequency, phase = rng.uniform(0.15, top_hz, joints), rng.uniform(0.0, 2 * np.pi, joints)
        waves += rng.uniform(0.1, 0.3, joints) * np.sin(2 * np.pi * frequency * seconds + phase)
    return np.asarray(home + envelope * waves)


def _through_waypoints(
    moving: Float64[np.ndarray, "T"], waypoints: Float[np.ndarray, "K J"], *, smooth: bool
) -> Float[np.ndarray, "T J"]:
    position = moving * (len(waypoints) - 1)
    leg = np.minimum(position.astype(int), len(waypoints) - 2)
    share = (position - leg)[:, None]
    # Minimum-jerk profile from waypoint to waypoint, or a jump in the middle of each leg.
    blend = share**3 * (10 - 15 * share + 6 * share**2) if smooth else (share >= 0.5).astype(float)
    return np.asarray(waypoints[leg] * (1 - blend) + waypoints[leg + 1] * blend)
