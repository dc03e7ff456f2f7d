"""Robots drawn around a model, and the logs that they would leave: truths with which a fit is tried out."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Float64, Int

from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.fit_result import FitResult
from trueup.core.hold import SAME_INSTANT_S, held_rows
from trueup.core.interpolation import columns_at
from trueup.core.parameters import Parameter, ParameterSet
from trueup.core.selftest_result import DrawnNumber, SelftestVerdict
from trueup.core.timeseries import BODY_PREFIX, TimeSeries
from trueup.core.units import SI_UNIT, joint_unit
from trueup.errors import DataError
from trueup.identify.candidate import Nominal
from trueup.identify.discretization import Discretization
from trueup.identify.problem import Problem
from trueup.identify.quantities import motion_target, quantity
from trueup.identify.uncertainty import noise_level
from trueup.robots import CommandTiming, RobotSpec, Setup, setup_of
from trueup.sim import MujocoSimulator, ReplayPlan, ReplaySettings
from trueup.sim.compiled_robot import ABSURD
from trueup.sim.replay_plan import smooth_commands, steps_of
from trueup.sim.trapezoid import damp_by_trapezoid

# Drawn numbers: standard deviation of the logarithm, or share of what counts as a large change; masses were weighed.
_SPREAD, _MASS_SPREAD = 0.3, 0.1
_FARTHEST = 2.5
# A truth has a time step of its own: this one, or a sixteenth of the model's, if that is less [s]. A fit may take a
# quarter of the model's, and extrapolates to zero. A robot that takes torques is stepped in Python: with one that is
# longer, but not longer than an eighth.
_DIVISOR, _FINE_S = 16, 1e-4
_LED_DIVISOR, _LED_S = 8, 2.5e-4
# Steps in one of those with which commands of velocity are found out.
_COARSE = 8
# A servo holds its first command for so long before a log begins [s].
_SETTLE_S = 2.0
# How quickly a velocity loop outside of the robot takes an error of position away [1/s].
_OUTER_LOOP = 2.0
# Noise of a logged velocity per noise of a position [1/s].
_VELOCITY_NOISE = 10.0
# Encoders are no better than this [rad or m].
_LEAST_NOISE = 1e-5
# How long a default fit takes: candidates per parameter, and a simulation step [us] per degree of freedom, and two; it
# is counted with so many threads at most.
_CANDIDATES, _STEP_US, _JOBS = 25.0, 0.8, 2
# Rounding of what is written into models.
_DIGITS_LOST = 1e-5


@runtime_checkable
class Leader(Protocol):
    """The controller outside of a torque-driven robot that keeps it on its way."""

    def torque(
        self,
        position: Float[np.ndarray, "J"],
        velocity: Float[np.ndarray, "J"],
        goal: tuple[Float[np.ndarray, "J"], Float[np.ndarray, "J"]],
    ) -> Float64[np.ndarray, "J"]:
        """What leads the joints to a position and velocity [Nm or N]."""
        ...


def draw_truth(parameters: ParameterSet, nominal: Nominal, rng: np.random.Generator) -> dict[str, float]:
    """True values around those that a fit would start from: parameter name -> value.

    Parameters on a logarithmic scale are multiplied by exp(N(0, 0.3)), masses by exp(N(0, 0.1)); the others move by
    N(0, 0.3) of their scale. A prior that is narrower than that is what truths are drawn from. Values stay inside the
    bounds, and no command acts before it was sent. Frozen parameters keep their value.

    Args:
        parameters: of a fit, as `make_parameters` gives them: numbers that the model has none of (friction, armature)
            start at a share of the natural size of their joint.
        nominal: the model.
        rng: of the draw; one number is drawn for each parameter, frozen or not.
    """
    drawn = {}
    for item in parameters:
        move = float(np.clip(rng.standard_normal(), -_FARTHEST, _FARTHEST))
        if item.frozen:
            continue
        spread = min(_MASS_SPREAD if item.quantity == "mass" else _SPREAD, item.prior_std or np.inf)
        value = item.from_z(item.to_z(_center(item, nominal)) + spread * move)
        if item.quantity == "delay_s":
            sent = -nominal.given.replay.command_shift_s
            value = float(np.clip(sent + abs(value - sent), item.low, item.high))
        drawn[item.name] = float(f"{value:.6g}")
    return drawn


def _center(item: Parameter, nominal: Nominal) -> float:
    """Where a fit starts; a servo without damping gets some that suits the size of its joint."""
    kind = quantity(item.quantity)
    places = kind.places(nominal, item.target)
    if item.quantity == "kv" and not item.nominal and kind.of == "joint":
        return float(max(item.low, min(item.value, quantity("damping").parameter(nominal, places[0]).value)))
    return item.value


@dataclass(frozen=True, eq=False)
class Sensors:
    """What a drawn robot reports.

    Attributes:
        noise: signal -> standard deviation of one sample, (J,) [unit of the signal]; `position` is among them.
    """

    noise: Mapping[str, Float64[np.ndarray, "J"]]

    @staticmethod
    def of_logs(episodes: Sequence[Episode], joints: Sequence[str], *, position: float | None = None) -> Sensors:
        """The signals of logs with the white noise that their third differences show.

        Args:
            episodes: in the robot's joint names.
            joints: names of the J joints.
            position: noise of all positions, in place of what the logs show [rad or m].
        """
        known = [name for name in ("position", "velocity", "torque") if all(name in log.measured for log in episodes)]
        noise = {name: _noise([log.measured.select(joints)[name] for log in episodes]) for name in known}
        own = noise["position"] if position is None else np.full(len(joints), position)
        return Sensors({**noise, "position": np.maximum(own, _LEAST_NOISE)})

    @staticmethod
    def flat(joints: int, noise: float, *, moving: bool) -> Sensors:
        """Encoders of one noise [rad or m], and velocities, ten times as noisy [1/s], if they are logged."""
        each = np.full(joints, noise)
        return Sensors({"position": each, **({"velocity": _VELOCITY_NOISE * each} if moving else {})})


def _noise(pieces: Sequence[Float[np.ndarray, "_ J"]]) -> Float64[np.ndarray, "J"]:
    found = []
    for column in range(pieces[0].shape[1]):
        whole = [piece[:, column].astype(np.float64) for piece in pieces]
        parts = [part for own in whole for part in _finite_parts(own)]
        found.append(noise_level(parts) if parts else 0.0)
    return np.array(found)


def _finite_parts(values: Float64[np.ndarray, "_"]) -> list[Float64[np.ndarray, "_"]]:
    gaps = np.flatnonzero(~np.isfinite(values))
    parts = np.split(values, gaps)
    return [own for part in parts if (own := part[np.isfinite(part)]).size > 3]


class DrawnSimulator:
    """A robot that was drawn: it makes the logs that it would leave.

    Position servos get the commands of a log as they are, from rest under the first one. Commands of torque and
    velocity came from a controller outside of the robot, which would have given others to another robot: they are
    corrected so that it goes the same way, and what it was told is what is logged.

    Args:
        robot: its description.
        path: MJCF or URDF.
        parameters: what is drawn.
        values: their true values.
        leader: what leads a torque-driven robot; unused for others.
    """

    def __init__(
        self,
        robot: RobotSpec,
        path: Path,
        parameters: ParameterSet,
        values: Mapping[str, float],
        *,
        leader: Leader | None = None,
    ) -> None:
        step_s = Nominal(robot, path).simulator.timestep_s
        follows = robot.controller.signal != "torque"
        fine_s = min(step_s / _DIVISOR, _FINE_S) if follows else min(step_s / _LED_DIVISOR, _LED_S)
        divisor = int(np.ceil(step_s / fine_s - 1e-6))
        self._nominal = Nominal(Discretization(divisor, robot.replay.command).of(robot, step_s), path)
        self._candidate = Problem(self._nominal, parameters, ()).candidate(values)
        self._leader = leader
        self._simulators: dict[Setup, MujocoSimulator] = {}

    def prepare(self, metas: Iterable[EpisodeMeta]) -> None:
        """Compile the robot as it is in these motions, before `log` is called from several threads.

        Raises:
            ConfigError: MuJoCo refuses the drawn numbers.
        """
        nominal = self._nominal
        for setup in {setup_of(nominal.robot, meta) for meta in metas}:
            model = self._candidate.compile(setup)
            damp_by_trapezoid(model)  # a robot has no step
            self._simulators[setup] = MujocoSimulator(model, nominal.robot, nominal.simulator.channels)

    def log(self, episode: Episode, sensors: Sensors, rng: np.random.Generator) -> Episode:
        """What the robot leaves of a motion.

        Args:
            episode: in the robot's joint names: what it is told and, of a robot that is led, which way it goes.
            sensors: what is logged, and how noisy.
            rng: of the noise.

        Raises:
            DataError: the simulation diverges.
        """
        robot = self._nominal.robot
        simulator = self._simulators[setup_of(robot, episode.meta)].clone()
        joints = robot.joint_names
        zeros = np.array([self._candidate.encoder_zeros.get(motion_target(episode.id, name), 0.0) for name in joints])
        if robot.controller.signal == "torque":
            series, command = self._led(episode, simulator, zeros)
        else:
            series, command = self._served(episode, simulator, zeros)
        signals = {}
        for signal, noise in sensors.noise.items():
            values = series[signal] - zeros if signal == "position" else series[signal]
            signals[signal] = values + noise * rng.standard_normal(values.shape)
        units = {name: series.units[name] for name in signals}
        # What its base felt is what it felt.
        felt = episode.measured.rows(slice(len(episode.measured) - len(series), None))
        bodies = [name for name in felt.signals if name.startswith(BODY_PREFIX)]
        measured = TimeSeries(
            series.time_s,
            joints,
            {**signals, **{name: felt[name] for name in bodies}},
            {**units, **{name: felt.units[name] for name in bodies}},
            felt.bodies if bodies else (),
        )
        return Episode(replace(episode.meta, flags=()), measured, command)

    def _served(
        self, episode: Episode, simulator: MujocoSimulator, zeros: Float64[np.ndarray, "J"]
    ) -> tuple[TimeSeries, TimeSeries]:
        """What a servo makes of the commands of a log, and these."""
        told = episode.commanded().select(simulator.joints)
        replay, settle_s = self._nominal.robot.replay, _SETTLE_S
        if self._nominal.robot.controller.signal == "velocity":
            # Which commands it needs is found out at a coarser step; it would go on for ever under the first of them.
            _, told = self._led(episode, self._coarse(simulator), zeros)
            settle_s = 0.0
        clock = _from_command_on(episode, told)
        step_s, count = simulator.timestep_s, steps_of(clock[-1] - clock[0], simulator.timestep_s)
        edges = clock[0] + step_s * np.arange(count + 1)
        # What acts from the middle of one step to that of the next (`damp_by_trapezoid`).
        middles = edges - 0.5 * step_s
        signals = {}
        for name in (name for name in simulator.command_signals if name in told):
            values = told[name].astype(np.float64) + (zeros if name == "position" else 0.0)
            columns = [
                _acting(told.time_s, values[:, column], middles - delay, replay.command)
                for column, delay in enumerate(self._candidate.delays)
            ]
            signals[name] = np.stack(columns, axis=1)
        acting = TimeSeries(edges[:-1], told.joints, signals, {name: told.units[name] for name in signals})
        start = episode.measured.select(simulator.joints)
        start = replace(start, signals={**start.signals, "position": start["position"] + zeros})
        settings = ReplaySettings(
            settle_s=max(replay.settle_s, settle_s), base_sensor=self._nominal.robot.simulation.base_sensor
        )
        plan = ReplayPlan(replace(episode, measured=start, command=acting), simulator, settings)
        return plan.series(simulator.rollout(plan.request())), told

    @staticmethod
    def _coarse(simulator: MujocoSimulator) -> MujocoSimulator:
        """The same robot with a step of the model's kind."""
        model = copy.copy(simulator.model)
        model.opt.timestep = _COARSE * simulator.timestep_s
        return MujocoSimulator(model, simulator.robot, simulator.channels, simulator.holding)

    def _led(
        self, episode: Episode, simulator: MujocoSimulator, zeros: Float64[np.ndarray, "J"]
    ) -> tuple[TimeSeries, TimeSeries]:
        """A robot that a controller outside of it leads along the way of a log, and what that told it."""
        signal = self._nominal.robot.controller.signal
        told = episode.commanded().select(simulator.joints)
        seen = episode.measured.select(simulator.joints)
        clock = _from_command_on(episode, told)
        step_s, count = simulator.timestep_s, steps_of(clock[-1] - clock[0], simulator.timestep_s)
        edges = clock[0] + step_s * np.arange(count + 1)
        way, pace = _way(seen)
        goal, goal_pace = (columns_at(told.time_s, seen.time_s, values) for values in (way, pace))
        before, after, share = _held_shares(told.time_s, edges, self._candidate.delays)
        sent = told[signal].astype(np.float64).copy()
        passive = ~sent.any(axis=0)  # a joint that is never driven may have no drive
        limits = self._nominal.commanded_limits
        most = np.array([limits.get(name, np.inf) for name in simulator.joints])
        columns = np.arange(len(simulator.joints))
        first = [columns_at(clock[:1], seen.time_s, values) for values in (way, pace)]
        simulator.reset(first[0] + zeros, first[1])
        position, velocity = first[0][0] + zeros, first[1][0]
        grid = {name: np.empty((count + 1, len(columns))) for name in ("position", "velocity", "torque")}
        grid["position"][0], grid["velocity"][0] = position, velocity
        known = -1
        for step in range(count):
            # What acts in this step is decided by now, and not before.
            while known < int(after[step].max()):
                known += 1
                error = goal[known] - (position - zeros)
                if signal == "velocity":
                    sent[known] += _OUTER_LOOP * error
                elif self._leader is not None:
                    pull = self._leader.torque(position - zeros, velocity, (goal[known], goal_pace[known]))
                    sent[known] = np.clip(sent[known] + np.where(passive, 0.0, pull), -most, most)
            part = share[step]
            acting = (1.0 - part) * sent[before[step], columns] + part * sent[after[step], columns]
            now = simulator.step({signal: acting[None]})
            position, velocity = now["position"][0], now["velocity"][0]
            if not np.abs(position).max() <= ABSURD:
                raise DataError(
                    "the drawn robot diverged", got=f"{step * step_s:.3f} s after the start of {episode.id}"
                )
            grid["position"][step + 1], grid["velocity"][step + 1] = position, velocity
            grid["torque"][step] = now["torque"][0]
        grid["torque"][-1] = grid["torque"][-2]
        lengths = [self._nominal.length_unit(name) for name in simulator.joints]
        units = {name: tuple(joint_unit(SI_UNIT[name], length) for length in lengths) for name in grid}
        signals = {name: columns_at(clock, edges, values) for name, values in grid.items()}
        series = TimeSeries(clock, simulator.joints, signals, units)
        return series, replace(told, signals={signal: sent}, units={signal: told.units[signal]})


