"""dataset.json: what holds for all episodes of a dataset."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path, PurePosixPath
from typing import Any

from trueup.core.atomic import is_inside, read_json, write_json
from trueup.core.timeseries import TimeSeries
from trueup.errors import ConfigError, DataError, FormatError

DATASET_SCHEMA = "trueup.dataset/1"
INFO_NAME = "dataset.json"
# Where folders of results have the dataset from which they were made.
_INSIDE = "dataset"
# Two of their files; of the second one an import would make what it can.
_RESULTS = ("gap.json", "traces.npz")


@dataclass(frozen=True)
class DatasetInfo:
    """What holds for all episodes.

    Attributes:
        robot: name of the robot.
        joints: names of the measured joints, in the log's order; filled in while episodes are written.
        units: signal (`position`, `command.position`) -> joint or body -> unit; filled in while episodes are
            written. The units that count are those of each series.
        licence: licence of the recording.
        model: folder or file of the robot's model, relative to the dataset's folder and inside it.
        provenance: where the dataset comes from, JSON types only.
        notes: what a person should know (assumed units, skipped files).
    """

    robot: str = ""
    joints: tuple[str, ...] = ()
    units: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    licence: str = ""
    model: str = ""
    provenance: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """The content of dataset.json."""
        return {"schema": DATASET_SCHEMA, **asdict(self)}

    @staticmethod
    def from_json(data: Any) -> DatasetInfo:
        """Read back what `to_json` wrote.

        Raises:
            FormatError: another version, unknown or missing keys, or values of the wrong type.
        """
        found = data.get("schema") if isinstance(data, Mapping) else type(data).__name__
        if found != DATASET_SCHEMA:
            raise FormatError("no dataset, or one of another version", got=found, expected=DATASET_SCHEMA)
        known = {item.name for item in fields(DatasetInfo)}
        values = {name: value for name, value in data.items() if name != "schema"}
        if not set(values) <= known:
            raise FormatError("unknown keys", got=sorted(set(values) - known), available=sorted(known))
        for name, kind in _KINDS.items():
            if not _is(values.get(name, kind()), kind):
                raise FormatError(f"the value of {name!r} is of the wrong type", got=values[name])
        if not all(isinstance(owners, dict) and _is([*owners.values()], list) for owners in _units(values)):
            raise FormatError("the value of 'units' is of the wrong type", expected="signal -> joint -> unit")
        for name in ("joints", "notes"):
            if name in values:
                values[name] = tuple(values[name])
        return DatasetInfo(**values)

    def covering(self, prefix: str, series: TimeSeries) -> DatasetInfo:
        """This, with the joints and units of a series added; the same object if it adds nothing.

        Args:
            prefix: `` for measured, `command.` for command.
            series: the series.
        """
        joints = self.joints if prefix else tuple(dict.fromkeys(self.joints + series.joints))
        units = {signal: dict(owners) for signal, owners in self.units.items()}
        for signal, owned in series.units.items():
            owners = series.bodies if signal.startswith("body.") else series.joints
            known = units.setdefault(prefix + signal, {})
            for owner, unit in zip(owners, owned, strict=True):
                known.setdefault(owner, unit)
        if joints == self.joints and units == self.units:
            return self
        return replace(self, joints=joints, units=units)

    def model_path(self, folder: Path) -> Path | None:
        """Where the model is, None if there is none.

        Raises:
            ConfigError: it is not inside the dataset's folder.
        """
        if not self.model:
            return None
        relative = PurePosixPath(self.model)
        inside = not relative.is_absolute() and ".." not in relative.parts and "\\" not in self.model
        # A link out of the folder is a way out, too.
        if not inside or "\0" in self.model or not is_inside(folder, folder / relative):
            raise ConfigError(
                f"{folder / INFO_NAME} names a model outside its folder",
                got=repr(self.model),
                expected="a path inside, such as 'model'",
            )
        return folder / relative

    def save(self, folder: Path) -> None:
        """Write dataset.json atomically.

        Raises:
            ConfigError: the model is outside the folder; provenance has something that is not JSON.
        """
        self.model_path(folder)
        try:
            write_json(folder / INFO_NAME, self.to_json())
        except (TypeError, ValueError, RecursionError) as error:
            raise ConfigError("the description of the dataset is not JSON", got=error) from error

    @staticmethod
    def load(folder: Path) -> DatasetInfo:
        """Read dataset.json.

        Raises:
            FormatError: the folder is no dataset, or one of another version.
            DataError: the file is damaged.
            ConfigError: it names a path outside its folder.
        """
        path = folder / INFO_NAME
        if not path.is_file():
            refuse_results(folder)
            got = "no dataset.json in it" if folder.is_dir() else "no such folder"
            raise FormatError(
                f"{folder} is no trueup dataset", got=got, hint="`trueup import LOGS --out DIR` makes one"
            )
        try:
            info = DatasetInfo.from_json(_read(path))
        except FormatError as error:
            raise FormatError(f"{path}: {error}", hint="a newer trueup may read it; or import the logs again") from None
        info.model_path(folder)
        return info


_KINDS: Mapping[str, type] = {
    "robot": str,
    "joints": list,
    "units": dict,
    "licence": str,
    "model": str,
    "provenance": dict,
    "notes": list,
}


def _is(value: Any, kind: type) -> bool:
    """Whether a JSON value is of a kind; the lists in dataset.json hold texts only."""
    if isinstance(value, list):
        return kind is list and all(isinstance(item, str) for item in value)
    return isinstance(value, kind)


def _units(values: Mapping[str, Any]) -> list[Any]:
    return list(values.get("units", {}).values())


def _read(path: Path) -> Any:
    try:
        return read_json(path)
    except DataError as error:
        raise DataError(
            f"{path} is broken",
            got=error.details.removeprefix("got "),
            hint="Restore it from a copy, or import the logs again.",
        ) from error


def refuse_results(path: Path) -> None:
    """Refuse what is neither logs nor a dataset, although data are in it.

    Raises:
        FormatError: a folder of results, be the dataset from which they were made in it or not.
        DataError: a dataset whose dataset.json is damaged, which would be taken for logs.
    """
    if (path / INFO_NAME).is_file():
        _read(path / INFO_NAME)
    elif is_dataset(path / _INSIDE):
        raise FormatError(
            f"{path} holds results; its data are in {path / _INSIDE}", hint=f"Give {path / _INSIDE} instead."
        )
    elif all((path / name).is_file() for name in _RESULTS):
        raise FormatError(f"{path} holds results, no data", hint="Give the dataset from which they were made.")


def is_dataset(path: Path) -> bool:
    """Whether the folder is a dataset of any version; raises nothing."""
    try:
        data = read_json(path / INFO_NAME)
    except DataError:
        return False
    return isinstance(data, dict) and str(data.get("schema", "")).startswith("trueup.dataset/")
