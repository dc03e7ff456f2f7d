"""Start values for fitting torque-driven logs: friction, armature and masses by one small least-squares problem.

Open-loop torque makes whole simulations diverge from wrong parameters, accelerations do not: the equation of motion is
linear in all of these, so a regression brings a non-linear fit near enough. It needs MuJoCo alone, no Pinocchio.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from jaxtyping import Float64

from trueup.core.episode import Episode
from trueup.errors import DataError
from trueup.identify.regression.equation import JOINT_TERMS
from trueup.identify.regression.mass_regression import choose_cutoff, regress_masses
from trueup.identify.regression.samples import SampleSettings, TorqueSource, gather

_ROWS = 1500  # that are regressed, about


@dataclass(frozen=True)
class TorqueStart:
    """Where to start.

    Attributes:
        armature: joint -> [kg m^2 or kg], >= 0.
        damping: joint -> [Nm s/rad or N s/m], >= 0.
        frictionloss: joint -> [Nm or N], >= 0.
        offset: joint -> constant torque that the motor brings up [Nm or N].
        mass_scale: body -> factor on mass and inertia; a body and what is welded to it share one.
        cutoff_hz: the low-pass that was used [Hz].
    """

    armature: Mapping[str, float]
    damping: Mapping[str, float]
    frictionloss: Mapping[str, float]
    offset: Mapping[str, float]
    mass_scale: Mapping[str, float]
    cutoff_hz: float


def torque_start(
    episodes: Iterable[Episode],
    model: mujoco.MjModel,
    *,
    joints: Sequence[str] | None = None,
    torque: TorqueSource = "command",
    cutoff_hz: float | None = None,
) -> TorqueStart:
    """Regress the torque on each body's share of it and on armature, damping, Coulomb friction and offset.

    Values are bounded to what is possible; masses are drawn weakly to the model's, which decides what the torques
    cannot tell (the mass of a first link that turns about the vertical, say).

    Args:
        episodes: torque-driven logs in the joint names and units of the robot.
        model: with the nominal bodies; hinges and slides.
        joints: joints of the log that are used; those of the first episode if None. Others rest at their reference.
        torque: the commanded torque, which the simulation will be driven by, or the measured one.
        cutoff_hz: low-pass of position and torque [Hz]; None takes the one that explains most of the torque.

    Raises:
        ConfigError: a joint is neither hinge nor slide.
        DataError: too few rows.
        MissingSignal: there is no such torque.
        NameMismatch: the model lacks a joint.
    """
    logs = list(episodes)
    if not logs:
        raise DataError("there are no episodes to fit", expected="at least one")
    settings = SampleSettings(smooth_torque=True, torque=torque)
    if cutoff_hz is None:
        cutoff_hz = choose_cutoff(logs, model, settings, joints)
    samples = gather(logs, replace(settings, cutoff_hz=cutoff_hz), joints=joints)
    found = regress_masses(samples, model, max_rows=_ROWS)
    parts = found.values[len(found.links) :].reshape(len(JOINT_TERMS), -1)
    return TorqueStart(
        **{term: _by(found.joints, parts[number]) for number, term in enumerate(JOINT_TERMS)},
        mass_scale=_by(found.links, found.values[: len(found.links)]),
        cutoff_hz=cutoff_hz,
    )


def _by(names: Sequence[str], values: Float64[np.ndarray, "K"]) -> dict[str, float]:
    return {name: float(value) for name, value in zip(names, values, strict=True)}
