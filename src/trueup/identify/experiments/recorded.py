"""The motions of each joint in a set of recordings, and what may spoil them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trueup.core.episode import Episode
from trueup.core.results import Estimate
from trueup.errors import DataError, NotIdentifiable, TrueupError
from trueup.identify.experiments.findings import (
    Experiment,
    ExperimentResult,
    Finding,
    Rejection,
    reasons_in_short,
    said,
)
from trueup.identify.experiments.joint_log import disturbances, excited_joints, in_si, joint_log, reason_of
from trueup.identify.experiments.motion_fit import MotionFit
from trueup.identify.experiments.slides import Motion, Slide, SlideSettings, motion

# Another joint that moves by this much, or by this share of the joint's own travel, while that one slides, changes its
# inertia and gravity.
_OTHERS_RAD, _OTHERS_SHARE = 0.1, 0.2
_MISFIT = 3.0  # residual over the noise of the sensor, above which the model does not describe the motion
_FAR_RAD = 0.5
_APART_RAD = 0.2


@dataclass(frozen=True)
class JointMotions:
    """The motions of one joint.

    Attributes:
        joint: its name.
        episodes: what they were cut from, in the same order.
        motions: one per episode.
        length: `rad` or `m`.
        effort: `Nm` or `N`.
    """

    joint: str
    episodes: tuple[Episode, ...]
    motions: tuple[Motion, ...]
    length: str
    effort: str

    @property
    def slides(self) -> list[Slide]:
        """All stretches of sliding."""
        return [slide for item in self.motions for slide in item.slides]

    @property
    def mass(self) -> str:
        """Unit of the effective inertia."""
        return "kg" if self.length == "m" else "kg m^2"

    def missing_direction(self) -> str:
        """A sentence if the joint did not slide in both directions, else empty."""
        lacking = [sign for sign in (1, -1) if not any(slide.direction == sign for slide in self.slides)]
        if not lacking:
            return ""
        parts = []
        for sign in lacking:
            tried = sorted({round(item.torque, 6) for item in self.motions if item.direction == sign})
            word = "positive" if sign > 0 else "negative"
            torques = (
                f" under {', '.join(f'{value:g}' for value in tried)} {self.effort}"
                if tried
                else ", none was asked for"
            )
            parts.append(f"no motion in {word} direction{torques}")
        text = " and ".join(parts)
        return f"{text[0].upper()}{text[1:]}: the offset needs both; apply larger torques."

    def inertia(self, fit: MotionFit) -> Finding:
        """Effective inertia from a fit with `alpha`.

        Raises:
            NotIdentifiable: the motions do not determine it, and so nothing in units of torque.
        """
        mobility = fit.derived(lambda theta: theta["alpha"], "1")
        if mobility.low is None or mobility.low <= 0.0:
            raise NotIdentifiable(
                "the motions do not determine the effective inertia, and so nothing in units of torque",
                hint="Record several torques per direction and the coasting after them, or state the inertia.",
            )
        estimate = fit.derived(lambda theta: 1.0 / theta["alpha"], self.mass)
        return Finding(estimate, f"The effective inertia of these motions is {said(estimate)}.")

    def stated(self, inertia: float) -> Finding:
        """Effective inertia that the caller knows."""
        return Finding(Estimate(inertia, self.mass), f"The effective inertia was stated: {inertia:.3g} {self.mass}.")

    def misfit(self, fit: MotionFit) -> tuple[str, ...]:
        """Notes if recordings are too few, or the residual is far above the noise of the sensor."""
        notes = []
        if len(fit.without) == 0:
            notes.append("too few recordings to see how friction varies between them: that is not in the intervals")
        if fit.misfit > _MISFIT:
            notes.append(
                f"the fit leaves {fit.misfit:.2g} times the noise of the sensor: friction varies, or is not Coulomb "
                "plus viscous here, or gravity bends with the position; the intervals are widened for it"
            )
        return tuple(notes)

    def notes(self) -> tuple[str, ...]:
        """What else happened in these recordings."""
        notes = disturbances(self.episodes, self.joint)
        travel = max((item.travel for item in self.motions), default=0.0)
        if travel > _FAR_RAD and self.length == "rad":
            notes.append(
                f"the joint travelled up to {travel:.2g} rad: gravity errors that bend with the position bias it"
            )
        starts = [slide.start for slide in self.slides if slide.is_position]
        if starts and max(starts) - min(starts) > _APART_RAD:
            apart = max(starts) - min(starts)
            notes.append(f"the motions start up to {apart:.2g} {self.length} apart: offsets are those of the middle")
        against = sum(item.against for item in self.motions)
        if against:
            notes.append(f"{against} samples moved against their torque (an end stop, or gravity) and are left out")
        still = sorted({round(item.torque, 6) for item in self.motions if not item.slides and item.direction})
        if still:
            notes.append(f"no motion under {', '.join(f'{value:g}' for value in still)} {self.effort}")
        return tuple(notes)


@dataclass(frozen=True)
class Recorded:
    """All joints of a set of recordings."""

    joints: dict[str, JointMotions]
    rejected: tuple[Rejection, ...]

    def runs(self) -> tuple[dict[str, Any], ...]:
        """One row per trajectory."""
        return tuple(
            {
                "episode": episode.id,
                "joint": item.joint,
                "torque": own.torque,
                "moved": bool(own.slides),
                "travel": own.travel,
                "top_speed": own.top_speed,
                "sliding_s": math.fsum(float(slide.time_s[-1] - slide.time_s[0]) for slide in own.slides),
                "unit": item.effort,
                "length_unit": item.length,
            }
            for item in self.joints.values()
            for episode, own in zip(item.episodes, item.motions, strict=True)
        )

    def result(
        self,
        experiment: Experiment,
        evaluate: Callable[[JointMotions], tuple[dict[str, Finding], tuple[str, ...]]],
        settings: Mapping[str, Any],
    ) -> ExperimentResult:
        """All joints evaluated, each by `evaluate`, which returns findings and notes."""
        found = {joint: evaluate(motions) for joint, motions in self.joints.items()}
        return ExperimentResult(
            experiment=experiment,
            joints={joint: findings for joint, (findings, _) in found.items()},
            notes={joint: (*self.joints[joint].notes(), *extra) for joint, (_, extra) in found.items()},
            runs=self.runs(),
            rejected=self.rejected,
            settings=settings,
        )


def read_motions(
    episodes: Sequence[Episode],
    joints: Sequence[str] | None,
    settings: SlideSettings,
    *,
    isolates: Callable[[Episode, str, Motion], str],
    record: str,
) -> Recorded:
    """Cut recordings into the motions of each joint.

    Args:
        episodes: the recordings.
        joints: which joints; None finds them.
        settings: how motions are cut and read.
        isolates: episode, joint and motion -> why the motion does not show the one thing; empty if it does.
        record: what to record for this experiment.

    Raises:
        DataError: no episodes.
        NotIdentifiable: no episode could be used; the message says why.
    """
    if not episodes:
        raise DataError("there are no episodes to evaluate")
    found: dict[str, list[tuple[Episode, Motion, str, str]]] = {}
    rejected = []
    for episode in episodes:
        for joint in excited_joints(episode, joints):
            try:
                log = joint_log(episode, joint, delay_s=settings.delay_s, torque_source=settings.torque)
                own = motion(log, settings)
            except TrueupError as error:
                rejected.append(Rejection(episode.id, joint, reason_of(error, episode)))
                continue
            if own.direction == 0:
                rejected.append(Rejection(episode.id, joint, reason_of("the torque is zero throughout", episode)))
            elif why := _others_moved(episode, joint, own) or isolates(episode, joint, own):
                rejected.append(Rejection(episode.id, joint, reason_of(why, episode)))
            else:
                found.setdefault(joint, []).append((episode, own, log.length, log.effort))
    if not found:
        raise NotIdentifiable("no recording could be used", got=reasons_in_short(rejected), hint=record)
    grouped = {
        joint: JointMotions(joint, tuple(row[0] for row in rows), tuple(row[1] for row in rows), rows[0][2], rows[0][3])
        for joint, rows in found.items()
    }
    return Recorded(grouped, tuple(rejected))


def _others_moved(episode: Episode, joint: str, own: Motion) -> str:
    """Why the motion is not that of one joint: others that moved while it slid; empty if they hardly did."""
    measured = episode.measured
    if "position" not in measured:
        return ""
    for slide in own.slides:
        rows = (measured.time_s >= slide.time_s[0]) & (measured.time_s <= slide.time_s[-1])
        most = max(_OTHERS_RAD, _OTHERS_SHARE * float(np.ptp(slide.position)))
        for other in measured.joints:
            values = in_si(measured.select([other]), "position")[rows]
            values = values[np.isfinite(values)]
            if other != joint and values.size and np.ptp(values) > most:
                return f"{other} moved by {np.ptp(values):.2g} while {joint} slid"
    return ""
