"""Friction and armature of a joint: MuJoCo's own, and the laws of `JointFriction`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from trueup.core.parameters import SearchRange
from trueup.identify.candidate import Candidate, JointSize, Nominal
from trueup.identify.drive import Drive
from trueup.identify.quantities.base import Cause, Quantity
from trueup.robots.friction import LAWS, Law, Number
from trueup.robots.friction.law import FAST, SLOW
from trueup.sim import friction_of, set_friction


def _own(
    name: str,
    label: str,
    unit: str,
    excite: str,
    search: SearchRange,
    sized: Callable[[JointSize], float],
    *,
    cause: Cause = "friction",
    brakes: bool = False,
) -> Quantity:
    """The quantity that is a number which MuJoCo's joints have."""

    def read(nominal: Nominal, joint: str) -> float:
        dof = int(nominal.model.jnt_dofadr[nominal.model.joint(joint).id])
        return float(getattr(nominal.model, f"dof_{name}")[dof])

    def write(candidate: Candidate, joint: str, value: float) -> None:
        if name == "damping":
            candidate.spec.joint(joint).damping[0] = value  # the other entries belong to higher powers of the velocity
        else:
            setattr(candidate.spec.joint(joint), name, value)

    return Quantity(
        *(name, label, unit, "joint", cause, read, write, excite, search),
        brakes=brakes,
        sized=sized,
        optional=True,
    )


def _quantity(number: Number, law: Law) -> Quantity:
    """The quantity that is one number of a joint's `JointFriction`."""
    has, needs = _DRIVES[law.drive]

    def read(nominal: Nominal, joint: str) -> float | None:
        there = has(nominal.drive(joint))
        return float(getattr(friction_of(nominal.spec, joint), number.name)) if there else None

    def write(candidate: Candidate, joint: str, value: float) -> None:
        friction = friction_of(candidate.spec, joint)
        set_friction(candidate.spec, joint, replace(friction, **{number.name: value}))

    about = (number.name, number.label, number.unit)
    return Quantity(
        *about, "joint", "friction", read, write, number.excite, number.search, needs=needs, brakes=number.brakes
    )


_HARDER = "accelerate {target} harder"
# The kind of drive that carries a law out: whether a joint has it, and in words.
_DRIVES: Mapping[str, tuple[Callable[[Drive], bool], str]] = {
    "": (lambda _: True, ""),
    "position servo": (lambda own: own.kp is not None and not own.plugin, "a position servo other than a plugin"),
    "motor": (lambda own: own.torque_gain is not None and own.kv is None, "a drive that follows torque"),
}

FRICTION: tuple[Quantity, ...] = (
    # Of the usual torque: at one rad/s (or m/s), and at rest.
    _own(
        *("damping", "viscous friction", "Nm s/rad", FAST, SearchRange("log", start=0.02), lambda size: size.torque),
        brakes=True,
    ),
    _own(
        *("frictionloss", "Coulomb friction", "Nm", SLOW, SearchRange("log", start=0.02), lambda size: size.torque),
        brakes=True,
    ),
    _own(
        "armature",
        "rotor inertia at the joint",
        "kg m2",
        _HARDER,
        SearchRange("log", start=0.1),
        lambda size: size.inertia,
        cause="inertia",
    ),
    *(_quantity(number, law) for law in LAWS.values() for number in law.numbers if number.excite),
)
