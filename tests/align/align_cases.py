"""Series and episodes for the tests of align, and a servo with stiction, gravity and a hard stop."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.timeseries import TimeSeries

UNITS = {"position": "rad", "velocity": "rad/s", "acceleration": "rad/s^2", "torque": "Nm", "current": "A"}


def make_series(time_s, joints=("a",), units=None, **signals):
    """A series with SI units (or `units[signal]`); one-dimensional values become one column."""
    arrays = {name: np.asarray(v, dtype=float).reshape(len(time_s), -1) for name, v in signals.items()}
    given = {name: (units or {}).get(name, (UNITS[name],) * len(joints)) for name in arrays}
    return TimeSeries(np.asarray(time_s, dtype=float), tuple(joints), arrays, given)


def make_episode(measured, command=None, flags=()):
    return Episode(EpisodeMeta("one", flags=flags), measured, command)


def smooth(rng, joints=1, low_hz=0.2, high_hz=2.0) -> Callable[[np.ndarray], np.ndarray]:
    """A random smooth motion as a function of time: (T,) -> (T, joints)."""
    rate = rng.uniform(low_hz, high_hz, (6, joints))
    phase = rng.uniform(0.0, 2.0 * np.pi, (6, joints))
    size = rng.uniform(0.1, 0.3, (6, joints))
    return lambda t: np.sum(size * np.sin(2.0 * np.pi * rate * np.asarray(t)[:, None, None] + phase), axis=1)


@dataclass(frozen=True)
class Servo:
    """A position servo: inertia 0.03, stiffness 16 Nm/rad, damping 1; sampled at 50 Hz with a coarse encoder."""

    stiction_nm: float = 0.1
    gravity_nm: float = 0.0
    stop_rad: float = 10.0
    noise_nm: float = 0.02
    noise_rad: float = 0.0
    step_rad: float = 0.00153
    signed: bool = False

    def run(self, command: np.ndarray, seed: int = 0, *, with_load: bool = True) -> Episode:
        """The episode for a command at 50 Hz; gravity pulls towards 0 hanging."""
        rng = np.random.default_rng(seed)
        position, velocity, dt = float(command[0]), 0.0, 0.001
        rows, loads = [], []
        for target in command.tolist():
            rows.append(position)
            for _ in range(20):
                motor = max(-12.0, min(12.0, 16.0 * (target - position) - velocity))
                drive = motor - self.gravity_nm * math.sin(position)
                if position > self.stop_rad:
                    drive -= 3000.0 * (position - self.stop_rad) + 15.0 * velocity
                free = velocity + dt * drive / 0.03
                # Coulomb friction never turns a velocity round within a step.
                slow = dt * self.stiction_nm / 0.03
                velocity = math.copysign(max(abs(free) - slow, 0.0), free)
                position += dt * velocity
            loads.append(motor)
        time_s = 0.02 * np.arange(command.size)
        measured = np.array(rows) + self.noise_rad * rng.standard_normal(command.size)
        if self.step_rad:
            measured = np.round(measured / self.step_rad) * self.step_rad
        load = np.array(loads) + self.noise_nm * rng.standard_normal(command.size)
        load = np.round((load if self.signed else np.abs(load)) / 0.0228) * 0.0228
        signals = {"position": measured} | ({"torque": load} if with_load else {})
        return make_episode(make_series(time_s, **signals), make_series(time_s, position=command))


def sine(amplitude, hz, seconds=20.0, center=0.0):
    """A sine at 50 Hz that rests for a second at either end."""
    time_s = np.arange(0.0, seconds, 0.02)
    return np.concatenate(
        [np.full(50, center), center + amplitude * np.sin(2 * np.pi * hz * time_s), np.full(50, center)]
    )
