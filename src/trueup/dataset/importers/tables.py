"""Files as tables: columns of numbers by name, whatever the file's format.

A column is a number per row, or a vector per row, such as a cell `[0.1, 0.2]`, a list of a Parquet file, or an array of
T x K numbers. `name[3]` is the fourth component of the vectors `name`.
"""

from __future__ import annotations

import contextlib
import io
import itertools
import json
import math
import re
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import pyarrow.compute as pc
import pyarrow.parquet as pq
from jaxtyping import Float64, Shaped

from trueup.core.npz import array_of, arrays_of
from trueup.core.unpacking import most_bytes
from trueup.dataset.importers.files import inside, read_bytes, refuse_pickle
from trueup.dataset.importers.matlab import is_mat5, read_mat5
from trueup.dataset.importers.text_table import (
    IS_DATE,
    Head,
    TextTable,
    dates,
    head_in,
    refuse_missing,
    split_component,
)
from trueup.dataset.parquet_tables import is_list, read_table
from trueup.errors import DataError, MissingDependency

if TYPE_CHECKING:
    from trueup.dataset.importers.mapping import TableMapping

# How pandas stores a frame: names of columns, values of all columns of a kind, names of rows.
_BLOCK_OF_PANDAS = re.compile(r"(?P<block>block\d{1,4})_(?P<what>values)|(block\d{1,4}_items)|axis0|(?P<axis>axis1)")
_NUMBER_BYTES, _TIMES_IN_MEMORY = 8, 20
_DEEPEST = 16
# Where records say which message they are.
_KINDS, _MOST_KINDS = ("type", "topic", "channel", "kind", "msg"), 20
_LONGEST_HEAD = 300  # of a sheet, in rows
# No sheet has more rows.
_MOST_COLUMNS, _MOST_ROWS = 100_000, 1 << 20
# Files of arrays that may be one recording.
_MOST_FILES = 64


class ArrayTable:
    """Columns that are arrays; methods as those of `TextTable`.

    Args:
        path: where they are from.
        names: of the columns.
        read: a column by its name: numbers or texts, the first axis the rows; a single number is one row.
        files: all that they are from, where that is more than one.
    """

    cut = ""

    def __init__(
        self,
        path: Path,
        names: Sequence[str],
        read: Callable[[str], Shaped[np.ndarray, "..."]],
        files: Sequence[Path] = (),
    ) -> None:
        self.path, self.names, self.files = path, tuple(names), tuple(files) or (path,)
        self._read = read
        self._arrays: dict[str, Shaped[np.ndarray, "..."]] = {}
        self._stamps = 0  # of the clock, once it was read: where arrays have a sample in each column, it says so

    def load(self, columns: Sequence[str]) -> None:
        """See `TextTable`."""
        wanted = {split_component(name, self.names)[0] for name in columns}
        refuse_missing(self.path, columns, self.names)
        self._arrays |= {name: np.asarray(self._read(name)) for name in sorted(wanted - set(self._arrays))}

    def numbers(self, column: str) -> Float64[np.ndarray, "N *K"]:
        """See `TextTable`."""
        name, component = split_component(column, self.names)
        array = np.atleast_1d(self._arrays[name])
        if array.dtype.kind not in "fiub":
            raise DataError(f"{self.path}: {name} holds no numbers", got=array.dtype, expected="numbers")
        if array.ndim > 1 and array.shape[0] == 1 and array.ndim == 2:
            array = array[0] if component is None else array  # a row of MATLAB
        if not array.size:
            raise DataError(f"{self.path}: {name} is empty", got=f"shape {array.shape}", expected="numbers")
        if array.ndim == 2 and len(array) < array.shape[1] == self._stamps:
            array = array.T
        if array.ndim > 2:
            array = array.reshape(len(array), -1)
        if component is not None:
            if array.ndim < 2 or not component < array.shape[1]:
                raise DataError(f"{self.path}: {name} has no component {component}", got=f"shape {array.shape}")
            array = array[:, component]
        numbers = array.astype(np.float64)
        if np.isinf(numbers).any():
            raise DataError(f"{self.path}: {name} has values that are infinite", expected="finite numbers")
        return np.asarray(numbers)

    def ticks(self, column: str) -> tuple[Shaped[np.ndarray, "N"], bool]:
        """See `TextTable`."""
        array = np.atleast_1d(np.squeeze(self._arrays[split_component(column, self.names)[0]]))
        self._stamps = array.size if array.ndim == 1 else 0
        if array.dtype.kind == "M":
            return np.asarray(array.astype("datetime64[ns]").astype(np.int64)), True
        if array.dtype.kind in "UO":
            return dates(self.words(column), f"{self.path}: {column}"), True
        if array.dtype.kind in "iu" and array.ndim == 1:
            return np.asarray(array.astype(np.int64)), False
        numbers = self.numbers(column)
        numbers = numbers[:, 0] if numbers.shape[1:] == (1,) else numbers  # a column of MATLAB
        if numbers.ndim != 1:
            got = f"shape {numbers.shape}"
            raise DataError(f"{self.path}: {column} is no clock", got=got, expected="one stamp a row")
        return numbers, False

    def within(self, group: str) -> ArrayTable:
        """The columns below a group: those whose names begin with it, without it."""
        names = {name[len(group) + 1 :]: name for name in self.names if name.startswith((f"{group}/", f"{group}."))}
        return ArrayTable(self.path, list(names), lambda name: self._read(names[name]), self.files)

    def words(self, column: str) -> list[str]:
        """See `TextTable`."""
        return [str(value) for value in self._arrays[split_component(column, self.names)[0]].reshape(-1)]