def _from_command_on(episode: Episode, told: TimeSeries) -> Float64[np.ndarray, "T"]:
    """The measured stamps from the first command on, as a replay has them."""
    stamps = episode.measured.time_s
    own = stamps[stamps >= told.time_s[0] - SAME_INSTANT_S]
    if own.size < 2:
        raise DataError(f"episode {episode.id!r}: the measurement ends before the first command")
    return np.asarray(own)


def _acting(
    stamps_s: Float64[np.ndarray, "N"],
    values: Float64[np.ndarray, "N"],
    edges_s: Float64[np.ndarray, "_"],
    timing: CommandTiming,
) -> Float64[np.ndarray, "K"]:
    """The mean command in each of K steps between their edges: it acts from its stamp on, not from the next step on."""
    middle = 0.5 * (edges_s[1:] + edges_s[:-1])
    if timing == "linear":
        return np.asarray(np.interp(middle, stamps_s, values))
    if timing == "smooth":
        return smooth_commands(stamps_s, values, middle)
    begin = min(float(stamps_s[0]), float(edges_s[0])) - 1.0
    stamps = np.concatenate([[0.0], stamps_s - begin, [max(float(stamps_s[-1]), float(edges_s[-1])) + 1.0 - begin]])
    held = np.concatenate([values[:1], values])
    area = np.concatenate([[0.0], np.cumsum(held * np.diff(stamps))])
    return np.asarray(np.diff(np.interp(edges_s - begin, stamps, area)) / np.diff(edges_s))


