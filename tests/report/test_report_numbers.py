"""Numbers as they are printed."""

import math

import pytest

from trueup.core.results import Estimate
from trueup.report.numbers import in_degrees, interval, percent, plural, quantity, quantity_with_degrees, significant

NBSP = "\N{NO-BREAK SPACE}"


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0365, "0.0365"),
        (0.03649, "0.0365"),
        (12.345, "12.3"),
        (999.6, "1000"),
        (0.0, "0"),
        (-0.5, "−0.500"),
        (1.2e-7, "1.20e−7"),
        (3.4e8, "3.40e8"),
        (math.nan, "–"),
        (math.inf, "–"),
    ],
)
def test_three_digits(value, text):
    assert significant(value) == text


def test_a_zero_has_no_sign():
    assert significant(-0.0, sign=True) == "0"
    assert percent(-1e-9) == f"0.0{NBSP}%"
    assert percent(-0.047) == f"−4.7{NBSP}%"
    assert percent(0.57) == f"+57{NBSP}%"


def test_units_and_degrees():
    assert quantity(0.5, "Nm") == f"0.500{NBSP}Nm"
    assert quantity(0.5, "1") == "0.500"
    assert quantity(2.0, "rad/s^2") == f"2.00{NBSP}rad/s²"
    assert in_degrees(math.pi / 180, "rad") == "1.00°"
    assert in_degrees(math.pi, "rad/s") == "180°/s"
    assert in_degrees(0.3, "Nm") == ""
    assert quantity_with_degrees(0.0365, "rad") == f"0.0365{NBSP}rad (2.09°)"


def test_intervals_have_the_places_of_the_value():
    assert interval(Estimate(0.0365, "rad", 0.022, 0.0512)) == "0.0220 to 0.0512"
    assert interval(Estimate(0.0365, "rad")) == ""
    assert interval(Estimate(0.0365, "rad", 0.02, None)) == ""
    assert interval(Estimate(-0.002, "rad", -0.007, 0.0035), sign=True) == "−0.00700 to +0.00350"
    assert interval(Estimate(math.nan, "rad", 0.1, 0.2)) == ""


def test_plurals():
    assert (plural(1, "motion"), plural(2, "motion")) == (f"1{NBSP}motion", f"2{NBSP}motions")
