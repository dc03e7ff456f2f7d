"""What the quality checks found, episode by episode (`quality.json`), and who is left out because of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from trueup.core.atomic import read_json, write_json
from trueup.core.config import build_versioned
from trueup.core.episode import EpisodeMeta, Flag, warning_kinds
from trueup.errors import DataError

QUALITY_SCHEMA = "trueup.quality/1"


def dropped(metas: Iterable[EpisodeMeta], *, drop_flagged: bool | None) -> dict[str, str]:
    """Motion -> why, of those that are left out; `drop_flagged` as of `EpisodeMeta.why_dropped`."""
    reasons = {meta.id: ", ".join(meta.why_dropped(drop_flagged=drop_flagged)) for meta in metas}
    return {name: why for name, why in reasons.items() if why}


def refuse_majority(reasons: Mapping[str, str], count: int, *, keep: str) -> None:
    """Stop where more than half of the motions to learn from would be left out.

    Args:
        reasons: motion -> the kinds of flags because of which it is left out.
        count: of all motions of the split, with those.
        keep: how one says that they are used all the same.

    Raises:
        DataError: more than half of them.
    """
    if 2 * len(reasons) <= count:
        return
    times = Counter(kind for why in reasons.values() for kind in why.split(", "))
    raise DataError(
        "the measurement is broken in most of the train motions",
        got=f"{len(reasons)} of {count}: {', '.join(f'{kind} in {times[kind]}' for kind in sorted(times))}",
        expected="at most half",
        hint=f"docs/logs.md#quality-flags says what that means; mend the logs, or use them as they are: {keep}.",
    )


def left_out(reasons: Mapping[str, Mapping[str, str]], *, most: int = 4) -> list[str]:
    """One sentence for each split about motions that are left out.

    Args:
        reasons: split -> motion -> why.
        most: as many are named.
    """
    sentences = []
    for split, own in reasons.items():
        named = "; ".join(f"{name} ({why})" for name, why in list(own.items())[:most])
        more = f"; … ({len(own) - most} more)" if len(own) > most else ""
        count = "1 motion" if len(own) == 1 else f"{len(own)} motions"
        sentences += [f"{count} of {split} left out: {named}{more}"] if own else []
    return sentences


@dataclass(frozen=True)
class EpisodeQuality:
    """The flags of one episode.

    Attributes:
        split: its split, or empty.
        flags: what was found.
        dropped: whether the episode was left out of the result because of them.
    """

    split: str = ""
    flags: tuple[Flag, ...] = ()
    dropped: bool = False

    @property
    def warned(self) -> bool:
        """Whether a flag of severity `warning` is set."""
        return bool(warning_kinds(self.flags))


@dataclass(frozen=True)
class Quality:
    """The content of quality.json.

    Attributes:
        episodes: episode id -> what was found, for all episodes that were checked.
        provenance: versions, git hash, data hash.
    """

    episodes: Mapping[str, EpisodeQuality]
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """The content of quality.json."""
        episodes = {
            name: {"split": item.split, "dropped": item.dropped, "flags": [flag.to_json() for flag in item.flags]}
            for name, item in self.episodes.items()
        }
        return {"schema": QUALITY_SCHEMA, "episodes": episodes, "provenance": dict(self.provenance)}

    @staticmethod
    def from_json(data: Any, where: str = "quality.json") -> Quality:
        """Read back what `to_json` wrote.

        Raises:
            FormatError: not a list of quality flags, or of another version.
            DataError: a list of quality flags, but broken.
        """
        return build_versioned(Quality, data, where, schema=QUALITY_SCHEMA, what="quality flags")

    def save(self, path: Path) -> None:
        """Write quality.json atomically."""
        write_json(path, self.to_json())

    @staticmethod
    def load(path: Path) -> Quality:
        """Read quality.json."""
        return Quality.from_json(read_json(path), str(path))
