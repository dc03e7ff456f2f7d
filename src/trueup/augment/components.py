"""Bodies as a network sees them: numbers, one channel each, of the vectors and rotations of a body (SAT, V-A).

A channel names a component of a body's signal: `body.position.x`, and of a rotation one of the six numbers of its first
two columns, `body.rotation.0` to `.5`.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from trueup.augment.rotations import refuse_no_rotation, six_of
from trueup.core.timeseries import BODY_PREFIX

POSITION, ROTATION = (f"{BODY_PREFIX}{name}" for name in ("position", "rotation"))
# What can be corrected is what a motion capture measures; what else a body has can be read.
CORRECTED = (POSITION, ROTATION)
SIGNALS = (*CORRECTED, *(f"{BODY_PREFIX}{name}" for name in ("velocity", "angular_velocity", "force", "torque")))
_AXES = ("x", "y", "z")
_SIX = tuple(str(number) for number in range(6))


def components(signal: str) -> tuple[str, ...]:
    """The channels' signals of a signal: of a body's those of its components, else the signal itself."""
    if not signal.startswith(BODY_PREFIX):
        return (signal,)
    return tuple(f"{signal}.{name}" for name in (_SIX if signal == ROTATION else _AXES))


def number_of(component: str) -> int:
    """Which of the components of its signal it is."""
    signal, _, name = component.rpartition(".")
    return (_SIX if signal == ROTATION else _AXES).index(name)


def values_of(values: Float[np.ndarray, "T B ..."], body: int, component: str, where: str) -> Float[np.ndarray, "T"]:
    """One component of a body's signal.

    Raises:
        DataError: of a rotation that is none.
    """
    own, number = values[:, body], number_of(component)
    if not component.startswith(ROTATION):
        return own[:, number]
    if number == 0:  # once, not for each of the six
        refuse_no_rotation(own, where)
    return six_of(own)[:, number]
