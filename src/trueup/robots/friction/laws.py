"""The table of friction laws."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module

from trueup.robots.friction.law import Law, Number

# The files of the laws, in the order of their numbers in the user data of a joint. Model files rely on it: a new law
# goes to the end, and none is taken out.
_FILES = (
    "stribeck",
    "load",
    "asymmetry",
    "tanh",
    "sigmoid",
    "dead_band",
    "static_threshold",
)

LAWS: Mapping[str, Law] = {name: import_module(f"trueup.robots.friction.{name}").LAW for name in _FILES}
NUMBERS: tuple[Number, ...] = tuple(number for law in LAWS.values() for number in law.numbers)

# The first number of a joint's user data says that the others are its friction laws in the order of NUMBERS. (MJCF
# keeps six digits.) A file from before the last laws has fewer: those laws are off.
MARK = 20261.0
WIDTH = 1 + len(NUMBERS)
LEAST_WIDTH = 14
