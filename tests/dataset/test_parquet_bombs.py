"""Parquet files of some kB that would fill the memory: each is refused before it is read."""

import secrets
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from dataset.store_cases import INFO, make_episode
from dataset.test_import_lerobot import ARM, foreign, load, values
from trueup.dataset import Dataset, DatasetWriter
from trueup.dataset.parquet_pages import pages
from trueup.dataset.parquet_tables import believable, read_table
from trueup.dataset.writer import dataset_spec
from trueup.errors import DataError

LONG = "x" * 100_000
TOO_MUCH = "claims more than a file of its size can hold"


def repeated(rows, text=LONG):
    """A column of which a file holds one text."""
    return pa.DictionaryArray.from_arrays(np.zeros(rows, np.int32), [text])


def write(table, path):
    with pq.ParquetWriter(path, table.schema, store_schema=False) as writer:
        writer.write_table(table)
        writer.add_key_value_metadata(table.schema.metadata or {})
    assert path.stat().st_size < 2_000_000


def logs(folder: Path) -> tuple[Path, Path, Path]:
    """Good ones, the file with their frames, and their list of episodes."""
    foreign(folder / "d", {"observation.state": (ARM, values(3)), "action": (ARM, values(3, 1))})
    name = "chunk-000/file-000.parquet"
    return folder / "d", folder / "d/data" / name, folder / "d/meta/episodes" / name


def test_one_row_with_a_list_without_end(tmp_path):
    folder, frames, _ = logs(tmp_path)
    table = pq.read_table(frames).slice(0, 1)
    long = pa.ListArray.from_arrays([0, 1 << 24], np.zeros(1 << 24, np.float32))
    write(table.set_column(table.column_names.index("action"), "action", long), frames)
    with pytest.raises(DataError, match=TOO_MUCH):
        load(folder)


def test_numbers_that_are_texts(tmp_path):
    folder, frames, _ = logs(tmp_path)
    table = pq.read_table(frames)
    write(table.set_column(table.column_names.index("action"), "action", repeated(len(table))), frames)
    with pytest.raises(DataError, match="action has values that are no numbers"):
        load(folder)


def test_a_text_for_many_episodes(tmp_path):
    folder, _, episodes = logs(tmp_path)
    rows = 50_000
    table = pa.table(
        {
            "episode_index": np.arange(rows),
            "data/chunk_index": np.zeros(rows, np.int64),
            "data/file_index": np.zeros(rows, np.int64),
            "length": np.zeros(rows, np.int64),
            "trueup/condition": repeated(rows),
        }
    )
    write(table, episodes)
    with pytest.raises(DataError, match=rf"{TOO_MUCH}.*{rows * len(LONG)} bytes"):
        load(folder)


def test_more_episodes_than_bytes(tmp_path):
    folder, _, episodes = logs(tmp_path)
    rows = 1_000_000
    names = ("episode_index", "data/chunk_index", "data/file_index", "length")
    write(pa.table(dict.fromkeys(names, np.zeros(rows, np.int64))), episodes)
    with pytest.raises(DataError, match=rf"{TOO_MUCH}.*{rows} rows"):
        load(folder)


def test_an_episode_that_claims_to_be_long(tmp_path):
    folder, _, episodes = logs(tmp_path)
    table = pq.read_table(episodes)
    write(table.set_column(table.column_names.index("length"), "length", pa.array([20, 1 << 39])), episodes)
    with pytest.raises(DataError, match="not complete"):
        load(folder)


@pytest.fixture
def dataset(tmp_path):
    with DatasetWriter.create(tmp_path / "d", INFO) as writer:
        for number in range(2):
            writer.append(make_episode(number, samples=20))
    return tmp_path / "d"


def test_a_text_for_many_rows_of_an_index(dataset):
    index = dataset_spec(dataset).index_path
    rows = 3000
    table = pa.concat_tables([pq.read_table(index).slice(0, 1)] * rows)
    for name, column in {
        "id": pa.array([f"e{number}" for number in range(rows)]),
        "hash": pa.array([secrets.token_hex(32) for _ in range(rows)]),
        "flags": repeated(rows),
    }.items():
        table = table.set_column(table.column_names.index(name), name, column)
    write(table, index)
    with pytest.raises(DataError, match=rf"{TOO_MUCH}.*300\d* bytes"):
        Dataset(dataset)


def changed_footer(path, old, new):
    """Other numbers in the description at the end of a file."""
    data = path.read_bytes()
    at = data.rindex(old)
    path.write_bytes(data[:at] + new + data[at + len(new) :])


