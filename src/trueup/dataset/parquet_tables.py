"""Parquet files from strangers: pages are added up before they are read, and texts before they are written out.

A value that is repeated costs nothing in a file, nor does a list of such values. A text of 100 kB that a million rows
refer to takes 100 kB in a file and 100 GB as a column of texts. So texts are read as dictionaries, which are no larger
than in the file.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from trueup.core import unpacking
from trueup.dataset.parquet_pages import pages
from trueup.dataset.shards import refuse_values, row_groups
from trueup.errors import DataError

_FEW_ROWS = 100_000
_BYTES_PER_BYTE = 200


def believable(file: pq.ParquetFile, path: Path, columns: Collection[str]) -> pq.ParquetFile:
    """The file, unless these columns hold values by the million for every kilobyte, or unpack to much more than it is.

    Raises:
        DataError: they do, or the file contradicts itself.
    """
    groups, size = row_groups(file, path), path.stat().st_size
    read = [k for k in range(len(file.schema)) if _is_of(file.schema.column(k).path, columns)]
    chunks = [group.column(k) for group in groups for k in read]
    # A list has many values in a row.
    refuse_values(path, sum(abs(chunk.num_values) for chunk in chunks))
    if sum(abs(chunk.total_compressed_size) for chunk in chunks) > size:
        raise DataError(f"{path} contradicts itself", got="columns that are larger than the file")
    unpacked = 0
    with path.open("rb") as raw:
        for chunk in chunks:
            found = list(pages(raw, chunk))
            values = sum(page.values for page in found)
            if values != chunk.num_values:
                raise DataError(
                    f"{path} contradicts itself",
                    got=f"{chunk.num_values} values of {chunk.path_in_schema}, and {values} in their pages",
                )
            unpacked += sum(page.unpacked for page in found)
    _refuse_bytes(path, unpacked, size)
    return file


def read_table(file: pq.ParquetFile, path: Path, columns: Sequence[str]) -> pa.Table:
    """Columns of a small file, as far as they are there; texts come as dictionaries.

    Args:
        file: open.
        path: where it is.
        columns: their names.

    Raises:
        DataError: the file is not believable; there are more rows than bytes in it; a column holds neither numbers nor
            texts.
    """
    size = path.stat().st_size
    believable(file, path, columns)
    if file.metadata.num_rows > max(_FEW_ROWS, size):
        raise DataError(f"{path} claims more than a file of its size can hold", got=f"{file.metadata.num_rows} rows")
    texts = [k for k in range(len(file.schema)) if file.schema.column(k).physical_type == "BYTE_ARRAY"]
    with pq.ParquetFile(
        path, metadata=file.metadata, read_dictionary=texts, pre_buffer=False, page_checksum_verification=True
    ) as own:
        kinds = {name: own.schema_arrow.field(name).type for name in columns if name in own.schema_arrow.names}
        for name, kind in kinds.items():
            if not _is_countable(kind):
                expected = "numbers, texts, or lists of them"
                raise DataError(f"{path}: {name} is of another kind", got=str(kind), expected=expected)
        table = own.read(columns=list(kinds), use_threads=False)
    _refuse_bytes(path, sum(_text_bytes(chunk) for column in table.columns for chunk in column.chunks), size)
    return table


def _is_of(path: str, columns: Collection[str]) -> bool:
    """Whether something in a schema, `tasks.list.element`, belongs to one of these columns."""
    return any(path == name or path.startswith(f"{name}.") for name in columns)


def _refuse_bytes(path: Path, unpacked: int, size: int) -> None:
    if unpacked > max(unpacking.FEW_BYTES, _BYTES_PER_BYTE * size):
        raise DataError(f"{path} claims more than a file of its size can hold", got=f"{unpacked} bytes")


def _is_countable(kind: pa.DataType) -> bool:
    if is_list(kind):
        return _is_countable(kind.value_type)
    if pa.types.is_dictionary(kind):
        return kind.value_type in (pa.string(), pa.large_string(), pa.binary(), pa.large_binary())
    return bool(pa.types.is_primitive(kind) or pa.types.is_boolean(kind) or pa.types.is_null(kind))


def _text_bytes(array: pa.Array) -> int:
    """The bytes of all texts, once they are written out."""
    if is_list(array.type):
        return _text_bytes(array.flatten())
    if not pa.types.is_dictionary(array.type):
        return 0
    return int(pc.sum(pc.binary_length(array.dictionary).take(array.indices)).as_py() or 0)


def is_list(kind: pa.DataType) -> bool:
    """Whether it is a kind of list."""
    return bool(pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind))
