"""A made-up robot of bodies whose difference from their simulator is known, as a dataset with a simulated run."""

import numpy as np
from scipy.spatial.transform import Rotation

from augment.augment_cases import RATE_HZ, RUN, robot, write_run
from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.timeseries import TimeSeries, same_units
from trueup.core.units import SI_UNIT
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter

BODIES = ("thigh", "shank", "foot")
JOINTS = ("hip",)


def motion(rng, samples, *, noise=0.0, bodies=BODIES):
    """Simulated and measured: real bodies sag by what pulls at them, and are turned by a part of the torque."""
    time_s = np.arange(samples) / RATE_HZ
    shape = (samples, len(bodies), 3)
    phase, rate = rng.uniform(0, 6, shape[1:]), rng.uniform(1, 4, shape[1:])
    swing = np.sin(rate * time_s[:, None, None] + phase)
    force, torque = 10 * np.cos(swing + phase), np.sin(2 * swing)
    rotation = Rotation.from_rotvec(swing.reshape(-1, 3)).as_matrix().reshape(*shape, 3)
    turned = Rotation.from_rotvec(0.05 * torque.reshape(-1, 3)).as_matrix().reshape(*shape, 3)
    simulated = {
        "body.position": 0.2 * swing + 0.3,
        "body.rotation": rotation,
        "body.velocity": 0.2 * rate * np.cos(rate * time_s[:, None, None] + phase),
        "body.angular_velocity": np.zeros(shape),
        "body.force": force,
        "body.torque": torque,
    }
    position = simulated["body.position"] + 1e-3 * force + noise * rng.normal(size=shape)
    measured = {"body.position": position, "body.rotation": turned @ rotation}
    start = rng.uniform(0, 6)
    joint = {"position": np.sin(time_s[:, None] + start), "velocity": np.cos(time_s[:, None] + start)}
    return tuple(series_of(time_s, {**joint, **kind}, bodies) for kind in (simulated, measured))


def series_of(time_s, signals, bodies=BODIES, joints=JOINTS):
    units = {name: (SI_UNIT[name],) * len(bodies if name.startswith("body.") else joints) for name in signals}
    return TimeSeries(time_s, joints, signals, units, bodies)


def make_bodies(folder, *, counts=(10, 4, 5), samples=(50, 90), seed=0, drop=(), spoil=None, **kwargs):
    """Motions of the splits with a run; `drop` are measured signals to leave out, `spoil` changes what is measured."""
    rng = np.random.default_rng(seed)
    runs = {}
    with DatasetWriter.create(folder, DatasetInfo(robot="arm")) as writer:
        for split, count in zip(("train", "val", "test"), counts, strict=True):
            for number in range(count):
                simulated, measured = motion(rng, int(rng.integers(*samples)), **kwargs)
                signals = {name: values for name, values in measured.signals.items() if name not in drop}
                signals = spoil(signals) if spoil else signals
                meta = EpisodeMeta(f"{split}{number}", split=split)
                command = TimeSeries(
                    measured.time_s,
                    JOINTS,
                    {"position": measured["position"]},
                    same_units({"position": "rad"}, JOINTS),
                )
                writer.append(Episode(meta, series_of(measured.time_s, signals, measured.bodies), command))
                runs[meta.id] = simulated
    write_run(folder, runs, robot(JOINTS))
    return Dataset(folder)


__all__ = ["BODIES", "JOINTS", "RUN", "make_bodies", "motion", "series_of"]
