"""Tables of any format, with a mapping file; the mappings that ship with trueup are recognized by their columns."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from trueup.core.atomic import regular
from trueup.core.episode import EpisodeMeta
from trueup.dataset.importers.base import EpisodeSource, ImportOptions, ImportPlan
from trueup.dataset.importers.beside import plan_with
from trueup.dataset.importers.files import data_files, episode_id, inside, read_bytes
from trueup.dataset.importers.gain_setting import kp_setting_of
from trueup.dataset.importers.headers import Suggestion, sounds_told, suggest, units_in
from trueup.dataset.importers.mapping import ABOUT, ENDINGS, FileValue, TableMapping, substitute
from trueup.dataset.importers.mapping_file import load_mapping, shipped
from trueup.dataset.importers.packed import opened
from trueup.dataset.importers.pattern import matches
from trueup.dataset.importers.table_episode import TableEpisode, load_episode, parts_of
from trueup.dataset.importers.tables import Table, is_text, open_table
from trueup.dataset.importers.text_table import TextTable, refuse_headerless
from trueup.errors import DataError, FormatError, NameMismatch, TrueupError

NAME = "table"
LOOKS_FOR = "CSV files; with a mapping file (--mapping, or mapping.yaml beside them) other tables, too"
EPISODE = "what the mapping says"
ASSUMES = "nothing: the mapping says all"

_HEADER_BYTES, _SAMPLE_BYTES = 1 << 16, 1 << 20
# Files beside logs that are none.
_BESIDE = ("split.json", "mapping.yaml")
_NUMBERED = re.compile(r"(.*?[^\d/.]*\d+)[/.].+")
# Of files that nothing else than tables have.
_ENDINGS = (".csv", ".tsv", ".parquet", ".xlsx", ".npy", ".mat", ".jsonl", ".ndjson")


def detects(path: Path) -> bool:
    """Whether `path` is a table, holds some, or has a mapping in it."""
    try:
        if (path / "mapping.yaml").is_file() or any(data_files(path, ending) for ending in _ENDINGS):
            return True
        root = path.parent if path.is_file() else path
        return bool(_fitting(root, [file.relative_to(root).as_posix() for file in data_files(path, ".json")]))
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
    names = [file.relative_to(root).as_posix() for file in data_files(path, "")]
    if given is None:
        tables = [name for name in names if name.lower().endswith(_ENDINGS)]
        names = tables or [name for name in names if name.lower().endswith(".json")]
    mapping = _recognize(path, root, names) if given is None else load_mapping(given)
    if mapping.joint_pattern and (first := next(iter(_matching(mapping, names)), None)):
        mapping = mapping.of_columns(open_table(inside(root, root / first[0]), mapping).names)
    episodes = _episodes(root, names, mapping, options)
    if not episodes:
        raise FormatError(
            f"no file below {path} matches `episodes` of {mapping.name}",
            got=mapping.episodes or "files of other endings",
            available=names,
        )
    used = {name for episode in episodes for name in episode.series.values()} | {mapping.metadata}
    unused = [name for name in names if name not in used and name.endswith(ENDINGS[:4])]
    sources = []
    for whole in episodes:
        size = sum((root / name).stat().st_size for name in set(whole.series.values()))
        for episode in parts_of(root, whole, mapping):
            load = partial(load_episode, root, episode, mapping, options)
            sources.append(EpisodeSource(episode.meta.id, load, size, episode.meta.source))
    return plan_with(
        NAME,
        path,
        root,
        sources,
        robot=options.robot or _constant(mapping.robot),
        licence=mapping.licence,
        notes=(
            f"columns are read as {mapping.name} says",
            *([f"skipped {len(unused)} tables, e.g. {unused[0]}: the mapping does not use them"] if unused else []),
        ),
    )


def _recognize(path: Path, root: Path, names: Sequence[str]) -> TableMapping:
    """The one shipped mapping whose columns and file names fit every file."""
    fitting = _fitting(root, names)
    if len(fitting) == 1:
        return fitting[0]
    first = next((name for name in names if name.lower().endswith(".csv")), None)
    shown = (first, _header(inside(root, root / first))) if first else None
    suggestion = suggested(path)
    hint = "Write columns, joints and units into a YAML file for --mapping; docs/logs.md#tables has one to begin with."
    if suggestion is not None:
        hint = (
            f"If this is right, save it as mapping.yaml beside the logs, or give it with --mapping:\n{suggestion.text}"
        )
    raise FormatError(
        f"no mapping says what the columns of {path} are",
        got=f"{shown[0]} with columns {', '.join(shown[1])[:100]}" if shown else "no CSV file",
        available=None if suggestion is not None else [mapping.name for mapping in fitting] or shipped(),
        hint=hint,
    )


def suggested(path: Path) -> Suggestion | None:
    """A mapping that the names of files and columns suggest; None where they say too little.

    Files that are alike are a motion each. Where all folders have the same two files, a folder is a motion, and the
    file that is called as commands are has the command.

    Args:
        path: a file or folder with logs.

    Raises:
        TrueupError: the first file cannot be read.
    """
    logs = opened(path)
    path = logs.path
    root = path.parent if path.is_file() else path
    names = [file.relative_to(root).as_posix() for file in data_files(path, "")]
    ending = next((own for own in ENDINGS if any(name.lower().endswith(own) for name in names)), None)
    tables = [name for name in names if ending and name.lower().endswith(ending)]
    if not tables:
        return None
    kinds = sorted({Path(name).name for name in tables})
    folders = {Path(name).parent for name in tables}
    told = [kind for kind in kinds if sounds_told(kind)]
    whole = len(kinds) > 1 and len(tables) == len(kinds) * len(folders)
    if not (whole and len(told) == 1 and len(kinds) == 2):
        return _suggested_of(_sample(inside(root, root / tables[0])))
    (done,) = set(kinds) - set(told)
    first = Path(tables[0]).parent
    measured = suggest(_sample(inside(root, root / first / done)))
    command = suggest(_sample(inside(root, root / first / told[0])), "command")
    if measured is None or command is None:
        return measured
    own = command.tree["series"]["command"]
    joints = {} if command.tree["joints"] == measured.tree["joints"] else {"joints": command.tree["joints"]}
    tree = {
        "joints": measured.tree["joints"],
        "episodes": rf"(?:(?P<motion>.+)/)?{re.escape(done)}",
        "id": "{motion}" if first != Path() else "",
        "series": {
            "measured": measured.tree["series"]["measured"],
            "command": {"file": f"{{motion}}/{told[0]}", "time": own["time"], **joints, "signals": own["signals"]},
        },
    }
    unsure = [line for line in (*measured.unsure, *command.unsure) if "sounds like a command" not in line]
    return Suggestion({key: value for key, value in tree.items() if value}, measured.taken, tuple(unsure))


def _sample(path: Path, *, units_row: bool = False) -> Table:
    """A file as a table; of text, the first megabyte says what the columns are."""
    if not is_text(path):
        return open_table(path)
    with regular(path).open("rb") as file:
        data = file.read(_SAMPLE_BYTES)
    whole = len(data) < _SAMPLE_BYTES
    data = data if whole else data[: data.rfind(b"\n") + 1]
    return TextTable(path, data, delimiter="", units_row=units_row)


def _suggested_of(table: Table) -> Suggestion | None:
    """Of one file: of the first of its groups, where all arrays are in groups that only a number tells apart."""
    if isinstance(table, TextTable):
        return _suggested_of_text(table)
    found = [_NUMBERED.fullmatch(name) for name in table.names]
    groups = dict.fromkeys(one[1] for one in found if one)
    stems = {re.sub(r"\d+$", "", group) for group in groups}
    if len(groups) < 2 or len(stems) > 1:
        return suggest(table)
    suggestion = suggest(table.within(next(iter(groups))))
    if suggestion is None:
        return suggest(table)
    tree = {"joints": suggestion.tree["joints"], "group": rf"{re.escape(stems.pop())}\d+", **suggestion.tree}
    return replace(suggestion, tree=tree)


def _suggested_of_text(table: TextTable) -> Suggestion | None:
    """Of a file of text, whose second line may hold units.

    Raises:
        DataError: the first line holds numbers.
    """
    refuse_headerless(table.path, table.names)
    units = units_in(table.first)
    if not units:
        return suggest(table)
    suggestion = suggest(_sample(table.path, units_row=True), units=units)
    if suggestion is None:
        return None
    return replace(suggestion, tree={"joints": suggestion.tree["joints"], "units_row": True, **suggestion.tree})


def _fitting(root: Path, names: Sequence[str]) -> list[TableMapping]:
    """The shipped mappings that fit every CSV file, or every JSON file where there is no other."""
    tables = [name for name in names if name not in _BESIDE]
    read = [name for name in tables if name.lower().endswith(".csv")] or [
        name for name in tables if name.lower().endswith(".json")
    ]
    if not read:
        return []
    if not is_text(Path(read[0])):  # they are read as a whole, so the first one is asked alone
        alone = {read[0]: _header(inside(root, root / read[0]))}
        if not any(_fits(mapping, alone) for mapping in shipped().values()):
            return []
    headers = {name: _header(inside(root, root / name)) for name in read}
    return [mapping for mapping in shipped().values() if _fits(mapping, headers)]


def _header(path: Path) -> tuple[str, ...]:
    if not is_text(path):
        return open_table(path).names
    try:
        with path.open("rb") as file:
            return TextTable(path, file.read(_HEADER_BYTES), delimiter="").names
    except OSError as error:
        raise DataError(f"cannot read {path}", got=error.strerror or str(error)) from error


def _fits(mapping: TableMapping, headers: Mapping[str, tuple[str, ...]]) -> bool:
    """Whether each file belongs to an episode and has the columns that are read from it."""
    used = set()
    try:
        mapping = mapping.of_columns(next(iter(headers.values())))
    except NameMismatch:
        return False
    for name, groups in _matching(mapping, list(headers)):
        for series, spec in mapping.series.items():
            file = _file_of(mapping, series, name, groups)
            needed = set(spec.time.names)
            needed.update(*(mapping.columns(series, key) for key, item in spec.signals.items() if not item.optional))
            if needed <= set(headers.get(file, ())):
                used.add(file)
            elif not spec.optional:
                return False
    return used == set(headers)


def _matching(mapping: TableMapping, names: Sequence[str]) -> list[tuple[str, dict[str, str]]]:
    """The paths that `episodes` matches, and its groups for each."""
    if not mapping.episodes:
        tables = [name for name in names if name not in (*_BESIDE, mapping.metadata)]
        ending = next((own for own in ENDINGS if any(name.lower().endswith(own) for name in tables)), None)
        # A single file may be called anything.
        return [(name, {}) for name in tables if len(tables) == 1 or (ending and name.lower().endswith(ending))]
    found = zip(names, matches(mapping.episodes, names, where=f"{mapping.name}: episodes"), strict=True)
    return [(name, groups) for name, groups in found if groups is not None]


def _file_of(mapping: TableMapping, series: str, name: str, groups: Mapping[str, str]) -> str:
    template = mapping.series[series].file
    if not template:
        return name
    return os.path.normpath(substitute(template, groups, where=mapping.name).lstrip("/")).replace(os.sep, "/")


def _episodes(root: Path, names: Sequence[str], mapping: TableMapping, options: ImportOptions) -> list[TableEpisode]:
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
        told = {key: getattr(mapping, key) for key in ("id", *ABOUT)}
        templates = {key: text for key, text in told.items() if isinstance(text, str)}
        said = {key: substitute(text, groups, where=mapping.name) for key, text in templates.items()}
        said |= _said_in(root / name, mapping)
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
        found.append(TableEpisode(meta, series))
    return found


def _said_in(path: Path, mapping: TableMapping) -> dict[str, str]:
    """What a file says about its motion, where the mapping leaves that to it.

    Raises:
        DataError: it cannot be read.
        NameMismatch: it does not say it.
    """
    columns = {key: value.column for key in ABOUT if isinstance(value := getattr(mapping, key), FileValue)}
    if not columns:
        return {}
    table = open_table(path, mapping)
    table.load(list(columns.values()))
    return {key: table.words(column)[0] for key, column in columns.items()}


def _constant(said: str | FileValue) -> str:
    """What a mapping says of all motions."""
    return "" if isinstance(said, FileValue) or "{" in said else said


def _metadata(root: Path, mapping: TableMapping) -> dict[str, dict[str, str]]:
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
