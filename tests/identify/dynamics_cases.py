"""Torque logs of arms whose parameters are known, simulated by MuJoCo and by nothing of what is tested."""

import mujoco
import numpy as np

from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.timeseries import TimeSeries, same_units

UNITS = {"position": "rad", "velocity": "rad/s", "torque": "Nm"}


def torque_driven(model, *, motions, seconds, home, reach, stiffness, seed, noise=(1e-5, 0.02), top_hz=1.2):
    """Episodes of a torque-driven arm that follows multisines; noise on position [rad] and torque [Nm]."""
    names = tuple(model.joint(number).name for number in range(model.njnt))
    plain = mujoco.MjModel.__copy__(model)
    plain.opt.disableflags |= (
        mujoco.mjtDisableBit.mjDSBL_ACTUATION | mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    )
    damping = 0.1 * np.asarray(stiffness)
    for index in range(motions):
        rng = np.random.default_rng([seed, index])
        data = mujoco.MjData(plain)
        data.qpos[:] = home
        step = plain.opt.timestep
        clock = np.arange(round(seconds / step)) * step
        hz = rng.uniform(0.2, top_hz, (3, model.nv))
        phase = rng.uniform(0, 2 * np.pi, (3, model.nv))
        angles = 2 * np.pi * hz[:, None] * clock[:, None] + phase[:, None]
        wave = np.asarray(reach) / 2 * (np.sin(angles) - np.sin(phase)[:, None]).sum(axis=0)
        gravity = mujoco.MjData(plain)
        gravity.qpos[:] = home
        mujoco.mj_forward(plain, gravity)
        hold = gravity.qfrc_bias.copy()
        rows = {"position": [], "velocity": [], "torque": []}
        for target in np.asarray(home) + wave:
            torque = hold + stiffness * (target - data.qpos) - damping * data.qvel
            for name, values in (("position", data.qpos), ("velocity", data.qvel), ("torque", torque)):
                rows[name].append(values.copy())
            data.qfrc_applied[:] = torque
            mujoco.mj_step(plain, data)
        truth = {name: np.array(values) for name, values in rows.items()}
        command = TimeSeries(clock, names, {"torque": truth["torque"]}, same_units({"torque": "Nm"}, names))
        sensed = dict(truth)
        sensed["position"] = truth["position"] + noise[0] * rng.standard_normal(truth["position"].shape)
        sensed["torque"] = truth["torque"] + noise[1] * rng.standard_normal(truth["torque"].shape)
        measured = TimeSeries(clock, names, sensed, same_units(UNITS, names))
        yield Episode(EpisodeMeta(f"motion_{index}", split="train"), measured, command)
