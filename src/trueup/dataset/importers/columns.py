"""Text columns of a CSV file, turned into numbers with errors that name file, line and column."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
from jaxtyping import Float64, Int64

from trueup.errors import DataError, NameMismatch

_NEWLINE = re.compile(rb"\r\n|\n|\r")
_LONGEST_HEADER = 1 << 20
_BLOCK = 1 << 24
_MISSING = pa.array(["", "nan", "na", "n/a", "null", "none"])


class TextTable:
    """A CSV file whose columns are still text.

    Args:
        path: where it came from, for error messages.
        data: its bytes; UTF-8, with or without byte order mark.
        delimiter: one character, or `whitespace` for any run of blanks.
        header: names of the columns if the file has no header line.
        skip_lines: lines before the header.

    Attributes:
        names: the columns' names.

    Raises:
        DataError: there is no header, or a name occurs twice.
    """

    def __init__(
        self, path: Path, data: bytes, *, delimiter: str = ",", header: Sequence[str] = (), skip_lines: int = 0
    ) -> None:
        self.path = path
        self._delimiter = delimiter
        start = 3 if data.startswith(b"\xef\xbb\xbf") else 0
        for _ in range(skip_lines):
            start = _line_end(data, start)[1]
        self._first_line = skip_lines + 1
        names = list(header)
        if not names:
            end, start_of_rows = _line_end(data, start)
            names = self._header(data[start:end])
            start = start_of_rows
            self._first_line += 1
        repeated = sorted({name for name in names if names.count(name) > 1 and name})
        if repeated:
            raise DataError(f"{path} has columns of the same name", got=repeated, available=names)
        self.names = tuple(names)
        self._rows = data[start:]

    def _header(self, line: bytes) -> list[str]:
        if len(line) > _LONGEST_HEADER:
            raise DataError(f"{self.path} has no header line that could be read", got=f"a line of {len(line)} bytes")
        try:
            text = line.decode()
            if self._delimiter == "whitespace":
                names = text.lstrip("#").split()
            else:
                names = next(csv.reader([text], delimiter=self._delimiter), [])
        except (UnicodeDecodeError, csv.Error) as error:
            raise DataError(f"the header of {self.path} cannot be read", got=error) from error
        names = [name.strip().lstrip("#").strip() for name in names]
        if not any(names):
            raise DataError(
                f"{self.path} is empty or has no header line", expected="names of columns in the first line"
            )
        return names

    def read(self, columns: Sequence[str]) -> dict[str, pa.StringArray]:
        """The text of these columns, one entry per row; empty lines are skipped.

        Raises:
            NameMismatch: a column is not there; both lists are printed.
            DataError: there are no rows, or a row has too many or too few fields.
        """
        missing = [name for name in columns if name not in self.names]
        if missing:
            raise NameMismatch(
                f"{self.path} has no column {', '.join(missing)}",
                left=columns,
                right=self.names,
                left_name="needed",
                right_name="the file has",
            )
        rows = self._rows
        if self._delimiter == "whitespace":
            # Runs first: an expression that begins with a run of any length takes hours for a megabyte of blanks.
            rows = re.sub(rb"[ \t]+", b" ", rows).lstrip(b" ")
            rows = re.sub(rb" ?(\r?\n|\Z) ?", rb"\1", rows).replace(b" ", b",")
        if not rows.strip():
            raise DataError(f"{self.path} has a header but no rows")
        try:
            rows.decode()  # pyarrow prints to stderr when a row of the wrong length is not UTF-8
        except UnicodeDecodeError as error:
            line = self._first_line + len(_NEWLINE.findall(rows, 0, error.start))
            raise DataError(f"{self.path} is not UTF-8 text", got=f"{error.reason} in line {line}") from error
        wrong: list[pyarrow.csv.InvalidRow] = []

        def note(row: pyarrow.csv.InvalidRow) -> str:
            wrong.append(row)
            return "error"

        # Names of ours, so that nameless columns of the file cannot collide.
        own = [str(number) for number in range(len(self.names))]
        wanted = [own[self.names.index(name)] for name in columns]
        try:
            table = pyarrow.csv.read_csv(
                pa.BufferReader(rows),
                read_options=pyarrow.csv.ReadOptions(use_threads=False, block_size=_BLOCK, column_names=own),
                parse_options=pyarrow.csv.ParseOptions(
                    delimiter="," if self._delimiter == "whitespace" else self._delimiter,
                    invalid_row_handler=note,
                ),
                convert_options=pyarrow.csv.ConvertOptions(
                    column_types=dict.fromkeys(own, pa.string()), include_columns=sorted(set(wanted), key=int)
                ),
            )
            chunked = {name: table[key].combine_chunks() for name, key in zip(columns, wanted, strict=True)}
        except pa.ArrowException as error:
            if wrong:
                row = wrong[0]
                where = f" in line {self.line(row.number - 1)}" if row.number is not None else ""
                raise DataError(
                    f"{self.path} has a row of the wrong length{where}",
                    got=f"{row.actual_columns} fields",
                    expected=row.expected_columns,
                    hint="The file may be truncated.",
                ) from error
            raise DataError(f"{self.path} cannot be read as CSV", got=error) from error
        # An unclosed quote would swallow the lines up to the next one without a word.
        if b'"' in rows and sum(map(bool, rows.splitlines())) != table.num_rows:
            raise DataError(f"{self.path} has a quoted value that runs over a line end", expected="closed quotes")
        return {name: column if isinstance(column, pa.Array) else column.chunk(0) for name, column in chunked.items()}

    def line(self, row: int) -> int:
        """The line of the file that holds a row, both the first line and the first row counted from 1 and 0."""
        seen = -1
        for number, line in enumerate(_NEWLINE.split(self._rows), start=self._first_line):
            seen += bool(line)
            if seen == row:
                return number
        return self._first_line + row

    def floats(self, column: str, text: pa.StringArray) -> Float64[np.ndarray, "N"]:
        """Numbers of one column; an empty cell, NA and NaN are missing samples (NaN).

        Raises:
            DataError: a cell is not a number, or infinite.
        """
        trimmed = pc.ascii_trim_whitespace(text)
        missing = pc.is_in(pc.ascii_lower(trimmed), value_set=_MISSING)
        numbers = self.cast(column, pc.if_else(missing, "nan", trimmed))
        infinite = np.isinf(numbers)
        if infinite.any():
            row = int(np.argmax(infinite))
            self.refuse(column, row, text[row].as_py(), expected="a finite number")
        return numbers

    def ticks(self, column: str, text: pa.StringArray) -> Int64[np.ndarray, "N"] | Float64[np.ndarray, "N"]:
        """Stamps of one column, as integers if all of them are: nanoseconds since 1970 need every digit."""
        try:
            return np.asarray(pc.ascii_trim_whitespace(text).cast(pa.int64()).to_numpy(zero_copy_only=False))
        except pa.ArrowException:
            return self.floats(column, text)

    def cast(self, column: str, text: pa.StringArray, *, per_row: int = 1) -> Float64[np.ndarray, "N"]:
        """Text to float64, by the rules of `strtod` in the C locale.

        Args:
            column: name of the column, for the error message.
            text: N numbers.
            per_row: how many of them come from one row of the file.

        Raises:
            DataError: a text is not a number.
        """
        try:
            return np.asarray(text.cast(pa.float64()).to_numpy(zero_copy_only=False), dtype=np.float64)
        except pa.ArrowException:
            failing = _first_that_fails(text)
            self.refuse(column, failing // per_row, text[failing].as_py(), expected="a number")

    def refuse(self, column: str, row: int, value: object, *, expected: str) -> NoReturn:
        """Raise a DataError about one cell, with its line."""
        raise DataError(
            f"{self.path}, line {self.line(row)}, column {column!r} cannot be used",
            got=repr(value)[:80],
            expected=expected,
        )


def _first_that_fails(text: pa.StringArray) -> int:
    """Index of the first entry that is not a number, by bisection; one of them must fail."""
    low, high = 0, len(text)
    while high - low > 1:
        middle = (low + high) // 2
        try:
            text.slice(low, middle - low).cast(pa.float64())
        except pa.ArrowException:
            high = middle
        else:
            low = middle
    return low


def _line_end(data: bytes, start: int) -> tuple[int, int]:
    """Where the line that begins at `start` ends, and where the next one begins."""
    newline = _NEWLINE.search(data, start)
    return newline.span() if newline else (len(data), len(data))
