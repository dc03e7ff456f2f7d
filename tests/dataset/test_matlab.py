"""Our reader of .mat files says what scipy's does, and survives what ends scipy's process."""

import io

import numpy as np
import pytest
import scipy.io

from trueup.dataset.importers.matlab import is_mat5, read_mat5

VARIABLES = {
    "t": np.arange(5.0),
    "q": np.random.default_rng(0).normal(size=(5, 3)),
    "pages": np.random.default_rng(1).normal(size=(2, 3, 4)),
    "ticks": np.arange(3, dtype=np.int16),
    "on": np.array([True, False]),
    "names": np.array(["a", "bc"], object),
    "text": "grüße",
    "lines": np.array(["ab", "cde"]),
    "log": {"a": np.arange(4.0), "deep": {"x": 3.0, "n": "hello"}},
}
MOST = 1 << 20


def saved(variables, *, packed=False):
    file = io.BytesIO()
    scipy.io.savemat(file, variables, do_compression=packed)
    return file.getvalue()


def same(own, other):
    if isinstance(other, dict):
        assert own.keys() == other.keys()
        for key, value in other.items():
            same(own[key], value)
        return
    other = np.asarray(other)
    if other.dtype.kind in "UO":
        assert [str(word) for word in own.reshape(-1)] == [str(word).rstrip() for word in other.reshape(-1)]
    else:
        np.testing.assert_array_equal(own, other)


@pytest.mark.parametrize("packed", [False, True])
def test_the_same_as_scipy(packed):
    data = saved(VARIABLES, packed=packed)
    assert is_mat5(data)
    theirs = scipy.io.loadmat(io.BytesIO(data), simplify_cells=True)
    same(read_mat5(data, MOST), {name: value for name, value in theirs.items() if not name.startswith("__")})


def test_complex_numbers_are_no_columns():
    assert set(read_mat5(saved({"z": np.array([1 + 2j]), "x": 1.0}), MOST)) == {"x"}


@pytest.mark.parametrize("shape", [(2,), (2, 3)])
def test_arrays_of_structs_are_structs_in_their_order(shape):
    structs = np.zeros(shape, dtype=[("a", float), ("b", "O")])
    structs["a"], structs["b"] = np.arange(structs.size).reshape(shape), "word"
    data = saved({"s": structs})
    theirs = scipy.io.loadmat(io.BytesIO(data))["s"].ravel(order="F")
    own = read_mat5(data, MOST)["s"]
    assert [float(one["a"]) for one in own] == [float(one["a"].item()) for one in theirs]
    assert {str(one["b"]) for one in own} == {"word"}


@pytest.mark.parametrize("kind", [0, 8, 10, 14, 41, 2049])
def test_kinds_of_numbers_that_there_are_not(kind):
    data = bytearray(saved({"t": np.arange(5.0)}))
    place = data.index(np.arange(5.0).tobytes()) - 8
    data[place : place + 2] = kind.to_bytes(2, "little")
    with pytest.raises(ValueError, match="kind"):
        read_mat5(bytes(data), MOST)


def test_what_unpacks_to_more_than_is_believed_is_refused():
    with pytest.raises(ValueError, match="unpacks to more"):
        read_mat5(saved({"x": np.zeros(10 * MOST // 8)}, packed=True), MOST)
