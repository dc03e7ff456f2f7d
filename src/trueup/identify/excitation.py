"""What the logs cannot show, said before anything is fitted."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from trueup.core.episode import Episode
from trueup.core.parameters import ParameterSet
from trueup.errors import NotIdentifiable
from trueup.identify.quantities import quantity

# A joint that moves less than this shows stiction and sensor noise, nothing else.
_STILL = 2e-3
_SATURATED = 0.05


@dataclass(frozen=True)
class Excitation:
    """What the logs show of each joint.

    Attributes:
        stalled: joints that do not move although they are commanded.
        idle: joints that are never told to move, and do not.
        statements: the same in words, and what else is wrong with the logs.
    """

    stalled: tuple[str, ...]
    idle: tuple[str, ...]
    statements: tuple[str, ...]


def excitation_of(
    episodes: Iterable[Episode], joints: Sequence[str], signal: str, torque_limits: dict[str, float]
) -> Excitation:
    """Look at how much each joint is commanded and how much it moves.

    Args:
        episodes: that the fit will see, in the robot's joint names.
        joints: that enter the residual.
        signal: of the command that the robot follows.
        torque_limits: joint -> largest torque [Nm or N], where known.

    Raises:
        NotIdentifiable: no joint moves, or no command ever changes.
        NameMismatch: an episode lacks one of the joints.
        MissingSignal: an episode has no position, or no command of that signal.
    """
    moved, commanded = dict.fromkeys(joints, 0.0), dict.fromkeys(joints, 0.0)
    saturated = dict.fromkeys(joints, 0.0)
    seconds = 0.0
    for episode in episodes:
        seconds += episode.measured.duration_s
        positions = episode.measured.select(joints)["position"]
        commands = episode.commanded().select(joints)[signal]
        for joint, position, asked in zip(joints, positions.T, commands.T, strict=True):
            moved[joint] = max(moved[joint], _range(position))
            commanded[joint] = max(commanded[joint], _range(asked))
            limit = torque_limits.get(joint)
            if signal == "torque" and limit:
                share = float(np.mean(np.abs(asked) >= 0.999 * limit))
                saturated[joint] += share * episode.measured.duration_s
    still = [joint for joint in joints if moved[joint] < _STILL]
    stalled = tuple(joint for joint in still if commanded[joint] > 0)
    idle = tuple(joint for joint in still if commanded[joint] == 0)
    if len(still) == len(joints):
        raise NotIdentifiable(
            "no joint moves in these motions",
            got="a constant command" if not stalled else f"less than {_STILL:g} rad everywhere",
            hint="Record motions in which every joint that matters moves and reverses.",
        )
    statements = [
        *(
            f"{joint} does not move although it is commanded: is it stalled? Nothing is fitted for it"
            for joint in stalled
        ),
        *(f"{joint} is never moved: nothing is fitted for it" for joint in idle),
        *(
            f"{joint} is commanded beyond its torque limit {100 * share / seconds:.0f} % of the time: the log does "
            "not show what torque the drive really applied"
            for joint, share in saturated.items()
            if share > _SATURATED * seconds
        ),
    ]
    return Excitation(stalled, idle, tuple(statements))


def freeze_still(parameters: ParameterSet, excitation: Excitation) -> ParameterSet:
    """The same parameters, those of joints that do not move kept at their value."""
    still = {*excitation.stalled, *excitation.idle}
    return parameters.freeze(
        parameter.name
        for parameter in parameters
        if quantity(parameter.quantity).of == "joint" and parameter.target in still
    )


def _range(values: np.ndarray) -> float:
    finite = values[np.isfinite(values)]
    return float(np.ptp(finite)) if finite.size else 0.0
