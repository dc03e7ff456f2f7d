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
_PARTS: dict[StepName, float] = {"explain": 0.15, "identify": 0.5, "augment": 0.3}
_REST = 0.05
# Derivatives that all searches of a fit together take, counted by what a replay of the motion takes; by how many
# parameters of a joint; and motion below which they are worth nothing [s].
_DERIVATIVES, _PARAMETERS_OF_JOINT, _LEAST_MOTION_S = 20, 7, 20.0


class Budget:
    """Time for a call, and who has which part of it.

    Args:
        seconds: for all steps together; None without a limit.
        steps: those that are to come and take as long as they are let.
    """

    def __init__(self, seconds: float | None, steps: Sequence[StepName]) -> None:
        self._limit = None if seconds is None else TimeLimit.after(seconds)
        self._steps = [step for step in steps if step in _PARTS]

    def of(self, step: StepName) -> TimeLimit | None:
        """The end of a step: its part of what is left, for those after it have theirs."""
        if self._limit is None:
            return None
        whole = sum(_PARTS[item] for item in self._steps) + _REST
        self._steps.remove(step)
        return self._limit.share(_PARTS[step] / whole)


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
