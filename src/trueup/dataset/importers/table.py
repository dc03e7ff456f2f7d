"""Tables of any format, with a mapping file; the mappings that ship with trueup are recognized by their columns."""

from __future__ import annotations

import codecs
import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from trueup.core.atomic import regular
from trueup.core.episode import EpisodeMeta
from trueup.dataset.importers.base import EpisodeSource, ImportOptions, ImportPlan
from trueup.dataset.importers.beside import plan_with
from trueup.dataset.importers.files import data_files, episode_id, inside, read_bytes
from trueup.dataset.importers.gain_setting import kp_setting_of
from trueup.dataset.importers.headers import Side, Suggestion, column_of, names_joints, sounds_told, suggest, units_in
from trueup.dataset.importers.mapping import ABOUT, ENDINGS, FileValue, TableMapping, substitute
from trueup.dataset.importers.mapping_file import load_mapping, shipped
from trueup.dataset.importers.packed import opened
from trueup.dataset.importers.pattern import matches
from trueup.dataset.importers.table_episode import TableEpisode, load_episode, parts_of
from trueup.dataset.importers.tables import ArrayTable, is_text, open_table
from trueup.dataset.importers.text_table import TextTable, head_of, refuse_headerless
from trueup.errors import DataError, FormatError, NameMismatch, TrueupError

NAME = "table"
LOOKS_FOR = "CSV files; with a mapping file (--mapping, or mapping.yaml beside them) other tables, too"
EPISODE = "what the mapping says"
ASSUMES = "nothing: the mapping says all"

# What a mapping need not say of the head of a file of text.
_USUAL: Mapping[str, Any] = {"skip_lines": 0, "header_rows": 1, "units_row": False, "encoding": ""}
# Files of other columns that a motion may have.
_MOST_FILES = 8
_HEADER_BYTES, _SAMPLE_BYTES = 1 << 16, 1 << 20
# Files beside logs that are none.
_BESIDE = ("split.json", "mapping.yaml")
_NUMBERED = re.compile(r"(.*?[^\d/.]*\d+)[/.].+")
# Of files that nothing else than tables have.
_ENDINGS = (".csv", ".tsv", ".parquet", ".xlsx", ".npy", ".mat", ".jsonl", ".ndjson")
# Of files of text that are tables if their lines are alike.
_MAYBE = (".txt", ".log", ".dat", ".lvm")


def detects(path: Path) -> bool:
    """Whether `path` is a table, holds some, or has a mapping in it."""
    try:
        if (path / "mapping.yaml").is_file() or any(data_files(path, ending) for ending in _ENDINGS):
            return True
        for file in data_files(path, ""):
            if file.suffix.lower() in _MAYBE and _is_table(file):
                return True
        root = path.parent if path.is_file() else path
        return bool(_fitting(root, [file.relative_to(root).as_posix() for file in data_files(path, ".json")]))
    except TrueupError:
        return False


def _is_table(path: Path) -> bool:
    """Whether a file of text has a header above rows of numbers."""
    try:
        with regular(path).open("rb") as file:
            return bool(head_of(file.read(_HEADER_BYTES)).delimiter)
    except OSError:
        return False


