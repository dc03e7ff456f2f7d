"""Options that several commands share, named and explained once."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from trueup.dataset.importers.base import ImportOptions
from trueup.dataset.importers.detect import FORMATS
from trueup.errors import ConfigError

if TYPE_CHECKING:
    from trueup.robots import RobotSpec
    from trueup.stages import Drafted

Robot = Annotated[
    str, typer.Option("--robot", help="Name of a shipped robot, path of a robot.yaml, or of an MJCF or URDF.")
]
RobotOrModel = Annotated[
    str | None,
    typer.Option("--robot", help="Name of a shipped robot, robot.yaml, MJCF or URDF; optional with --model."),
]
Model = Annotated[
    Path | None,
    typer.Option("--model", exists=True, dir_okay=False, help="MJCF or URDF; else looked for in the dataset's model/."),
]
Results = Annotated[
    Path | None, typer.Option("--out", help="Folder for the results; runs/NAME of the data if not given.")
]
Jobs = Annotated[int | None, typer.Option("--jobs", min=1, help="Threads; the number of cores if not given.")]
Ray = Annotated[
    str | None, typer.Option("--ray", help="Work on a Ray cluster: its HOST:PORT, or local for one on this machine.")
]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Seed of all draws.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace what is there.")]
Resume = Annotated[bool, typer.Option("--resume", help="Go on where an earlier call was interrupted.")]
DropFlagged = Annotated[bool, typer.Option("--drop-flagged", help="Leave out episodes with quality warnings.")]
TrainFlagged = Annotated[
    bool | None,
    typer.Option(
        "--drop-flagged/--keep-flagged",
        help="Leave out all episodes with quality warnings, or none; by default, those with a broken measurement.",
    ),
]
Format = Annotated[
    str | None, typer.Option("--format", help=f"Log format, detected if not given: {', '.join(FORMATS)}.")
]
Mapping = Annotated[
    Path | None, typer.Option("--mapping", help="YAML (or the name of a shipped one) that says what the columns mean.")
]
Units = Annotated[
    list[str] | None,
    typer.Option("--unit", help="SIGNAL=UNIT or SIGNAL.JOINT=UNIT, overriding the format's units; repeatable."),
]
CommandTopic = Annotated[str | None, typer.Option("--command-topic", help="Bag topic that holds the commands.")]
MeasuredTopic = Annotated[str | None, typer.Option("--measured-topic", help="Bag topic that holds the joint states.")]
Splits = Annotated[
    str | None,
    typer.Option("--splits", help="A split.json, or shares TRAIN/VAL/TEST such as 80/10/10, drawn by whole motion."),
]
FailAbove = Annotated[
    list[str] | None,
    typer.Option(
        "--fail-above",
        help="SIGNAL.METRIC=VALUE or RUN:SPLIT:SIGNAL.METRIC=VALUE; exit code 3 if a run is above; repeatable.",
    ),
]
Priority = Annotated[
    int | None,
    typer.Option("--priority", help="Real-time priority of the loop, 1 to 99 (80 is usual); its memory is locked."),
]
Cpu = Annotated[
    list[int] | None, typer.Option("--cpu", min=0, help="Core that the loop runs on; repeatable; all if not given.")
]
Domain = Annotated[
    int | None, typer.Option("--domain", min=0, help="Domain of ROS 2; ROS_DOMAIN_ID, or 0, if not given.")
]
Localhost = Annotated[
    bool | None,
    typer.Option(
        "--localhost/--no-localhost",
        help="This computer only, or all of the network; what ROS's variables say if not given.",
    ),
]
Reliable = Annotated[
    bool,
    typer.Option("--reliable", help="Joint states are reliable, for listeners that ask for it; commands always are."),
]
Form = Annotated[
    Literal["joint_state", "array"],
    typer.Option(
        "--form", help="Commands as JointState, or as Float64MultiArray for ros2_control's forward controllers."
    ),
]
Force = Annotated[bool, typer.Option("--force", help="Continue even if the check finds certain set-up errors.")]
SkipBad = Annotated[bool, typer.Option("--skip-bad", help="Exit with 0 even if some episodes were refused.")]

_SECONDS = {"s": 1.0, "m": 60.0, "h": 3600.0}


_MODELS = (".xml", ".mjcf", ".urdf")


def robot_or_model(robot: str | None, model: Path | None) -> str:
    """What is known of the robot.

    Raises:
        ConfigError: nothing.
    """
    if robot is None and model is None:
        raise ConfigError(
            "nothing says which robot this is",
            expected="--robot NAME, --robot robot.yaml, or --model arm.urdf",
            hint="`trueup init MODEL LOGS` writes a robot.yaml.",
        )
    return str(model) if robot is None else robot


def robot_of(text: str, logs: Path | None = None) -> RobotSpec:
    """What --robot names; of a model file, the description that `trueup init` would write.

    Args:
        text: name of a shipped robot, path of a robot.yaml or of a model.
        logs: of the robot, or a dataset: what they say counts where only a model is given.

    Raises:
        TrueupError: there is none, or model and logs do not fit together.
    """
    from trueup.robots import load_robot

    drafted = drafted_of(text, logs)
    return load_robot(text) if drafted is None else drafted.robot


def drafted_of(
    text: str, logs: Path | None = None, format: str | None = None, choices: ImportOptions | None = None
) -> Drafted | None:
    """What `trueup init` would write for a model and logs, which is said; None for what is no model.

    Args:
        text: see `robot_of`.
        logs: see `robot_of`.
        format: of the logs.
        choices: how they are read.
    """
    from trueup.cli.console import note

    if Path(text).suffix.lower() not in _MODELS:
        return None
    from trueup.stages import draft

    drafted = draft(text, logs, format=format, options=choices)
    for line in drafted.unsure:
        note(line)
    note(f"--robot is a model: the robot is described as `trueup init {text}{f' {logs}' if logs else ''}` would do it")
    return drafted


def budget_s(text: str) -> float | None:
    """`90s`, `10m`, `1.5h` in seconds; None for `none`.

    Raises:
        ConfigError: something else, or no time; a bare number, which some take for seconds and others for minutes.
    """
    if text == "none":
        return None
    number, unit = (text[:-1], text[-1]) if text[-1:] in _SECONDS else (text, "")
    try:
        found = float(number) * _SECONDS.get(unit, 1.0)
    except ValueError:
        found = math.nan
    if not 0 < found < math.inf:
        raise ConfigError("--budget", got=repr(text), expected="a time such as 90s, 10m or 1h, or none")
    if not unit:
        raise ConfigError(
            "--budget has no unit", got=text, hint=f"Give {text}s for seconds, or {text}m for minutes; h is hours."
        )
    return found


def splits_choice(text: str | None) -> Path | dict[str, float] | None:
    """A path, or fractions from per cents.

    Raises:
        ConfigError: neither.
    """
    if text is None:
        return None
    parts = text.split("/")
    if len(parts) == 3 and all(part.strip().replace(".", "", 1).isdigit() for part in parts):
        numbers = [float(part) for part in parts]
        if abs(sum(numbers) - 100.0) > 1.0:  # thirds are rounded
            raise ConfigError("the shares of --splits do not add up to 100", got=text, expected="e.g. 80/10/10")
        return {name: number / sum(numbers) for name, number in zip(("train", "val", "test"), numbers, strict=True)}
    path = Path(text)
    if not path.is_file():
        raise ConfigError("--splits", got=text, expected="a split.json, or three numbers such as 80/10/10")
    return path


def names_among(text: str, known: Sequence[str]) -> list[str]:
    """The names in a list with commas; a known name may have commas of its own."""
    parts, names = text.split(","), []
    while parts:
        ends = range(len(parts), 0, -1)
        end = next((end for end in ends if ",".join(parts[:end]).strip() in known), 1)
        names.append(",".join(parts[:end]).strip())
        parts = parts[end:]
    return [name for name in names if name]


def reading(
    mapping: Path | None,
    unit: list[str] | None,
    command_topic: str | None,
    measured_topic: str | None,
    robot: str | Path | None = None,
) -> ImportOptions:
    """How logs are read; the mapping.yaml that `init` has left beside robot.yaml counts where no other fits.

    Raises:
        ConfigError: a unit is not said as it has to be.
    """
    beside = Path(robot).parent / "mapping.yaml" if robot is not None and Path(robot).is_file() else None
    return ImportOptions(
        mapping=mapping,
        units=unit_choices(unit),
        command_topic=command_topic,
        measured_topic=measured_topic,
        spare_mapping=beside if beside is not None and beside.is_file() else None,
    )


def unit_choices(items: list[str] | None) -> dict[str, str]:
    """{"position.Jaw": "1"} from ["position.Jaw=1"].

    Raises:
        ConfigError: an item has no equals sign.
    """
    units = {}
    for item in items or []:
        name, equals, unit = item.rpartition("=")
        if not (name and equals and unit):
            raise ConfigError("--unit", got=item, expected="SIGNAL=UNIT or SIGNAL.JOINT=UNIT, e.g. position.Jaw=1")
        units[name] = unit
    return units


def folder_for(out: Path | None, data: Path, *, of: str = "", below: str = "runs") -> Path:
    """The folder that was asked for, or one by the name of the data: `runs/arm-fit` for `data/arm` or `logs/arm.csv`.

    A dataset among the results of `close` has the name of these.
    """
    if out is not None:
        return out
    place = data.absolute()
    name = place.parent.name if place.name == "dataset" else place.name.partition(".")[0]
    return Path(below) / (f"{name or 'results'}-{of}" if of else name or "results")
