"""npz files: one file, one episode; the keys are `measured.time_s`, `measured.position`, `joints` and so on.

A file holds, for each of the series `measured`, `command` (optional) and `simulated/LABEL` (optional):
`SERIES.time_s` (T,) [s], and `SERIES.SIGNAL` (T, J), or (T, B, ...) for body signals. `joints` names the columns
(`SERIES.joints` where a series has others), `bodies` likewise. `SERIES.SIGNAL.unit` is one unit, or one per joint;
SI without it. Optional: `robot`, `unit`, `payload_kg`,
`kp_setting`, `condition`. The file's name is the episode's id.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float, Shaped

from trueup.core.episode import Episode, EpisodeMeta, Flag
from trueup.core.npz import arrays_of
from trueup.core.timeseries import BODY_PREFIX, TimeSeries
from trueup.core.units import SI_UNIT, UNITS
from trueup.dataset.importers.base import EpisodeSource, ImportOptions, ImportPlan
from trueup.dataset.importers.beside import plan_with
from trueup.dataset.importers.clock import usable_clock
from trueup.dataset.importers.files import bytes_hash, data_files, episode_id, inside, read_bytes
from trueup.dataset.importers.gain_setting import kp_setting_of
from trueup.dataset.importers.headers import suggest
from trueup.dataset.importers.mapping import COMPONENTS
from trueup.dataset.importers.tables import ArrayTable
from trueup.dataset.importers.units import override_units
from trueup.errors import DataError, FormatError, NameMismatch, TrueupError, UnitError

NAME = "npz"
LOOKS_FOR = "npz files with measured.time_s, measured.position, joints, ..."
EPISODE = "a file"
ASSUMES = "SI where no unit is stored"

_TEXTS = ("robot", "unit", "condition")
_NAMES = ("joints", "bodies")
_NUMBERS = ("payload_kg", "kp_setting")
_SERIES_KEYS = ("time_s", *_NAMES, *SI_UNIT, *(f"{signal}.unit" for signal in SI_UNIT))


def detects(path: Path) -> bool:
    """Whether `path` is an npz file or holds some."""
    try:
        return bool(data_files(path, ".npz"))
    except TrueupError:
        return False


def scan(path: Path, options: ImportOptions) -> ImportPlan:
    """List the npz files below `path`; an episode's id is its path without the ending.

    Raises:
        FormatError: there is none.
        ConfigError: an option that is not read.
        DataError: a link leads out of the folder; two files would get the same id.
    """
    options.refuse_others(NAME, "units")
    files = data_files(path, ".npz")
    if not files:
        raise FormatError(f"{path} holds no npz file", expected=LOOKS_FOR)
    root = path.parent if path.is_file() else path
    episodes = []
    for file in files:
        source = file.relative_to(root).as_posix()
        id = episode_id(source[: -len(".npz")])
        episodes.append(EpisodeSource(id, partial(_load, root, file, id, options), file.stat().st_size, source))
    return plan_with(NAME, path, root, episodes, robot=options.robot)


def _load(root: Path, path: Path, id: str, options: ImportOptions) -> Episode:
    """Read one file."""
    data = read_bytes(inside(root, path))
    arrays = arrays_of(data, path)
    labels = [key.removesuffix(".time_s") for key in arrays if key.endswith(".time_s")]
    known = {f"{label}.{key}" for label in labels for key in _SERIES_KEYS} | {*_TEXTS, *_NAMES, *_NUMBERS}
    strange = [label for label in labels if label not in {"measured", "command"} and not label.startswith("simulated/")]
    strange += [key for key in arrays if key not in known]
    if strange or "measured" not in labels:
        raise DataError(
            f"{path} does not have the keys of an episode",
            got=", ".join(strange or sorted(arrays))[:200],
            expected="measured.time_s, measured.SIGNAL, measured.SIGNAL.unit, the same with command. or "
            f"simulated/LABEL., and {', '.join((*_NAMES, *_TEXTS, *_NUMBERS))}; SIGNAL is one of {', '.join(SI_UNIT)}",
            hint=_mapping_hint(path, arrays) if "measured" not in labels else None,
        )
    done = {label: _series(path, arrays, label, options) for label in labels}
    numbers = {key: float(_numbers(path, key, arrays[key], ndim=0)) for key in _NUMBERS if key in arrays}
    texts = {key: " ".join(_words(path, key, arrays[key])) for key in _TEXTS if key in arrays}
    meta = EpisodeMeta(
        id=id,
        robot=options.robot or texts.get("robot", ""),
        unit=texts.get("unit", ""),
        payload_kg=numbers.get("payload_kg"),
        kp_setting=kp_setting_of(numbers.get("kp_setting"), f"{path}: kp_setting"),
        condition=texts.get("condition", ""),
        source=path.relative_to(root).as_posix(),
        source_hash=bytes_hash([data]),
        flags=tuple(flag for _, flags in done.values() for flag in flags),
    )
    return Episode(
        meta=meta,
        measured=done["measured"][0],
        command=done["command"][0] if "command" in done else None,
        simulated={label.partition("/")[2]: one[0] for label, one in done.items() if label.startswith("simulated/")},
    )


def _mapping_hint(path: Path, arrays: dict[str, Shaped[np.ndarray, "..."]]) -> str:
    """What reads the arrays of other programs."""
    suggestion = suggest(ArrayTable(path, list(arrays), arrays.__getitem__))
    if suggestion is None:
        return "A mapping file reads the arrays of other programs: docs/logs.md#tables."
    return f"A mapping reads it. If this is right, save it as mapping.yaml beside the logs:\n{suggestion.text}"


def _series(
    path: Path, arrays: dict[str, Shaped[np.ndarray, "..."]], label: str, options: ImportOptions
) -> tuple[TimeSeries, tuple[Flag, ...]]:
    """One series of the file."""
    own = {key: arrays[f"{label}.{key}"] for key in _SERIES_KEYS if f"{label}.{key}" in arrays}
    names = {key: _words(path, key, own.get(key, arrays.get(key, np.array([], dtype=str)))) for key in _NAMES}
    signals = [signal for signal in SI_UNIT if signal in own]
    if not signals or not names["joints"]:
        raise DataError(f"{path} has no signal or no joints for {label!r}", got=", ".join(arrays)[:200])
    time_s = _numbers(path, f"{label}.time_s", own["time_s"], ndim=1).astype(np.float64)
    rows, flags = usable_clock(time_s, source=f"{path}, {label}", series=label)
    values, units = {}, {}
    for signal in signals:
        slots = names["bodies"] if signal.startswith(BODY_PREFIX) else names["joints"]
        shape = (time_s.size, len(slots), *COMPONENTS.get(signal, ()))
        array = _numbers(path, f"{label}.{signal}", own[signal], ndim=len(shape))
        if array.shape != shape:
            raise DataError(f"{path}: {label}.{signal} has the wrong shape", got=array.shape, expected=shape)
        values[signal] = array[rows]
        unit = _words(path, f"{signal}.unit", own.get(f"{signal}.unit", np.array(SI_UNIT[signal])))
        units[signal] = unit * len(slots) if len(unit) == 1 else unit
        if len(units[signal]) != len(slots) or not set(unit) <= set(UNITS):
            raise UnitError(f"{path}: {label}.{signal}.unit does not fit {', '.join(slots)}", available=UNITS)
    units |= override_units(
        {key: unit for key, unit in units.items() if not key.startswith(BODY_PREFIX)}, names["joints"], options.units
    )
    bodies = names["bodies"] if any(key.startswith(BODY_PREFIX) for key in values) else ()
    return TimeSeries(time_s=time_s[rows], joints=names["joints"], signals=values, units=units, bodies=bodies), flags


def _words(path: Path, key: str, array: Shaped[np.ndarray, "..."]) -> tuple[str, ...]:
    """Names or one text."""
    if array.ndim > 1 or (array.size and array.dtype.kind != "U"):
        raise DataError(f"{path}: {key} is not text", got=f"{array.dtype} of shape {array.shape}")
    words = tuple(str(word) for word in array.reshape(-1))
    if key in _NAMES and len(set(words)) < len(words):
        raise NameMismatch(f"{path}: {key} has a name twice", left=words, right=sorted(set(words)))
    return words


def _numbers(path: Path, key: str, array: Shaped[np.ndarray, "..."], *, ndim: int) -> Float[np.ndarray, "..."]:
    """Finite numbers, or NaN for missing samples; float32 stays, everything else becomes float64."""
    if array.dtype.kind not in "fiu" or array.ndim != ndim:
        raise DataError(
            f"{path}: {key} cannot be used",
            got=f"{array.dtype} of shape {array.shape}",
            expected=f"numbers with {ndim} dimensions",
        )
    numbers = array if array.dtype == np.float32 else array.astype(np.float64)
    if np.isinf(numbers).any():
        raise DataError(f"{path}: {key} has values that are infinite", got=f"{int(np.isinf(numbers).sum())} of them")
    return numbers
