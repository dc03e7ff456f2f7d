"""Which changes of the reading the motions ask for, one after the other, and how sure each is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueup.check.changes import LOST, Looked, Proposal, proposals
from trueup.check.evidence import Evidence, Score, loss
from trueup.check.reading import Reading
from trueup.core.check_result import CheckSeverity

# A change is told if what is left falls to the first share, of the joints that it is about; below the second it may be
# certain.
_TOLD, _CERTAIN = 1.0 / 3.0, 1.0 / 6.0
# What a certain change leaves of the motion of a servo, or of the torque of a motor, at most.
_FOLLOWED, _MOVED = 0.05, 0.15
# Of what the model could explain it has to explain this much, where it explained no more than that before, or
# left four times as much.
_EXPLAINED, _UNEXPLAINED, _MUCH_LESS = 0.75, 0.4, 0.25
# What a motor's torque may leave where positions were far out of range.
_SENSIBLE = 0.5
# Where a joint was explained not at all and leaves so many times less now, more may be left: of a servo, of a motor.
_NOTHING, _BY_FAR, _NEARLY, _MOSTLY = 0.7, 8.0, 0.12, 0.3
# A joint is out of its range for more than the first share of the time, and in it where it is out for less than the
# second.
OUTSIDE, INSIDE = 0.2, 0.02
# Another explanation that is nearly as good, in the logarithm of what is left.
_RIVAL = 0.7
# What is left without the model, where that is no reason to believe it.
_AS_GOOD = 2.0
_AGREE = 0.8
_ROUNDS = 6
_LAGS = np.arange(0.0, 0.21, 0.02)
_SAME_LOSS = 0.3
# Steps by which a factor is looked for.
_NEARER = (0.06, 0.03, 0.012, 0.005, 0.002)
# First digits of round factors, as gears and scales of actions have, and how near a factor may be to such a one.
_ROUND, _NEARLY_ROUND = (1.0, 1.25, 5 / 3, 2.0, 2.5, 3.0, 10 / 3, 4.0, 5.0, 6.0, 8.0, 10.0), 0.012
# Clocks that differ by less are nothing to stop for [s].
_LATE_S = 0.1
# Proposals that are looked at closely, after a first look at all of them.
_CLOSELY = 14
_LEAST = 1e-6


@dataclass(frozen=True, eq=False)
class Accepted:
    """A change that the motions ask for.

    Attributes:
        proposal: what it is.
        severity: how sure.
        before: score of the reading without it.
        after: score with it.
        others: the same change of another series that explains as much; and other changes that do.
        joints: those that it makes better.
        far: whether these were far out of their range before.
    """

    proposal: Proposal
    severity: CheckSeverity
    before: Score
    after: Score
    others: tuple[Proposal, ...]
    joints: tuple[int, ...]
    far: bool


def nominal(evidence: Evidence) -> Reading:
    """The logs as robot.yaml has them read, at a usual lag."""
    return _usual_lag(evidence, Reading.as_it_is(evidence.joints))


def accepted(evidence: Evidence, reading: Reading, lengths: Sequence[str]) -> tuple[list[Accepted], Reading]:
    """The changes, and how the logs are read with all that are certain."""
    found: list[Accepted] = []
    sure = reading
    for _ in range(_ROUNDS):
        score = evidence.score(reading)
        best = _best(Looked(evidence, reading, score, tuple(lengths)))
        if best is None:
            break
        found.append(best)
        if best.severity != "certain" and not best.far:
            break
        reading = best.proposal.reading
        if best.proposal.kind not in ("delay", "control-mode"):
            reading = _usual_lag(evidence, reading)
    # What brought joints back into their range is certain once the rest is right, too.
    last = evidence.score(reading)
    for place, one in enumerate(found):
        if one.far and one.severity == "likely" and _sensible(evidence, one.proposal, last, np.array(one.joints)):
            found[place] = replace(one, severity="certain")
    if all(one.severity == "certain" for one in found):
        return found, reading
    doubtful = next(place for place, one in enumerate(found) if one.severity != "certain")
    found = found[: doubtful + 1]
    return found, found[doubtful - 1].proposal.reading if doubtful else sure


def _sensible(evidence: Evidence, proposal: Proposal, score: Score, own: np.ndarray) -> bool:
    """Whether joints that are back in their range also do about what they are told."""
    servo = evidence.followed(proposal.reading) != "torque"
    if not evidence.sure and not servo:
        return True
    return bool(score.left[own].max() < (LOST if servo else _SENSIBLE))


def _usual_lag(evidence: Evidence, reading: Reading) -> Reading:
    """The smallest lag with which a reading explains about as much as with any."""
    if not 0.0 <= reading.lag_s <= _LAGS[-1]:
        return reading
    readings = [replace(reading, lag_s=float(lag)) for lag in _LAGS]
    scores = [evidence.score(one) for one in readings]
    losses = [float(loss(score, scores[0]).sum()) for score in scores]
    return next(one for one, own in zip(readings, losses, strict=True) if own < min(losses) + _SAME_LOSS)


def _at_lag(evidence: Evidence, proposal: Proposal) -> Proposal:
    """The proposal with the lag, and the factor if that is free, that explain most."""
    for width in _NEARER if proposal.again is not None else ():
        again = proposal.again
        assert again is not None
        tried = [again(1.0 + step * width) for step in (-2, -1, 0, 1, 2)]
        proposal = min(tried, key=lambda one: float(np.nansum(np.log(evidence.score(one.reading).left))))
    proposal = _with_round_factor(proposal)
    return replace(proposal, reading=_usual_lag(evidence, proposal.reading))


def _with_round_factor(proposal: Proposal) -> Proposal:
    """The same with the round factor that it is nearly: the one that explains most also makes up for wrong gains."""
    if proposal.again is None:
        return proposal
    digits = abs(proposal.value) / 10.0 ** math.floor(math.log10(abs(proposal.value)))
    much = min(_ROUND, key=lambda one: abs(one / digits - 1.0)) / digits
    if abs(much - 1.0) > _NEARLY_ROUND:
        return proposal
    return proposal.again(1.0 / much if proposal.side == "measured" else much)


def _best(looked: Looked) -> Accepted | None:
    before = looked.score
    if not looked.moved:
        return None
    coarse = looked.evidence.coarse
    first = sorted(
        proposals(looked), key=lambda one: float(loss(coarse.score(one.reading), looked.rough).sum()) + one.freedom
    )
    base = loss(before, before)
    ranked: list[tuple[float, Proposal, Score]] = []
    for proposal in first[:_CLOSELY]:
        own = proposal if proposal.kind == "delay" else _at_lag(looked.evidence, proposal)
        after = looked.evidence.score(own.reading)
        ranked.append((float((base - loss(after, before)).sum()) - own.freedom, own, after))
    ranked.sort(key=lambda item: -item[0])
    for place, (gain, proposal, after) in enumerate(ranked):
        better = _better(looked, proposal, after)
        if gain < -np.log(_TOLD) or not better:
            continue
        near = [other for own, other, _ in ranked[place + 1 :] if gain - own < _RIVAL]
        same = _different(proposal, [other for other in near if other.alike == proposal.alike])
        rivals = [other for other in near if other.alike != proposal.alike]
        severity = _severity(looked, proposal, after, better)
        if severity is None:
            continue
        # Of changes of one kind that are as good (which joint of two is mirrored?) one is needed.
        if severity == "certain" and any(other.kind != proposal.kind for other in rivals):
            severity = "likely"
        ordered = _permuted(before, proposal.order)
        far = proposal.kind == "unit" and _far_outside(ordered, after, np.array(better))
        return Accepted(proposal, severity, ordered, after, (*same, *rivals[:2]), better, far)
    return None


def _different(proposal: Proposal, others: Sequence[Proposal]) -> list[Proposal]:
    """The same change of another series, or another unit; not the same one with another number."""
    seen, found = {(proposal.side, tuple(proposal.units.values()))}, []
    for other in others:
        key = (other.side, tuple(other.units.values()))
        if key not in seen:
            seen.add(key)
            found.append(other)
    return found[:2]


def _permuted(score: Score, order: dict[int, int]) -> Score:
    """The score with joints in each other's places, as a swap of both series has them."""
    if not order:
        return score
    columns = np.arange(score.left.size)
    for joint, source in order.items():
        columns[joint] = source
    return replace(
        score,
        left=score.left[columns],
        blind=score.blind[columns],
        chunks=score.chunks[:, columns],
        outside=score.outside[columns],
        beyond=score.beyond[columns],
    )


