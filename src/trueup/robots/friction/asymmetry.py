"""Friction that is higher in one direction; it multiplies all others, so the engines know it by name."""

from __future__ import annotations

from trueup.core.parameters import SearchRange
from trueup.robots.friction.law import Law, Number

_EXCITE = "move {target} in both directions at several speeds"
_SEARCH = SearchRange(low=-0.9, high=0.9, scale=0.1)

LAW = Law(
    (
        Number(
            "asymmetry", "1", "friction by direction, share that is more in positive", _EXCITE, _SEARCH, domain="share"
        ),
    ),
    formula="all friction, viscous too, times `1 + asymmetry * sign(v)`",
    source="ES thesis, Table 3.1",
)
