"""Gravity offset and kinetic asymmetry from constant torques of both signs (ES thesis 3.1.1, Table 3.1).

The thesis shifts commands by hand until the motions under +tau and -tau look alike. Here the equation of motion
(`motion_fit`) is fitted to all motions of a joint, and the shift follows with an interval: with a torque `c` added to
the command, the accelerations at speed `v` in the two directions are mirror images if

    c = -(beta_+ + beta_- - (gamma_+ - gamma_-) v) / (2 alpha).

What `c` consists of, motion alone cannot say: at zero speed c = -o + (Fc_+ - Fc_-) / 2, and a torque offset `o` that
pushes all the time does the same as a Coulomb friction that is larger in one direction. Three assumptions split it:

- friction is the same in both directions: o = -c;
- static friction is the same in both directions: o = -midpoint of a breakaway experiment;
- all friction of one direction is a multiple of that of the other: (Fc_+ - Fc_-) / (Fc_+ + Fc_-) is then
  (d_+ - d_-) / (d_+ + d_-), which the motions do determine.

Gravity errors change with the position. The offset is that at the starting pose; a linear change is fitted along
with it, what bends more than that is not: keep the travel small.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from operator import itemgetter

import numpy as np

from trueup.core.episode import Episode
from trueup.core.hold import held_rows
from trueup.core.results import Estimate
from trueup.errors import NotIdentifiable
from trueup.identify.experiments.findings import ExperimentResult, Finding, in_words, of_friction, refuted, said
from trueup.identify.experiments.joint_log import in_si
from trueup.identify.experiments.motion_fit import MotionFit, fit_motion
from trueup.identify.experiments.recorded import JointMotions, read_motions
from trueup.identify.experiments.slides import Motion, SlideSettings

Coefficients = Mapping[str, float]

# A torque that is not constant: it changes by this share of the largest within so many seconds, in this share of the
# time in which there is one.
_CHANGE, _WITHIN_S, _CHANGING = 0.02, 0.05, 0.5
_ACTIVE = 0.05  # of the largest torque
_RECORD = (
    "Record this joint alone, the others held: several constant torques, each in both directions, and the coasting "
    "after them (trueup.identify.experiments.run_constant_torque does)."
)


def estimate_constant_torque(
    episodes: Iterable[Episode],
    *,
    joints: Sequence[str] | None = None,
    inertia_kgm2: Mapping[str, float] | None = None,
    breakaway: ExperimentResult | None = None,
    position_slope: bool = True,
    settings: SlideSettings | None = None,
) -> ExperimentResult:
    """The torque to add so that both directions move alike, and what it may consist of.

    Quantities per joint: `mirror_offset` (to be *added to commands*, as in Table 3.1, for the mean speed of the
    motions), that `mirror_speed`, the `reference_position` at which offsets are stated, `coulomb_friction` (mean of
    both directions), `viscous_positive`, `viscous_negative`, `viscous_asymmetry`, `effective_inertia`,
    `position_slope`, `torque_delay` (where a torque ends while the joint slides); and, each under the assumption that
    its sentence states, `gravity_offset_*` (torque that *acts on the joint*, so of opposite sign) and
    `coulomb_asymmetry_*` (positive minus negative direction).

    Args:
        episodes: command with `torque`, measured with `position` or `velocity`; both directions must slide.
        joints: which joints; None finds them.
        inertia_kgm2: joint -> effective inertia where it is known; otherwise it is fitted, which needs several
            torques per direction or the coasting after them.
        breakaway: of the same robot, to split the offset.
        position_slope: fit a linear change of the offset with the position.
        settings: how motions are cut and read.

    Raises:
        DataError: no episodes.
        MissingSignal: no episode has a torque command, or the signal that `settings` asks for.
        NotIdentifiable: no episode could be used; the message says why.
    """
    settings, known = settings or SlideSettings(), dict(inertia_kgm2 or {})
    return read_motions(tuple(episodes), joints, settings, isolates=_isolates, record=_RECORD).result(
        "constant_torque",
        lambda motions: _joint(motions, known.get(motions.joint), breakaway, position_slope=position_slope),
        {**settings.to_json(), "position_slope": position_slope, "inertia_kgm2": known},
    )


def _joint(
    motions: JointMotions, inertia: float | None, breakaway: ExperimentResult | None, *, position_slope: bool
) -> tuple[dict[str, Finding], tuple[str, ...]]:
    effort = motions.effort
    missing = motions.missing_direction()
    if missing:
        return {"mirror_offset": Finding(Estimate(math.nan, effort), missing, "no_motion")}, ()
    try:
        fit = fit_motion(motions.slides, inertia=inertia, position_slope=position_slope)
        inertia_estimate = motions.inertia(fit) if inertia is None else motions.stated(inertia)
    except NotIdentifiable as error:
        return {"mirror_offset": Finding(Estimate(math.nan, effort), in_words(error), "not_identifiable")}, ()

    def nm(function: Callable[[Coefficients, float], float], unit: str = effort) -> Estimate:
        """A function of the coefficients and of 1 / alpha."""
        return fit.derived(lambda theta: function(theta, 1.0 / theta["alpha"] if inertia is None else inertia), unit)

    drag = f"{effort} s/{motions.length}"
    offset = nm(lambda theta, size: -0.5 * size * (_push(theta) - fit.speed * (theta["gamma+"] - theta["gamma-"])))
    coulomb = nm(lambda theta, size: -0.5 * size * (theta["beta+"] - theta["beta-"]))
    viscous = {
        "viscous_positive": nm(lambda theta, size: size * theta["gamma+"], drag),
        "viscous_negative": nm(lambda theta, size: size * theta["gamma-"], drag),
    }
    asymmetry = nm(lambda theta, size: size * (theta["gamma+"] - theta["gamma-"]), drag)
    findings = {
        "mirror_offset": Finding(
            offset,
            f"Adding {said(offset)} to commands makes both directions mirror images at {fit.speed:.2g} "
            f"{motions.length}/s, from {len(motions.slides)} motions that start near {fit.reference:.3g} "
            f"{motions.length}.",
        ),
        "mirror_speed": Finding(
            Estimate(fit.speed, f"{motions.length}/s"), "The mean speed at which the two directions are compared."
        ),
        "reference_position": Finding(
            Estimate(fit.reference, motions.length), "The pose at which offsets are stated: the mean of the starts."
        ),
        "coulomb_friction": of_friction(coulomb, "Coulomb friction, the mean of both directions, is {}."),
        **{
            name: of_friction(value, f"Viscous friction in {name.removeprefix('viscous_')} direction is {{}}.")
            for name, value in viscous.items()
        },
        "viscous_asymmetry": Finding(
            asymmetry, f"Viscous friction is larger by {said(asymmetry)} in positive direction."
        ),
        "effective_inertia": inertia_estimate,
        **_split(fit, nm, effort, breakaway, motions.joint),
    }
    if position_slope:
        slope = nm(lambda theta, size: size * theta["kappa"], f"{effort}/{motions.length}")
        findings["position_slope"] = Finding(slope, f"The offset torque changes with the position by {said(slope)}.")
    if "lambda" in fit.values:
        delay = nm(lambda theta, size: size * theta["lambda"], "s")
        findings["torque_delay"] = Finding(
            delay, f"The torque acts {said(delay)} later than its stamp says, beyond a delay that was stated."
        )
    notes = motions.misfit(fit)
    if asymmetry.low is not None and asymmetry.high is not None and asymmetry.low * asymmetry.high > 0:
        notes += ("viscous friction differs between the directions: no constant offset mirrors them at every speed",)
    return refuted(findings, "mirror_offset", _RECORD), notes


def _isolates(episode: Episode, joint: str, motion: Motion) -> str:
    """Why a motion is not one under constant torques."""
    del motion
    command = episode.commanded().select([joint])
    torque = np.nan_to_num(in_si(command, "torque"))
    largest = float(np.abs(torque).max())
    later = torque[held_rows(command.time_s, command.time_s + _WITHIN_S)]
    active = np.abs(torque) > _ACTIVE * largest
    if np.mean(np.abs(later - torque)[active] > _CHANGE * largest) <= _CHANGING:
        return ""
    return f"the commanded torque of {joint} keeps changing: it is not constant"


def _split(
    fit: MotionFit,
    nm: Callable[[Callable[[Coefficients, float], float]], Estimate],
    effort: str,
    breakaway: ExperimentResult | None,
    joint: str,
) -> dict[str, Finding]:
    """Torque offset and Coulomb asymmetry under each assumption that separates them."""
    offset = nm(lambda theta, size: 0.5 * size * _push(theta))
    asymmetry = nm(lambda theta, size: -size * _push(theta))
    told = "Motion alone cannot tell this from the other: "
    findings = {
        "gravity_offset_if_symmetric": Finding(
            offset,
            f"If Coulomb friction is the same in both directions, {said(offset)} act on the joint. {told}"
            "a Coulomb asymmetry would do the same.",
        ),
        "coulomb_asymmetry_if_balanced": Finding(
            asymmetry,
            f"If gravity is compensated, Coulomb friction is larger by {said(asymmetry)} in positive direction. {told}"
            "a torque offset would do the same.",
        ),
    }
    rates = [fit.derived(itemgetter(name), "1/s") for name in ("gamma+", "gamma-")]
    if all(rate.low is not None and rate.low > 0.0 for rate in rates):

        def one_factor(theta: Coefficients, size: float) -> float:
            ratio = (theta["gamma+"] - theta["gamma-"]) / (theta["gamma+"] + theta["gamma-"])
            return -size * (theta["beta+"] - theta["beta-"]) * ratio

        asymmetry = nm(one_factor)
        offset = nm(lambda theta, size: 0.5 * (size * _push(theta) + one_factor(theta, size)))
        assumed = "If all friction of one direction is one multiple of that of the other (from viscous friction)"
        findings |= _pair("viscous", assumed, offset, asymmetry)
    middle = None if breakaway is None or joint not in breakaway.joints else breakaway.finding(joint, "midpoint")
    if middle is not None and middle.status == "ok" and middle.estimate.low is not None:
        static = middle.estimate
        acts = Estimate(-static.value, effort, -(static.high or 0.0), -(static.low or 0.0))
        value = -2.0 * (offset_value := findings["gravity_offset_if_symmetric"].estimate).value - 2.0 * static.value
        half = 2.0 * math.hypot(_half(offset_value), _half(static))
        assumed = "If static friction is the same in both directions (from the breakaway midpoint)"
        findings |= _pair("breakaway", assumed, acts, Estimate(value, effort, value - half, value + half))
    return findings


def _pair(name: str, assumed: str, offset: Estimate, asymmetry: Estimate) -> dict[str, Finding]:
    return {
        f"gravity_offset_from_{name}": Finding(offset, f"{assumed}, {said(offset)} act on the joint."),
        f"coulomb_asymmetry_from_{name}": Finding(
            asymmetry, f"{assumed}, Coulomb friction is larger by {said(asymmetry)} in positive direction."
        ),
    }


def _push(theta: Coefficients) -> float:
    """Twice the acceleration of offset and Coulomb asymmetry at zero speed."""
    return theta["beta+"] + theta["beta-"]


def _half(estimate: Estimate) -> float:
    assert estimate.low is not None and estimate.high is not None  # noqa: PT018
    return 0.5 * (estimate.high - estimate.low)
