"""How the time of a close is divided among its steps, and how much is fitted in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from trueup.core.close_result import StepName
from trueup.core.time_limit import TimeLimit
from trueup.dataset import Dataset
from trueup.robots import RobotSpec

if TYPE_CHECKING:
    from trueup.identify import IdentifyConfig

# Parts of what is left once the simulator as it came is measured; the rest is for the last measurement.
_PARTS: dict[StepName, float] = {"explain": 0.05, "identify": 0.55, "augment": 0.35}
_REST = 0.05
# What a fit does after its searches, counted by replays of all motions (one, and held-out motions of two models) and by
# measurements of one run.
_REPLAYS_OF_FIT, _MEASUREMENTS_OF_FIT = 1.5, 1.5
# Runs of a close with networks, which are measured at its end.
_RUNS_OF_AUGMENT = 4.0
# A step that is built on has at least the first share of the whole, if what cannot be cut does not exceed the whole by
# more than the second: a close that leaves out what was asked for so as to end early is of no use.
_LEAST_PART, _EXCESS = 0.1, 0.05
# Derivatives that all searches of a fit together take, counted by what a replay of the motion takes; by how many
# parameters of a joint; and motion below which they are worth nothing [s].
_DERIVATIVES, _PARAMETERS_OF_JOINT, _LEAST_MOTION_S = 20, 7, 20.0


class Budget:
    """Time for a call, and who has which part of it.

    What cannot be cut comes first: the first replay and the first measurement tell how long it takes. Each step has its
    part of what that leaves. `explain` is done last, in what the others have left.

    Args:
        seconds: for all steps together; None without a limit.
        steps: those that are to come and take as long as they are let.
    """

    def __init__(self, seconds: float | None, steps: Sequence[StepName]) -> None:
        self._limit = None if seconds is None else TimeLimit.after(seconds)
        self._steps = [step for step in steps if step in _PARTS]
        self._replay_s = self._measure_s = 0.0

    def took(self, *, replay_s: float = 0.0, measure_s: float = 0.0) -> None:
        """Note what a replay of all motions and a measurement of one run took [s]."""
        self._replay_s, self._measure_s = max(self._replay_s, replay_s), max(self._measure_s, measure_s)

    def of(self, step: StepName) -> TimeLimit | None:
        """The end of what a step searches or trains: its part of what is left for such things."""
        if self._limit is None:
            return None
        left_s = self._limit.ends_at - TimeLimit.after(0.0).began_at - self._fixed_s
        whole = sum(_PARTS[item] for item in self._steps) + _REST
        self._steps.remove(step)
        part_s, whole_s = left_s * _PARTS[step] / whole, self._limit.ends_at - self._limit.began_at
        if step != "explain" and left_s > -_EXCESS * whole_s:
            part_s = max(part_s, _LEAST_PART * whole_s)
        return TimeLimit.after(max(0.0, part_s))

    @property
    def _fixed_s(self) -> float:
        """What will be done in any case, after the searches and trainings of the steps that are still to come [s]."""
        seconds = 0.0
        if "identify" in self._steps:
            seconds += _REPLAYS_OF_FIT * self._replay_s + _MEASUREMENTS_OF_FIT * self._measure_s
        if "augment" in self._steps:
            seconds += _RUNS_OF_AUGMENT * self._measure_s
        return seconds


def fitted_motion(
    config: IdentifyConfig, robot: RobotSpec, dataset: Dataset, replay_s: float, limit: TimeLimit | None
) -> IdentifyConfig:
    """The configuration, with as much motion to fit as the time allows.

    Args:
        config: what was asked for.
        robot: whose joints have parameters.
        dataset: whose motions were replayed.
        replay_s: how long that took [s].
        limit: for the fit; None leaves the configuration as it is.
    """
    if limit is None or replay_s <= 0:
        return config
    moved_s = float(sum(dataset.index.column("duration_s").to_pylist()))
    candidates = _DERIVATIVES * _PARAMETERS_OF_JOINT * len(robot.scored_joints)
    motion_s = limit.left_s / candidates * moved_s / replay_s
    # Whole tens: a limit of the same length asks for the same fit.
    motion_s = max(_LEAST_MOTION_S, 10.0 * round(motion_s / 10.0))
    return replace(config, data=replace(config.data, budget_s=min(motion_s, config.data.budget_s)))
