"""Errors of a model on whole motions, simulated as `trueup replay` does it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int

from trueup.core.episode import Episode
from trueup.core.parameters import ParameterSet
from trueup.core.results import Estimate
from trueup.errors import DataError
from trueup.identify.candidate import Nominal
from trueup.identify.config import IdentifyConfig
from trueup.identify.logged_torque import LoggedTorque
from trueup.identify.problem import Problem, Weights
from trueup.identify.quantities import quantity
from trueup.identify.segments import Segment, SegmentRule, make_segments
from trueup.measure import bootstrap_interval, motion_numbers
from trueup.robots import RobotSpec

# Instead of a split: of each motion by a fit to the others.
CROSS_VALIDATION = "cross-validation"
# Fewer motions of val than this do not choose between models alone.
_FEW = 6


@dataclass(frozen=True, eq=False)
class Scores:
    """Position RMSE of every motion and scored joint, (E, J) [rad or m].

    Attributes:
        episodes: ids of the E motions.
        joints: names of the J scored joints.
        rmse: NaN where a motion diverged.
        samples: number of samples of each motion, (E,).
        seed: of the intervals.
        executed: what each motion executed, (E,), the same for its repetitions; none is repeated if empty.
    """

    episodes: tuple[str, ...]
    joints: tuple[str, ...]
    rmse: Float64[np.ndarray, "E J"]
    samples: Int[np.ndarray, "E"]
    seed: int = 0
    executed: tuple[str, ...] = ()

    @staticmethod
    def together(parts: Sequence[Scores]) -> Scores:
        """Those of the motions of all parts, of which there is one at least."""
        first = parts[0]
        return Scores(
            tuple(name for part in parts for name in part.episodes),
            first.joints,
            np.concatenate([part.rmse for part in parts]),
            np.concatenate([part.samples for part in parts]),
            first.seed,
            tuple(name for part in parts for name in part.executed),
        )

    @property
    def mean(self) -> float:
        """Mean over motions of the mean over scored joints; infinite if a motion diverged."""
        return float(np.mean(self.rmse)) if np.isfinite(self.rmse).all() else float("inf")

    @property
    def per_joint(self) -> dict[str, float]:
        """Joint -> mean over motions; joints of a motion that diverged are left out."""
        means = np.mean(self.rmse, axis=0)
        return {joint: float(value) for joint, value in zip(self.joints, means, strict=True) if np.isfinite(value)}

    @property
    def pooled(self) -> dict[str, float]:
        """Joint -> root mean square over the samples of all motions."""
        share = self.samples / self.samples.sum()
        values = np.sqrt(share @ self.rmse**2)
        return {joint: float(value) for joint, value in zip(self.joints, values, strict=True)}

    def estimate(self, unit: str) -> Estimate:
        """The mean with its 95 % interval over motions; repetitions are drawn together."""
        values = self.rmse.mean(axis=1, keepdims=True)
        if not np.isfinite(values).all():
            return Estimate(float("nan"), unit)
        low, high = bootstrap_interval(values, motions=motion_numbers(self.executed or self.episodes), seed=self.seed)
        if np.isnan(low[0]):
            return Estimate(self.mean, unit)
        return Estimate(self.mean, unit, max(0.0, float(low[0])), float(high[0]))


def judged(robot: RobotSpec, config: IdentifyConfig | None) -> RobotSpec:
    """The robot as its models are judged: where it says no `replay.window_s`, with the window of the fit.

    Whole motions of open-loop torque forget their parameters: which of two models does better on them is chance.
    """
    if robot.replay.window_s is not None:
        return robot
    window_s = (config or IdentifyConfig()).window_s(robot)
    return replace(robot, replay=replace(robot.replay, window_s=window_s))


class Scorer:
    """Scores models on the motions of each split.

    Args:
        nominal: the model as it came; joints, time step and commands count.
        episodes: split -> motions in the robot's joint names.
        jobs: threads.
        seed: of the intervals.

    Attributes:
        refused: split -> motion -> why it cannot be scored.
        executed: motion -> what it executed, the same for its repetitions.
    """

    def __init__(
        self, nominal: Nominal, episodes: Mapping[str, Sequence[Episode]], *, jobs: int = 1, seed: int = 0
    ) -> None:
        rule = SegmentRule(
            window_s=nominal.robot.replay.window_s,
            cut_s=None,
            budget_s=float("inf"),
            settle_s=nominal.robot.replay.settle_s,
            base_sensor=nominal.robot.simulation.base_sensor,
            command=nominal.robot.replay.command,
        )
        self._nominal, self._jobs, self._seed = nominal, jobs, seed
        self._segments: dict[str, list[Segment]] = {}
        self.executed: dict[str, str] = {}
        self.refused: dict[str, dict[str, str]] = {}
        for split, logs in episodes.items():
            if not logs:
                continue
            self.executed.update({log.id: log.meta.executed for log in logs})
            try:
                self._segments[split], refused = make_segments(logs, nominal.simulator, rule)
            except DataError as error:
                refused = dict.fromkeys((log.id for log in logs), error)
            if refused:
                self.refused[split] = {name: error.summary for name, error in refused.items()}

    @property
    def splits(self) -> tuple[str, ...]:
        """The splits that have motions."""
        return tuple(self._segments)

    @property
    def deciding(self) -> tuple[str, ...]:
        """The splits that choose between models: val, and train beside it where val has few motions."""
        if "val" not in self._segments:
            return ()
        few = len({self.executed[segment.episode_id] for segment in self._segments["val"]}) < _FEW
        return ("train", "val") if few and "train" in self._segments else ("val",)

    def deciding_error(self, parameters: ParameterSet, values: Mapping[str, float]) -> float:
        """Mean over the motions that choose between models of the mean over scored joints; infinite if one diverged."""
        errors = np.concatenate([self.score(parameters, values, split).rmse for split in self.deciding])
        return float(np.mean(errors)) if np.isfinite(errors).all() else float("inf")

    @property
    def unit(self) -> str:
        """Unit of the errors: that of the scored joints, `mixed` if they have several."""
        segment = next(segment for segments in self._segments.values() for segment in segments)
        units = dict(zip(segment.plan.measured.joints, segment.plan.measured.units["position"], strict=True))
        own = {units[joint] for joint in self._nominal.robot.scored_joints}
        return own.pop() if len(own) == 1 else "mixed"

    def size(self, split: str) -> dict[str, dict[str, float]]:
        """Logged signal -> scored joint -> standard deviation of what was measured on one split [its unit]."""
        robot, found = self._nominal.robot, {}
        for name in ("position", "velocity", "torque"):
            rows = [own.plan.measured[name] for own in self._segments[split] if name in own.plan.measured]
            if rows:
                spread = np.nanstd(np.concatenate(rows), axis=0)
                found[name] = {joint: float(spread[robot.joint_names.index(joint)]) for joint in robot.scored_joints}
        return found

    def signals(
        self,
        parameters: ParameterSet,
        values: Mapping[str, float],
        split: str,
        torque: Mapping[str, LoggedTorque],
    ) -> dict[str, dict[str, float]]:
        """Logged signal -> scored joint -> root mean square error of one model on one split [unit of the signal].

        Torques are compared without what other moments of their measurement explain: where a command is held, the one
        that acted a moment before may make all the difference.
        """
        logged = {name for segment in self._segments[split] for name in segment.plan.measured.signals}
        own = dict.fromkeys(("position", *(name for name in ("velocity", "torque") if name in logged)), 1.0)
        problem = self._problem(parameters, values, split, Weights(own, {}, torque=torque))
        residual = problem.residuals(problem.parameters.start[None])[0]
        pieces: dict[str, list[np.ndarray]] = {}
        for _, signal, rows in problem.by_segment(residual):
            pieces.setdefault(signal, []).append(rows / problem.scale)
        joints = self._nominal.robot.joint_names
        return {
            signal: {
                joints[column]: float(np.sqrt(np.mean(np.concatenate(rows)[:, place] ** 2)))
                for place, column in enumerate(problem.columns)
            }
            for signal, rows in pieces.items()
        }

    def command(self, split: str) -> Estimate | None:
        """The error of the command that is taken as the motion: a position, or a velocity's integral from the start.

        None where a torque is commanded.
        """
        signal = self._nominal.robot.controller.signal
        if signal == "torque":
            return None
        joints = [self._nominal.robot.joint_names.index(name) for name in self._nominal.robot.scored_joints]
        rows, names = [], []
        for segment in self._segments[split]:
            plan = segment.plan
            told, measured = plan.told(signal), plan.measured["position"]
            if signal == "velocity":
                moved = np.cumsum(told[:-1] * np.diff(plan.measured.time_s)[:, None], axis=0)
                told = measured[0] + np.concatenate([np.zeros_like(told[:1]), moved])
            rows.append(np.sqrt(np.nanmean((told - measured)[:, joints] ** 2, axis=0)))
            names.append(segment.episode_id)
        executed = tuple(self.executed[name] for name in names)
        found = Scores(
            tuple(names), tuple(map(str, joints)), np.array(rows), np.ones(len(rows), int), self._seed, executed
        )
        return found.estimate(self.unit)

    def _problem(
        self,
        parameters: ParameterSet,
        values: Mapping[str, float],
        split: str,
        weights: Weights | None = None,
        executed: str = "",
    ) -> Problem:
        # What single recordings were off by is no part of the model that is judged.
        lasting = tuple(item for item in parameters if quantity(item.quantity).of != "motion")
        moved = ParameterSet(lasting).at(values)
        segments = [own for own in self._segments[split] if executed in ("", self.executed[own.episode_id])]
        return Problem(self._nominal, moved, segments, weights=weights, jobs=self._jobs)

    def score(self, parameters: ParameterSet, values: Mapping[str, float], split: str, executed: str = "") -> Scores:
        """Errors of one model on one split, or on those of its motions that executed this."""
        problem = self._problem(parameters, values, split, executed=executed)
        residual = problem.residuals(problem.parameters.start[None])[0]
        joints = self._nominal.robot.joint_names
        rmse, samples = {}, {}
        for segment, _, own in problem.by_segment(residual):
            rmse[segment.episode_id] = [
                problem.unscaled_rms(own[:, place], int(column)) for place, column in enumerate(problem.columns)
            ]
            samples[segment.episode_id] = own.shape[0]
        scored = tuple(joints[column] for column in problem.columns)
        return Scores(
            tuple(rmse),
            scored,
            np.array(list(rmse.values())),
            np.array(list(samples.values())),
            self._seed,
            tuple(self.executed[name] for name in rmse),
        )
