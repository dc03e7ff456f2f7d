"""The numbers of all friction laws of one joint."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import Field, make_dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from jaxtyping import Float64

from trueup.robots.friction.law import Value
from trueup.robots.friction.laws import LAWS, NUMBERS


class _Laws:
    """What MuJoCo's `damping` and `frictionloss` of a joint cannot say: one field for each of `NUMBERS`.

    With v the joint velocity, q its position and g the torque that the transmission carries (gravity and the motion of
    the other joints, MuJoCo's `qfrc_bias`), a joint that moves is braked by

        (1 + asymmetry * sign(v)) * (frictionloss + damping * |v| + the sum of the laws' `brake`).

    All but the viscous part are held by MuJoCo's constraint solver: what is there at rest lets a joint stick instead
    of creep, and none of it ever drives a joint (a negative sum counts as zero). (Coulomb friction that depends on the
    direction alone moves a joint exactly as a torque offset does; the asymmetry matters through the terms that grow
    with speed or load.)

    Raises:
        ConfigError: a number is not finite, or outside its domain.
    """

    asymmetry: float

    def __post_init__(self) -> None:
        """Refuse numbers that make no friction law."""
        for number in NUMBERS:
            number.check(getattr(self, number.name))

    @property
    def on(self) -> bool:
        """Whether a law with a formula is on."""
        return any(True for _ in self._on())

    def brake(
        self, velocity: Float64[np.ndarray, "*shape"], coulomb: Value = 0.0, load: Value = 0.0, position: Value = 0.0
    ) -> Float64[np.ndarray, "*shape"]:
        """Friction other than viscous, against the motion [Nm or N].

        Args:
            velocity: of the joint [rad/s or m/s].
            coulomb: its `frictionloss` [Nm or N].
            load: transmitted torque [Nm or N].
            position: of the joint [rad or m].
        """
        total = coulomb + np.zeros_like(velocity)
        for brake, numbers in self._on():
            total = total + brake(velocity, load, position, numbers)
        return np.asarray(np.maximum((1.0 + np.sign(velocity) * self.asymmetry) * total, 0.0))

    def _on(self) -> Iterator[tuple[Callable[..., Value], list[float]]]:
        for law in LAWS.values():
            values = [getattr(self, number.name) for number in law.numbers]
            if law.brake is not None and values[0]:
                yield law.brake, values


if TYPE_CHECKING:

    class JointFriction(_Laws):
        """For type checkers, which cannot look into the table."""

        __dataclass_fields__: ClassVar[dict[str, Field[float]]]

        def __init__(self, *numbers: float, **named: float) -> None: ...

        def __getattr__(self, name: str) -> float: ...

else:
    JointFriction = make_dataclass(
        "JointFriction",
        [(number.name, float, number.default) for number in NUMBERS],
        bases=(_Laws,),
        namespace={
            "__module__": __name__,
            "__doc__": f"{_Laws.__doc__}\n    Attributes:\n"
            + "".join(f"        {number.name}: {number.label} [{number.unit}].\n" for number in NUMBERS),
        },
        frozen=True,
    )
