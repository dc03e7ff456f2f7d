"""CSV files with a mapping file; the mappings that ship with trueup are recognized by their columns."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from trueup.core.episode import EpisodeMeta
from trueup.dataset.importers.base import EpisodeSource, ImportOptions, ImportPlan
from trueup.dataset.importers.beside import plan_with
from trueup.dataset.importers.columns import TextTable
from trueup.dataset.importers.csv_episode import CsvEpisode, load_episode
from trueup.dataset.importers.files import data_files, episode_id, inside, read_bytes
from trueup.dataset.importers.gain_setting import kp_setting_of
from trueup.dataset.importers.mapping import ABOUT, CsvMapping, substitute
from trueup.dataset.importers.mapping_file import load_mapping, shipped
from trueup.dataset.importers.pattern import matches
from trueup.errors import DataError, FormatError, TrueupError

NAME = "csv"
LOOKS_FOR = "CSV files, with a mapping file (--mapping, or mapping.yaml beside them) or with columns that are known"
EPISODE = "what the mapping says"
ASSUMES = "nothing: the mapping says all"

_HEADER_BYTES = 1 << 16


def detects(path: Path) -> bool:
    """Whether `path` is a CSV file, holds some, or has a mapping in it."""
    try:
        return (path / "mapping.yaml").is_file() or bool(data_files(path, ".csv"))
    except TrueupError:
        return False


def scan(path: Path, options: ImportOptions) -> ImportPlan:
    """List the episodes that the mapping finds below `path`.

    The mapping is `options.mapping` (a file, or the name of a shipped one), else `mapping.yaml` in the folder,
    else the one shipped mapping that fits all files.

    Raises:
        FormatError: no mapping is given and none fits; no file matches the mapping.
        ConfigError: an option that is not read, the mapping is wrong.
        DataError: a file that the mapping names is missing or outside the folder.
    """
    options.refuse_others(NAME, "units", "mapping")
    root = path.parent if path.is_file() else path
    beside = root / "mapping.yaml"
    given = options.mapping or (inside(root, beside) if beside.is_file() else None)
    # A mapping may name files of any ending.
    names = [file.relative_to(root).as_posix() for file in data_files(path, ".csv" if given is None else "")]
    mapping = _recognize(path, root, names) if given is None else load_mapping(given)
    episodes = _episodes(root, names, mapping, options)
    if not episodes:
        raise FormatError(
            f"no file below {path} matches `episodes` of {mapping.name}",
            got=mapping.episodes,
            available=names,
        )
    used = {name for episode in episodes for name in episode.series.values()} | {mapping.metadata}
    unused = [name for name in names if name not in used and name.endswith(".csv")]
    sources = []
    for episode in episodes:
        size = sum((root / name).stat().st_size for name in set(episode.series.values()))
        load = partial(load_episode, root, episode, mapping, options)
        sources.append(EpisodeSource(episode.meta.id, load, size, episode.meta.source))
    return plan_with(
        NAME,
        path,
        root,
        sources,
        robot=options.robot or ("" if "{" in mapping.robot else mapping.robot),
        licence=mapping.licence,
        notes=(
            f"columns are read as {mapping.name} says",
            *([f"skipped {len(unused)} CSV files, e.g. {unused[0]}: the mapping does not use them"] if unused else []),
        ),
    )


def _recognize(path: Path, root: Path, names: Sequence[str]) -> CsvMapping:
    """The one shipped mapping whose columns and file names fit every file."""
    headers = {name: _header(inside(root, root / name)) for name in names}
    known = shipped()
    fitting = [mapping for mapping in known.values() if headers and _fits(mapping, headers)]
    if len(fitting) == 1:
        return fitting[0]
    shown = next(iter(headers.items()), None)
    raise FormatError(
        f"no mapping says what the columns of {path} are",
        got=f"{shown[0]} with columns {', '.join(shown[1])[:100]}" if shown else "no CSV file",
        available=[mapping.name for mapping in fitting] or known,
        hint="Write columns, joints and units into a YAML file for --mapping; docs/logs.md#csv has one to begin with.",
    )


def _header(path: Path) -> tuple[str, ...]:
    try:
        with path.open("rb") as file:
            return TextTable(path, file.read(_HEADER_BYTES)).names
    except OSError as error:
        raise DataError(f"cannot read {path}", got=error.strerror or str(error)) from error


def _fits(mapping: CsvMapping, headers: Mapping[str, tuple[str, ...]]) -> bool:
    """Whether each file belongs to an episode and has the columns that are read from it."""
    used = set()
    for name, groups in _matching(mapping, list(headers)):
        for series, spec in mapping.series.items():
            file = _file_of(mapping, series, name, groups)
            needed = {spec.time.column}
            needed.update(*(mapping.columns(series, key) for key, item in spec.signals.items() if not item.optional))
            if needed <= set(headers.get(file, ())):
                used.add(file)
            elif not spec.optional:
                return False
    return used == set(headers)


def _matching(mapping: CsvMapping, names: Sequence[str]) -> list[tuple[str, dict[str, str]]]:
    """The paths that `episodes` matches, and its groups for each."""
    found = zip(names, matches(mapping.episodes, names, where=f"{mapping.name}: episodes"), strict=True)
    return [(name, groups) for name, groups in found if groups is not None]


def _file_of(mapping: CsvMapping, series: str, name: str, groups: Mapping[str, str]) -> str:
    template = mapping.series[series].file
    if not template:
        return name
    return os.path.normpath(substitute(template, groups, where=mapping.name).lstrip("/")).replace(os.sep, "/")


def _episodes(root: Path, names: Sequence[str], mapping: CsvMapping, options: ImportOptions) -> list[CsvEpisode]:
    table = _metadata(root, mapping)
    found = []
    for name, groups in _matching(mapping, names):
        if name == mapping.metadata:
            continue
        series = {}
        for label, spec in mapping.series.items():
            file = _file_of(mapping, label, name, groups)
            if inside(root, root / file).is_file():
                series[label] = file
            elif not spec.optional:
                raise DataError(f"{root / file} is missing", expected=f"the {label} series that belongs to {name}")
        said = {key: substitute(str(getattr(mapping, key)), groups, where=mapping.name) for key in ("id", *ABOUT)}
        id = episode_id(said["id"] or name.removesuffix(Path(name).suffix))
        said |= {key: text for key, text in table.get(id, {}).items() if key in said and text}
        meta = EpisodeMeta(
            id=id,
            robot=options.robot or said["robot"],
            unit=said["unit"],
            payload_kg=_payload(said["payload_kg"], name),
            kp_setting=kp_setting_of(said["kp_setting"], f"kp_setting of {name}"),
            condition=said["condition"],
            source=name,
        )
        found.append(CsvEpisode(meta, series))
    return found


def _metadata(root: Path, mapping: CsvMapping) -> dict[str, dict[str, str]]:
    """The metadata table: episode id -> column -> text."""
    if not mapping.metadata:
        return {}
    path = inside(root, root / mapping.metadata)
    table = TextTable(path, read_bytes(path))
    names = [name for name in ("id", *ABOUT) if name in table.names or name == "id"]
    columns = {name: text.to_pylist() for name, text in table.read(names).items()}
    return {id: {name: columns[name][row] for name in names[1:]} for row, id in enumerate(columns["id"])}


def _payload(text: str, name: str) -> float | None:
    if not text:
        return None
    try:
        payload_kg = float(text)
    except ValueError:
        payload_kg = math.nan
    if not (math.isfinite(payload_kg) and payload_kg >= 0):
        raise DataError(f"the payload of {name} is not a mass", got=repr(text), expected="a number of kg, or nothing")
    return payload_kg
