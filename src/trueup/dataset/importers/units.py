"""Units that the user states over those that a format implies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from trueup.core.units import SI_UNIT, UNITS
from trueup.errors import ConfigError, NameMismatch, UnitError

# What a joint's motion can be measured as: of a hinge, of a slide, of a part of its range.
_MOTION = {
    "position": ("angle", "length", "ratio"),
    "velocity": ("angular velocity", "velocity", "rate"),
    "acceleration": ("angular acceleration", "acceleration", "rate of rate"),
}


def override_units(
    units: Mapping[str, tuple[str, ...]], joints: Sequence[str], overrides: Mapping[str, str]
) -> dict[str, tuple[str, ...]]:
    """The units of a series' joint signals with the user's put in place of the format's.

    Args:
        units: signal -> one unit per joint.
        joints: names of the joints.
        overrides: `signal` or `signal.joint` -> unit; the entry with a joint wins. Signals that the series does
            not have are passed over: an override is for command and measurement alike.

    Raises:
        UnitError: a unit is unknown, or none of a position, velocity or acceleration where one is meant.
        ConfigError: a signal is unknown.
        NameMismatch: a joint is unknown; both lists are printed.
    """
    result = dict(units)
    for key, unit in sorted(overrides.items(), key=lambda item: "." in item[0]):
        if unit not in UNITS:
            raise UnitError(f"unknown unit {unit!r} for {key!r}", available=UNITS)
        signal, _, joint = key.partition(".")
        if signal not in SI_UNIT:
            raise ConfigError(f"no signal is called {signal!r}", got=f"a unit for {key!r}", available=SI_UNIT)
        if UNITS[unit][0] not in _MOTION.get(signal, (UNITS[unit][0],)):
            fitting = [name for name, (quantity, _) in UNITS.items() if quantity in _MOTION[signal]]
            raise UnitError(f"{unit} is no unit of {signal}", got=f"{key}={unit}", available=fitting)
        if joint and joint not in joints:
            raise NameMismatch(f"no joint is called {joint!r}", left=[joint], right=joints, right_name="the log has")
        if signal in result:
            result[signal] = tuple(
                unit if joint in {"", name} else old for name, old in zip(joints, result[signal], strict=True)
            )
    return result
