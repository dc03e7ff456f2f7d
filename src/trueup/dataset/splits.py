"""Which motions are for training, for choosing, for the final number. Always whole motions."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from trueup.core.atomic import read_json
from trueup.errors import ConfigError, DataError, FormatError

SPLITS = ("train", "val", "test")

_SUFFIX = re.compile(r"\.[A-Za-z][A-Za-z0-9]{1,7}$")
_FOLDER_AND_FILE = re.compile(r"(?P<folder>.*\S)\s*\((?P<file>[^()]+)\)")


@dataclass(frozen=True)
class SplitMatch:
    """What a split file means for some episodes.

    Attributes:
        splits: episode id -> split.
        notes: entries without an episode, episodes without an entry.
    """

    splits: Mapping[str, str]
    notes: tuple[str, ...] = ()


def read_split(path: Path) -> dict[str, tuple[str, ...]]:
    """Read a split file: `{"train": ["motion", ...], "val": [...], "test": [...]}`.

    Returns:
        split -> entries as they stand there.

    Raises:
        DataError: the file is not readable JSON.
        FormatError: it is of another form, or has other splits.
    """
    data = read_json(path)
    if not isinstance(data, dict) or not all(
        isinstance(entries, list) and all(isinstance(entry, str) for entry in entries) for entries in data.values()
    ):
        raise FormatError(f"{path} is no split file", expected='{"train": ["motion", ...], "val": [...], ...}')
    unknown = sorted(set(data) - set(SPLITS))
    if unknown:
        raise FormatError(f"{path} has unknown splits", got=unknown, expected=SPLITS)
    return {split: tuple(entries) for split, entries in data.items()}


def match_splits(
    entries: Mapping[str, Sequence[str]], ids: Sequence[str], *, sources: Mapping[str, str] | None = None
) -> SplitMatch:
    """Find the episodes that the entries of a split file mean.

    An entry is an episode's id or source, with or without a file suffix (`trajectory_00.csv`), a file in a folder
    (`energy_shaping (data_1kg.csv)`), the last part of one id (`chirp` for `session1/chirp`), or a folder, which
    means all episodes in it that no other entry names.

    Args:
        entries: split -> entries, from `read_split`.
        ids: ids of the episodes.
        sources: episode id -> file or folder that it came from.

    Raises:
        DataError: an episode is in two splits; the last part of an id fits several episodes.
    """
    names = {id: _names_of(id, (sources or {}).get(id, "")) for id in ids}
    exact: dict[str, tuple[str, str]] = {}
    folders: dict[str, tuple[str, str]] = {}
    notes = []
    for split, items in entries.items():
        for entry in items:
            key = _key(entry)
            found = _exact(key, names)
            into = exact
            if not found:
                found = [id for id, known in names.items() if any(name.startswith(key + "/") for name in known)]
                into = folders
            if not found:
                notes.append(f"split {split!r}: no episode for entry {entry!r}")
            for id in found:
                _assign(into, id, split, entry)
    # A folder's file that has an entry of its own belongs to that entry.
    chosen = {**folders, **exact}
    without = [id for id in ids if id not in chosen]
    if without and chosen:
        notes.append(f"{len(without)} of {len(ids)} episodes are in no split: {', '.join(without[:5])}")
    return SplitMatch({id: chosen[id][0] for id in ids if id in chosen}, tuple(notes))


def _key(name: str) -> str:
    """One spelling for an entry, an id and a source."""
    match = _FOLDER_AND_FILE.fullmatch(name.strip())
    path = f"{match['folder']}/{match['file']}" if match else name.strip()
    return _SUFFIX.sub("", path.replace("\\", "/").removeprefix("./").rstrip("/"))


def _names_of(id: str, source: str) -> set[str]:
    # The id as it is, too: `v1.abc` may be a whole id and not a file.
    return {name for name in (id, _key(id), _key(source)) if name}


def _exact(key: str, names: Mapping[str, set[str]]) -> list[str]:
    found = [id for id, known in names.items() if key in known]
    if found or "/" in key:
        return found
    last = [id for id, known in names.items() if any(name.rsplit("/", 1)[-1] == key for name in known)]
    if len(last) > 1:
        raise DataError(f"entry {key!r} of the split fits several episodes", got=last, expected="the whole id")
    return last


def _assign(into: dict[str, tuple[str, str]], id: str, split: str, entry: str) -> None:
    before = into.setdefault(id, (split, entry))
    if before[0] != split:
        raise DataError(
            f"episode {id!r} is in two splits",
            got=f"{before[0]!r} by entry {before[1]!r} and {split!r} by entry {entry!r}",
            hint="delete one of the two entries",
        )


def assign_splits(ids: Sequence[str], fractions: Mapping[str, float], *, seed: int) -> dict[str, str]:
    """Draw a split for each motion: as many as the shares say, rounded, and at least one for each.

    The order of the draw is that of a hash of id and seed, so that next to all episodes keep their split when others
    are added.

    Args:
        ids: ids of the episodes.
        fractions: split -> share, e.g. {"train": 0.7, "val": 0.15, "test": 0.15}; they add up to 1.
        seed: another seed draws another partition.

    Raises:
        ConfigError: fractions that do not add up to 1, unknown splits, or fewer episodes than splits.
    """
    wanted = {split: share for split, share in fractions.items() if share != 0}
    if not set(fractions) <= set(SPLITS) or not abs(sum(wanted.values()) - 1) <= 1e-9 or min(wanted.values()) < 0:
        raise ConfigError("fractions must add up to 1", got=dict(fractions), expected=SPLITS)
    drawn = sorted(set(ids), key=lambda own: (_draw(own, seed), own))
    if len(drawn) < len(wanted):
        raise ConfigError(f"{len(drawn)} episodes are too few for {len(wanted)} splits", got=dict(fractions))
    counts = _counts(len(drawn), wanted)
    names = [split for split, count in counts.items() for _ in range(count)]
    return dict(zip(drawn, names, strict=True))


def _counts(total: int, shares: Mapping[str, float]) -> dict[str, int]:
    """How many are of each: at least one, and then those that are furthest from their share."""
    counts = dict.fromkeys(shares, 1)
    for _ in range(total - len(shares)):
        counts[max(shares, key=lambda split: shares[split] * total - counts[split])] += 1
    return counts


def _draw(id: str, seed: int) -> float:
    """Uniform in [0, 1), a function of its arguments only."""
    return int.from_bytes(hashlib.sha256(f"{seed}\0{id}".encode()).digest()[:7], "big") / 256**7
