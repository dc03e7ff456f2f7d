"""The catalogue of what a fit can change."""

from trueup.errors import ConfigError
from trueup.identify.quantities.base import Cause as Cause
from trueup.identify.quantities.base import Quantity as Quantity
from trueup.identify.quantities.base import motion_target as motion_target
from trueup.identify.quantities.base import split_motion_target as split_motion_target
from trueup.identify.quantities.friction import FRICTION
from trueup.identify.quantities.rigid_body import RIGID_BODY
from trueup.identify.quantities.servo import SERVO

QUANTITIES: dict[str, Quantity] = {quantity.name: quantity for quantity in (*SERVO, *FRICTION, *RIGID_BODY)}


def quantity(name: str) -> Quantity:
    """The quantity of that name.

    Raises:
        ConfigError: there is none.
    """
    if name not in QUANTITIES:
        raise ConfigError(f"there is no quantity {name!r} to fit", available=QUANTITIES)
    return QUANTITIES[name]


__all__ = ["QUANTITIES", "Cause", "Quantity", "motion_target", "quantity", "split_motion_target"]
