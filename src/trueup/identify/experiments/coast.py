"""Friction from coasting: how a joint slows down when its torque is taken away (ES thesis 3.2).

Without torque, in direction s, the deceleration is (Fc_s -+ o) / I + (d / I) |dq|: whatever the inertia is, the coast
alone determines friction *over* inertia. The jump of the acceleration when the torque ends determines the inertia,
and with it the friction in units of torque.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from trueup.core.episode import Episode
from trueup.core.results import Estimate
from trueup.errors import NotIdentifiable
from trueup.identify.experiments.findings import ExperimentResult, Finding, in_words, of_friction, refuted, said
from trueup.identify.experiments.motion_fit import fit_motion
from trueup.identify.experiments.recorded import JointMotions, read_motions
from trueup.identify.experiments.slides import Motion, Slide, SlideSettings

_QUIET = 0.05  # share of the largest torque below which a joint coasts
_FLAT = 0.01  # of the largest torque: one that changes by more while it is small only passes through zero
_LEAST_S = 0.05
_RECORD = (
    "Record this joint alone, the others held: a constant torque until it moves, then zero torque until it stands, in "
    "both directions (trueup.identify.experiments.run_coast does)."
)


def estimate_coast(
    episodes: Iterable[Episode],
    *,
    joints: Sequence[str] | None = None,
    inertia_kgm2: Mapping[str, float] | None = None,
    position_slope: bool = True,
    settings: SlideSettings | None = None,
) -> ExperimentResult:
    """Friction over inertia from the coasting after a torque, and friction itself where the inertia is known.

    Quantities per joint, from the coasting alone: `viscous_rate_positive` and `viscous_rate_negative` (d / I in each
    direction), `coulomb_rate_positive` and `coulomb_rate_negative` (the deceleration that is left at zero speed; a
    torque offset o enters as -o / I and +o / I), and the means of the two directions `viscous_rate` and
    `coulomb_rate` (free of the offset), or those of the one direction in which the joint coasted; the
    `reference_position` at which they are stated. With the inertia,
    stated or from the motions under torque, also `effective_inertia`, `viscous_friction` and `coulomb_friction`.

    Args:
        episodes: command with `torque` that ends while the joint moves, measured with `position` or `velocity`. A
            torque that only passes through zero does not end, and motions in which other joints move are refused.
        joints: which joints; None finds them.
        inertia_kgm2: joint -> effective inertia where it is known.
        position_slope: fit a linear change of the offset torque with the position. Without it intervals are much
            narrower, and wrong where gravity is not compensated: do that on joints that gravity does not touch.
        settings: how motions are cut and read.

    Raises:
        DataError: no episodes.
        MissingSignal: no episode has a torque command, or the signal that `settings` asks for.
        NotIdentifiable: no episode could be used; the message says why.
    """
    settings, known = settings or SlideSettings(), dict(inertia_kgm2 or {})
    return read_motions(tuple(episodes), joints, settings, isolates=_isolates, record=_RECORD).result(
        "coast",
        lambda motions: _joint(motions, known.get(motions.joint), position_slope=position_slope),
        {**settings.to_json(), "position_slope": position_slope, "inertia_kgm2": known},
    )


def _joint(
    motions: JointMotions, inertia: float | None, *, position_slope: bool
) -> tuple[dict[str, Finding], tuple[str, ...]]:
    unit = f"{motions.length}/s^2"
    coasting = _coasting(motions)
    if not coasting:
        moved = "no motion" if not motions.slides else "no coasting: the joint stopped, or the recording did"
        sentence = f"There is {moved} after the torque ended. {_RECORD}"
        return {"coulomb_rate": Finding(Estimate(math.nan, unit), sentence, "no_motion")}, ()
    try:
        fit = fit_motion(coasting, inertia=None, with_torque=False, position_slope=position_slope)
    except NotIdentifiable as error:
        return {"coulomb_rate": Finding(Estimate(math.nan, unit), in_words(error), "not_identifiable")}, ()
    sides = [(name, sign) for name, sign in (("positive", "+"), ("negative", "-")) if f"beta{sign}" in fit.values]
    findings = {}
    for side, sign in sides:
        rate = fit.derived(lambda theta, sign=sign: theta[f"gamma{sign}"], "1/s")  # type: ignore[misc]
        findings[f"viscous_rate_{side}"] = of_friction(
            rate, f"Coasting in {side} direction, viscous friction over inertia is {{}}."
        )
        rate = fit.derived(lambda theta, sign=sign: _coulomb(theta, sign), unit)  # type: ignore[misc]
        sentence = f"Coasting in {side} direction, the joint slows down by {said(rate)} as its speed goes to zero."
        findings[f"coulomb_rate_{side}"] = Finding(rate, sentence)
    signs = [sign for _, sign in sides]
    viscous = fit.derived(lambda theta: sum(theta[f"gamma{sign}"] for sign in signs) / len(signs), "1/s")
    coulomb = fit.derived(lambda theta: sum(_coulomb(theta, sign) for sign in signs) / len(signs), unit)
    free = "free of any torque offset" if len(signs) == 2 else "which a torque offset enters: one direction only"
    findings["viscous_rate"] = of_friction(viscous, "Viscous friction over inertia is {}.")
    findings["coulomb_rate"] = of_friction(coulomb, f"Coulomb friction over inertia is {{}}, {free}.")
    findings["reference_position"] = Finding(
        Estimate(fit.reference, motions.length), "The pose at which the rates are stated: the mean of the starts."
    )
    if len(signs) == 1:
        # A torque offset enters what is left at zero speed: it may have any sign.
        findings["coulomb_rate"] = Finding(coulomb, f"Coulomb friction over inertia is {said(coulomb)}, {free}.")
    left = refuted(findings, "coulomb_rate", _RECORD)
    if len(left) < len(findings):
        return left, motions.misfit(fit)
    with_inertia, notes = _with_inertia(motions, inertia, viscous, coulomb, position_slope=position_slope)
    return {**findings, **with_inertia}, (*motions.misfit(fit), *notes)


def _with_inertia(
    motions: JointMotions, known: float | None, viscous: Estimate, coulomb: Estimate, *, position_slope: bool
) -> tuple[dict[str, Finding], tuple[str, ...]]:
    """Friction in units of torque."""
    try:
        if known is not None:
            inertia = motions.stated(known)
        else:
            inertia = motions.inertia(fit_motion(motions.slides, inertia=None, position_slope=position_slope))
    except NotIdentifiable as error:
        return {}, (f"no friction in units of torque: {in_words(error)}",)
    findings = {"effective_inertia": inertia}
    for name, rate, unit in (
        ("viscous_friction", viscous, f"{motions.effort} s/{motions.length}"),
        ("coulomb_friction", coulomb, motions.effort),
    ):
        value = _product(inertia.estimate, rate, unit)
        findings[name] = of_friction(value, f"With this inertia, {name.replace('_', ' ')} is {{}}.")
    return findings, ()


def _coasting(motions: JointMotions) -> list[Slide]:
    """The parts of the slides in which no torque acts."""
    return [part for item in motions.motions for part in _coasts(item)]


def _coasts(motion: Motion) -> list[Slide]:
    """The stretches of a motion in which there is no torque, other than one that is passing through zero."""
    largest = abs(motion.torque)
    parts = [slide.part(np.abs(slide.torque) <= _QUIET * largest) for slide in motion.slides]
    return [part for part in parts if part is not None and _is_coast(part, largest)]


def _is_coast(part: Slide, largest: float) -> bool:
    third = part.torque.size // 3
    change = abs(float(np.mean(part.torque[-third:])) - float(np.mean(part.torque[:third])))
    return bool(part.time_s[-1] - part.time_s[0] >= _LEAST_S) and change <= _FLAT * largest


def _isolates(episode: Episode, joint: str, motion: Motion) -> str:
    """Why a motion does not end in coasting; one in which nothing moves after its torque is told of later."""
    del episode
    quiet = [slide.part(np.abs(slide.torque) <= _QUIET * abs(motion.torque)) for slide in motion.slides]
    if any(quiet) and not _coasts(motion):
        return f"the torque of {joint} passes through zero and does not stay there: there is no coasting"
    return ""


def _coulomb(theta: Mapping[str, float], sign: str) -> float:
    """Deceleration at zero speed in one direction."""
    return -theta["beta+"] if sign == "+" else theta["beta-"]


def _product(inertia: Estimate, rate: Estimate, unit: str) -> Estimate:
    value = inertia.value * rate.value
    if rate.low is None or rate.high is None:
        return Estimate(value, unit)
    own = 0.0 if inertia.low is None or inertia.high is None else 0.5 * (inertia.high - inertia.low) * rate.value
    half = math.hypot(own, 0.5 * (rate.high - rate.low) * inertia.value)
    return Estimate(value, unit, value - half, value + half)