def _better(looked: Looked, proposal: Proposal, after: Score) -> tuple[int, ...]:
    """The joints of a proposal that are explained better by it, or in their range for the first time."""
    before = _permuted(looked.score, proposal.order)
    found = []
    for joint in proposal.joints or looked.moved:
        if np.isnan(before.left[joint]) or np.isnan(after.left[joint]):
            continue
        ratio = (after.left[joint] + _LEAST) / (before.left[joint] + _LEAST)
        back = before.outside[joint] > OUTSIDE and after.outside[joint] < INSIDE
        if ratio < _TOLD or (back and ratio < 1.5):
            found.append(joint)
    # What a joint's position is counts for those before it, too. Which way one counts that stands still is not seen.
    seen = proposal.kind != "sign" or not set(proposal.joints).isdisjoint(looked.moved)
    if not found and proposal.joints and proposal.side != "command" and seen:
        return tuple(
            joint for joint in looked.moved if (after.left[joint] + _LEAST) / (before.left[joint] + _LEAST) < _TOLD
        )
    return tuple(found)


def _severity(looked: Looked, proposal: Proposal, after: Score, better: tuple[int, ...]) -> CheckSeverity | None:
    before, evidence = _permuted(looked.score, proposal.order), looked.evidence
    own = np.array(better)
    left, was = after.left[own], before.left[own]
    share, had = _share(after)[own], _share(before)[own]
    servo = evidence.followed(proposal.reading) != "torque"
    if proposal.kind == "unit" and _far_outside(before, after, own):
        return "certain" if _sensible(evidence, proposal, after, own) else "likely"
    itself = looked.unmodelled[[proposal.order.get(joint, joint) for joint in better]] if servo else np.inf
    inside = (before.outside[own] <= OUTSIDE) | (after.outside[own] >= INSIDE)
    if np.all((was < LOST) & (itself < _AS_GOOD * left) & inside):
        return None  # they follow as good servos do, with or without a model
    plain = bool(np.any((was > _NOTHING) & (left * _BY_FAR < was)))
    if plain and left.max() < (_NEARLY if servo else _MOSTLY):
        strong = True  # it explained nothing, and explains nearly all now
    elif servo and was.max() > LOST and left[was > LOST].max() < _FOLLOWED:
        strong = bool(np.all(left[was > LOST] < _CERTAIN * was[was > LOST]))
    elif not servo and left.max() < _MOVED:
        strong = bool(np.max(was / (left + _LEAST)) > 1.0 / _CERTAIN) and share.max() > _EXPLAINED
    elif servo and evidence.sure and share.max() > _EXPLAINED:
        joint = int(np.argmax(share))
        strong = bool(had[joint] < _UNEXPLAINED or left[joint] < _MUCH_LESS * was[joint])
        # What other joints do may have many reasons, such as a base that moves.
        strong = strong and (not proposal.joints or bool(np.isin(own, proposal.joints).any()))
    elif left.max() < 0.3 or (evidence.sure and share.max() > 0.5):
        strong = False
    else:
        return None
    if (proposal.kind == "gravity-compensation" and servo) or (
        proposal.kind == "delay" and abs(proposal.value) < _LATE_S
    ):
        strong = False
    if strong and _agree(before, after, own):
        return "certain"
    # Friction and damping make many a torque look like a velocity.
    return None if proposal.kind == "control-mode" else "likely"


def _share(score: Score) -> np.ndarray:
    """What the model explains of what it could."""
    return np.asarray(1.0 - score.left / np.maximum(score.blind, 1e-12))


def _far_outside(before: Score, after: Score, own: np.ndarray) -> bool:
    """Whether joints were so far out of their range that no calibration explains it, and are in it now."""
    return bool(
        np.all(after.outside[own] < INSIDE) and np.all(before.outside[own] > 0.5) and before.beyond[own].min() > 6.3
    )


def _agree(before: Score, after: Score, own: np.ndarray) -> bool:
    """Whether all groups of motions ask for it, of the joints that it makes much better."""
    strong = own[(after.left[own] + _LEAST) < 0.5 * (before.left[own] + _LEAST)]
    was, now = before.chunks[:, strong], after.chunks[:, strong]
    known = np.isfinite(was) & np.isfinite(now) & (was > 0.05 * before.left[strong])
    if not known.any():
        return False
    ratio = (now[known] + _LEAST) / (was[known] + _LEAST)
    return bool(np.mean(ratio < 0.6) >= _AGREE and np.exp(np.mean(np.log(ratio))) < 0.4)