Table: TypeAlias = TextTable | ArrayTable


def is_text(path: Path) -> bool:
    """Whether a file is none of the formats that hold arrays."""
    return path.suffix.lower() not in _FORMATS


def open_table(path: Path, mapping: TableMapping | None = None) -> Table:
    """A file as a table, by its ending; whatever has another is text, laid out as the mapping says if there is one.

    Raises:
        DataError: it cannot be read.
        MissingDependency: a format needs a package that is not installed.
    """
    refuse_pickle(path)
    if not is_text(path):
        return _FORMATS[path.suffix.lower()](path)
    if mapping is None:
        return TextTable(path, read_bytes(path), delimiter="")
    return TextTable(
        path,
        read_bytes(path),
        delimiter=mapping.delimiter,
        header=mapping.header,
        skip_lines=mapping.skip_lines,
        header_rows=mapping.header_rows,
        decimal=mapping.decimal,
        encoding=mapping.encoding,
        units_row=mapping.units_row,
        skip_bad_rows=mapping.skip_bad_rows,
    )


def _npz(path: Path) -> Table:
    """Arrays of numpy; the fields of structured ones are columns, and the files of a folder those of a recording."""
    data = read_bytes(path)
    whole = {"": array_of(data, path)} if path.suffix.lower() == ".npy" else arrays_of(data, path)
    if "" in whole and whole[""].dtype.names is None:
        files = {own.stem: inside(path.parent, own) for own in sorted(path.parent.glob("*.npy"))}
        if 1 < len(files) <= _MOST_FILES:
            return ArrayTable(path, list(files), lambda name: _whole(files[name]), list(files.values()))
    arrays = {own: array for name, array in whole.items() for own, array in _fields(name, array)}
    return ArrayTable(path, list(arrays), arrays.__getitem__)


def _whole(path: Path) -> Shaped[np.ndarray, "..."]:
    return np.asarray(array_of(read_bytes(path), path))


def _fields(name: str, array: Shaped[np.ndarray, "..."]) -> Iterator[tuple[str, Shaped[np.ndarray, "..."]]]:
    """An array by its name, or each field of a structured one."""
    for field in array.dtype.names or ():
        yield f"{name}.{field}".lstrip("."), array[field]
    if array.dtype.names is None:
        yield name or "values", array


def _parquet(path: Path) -> Table:
    from trueup.dataset.importers.lerobot_rows import reading

    with reading(path), pq.ParquetFile(path) as file:
        names = file.schema_arrow.names

    def column(name: str) -> Shaped[np.ndarray, "..."]:
        with reading(path), pq.ParquetFile(path) as file:
            found = read_table(file, path, [name])[name].combine_chunks()
        if is_list(found.type):
            widths = set(pc.list_value_length(found).to_pylist())
            if len(widths) != 1 or not widths <= set(range(1, _MOST_COLUMNS)):
                raise DataError(f"{path}: {name} is ragged, or empty", got=f"vectors of {list(widths)[:4]} numbers")
            return np.asarray(found.flatten().to_numpy(zero_copy_only=False)).reshape(len(found), -1)
        return np.asarray(found.to_numpy(zero_copy_only=False))

    return ArrayTable(path, names, column)


