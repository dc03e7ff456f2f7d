"""Mapping files as YAML: read with every mistake named; the ones that ship with trueup."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields
from functools import cache, partial
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

from trueup.core.config import parse_yaml
from trueup.dataset.importers.files import read_text
from trueup.dataset.importers.mapping import (
    ABOUT,
    ClockColumn,
    FileValue,
    SeriesColumns,
    SignalColumns,
    SplitRule,
    TableMapping,
)
from trueup.errors import ConfigError, TrueupError

# Letters, of up to four bytes each; YAML takes minutes for megabytes.
_LARGEST = 1 << 18
_LARGEST_BYTES = 4 * _LARGEST
Kind = TypeVar("Kind")


@cache
def shipped() -> Mapping[str, TableMapping]:
    """The mappings that come with trueup, by name."""
    folder = resources.files("trueup.dataset.importers").joinpath("mappings")
    files = {item.name.removesuffix(".yaml"): item for item in folder.iterdir() if item.name.endswith(".yaml")}
    return {name: parse_mapping(files[name].read_text(encoding="utf-8"), name=name) for name in sorted(files)}


def load_mapping(path: Path) -> TableMapping:
    """Read a mapping file, or take the shipped mapping of that name.

    Raises:
        ConfigError: neither exists, or the file is not a valid mapping.
        DataError: the file cannot be read or is not UTF-8.
    """
    if path.exists():
        if path.is_file() and (size := path.stat().st_size) > _LARGEST_BYTES:
            raise ConfigError(f"{path} is too large for a mapping", got=f"{size} bytes", expected=_LARGEST)
        return parse_mapping(read_text(path), name=path.name)
    known = shipped()
    if str(path) in known:
        return known[str(path)]
    raise ConfigError(f"there is no mapping file {path}", expected="a YAML file or a shipped mapping", available=known)


def is_table_mapping(path: Path) -> bool:
    """Whether a file, or a shipped mapping of that name, says where series are, as mappings of tables do."""
    if not path.is_file():
        return str(path) in shipped()
    if path.stat().st_size > _LARGEST_BYTES:
        return True  # which `load_mapping` refuses, without reading it
    try:
        tree = parse_yaml(read_text(path), path.name)
    except TrueupError:
        return False
    return isinstance(tree, dict) and "series" in tree


def parse_mapping(text: str, *, name: str) -> TableMapping:
    """Read a mapping from YAML.

    Args:
        text: the YAML.
        name: how messages call it.

    Raises:
        ConfigError: not plain YAML, an unknown or missing key, a value of the wrong kind.
        UnitError: a unit is unknown.
    """
    if len(text) > _LARGEST:
        raise ConfigError(f"{name} is too large for a mapping", got=f"{len(text)} characters", expected=_LARGEST)
    data = parse_yaml(text, name)
    pattern = data["joints"] if isinstance(data, dict) and isinstance(data.get("joints"), str) else ""
    readers: dict[str, Callable[[object, str], object]] = {
        "joints": lambda item, where: () if pattern else _texts(item, where),
        **dict.fromkeys(ABOUT, _text_or_value),
        "series": partial(_each, _series),
        "header": lambda item, where: _texts([item] if item == "none" else item, where),
        "bodies": _texts,
        **dict.fromkeys(("skip_lines", "header_rows"), _count),
        "keep_origin": _switch,
        "units_row": _switch,
        "skip_bad_rows": _switch,
        "split": _split,
    }
    return _build(partial(TableMapping, name=name, joint_pattern=pattern), TableMapping, data, name, readers)


def _series(data: object, where: str) -> SeriesColumns:
    readers: dict[str, Callable[[object, str], object]] = {
        "time": _clock,
        "signals": partial(_each, _signal),
        "optional": _switch,
        "joints": _texts,
    }
    return _build(SeriesColumns, SeriesColumns, data, where, readers)


def _clock(data: object, where: str) -> ClockColumn:
    readers: dict[str, Callable[[object, str], object]] = {"columns": _texts, "rate_hz": _number}
    return ClockColumn(data) if isinstance(data, str) else _build(ClockColumn, ClockColumn, data, where, readers)


def _split(data: object, where: str) -> SplitRule:
    readers: dict[str, Callable[[object, str], object]] = {
        **dict.fromkeys(("gap_s", "every_s", "rest_s"), _number),
        "back": _switch,
    }
    return _build(SplitRule, SplitRule, data, where, readers)


def _signal(data: object, where: str) -> SignalColumns:
    readers: dict[str, Callable[[object, str], object]] = {
        "columns": _text_or_texts,
        "unit": _text_or_texts,
        "optional": _switch,
        "factor": _number_or_numbers,
        "offset": _number_or_numbers,
    }
    return _build(SignalColumns, SignalColumns, data, where, readers)


def _build(
    make: Callable[..., Kind],
    kind: Any,
    data: object,
    where: str,
    readers: dict[str, Callable[[object, str], object]],
) -> Kind:
    """One of the mapping's dataclasses from a YAML mapping; keys without a reader of their own are text."""
    own = ("name", "joint_pattern") if kind is TableMapping else ()
    known = {item.name: item.default is MISSING for item in fields(kind) if item.name not in own}
    entries = _mapping(data, where, expected=f"keys {', '.join(known)}")
    unknown = [key for key in entries if key not in known]
    if unknown:
        raise ConfigError(f"{where}: unknown keys", got=unknown, available=known)
    missing = [key for key, needed in known.items() if needed and key not in entries]
    if missing:
        raise ConfigError(f"{where}: {' and '.join(missing)} missing", got=list(entries), available=known)
    return make(**{key: readers.get(key, _text)(value, f"{where}.{key}") for key, value in entries.items()})


