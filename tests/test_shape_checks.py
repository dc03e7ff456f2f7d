"""Shapes are checked in every test: in the first calls of a function, of which there are enough."""

import jaxtyping
import numpy as np
import pytest

from shape_checks import CALLS, begin_test
from trueup.core.interpolation import columns_at


def interpolated(stamps):
    return columns_at(stamps, np.arange(3.0), np.zeros((3, 2)))


def test_a_wrong_shape_is_refused():
    with pytest.raises(jaxtyping.TypeCheckError):
        interpolated(np.zeros((4, 1)))


def test_it_is_refused_in_the_next_test_too_however_often_the_function_was_called():
    for _ in range(CALLS + 1):
        assert interpolated(np.zeros(4)).shape == (4, 2)
    begin_test()
    with pytest.raises(jaxtyping.TypeCheckError):
        interpolated(np.zeros((4, 1)))
