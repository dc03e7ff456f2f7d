"""Observations are moved part by part, whatever their parts are."""

import numpy as np
import pytest

from trueup.policy.moved_observation import moved


def test_numbers_are_moved_by_the_difference():
    np.testing.assert_allclose(moved(np.array([5.0, 7.0]), np.array([1.0, 2.0]), np.array([1.5, 2.0])), [5.5, 7.0])


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.int32, np.uint8])
def test_kinds_of_numbers_stay(kind):
    seen = moved(np.array([5, 200], kind), np.array([5, 100], kind), np.array([7, 99], kind))
    assert seen.dtype == kind
    np.testing.assert_array_equal(seen, [7, 199])


def test_what_does_not_differ_stays_bit_by_bit():
    odd = np.array([0.1, np.inf, 1e-300])
    np.testing.assert_array_equal(moved(odd, np.array([0.3, np.inf, 1e300]), np.array([0.3, np.inf, 1e300])), odd)


def test_switches_are_those_of_the_corrected_state_where_they_differ():
    before, after = np.array([True, True, False]), np.array([True, False, False])
    assert moved(np.array([True, True, True]), before, after).tolist() == [True, False, True]
    assert moved("near", "near", "far") == "far"


def test_parts_in_parts():
    seen = moved(
        {"pair": (np.zeros(2), np.int64(3)), "near": np.bool_(True)},
        {"pair": (np.zeros(2), np.int64(3)), "near": np.bool_(True)},
        {"pair": (np.ones(2), np.int64(4)), "near": np.bool_(False)},
    )
    assert isinstance(seen["pair"], tuple)
    assert (seen["pair"][0].tolist(), int(seen["pair"][1]), bool(seen["near"])) == ([1.0, 1.0], 4, False)
