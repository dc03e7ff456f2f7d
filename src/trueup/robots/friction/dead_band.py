"""Backlash or dead zone of a position servo; a property of the drive, so the engines know it by name."""

from __future__ import annotations

from trueup.core.parameters import SearchRange
from trueup.robots.friction.law import Law, Number

_EXCITE = "let {target} stop in many poses, from both directions"
_SEARCH = SearchRange(low=0.0, high=0.2, scale=0.005)

LAW = Law(
    (Number("dead_band", "rad", "dead band of the servo, half width", _EXCITE, _SEARCH),),
    formula="position errors up to `dead_band` make no torque; the joint stands still within it",
    source="backlash, or the servo's own dead zone",
    drive="position servo",
)