def _each(read: Callable[[object, str], Kind], data: object, where: str) -> dict[str, Kind]:
    return {key: read(value, f"{where}.{key}") for key, value in _mapping(data, where, expected="names").items()}


def _mapping(data: object, where: str, *, expected: str) -> dict[str, object]:
    if not isinstance(data, dict) or not data or not all(isinstance(key, str) for key in data):
        raise ConfigError(f"{where} is not a YAML mapping", got=repr(data)[:80], expected=expected)
    return data


def _text(data: object, where: str) -> str:
    """Text; a number is taken as written by Python, since `unit: 1` and `payload_kg: 0.5` are what people write."""
    if isinstance(data, str | int | float) and not isinstance(data, bool):
        return str(data)
    raise ConfigError(
        f"{where} is not text", got=repr(data)[:80], hint="Words such as on, off, yes and no need quotes."
    )


def _texts(data: object, where: str) -> tuple[str, ...]:
    if not isinstance(data, list) or not data:
        raise ConfigError(f"{where} is not a list", got=repr(data)[:80], expected="a list of names")
    return tuple(_text(item, where) for item in data)


def _text_or_value(data: object, where: str) -> str | FileValue:
    return _build(FileValue, FileValue, data, where, {}) if isinstance(data, dict) else _text(data, where)


def _text_or_texts(data: object, where: str) -> str | tuple[str, ...]:
    return _texts(data, where) if isinstance(data, list) else _text(data, where)


def _number(data: object, where: str) -> float:
    if isinstance(data, int | float) and not isinstance(data, bool):
        return float(data)
    raise ConfigError(f"{where} is not a number", got=repr(data)[:80])


def _number_or_numbers(data: object, where: str) -> float | tuple[float, ...]:
    if isinstance(data, list) and data:
        return tuple(_number(item, where) for item in data)
    return _number(data, where)


def _count(data: object, where: str) -> int:
    if isinstance(data, int) and not isinstance(data, bool) and 0 <= data <= 10_000:
        return data
    raise ConfigError(f"{where} is not a count", got=repr(data)[:80], expected="0 to 10000")


def _switch(data: object, where: str) -> bool:
    if isinstance(data, bool):
        return data
    raise ConfigError(f"{where} is not a switch", got=repr(data)[:80], expected="true or false")
