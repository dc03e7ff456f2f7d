"""Torque below which a motor does not start; a property of the drive, so the engines know it by name."""

from __future__ import annotations

from trueup.core.parameters import SearchRange
from trueup.robots.friction.law import Law, Number

_EXCITE = "ramp the torque of {{target}} {} until it breaks away"
_SEARCH = SearchRange(low=0.0, high=100.0, scale=0.5)

LAW = Law(
    (
        Number("static_positive", "Nm", "breakaway torque, positive", _EXCITE.format("up"), _SEARCH),
        Number("static_negative", "Nm", "breakaway torque, negative, as a size", _EXCITE.format("down"), _SEARCH),
        Number("static_velocity", "rad/s", "slower than this is standing still", default=0.03),
    ),
    formula="a torque from `-static_negative` to `static_positive` counts as zero while `|v| < static_velocity`",
    source="ES thesis, 3.1.2, Table 3.2",
    drive="motor",
)
