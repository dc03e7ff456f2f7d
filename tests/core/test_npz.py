"""npz files that are made to hurt; `dataset/test_import_npz.py` has those that are only broken."""

import io
import resource
import zipfile

import numpy as np
import pytest

from trueup.core.npz import arrays_of, read_arrays
from trueup.errors import DataError

HEADER = b"\x93NUMPY\x01\x00"


def header(shape):
    text = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}}}\n".encode()
    return HEADER + len(text).to_bytes(2, "little") + text


def bomb(path, gigabytes):
    """Zeros: a thousandth of them on disk; each array is of the size that its header says."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for number in range(gigabytes):
            with archive.open(f"{number}.npy", "w", force_zip64=True) as file:
                file.write(header(((1 << 30) // 4,)))
                for _ in range(64):
                    file.write(bytes(1 << 24))


def claiming(path, size):
    """A small file whose directory says that it unpacks to `size` bytes, and whose header agrees."""
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.npy", header((size // 4,)) + bytes(1000))
        archive.filelist[0].file_size = size  # what its central directory is written from
    path.write_bytes(data.getvalue())


def most_bytes():
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


@pytest.mark.long
def test_zeros_that_unpack_to_gigabytes_are_refused_before_memory_is_taken(tmp_path):
    bomb(tmp_path / "x.npz", 1)
    assert (tmp_path / "x.npz").stat().st_size < 2_000_000
    before = most_bytes()
    with pytest.raises(DataError, match=r"x\.npz claims to unpack to 10737\d+ bytes"):
        read_arrays(tmp_path / "x.npz")
    assert most_bytes() - before < 1 << 28


@pytest.mark.parametrize("size", [1 << 31, (1 << 32) - 4])
def test_a_directory_that_claims_much_is_not_believed(size, tmp_path):
    claiming(tmp_path / "x.npz", size)
    before = most_bytes()
    with pytest.raises(DataError, match="claims to unpack"):
        read_arrays(tmp_path / "x.npz")
    assert most_bytes() - before < 1 << 28


def test_a_header_that_claims_terabytes_is_not_believed(tmp_path):
    with zipfile.ZipFile(tmp_path / "x.npz", "w") as archive:
        archive.writestr("a.npy", header((10**12,)) + bytes(1000))
    before = most_bytes()
    with pytest.raises(DataError, match=r"'a\.npy' is truncated or too large"):
        read_arrays(tmp_path / "x.npz")
    assert most_bytes() - before < 1 << 28


def test_arrays_come_back(tmp_path):
    rng = np.random.default_rng(0)
    made = {"a": rng.normal(size=(3, 4)), "b": np.arange(5), "c": np.zeros((100, 100))}
    np.savez_compressed(tmp_path / "x.npz", **made)
    for read in (read_arrays(tmp_path / "x.npz"), arrays_of((tmp_path / "x.npz").read_bytes(), tmp_path / "x.npz")):
        assert read.keys() == made.keys()
        assert all(np.array_equal(read[name], made[name]) for name in made)


def test_no_file(tmp_path):
    (tmp_path / "x.npz").mkdir()
    for name in ("x.npz", "missing.npz"):
        with pytest.raises(DataError, match=rf"cannot read .*{name}"):
            read_arrays(tmp_path / name)
