"""Robots with known friction: independent joints whose static friction exceeds the kinetic one, and may differ by direction."""

from dataclasses import dataclass, field, replace

import numpy as np

from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.timeseries import TimeSeries, same_units


@dataclass(frozen=True)
class Friction:
    """One joint: I ddq = tau + offset + slope q - kinetic(sign) - viscous(sign) dq; stuck while |tau + ...| <= static."""

    inertia: float = 0.1
    static: tuple[float, float] = (0.5, 0.4)  # in positive, in negative direction
    kinetic: tuple[float, float] = (0.4, 0.3)
    viscous: tuple[float, float] = (0.2, 0.2)
    offset: float = 0.0  # torque that acts on the joint besides the command
    slope: float = 0.0

    def mirrored(self):
        """The same joint seen in a mirror."""
        swap = {name: getattr(self, name)[::-1] for name in ("static", "kinetic", "viscous")}
        return replace(self, offset=-self.offset, **swap)


def advance(friction, position, velocity, torque, dt, scale=1.0):
    """One step for arrays of states of the same joint; `scale` multiplies its dry friction."""
    push = torque + friction.offset + friction.slope * position
    stuck = (velocity == 0.0) & (push <= scale * friction.static[0]) & (push >= -scale * friction.static[1])
    way = np.where(velocity != 0.0, np.sign(velocity), np.sign(push))
    up = way > 0
    coulomb = scale * np.where(up, friction.kinetic[0], -friction.kinetic[1])
    half = 0.5 * dt * np.where(up, *friction.viscous) / friction.inertia
    after = (velocity * (1.0 - half) + dt * (push - coulomb) / friction.inertia) / (1.0 + half)
    after = np.where(stuck | (velocity * after < 0.0), 0.0, after)
    return position + dt * 0.5 * (velocity + after), after


@dataclass
class SlidingRobot:
    """Implements RobotIO and Clock."""

    frictions: dict
    dt: float = 0.001
    position_noise: float = 1e-5
    velocity_noise: float = 0.0  # 0: no velocity signal
    step: float = 0.0
    seed: int = 0
    mirror: int = 1
    fail_at_s: float = np.inf
    heal_at_s: float = np.inf
    frozen: tuple = ()
    silent_from_s: float = np.inf
    written: list = field(default_factory=list)

    def __post_init__(self):
        self.rng = np.random.default_rng(self.seed)
        self.time_s = 0.0
        self.q = np.zeros(len(self.frictions))
        self.v = np.zeros(len(self.frictions))
        self.tau = np.zeros(len(self.frictions))
        self.last = None

    @property
    def joints(self):
        return tuple(self.frictions)

    def now_s(self):
        return self.time_s

    def wait_until_s(self, time_s):
        while self.time_s < time_s - 1e-9:
            for j, friction in enumerate(self.frictions.values()):
                if self.joints[j] not in self.frozen:
                    q, v = advance(friction, self.q[j], self.v[j], self.tau[j], self.dt)
                    self.q[j], self.v[j] = q, v
            self.time_s += self.dt

    def read(self):
        if self.fail_at_s <= self.time_s < self.heal_at_s:
            raise TimeoutError("no answer from the bus")
        if self.time_s >= self.silent_from_s and self.last is not None:
            return self.last
        noise = self.mirror * self.rng.standard_normal((2, len(self.q)))
        position = self.q + self.position_noise * noise[0]
        if self.step:
            position = np.round(position / self.step) * self.step
        self.last = {"position": position, "torque": self.tau + 1e-4 * noise[1]}
        if self.velocity_noise:
            self.last["velocity"] = self.v + self.velocity_noise * noise[1]
        return self.last

    def write(self, command):
        if self.fail_at_s <= self.time_s < self.heal_at_s:
            raise TimeoutError("no answer from the bus")
        self.tau = np.array(command["torque"])
        self.written.append(self.tau)


def recordings(
    friction,
    torque,
    rate_hz,
    seeds,
    *,
    position_noise=1e-5,
    velocity_noise=1e-3,
    step=0.0,
    substeps=1,
    scale=1.0,
    start=0.0,
):
    """Open-loop motions under torque (T,), for many seeds at once: positions and velocities, (S, T)."""
    count = len(seeds)
    q, v = np.full(count, start, dtype=float), np.zeros(count)
    rows_q, rows_v = [], []
    for tau in torque:
        rows_q.append(q)
        rows_v.append(v)
        for _ in range(substeps):
            q, v = advance(friction, q, v, tau, 1.0 / rate_hz / substeps, scale)
    noise = np.stack(
        [
            np.random.default_rng([seed, int(1e6 * abs(torque).max()), int(torque.sum() > 0)]).standard_normal(
                (2, len(torque))
            )
            for seed in seeds
        ]
    )
    position = np.stack(rows_q, axis=1) + position_noise * noise[:, 0]
    if step:
        position = np.round(position / step) * step
    return position, np.stack(rows_v, axis=1) + velocity_noise * noise[:, 1]


def log(name, rate_hz, torque, position=None, velocity=None, joint="joint1"):
    """An episode of one joint."""
    clock = np.arange(len(torque)) / rate_hz
    signals = {
        key: values[:, None] for key, values in (("position", position), ("velocity", velocity)) if values is not None
    }
    units = {"position": "rad", "velocity": "rad/s"}
    measured = TimeSeries(clock, (joint,), signals, same_units({key: units[key] for key in signals}, (joint,)))
    command = TimeSeries(
        clock, (joint,), {"torque": np.asarray(torque, dtype=float)[:, None]}, same_units({"torque": "Nm"}, (joint,))
    )
    return Episode(EpisodeMeta(name), measured, command)
