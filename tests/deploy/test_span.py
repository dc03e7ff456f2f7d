"""Ranges of inputs; some are of how far a command is from a joint, wherever that stands."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.networks import card_of
from hypothesis import given
from hypothesis import strategies as st

from trueup.core.model_card import Input
from trueup.deploy.span import Span
from trueup.errors import ConfigError
from trueup.stages.timing import _motion

INPUTS = (
    Input("position", "a", "rad"),
    Input("velocity", "a", "rad/s", low=-2.0, high=2.0),
    Input("position", "a", "rad", "command", low=-0.1, high=0.3, relative=True),
)
numbers = st.floats(-1e6, 1e6, allow_nan=False)


@given(st.tuples(numbers, numbers, numbers))
def test_the_nearest_sample_is_inside_and_that_of_one_inside_is_itself(sample):
    span, x = Span(INPUTS, 0.0), np.array(sample)
    given_x = x.copy()
    inside = abs(x[1]) <= 2.0 and -0.1 <= x[2] - x[0] <= 0.3
    assert bool(span.outside(x).size) != span.covers(x)
    assert span.covers(x) or not inside
    nearest = span.clipped(x)
    read = nearest - [0.0, 0.0, nearest[0]]
    assert np.all((read >= span.low - 1e-9) & (read <= span.high + 1e-9))
    if inside:
        np.testing.assert_allclose(nearest, x, rtol=1e-12, atol=1e-9)
    np.testing.assert_array_equal(x, given_x)


def test_where_the_joint_stands_does_not_matter():
    span = Span(INPUTS, 0.1)
    for place in (0.0, 40.0, -1e4):
        assert span.covers(np.array([place, 0.0, place + 0.33]))
        assert list(span.outside(np.array([place, 0.0, place + 0.35]))) == [2]
    for number in (np.nan, np.inf):
        assert not span.covers(np.array([number, 0.0, number]))


def test_a_made_up_motion_is_inside():
    card = replace(card_of(), joints=("a",), inputs=INPUTS, outputs=(replace(card_of().outputs[0], base=0),))
    span = Span(card.inputs, card.margin)
    assert all(span.covers(row) for row in _motion(card))


def test_a_distance_needs_two():
    with pytest.raises(ConfigError, match="relative to an input that is not there"):
        replace(card_of(), inputs=(INPUTS[2],), outputs=(replace(card_of().outputs[0], base=0),))
