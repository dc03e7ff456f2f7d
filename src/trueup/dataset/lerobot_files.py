"""Files of a LeRobot dataset while it is written: numbered tables, metadata."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

FILES_PER_CHUNK = 1000


class NumberedFiles:
    """A numbered sequence of Parquet files of one schema, one open at a time; a row group per write.

    Args:
        folder: folder of the dataset.
        template: path below it, with `chunk_index` and `file_index`.

    Attributes:
        chunk_index: chunk of the file that is written.
        file_index: its number in the chunk.
        bytes: uncompressed size of what it holds.
        rows: its rows.
        paths: all files so far.
    """

    def __init__(self, folder: Path, template: str) -> None:
        self._folder = folder
        self._template = template
        self._writer: Any = None
        self.chunk_index = self.file_index = 0
        self.bytes = self.rows = 0
        self.paths: list[Path] = []

    def write(self, table: pa.Table) -> None:
        """Append the rows as one row group."""
        if self._writer is None:
            name = self._template.format(chunk_index=self.chunk_index, file_index=self.file_index)
            self.paths.append(self._folder / name)
            self.paths[-1].parent.mkdir(parents=True, exist_ok=True)
            self._writer = pq.ParquetWriter(self.paths[-1], table.schema, compression="snappy")
        self._writer.write_table(table, row_group_size=max(table.num_rows, 1))
        self.bytes += table.nbytes
        self.rows += table.num_rows

    def roll(self) -> None:
        """Close this file; the next write begins the next one."""
        self.close()
        self.bytes = self.rows = 0
        self.file_index += 1
        if self.file_index == FILES_PER_CHUNK:
            self.chunk_index, self.file_index = self.chunk_index + 1, 0

    def close(self) -> None:
        """Finish the file that is open, if one is."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None


def write_tasks(path: Path, task: str) -> None:
    """The table of tasks. LeRobot reads it with pandas and expects the task as the index, which pandas finds here."""
    text = {"pandas_type": "unicode", "numpy_type": "object", "metadata": None}
    number = {"pandas_type": "int64", "numpy_type": "int64", "metadata": None}
    index = {
        "index_columns": ["task"],
        "column_indexes": [{"name": None, "field_name": None, **text, "metadata": {"encoding": "UTF-8"}}],
        "columns": [
            {"name": "task_index", "field_name": "task_index", **number},
            {"name": "task", "field_name": "task", **text},
        ],
        "creator": {"library": "pyarrow", "version": pa.__version__},
        "pandas_version": "2.2.0",
    }
    table = pa.table({"task_index": pa.array([0], pa.int64()), "task": pa.array([task], pa.string())})
    pq.write_table(table.replace_schema_metadata({"pandas": json.dumps(index)}), path)
