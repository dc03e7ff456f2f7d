"""Orientations in six numbers: any six are a rotation, and a rotation comes back as it was."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from trueup.augment.rotations import refuse_no_rotation, rotation_of, six_of
from trueup.errors import DataError

NUMBERS = st.lists(st.floats(-1e30, 1e30, width=64), min_size=6, max_size=6)


def is_rotation(matrix, tolerance=1e-9):
    np.testing.assert_allclose(matrix.T @ matrix, np.eye(3), atol=tolerance)
    assert np.linalg.det(matrix) == pytest.approx(1.0, abs=tolerance)


@given(NUMBERS)
def test_any_six_numbers_are_a_rotation(six):
    is_rotation(rotation_of(np.array(six, np.float64)))


@pytest.mark.parametrize(
    "six",
    [
        [0, 0, 0, 0, 0, 0],
        [1, 2, 3, 2, 4, 6],
        [1, 2, 3, -1, -2, -3],
        [0, 0, 0, 1, 0, 0],
        [1e-30, 0, 0, 0, 1e-30, 0],
        [1, 0, 0, 1, 1e-13, 0],
        [1e300, 1e300, 0, -1e300, 1e300, 1e-300],
    ],
)
def test_six_numbers_that_say_nothing_are_one_too(six):
    is_rotation(rotation_of(np.array(six, np.float64)))


def test_two_columns_that_are_nearly_parallel_lose_no_digits():
    """Of the second column nothing but a billionth lies across the first: most digits of it are rounding."""
    rng = np.random.default_rng(2)
    first = rng.normal(size=(50, 3))
    for matrix in rotation_of(np.concatenate([first, first + 1e-8 * rng.normal(size=(50, 3))], axis=1)):
        is_rotation(matrix, 1e-12)


def test_a_rotation_comes_back():
    rotations = Rotation.random(200, rng=3).as_matrix()
    six = six_of(rotations)
    assert six.shape == (200, 6)
    np.testing.assert_allclose(rotation_of(six), rotations, atol=1e-12)
    np.testing.assert_array_equal(six[0], [*rotations[0, :, 0], *rotations[0, :, 1]])


def test_gram_schmidt_keeps_the_first_column_and_the_plane_of_both():
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=(2, 50, 3))
    made = rotation_of(np.concatenate([first, second], axis=1))
    np.testing.assert_allclose(np.cross(made[:, :, 0], first), 0, atol=1e-12)
    np.testing.assert_allclose((made[:, :, 2] * second).sum(axis=1), 0, atol=1e-12)
    assert ((made[:, :, 1] * second).sum(axis=1) > 0).all()


def test_what_is_no_rotation_is_refused():
    rotations = Rotation.random(5, rng=1).as_matrix()
    refuse_no_rotation(rotations.astype(np.float32), "here")
    missing = rotations.copy()
    missing[2] = np.nan
    refuse_no_rotation(missing, "here")
    for wrong in (1.01 * rotations, -rotations, np.zeros((5, 3, 3)), np.swapaxes(rotations, 1, 2)[:, ::-1]):
        with pytest.raises(DataError, match="here: a rotation is none"):
            refuse_no_rotation(wrong, "here")
