"""Static friction from torque ramps: the table of thresholds of ES thesis 3.1.2 (Table 3.2), with intervals."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Float64
from scipy.special import stdtrit

from trueup.core.episode import Episode
from trueup.core.results import Estimate
from trueup.errors import DataError, NotIdentifiable, TrueupError
from trueup.identify.experiments.attempts import Attempt, read_attempts
from trueup.identify.experiments.findings import ExperimentResult, Finding, Rejection, reasons_in_short, said
from trueup.identify.experiments.joint_log import (
    Delay,
    delay_to_json,
    disturbances,
    excited_joints,
    joint_log,
    reason_of,
)
from trueup.identify.experiments.onset import STILL_SPEED

_DOUBT = 0.25  # share of the correction that stays in doubt: the law of the onset is not known exactly


def estimate_breakaway(
    episodes: Iterable[Episode],
    *,
    joints: Sequence[str] | None = None,
    delay_s: Delay = 0.0,
    still_speed: float = STILL_SPEED,
) -> ExperimentResult:
    """The torques that set standing joints in motion, from recorded ramps.

    An episode may hold one ramp or several, of one joint or, in turn, of many; before each ramp the commanded torque
    must be zero for a while. Between breaking away and being seen the torque has grown by slope times time; this is
    corrected by fitting the onset (see `onset`), and a quarter of the correction is kept in the interval, next to
    Student's interval of the repetitions and half the step of the torque from one command to the next.

    Quantities per joint: `positive` and `negative` (the thresholds, the second usually below zero),
    `static_friction` (half of their distance, free of any torque offset), `midpoint` (their mean: the torque to add
    to commands so that both directions break away alike; it is the offset of the gravity compensation, with its sign
    reversed, if static friction is the same in both directions).

    Args:
        episodes: command with `torque`, measured with `position` or `velocity`.
        joints: which joints; None finds them (see `excited_joints`).
        delay_s: the command acts this much later [s], one number or joint -> its own; a delay that is left out makes
            thresholds too large by slope times delay.
        still_speed: speed below which a joint stands [rad/s].

    Raises:
        DataError: no episodes.
        MissingSignal: no episode has a torque command.
        NotIdentifiable: no ramp at all that could be used; the message says why.
    """
    episodes = tuple(episodes)
    if not episodes:
        raise DataError("there are no episodes to evaluate")
    attempts: dict[str, list[Attempt]] = {}
    rejected: list[Rejection] = []
    efforts: dict[str, str] = {}
    for episode in episodes:
        for joint in excited_joints(episode, joints):
            own = attempts.setdefault(joint, [])
            try:
                log = joint_log(episode, joint, delay_s=delay_s)
            except TrueupError as error:
                rejected.append(Rejection(episode.id, joint, reason_of(str(error), episode)))
                continue
            efforts[joint] = log.effort
            found, reasons = read_attempts(log, still_speed)
            own += found
            rejected += [Rejection(episode.id, joint, reason_of(reason, episode)) for reason in reasons]
    if not any(attempts.values()):
        raise NotIdentifiable("no torque ramp could be used", got=reasons_in_short(rejected))
    return ExperimentResult(
        experiment="breakaway",
        joints={joint: _findings(items, efforts.get(joint, "Nm")) for joint, items in attempts.items()},
        notes={joint: _notes(episodes, joint, items) for joint, items in attempts.items()},
        runs=tuple(item.to_json(efforts[joint]) for joint, items in attempts.items() for item in items),
        rejected=tuple(rejected),
        settings={"delay_s": delay_to_json(delay_s), "still_speed": still_speed},
    )


def _findings(attempts: Sequence[Attempt], effort: str) -> dict[str, Finding]:
    positive = _threshold([item for item in attempts if item.sign > 0], 1, effort)
    negative = _threshold([item for item in attempts if item.sign < 0], -1, effort)
    static = _combined(positive.estimate, negative.estimate, -1.0)
    middle = _combined(positive.estimate, negative.estimate, 1.0)
    findings = {"positive": positive, "negative": negative}
    sentences = {
        "static_friction": f"Static friction, the mean of both directions, is {said(static)}.",
        "midpoint": f"Adding {said(middle)} to commands makes both directions break away alike: if static friction is "
        "the same in both, a torque of this size and opposite sign acts on the joint besides the command.",
    }
    for (name, sentence), estimate in zip(sentences.items(), (static, middle), strict=True):
        bad = next((item for item in (positive, negative) if item.status != "ok"), None)
        known = not math.isnan(estimate.value)
        lacking = f"The {name.replace('_', ' ')} needs the thresholds of both directions."
        findings[name] = Finding(estimate, sentence if known else lacking, bad.status if bad else "ok")
    return findings


def _combined(positive: Estimate, negative: Estimate, factor: float) -> Estimate:
    """Half of positive + factor * negative."""
    value = 0.5 * (positive.value + factor * negative.value)
    halves = [_half(positive), _half(negative)]
    if math.isnan(value) or math.isnan(sum(halves)):
        return Estimate(value, positive.unit)
    half = 0.5 * math.hypot(*halves)
    return Estimate(value, positive.unit, value - half, value + half)


def _half(estimate: Estimate) -> float:
    return math.nan if estimate.low is None or estimate.high is None else 0.5 * (estimate.high - estimate.low)


def _threshold(attempts: Sequence[Attempt], sign: int, effort: str) -> Finding:
    """The threshold of one direction."""
    direction = "positive" if sign > 0 else "negative"
    moved = [item for item in attempts if item.outcome == "moved"]
    stuck = [item for item in attempts if item.outcome == "no_motion"]
    if not moved:
        if any(item.outcome == "moves_without_torque" for item in attempts):
            sentence = "The joint moves without torque, so that no threshold exists here: gravity exceeds friction."
            return Finding(Estimate(math.nan, effort), sentence, "moves_without_torque")
        if stuck:
            most = sign * max(item.largest for item in stuck)
            ends = {"low" if sign > 0 else "high": most}
            sentence = f"No motion up to {most:.3g} {effort} in {len(stuck)} {direction} ramps."
            return Finding(Estimate(math.nan, effort, **ends), sentence, "no_motion")
        return Finding(Estimate(math.nan, effort), f"There is no usable {direction} ramp.", "not_identifiable")
    values = sign * np.array([item.threshold for item in moved])
    value = float(values.mean())
    correction = float(np.mean([item.correction for item in moved]))
    half = _interval(values, resolution=0.5 * max(item.tick for item in moved) + _DOUBT * max(correction, 0.0))
    estimate = Estimate(value, effort, *((None, None) if half is None else (value - half, value + half)))
    seen = float(np.mean([item.seen_after_s for item in moved]))
    sentence = (
        f"Starts to move in {direction} direction at {said(estimate)}, {len(moved)} ramps; the {correction:.2g} "
        f"{effort} that the ramp gained in the {seen:.2g} s until the motion was seen are taken off."
    )
    if stuck:
        sentence += f" {len(stuck)} more ramps ended without motion, so that the mean is too small."
        return Finding(estimate, sentence, "censored")
    return Finding(estimate, sentence)


def _interval(values: Float64[np.ndarray, "N"], *, resolution: float) -> float | None:
    """Half the 95 % interval of the mean of repetitions, with a resolution that repeating does not improve."""
    if values.size < 2:
        return None
    spread = float(stdtrit(values.size - 1, 0.975)) * float(values.std(ddof=1)) / math.sqrt(values.size)
    return math.hypot(spread, resolution)


def _notes(episodes: Sequence[Episode], joint: str, attempts: Sequence[Attempt]) -> tuple[str, ...]:
    ids = {item.episode for item in attempts}
    notes = disturbances([episode for episode in episodes if episode.id in ids], joint)
    sliding = [item for item in attempts if item.outcome == "moves_without_torque"]
    if sliding and len(sliding) < len(attempts):
        notes.append(f"{len(sliding)} of {len(attempts)} ramps began while the joint was moving and are left out")
    return tuple(notes)
