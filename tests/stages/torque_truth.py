"""Logs of an arm with two joints, moved by plain MuJoCo at 0.5 ms with numbers that its model does not have."""

import functools

import mujoco
import numpy as np

from trueup.robots import ControllerSpec, JointSpec, RobotSpec

ARM = """
<mujoco>
  <option timestep="0.0005" integrator="implicitfast"/>
  <worldbody>
    <body name="upper">
      <joint name="lift" axis="0 1 0" damping="{damping}" armature="{armature}" frictionloss="{dry}"/>
      <inertial pos="0.02 0 -0.14" mass="{upper}" diaginertia="0.012 0.012 0.002"/>
      <body name="fore" pos="0 0 -0.28">
        <joint name="elbow" axis="0 1 0" damping="{damping}" armature="{armature}" frictionloss="{dry}"/>
        <inertial pos="0.02 0 -0.11" mass="{fore}" diaginertia="0.006 0.006 0.002"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
MODEL = {"damping": 0.1, "armature": 0.01, "dry": 0.05, "upper": 1.2, "fore": 0.7}
TRUE = {"damping": 0.3, "armature": 0.03, "dry": 0.2, "upper": 1.5, "fore": 0.9}
JOINTS = ("lift", "elbow")
KP, KV = np.array([60.0, 25.0]), np.array([5.0, 2.0])
GAIN, OFFSET = np.array([0.9, 1.1]), np.array([0.1, -0.05])
DELAY_S, STEP_S, RATE_HZ, SECONDS = 0.01, 0.0005, 100, 3.0
CONTROLLERS = {
    "position": ControllerSpec(kind="position", kp=40.0, kv=3.0),
    "velocity": ControllerSpec(kind="velocity", kv=4.0),
    "torque": ControllerSpec(kind="torque"),
}


def robot(folder, drive, factors=None):
    """What its user says of it."""
    (folder / "arm.xml").write_text(ARM.format(**MODEL))
    joints = tuple(JointSpec(name, torque_constant_nm_a=(factors or {}).get(name)) for name in JOINTS)
    return RobotSpec(name="arm", joints=joints, model="arm.xml", controller=CONTROLLERS[drive], folder=folder)


def motion(drive, seed, numbers=TRUE):
    """Arrays of one motion, noiseless: stamps, position, velocity, torque, and what was commanded."""
    return _motion(drive, seed, tuple(numbers.items()))


@functools.cache
def _motion(drive, seed, items):
    numbers = dict(items)
    rng = np.random.default_rng([seed, 11])
    model = mujoco.MjModel.from_xml_string(ARM.format(**numbers))
    data = mujoco.MjData(model)
    hz, phase, size = rng.uniform(0.3, 1.1, (3, 2)), rng.uniform(0, 6.28, (3, 2)), rng.uniform(0.1, 0.35, (3, 2))
    rows, late = [], round(DELAY_S / STEP_S)
    held = []
    for step in range(round(SECONDS / STEP_S)):
        t = STEP_S * step
        angle = 2 * np.pi * hz * t + phase
        goal, rate = (size * np.sin(angle)).sum(axis=0), (size * 2 * np.pi * hz * np.cos(angle)).sum(axis=0)
        if step == 0:
            data.qpos[:], data.qvel[:] = goal, rate
        logged = step % round(1 / RATE_HZ / STEP_S) == 0
        if logged:
            position, velocity = data.qpos.copy(), data.qvel.copy()
            mujoco.mj_forward(model, data)
            weight = data.qfrc_bias.copy()
            commands = {
                "position": goal,
                "velocity": rate + 3.0 * (goal - position),
                "torque": weight + 20.0 * (goal - position) + 2.0 * (rate - velocity),
            }
            command = commands[drive]
        held.append(command)
        told = held[max(step - late, 0)]
        if drive == "position":
            torque = KP * (told - data.qpos) - KV * data.qvel
        elif drive == "velocity":
            torque = KV * 4.0 * (told - data.qvel)
        else:
            torque = GAIN * told + OFFSET
        if logged:
            rows.append((t, position, velocity, torque.copy(), command))
        data.qfrc_applied[:] = torque
        mujoco.mj_step(model, data)
    return [np.array(column) for column in zip(*rows, strict=True)]


def write_logs(folder, drive, *, count=5, numbers=TRUE, change=None, signal="torque"):
    """npz files as a robot would log them; `change` may do something to the torque of a motion."""
    folder.mkdir(parents=True)
    for number in range(count):
        time_s, position, velocity, torque, command = motion(drive, number, numbers)
        torque = torque if change is None else change(number, torque)
        np.savez(
            folder / f"m{number}.npz",
            joints=np.array(JOINTS),
            **{"measured.time_s": time_s, "measured.position": position, "measured.velocity": velocity},
            **{f"measured.{signal}": torque, "command.time_s": time_s, f"command.{drive}": command},
        )
    return folder