def scan(path: Path, options: ImportOptions) -> ImportPlan:
    """List the episodes that the mapping finds below `path`.

    The mapping is `options.mapping` (a file, or the name of a shipped one), else `mapping.yaml` in the folder,
    else the one shipped mapping that fits all files, else `options.spare_mapping`.

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
        names = tables or [name for name in names if name.lower().endswith((".json", *_MAYBE))]
    filled = _filled(root, names)
    try:
        mapping = _recognize(path, root, filled) if given is None else load_mapping(given)
    except FormatError:
        if options.spare_mapping is None or given is not None:
            raise
        mapping = load_mapping(options.spare_mapping)
    if mapping.joint_pattern and (first := next(iter(_matching(mapping, filled)), None)):
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


def _filled(root: Path, names: Sequence[str]) -> Sequence[str]:
    """Those that have anything in them, if any does: others say nothing of how the rest is to be read."""
    return [name for name in names if (root / name).stat().st_size] or names


def _recognize(path: Path, root: Path, names: Sequence[str]) -> TableMapping:
    """The one shipped mapping whose columns and file names fit every file."""
    fitting = _fitting(root, names)
    if len(fitting) == 1:
        return fitting[0]
    first = next(iter(names), None)
    shown = (first, _names_in(inside(root, root / first))) if first else None
    suggestion = suggested(path)
    hint = "Write columns, joints and units into a YAML file for --mapping; docs/logs.md#tables has one to begin with."
    if suggestion is not None:
        hint = (
            f"If this is right, save it as mapping.yaml beside the logs, or give it with --mapping:\n{suggestion.text}"
        )
    raise FormatError(
        f"no mapping says what the columns of {path} are",
        got=f"{shown[0]} with columns {', '.join(shown[1])[:100]}" if shown else "no table",
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
    names = _filled(root, [file.relative_to(root).as_posix() for file in data_files(path, "")])
    ending = next((own for own in ENDINGS if any(name.lower().endswith(own) for name in names)), None)
    tables = [name for name in names if ending and name.lower().endswith(ending)]
    if not tables:
        return None
    kinds = sorted({Path(name).name for name in tables})
    folders = {Path(name).parent for name in tables}
    alike = len(tables) == len(kinds) * len(folders)
    first = Path(tables[0]).parent
    if ending == ".npy" and alike and len(kinds) > 1 and (found := _suggested_of(inside(root, root / tables[0]))):
        # Each folder is a recording, and each file an array of it.
        motion = {
            "episodes": rf"(?:(?P<motion>.+)/)?{re.escape(kinds[0])}",
            "id": "{motion}" if first != Path() else "",
        }
        return _with(found, {key: text for key, text in motion.items() if text})
    pair = _pair(kinds) if alike else None
    if pair is None:
        complete = _complete(root / first, kinds) if alike else None
        return complete or _suggested_of(inside(root, root / tables[0]))
    done, told = pair
    measured = _suggested_of(inside(root, root / first / done))
    command = _suggested_of(inside(root, root / first / told), "command")
    if measured is None or command is None:
        return measured
    own = command.tree["series"]["command"]
    joints = {} if command.tree["joints"] == measured.tree["joints"] else {"joints": command.tree["joints"]}
    tree = {
        **{key: value for key, value in measured.tree.items() if key != "series"},
        "episodes": rf"(?:(?P<motion>.+)/)?{re.escape(done)}",
        "id": "{motion}" if first != Path() else "",
        "series": {
            "measured": measured.tree["series"]["measured"],
            "command": {"file": f"{{motion}}/{told}", "time": own["time"], **joints, "signals": own["signals"]},
        },
    }
    unsure = [line for line in (*measured.unsure, *command.unsure) if "sounds like a command" not in line]
    return Suggestion({key: value for key, value in tree.items() if value}, measured.taken, tuple(unsure))


def _pair(kinds: Sequence[str]) -> tuple[str, str] | None:
    """Of files that are called differently, what was done and what was told; None where their names do not say so."""
    told = [kind for kind in kinds if sounds_told(kind)]
    done = [kind for kind in kinds if kind not in told]
    if len(told) == len(done) == 1:
        return done[0], told[0]
    said = {kind: column_of(Path(kind).stem) for kind in kinds}
    alike = [
        (one, other)
        for one in done
        for other in told
        if (said[one].signal, said[one].words) == (said[other].signal, said[other].words)
    ]
    return next((pair for pair in alike if said[pair[0]].signal in ("position", "")), None)


def _complete(folder: Path, kinds: Sequence[str]) -> Suggestion | None:
    """Of files with other columns each, the one that has measurement and command; None where none has."""
    if not 1 < len(kinds) <= _MOST_FILES:
        return None
    try:
        if len({_names_in(inside(folder, folder / kind)) for kind in kinds}) < 2:
            return None
        for kind in kinds:
            found = _suggested_of(inside(folder, folder / kind))
            if found is not None and "command" in found.tree["series"]:
                return _with(found, {"episodes": rf"(?:.+/)?{re.escape(kind)}"})
    except TrueupError:
        pass
    return None


def _head(path: Path, size: int = _SAMPLE_BYTES) -> tuple[TextTable, dict[str, Any], dict[str, str]]:
    """The beginning of a file of text, what a mapping has to say of its head, and units that stand in it.

    Raises:
        DataError: there is no header, or it cannot be read.
    """
    try:
        with regular(path).open("rb") as file:
            data = file.read(size)
    except OSError as error:
        raise DataError(f"cannot read {path}", got=error.strerror or str(error)) from error
    whole = len(data) < size
    data = data if whole else data[: data.rfind(b"\n") + 1]
    head = head_of(data)
    has_units = bool(units_in({str(place): text for place, text in enumerate(head.last)}))
    skip, rows = head.skip_lines, head.header_rows - has_units
    encoding = _encoding(data)
    table = TextTable(
        path,
        data,
        delimiter=head.delimiter,
        skip_lines=skip,
        header_rows=rows,
        units_row=has_units,
        encoding=encoding,
    )
    units = units_in(dict(zip(table.names, head.last, strict=True))) if has_units else {}
    said = {"skip_lines": skip, "header_rows": rows, "units_row": has_units, "encoding": encoding}
    return table, {key: value for key, value in said.items() if value != _USUAL[key]}, units


def _encoding(data: bytes) -> str:
    """What a mapping has to say of letters that are neither UTF-8 nor marked: they are those of Windows."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return ""
    try:
        codecs.getincrementaldecoder("utf-8")().decode(data)  # which may end within a letter
    except UnicodeDecodeError:
        return "cp1252"
    return ""


