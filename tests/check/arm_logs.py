"""Logs of a small arm, made in plain MuJoCo, and what may be wrong with them."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from trueup.align import JointMap
from trueup.check import check_motions
from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.timeseries import TimeSeries, same_units
from trueup.robots import ControllerSpec, JointSpec, RobotSpec, SimulationSpec
from trueup.sim import MujocoSimulator

ARM = """
<mujoco>
  <option timestep="0.001" gravity="0 0 -9.81"/>
  <worldbody>
    <body name="base" pos="0 0 0.1">
      <joint name="yaw" axis="0 0 1" range="-170 170" damping="0.2" armature="0.02" frictionloss="0.1"/>
      <inertial pos="0 0.02 0.05" mass="1.5" diaginertia="0.01 0.01 0.006"/>
      <body name="upper" pos="0 0 0.1">
        <joint name="lift" axis="0 1 0" range="-100 120" damping="0.3" armature="0.03" frictionloss="0.2"/>
        <inertial pos="0.02 0 0.14" mass="1.2" diaginertia="0.012 0.012 0.002"/>
        <body name="fore" pos="0 0 0.28">
          <joint name="elbow" axis="0 1 0" range="-30 145" damping="0.15" armature="0.01" frictionloss="0.1"/>
          <inertial pos="0.11 0 0.01" mass="0.7" diaginertia="0.002 0.006 0.006"/>
          <site name="tool" pos="0.22 0 0"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
UNITS = {"position": "rad", "velocity": "rad/s", "torque": "Nm"}
CONTROLLERS = {
    "position": ControllerSpec(kind="position", kp=60.0, kv=4.0),
    "velocity": ControllerSpec(kind="velocity", kv=12.0),
    "torque": ControllerSpec(kind="torque"),
}
RATE_HZ, NOISE, DURATION_S = 100, 3e-4, 6.0


def arm(folder, signal):
    """The arm, driven by a signal, and its model."""
    path = Path(folder) / "arm.xml"
    path.write_text(ARM)
    robot = RobotSpec(
        name="arm",
        joints=tuple(JointSpec(name) for name in ("yaw", "lift", "elbow")),
        model=path.name,
        controller=CONTROLLERS[signal],
        simulation=SimulationSpec(timestep_s=0.001),
        folder=path.parent,
    )
    return robot, path


def logs(robot, path, rng, *, count=3, gravity=None, change=None, still=False):
    """Motions of it: sums of sines around the middle of each range, from commands that are held between samples.

    `change` may do something to the compiled model, which robot and path know nothing of.
    """
    return [_motion(robot, path, rng, f"motion_{number}", gravity, change, still) for number in range(count)]


def _motion(robot, path, rng, name, gravity, change, still):
    simulator = MujocoSimulator.from_robot(robot, path)
    model, signal = simulator.model, robot.controller.signal
    if gravity is not None:
        model.opt.gravity[:] = gravity
    if change is not None:
        change(model)
    data = mujoco.MjData(model)
    joints, limits = len(robot.joints), simulator.position_limits
    ranges = np.clip([limits[joint] for joint in robot.joint_names], -2.2, 2.5)
    frequency, phase = rng.uniform(0.15, 0.7, (joints, 3)), rng.uniform(0, 6.28, (joints, 3))
    size = rng.dirichlet(np.ones(3), joints) * 0.4 * np.ptp(ranges, axis=1)[:, None]

    def wanted(time_s):
        time_s = 1.2 * np.floor(time_s / 1.2) if still else time_s
        angle = 2 * np.pi * frequency * time_s + phase
        rate = np.sum(size * 2 * np.pi * frequency * np.cos(angle), axis=1)
        return ranges.mean(axis=1) + np.sum(size * np.sin(angle), axis=1), 0.0 * rate if still else rate

    data.qpos[:] = wanted(0.0)[0]
    mujoco.mj_forward(model, data)
    rows, command = [], np.zeros(joints)
    for step in range(round(DURATION_S * 1000)):
        if step % (1000 // RATE_HZ) == 0:
            position, velocity = data.qpos.copy(), data.qvel.copy()
            goal, rate = wanted(0.001 * step)
            if signal == "position":
                command = goal
            elif signal == "velocity":
                command = rate + 2.0 * (goal - position)
            else:
                command = 30.0 * (goal - position) + 3.0 * (rate - velocity) + data.qfrc_bias
            noise = rng.normal(0, NOISE, (2, joints)) * [[1.0], [10.0]]
            rows.append((0.001 * step, position + noise[0], velocity + noise[1], command.copy()))
        data.ctrl[:] = command
        mujoco.mj_step(model, data)
    time_s, position, velocity, commanded = (np.array(column) for column in zip(*rows, strict=True))
    names = robot.joint_names
    return Episode(
        EpisodeMeta(name),
        TimeSeries(
            time_s,
            names,
            {"position": position, "velocity": velocity},
            same_units({n: UNITS[n] for n in ("position", "velocity")}, names),
        ),
        TimeSeries(time_s.copy(), names, {signal: commanded}, same_units({signal: UNITS[signal]}, names)),
    )


def look(robot, path, episodes):
    """The findings of a check, read as robot.yaml says."""
    joint_map = JointMap.from_dict(robot.joint_rules())
    return check_motions([joint_map.of_episode(episode) for episode in episodes], robot, path)[0]


def changed(episodes, change, *, measured=True, command=True):
    """All motions with their signals changed by a function of name and values."""

    def series(item):
        return replace(item, signals={name: change(name, values.copy()) for name, values in item.signals.items()})

    return [
        replace(
            episode,
            measured=series(episode.measured) if measured else episode.measured,
            command=series(episode.command) if command else episode.command,
        )
        for episode in episodes
    ]


def mirrored(joint):
    def change(_, values):
        values[:, joint] *= -1
        return values

    return change


def swapped(one, other):
    def change(_, values):
        values[:, [one, other]] = values[:, [other, one]]
        return values

    return change


def scaled(joint, factor, offset=0.0, *, rates=False):
    def change(name, values):
        if name == "position" or rates:
            values[:, joint] = factor * values[:, joint] + (offset if name == "position" else 0.0)
        return values

    return change
