"""Recordings of the small arm with and without something in its hand, made by plain MuJoCo with numbers of its own."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from check.arm_logs import arm, logs
from trueup.robots import SimulationSpec

PLACE = (0.2, 0.03, -0.02)  # where it is held, in the frame of the forearm [m]


def described(folder, signal):
    """The arm as its user has it: with a time step twice as long as that of the recordings."""
    robot, path = arm(folder, signal)
    return robot, replace(robot, simulation=SimulationSpec(timestep_s=0.002)), path


def record(folder, signal, kg, rng, *, count, place=PLACE, change=None):
    """Motions of an arm whose drives are softer, and whose joints rub more, than its model says."""
    true, _, path = described(folder, signal)

    def hardware(model):
        model.dof_damping[:] *= 1.5
        model.dof_frictionloss[:] *= 1.4
        if signal == "position":
            model.actuator_gainprm[:, 0] *= 0.8
            model.actuator_biasprm[:, 1] *= 0.8
        if kg:
            hang(model, "fore", kg, place)
        if change is not None:
            change(model)

    return logs(true, path, rng, count=count, change=hardware)


def hang(model, body, kg, place):
    """A ball with a radius of gyration of 2 cm at a place of a body."""
    number, place = model.body(body).id, np.array(place)
    axes = np.empty(9)
    mujoco.mju_quat2Mat(axes, model.body_iquat[number])
    axes = axes.reshape(3, 3)
    mass, center = model.body_mass[number], model.body_ipos[number].copy()
    both = (mass * center + kg * place) / (mass + kg)
    inertia = axes @ np.diag(model.body_inertia[number]) @ axes.T + kg * 0.02**2 * np.eye(3)
    for part, own in ((mass, center), (kg, place)):
        off = own - both
        inertia += part * ((off @ off) * np.eye(3) - np.outer(off, off))
    moments, vectors = np.linalg.eigh(inertia)
    vectors[:, 0] *= np.sign(np.linalg.det(vectors))
    turned = np.empty(4)
    mujoco.mju_mat2Quat(turned, vectors.ravel())
    model.body_sameframe[number] = 0  # or MuJoCo takes the axes of inertia for those of the body
    model.body_mass[number], model.body_ipos[number] = mass + kg, both
    model.body_inertia[number], model.body_iquat[number] = moments, turned


def save(folder, episodes):
    """As logs that a user would have: a file for each motion."""
    folder = Path(folder)
    folder.mkdir(parents=True)
    for episode in episodes:
        measured, command = episode.measured, episode.command
        np.savez(
            folder / f"{episode.id}.npz",
            joints=np.array(measured.joints),
            **{f"measured.{name}": measured[name] for name in measured.signals},
            **{f"command.{name}": command[name] for name in command.signals},
            **{"measured.time_s": measured.time_s, "command.time_s": command.time_s},
        )
    return folder
