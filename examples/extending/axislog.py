"""axislog: a folder per motion, in it a semicolon file per joint, each on its own drive's clock."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from trueup.core.episode import Episode, EpisodeMeta, Flag
from trueup.core.timeseries import TimeSeries, same_units
from trueup.dataset.importers.base import EpisodeSource, ImportOptions, ImportPlan
from trueup.dataset.importers.beside import plan_with
from trueup.dataset.importers.clock import common_origin, shifted, usable_clock
from trueup.dataset.importers.files import bytes_hash, data_files, episode_id, inside, read_bytes
from trueup.dataset.importers.parts import on_one_clock
from trueup.dataset.importers.text_table import TextTable
from trueup.dataset.importers.units import override_units
from trueup.errors import FormatError, TrueupError

NAME = "axislog"
LOOKS_FOR = "folders of CSV files, one per joint, that begin with axislog"
EPISODE = "a folder"
ASSUMES = "µs; the unit stands in the first line"

_MAGIC = b"axislog;"
_COLUMNS = {"measured": "actual", "command": "target"}


def detects(path: Path) -> bool:
    """Whether `path` holds such files."""
    try:
        return bool(_motions(path))
    except TrueupError:
        return False


def scan(path: Path, options: ImportOptions) -> ImportPlan:
    """List the motions below `path`.

    Raises:
        FormatError: there is none.
        DataError: a link leads out of the folder.
    """
    motions = _motions(path)
    if not motions:
        raise FormatError(f"{path} holds no axislog", expected=LOOKS_FOR)
    root = path.parent if path in motions else path
    episodes = []
    for folder, files in motions.items():
        source = folder.relative_to(root).as_posix()
        id, size = episode_id(source), sum(file.stat().st_size for file in files)
        episodes.append(EpisodeSource(id, partial(_load, root, id, files, options), size, source))
    return plan_with(NAME, path, root, episodes, robot=options.robot)


def _motions(path: Path) -> dict[Path, list[Path]]:
    """Folder -> its files, joint by joint."""
    found: dict[Path, list[Path]] = {}
    for file in data_files(path, ".csv") if path.is_dir() else ():
        with file.open("rb") as opened:
            if opened.read(len(_MAGIC)) == _MAGIC:
                found.setdefault(file.parent, []).append(file)
    return found


def _load(root: Path, id: str, files: Sequence[Path], options: ImportOptions) -> Episode:
    contents = {file: read_bytes(inside(root, file)) for file in files}
    parts: dict[str, list[TimeSeries]] = {"measured": [], "command": []}
    flags: tuple[Flag, ...] = ()
    for file, data in contents.items():
        unit = data.split(b"\n", 1)[0][len(_MAGIC) :].decode(errors="replace").strip()
        units = override_units(same_units({"position": unit}, [file.stem]), [file.stem], {})
        table = TextTable(file, data, delimiter=";", skip_lines=1)
        text = table.read(["time_us", *_COLUMNS.values()])
        time_s = 1e-6 * table.floats("time_us", text["time_us"])
        rows, found = usable_clock(time_s, source=str(file))
        flags += found
        for series, column in _COLUMNS.items():
            values = table.floats(column, text[column])[rows, None]
            parts[series].append(TimeSeries(time_s[rows], (file.stem,), {"position": values}, units))
    measured, command = (on_one_clock(parts[series]) for series in _COLUMNS)
    origin = common_origin(measured.time_s, command.time_s)
    measured, flags = shifted(measured, flags, origin=origin)
    command, _ = shifted(command, (), origin=origin)
    source = files[0].parent.relative_to(root).as_posix()
    meta = EpisodeMeta(id, options.robot, source=source, source_hash=bytes_hash(contents.values()), flags=flags)
    return Episode(meta, measured, command)
