"""What the rest of a fit looks like: causes that no number of the catalogue expresses, tested along the fitted motion.

Each cause is put into the fitted model as a small force or shift in one more simulation, which gives the derivative of
the residual. What the parameters of the fit can do themselves is projected off, since they have hidden a part of the
cause. The best causes are then fitted together with the parameters, on the simulation itself, and judged by motions
that were not fitted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float64
from scipy.optimize import lsq_linear

from trueup.core.fit_result import Suspect
from trueup.core.parameters import ParameterSet
from trueup.identify.causes import CAUSES, Cause, Column, Motions, late_feedback
from trueup.identify.problem import Forces, Problem
from trueup.identify.solution import Solution, SolveSettings
from trueup.identify.solvers import Loss
from trueup.identify.uncertainty import as_least_squares, noise_level, noise_of, precision_of, unresolved

# A small push, as a share of the rms torque of the drive.
_PUSH = 0.05
# A force per unit that is less than this share of the rms torque is none.
_NOTHING = 1e-4
# What may be late by so much [s].
_LATE_S = (0.005, 0.015)
# As far as one step of parameters goes, in z; how much a step of one is held back, in units of what is left; and the
# step of derivatives.
_FARTHEST, _HOLDS, _STEP = 1.5, (0.0, 1e-3, 1e-2, 0.1, 1.0, 10.0), 0.01
# A number becomes smaller by this share of it at most in a step.
_LEAST_STEP = -0.9
# A fit that takes less than this off the sum of squares had ended where it was.
_ENDED = 0.01
# Steps of a fit with the cause in it.
_ROUNDS = 2
# How far a derivative along a cause goes: parameters, in z, and a shift in units of what is left.
_FAR, _SHIFTED = 0.3, 5.0
# Gains, in independent observations: of a cause and of one of its joints to be looked at closely, and on motions that
# were not fitted.
_LEAST_GAIN, _LEAST_OF_JOINT, _LEAST_ON_VAL = 25.0, 12.0, 10.0
# What can only be one must be this share of it at least, with derivatives alone.
_SOME = 0.2
# Causes that are looked at closely.
_MOST = 3
# Share of what is left that a suspect explains at least, on train and on val, and on train without val.
_EXPLAINS, _EXPLAINS_ALONE = 0.3, 0.5
# What is left passes for noise up to so many times the noise of each joint. There a cause explains at least this share,
# and moves a number by so many of its standard deviations.
_PASSES, _EXPLAINS_SOME, _BENDS = 1.3, 0.1, 2.0
# Of one of its joints, on train.
_PART = 0.15
# What is left beyond the noise of the measurement counts as no less than this share of that noise.
_LEAST_EXCESS = 0.1
# What acts on the whole robot explains at least so much of what is left of all joints.
_ON_ALL = 0.1
# Another joint explains nearly as much, and another cause so much that it may be that one.
_NEARLY, _RIVAL = 0.85, 0.75
# Simulated forces that are held at a time [numbers].
_AT_ONCE = 20_000_000
# Prior standard deviations by which a mass, or their sum, is out of what CAD may have wrong.
_HEAVY = 3.5


@dataclass(frozen=True, eq=False)
class Rest:
    """What is left of some motions, and what causes would change.

    Attributes:
        motions: of the fitted model, with the larger time step if the fit has two.
        residual: of the fitted model, (N,).
        finer: what the smaller time step changes of it, (N,): changes are those of the larger one.
        counts: how much each residual counts under a robust loss, as factors, (N,).
    """

    motions: Motions
    residual: Float64[np.ndarray, "N"]
    finer: Float64[np.ndarray, "N"]
    counts: Float64[np.ndarray, "N"]

    @staticmethod
    def of(problem: Problem, z: Float64[np.ndarray, "P"], loss: Loss) -> Rest:
        """What a fitted model leaves.

        Raises:
            DataError: it cannot be simulated.
        """
        used = problem.coarse or problem
        (own,) = used.residuals(z[None])
        residual = own if used is problem else problem.residuals(z[None])[0]
        counts = np.sqrt(loss.weights(residual))
        return Rest(Motions(used, z), counts * residual, residual - own, counts)

    @property
    def problem(self) -> Problem:
        """Whose motions these are."""
        return self.motions.problem

    def columns(self, cause: Cause) -> list[Column]:
        """Of a cause."""
        return cause.columns(self.motions)

    def derivatives(self, columns: Sequence[Column]) -> Float64[np.ndarray, "K N"]:
        """What one unit of each column adds to the residual; zero where it cannot be told."""
        out = np.zeros((len(columns), self.residual.size))
        pushes = np.array([0.0 if column.shifts else self.push(column) for column in columns])
        pushed = np.flatnonzero(pushes)
        for number, column in enumerate(columns):
            if column.shifts:
                out[number] = self.shifted(column)
        if pushed.size:
            z = np.tile(self.motions.z, (pushed.size, 1))
            found = self.with_causes([columns[int(k)] for k in pushed], np.diag(pushes[pushed]), z)
            out[pushed] = (found - self.residual) / pushes[pushed, None]
        out[~np.isfinite(out).all(axis=1)] = 0.0
        return out

    @cached_property
    def beginnings(self) -> tuple[list[Column], Float64[np.ndarray, "K N"]]:
        """A constant torque of each joint in each motion, and its derivatives; all motions are simulated at once."""
        columns, segments = self.motions.beginnings(), len(self.problem.segments)
        rows: list[np.ndarray] = []
        for begin in range(0, len(columns), segments):
            own = columns[begin : begin + segments]
            every = {key: np.sum([column.field[key] for column in own], axis=0) for key in own[0].field}
            (found,) = self.derivatives([replace(own[0], field=every, logged=every)])
            for segment in self.problem.segments:
                row = np.zeros_like(found)
                for (other, _, mine), (_, _, values) in zip(
                    self.problem.by_segment(row), self.problem.by_segment(found), strict=True
                ):
                    mine[:] = values if other is segment else 0.0
                rows.append(row)
        return columns, np.array(rows).reshape(len(columns), self.residual.size)

    def with_causes(
        self, columns: Sequence[Column], sizes: Float64[np.ndarray, "C K"], z: Float64[np.ndarray, "C P"]
    ) -> Float64[np.ndarray, "C N"]:
        """Residuals of candidates, each with causes of sizes of its own."""
        steps = sum(course.position[:, 1:].size for course in self.motions.courses.values())
        several = max(1, _AT_ONCE // max(1, steps))
        out = np.empty((len(z), self.residual.size))
        for begin in range(0, len(z), several):
            own = slice(begin, begin + several)
            forces = [self._forces(columns, row) for row in sizes[own]]
            out[own] = (self.problem.residuals(z[own], forces) + self.finer) * self.counts
        shifts = [number for number, column in enumerate(columns) if column.shifts]
        if shifts:
            unit = np.array([self.shifted(columns[number]) for number in shifts])
            out += sizes[:, shifts] @ unit
        return out

    def shifted(self, column: Column) -> Float64[np.ndarray, "N"]:
        """What one unit of a shift adds to the residual."""
        return np.asarray(
            self.counts * self.problem.shift({segment: column.of(segment) for segment in self.motions.courses})
        )

    @property
    def samples(self) -> Float64[np.ndarray, "K"]:
        """How many residuals each joint that counts has."""
        return self.problem.squares(self.counts)

    def push(self, column: Column) -> float:
        """A size at which a force is small against the drives; 0 where the cause does nothing."""
        values = [column.of(segment) for segment in self.motions.courses]
        rms = np.sqrt(np.mean([np.mean(own**2, axis=(0, 1)) for own in values], axis=0))
        most = float(np.max(rms / np.maximum(self.motions.torque, 1e-12)))
        return _PUSH / most if most > _NOTHING else 0.0

    def _forces(self, columns: Sequence[Column], sizes: Sequence[float] | np.ndarray) -> Forces:
        courses = self.motions.courses
        total = {segment: np.zeros((2, *own.position[:, 1:].shape)) for segment, own in courses.items()}
        for column, size in zip(columns, sizes, strict=True):
            if not column.shifts and size:
                for segment, own in total.items():
                    own += size * column.forces(segment)
        return total


@dataclass(frozen=True, eq=False)
class Place:
    """Parameters, sizes of causes, and what is left there.

    Attributes:
        z: parameters, (P,).
        sizes: of the columns, (K,).
        begun: of the beginnings of the motions, (M,).
        residual: (N,).
        cost: sum of squares, with the prior.
    """

    z: Float64[np.ndarray, "P"]
    sizes: Float64[np.ndarray, "K"]
    begun: Float64[np.ndarray, "M"]
    residual: Float64[np.ndarray, "N"]
    cost: float


@dataclass(frozen=True, eq=False)
class _Free:
    """What a fit with a cause changes, and how the residual changes with it.

    Attributes:
        columns: of the cause, K.
        begun: beginnings of the motions, M.
        jacobian: derivatives by parameters and beginnings, (P + M, N).
        raw: derivatives by the columns, (K, N).
        rows: the same, mended, (K, N).
        at: where.
    """

    columns: Sequence[Column]
    begun: Sequence[Column]
    jacobian: np.ndarray
    raw: np.ndarray
    rows: np.ndarray
    at: Place

    def only(self, kept: Sequence[int]) -> _Free:
        """The same with these columns alone."""
        own = list(kept)
        return replace(
            self,
            columns=[self.columns[number] for number in own],
            raw=self.raw[own],
            rows=self.rows[own],
            at=replace(self.at, sizes=self.at.sizes[own]),
        )


@dataclass(frozen=True, eq=False)
class _Solved:
    """A step of parameters, beginnings and columns, what it promises, and what each column is worth."""

    z: np.ndarray
    begun: np.ndarray
    sizes: np.ndarray
    change: float
    gains: np.ndarray


@dataclass(frozen=True, eq=False)
class Tested:
    """A cause that was looked at.

    Attributes:
        cause: which.
        columns: those of it that matter.
        numbers: which of its columns they are.
        gain: in independent observations, as its derivatives see it.
        alike: joints that might be the one, of a cause of a single joint.
        place: fitted with it.
        train: joint that counts -> squares that it takes away, (K,).
        val: likewise on val; None without.
    """

    cause: Cause
    columns: Sequence[Column]
    numbers: Sequence[int]
    gain: float
    alike: Set[int | None]
    place: Place | None = None
    train: np.ndarray | None = None
    val: np.ndarray | None = None

    @property
    def judged(self) -> np.ndarray:
        """What it takes away from motions that were not fitted, or, without any, from those that were."""
        found = self.train if self.val is None else self.val
        assert found is not None
        return found


class Suspicion:
    """Looks for causes in what a fit leaves.

    Args:
        problem: the fit.
        held_out: the same for motions that were not fitted; None without.
        solution: of the fit.
        settings: of its search.
        known: number -> standard deviation of its interval, in z.

    Raises:
        DataError: the model cannot be simulated.
    """

    def __init__(
        self,
        problem: Problem,
        held_out: Problem | None,
        solution: Solution,
        settings: SolveSettings,
        known: Mapping[str, float] | None = None,
    ) -> None:
        z, newton = solution.z, settings.gauss_newton
        (residual,) = problem.residuals(z[None])
        loss = Loss.of(residual, newton.loss, newton.loss_scale)
        _, factor = as_least_squares(problem, residual, loss)
        self._mean, _ = problem.parameters.prior
        self._low, self._high = problem.parameters.bounds
        self._begin(Rest.of(problem, z, loss), solution.jacobian / factor)
        # Where a search ended early, the rest of its way is no cause.
        ended = self.fitted([])
        if ended.cost < (1.0 - _ENDED) * self._cost(z, self.train.residual):
            z = ended.z
            jacobian = self._derivatives([], ended) / self.train.counts
            self._begin(Rest.of(problem, z, loss), jacobian)
        self.val = None if held_out is None else Rest.of(held_out, z, loss)
        names = [item.name for item in problem.parameters.free]
        self._spread = np.array([np.inf if known is None else known.get(name, np.inf) for name in names])
        most = _PASSES**2 * self._noise * self.train.samples
        self._passes = bool(np.all(self.train.problem.squares(self.train.residual) <= most))
        self._least = _EXPLAINS_SOME if self._passes else _EXPLAINS

    def _begin(self, rest: Rest, jacobian: Float64[np.ndarray, "P N"]) -> None:
        self.train, self._z, self._jacobian = rest, rest.motions.z, jacobian * rest.counts
        self.observation = noise_of(rest.problem, rest.residual).weight
        self._precision = self.observation * np.diag(precision_of(rest.problem.parameters))

    @cached_property
    def _noise(self) -> Float64[np.ndarray, "K"]:
        """Mean square of what the measurement adds to the residual of each joint, in the scale of train."""
        problem = self.train.problem
        total, samples = np.zeros(problem.columns.size), 0
        blocks = list(problem.by_segment(self.train.residual))
        for signal in dict.fromkeys(name for _, name, _ in blocks):
            pieces = [own for _, name, own in blocks if name == signal]
            noise = np.array([noise_level([own[:, k] for own in pieces]) for k in range(problem.columns.size)])
            if signal == "position":
                noise = np.maximum(noise, problem.in_residual(signal, unresolved(problem)))
            count = sum(len(own) for own in pieces)
            total, samples = total + count * noise**2, samples + count
        return total / samples

    def excess(self, rest: Rest, residual: Float64[np.ndarray, "N"]) -> Float64[np.ndarray, "K"]:
        """Squares of each joint beyond the noise of the measurement, and no less than a share of that."""
        noise = self._noise * (rest.problem.scale / self.train.problem.scale) ** 2
        noise = noise * rest.samples
        return np.asarray(np.maximum(rest.problem.squares(residual) - noise, _LEAST_EXCESS * noise))

    @cached_property
    def _open(self) -> set[int]:
        """Joints of which so much is left that a cause could be named; all where noise may hide it."""
        columns = self.train.problem.columns
        if self._passes:
            return {int(column) for column in columns}
        noise = self._noise * self.train.samples
        beyond = self.train.problem.squares(self.train.residual) - noise
        return {int(columns[place]) for place in np.flatnonzero(beyond > self._least * _LEAST_EXCESS * noise)}

    def screened(self) -> list[Tested]:
        """All causes whose derivatives explain more than chance would, the best first."""
        found = [self._screened(cause) for cause in (*self._late(), *CAUSES)]
        return sorted((item for item in found if item is not None), key=lambda item: -item.gain)

    def _late(self) -> list[Cause]:
        """Feedback that is late by what explains most if all drives share it."""
        gains = {}
        for late_s in _LATE_S:
            columns = self.train.motions.late(late_s)
            fields = list({id(column.field): column for column in columns}.values())
            shared = [
                replace(
                    first,
                    joint=None,
                    field={
                        key: np.sum([column.of(key) for column in columns if column.field is first.field], axis=0)
                        for key in first.field
                    },
                )
                for first in fields
            ]
            if shared:
                gains[late_s] = self._gain(self._free(shared, beginnings=False))
        return [late_feedback(max(gains, key=lambda late_s: gains[late_s]))] if gains else []

    def _free(self, columns: Sequence[Column], *, beginnings: bool) -> _Free:
        """Parameters, beginnings and columns with their derivatives where the fit has ended."""
        begun, rows = self.train.beginnings if beginnings else ([], np.zeros((0, self.train.residual.size)))
        raw = self.train.derivatives(columns)
        kept = [number for number, row in enumerate(raw) if row.any()]
        own = [columns[number] for number in kept]
        residual = self.train.residual
        start = Place(self._z, np.zeros(len(own)), np.zeros(len(begun)), residual, self._cost(self._z, residual))
        jacobian = np.concatenate([self._jacobian, rows])
        return self._along(_Free(own, begun, jacobian, raw[kept], raw[kept], start))

    def _along(self, free: _Free) -> _Free:
        """The same with derivatives along the directions in which parameters hide the columns.

        A cause that parameters nearly make up for leaves a small rest of two large derivatives, whose errors are as
        large as that rest. So what is simulated is the column together with the step of the parameters that hides it,
        and the derivative along the column is mended by that.
        """
        at = free.at
        if not free.columns:
            return free
        curve = free.jacobian @ free.jacobian.T
        curve[np.diag_indices_from(curve)] += float(at.residual @ at.residual)
        moves = -np.linalg.solve(curve, free.jacobian @ free.raw.T).T
        parameters = len(at.z)
        most = np.maximum(np.abs(moves[:, :parameters]).max(axis=1), 1e-300)
        size = np.array([self._size(column, row) for column, row in zip(free.columns, free.raw, strict=True)])
        size = np.minimum(size, _FAR / most)
        z = np.array([self._moved(at.z, step * move[:parameters]) for step, move in zip(size, moves, strict=True)])
        begun = at.begun + size[:, None] * moves[:, parameters:]
        sizes = np.concatenate([at.sizes + np.diag(size), begun], axis=1)
        found = self.train.with_causes([*free.columns, *free.begun], sizes, z)
        rows = (found - at.residual) / size[:, None]
        lost = ~np.isfinite(rows).all(axis=1)
        rows -= moves @ free.jacobian
        rows[lost] = free.raw[lost]
        return replace(free, rows=rows)

    def _size(self, column: Column, row: Float64[np.ndarray, "N"]) -> float:
        if not column.shifts:
            return self.train.push(column)
        left = float(np.linalg.norm(self.train.residual))
        return _SHIFTED * left / float(np.linalg.norm(row))

    def _gain(self, free: _Free) -> float:
        """What columns bring beside parameters and beginnings, in independent observations."""
        alone = self._solve(free.only([]))
        return (alone.change - self._solve(free).change) / self.observation

    def _screened(self, cause: Cause) -> Tested | None:
        columns = self.train.columns(cause)
        worth = [column for column in columns if column.joint is None or column.joint in self._open]
        if not worth:
            return None
        free = self._free(worth, beginnings=cause.beginnings)
        kept, alike = list(range(len(free.columns))), set()
        if cause.single and kept:
            gains = np.array([self._gain(free.only([number])) for number in kept])
            alike = {free.columns[k].joint for k in kept if gains[k] > _NEARLY * gains.max()}
            kept = [int(np.argmax(gains))]
        while kept:
            own = free.only(kept)
            solved = self._solve(own)
            weakest = int(np.argmin(solved.gains))
            if cause.together or solved.gains[weakest] >= _LEAST_OF_JOINT:
                numbers = [k for k, column in enumerate(columns) if any(column is other for other in own.columns)]
                gain = self._gain(own)
                least = [_SOME * max(column.within[0], 0.0) for column in own.columns]
                if not cause.together and np.any(solved.sizes < least):
                    return None
                return Tested(cause, own.columns, numbers, gain, alike) if gain > _LEAST_GAIN else None
            kept.pop(weakest)
        return None

    def _solve(self, free: _Free, hold: float = 0.0) -> _Solved:
        """The step to the minimum that derivatives see, inside of bounds.

        It minimizes |r + J^T a + D^T c|^2 + w |z + a - mean|^2_L + h |r|^2 |a|^2 over steps a of parameters and
        beginnings and c of the columns, with L the precision of the prior and w the variance of one independent
        observation.
        """
        at = free.at
        parameters, rest = len(at.z), len(free.jacobian)
        every = np.concatenate([free.jacobian, free.rows])
        curve, slope = every @ every.T, every @ at.residual
        places = np.arange(parameters)
        curve[places, places] += self._precision + hold * float(at.residual @ at.residual)
        slope[:parameters] += self._precision * (at.z - self._mean)
        norms = np.sqrt(np.maximum(np.diag(curve), 1e-300))
        low, high = np.full(len(every), -np.inf), np.full(len(every), np.inf)
        low[:parameters] = np.maximum(self._low - at.z, -_FARTHEST)
        high[:parameters] = np.minimum(self._high - at.z, _FARTHEST)
        if free.columns:
            limits = np.array([column.bounds for column in free.columns]) - at.sizes[:, None]
            low[rest:], high[rest:] = limits.T
        low, high = np.minimum(low, 0.0) * norms, np.maximum(high, 1e-12) * norms
        curve, slope = curve / np.outer(norms, norms), slope / norms
        squares, vectors = np.linalg.eigh(curve)
        seen = squares > 1e-12 * squares.max()
        roots = np.sqrt(squares[seen])
        known, asked = roots[:, None] * vectors[:, seen].T, -(vectors[:, seen].T @ slope) / roots
        step = lsq_linear(known, asked, (low, high), method="bvls").x
        inside = (step > low) & (step < high)
        spread = np.zeros(len(every))
        spread[inside] = np.diag(np.linalg.pinv(curve[np.ix_(inside, inside)], rcond=1e-12, hermitian=True))
        gains = np.where(spread > 0, step**2 / np.maximum(spread, 1e-300), 0.0) / self.observation
        change = float(step @ curve @ step + 2 * slope @ step)
        step = step / norms
        return _Solved(step[:parameters], step[parameters:rest], step[rest:], change, gains[rest:])

    def _cost(self, z: Float64[np.ndarray, "P"], residual: Float64[np.ndarray, "N"]) -> float:
        return float(residual @ residual + np.sum(self._precision * (z - self._mean) ** 2))

    def fitted(self, columns: Sequence[Column], *, beginnings: bool = False) -> Place:
        """Parameters and sizes of a cause together, by a few steps of Gauss-Newton on the simulation itself."""
        free = self._free(columns, beginnings=beginnings)
        for number in range(_ROUNDS):
            at = free.at
            if number:
                jacobian = self._derivatives([*free.columns, *free.begun], at)
                free = self._along(replace(free, jacobian=np.concatenate([jacobian, free.jacobian[len(at.z) :]])))
            steps = [self._solve(free, hold) for hold in _HOLDS]
            z = np.array([self._moved(at.z, step.z) for step in steps])
            sizes = np.array([at.sizes + step.sizes for step in steps])
            begun = np.array([at.begun + step.begun for step in steps])
            every = np.concatenate([sizes, begun], axis=1)
            residuals = self.train.with_causes([*free.columns, *free.begun], every, z)
            costs = np.array([self._cost(own, residual) for own, residual in zip(z, residuals, strict=True)])
            best = int(np.argmin(np.where(np.isfinite(costs), costs, np.inf)))
            if not costs[best] < at.cost:
                break
            free = replace(free, at=Place(z[best], sizes[best], begun[best], residuals[best], float(costs[best])))
        return free.at

    def _moved(self, z: Float64[np.ndarray, "P"], step: Float64[np.ndarray, "P"]) -> Float64[np.ndarray, "P"]:
        """A step in the numbers themselves, in which torques are linear, where z is their logarithm."""
        logarithmic = np.array([item.transform == "log" for item in self.train.problem.parameters.free], dtype=bool)
        own = np.where(logarithmic, np.log1p(np.maximum(step, _LEAST_STEP)), step)
        return np.asarray(np.clip(z + own, self._low, self._high))

    def _derivatives(self, columns: Sequence[Column], at: Place) -> Float64[np.ndarray, "P N"]:
        """Of the residual with causes by the parameters."""
        steps = np.where(at.z + _STEP > self._high, -_STEP, _STEP)
        sizes = np.tile(np.concatenate([at.sizes, at.begun]), (steps.size, 1))
        found = self.train.with_causes(columns, sizes, at.z + np.diag(steps))
        out = (found - at.residual) / steps[:, None]
        out[~np.isfinite(out).all(axis=1)] = 0.0
        return np.asarray(out)

    def looked_at(self, most: int = _MOST) -> list[Tested]:
        """The best causes, fitted, with what they explain beside what parameters alone do; the best on val first."""
        screened = self.screened()[:most] if self._open else []
        if not screened:
            return []
        alone = {
            begun: self._explained(None, beginnings=begun)
            for begun in {item.cause.beginnings for item in screened} | {False}
        }
        self.left = alone[False]
        found = []
        for item in screened:
            own, base = self._explained(item, beginnings=item.cause.beginnings), alone[item.cause.beginnings]
            if all(column.sensible(size) for column, size in zip(item.columns, own.place.sizes, strict=True)):
                val = None if own.val is None or base.val is None else base.val - own.val
                found.append(replace(item, place=own.place, train=base.train - own.train, val=val))
        return sorted(found, key=lambda item: -float(np.sum(item.judged[self.about(item)])))

    def about(self, item: Tested) -> list[int]:
        """Places of the joints, among those that count, that a cause is about.

        What acts on the whole robot is about those that it explains. What each joint may have of its own is about those
        of which it explains some part on train, and something on val: a joint that it hardly explains says nothing
        against the others.
        """
        columns = list(self.train.problem.columns)
        joints = {column.joint for column in item.columns}
        shares = self._by_joint(item)
        if None not in joints and not item.cause.single:
            part = min(_PART, self._least)
            some = [place for place, joint in enumerate(columns) if joint in joints and shares[0][place] > part]
            return [place for place in some if shares[-1][place] > 0.0]
        return [place for place in range(len(columns)) if all(own[place] > self._least for own in shares)]

    def _by_joint(self, item: Tested) -> list[Float64[np.ndarray, "K"]]:
        """Share of what is left of each joint that a cause explains, on train and on val."""
        assert item.train is not None
        shares = [item.train / np.maximum(self.left.excess, 1e-300)]
        if item.val is not None and self.left.val_excess is not None:
            shares.append(item.val / np.maximum(self.left.val_excess, 1e-300))
        return shares

    def _explained(self, item: Tested | None, *, beginnings: bool) -> _Left:
        place = self.fitted([] if item is None else item.columns, beginnings=beginnings)
        train, excess = self.train.problem.squares(place.residual), self.excess(self.train, place.residual)
        if self.val is None:
            return _Left(place, train, excess, None, None)
        own: list[Column] = []
        if item is not None:
            there = item.cause.columns(self.val.motions)
            own = [there[number] for number in item.numbers]
        (left,) = self.val.with_causes(own, place.sizes[None], place.z[None])
        beyond = self.excess(self.val, left)
        if beginnings:
            # How the motions of val begin is not known either.
            basis, _ = np.linalg.qr(self.val.beginnings[1].T)
            left = left - basis @ (basis.T @ left)
        return _Left(place, train, excess, self.val.problem.squares(left), beyond)

    def suspects(self) -> tuple[Suspect, ...]:
        """The causes that explain what is left, one for each group of joints, the most important first."""
        free = set(range(self.train.problem.columns.size))
        looked, found = self.looked_at(), []
        for item in looked:
            about = [place for place in self.about(item) if place in free]
            train, val, gain = self._shares(item, about)
            if not about or not self._convinces(item, about):
                continue
            free -= set(about)
            rivals = [
                other
                for other in looked
                if other is not item
                and set(about) & set(self.about(other))
                and float(np.sum(other.judged[about])) > _RIVAL * float(np.sum(item.judged[about]))
            ]
            found.append(self._named(item, train, val, gain, rivals, about))
        return tuple(found)

    def _shares(self, item: Tested, about: list[int]) -> tuple[float, float | None, float]:
        """Of what is left of some joints, what a cause explains on train and on val; and its gain on val."""
        assert item.train is not None
        train = float(np.sum(item.train[about])) / max(float(np.sum(self.left.excess[about])), 1e-300)
        if item.val is None or self.left.val_excess is None:
            return min(train, 1.0), None, item.gain
        val = float(np.sum(item.val[about]))
        scale = (self.val.problem.scale / self.train.problem.scale) ** 2 if self.val else 1.0
        share = val / max(float(np.sum(self.left.val_excess[about])), 1e-300)
        return min(train, 1.0), min(share, 1.0), val / (self.observation * scale)

    def _convinces(self, item: Tested, about: list[int]) -> bool:
        every = list(range(self.train.problem.columns.size))
        if item.cause.together and min(value for value in self._shares(item, every)[:2] if value is not None) < _ON_ALL:
            return False
        if item.cause.size is not None and max(self._sizes(item).values()) < item.cause.least:
            return False
        train, val, gain = self._shares(item, about)
        if val is None:
            return train > _EXPLAINS_ALONE
        least = self._least if self._bends(item) else _EXPLAINS
        return train > least and val > least and gain > _LEAST_ON_VAL

    def _bends(self, item: Tested) -> bool:
        """Whether numbers would be others with the cause, by more than their intervals say."""
        assert item.place is not None
        return bool(np.any(np.abs(item.place.z - self.left.place.z) > _BENDS * self._spread))

    @staticmethod
    def _sizes(item: Tested) -> dict[int | None, float]:
        """Joint -> size of a cause that has one; of two columns of a joint, the first is what is told."""
        assert item.place is not None
        assert item.cause.size is not None
        found = list(zip(item.columns, item.place.sizes, strict=True))
        return {column.joint: item.cause.size(float(value)) for column, value in reversed(found)}

    def _named(
        self, item: Tested, train: float, val: float | None, gain: float, rivals: Sequence[Tested], about: list[int]
    ) -> Suspect:
        motions, cause = self.train.motions, item.cause
        assert item.place is not None
        numbers = [int(self.train.problem.columns[place]) for place in about]
        joints, where, unit = tuple(motions.joints[number] for number in numbers), "", cause.unit
        sizes: tuple[float, ...] = ()
        if cause.together:
            where = f"the body {motions.model.body(motions.end_body).name!r}"
        else:
            which = [name for number, name in enumerate(motions.joints) if number in item.alike]
            where, unit = " or ".join(which) or ", ".join(joints), motions.unit(numbers[0], cause.unit)
            if cause.size is not None:
                own = self._sizes(item)
                sizes = tuple(own[number] for number in numbers)
        size = f"{', '.join(f'{value:.2g}' for value in sizes)} {unit}".strip()
        words = cause.words.format(joints=where, size=size)
        what = (
            "the remaining error"
            if len(about) == self.train.problem.columns.size
            else f"the remaining error of {', '.join(joints)}"
        )
        judged = "" if val is None else f" (val: {val:.0%})"
        other = "; ".join(
            f"{rival.cause.name.replace('-', ' ')}, which looks similar, {self._shares(rival, about)[0]:.0%}"
            for rival in rivals
        )
        sentence = f"{words} would explain {train:.0%} of {what}{judged}" + (f"; {other}" if other else "")
        return Suspect(cause.name, joints, sizes, unit, train, val, gain, sentence)


@dataclass(frozen=True, eq=False)
class _Left:
    """Where a fit ended, and what it leaves of each joint that counts: squares, and those beyond the noise."""

    place: Place
    train: np.ndarray
    excess: np.ndarray
    val: np.ndarray | None
    val_excess: np.ndarray | None


def suspects_of(
    problem: Problem,
    held_out: Problem | None,
    solution: Solution,
    settings: SolveSettings,
    known: Mapping[str, float] | None = None,
) -> tuple[Suspect, ...]:
    """What a fitted model may lack.

    Args:
        problem: the fit.
        held_out: the same for motions that were not fitted; None without.
        solution: of the fit.
        settings: of its search.
        known: number -> standard deviation of its interval, in z.

    Raises:
        DataError: the fitted model cannot be simulated.
    """
    return Suspicion(problem, held_out, solution, settings, known).suspects()


def strange_masses(parameters: ParameterSet, values: Mapping[str, float]) -> str:
    """What to say of masses that are further from the model's than somebody who weighs them is wrong; empty if none is.

    Args:
        parameters: of the fit.
        values: of its end.
    """
    found = []
    for item in parameters.free:
        if item.quantity == "mass" and item.nominal and item.prior_std and item.transform == "log":
            away = abs(float(np.log(values[item.name] / item.nominal))) / item.prior_std
            if away > _HEAVY:
                found.append((away, item.name, values[item.name] - item.nominal))
    words = [
        f"{name} is {abs(change):.2g} kg {'above' if change > 0 else 'below'} the model's ({away:.1f} standard "
        "deviations of its prior)"
        for away, name, change in sorted(found, reverse=True)[:3]
    ]
    heavier = any(change > 0 for _, _, change in found)
    return "; ".join(words) + (": is there a payload that the model does not have?" if heavier else "")