def _suggested_of(path: Path, side: Side = "measured") -> Suggestion | None:
    """Of one file: of the first of its groups, where it has a group for each motion.

    Raises:
        DataError: it cannot be read, or it is text whose first line holds numbers.
    """
    if is_text(path):
        text, said, units = _head(path)
        refuse_headerless(path, text.names)
        suggestion = suggest(text, side, units=units)
        return None if suggestion is None else _with(suggestion, said)
    table = open_table(path)
    if isinstance(table, ArrayTable) and (groups := _motions_in(table)):
        within = suggest(table.within(groups[0]), side)
        if within is not None:
            stem = re.sub(r"\d+$", "", groups[0])
            return _with(within, {"group": rf"{re.escape(stem)}\d+"})
    return suggest(table, side)


def _motions_in(table: ArrayTable) -> list[str]:
    """Groups of arrays that only a number tells apart, and that have all there is of a motion each.

    Joints are numbered, too: nothing but a number and a signal is then left of a name, or another joint has the same
    signals without a number.
    """
    found = {name: match for name in table.names if (match := _NUMBERED.fullmatch(name))}
    groups = list(dict.fromkeys(match[1] for match in found.values()))
    stems = {re.sub(r"\d+$", "", group) for group in groups}
    if len(groups) < 2 or len(stems) > 1 or names_joints(stems.pop()):
        return []
    inner = {name[len(match[1]) + 1 :] for name, match in found.items()}
    beside = [name for name in table.names if name not in found]
    if any(re.split(r"[/.]", name, maxsplit=1)[-1] in inner for name in beside):
        return []
    return groups


def _with(suggestion: Suggestion, said: Mapping[str, Any]) -> Suggestion:
    """The same, with what is said of the whole file behind the joints."""
    return replace(suggestion, tree={"joints": suggestion.tree["joints"], **said, **suggestion.tree})


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
    """Names in the first line, where shipped mappings look for them; none if the header stands elsewhere.

    Where the samples begin is looked for only where that line cannot be a header: folders have thousands of files.
    """
    if not is_text(path):
        return open_table(path).names
    try:
        with path.open("rb") as file:
            return TextTable(path, file.read(_HEADER_BYTES), delimiter="").names
    except OSError as error:
        raise DataError(f"cannot read {path}", got=error.strerror or str(error)) from error
    except DataError:
        table, said, _ = _head(path, _HEADER_BYTES)
        return () if said else table.names


def _names_in(path: Path) -> tuple[str, ...]:
    return _head(path, _HEADER_BYTES)[0].names if is_text(path) else open_table(path).names


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
