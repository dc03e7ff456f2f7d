"""A small arm under position commands, simulated and recorded by a robot that is a little different."""

from dataclasses import replace

import numpy as np

from identify.recovery_cases import JOINTS, SERVO, arm, wave
from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.timeseries import TimeSeries, same_units
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter
from trueup.robots import PayloadSpec, Setup
from trueup.sim import MujocoSimulator
from trueup.sim.transitions import Transitions

CONTROL_S = 0.02
UNITS = {"position": ("rad",) * 2, "velocity": ("rad/s",) * 2}


def arm_of(folder, *, friction=True):
    """Its description, with a payload, and its model."""
    folder.mkdir(exist_ok=True)
    robot, path = arm(folder, SERVO)
    if not friction:
        text = path.read_text()
        for own in ("0.3", "0.15"):
            text = text.replace(f'frictionloss="{own}"', "")
        path.write_text(text)
    return replace(robot, payload=PayloadSpec(("payload",)), folder=folder), path


def transitions_of(robot, path, *, payload_kg=0.0, delay_s=0.0):
    return Transitions(MujocoSimulator.from_robot(robot, path, setup=Setup(payload_kg)), CONTROL_S, delay_s)


def states(count, seed=0, *, spread=0.3):
    """States and commands of the arm, (count, 4), (count, 2), (count, 2)."""
    rng = np.random.default_rng(seed)
    position = rng.normal(0, spread, (count, 2))
    state = np.concatenate([position, rng.normal(0, 0.5, (count, 2))], axis=1)
    return state, position + rng.normal(0, 0.05, (count, 2)), position + rng.normal(0, 0.05, (count, 2))


def moved(transitions, command, offset, state):
    """What a robot does that is the simulator, with commands that are off."""
    rows, before = [state], command[:1] + offset(state, command[0])
    for wanted in command[:, None]:
        sent = wanted + offset(rows[-1], wanted[0])
        rows.append(transitions.next(rows[-1], before, sent))
        before = sent
    return np.concatenate(rows[:-1])


def recorded(folder, robot, path, *, offset, payloads=(0.0, 1.0), motions=4, seconds=2.4, command=True):
    """A dataset of a robot that is the simulator with commands that are off by `offset(state, command, payload)`."""
    with DatasetWriter.create(folder, DatasetInfo(robot=robot.name)) as writer:
        for payload_kg in payloads:
            transitions = transitions_of(robot, path, payload_kg=payload_kg)
            for number in range(motions):
                time_s, target = wave(seconds, 1 / CONTROL_S, number)
                state = np.concatenate([target[:1], np.zeros((1, 2))], axis=1)
                for _ in range(100):
                    state = transitions.next(state, target[:1], target[:1] + offset(state, target[0], payload_kg))
                own = lambda s, u, kg=payload_kg: offset(s, u, kg)  # noqa: E731
                done = moved(transitions, target, own, state)
                split = "train" if number < motions - 2 else ("val" if number == motions - 2 else "test")
                meta = EpisodeMeta(f"m{number}/{payload_kg:g}kg", payload_kg=payload_kg, split=split)
                signals = {"position": done[:, :2], "velocity": done[:, 2:]}
                asked = TimeSeries(time_s, JOINTS, {"position": target}, same_units({"position": "rad"}, JOINTS))
                writer.append(Episode(meta, TimeSeries(time_s, JOINTS, signals, UNITS), asked if command else None))
    return Dataset(folder)
