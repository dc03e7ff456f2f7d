"""The parts of the logs that a fit looks at."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Int

from trueup.core.episode import Episode
from trueup.core.hold import held_rows
from trueup.core.quality import dropped, refuse_majority
from trueup.errors import DataError, TrueupError
from trueup.robots import AS_DESCRIBED, CommandTiming, Setup, setup_of
from trueup.sim import MujocoSimulator, ReplayPlan, ReplaySettings


@dataclass(frozen=True)
class SegmentRule:
    """How logs are cut for a fit.

    Attributes:
        window_s: restart from the measured state this often [s] (multiple shooting); None simulates each piece as a
            whole. Torque-driven logs need windows: whole rollouts of open-loop torque have no usable gradient.
        cut_s: take a piece of this length from each motion [s], None takes whole motions.
        budget_s: simulate at most about this much motion per evaluation [s]; motions beyond it give shorter pieces.
        burn_in_s: leave the first seconds of a piece that begins in the middle of a motion out of the residual,
            since nobody knows in which state its friction was.
        seed: where in the motions the pieces lie.
        settle_s: hold the first command for this long before a whole motion [s].
        base_sensor: see `ReplaySettings`.
        command: see `ReplaySettings`.
    """

    window_s: float | None = None
    cut_s: float | None = None
    budget_s: float = 400.0
    burn_in_s: float = 1.0
    seed: int = 0
    settle_s: float = 0.0
    base_sensor: str = ""
    command: CommandTiming = "held"


@dataclass(frozen=True, eq=False)
class Segment:
    """One piece of a log.

    Attributes:
        episode_id: where it comes from.
        plan: prepared for simulation.
        counts: stamps that enter the residual: after the burn-in, with a position of every joint, (T,).
        setup: what the simulated robot carries, and how its gains are set.
    """

    episode_id: str
    plan: ReplayPlan
    counts: Bool[np.ndarray, "T"]
    setup: Setup = AS_DESCRIBED

    @property
    def seconds(self) -> float:
        """How much motion is simulated [s]."""
        return self.plan.measured.duration_s

    def rows(self, signal: str, columns: Int[np.ndarray, "K"]) -> Bool[np.ndarray, "T"]:
        """The stamps that count at which these joints have a value of a signal."""
        values = self.plan.measured[signal][:, columns]
        return np.asarray(self.counts & np.isfinite(values).all(axis=1))


def make_segments(
    episodes: Iterable[Episode], simulator: MujocoSimulator, rule: SegmentRule
) -> tuple[list[Segment], dict[str, TrueupError]]:
    """Cut logs into segments.

    Args:
        episodes: in the robot's joint names and SI units.
        simulator: of the nominal model.
        rule: how to cut.

    Returns:
        The segments, and the reason for each episode that gave none.

    Raises:
        DataError: not a single episode can be used.
    """
    logs = list(episodes)
    durations = [log.measured.duration_s for log in logs]
    cut_s = _cut_length(durations, rule)
    segments: list[Segment] = []
    refused: dict[str, TrueupError] = {}
    rng = np.random.default_rng(rule.seed)
    for log, duration_s in zip(logs, durations, strict=True):
        # Drawn for every log, so that a log more or less does not move the pieces of the others.
        place = float(rng.uniform())
        whole = cut_s is None or duration_s <= 1.2 * cut_s
        try:
            if whole or cut_s is None:
                piece, burn_in_s = log, 0.0
            else:
                piece = _cut(log, place * (duration_s - cut_s), cut_s)
                burn_in_s = 0.0 if rule.window_s else min(rule.burn_in_s, cut_s / 4)
            settings = ReplaySettings(
                rule.window_s,
                "measured" if rule.window_s or not whole else None,
                settle_s=rule.settle_s if whole else 0.0,
                base_sensor=rule.base_sensor,
                command=rule.command,
            )
            plan = ReplayPlan(piece, simulator, settings)
        except TrueupError as error:
            refused[log.id] = error
            continue
        stamps = plan.measured.time_s
        counts = stamps - stamps[0] >= burn_in_s
        counts &= np.all(np.isfinite(plan.measured["position"]), axis=1)
        if np.count_nonzero(counts) > 1:
            segments.append(Segment(log.id, plan, counts, setup_of(simulator.robot, log.meta)))
        else:
            refused[log.id] = DataError(f"episode {log.id!r} has too few samples to compare with")
    if not segments:
        first = next(iter(refused.values()), "there are no episodes")
        raise DataError("there is nothing to fit", got=first, expected="at least one motion with commands")
    return segments, refused


def usable(
    episodes: Mapping[str, Sequence[Episode]], *, drop_flagged: bool | None
) -> tuple[dict[str, list[Episode]], dict[str, dict[str, str]]]:
    """The motions that are used, and why the others are left out.

    Args:
        episodes: split -> motions.
        drop_flagged: as of `EpisodeMeta.why_dropped`; None leaves out those whose measurement is broken.

    Returns:
        Split -> motions, and split -> motion -> why; without splits of none.

    Raises:
        DataError: the measurement of more than half of the train motions is broken, and nobody said what to do.
    """
    reasons = {
        split: dropped((log.meta for log in logs), drop_flagged=drop_flagged) for split, logs in episodes.items()
    }
    if drop_flagged is None:
        keep = "`data: {keep_flagged: true}` in --config"
        refuse_majority(reasons.get("train", {}), len(episodes.get("train", ())), keep=keep)
    kept = {split: [log for log in logs if log.id not in reasons[split]] for split, logs in episodes.items()}
    return {split: own for split, own in kept.items() if own}, {split: why for split, why in reasons.items() if why}


def _cut_length(durations: Sequence[float], rule: SegmentRule) -> float | None:
    """One length for all pieces, so that every motion counts and the budget holds."""
    total = sum(durations)
    if total <= rule.budget_s:
        return rule.cut_s
    low, high = 0.0, max(durations)
    for _ in range(60):
        middle = 0.5 * (low + high)
        taken = sum(min(duration, middle) for duration in durations)
        low, high = (middle, high) if taken < rule.budget_s else (low, middle)
    return low if rule.cut_s is None else min(low, rule.cut_s)


def _cut(log: Episode, start_s: float, length_s: float) -> Episode:
    """The piece of a log that begins `start_s` after its first measured stamp; commands from before stay."""
    first = log.measured.time_s[0] + start_s
    stamps = log.measured.time_s
    rows = slice(int(np.searchsorted(stamps, first)), int(np.searchsorted(stamps, first + length_s, side="right")))
    measured = log.measured.rows(rows)
    command = log.commanded()
    # A delayed command from before the piece still acts in it.
    earliest = max(0, int(held_rows(command.time_s, np.array([measured.time_s[0] - 1.0]))[0]))
    # The next one, too: the command may move on to it, or its stamps be late.
    latest = int(held_rows(command.time_s, np.array([measured.time_s[-1]]))[0]) + 2
    return replace(log, measured=measured, command=command.rows(slice(earliest, max(latest, earliest + 1))))
