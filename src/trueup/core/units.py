"""Units that logs use, and their factors to SI.

Only what robots' logs contain; a table of factors, not a dimensional algebra.
"""

from __future__ import annotations

import math
from types import MappingProxyType

from trueup.errors import UnitError

# unit -> (quantity, factor to the quantity's SI unit)
_TABLE = {
    "rad": ("angle", 1.0),
    "deg": ("angle", math.pi / 180.0),
    "mrad": ("angle", 1e-3),
    "rev": ("angle", 2.0 * math.pi),
    "m": ("length", 1.0),
    "mm": ("length", 1e-3),
    "cm": ("length", 1e-2),
    "1": ("ratio", 1.0),
    "%": ("ratio", 1e-2),
    "rad/s": ("angular velocity", 1.0),
    "deg/s": ("angular velocity", math.pi / 180.0),
    "rpm": ("angular velocity", 2.0 * math.pi / 60.0),
    "m/s": ("velocity", 1.0),
    "mm/s": ("velocity", 1e-3),
    "1/s": ("rate", 1.0),
    "rad/s^2": ("angular acceleration", 1.0),
    "deg/s^2": ("angular acceleration", math.pi / 180.0),
    "m/s^2": ("acceleration", 1.0),
    "1/s^2": ("rate of rate", 1.0),
    "Nm": ("torque", 1.0),
    "mNm": ("torque", 1e-3),
    "N": ("force", 1.0),
    "A": ("current", 1.0),
    "mA": ("current", 1e-3),
    "V": ("voltage", 1.0),
    "mV": ("voltage", 1e-3),
    "degC": ("temperature", 1.0),
    "s": ("time", 1.0),
    "ms": ("time", 1e-3),
    "us": ("time", 1e-6),
    "ns": ("time", 1e-9),
    "kg": ("mass", 1.0),
}

UNITS = MappingProxyType(_TABLE)

# What each signal is measured in inside the package, for a revolute joint.
SI_UNIT = MappingProxyType(
    {
        "position": "rad",
        "velocity": "rad/s",
        "acceleration": "rad/s^2",
        "torque": "Nm",
        "current": "A",
        "voltage": "V",
        "load": "Nm",
        "temperature": "degC",
        "body.position": "m",
        "body.rotation": "1",
        "body.velocity": "m/s",
        "body.angular_velocity": "rad/s",
        "body.force": "N",
        "body.torque": "Nm",
        "body.specific_force": "m/s^2",
    }
)


def joint_unit(unit: str, length_unit: str) -> str:
    """The unit of a joint's number, given that of a hinge, for a joint in `rad` or `m`.

    >>> joint_unit("Nm s/rad", "m")
    'N s/m'
    """
    if length_unit == "rad":
        return unit
    for hinge, slide in (("kg m^2", "kg"), ("kg m2", "kg"), ("Nm", "N"), ("rad", "m")):
        unit = unit.replace(hinge, slide)
    return unit


def si_factor(unit: str) -> tuple[str, float]:
    """The SI unit of the same quantity, and the factor into it.

    Raises:
        UnitError: the unit is not in the table.
    """
    if unit not in UNITS:
        raise UnitError(f"unknown unit {unit!r}", available=UNITS)
    quantity, factor = UNITS[unit]
    si = next(name for name, (other, scale) in UNITS.items() if other == quantity and scale == 1.0)
    return si, factor


def conversion(source: str, target: str) -> float:
    """The factor f with value_in_target = f * value_in_source.

    Raises:
        UnitError: a unit is unknown, or the two measure different quantities.
    """
    for unit in (source, target):
        if unit not in UNITS:
            raise UnitError(f"unknown unit {unit!r}", available=UNITS)
    if UNITS[source][0] != UNITS[target][0]:
        raise UnitError(
            f"{source!r} cannot be converted into {target!r}",
            got=UNITS[source][0],
            expected=UNITS[target][0],
        )
    return UNITS[source][1] / UNITS[target][1]
