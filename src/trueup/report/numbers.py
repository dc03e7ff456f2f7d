"""Numbers as people read them: three significant digits, units, intervals, degrees beside radians."""

from __future__ import annotations

import math

from trueup.core.results import Estimate

MINUS = "\N{MINUS SIGN}"
NOTHING = "\N{EN DASH}"
_IN_DEGREES = {"rad": "°", "rad/s": "°/s", "rad/s^2": "°/s²"}
_PRETTY_UNIT = {"degC": "°C", "1": "", "kg m2": "kg m²", "deg": "°", "deg^2": "(°)²"}
_POWERS = {"^2": "²", "^3": "³", "^4": "⁴"}


def decimals(value: float, digits: int = 3) -> int:
    """Places after the point that show `digits` significant digits of `value`."""
    if value == 0 or not math.isfinite(value):
        return 0
    return max(0, digits - 1 - math.floor(math.log10(abs(value))))


def fixed(value: float, places: int, *, sign: bool = False) -> str:
    """A number with fixed places, a real minus sign, and a dash for NaN."""
    if not math.isfinite(value):
        return NOTHING
    text = f"{value:+.{places}f}" if sign else f"{value:.{places}f}"
    if not text.strip("+-0."):
        text = text.lstrip("+-")  # no sign on a zero
    return text.replace("-", MINUS)


def significant(value: float, digits: int = 3, *, sign: bool = False) -> str:
    """A number with `digits` significant digits; powers of ten only where the zeros would hide them."""
    if value and math.isfinite(value) and not 1e-5 <= abs(value) < 1e6:
        mantissa, exponent = f"{value:+.{digits - 1}e}".split("e")
        return f"{mantissa if sign else mantissa.lstrip('+')}e{int(exponent)}".replace("-", MINUS)
    return fixed(value, decimals(value, digits), sign=sign)


def plain(value: float) -> str:
    """A number that somebody wrote down: without zeros that only fill up digits."""
    text = significant(value, 4)
    mantissa, mark, exponent = text.partition("e")
    return (mantissa.rstrip("0").rstrip(".") if "." in mantissa else mantissa) + mark + exponent


def pretty_unit(unit: str) -> str:
    """A unit as printed; empty for pure numbers."""
    for plain, raised in _POWERS.items():
        unit = unit.replace(plain, raised)
    return _PRETTY_UNIT.get(unit, unit)


def with_unit(text: str, unit: str) -> str:
    """`text` and its unit, with a space that does not break."""
    shown = pretty_unit(unit)
    return f"{text}\N{NO-BREAK SPACE}{shown}" if shown and text != NOTHING else text


def quantity(value: float, unit: str) -> str:
    """A number with its unit."""
    return with_unit(significant(value), unit)


def in_degrees(value: float, unit: str) -> str:
    """The same angle (or its rate) in degrees; empty for everything that is no angle."""
    if unit not in _IN_DEGREES or not math.isfinite(value):
        return ""
    return significant(math.degrees(value)) + _IN_DEGREES[unit]


def quantity_with_degrees(value: float, unit: str) -> str:
    """`0.0365 rad (2.09°)`."""
    degrees = in_degrees(value, unit)
    return f"{quantity(value, unit)} ({degrees})" if degrees else quantity(value, unit)


def has_interval(estimate: Estimate) -> bool:
    """Whether the value and both ends of its interval are known."""
    ends = (estimate.low, estimate.high)
    return math.isfinite(estimate.value) and all(end is not None and math.isfinite(end) for end in ends)


def interval(estimate: Estimate, *, sign: bool = False) -> str:
    """`0.0220 to 0.0510`, with as many places as the value has; empty where there is no interval."""
    if estimate.low is None or estimate.high is None or not has_interval(estimate):
        return ""
    scale = max(abs(estimate.low), abs(estimate.high)) if sign else estimate.value
    if scale and math.isfinite(scale) and not 1e-5 <= abs(scale) < 1e6:
        return f"{significant(estimate.low, sign=sign)} to {significant(estimate.high, sign=sign)}"
    places = decimals(scale)
    return f"{fixed(estimate.low, places, sign=sign)} to {fixed(estimate.high, places, sign=sign)}"


def percent(ratio: float, *, sign: bool = True) -> str:
    """A ratio in percent, whole numbers from 10 % on."""
    if not math.isfinite(ratio):
        return NOTHING
    value = 100.0 * ratio
    places = 0 if abs(value) >= 9.5 else 1
    return f"{fixed(value, places, sign=sign)}\N{NO-BREAK SPACE}%"


def plural(count: int, noun: str) -> str:
    """`1 motion`, `6 motions`."""
    return f"{count}\N{NO-BREAK SPACE}{noun}" if count == 1 else f"{count}\N{NO-BREAK SPACE}{noun}s"
