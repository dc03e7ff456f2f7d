"""The fit as a function: parameters in, residuals of many candidates out."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from queue import SimpleQueue

import mujoco
import numpy as np
from jaxtyping import Bool, Float64, Int

from trueup.core.parameters import ParameterSet
from trueup.core.protocols import RolloutRequest
from trueup.core.time_limit import OutOfTime, TimeLimit
from trueup.errors import ConfigError, DataError
from trueup.identify.candidate import Candidate, Nominal
from trueup.identify.logged_torque import LoggedTorque, Moments
from trueup.identify.quantities import motion_target, quantity, split_motion_target
from trueup.identify.segments import Segment
from trueup.identify.window_starts import WindowStarts, window_starts
from trueup.robots import AS_DESCRIBED, Setup
from trueup.sim import MujocoSimulator
from trueup.sim.trapezoid import Drives, at_step_ends, damp_by_trapezoid

# Simulated states that one task holds at a time: some 100 MB.
_STATES_PER_TASK = 4_000_000


@dataclass(frozen=True)
class Weights:
    """What the residual consists of.

    Attributes:
        signals: signal -> weight of one standard unit [1/rad, s/rad or 1/Nm]; position alone by default.
        joints: joint name -> weight; joints that are not named have 1, unscored joints 0.
        own: signal -> joint name -> further weight of this signal, 1 where it is not named.
        torque: joint name -> what is known of its logged torque, which is compared without what other moments of its
            measurement would explain.
    """

    signals: Mapping[str, float]
    joints: Mapping[str, float]
    own: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    torque: Mapping[str, LoggedTorque] = field(default_factory=dict)

    def of(self, signal: str, joints: Sequence[str]) -> Float64[np.ndarray, "J"]:
        """The weights of one signal of these joints."""
        own = self.own.get(signal, {})
        return self.signals[signal] * np.array([own.get(joint, 1.0) for joint in joints])


# Segment -> what acts on the joints in each simulation step of each window besides the drives of the model, and which
# part of it the robot's drives exert and log, (2, W, N, J) [Nm or N].
Forces = Mapping[Segment, Float64[np.ndarray, "2 _ _ J"]]


@dataclass(frozen=True, eq=False)
class Course:
    """One segment as a candidate moves through it, on the grid of the simulation.

    Attributes:
        model: of the candidate, with what it carries there.
        position: (W, N + 1, J) [rad or m].
        velocity: (W, N + 1, J).
        torque: of the drives, (W, N + 1, J) [Nm or N].
        command: signal -> (W, N, J), as it acts.
        zeros: what the encoders read too little, (J,) [rad or m].
    """

    model: mujoco.MjModel
    position: Float64[np.ndarray, "W N1 J"]
    velocity: Float64[np.ndarray, "W N1 J"]
    torque: Float64[np.ndarray, "W N1 J"]
    command: Mapping[str, Float64[np.ndarray, "W N J"]]
    zeros: Float64[np.ndarray, "J"]


class Problem:
    """Residuals of a model against logs, for many candidates at once.

    The residual of one sample is weight * (simulated - measured) / sqrt(N), with N the number of samples that
    count, so that the sum of squares is a mean square. A candidate that diverges, or that MuJoCo refuses to
    compile, has NaN throughout: it loses, and the others stand.

    Args:
        nominal: the model as it came.
        parameters: what may change.
        segments: parts of the logs.
        weights: of signals and joints; position and the scored joints alone if None.
        jobs: threads.
        coarse: the same logs simulated with a larger time step, of which derivatives are taken; None takes those of
            the simulation itself.
        starts: where windows begin, and what of the residual a change of that explains, which is left out of it; by
            segment, those that are not named begin as they were measured.
        trapezoidal: whether damping follows the trapezoidal rule (`damp_by_trapezoid`), or is as MuJoCo takes it.

    Attributes:
        columns: of the joints that enter the residual.
        size: length N of the residual.
        scale: the factor 1 / sqrt(N) in it.
        evaluations: candidates that were simulated.
        seconds: what that took [s].
    """

    def __init__(
        self,
        nominal: Nominal,
        parameters: ParameterSet,
        segments: Sequence[Segment],
        *,
        weights: Weights | None = None,
        jobs: int = 1,
        coarse: Problem | None = None,
        starts: Mapping[Segment, WindowStarts] | None = None,
        trapezoidal: bool = False,
    ) -> None:
        self.nominal, self.coarse, self.starts, self.trapezoidal = nominal, coarse, starts or {}, trapezoidal
        self.parameters = parameters
        self.segments = tuple(segments)
        self.jobs = jobs
        robot = nominal.robot
        self.weights = weights or Weights({"position": 1.0}, {})
        scored = {name: float(name in robot.scored_joints) for name in robot.joint_names}
        strangers = [name for name in self.weights.joints if name not in scored]
        if strangers:
            raise ConfigError(f"weights for {strangers}, which are not joints", available=scored)
        self._joint_weights = np.array([self.weights.joints.get(name, scored[name]) for name in robot.joint_names])
        self.columns = np.flatnonzero(self._joint_weights)
        self._simulators = {
            setup: _simulators(nominal, setup, jobs) for setup in sorted({segment.setup for segment in self.segments})
        }
        self._writers = [
            (quantity(parameter.quantity).write, place, parameter)
            for parameter in parameters
            if not parameter.untouched
            for place in quantity(parameter.quantity).places(nominal, parameter.target)
        ]
        self._rows = {segment: self._counted(segment) for segment in self.segments}
        self._moments = {
            segment: Moments(
                segment, rows["torque"], self.columns, robot.controller.signal, self.weights.torque, len(segments)
            )
            for segment, rows in self._rows.items()
            if self.weights.torque and "torque" in rows
        }
        counts = [(signal, np.count_nonzero(own)) for rows in self._rows.values() for signal, own in rows.items()]
        self.size = int(sum(count for _, count in counts)) * self.columns.size
        positions = sum(count for signal, count in counts if signal == "position")
        self.scale = float(1.0 / np.sqrt(max(1, positions) * self.columns.size))
        self.evaluations, self.seconds = 0, 0.0
        self._limit: TimeLimit | None = None
        self._kept_for = 0

    @contextmanager
    def ending(self, limit: TimeLimit | None, *, keep: int = 0) -> Iterator[None]:
        """Simulations within end with `OutOfTime`, in the middle of a batch if need be.

        Args:
            limit: when; None lets all of them end.
            keep: so many candidates earlier, by how long the others took: the time for them is left.
        """
        before = self._limit, self._kept_for
        self._limit, self._kept_for = limit, keep
        try:
            with nullcontext() if self.coarse is None else self.coarse.ending(limit, keep=keep):
                yield
        finally:
            self._limit, self._kept_for = before

    def _refuse_late(self) -> None:
        if self._limit is not None:
            kept_s = self._kept_for * self.seconds / max(1, self.evaluations)
            if self._limit.left_s <= kept_s:
                raise OutOfTime

    def _counted(self, segment: Segment) -> dict[str, Bool[np.ndarray, "T"]]:
        """The signals of a segment that enter the residual, in order, and the stamps at which they do."""
        known = [name for name, weight in self.weights.signals.items() if weight and name in segment.plan.measured]
        rows = {name: segment.rows(name, self.columns) for name in known}
        return {name: own for name, own in rows.items() if own.any()}

    def with_parameters(self, parameters: ParameterSet) -> Problem:
        """The same logs and weights for other parameters; the count of evaluations goes on."""
        coarse = None if self.coarse is None else self.coarse.with_parameters(parameters)
        other = self._like(parameters=parameters, coarse=coarse, starts=self.starts)
        other.evaluations, other.seconds = self.evaluations, self.seconds
        return other

    def restart(self, z: Float64[np.ndarray, "P"], *, coarse: bool = True) -> bool:
        """Look again where windows begin, near where they do, with these parameters; whether any begins elsewhere.

        With `coarse`, also where those begin whose derivatives are taken.
        """
        if all(own.lasting for own in self.starts.values()):
            return False
        self.starts = window_starts(self, z, self.starts)
        if coarse and self.coarse is not None:
            self.coarse.restart(z)
        return True

    def alone(self) -> Problem:
        """The same with derivatives at its own time step, and its limit of time."""
        return self.with_starts(self.starts)

    def with_starts(self, starts: Mapping[Segment, WindowStarts]) -> Problem:
        """The same with other starts of the windows, simulated at its own time step alone."""
        return self._like(starts=starts)

    def with_weights(self, weights: Weights) -> Problem:
        """The same with other weights, and windows that begin as they were measured, at its own time step alone."""
        return self._like(weights=weights)

    def _like(
        self,
        *,
        parameters: ParameterSet | None = None,
        weights: Weights | None = None,
        coarse: Problem | None = None,
        starts: Mapping[Segment, WindowStarts] | None = None,
    ) -> Problem:
        """The same model, logs, way to simulate them, and limit of time."""
        other = Problem(
            self.nominal,
            self.parameters if parameters is None else parameters,
            self.segments,
            weights=self.weights if weights is None else weights,
            jobs=self.jobs,
            coarse=coarse,
            starts=starts,
            trapezoidal=self.trapezoidal,
        )
        other._limit, other._kept_for = self._limit, self._kept_for
        return other

    def candidate(self, values: Mapping[str, float]) -> Candidate:
        """A model with these values written into it; parameters that are not named keep their start."""
        candidate = self.nominal.candidate()
        for write, place, parameter in self._writers:
            write(candidate, place, values.get(parameter.name, parameter.value))
        return candidate

    def residuals(
        self, z: Float64[np.ndarray, "C P"], forces: Sequence[Forces] | None = None
    ) -> Float64[np.ndarray, "C N"]:
        """Residuals of C candidates, NaN for those that fail.

        Args:
            z: free parameters of each candidate.
            forces: what acts on its joints besides the drives of the model; nothing if None.

        Raises:
            OutOfTime: the time of `ending` is over.
        """
        self._refuse_late()
        began = time.perf_counter()
        candidates = [self.candidate(self.parameters.values(row)) for row in z]
        models = {setup: [self._compile(candidate, setup) for candidate in candidates] for setup in self._simulators}
        out = np.full((z.shape[0], self.size), np.nan)
        tasks = list(self._tasks(z.shape[0], models))
        if self.jobs == 1 or len(tasks) == 1:
            for task in tasks:
                self._run(task, candidates, models, out, forces)
        else:
            with ThreadPoolExecutor(self.jobs) as pool:
                running = [pool.submit(self._run, task, candidates, models, out, forces) for task in tasks]
                try:
                    for done in running:
                        done.result()
                except OutOfTime:
                    pool.shutdown(cancel_futures=True)
                    raise
        self.evaluations += z.shape[0]
        self.seconds += time.perf_counter() - began
        return out

    def courses(self, z: Float64[np.ndarray, "P"]) -> dict[Segment, Course]:
        """What one candidate does and is told in each simulation step.

        Raises:
            DataError: it cannot be simulated.
            OutOfTime: the time of `ending` is over.
        """
        candidate = self.candidate(self.parameters.values(z))
        found = {}
        for segment in self.segments:
            self._refuse_late()
            simulators = self._simulators[segment.setup]
            simulator = simulators.get()
            try:
                zeros = self._zeros(candidate, segment.episode_id)
                asked = segment.plan.request(self._late(candidate, segment))
                request = _shifted(asked, zeros, self.starts.get(segment))
                model = self._finished(candidate.compile(segment.setup))
                models = [model] * segment.plan.starts.size
                result = simulator.rollout_candidates(request, models)
            finally:
                simulators.put(simulator)
            if not np.isfinite(result.position).all():
                raise DataError(f"the simulation of {segment.episode_id!r} diverged")
            found[segment] = Course(models[0], result.position, result.velocity, result.torque, request.command, zeros)
        self.evaluations += 1
        return found

    def slopes(self, z: Float64[np.ndarray, "C P"]) -> Float64[np.ndarray, "C N"]:
        """Residuals of C candidates of which differences are taken: those of the larger time step, if there is one."""
        if self.coarse is None:
            return self.residuals(z)
        self.evaluations += z.shape[0]
        return self.coarse.residuals(z)

    def by_segment(self, residual: Float64[np.ndarray, "N"]) -> Iterator[tuple[Segment, str, np.ndarray]]:
        """The residual of one candidate in its places: segment, signal and (samples, columns)."""
        place = 0
        for segment in self.segments:
            for signal, counted in self._rows[segment].items():
                rows = int(np.count_nonzero(counted))
                size = rows * self.columns.size
                yield segment, signal, residual[place : place + size].reshape(rows, self.columns.size)
                place += size

    def squares(self, residual: Float64[np.ndarray, "N"]) -> Float64[np.ndarray, "K"]:
        """Sum of squares of each joint that counts, over all segments and signals."""
        total = np.zeros(self.columns.size)
        for _, _, own in self.by_segment(residual):
            total += (own**2).sum(axis=0)
        return total

    def shift(self, change: Mapping[Segment, Float64[np.ndarray, "_ J"]]) -> Float64[np.ndarray, "N"]:
        """What the residual changes by if simulated positions change by this at the measured stamps [rad or m]."""
        out = np.zeros(self.size)
        for segment, signal, own in self.by_segment(out):
            if signal == "position":
                own[:] = change[segment][self._rows[segment][signal]][:, self.columns] * self._factor(signal)
        begin = 0
        for segment in self.segments:
            size = sum(int(np.count_nonzero(own)) for own in self._rows[segment].values()) * self.columns.size
            if segment in self.starts:
                out[begin : begin + size] = self.starts[segment].without(out[None, begin : begin + size])[0]
            begin += size
        return out

    def _factor(self, signal: str) -> Float64[np.ndarray, "K"]:
        """The residual per unit of a signal, by joint."""
        own = self.weights.of(signal, self.nominal.robot.joint_names) * self._joint_weights
        return np.asarray(own[self.columns] * self.scale)

    def in_residual(self, signal: str, values: Float64[np.ndarray, "K"]) -> Float64[np.ndarray, "K"]:
        """What values of a signal of the joints that count are in the residual."""
        return np.asarray(values * self._factor(signal))

    def unscaled_rms(self, residual: Float64[np.ndarray, "M"], column: int) -> float:
        """Root mean square of position residuals of one joint in the joint's unit [rad or m]."""
        weight = self.weights.signals["position"] * float(self._joint_weights[column]) * self.scale
        return float(np.sqrt(np.mean(residual**2)) / weight)

    def colors(self) -> Int[np.ndarray, "P"]:
        """Free parameters of one color act on different motions, so one simulation shows all their derivatives.

        Curtis, Powell, Reid 1974, "On the estimation of sparse Jacobian matrices".
        """
        joints = self.nominal.robot.joint_names
        colors, number = [], len(joints)
        for parameter in self.parameters.free:
            if quantity(parameter.quantity).of == "motion":
                colors.append(joints.index(split_motion_target(parameter.target)[1]))
            else:
                colors.append(number)
                number += 1
        return np.array(colors, dtype=np.int64)

    def support(self, index: int) -> Bool[np.ndarray, "N"]:
        """Which residuals a free parameter can change."""
        parameter = self.parameters.free[index]
        motion = split_motion_target(parameter.target)[0] if quantity(parameter.quantity).of == "motion" else None
        return np.concatenate(
            [
                np.full(values.size, motion is None or segment.episode_id == motion)
                for segment, _, values in self.by_segment(np.empty(self.size))
            ]
        )

    def _compile(self, candidate: Candidate, setup: Setup) -> mujoco.MjModel | None:
        try:
            return self._finished(candidate.compile(setup))
        except ConfigError:
            return None

    def _finished(self, model: mujoco.MjModel) -> mujoco.MjModel:
        """A compiled model, made ready to be simulated."""
        # The same motion without looking for islands of constraints: a tenth faster for a robot, which is a few trees.
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
        if self.trapezoidal:
            damp_by_trapezoid(model)
        return model

    def _late(self, candidate: Candidate, segment: Segment) -> Float64[np.ndarray, "J"]:
        """How much later commands act than their stamps [s].

        Steps of the trapezoidal rule are from the middle of one step to that of the next, so that a command which is
        held from the beginning of a step acts half a step too early.
        """
        half = 0.5 * self.nominal.simulator.timestep_s if self.trapezoidal and segment.plan.holds else 0.0
        return np.asarray(candidate.delays + half)

    def _zeros(self, candidate: Candidate, motion: str) -> Float64[np.ndarray, "J"]:
        joints = self.nominal.robot.joint_names
        return np.array([candidate.encoder_zeros.get(motion_target(motion, joint), 0.0) for joint in joints])

    def _tasks(self, count: int, models: _Models) -> Iterator[_Task]:
        alive = np.array(
            [index for index in range(count) if all(own[index] is not None for own in models.values())], dtype=np.int64
        )
        place = 0
        tasks: list[_Task] = []
        for segment in self.segments:
            width = sum(int(np.count_nonzero(own)) for own in self._rows[segment].values()) * self.columns.size
            states = segment.plan.steps * segment.plan.starts.size * len(self.nominal.robot.joints)
            # The same number for every thread, or one of them would wait for the others.
            rounds = -(-alive.size // (self.jobs * max(1, _STATES_PER_TASK // max(1, states))))
            parts = np.array_split(alive, max(1, min(alive.size, rounds * self.jobs)))
            tasks += [_Task(segment, rows, place, place + width) for rows in parts if rows.size]
            place += width
        # The longest first, so that no thread is left with the last long one.
        tasks.sort(key=lambda task: -task.segment.plan.steps * task.segment.plan.starts.size * task.rows.size)
        yield from tasks

    def _run(
        self,
        task: _Task,
        candidates: Sequence[Candidate],
        models: _Models,
        out: Float64[np.ndarray, "C N"],
        forces: Sequence[Forces] | None,
    ) -> None:
        self._refuse_late()
        simulators = self._simulators[task.segment.setup]
        simulator = simulators.get()
        try:
            own = models[task.segment.setup]
            out[task.rows, task.begin : task.end] = self._simulate(task, simulator, candidates, own, forces)
        finally:
            simulators.put(simulator)

    def _simulate(
        self,
        task: _Task,
        simulator: MujocoSimulator,
        candidates: Sequence[Candidate],
        models: Sequence[mujoco.MjModel | None],
        forces: Sequence[Forces] | None,
    ) -> Float64[np.ndarray, "C M"]:
        plan = task.segment.plan
        windows = plan.starts.size
        zeros = np.array([self._zeros(candidates[row], task.segment.episode_id) for row in task.rows])
        starts = self.starts.get(task.segment)
        requests = [
            _shifted(plan.request(self._late(candidates[row], task.segment)), zero, starts)
            for row, zero in zip(task.rows, zeros, strict=True)
        ]
        request = RolloutRequest(
            position=np.concatenate([own.position for own in requests]),
            velocity=np.concatenate([own.velocity for own in requests]),
            command={name: np.concatenate([own.command[name] for own in requests]) for name in requests[0].command},
            gravity=None if (pulls := requests[0].gravity) is None else np.tile(pulls, (len(requests), 1, 1)),
        )
        per_window = [model for row in task.rows if (model := models[row]) is not None for _ in range(windows)]
        every = None if forces is None else np.concatenate([forces[row][task.segment] for row in task.rows], axis=1)
        result = simulator.rollout_candidates(request, per_window, None if every is None else every[0])
        grids = {"position": result.position, "velocity": result.velocity, "torque": result.torque}
        if self.trapezoidal and set(self._rows[task.segment]) - {"position"}:
            drives, later = Drives.all_of(per_window, simulator.places[1]), None
            if plan.holds:  # the torque at a stamp is that of the command which is new there
                told = [plan.request(candidates[row].delays).command for row in task.rows]
                own = {name: np.concatenate([one[name] for one in told]) - request.command[name] for name in told[0]}
                later = simulator.control_of(own)
            grids["torque"] = drives.at_step_ends(result.torque, result.velocity, later)
            grids["velocity"] = at_step_ends(result.velocity)
        if every is not None:
            grids["torque"] = grids["torque"] + np.concatenate([every[1], every[1, :, -1:]], axis=1)
        blocks = []
        for signal, counted in self._rows[task.segment].items():
            grid = grids[signal]
            simulated = plan.at_stamps(grid.reshape(task.rows.size, windows, *grid.shape[1:]))
            if signal == "position":
                simulated = simulated - zeros[:, None, :]
            residual = (simulated - plan.measured[signal])[:, counted][:, :, self.columns]
            residual = np.ascontiguousarray(residual) * self._factor(signal)
            if signal == "torque" and task.segment in self._moments:
                moments, step_s = self._moments[task.segment], self.nominal.simulator.timestep_s
                speed = grids["velocity"]
                slopes = np.diff(speed, axis=1, prepend=speed[:, :1]) / step_s
                moving = [
                    plan.at_stamps(own.reshape(task.rows.size, windows, *own.shape[1:]))[:, counted][:, :, self.columns]
                    for own in (speed, slopes)
                ]
                for own, velocity, acceleration in zip(residual, *moving, strict=True):  # a sum depends on its batch
                    own[:] = moments.without(own, velocity, acceleration)
            blocks.append(residual.reshape(task.rows.size, -1))
        residuals = np.concatenate(blocks, axis=1)
        return residuals if starts is None else starts.without(residuals)


# How the robot is in a motion -> a model of each candidate, None where MuJoCo refuses it.
_Models = Mapping[Setup, Sequence[mujoco.MjModel | None]]


@dataclass(frozen=True, eq=False)
class _Task:
    """Some candidates on one segment, and where their residuals go."""

    segment: Segment
    rows: np.ndarray
    begin: int
    end: int


def _simulators(nominal: Nominal, setup: Setup, jobs: int) -> SimpleQueue[MujocoSimulator]:
    """One for each thread, of the nominal model as it is in some motions."""
    free: SimpleQueue[MujocoSimulator] = SimpleQueue()
    simulator = nominal.simulator
    if setup != AS_DESCRIBED:
        simulator = MujocoSimulator(nominal.candidate().compile(setup), nominal.robot, simulator.channels)
    for _ in range(jobs):
        free.put(simulator.clone())
    return free


def _shifted(request: RolloutRequest, zeros: Float64[np.ndarray, "J"], starts: WindowStarts | None) -> RolloutRequest:
    """The same motion as an encoder would have told it that reads right, from the starts that are known."""
    if starts is not None:
        request = replace(
            request, position=request.position + starts.position, velocity=request.velocity + starts.velocity
        )
    if not np.any(zeros):
        return request
    command = dict(request.command)
    if "position" in command:
        command["position"] = command["position"] + zeros
    return replace(request, position=request.position + zeros, command=command)
