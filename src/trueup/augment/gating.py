"""Which outputs may correct: those that help on val, in every kind of motion that val has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64, Int

from trueup.augment.config import FEWEST_FOR_CHANCE
from trueup.augment.corrector import Corrector
from trueup.augment.pairs import Pairs
from trueup.augment.training import predictions
from trueup.measure import by_motion, motion_numbers


@dataclass(frozen=True, eq=False)
class Errors:
    """Sums of squared errors, episode by episode: those of joints that share a network are in one sum.

    Attributes:
        rows: samples of each episode, (E,).
        simulated: of the simulator, (E, K).
        corrected: of the corrected signals, (E, K).
        conditions: condition of each episode, (E,).
        executed: what each episode executed, (E,), the same for repetitions of a motion; empty if there are none.
    """

    rows: Float64[np.ndarray, "E"]
    simulated: Float64[np.ndarray, "E K"]
    corrected: Float64[np.ndarray, "E K"]
    conditions: tuple[str, ...]
    executed: tuple[str, ...] = ()

    @property
    def motions(self) -> Int[np.ndarray, "E"]:
        """The number of the motion that each episode executed, (E,)."""
        return motion_numbers(self.executed) if self.executed else np.arange(len(self.rows))

    def merged(self, groups: Sequence[int]) -> Errors:
        """The outputs of a group as one: the components of a vector are used together or not at all.

        Args:
            groups: for each output the number of its group, (K,).
        """
        table = np.zeros((len(groups), max(groups) + 1))
        table[np.arange(len(groups)), groups] = 1.0
        return replace(self, simulated=self.simulated @ table, corrected=self.corrected @ table)

    def rmse(self, which: Float64[np.ndarray, "E K"]) -> Float64[np.ndarray, "K"]:
        """Over all samples, (K,)."""
        found: np.ndarray = np.sqrt(which.sum(axis=0) / self.rows.sum())
        return found


def errors_of(corrector: Corrector, pairs: Pairs) -> Errors:
    """Errors on a split, with the gate as it is."""
    conditions = {motion.episode: motion.condition for motion in pairs.motions}
    executed = {motion.episode: motion.executed or motion.id for motion in pairs.motions}
    rows, sums = np.zeros(len(conditions)), np.zeros((2, len(conditions), len(pairs.outputs)))
    for number, *both, measured in predictions(corrector, pairs):
        place = pairs.motions[number].episode
        rows[place] += len(measured)
        for which, values in enumerate(both):
            sums[which, place] += ((measured.astype(float) - values) ** 2).sum(axis=0)
    return Errors(rows, sums[0], sums[1], tuple(conditions.values()), tuple(executed.values()))


def gates_of(
    errors: Errors, trained: Sequence[bool] | None = None, *, draws: int = 1000, seed: int = 0
) -> tuple[Bool[np.ndarray, "K"], tuple[str, ...]]:
    """Which outputs are used, and for the others why not.

    An output is used if its squared error on val is below the simulator's: over all motions, with the upper end of
    the 95 % bootstrap interval over motions where there are ten or more; and within each condition. With fewer motions,
    half of the outputs that are worth nothing pass. Repetitions of a motion are drawn together.

    Args:
        errors: on val.
        trained: whether the loss counted an output, (K,); all of them if None.
        draws: of the bootstrap.
        seed: of the draws.

    Returns:
        used, (K,); reason, empty for those that are used.
    """
    difference = errors.corrected - errors.simulated
    rng = np.random.default_rng(seed)
    many = len(errors.rows) >= FEWEST_FOR_CHANCE
    if many:
        apart = by_motion(difference, errors.motions)
        count = len(apart)
        picks = rng.multinomial(count, np.full(count, 1 / count), size=draws)
        upper = np.quantile(picks @ apart, 0.975, axis=0)
    else:
        upper = difference.sum(axis=0)
    used, reasons = [], []
    names = sorted(set(errors.conditions))
    kinds = np.array(errors.conditions)
    for output in range(difference.shape[1]):
        reason = ""
        if trained is not None and not trained[output]:
            reason = "its weight in the loss is 0"
        elif not np.isfinite(difference[:, output]).all():
            reason = "its error on val is not finite"
        elif errors.simulated[:, output].sum() == 0:
            reason = "the simulator is exact on val"
        elif difference[:, output].sum() >= 0:
            worse = 100 * (np.sqrt(errors.corrected[:, output].sum() / errors.simulated[:, output].sum()) - 1)
            reason = f"error on val larger than the simulator's, by {f'{worse:.0f}' if worse >= 1 else 'less than 1'} %"
        elif upper[output] >= 0:
            reason = "no better than the simulator on val beyond chance"
        else:
            worse_in = [name for name in names if difference[kinds == name, output].sum() > 0]
            if worse_in:
                reason = f"error on val larger than the simulator's in {', '.join(worse_in)} motions"
        used.append(not reason)
        reasons.append(reason)
    return np.array(used), tuple(reasons)
