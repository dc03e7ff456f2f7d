"""What lies beside the logs: `split.json`, a licence, the robot's model; and the plan that has all of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from trueup.core.atomic import regular
from trueup.dataset.importers.base import EpisodeSource, ImportPlan
from trueup.dataset.importers.files import inside, unique_ids
from trueup.dataset.splits import match_splits, read_split
from trueup.errors import DataError

_LONGEST_TITLE = 4096


def plan_with(
    format: str,
    path: Path,
    root: Path,
    episodes: Sequence[EpisodeSource],
    *,
    robot: str = "",
    licence: str = "",
    notes: Iterable[str] = (),
) -> ImportPlan:
    """The plan of these episodes with what lies beside them; a licence that is stated comes first.

    Args:
        format: name of the importer.
        path: what is imported: the folder of all motions, or one of them, which does not miss the splits of others.
        root: the folder in which the motions lie.
        episodes: what was found.
        robot: its name, if the logs say.
        licence: if the logs say.
        notes: what a person should know.

    Raises:
        DataError: two episodes have the same id, or something that lies beside them cannot be read.
        FormatError: `split.json` is no split file.
    """
    unique_ids((episode.id, episode.source) for episode in episodes)
    splits, unmatched = splits_beside(root, {episode.id: (episode.source,) for episode in episodes})
    return ImportPlan(
        format=format,
        episodes=tuple(episodes),
        robot=robot,
        licence=licence or licence_beside(root),
        splits=splits,
        model_dir=model_beside(root),
        notes=(*notes, *(unmatched if path == root else ())),
    )


def splits_beside(
    root: Path, ids: Mapping[str, Iterable[str]] | Iterable[str]
) -> tuple[dict[str, str], tuple[str, ...]]:
    """Splits from `split.json` in `root`; how its entries name episodes: see `trueup.dataset.splits`.

    Args:
        root: folder that the episodes were found in.
        ids: the episode ids; as a mapping, with the file or folder that each was made from, relative to `root`.

    Returns:
        Episode id -> split, empty if there is no `split.json`; and notes on entries and episodes that do not match.

    Raises:
        DataError: the file cannot be read or puts an episode into two splits.
        FormatError: it is no split file.
    """
    path = root / "split.json"
    if not path.is_file():
        return {}, ()
    sources = {name: next(iter(files), "") for name, files in ids.items()} if isinstance(ids, Mapping) else {}
    match = match_splits(read_split(inside(root, path)), list(ids), sources=sources)
    return dict(match.splits), match.notes


def licence_beside(root: Path) -> str:
    """The title of the licence file in `root`: its first line, with the version line that follows it; or empty.

    Raises:
        DataError: the file cannot be read, or leads out of the folder.
    """
    for name in ("LICENSE", "LICENCE", "LICENSE.txt", "LICENSE.md", "COPYING"):
        path = root / name
        if path.is_file():
            text = _begin(inside(root, path)).decode("utf-8-sig", errors="replace")
            lines = [line.strip(" #\t") for line in text.splitlines() if line.strip(" #\t")]
            title = " ".join(lines[:2] if len(lines) > 1 and lines[1].startswith("Version") else lines[:1])
            return title[:200]
    return ""


def _begin(path: Path) -> bytes:
    try:
        with regular(path).open("rb") as file:
            return file.read(_LONGEST_TITLE)
    except OSError as error:
        raise DataError(f"cannot read {path}", got=error.strerror or str(error)) from error


def model_beside(root: Path) -> Path | None:
    """The folder `model` in `root`, if it holds an MJCF or URDF file.

    Raises:
        DataError: it leads out of the folder.
    """
    folder = root / "model"
    if not folder.is_dir():
        return None
    inside(root, folder)
    models = [path for path in folder.iterdir() if path.suffix.lower() in {".xml", ".urdf", ".mjcf"}]
    return folder if models else None
