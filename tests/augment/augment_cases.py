"""Made-up robots whose difference from their simulator is known, as a dataset with a simulated run."""

import numpy as np

from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.timeseries import TimeSeries, same_units
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter, RunWriter
from trueup.robots import JointSpec, RobotSpec

JOINTS = ("pan", "lift")
UNITS = {"position": "rad", "velocity": "rad/s", "torque": "Nm"}
RUN = "mujoco/stock"
RATE_HZ = 100.0


def robot(joints=JOINTS):
    return RobotSpec(
        name="arm", model="arm.xml", joints=tuple(JointSpec(name, position_limits=(-3.0, 3.0)) for name in joints)
    )


def motion(rng, samples, *, noise=0.0, perfect=("velocity",), joints=JOINTS):
    """Simulated and measured signals: the robot's torque lags behind the simulator's and has an offset.

    Signals in `perfect` are simulated as they are measured.
    """
    time_s = np.arange(samples) / RATE_HZ
    phase = rng.uniform(0, 6, len(joints))
    rate = rng.uniform(1, 4, len(joints))
    position = np.sin(rate * time_s[:, None] + phase)
    velocity = rate * np.cos(rate * time_s[:, None] + phase)
    torque = 5 * np.cos(position) + 0.5 * velocity
    simulated = {
        "position": position + 0.02 * velocity,
        "velocity": velocity + 0.1 * np.sign(velocity),
        "torque": torque + 1.5 * (-1.0) ** np.arange(samples)[:, None] + 0.8,
    }
    measured = {"position": position, "velocity": velocity, "torque": torque}
    for name in perfect:
        simulated[name] = measured[name]
    measured = {name: values + noise * rng.normal(size=values.shape) for name, values in measured.items()}
    return tuple(TimeSeries(time_s, joints, kind, same_units(UNITS, joints)) for kind in (simulated, measured))


def make_dataset(
    folder, *, counts=(8, 4, 3), samples=(60, 120), noise=0.0, perfect=("velocity",), unmeasured=(), seed=0, **kwargs
):
    """Motions of the splits train, val and test, of the conditions fast and slow, with the run `mujoco/stock`."""
    rng = np.random.default_rng(seed)
    arm = robot(kwargs.get("joints", JOINTS))
    runs = {}
    with DatasetWriter.create(folder, DatasetInfo(robot="arm")) as writer:
        for split, count in zip(("train", "val", "test"), counts, strict=True):
            for number in range(count):
                simulated, measured = motion(rng, int(rng.integers(*samples)), noise=noise, perfect=perfect, **kwargs)
                known = {name: values for name, values in measured.signals.items() if name not in unmeasured}
                units = {name: measured.units[name] for name in known}
                measured = TimeSeries(measured.time_s, measured.joints, known, units)
                meta = EpisodeMeta(f"{split}{number}", split=split, condition=("fast", "slow")[number % 2])
                command = TimeSeries(
                    measured.time_s,
                    measured.joints,
                    {"position": measured["position"]},
                    same_units({"position": "rad"}, measured.joints),
                )
                writer.append(Episode(meta, measured, command))
                runs[meta.id] = simulated
    write_run(folder, runs, arm)
    return Dataset(folder)


def write_run(folder, runs, arm, label=RUN):
    info = {
        "joint_map": arm.joint_rules(),
        "joints": list(arm.joint_names),
        "scored_joints": list(arm.scored_joints),
        "command_signal": "position",
        "torque_limits": dict.fromkeys(arm.joint_names, 20.0),
        "settings": {"window_s": None, "initial_velocity": "zero"},
        "inputs": {"robot": arm.to_dict(), "model_sha256": "0"},
    }
    with RunWriter(folder, label, run_info=info) as writer:
        for name, series in runs.items():
            writer.append(name, series)
