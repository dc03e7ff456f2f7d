"""Columns at other times."""

import numpy as np
import pytest

from trueup.core.interpolation import columns_at


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_lines_stay_lines_and_ends_are_held(kind):
    clock = np.array([0.0, 0.5, 2.0])
    values = np.stack([3.0 * clock - 1.0, -clock], axis=1).astype(kind)
    time_s = np.array([-1.0, 0.0, 0.25, 1.1, 2.0, 5.0])
    inside = np.clip(time_s, 0.0, 2.0)
    found = columns_at(time_s, clock, values)
    assert found.dtype == np.float64
    assert found == pytest.approx(np.stack([3.0 * inside - 1.0, -inside], axis=1), rel=1e-6)
