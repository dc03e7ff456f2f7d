"""Which importer reads a path."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import cast

from trueup.core.atomic import where_missing
from trueup.dataset.importers.base import Importer
from trueup.dataset.importers.files import refuse_pickle
from trueup.dataset.importers.mapping_file import is_table_mapping
from trueup.errors import ConfigError, DataError, FormatError, MissingDependency

# One module each. Any folder may hold a few tables, too, so that the last one counts only when no other does.
FORMATS = (
    "sage",
    "lerobot",
    "rosbag",
    "hdf5",
    "npz",
    "table",
)
# What formats were called before.
_FORMER = {"csv": "table"}
# What is said of a folder of no known format: so many names, each of so many letters.
_NAMES, _NAME = 4, 24
# How files of other kinds become some that are read.
_ARROW = "python -c \"import pandas; pandas.read_feather('FILE').to_parquet('run.parquet')\""
_SQLITE = "sqlite3 -header -csv FILE 'SELECT * FROM TABLE' > run.csv"
_CONVERTED = {
    **dict.fromkeys((".feather", ".arrow"), _ARROW),
    **dict.fromkeys((".db", ".sqlite", ".sqlite3"), _SQLITE),
}


def importer(name: str) -> Importer:
    """The module of a format, imported now: some of them need heavy packages.

    Raises:
        MissingDependency: such a package is not installed.
    """
    try:
        return cast("Importer", import_module(f"trueup.dataset.importers.{name}"))
    except ImportError as error:
        raise MissingDependency(
            f"the importer for {name} cannot be loaded", got=error, hint="`trueup doctor` shows what is missing."
        ) from error


def find_importer(path: Path, name: str | None = None, mapping: Path | None = None) -> Importer:
    """The importer for a file or folder.

    Args:
        path: what is to be imported.
        name: take this one, whatever the path looks like.
        mapping: that the user gives: one of tables says that these are tables, as does one beside the logs.

    Raises:
        ConfigError: there is no importer of this name.
        DataError: the path does not exist.
        FormatError: no format, or more than one, is recognized.
        MissingDependency: the importer needs a package that is not installed.
    """
    name = None if name is None else _FORMER.get(name, name)
    if name is not None and name not in FORMATS:
        raise ConfigError(f"there is no format {name!r}", available=FORMATS)
    if not path.exists():
        raise DataError(f"{path} does not exist", hint=where_missing(path))
    if name is not None:
        return importer(name)
    if is_table_mapping(mapping or (path.parent if path.is_file() else path) / "mapping.yaml"):
        return importer("table")
    missing: list[str] = []
    found: list[str] = []
    for candidate in FORMATS:
        try:
            module = importer(candidate)
        except MissingDependency as error:
            missing.append(f"{candidate} was not tried: {error.details}")
            continue
        if not (found and candidate == FORMATS[-1]) and module.detects(path):
            found.append(candidate)
    if len(found) == 1:
        return importer(found[0])
    if found:
        raise FormatError(
            f"{path} looks like several formats",
            available=found,
            hint="Choose one with --format, or import a subfolder.",
        )
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    for file in files:
        refuse_pickle(file)
    content = _content(path)
    if not content:
        raise FormatError(f"{path} is empty", hint="Give the folder or file that holds the logs.")
    ways = [
        _CONVERTED[kind].replace("FILE", file.name) for file in files if (kind := file.suffix.lower()) in _CONVERTED
    ]
    usual = "docs/logs.md says what each format looks like; --mapping says what the columns of CSV files are."
    raise FormatError(
        f"{path} is of no known format",
        got=content,
        expected="; ".join([f"one of {', '.join(FORMATS)}", *missing]),
        hint=f"Convert it first: {ways[0]}" if ways else usual,
    )


def _content(path: Path) -> str:
    """A few of the names that are there; nothing of what is empty."""
    if path.is_file():
        size = path.stat().st_size
        return f"a file of {size} bytes" if size else ""
    try:
        names = sorted(child.name + ("/" if child.is_dir() else "") for child in path.iterdir())
    except OSError as error:
        return error.strerror or str(error)
    shown = ", ".join(name if len(name) <= _NAME else f"{name[:_NAME]}…" for name in names[:_NAMES])
    return shown + (f" and {len(names) - _NAMES} more" if len(names) > _NAMES else "")