def _h5(path: Path, *, of_matlab: bool = False) -> Table:
    """Datasets by their paths, fields of structured ones, columns of pandas; MATLAB stores the last axis first."""
    from trueup.dataset.importers.h5file import open_h5

    # Column -> dataset, its field, and which of its columns.
    places: dict[str, tuple[str, str, int | None]] = {}
    with open_h5(path) as file:
        names = file.arrays(_DEEPEST, _MOST_COLUMNS)
        for name in names:
            group, _, last = name.rpartition("/")
            block = _BLOCK_OF_PANDAS.fullmatch(last)
            if block is None:
                places |= {f"{name}.{own}" if own else name: (name, own, None) for own in file.fields(name) or ("",)}
            elif block["what"] == "values":
                items = file.texts(f"{group}/{block['block']}_items")
                places |= {f"{group}/{item}": (name, "", place) for place, item in enumerate(items)}
            elif block["axis"]:
                places[f"{group}/index"] = (name, "", None)
    blocks: dict[str, Shaped[np.ndarray, "..."]] = {}

    def column(name: str) -> Shaped[np.ndarray, "..."]:
        where, field, place = places[name]
        if where in blocks:
            return blocks[where][:, place]
        with open_h5(path) as file:
            try:
                found = np.asarray(file.numbers(where, field))
            except DataError:
                return np.array(file.texts(where))
        if place is not None:
            blocks[where] = found.reshape(len(found), -1)
            return blocks[where][:, place]
        return found.T if of_matlab else found

    return ArrayTable(path, list(places), column)


def _mat(path: Path) -> Table:
    """MATLAB's files: version 7.3 is HDF5, and scipy reads version 4."""
    import scipy.io

    data = read_bytes(path)
    if data[:128].startswith(b"MATLAB 7.3") or data[:8] == b"\x89HDF\r\n\x1a\n":
        return _h5(path, of_matlab=True)
    most = most_bytes(len(data))
    try:
        found = read_mat5(data, most) if is_mat5(data) else scipy.io.loadmat(io.BytesIO(data), simplify_cells=True)
    except Exception as error:  # damaged bytes of version 4 raise errors of many kinds
        raise DataError(f"{path} cannot be read as a file of MATLAB", got=error) from error
    arrays = dict(_leaves({name: value for name, value in found.items() if not name.startswith("__")}))
    return ArrayTable(path, list(arrays), arrays.__getitem__)


def _refuse_burst(path: Path, unpacked: int, size: int) -> None:
    """Refuse a file that unpacks to far more than samples could have been packed to.

    Raises:
        DataError: it does.
    """
    if unpacked > most_bytes(size):
        raise DataError(f"{path} unpacks to more than a file of its size can hold", got=f"over {unpacked:.3g} bytes")


def _json(path: Path) -> Table:
    """Records in a list or one a line, or a mapping of lists, of numbers or of records; nested names have dots.

    Data frames as pandas writes them, too: names and rows apart, or rows by their labels.
    """
    data = read_bytes(path)
    cut = ""
    try:
        text = data.decode("utf-8-sig")
        by_lines = _by_lines(path, text)
        parts = [part for part in (text.splitlines() if by_lines else [text]) if part.strip()]
        if by_lines and len(parts) > 1 and not text.endswith(("\n", "\r")) and not _is_json(parts[-1]):
            parts, cut = parts[:-1], "the last line was not written to its end, and is left out"
        trees = [json.loads(part) for part in parts]
    except (ValueError, RecursionError) as error:
        raise DataError(f"{path} cannot be read as JSON", got=error) from error
    tree = _turned(trees if by_lines else trees[0] if trees else [], path)
    if isinstance(tree, list) and tree and all(isinstance(row, dict) for row in tree):
        rows = [dict(_leaves(row)) for row in tree]
        columns = {
            f"{kind}.{name}".lstrip("."): column
            for kind, own in _by_kind(rows).items()
            for name, column in _columns(own, path, len(data)).items()
        }
    elif isinstance(tree, dict):
        columns = {}
        for name, value in _leaves(tree):
            if isinstance(value, list) and value and all(isinstance(row, dict) for row in value):
                records = _columns([dict(_leaves(row)) for row in value], path, len(data))
                columns |= {f"{name}.{own}": column for own, column in records.items()}
            else:
                columns[name] = _array(value, f"{path}: {name}")
    else:
        raise DataError(f"{path} is no table", got=type(tree).__name__, expected="records, or a list for each column")
    table = ArrayTable(path, list(columns), columns.__getitem__)
    table.cut = cut
    return table


