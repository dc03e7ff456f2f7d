"""What every importer offers: recognize a path, list its episodes cheaply, load one at a time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Protocol, runtime_checkable

from trueup.core.episode import Episode
from trueup.errors import ConfigError

# How a note begins that tells of units which logs do not state.
ASSUMED = "UNITS ARE ASSUMED"

# As they are called on the command line.
_OPTIONS = {
    "mapping": "--mapping",
    "units": "--unit",
    "command_topic": "--command-topic",
    "measured_topic": "--measured-topic",
}


@dataclass(frozen=True)
class ImportOptions:
    """What the user says about the logs; everything optional.

    Attributes:
        mapping: YAML file that names columns, units, joints and clocks (CSV), or fields and topics.
        robot: name of the robot, if the logs do not say.
        units: `signal` or `signal.joint` -> unit, over what the format implies.
        command_topic: bag topic that holds the commands.
        measured_topic: bag topic that holds the measured states.
        spare_mapping: YAML file that counts for tables which no other mapping fits.
    """

    mapping: Path | None = None
    robot: str = ""
    units: Mapping[str, str] = field(default_factory=dict)
    command_topic: str | None = None
    measured_topic: str | None = None
    spare_mapping: Path | None = None

    def refuse_others(self, format: str, *read: str) -> None:
        """Refuse what an importer would not look at: whoever said it believes that it counts.

        Args:
            format: the importer's name.
            read: names of the options that it reads; the robot is everybody's, and the spare mapping nobody's choice.

        Raises:
            ConfigError: another one is given.
        """
        unread = {item.name for item in fields(self)} - {"robot", "spare_mapping", *read}
        given = [item.name for item in fields(self) if getattr(self, item.name) and item.name in unread]
        if given:
            raise ConfigError(
                f"{format} logs are read without {' and '.join(_OPTIONS[name] for name in given)}",
                hint="Leave it out, or name the format that is meant with --format.",
            )


@dataclass(frozen=True)
class EpisodeSource:
    """One episode that can be loaded.

    Attributes:
        id: the episode's id (letters, digits, `_ . - /`), unique in the plan and stable between runs: resuming
            an import skips ids that are there.
        load: reads and checks the files; raises only errors of trueup.errors. The split is the plan's.
        bytes: size of its files, for the progress bar.
        source: the file or folder that it stands in, below the folder that is imported.
    """

    id: str
    load: Callable[[], Episode]
    bytes: int = 0
    source: str = ""


@dataclass(frozen=True)
class ImportPlan:
    """What an importer found.

    Attributes:
        format: the importer's name.
        episodes: in a stable order.
        robot: name of the robot, if the logs say.
        licence: licence of the recording, if stated.
        splits: episode id -> `train`, `val` or `test`, from the format or a `split.json` beside the data.
        model_dir: folder with the robot's model beside the data, copied into the dataset.
        notes: what a person should know (assumed units, skipped files).
        kept: what was unpacked for these episodes; it goes when nobody holds the plan any more.
    """

    format: str
    episodes: tuple[EpisodeSource, ...]
    robot: str = ""
    licence: str = ""
    splits: Mapping[str, str] = field(default_factory=dict)
    model_dir: Path | None = None
    notes: tuple[str, ...] = ()
    kept: object = None


@runtime_checkable
class Importer(Protocol):
    """One log format; a module of this package.

    Attributes:
        NAME: of the format, and of the module.
        LOOKS_FOR: what it is recognized by.
        EPISODE: what one episode is.
        ASSUMES: what the files do not say.
    """

    NAME: str
    LOOKS_FOR: str
    EPISODE: str
    ASSUMES: str

    def detects(self, path: Path) -> bool:
        """Whether `path` (file or folder) looks like this format; cheap, raises nothing."""
        ...

    def scan(self, path: Path, options: ImportOptions) -> ImportPlan:
        """List the episodes without loading them.

        Raises:
            TrueupError: the path is not of this format, or an option is wrong.
        """
        ...