def _held_shares(
    stamps_s: Float64[np.ndarray, "N"], edges_s: Float64[np.ndarray, "_"], delays_s: Float64[np.ndarray, "J"]
) -> tuple[Int[np.ndarray, "K J"], Int[np.ndarray, "K J"], Float64[np.ndarray, "K J"]]:
    """Which two held commands act in each step, and the share of the second: rows of the commands, (K, J)."""
    late = edges_s[:, None] - delays_s
    rows = np.maximum(held_rows(stamps_s, late), 0)
    before, after = rows[:-1], rows[1:]
    share = (late[1:] - stamps_s[after]) / np.diff(edges_s)[:, None]
    return before, after, np.where(after > before, np.clip(share, 0.0, 1.0), 1.0)


def _way(seen: TimeSeries) -> tuple[Float64[np.ndarray, "T J"], Float64[np.ndarray, "T J"]]:
    """Position and velocity of a log, gaps filled."""
    rows = np.arange(len(seen), dtype=np.float64)

    def filled(values: Float[np.ndarray, "T J"]) -> Float64[np.ndarray, "T J"]:
        columns = []
        for own in values.astype(np.float64).T:
            there = np.isfinite(own)
            columns.append(np.interp(rows, rows[there], own[there]) if there.any() else np.zeros(rows.size))
        return np.stack(columns, axis=1)

    position = filled(seen["position"])
    if "velocity" in seen:
        return position, filled(seen["velocity"])
    return position, np.gradient(position, seen.time_s, axis=0) if len(seen) > 1 else np.zeros_like(position)


