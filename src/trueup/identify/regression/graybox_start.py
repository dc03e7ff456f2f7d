"""Start values for a non-linear fit of servos, read off a gray-box regression."""

from __future__ import annotations

from dataclasses import dataclass

from trueup.identify.regression.graybox_result import Coefficient, GrayboxResult, JointFit


@dataclass(frozen=True)
class ServoStart:
    """What a servo and its friction look like to the regression; None where the motions do not tell.

    Attributes:
        stiffness: K_p [Nm/rad or N/m], above 0.
        damping: K_d - K_v [Nm s/rad or N s/m], at least 0: everything that opposes the velocity. A torque sensed at
            the motor shows the servo's damping only, one sensed at the joint that of the gears as well.
        friction: Coulomb friction [Nm or N], at least 0: -K_c. It shows in a torque that is sensed behind the gears.
        offset: tau_0 [Nm or N].
        notes: what was not taken as it was.
    """

    stiffness: float | None
    damping: float | None
    friction: float | None
    offset: float | None
    notes: tuple[str, ...] = ()


def servo_starts(result: GrayboxResult) -> dict[str, ServoStart]:
    """Physically signed start values per joint, from the richest model that could be fitted."""
    return {joint: _start(fit) for joint, fit in result.joints.items()}


def _start(fit: JointFit) -> ServoStart:
    final = fit.final
    if final is None:
        return ServoStart(None, None, None, None, fit.notes)
    notes: list[str] = []
    known = {name: item.value for name, item in final.coefficients.items() if item.value is not None}
    notes += [f"{name} is weak: {item.note}" for name, item in final.coefficients.items() if item.status == "weak"]
    stiffness = known.get("K_p")
    if stiffness is not None and stiffness <= 0.0:
        notes.append(
            f"K_p is {stiffness:.4g}: the torque does not pull towards the command (sign of a joint, or delay?)"
        )
        stiffness = None
    damping = known["K_d"] - known.get("K_v", 0.0) if "K_d" in known else None
    friction = -known["K_c"] if "K_c" in known else None
    if damping is not None and damping < 0.0:
        notes.append(f"K_d - K_v is {damping:.4g}: taken as 0 (an unmodeled delay looks like negative damping)")
        damping = 0.0
    if friction is not None and friction < 0.0:
        notes.append(f"K_c is {-friction:.4g}: the torque drives along the velocity, so no friction is taken from it")
        friction = 0.0
    return ServoStart(stiffness, damping, friction, _value(final.coefficients.get("tau_0")), tuple(notes))


def _value(coefficient: Coefficient | None) -> float | None:
    return None if coefficient is None else coefficient.value