def _is_json(text: str) -> bool:
    try:
        json.loads(text)
    except (ValueError, RecursionError):
        return False
    return True


def _by_kind(rows: list[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """Records by what they say that they are, where those of other kinds have something of the same name."""
    for key in _KINDS:
        kinds = dict.fromkeys(row.get(key) for row in rows)
        if 1 < len(kinds) <= _MOST_KINDS and all(isinstance(kind, str) and kind for kind in kinds):
            own = {str(kind): [row for row in rows if row[key] == kind] for kind in kinds}
            names = [frozenset(name for row in part for name in row if name != key) for part in own.values()]
            if len(frozenset().union(*names)) < sum(map(len, names)):
                return own
    return {"": rows}


def _turned(tree: Any, path: Path) -> Any:
    """A data frame that stands in another order as a mapping of lists; anything else as it is.

    Raises:
        DataError: a row has another length than there are names.
    """
    if not isinstance(tree, dict):
        return tree
    names, rows = tree.get("columns"), tree.get("data")
    if isinstance(names, list) and isinstance(rows, list) and all(isinstance(row, list) for row in rows):
        if any(len(row) != len(names) for row in rows):
            raise DataError(f"{path} has rows of other lengths than its names", got=f"{len(names)} names")
        texts = [".".join(map(str, name)) if isinstance(name, list) else str(name) for name in names]
        index = {"index": tree["index"]} if isinstance(tree.get("index"), list) else {}
        return index | {name: [row[place] for row in rows] for place, name in enumerate(texts)}
    inner = list(tree.values())
    if not inner or not all(isinstance(own, dict) and own for own in inner):
        return tree
    if len(tree) > 1 and all(map(_is_label, tree)):  # rows by their labels
        return [{"index": _label(text), **row} for text, row in tree.items()]
    labels = list(inner[0])
    if all(map(_is_label, labels)) and all(list(own) == labels for own in inner):
        return {"index": list(map(_label, labels)), **{name: list(own.values()) for name, own in tree.items()}}
    return tree


def _is_label(text: str) -> bool:
    """Whether a row may be called so: by its number, or by a date."""
    return not isinstance(_label(text), str) or bool(IS_DATE.match(text))


def _label(text: str) -> int | float | str:
    for kind in (int, float):
        with contextlib.suppress(ValueError):
            return kind(text)
    return text


def _by_lines(path: Path, text: str) -> bool:
    return path.suffix.lower() != ".json" or (text.lstrip().startswith("{") and "\n{" in text.strip())


def _columns(rows: Sequence[Mapping[str, Any]], path: Path, size: int) -> dict[str, Shaped[np.ndarray, "..."]]:
    """Columns of records; what one of them lacks is NaN.

    Args:
        rows: the records.
        path: where they are from.
        size: of the file [bytes].

    Raises:
        DataError: a column is ragged, or there is far more to fill in than there is.
    """
    widths: dict[str, int] = {}
    for row in rows:
        for name, value in row.items():
            widths[name] = max(widths.get(name, 0), len(value) if isinstance(value, list) else 0)
    # Each row may have a name of its own, or one row a vector that all others lack.
    _refuse_burst(path, _NUMBER_BYTES * len(rows) * sum(max(width, 1) for width in widths.values()), size)
    return {name: _stacked([row.get(name) for row in rows], width, f"{path}: {name}") for name, width in widths.items()}


def _stacked(values: list[Any], width: int, where: str) -> Shaped[np.ndarray, "..."]:
    """Values of a column, row by row; what is missing is NaN, or a vector of them."""
    missing: Any = [math.nan] * width if width else math.nan
    return _array([missing if value is None else value for value in values], where)


def _array(value: Any, where: str) -> Shaped[np.ndarray, "..."]:
    try:
        # Each text of an array of texts takes as much room as the longest.
        return np.asarray(value, dtype=object if _has_text(value) else None)
    except (ValueError, OverflowError) as error:
        raise DataError(f"{where} is ragged", got=error) from error


def _has_text(value: Any) -> bool:
    """Whether there is a text in a list, or in a list in it."""
    if not isinstance(value, list):
        return False
    kinds = set(map(type, value))
    return str in kinds or (list in kinds and any(map(_has_text, value)))


def _leaves(tree: Mapping[str, Any], above: str = "", depth: int = 0) -> Iterator[tuple[str, Any]]:
    for name, value in tree.items():
        if isinstance(value, Mapping) and depth < _DEEPEST:
            yield from _leaves(value, f"{above}{name}.", depth + 1)
        elif isinstance(value, np.ndarray) and value.dtype == object and _structs(value) and depth < _DEEPEST:
            for number, one in enumerate(value.ravel(), 1):  # an array of structs of MATLAB
                yield from _leaves(one, f"{above}{name}{number}.", depth + 1)
        else:
            yield f"{above}{name}", value


def _structs(array: Shaped[np.ndarray, "..."]) -> bool:
    return 0 < array.size <= _MOST_COLUMNS and all(isinstance(one, Mapping) for one in array.ravel())


def _excel(path: Path) -> Table:
    """The sheet that has samples, a row for each; of several, columns are called `SHEET/NAME`."""
    try:
        import openpyxl
    except ImportError as error:
        raise MissingDependency(
            f"{path.name} needs the package openpyxl", hint="pip install 'trueup[excel]', or save the sheet as CSV."
        ) from error
    data = read_bytes(path)
    sheets: dict[str, list[tuple[Any, ...]]] = {}
    cells = 0
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            sizes = {item.filename: item.file_size for item in archive.infolist()}
        _refuse_burst(path, sum(sizes.values()), len(data))
        # Cells are read one by one; all else is taken into memory, where it is twenty times as large.
        rest = sum(size for name, size in sizes.items() if not name.startswith("xl/worksheets/"))
        _refuse_burst(path, _TIMES_IN_MEMORY * rest, len(data))
        for sheet in openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=True).worksheets:
            sheet.reset_dimensions()  # what a file claims would be filled in
            rows = sheets[sheet.title] = []
            for row in itertools.islice(sheet.iter_rows(values_only=True), _MOST_ROWS):
                # So is what is left of a cell, or above it.
                cells += 1 + len(row)
                _refuse_burst(path, _NUMBER_BYTES * cells, len(data))
                if any(cell is not None for cell in row):
                    rows.append(row)
    except DataError:
        raise
    except Exception as error:  # damaged archives raise errors of many kinds
        raise DataError(f"{path} cannot be read as a workbook", got=error) from error
    tables = {name: _sheet(rows, f"{path}: {name}") for name, rows in sheets.items() if len(rows) > 1}
    if not tables:
        raise DataError(f"{path} has no rows", expected="names in the first row of a sheet")
    with_samples = [name for name, (head, _) in tables.items() if head is not None]
    if len(with_samples) < 2:
        columns = tables[next(iter(with_samples or tables))][1]
    else:
        columns = {f"{name}/{own}": values for name in with_samples for own, values in tables[name][1].items()}
    return ArrayTable(path, list(columns), columns.__getitem__)


def _sheet(rows: Sequence[Sequence[Any]], where: str) -> tuple[Head | None, dict[str, Shaped[np.ndarray, "..."]]]:
    """Columns of a sheet, below a header of one or more rows; what a name spans, it stands for."""
    width = max(map(len, rows))
    texts = [["" if cell is None else str(cell).strip() for cell in row] for row in rows[:_LONGEST_HEAD]]
    head = head_in([row + [""] * (width - len(row)) for row in texts])
    first, count = (head.skip_lines, head.header_rows) if head is not None else (0, 1)
    lines = [row + [""] * (width - len(row)) for row in texts[first : first + count]]
    for line in lines[:-1]:
        for place in range(1, width):
            line[place] = line[place] or line[place - 1]
    names = [".".join(filter(None, own)) for own in zip(*lines, strict=True)]
    return head, {
        name: _stacked(
            [row[place] if place < len(row) else None for row in rows[first + count :]], 0, f"{where}: {name}"
        )
        for place, name in enumerate(names)
        if name
    }


_FORMATS: Mapping[str, Callable[[Path], Table]] = {
    **dict.fromkeys((".npz", ".npy"), _npz),
    ".parquet": _parquet,
    ".h5": _h5,
    ".hdf5": _h5,
    ".mat": _mat,
    ".json": _json,
    ".jsonl": _json,
    ".ndjson": _json,
    ".xlsx": _excel,
}
