"""Friction and armature of a joint: MuJoCo's own, and the laws of `JointFriction`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from trueup.identify.candidate import Candidate, Nominal
from trueup.identify.drive import Drive
from trueup.identify.quantities.base import Quantity
from trueup.sim import friction_of, set_friction

_Read = Callable[[Nominal, str], float | None]
_Write = Callable[[Candidate, str, float], None]


def _dof(nominal: Nominal, joint: str) -> int:
    return int(nominal.model.jnt_dofadr[nominal.model.joint(joint).id])


def _read_damping(nominal: Nominal, joint: str) -> float:
    return float(nominal.model.dof_damping[_dof(nominal, joint)])


def _write_damping(candidate: Candidate, joint: str, value: float) -> None:
    candidate.spec.joint(joint).damping[0] = value  # the other entries belong to higher powers of the velocity


def _read_frictionloss(nominal: Nominal, joint: str) -> float:
    return float(nominal.model.dof_frictionloss[_dof(nominal, joint)])


def _write_frictionloss(candidate: Candidate, joint: str, value: float) -> None:
    candidate.spec.joint(joint).frictionloss = value


def _read_armature(nominal: Nominal, joint: str) -> float:
    return float(nominal.model.dof_armature[_dof(nominal, joint)])


def _write_armature(candidate: Candidate, joint: str, value: float) -> None:
    candidate.spec.joint(joint).armature = value


def _law(name: str) -> tuple[_Read, _Write]:
    """Reader and writer of one number of `JointFriction`."""

    def read(nominal: Nominal, joint: str) -> float | None:
        return float(getattr(friction_of(nominal.spec, joint), name))

    def write(candidate: Candidate, joint: str, value: float) -> None:
        law = friction_of(candidate.spec, joint)
        set_friction(candidate.spec, joint, replace(law, **{name: value}))

    return read, write


def _law_of(name: str, has: Callable[[Drive], bool]) -> tuple[_Read, _Write]:
    """The same for joints whose drive carries the law out."""
    read, write = _law(name)
    return lambda nominal, joint: read(nominal, joint) if has(nominal.drive(joint)) else None, write


def _position_servo(drive: Drive) -> bool:
    return drive.kp is not None and not drive.plugin


def _motor(drive: Drive) -> bool:
    return drive.torque_gain is not None and drive.kv is None


_SLOW = "let {target} creep, stop and reverse at low speed"
_FAST = "let {target} pass through its whole range of speeds"
_LOADED = "move {target} in both directions in poses with large and with small gravity load"

FRICTION: tuple[Quantity, ...] = (
    Quantity(
        "damping",
        "Nm s/rad",
        "joint",
        "friction",
        _read_damping,
        _write_damping,
        _FAST,
        transform="log",
        start=0.01,
        low=1e-6,
    ),
    Quantity(
        "frictionloss",
        "Nm",
        "joint",
        "friction",
        _read_frictionloss,
        _write_frictionloss,
        _SLOW,
        transform="log",
        start=0.02,
        low=1e-6,
    ),
    Quantity(
        "armature",
        "kg m2",
        "joint",
        "inertia",
        _read_armature,
        _write_armature,
        "accelerate {target} harder",
        transform="log",
        start=0.001,
        low=1e-7,
    ),
    Quantity(
        "stribeck", "Nm", "joint", "friction", *_law("stribeck"), _SLOW, low=0.0, high=100.0, scale=0.1, prior_std=3.0
    ),
    Quantity(
        "stribeck_velocity",
        "rad/s",
        "joint",
        "friction",
        *_law("stribeck_velocity"),
        _SLOW,
        transform="log",
        low=1e-3,
        span=20.0,
        prior_std=1.0,
    ),
    Quantity("load", "1", "joint", "friction", *_law("load"), _LOADED, low=0.0, high=5.0, scale=0.2),
    Quantity(
        "asymmetry",
        "1",
        "joint",
        "friction",
        *_law("asymmetry"),
        "move {target} in both directions at several speeds",
        low=-0.9,
        high=0.9,
        scale=0.1,
    ),
    Quantity(
        "tanh_coulomb",
        "Nm",
        "joint",
        "friction",
        *_law("tanh_coulomb"),
        _FAST,
        low=0.0,
        high=100.0,
        scale=0.1,
        prior_std=3.0,
    ),
    Quantity(
        "tanh_velocity",
        "rad/s",
        "joint",
        "friction",
        *_law("tanh_velocity"),
        _SLOW,
        transform="log",
        low=1e-3,
        span=20.0,
        prior_std=1.0,
    ),
    Quantity(
        "sigmoid_level",
        "Nm",
        "joint",
        "friction",
        *_law("sigmoid_level"),
        _FAST,
        transform="log",
        start=0.1,
        low=1e-4,
    ),
    Quantity(
        "sigmoid_slope",
        "s/rad",
        "joint",
        "friction",
        *_law("sigmoid_slope"),
        _SLOW,
        transform="log",
        low=0.1,
        high=1000.0,
        prior_std=1.5,
    ),
    Quantity(
        "sigmoid_shift",
        "rad/s",
        "joint",
        "friction",
        *_law("sigmoid_shift"),
        "let {target} move slowly in both directions",
        low=-1.0,
        high=1.0,
        scale=0.05,
    ),
    Quantity(
        "dead_band",
        "rad",
        "joint",
        "friction",
        *_law_of("dead_band", _position_servo),
        "let {target} stop in many poses, from both directions",
        low=0.0,
        high=0.2,
        scale=0.005,
        needs="a position servo other than a plugin",
    ),
    Quantity(
        "static_positive",
        "Nm",
        "joint",
        "friction",
        *_law_of("static_positive", _motor),
        "ramp the torque of {target} up until it breaks away",
        low=0.0,
        high=100.0,
        scale=0.5,
        needs="a drive that follows torque",
    ),
    Quantity(
        "static_negative",
        "Nm",
        "joint",
        "friction",
        *_law_of("static_negative", _motor),
        "ramp the torque of {target} down until it breaks away",
        low=0.0,
        high=100.0,
        scale=0.5,
        needs="a drive that follows torque",
    ),
)