def motion_within(seconds: float, parameters: ParameterSet, nominal: Nominal, *, jobs: int) -> float:
    """About how much motion a default fit of these parameters gets through in a time [s].

    By the size of the problem alone, so that the same call fits the same motion on any machine: candidates per
    parameter, simulation steps of a second, and the time of a step, which grows with the degrees of freedom.
    """
    step_s = _STEP_US * 1e-6 * (2.0 + nominal.model.nv)
    candidates = _CANDIDATES * (1 + len(parameters.free))
    return float(seconds * min(jobs, _JOBS) / (candidates * step_s / nominal.simulator.timestep_s))


def verdicts(fit: FitResult, parameters: ParameterSet, values: Mapping[str, float]) -> tuple[DrawnNumber, ...]:
    """What a fit has made of true values, parameter by parameter; what belongs to single recordings is left out.

    Args:
        fit: to the logs of the drawn robot.
        parameters: what was drawn.
        values: their true values.
    """
    found = {item.name: item for item in fit.parameters}
    rows = []
    for item in parameters:
        kind = quantity(item.quantity)
        if item.frozen or kind.of == "motion":
            continue
        truth, own = values[item.name], found.get(item.name)
        excite = kind.excite
        if own is None or own.frozen:
            sentence = f"not fitted, since these motions show nothing of it: {excite.format(target=item.target)}"
            value, interval = (None, None) if own is None else (own.value, None)
            rows.append(
                DrawnNumber(item.name, item.unit, truth, item.nominal, value, interval, "open", sentence, excite)
            )
            continue
        low, high, here = (item.to_z(one) for one in (*own.interval, truth))
        half = max(0.5 * (high - low), 1e-12)
        off = abs(item.to_z(own.value) - here) / half
        slack = _DIGITS_LOST * max(1.0, abs(here))
        verdict: SelftestVerdict = "open"
        if own.identified in ("yes", "effective"):
            inside = low - slack <= here <= high + slack
            verdict = "recovered" if inside else "missed" if own.identified == "yes" else "open"
        rows.append(
            DrawnNumber(
                *(item.name, item.unit, truth, item.nominal, own.value, own.interval, verdict, own.sentence, excite),
                off=float(f"{off:.3g}"),
            )
        )
    return tuple(rows)
