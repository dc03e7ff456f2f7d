from dataclasses import replace

import numpy as np
import pytest
from benchmarks.networks import card_of
from hypothesis import given
from hypothesis import strategies as st

from trueup.deploy import Confidence


def confidence_of(**changes):
    """Of a card whose outputs are all like this."""
    card = card_of()
    return Confidence(replace(card, outputs=tuple(replace(output, **changes) for output in card.outputs[:3])))


def test_half_widths_grow_with_the_correction():
    width = confidence_of(interval=(0.25, 0.5)).half_width(np.array([[0.0, -2.0, 2.0], [1.0, 0.0, 4.0]]))
    np.testing.assert_allclose(width, [[0.25, 1.25, 1.25], [0.75, 0.25, 2.25]])


def test_what_is_not_known_is_infinite_or_nan_and_warns_of_nothing():
    confidence = confidence_of(interval=None, far_correction=(), far_probability=())
    correction = np.array([0.0, 1.0, 1e6])
    assert np.isinf(confidence.half_width(correction)).all()
    assert np.isnan(confidence.far_off(correction)).all()
    assert not confidence.is_far_off(correction).any()


@given(
    st.lists(st.integers(1, 50), min_size=1, max_size=6),
    st.lists(st.integers(0, 10), min_size=6, max_size=6),
    st.lists(st.integers(-999, 999), min_size=3, max_size=3),
)
def test_the_warning_is_the_probability_above_one_half(gaps, rises, correction):
    size = np.cumsum(gaps) / 10
    probability = np.minimum(np.cumsum(rises)[: size.size] / 12, 1.0)
    confidence = confidence_of(far_correction=tuple(size), far_probability=tuple(probability))
    # Off the grid of sizes, so that no rounding decides.
    asked = np.array(correction) / 70 + 1e-5
    found = confidence.far_off(asked)
    np.testing.assert_allclose(found, np.interp(np.abs(asked), size, probability))
    clear = np.abs(found - 0.5) > 1e-9
    np.testing.assert_array_equal(confidence.is_far_off(asked)[clear], (found > 0.5)[clear])


@pytest.mark.parametrize(("probability", "expected"), [((0.6, 0.9), True), ((0.1, 0.5), False), ((0.1, 0.9), False)])
def test_the_warning_for_no_correction_at_all(probability, expected):
    confidence = confidence_of(far_correction=(0.0, 1.0), far_probability=probability)
    assert confidence.is_far_off(np.zeros(3)).all() == expected