def test_a_footer_that_contradicts_itself(tmp_path):
    path = tmp_path / "a.parquet"
    pq.write_table(pa.table({"a": np.arange(20)}), path)
    assert believable(pq.ParquetFile(path), path, ["a"])
    changed_footer(path, b"\x16\x28\x19", b"\x16\x26\x19")  # 20 rows become 19, those of its one part do not
    with pytest.raises(DataError, match=r"contradicts itself.*19 rows, and 20"):
        believable(pq.ParquetFile(path), path, ["a"])


def test_a_column_of_a_shard_that_claims_more_than_its_episode(dataset):
    assert len(Dataset(dataset)[1].measured) == 20
    changed_footer(dataset / "measured" / "00000.parquet", b"\x16\x28\x16", b"\x16\x2a\x16")
    with pytest.raises(DataError, match="row group 1 is not the one of the index"):
        _ = Dataset(dataset)[1]


def test_texts_that_are_repeated_are_read(tmp_path):
    """Honest tables repeat a lot: none of them is near the limits."""
    rows = 20_000
    table = pa.table({"id": [f"episode-{k}" for k in range(rows)], "flags": ["[" + "x" * 1000 + "]"] * rows})
    table = table.append_column("tasks", pa.array([["pick", "place"]] * rows))
    path = tmp_path / "a.parquet"
    pq.write_table(table, path)
    read = read_table(pq.ParquetFile(path), path, ["id", "flags", "tasks", "unit"])
    assert read.to_pylist() == table.to_pylist()


def test_pages_that_hold_more_than_the_description_says(tmp_path):
    """A library that reads a list goes on to its end, whatever the description says."""
    path = tmp_path / "a.parquet"
    pq.write_table(pa.table({"a": [list(range(100))]}), path)
    assert believable(pq.ParquetFile(path), path, ["a"])
    changed_footer(path, b"\x16\xc8\x01\x16", b"\x16\xc6\x01\x16")
    with pytest.raises(DataError, match=r"contradicts itself.*99 values of a\.list\.element, and 100"):
        believable(pq.ParquetFile(path), path, ["a"])
    assert believable(pq.ParquetFile(path), path, ["b"])


def test_a_page_that_unpacks_to_much_more_than_the_file(tmp_path, monkeypatch):
    monkeypatch.setattr("trueup.core.unpacking.FEW_BYTES", 1 << 20)
    path = tmp_path / "a.parquet"
    pq.write_table(pa.table({"a": np.zeros(1 << 18)}), path, use_dictionary=False, compression="zstd")
    with pytest.raises(DataError, match=rf"{TOO_MUCH}.* bytes"):
        read_table(pq.ParquetFile(path), path, ["a"])


@pytest.mark.parametrize("version", ["1.0", "2.0"])
@pytest.mark.parametrize("compression", ["none", "snappy", "zstd"])
@pytest.mark.parametrize("use_dictionary", [True, False])
def test_pages_are_those_that_were_written(tmp_path, version, compression, use_dictionary):
    path = tmp_path / "a.parquet"
    rng = np.random.default_rng(0)
    lists = [list(range(int(count))) or None for count in rng.integers(0, 9, 3000)]
    table = pa.table({"a": rng.normal(size=3000), "b": [f"{k}" * 9 for k in range(3000)], "c": lists})
    pq.write_table(
        table, path, data_page_version=version, compression=compression, use_dictionary=use_dictionary,
        row_group_size=1700, data_page_size=2000, write_batch_size=100, write_page_checksum=True,
    )  # fmt: skip
    metadata = pq.ParquetFile(path).metadata
    with path.open("rb") as raw:
        for group in (metadata.row_group(k) for k in range(metadata.num_row_groups)):
            for chunk in map(group.column, range(group.num_columns)):
                found = list(pages(raw, chunk))
                assert len(found) > 2
                assert sum(page.values for page in found) == chunk.num_values
                # The description counts the headers, too: a hundred bytes or two each.
                assert 0 <= chunk.total_uncompressed_size - sum(page.unpacked for page in found) < 400 * len(found)
    assert read_table(pq.ParquetFile(path), path, ["a", "b", "c"]).to_pylist() == table.to_pylist()


@pytest.mark.parametrize("junk", [bytes(100), b"\xff" * 100, b"\x1c" * 100, b"\x19" * 100, b"\x18\xff\xff\xff\x7f"])
def test_what_is_no_page_is_refused(tmp_path, junk):
    path = tmp_path / "a.parquet"
    pq.write_table(pa.table({"a": np.arange(100)}), path, use_dictionary=False)
    data = path.read_bytes()
    path.write_bytes(data[:4] + junk + data[4 + len(junk) :])
    with pytest.raises(ValueError, match="header of a page"), path.open("rb") as raw:
        list(pages(raw, pq.ParquetFile(path).metadata.row_group(0).column(0)))
