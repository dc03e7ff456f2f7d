"""Mass, centre of mass and inertia of a body, and what the robot carries."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from trueup.core.parameters import SearchRange
from trueup.identify.candidate import Candidate, Nominal
from trueup.identify.inertial import COMPONENTS
from trueup.identify.quantities.base import Quantity

_MASS, _EXTENT = "a body that has mass", "a body that has a rotational inertia"


def _read_mass(nominal: Nominal, body: str) -> float | None:
    mass = nominal.inertial(body).mass
    return mass if mass > 0.0 else None


def _write_mass(candidate: Candidate, body: str, value: float) -> None:
    candidate.inertials[body] = candidate.inertial(body).with_mass(value)


def _com(axis: int) -> tuple[Callable[[Nominal, str], float | None], Callable[[Candidate, str, float], None]]:
    def read(nominal: Nominal, body: str) -> float | None:
        own = nominal.inertial(body)
        return float(own.com[axis]) if own.mass > 0.0 else None

    def write(candidate: Candidate, body: str, value: float) -> None:
        inertial = candidate.inertial(body)
        com = inertial.com.copy()
        com[axis] = value
        candidate.inertials[body] = inertial.with_com(com)

    return read, write


def _write_inertia_scale(candidate: Candidate, body: str, value: float) -> None:
    inertial = candidate.inertial(body)
    candidate.inertials[body] = replace(inertial, inertia=inertial.inertia * value)


def _component(name: str) -> Callable[[Candidate, str, float], None]:
    def write(candidate: Candidate, body: str, value: float) -> None:
        candidate.deformations.setdefault(body, {})[name] = value

    return write


def _write_carried(name: str) -> Callable[[Candidate, str, float], None]:
    def write(candidate: Candidate, _target: str, value: float) -> None:
        candidate.payload[name] = value

    return write


def _place(axis: int) -> tuple[Callable[[Nominal, str], float | None], Callable[[Candidate, str, float], None]]:
    def read(nominal: Nominal, _target: str) -> float:
        return nominal.payload_start[axis]

    return read, _write_carried("xyz"[axis])


def _unchanged(value: float) -> Callable[[Nominal, str], float | None]:
    """Reader of what changes a body's inertia, which the model says nothing of."""

    def read(nominal: Nominal, body: str) -> float | None:
        own = nominal.inertial(body)
        return value if own.mass > 0.0 and own.inertia.any() else None

    return read


def _zero(_nominal: Nominal, _target: str) -> float:
    return 0.0


_POSES = "hold and swing {target} in many poses"
_SWING = "accelerate {target} about several axes"

RIGID_BODY: tuple[Quantity, ...] = (
    Quantity(
        *("mass", "mass", "kg", "body", "gravity"),
        _read_mass,
        _write_mass,
        _POSES,
        SearchRange("log", start=1e-4, low=1e-6, span=10.0, prior_std=0.5),
        needs=_MASS,
    ),
    *(
        Quantity(
            *(f"com_{axis}", f"center of mass, {axis}", "m", "body", "gravity"),
            *_com(index),
            _POSES,
            SearchRange(low=-2.0, high=2.0, scale=0.02, prior_std=1.0),
            needs=_MASS,
        )
        for index, axis in enumerate("xyz")
    ),
    Quantity(
        *("inertia_scale", "rotational inertia, factor", "1", "body", "inertia"),
        _unchanged(1.0),
        _write_inertia_scale,
        _SWING,
        SearchRange("log", span=20.0, prior_std=0.7),
        needs=_EXTENT,
        relative=True,
    ),
    *(
        Quantity(
            *(f"inertia_{name}", f"rotational inertia, log-Cholesky component {name}", "1", "body", "inertia"),
            _unchanged(0.0),
            _component(name),
            _SWING,
            SearchRange(low=-3.0, high=3.0, scale=0.3, prior_std=1.0),
            needs=_EXTENT,
            relative=True,
        )
        for name in COMPONENTS
    ),
    Quantity(
        *("payload_mass", "mass of the payload", "kg", "robot", "gravity"),
        _zero,
        _write_carried("mass"),
        "hold and swing the payload in many poses",
        SearchRange(low=0.0, high=50.0, scale=0.3, prior_std=10.0),
        relative=True,
    ),
    *(
        Quantity(
            *(f"payload_{axis}", f"payload, {axis}", "m", "robot", "gravity"),
            *_place(index),
            "turn the payload about several axes",
            SearchRange(low=-0.5, high=0.5, scale=0.03, prior_std=4.0),
            relative=True,
        )
        for index, axis in enumerate("xyz")
    ),
    Quantity(
        *("payload_inertia", "rotational inertia of the payload, per mass", "m2", "robot", "inertia"),
        _zero,
        _write_carried("inertia"),
        "accelerate the payload about several axes",
        SearchRange(low=0.0, high=0.25, scale=3.6e-3, prior_std=1.0),  # a radius of gyration of 6 cm
        relative=True,
    ),
)
