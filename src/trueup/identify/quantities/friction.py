"""Friction and armature of a joint: MuJoCo's own, and the laws of `JointFriction`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from trueup.core.parameters import Search
from trueup.identify.candidate import Candidate, Nominal
from trueup.identify.drive import Drive
from trueup.identify.quantities.base import Quantity
from trueup.robots.friction import LAWS, Law, Number
from trueup.robots.friction.law import FAST, SLOW
from trueup.sim import friction_of, set_friction


def _own(name: str) -> tuple[Callable[[Nominal, str], float], Callable[[Candidate, str, float], None]]:
    """Reader and writer of a number that MuJoCo's joints have."""

    def read(nominal: Nominal, joint: str) -> float:
        dof = int(nominal.model.jnt_dofadr[nominal.model.joint(joint).id])
        return float(getattr(nominal.model, f"dof_{name}")[dof])

    def write(candidate: Candidate, joint: str, value: float) -> None:
        if name == "damping":
            candidate.spec.joint(joint).damping[0] = value  # the other entries belong to higher powers of the velocity
        else:
            setattr(candidate.spec.joint(joint), name, value)

    return read, write


def _quantity(number: Number, law: Law) -> Quantity:
    """The quantity that is one number of a joint's `JointFriction`."""
    has, needs = _DRIVES[law.drive]

    def read(nominal: Nominal, joint: str) -> float | None:
        there = has(nominal.drive(joint))
        return float(getattr(friction_of(nominal.spec, joint), number.name)) if there else None

    def write(candidate: Candidate, joint: str, value: float) -> None:
        friction = friction_of(candidate.spec, joint)
        set_friction(candidate.spec, joint, replace(friction, **{number.name: value}))

    return Quantity(
        number.name,
        number.label,
        number.unit,
        "joint",
        "friction",
        read,
        write,
        number.excite,
        number.search,
        needs=needs,
        brakes=number.brakes,
    )


# The kind of drive that carries a law out: whether a joint has it, and in words.
_DRIVES: Mapping[str, tuple[Callable[[Drive], bool], str]] = {
    "": (lambda _: True, ""),
    "position servo": (lambda own: own.kp is not None and not own.plugin, "a position servo other than a plugin"),
    "motor": (lambda own: own.torque_gain is not None and own.kv is None, "a drive that follows torque"),
}

FRICTION: tuple[Quantity, ...] = (
    Quantity(
        *("damping", "viscous friction", "Nm s/rad", "joint", "friction"),
        *_own("damping"),
        FAST,
        Search("log", start=0.01, low=1e-6),
        brakes=True,
    ),
    Quantity(
        *("frictionloss", "Coulomb friction", "Nm", "joint", "friction"),
        *_own("frictionloss"),
        SLOW,
        Search("log", start=0.02, low=1e-6),
        brakes=True,
    ),
    Quantity(
        *("armature", "rotor inertia at the joint", "kg m2", "joint", "inertia"),
        *_own("armature"),
        "accelerate {target} harder",
        Search("log", start=0.001, low=1e-7),
    ),
    *(_quantity(number, law) for law in LAWS.values() for number in law.numbers if number.excite),
)
