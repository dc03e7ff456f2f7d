"""The logs of a fit, cut and simulated in one way or another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from trueup.core.episode import Episode
from trueup.core.parameters import ParameterSet
from trueup.core.time_limit import OutOfTime, TimeLimit
from trueup.errors import DataError, TrueupError
from trueup.identify.candidate import Nominal
from trueup.identify.config import IdentifyConfig
from trueup.identify.discretization import Discretization, in_words
from trueup.identify.problem import Problem, Weights
from trueup.identify.segments import Segment, make_segments
from trueup.identify.window_starts import WindowStarts, window_starts


class SimulatedLogs:
    """Motions, the pieces of them that a fit looks at, their weights, and the way in which they are simulated.

    Args:
        nominal: the model as it came.
        logs: split -> motions; `train` is fitted.
        config: resolved.
        jobs: threads.
        seed: where in the motions the pieces lie.
        limit: of time; after it, motions begin at their first reading.

    Attributes:
        way: in which they are simulated now.
        weights: of signals and joints.
        unfitted: motion -> why it cannot be fitted.

    Raises:
        DataError: no motion can be simulated.
    """

    def __init__(
        self,
        nominal: Nominal,
        logs: Mapping[str, Sequence[Episode]],
        config: IdentifyConfig,
        *,
        jobs: int,
        seed: int,
        limit: TimeLimit | None = None,
    ) -> None:
        self._limit = limit
        self._logs, self._config, self._jobs, self._seed = logs, config, jobs, seed
        self._timestep_s = nominal.simulator.timestep_s
        self._own = self.way = Discretization(command=nominal.robot.replay.command)
        self.weights = Weights(config.weights, config.joints)
        # Where windows begin, for each way to simulate, with parameters of these values; and in the way that was the
        # first, segment by segment: from there, it is one step to the starts of another.
        self._starts: dict[Discretization, Mapping[Segment, WindowStarts]] = {}
        self._place: Mapping[str, float] = {}
        self._first: list[WindowStarts] = []
        segments, refused = self._segments_of(nominal, "train")
        self._cut: dict[Discretization, tuple[Nominal, list[Segment]]] = {self.way: (nominal, segments)}
        self.unfitted = {name: error.summary for name, error in refused.items()}

    @property
    def nominal(self) -> Nominal:
        """The model as it came, simulated as the fit does."""
        return self._simulated(self.way)[0]

    @property
    def exported(self) -> Nominal:
        """The model as it came, simulated as a fitted model is outside of the fit."""
        return self._simulated(self.way.plain)[0]

    @property
    def segments(self) -> list[Segment]:
        """The pieces of the motions that are fitted."""
        return self._simulated(self.way)[1]

    @property
    def in_words(self) -> tuple[str, ...]:
        """How they are simulated otherwise than the robot's description says."""
        return in_words(self.way, self._own, self._timestep_s)

    @cached_property
    def period_s(self) -> float:
        """Usual time between two commands [s]."""
        return float(np.median([segment.plan.command_period_s for segment in self.segments]))

    @property
    def between_stamps(self) -> bool:
        """Whether there are simulation steps between the stamps of a command that moves."""
        return self.period_s > 1.5 * self._timestep_s

    @property
    def later_s(self) -> float:
        """By how much delays of the present timing are longer than those of the other one [s].

        A held command is late by half of the time between two.
        """
        return 0.5 * self.period_s * (-1.0 if self.way.command == "held" else 1.0)

    def problem(self, parameters: ParameterSet, way: Discretization | None = None) -> Problem:
        """The fit, simulated as it is now or in another way."""
        way = way or self.way
        nominal, segments = self._simulated(way)
        # The derivatives of the larger step serve as well, and take a fraction of the time.
        coarse = self.problem(parameters, replace(way, divisor=1)) if way.divisor > 1 else None
        problem = self._problem(nominal, parameters, segments, way, coarse)
        if way not in self._starts:
            self._starts[way] = self._begun(problem, self._near(segments))
            self._first = self._first or [self._starts[way][own] for own in segments if own in self._starts[way]]
        problem.starts = self._starts[way]
        return problem

    def held_out(self, parameters: ParameterSet, way: Discretization | None = None) -> Problem | None:
        """The motions of val, simulated as those of the fit; None without."""
        way = way or self.way
        if not self._logs.get("val"):
            return None
        nominal, _ = self._simulated(way)
        try:
            segments, _ = self._segments_of(nominal, "val")
        except DataError:
            return None
        coarse = self.held_out(parameters, replace(way, divisor=1)) if way.divisor > 1 else None
        problem = self._problem(nominal, parameters, segments, way, coarse)
        problem.starts = self._begun(problem)
        return problem

    def _begun(
        self, problem: Problem, near: Mapping[Segment, WindowStarts] | None = None
    ) -> Mapping[Segment, WindowStarts]:
        """Where the windows of a problem begin, with parameters of the present place."""
        z = problem.parameters.at(self._place).start
        try:
            with problem.ending(self._limit):
                return window_starts(problem, z, near, whole=self._config.data.window_s is None)
        except OutOfTime:
            return {}

    def _problem(
        self,
        nominal: Nominal,
        parameters: ParameterSet,
        segments: Sequence[Segment],
        way: Discretization,
        coarse: Problem | None,
    ) -> Problem:
        return Problem(
            nominal,
            parameters,
            segments,
            weights=self.weights,
            jobs=self._jobs,
            coarse=coarse,
            trapezoidal=way.trapezoidal,
        )

    def begin_at(self, values: Mapping[str, float], starts: Mapping[Segment, WindowStarts] | None = None) -> None:
        """Look again where windows begin, with these parameters; `starts` are known for the present way."""
        self._starts, self._place, self._first = {}, values, []
        if starts is not None:
            self._starts[self.way] = starts
            self._first = [starts[segment] for segment in self.segments if segment in starts]

    def _near(self, segments: Sequence[Segment]) -> dict[Segment, WindowStarts] | None:
        """Where these segments began in the first way; None if in none, or where windows are others."""
        if len(self._first) != len(segments):
            return None
        pairs = list(zip(segments, self._first, strict=True))
        alike = all(own.position.shape[0] == segment.plan.starts.size for segment, own in pairs)
        return dict(pairs) if alike else None

    def _simulated(self, way: Discretization) -> tuple[Nominal, list[Segment]]:
        """The model and the pieces of the logs for one way to simulate them."""
        if way not in self._cut:
            own, _ = self._cut[self._own]
            nominal = Nominal(way.of(own.given, self._timestep_s), own.path, hard_friction=way.rigid)
            self._cut[way] = nominal, self._segments_of(nominal, "train")[0]
        return self._cut[way]

    def _segments_of(self, nominal: Nominal, split: str) -> tuple[list[Segment], dict[str, TrueupError]]:
        rule = self._config.data.rule(nominal.robot, self._seed)
        return make_segments(self._logs[split], nominal.simulator, rule)
