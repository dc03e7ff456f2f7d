"""What the quality checks found, episode by episode: `quality.json`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from trueup.core.atomic import read_json, write_json
from trueup.core.config import build_versioned
from trueup.core.episode import Flag, warning_kinds

QUALITY_SCHEMA = "trueup.quality/1"


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
