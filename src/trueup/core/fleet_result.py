"""What was found of many robots of one kind: `fleet.json`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from trueup.core.atomic import read_json, without_nan, write_json
from trueup.core.config import build_versioned

FLEET_NAME = "fleet.json"
FLEET_SCHEMA = "trueup.fleet/1"


@dataclass(frozen=True)
class UnitValue:
    """A parameter of one unit.

    Attributes:
        value: fitted.
        low: lower end of its 95 % interval.
        high: upper end.
        identified: whether the data determine it: `yes`, `effective`, `weakly`, `no`.
    """

    value: float
    low: float
    high: float
    identified: str


@dataclass(frozen=True)
class FleetUnit:
    """One robot.

    Attributes:
        name: of the unit.
        folder: of its results, relative to that of fleet.json.
        status: of its fit, `failed` where there is none, `measured` where none was asked for.
        motions: number of its recordings.
        seconds: that it took [s].
        reason: why it failed.
        errors: rung -> split -> RMSE of the first signal that is compared, mean over joints and motions.
        parameters: name -> value.
    """

    name: str
    folder: str
    status: str
    motions: int = 0
    seconds: float = 0.0
    reason: str = ""
    errors: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    parameters: Mapping[str, UnitValue] = field(default_factory=dict)


@dataclass(frozen=True)
class FleetParameter:
    """One parameter over all units that determine it.

    Attributes:
        name: `QUANTITY[TARGET]`.
        unit: of value and interval.
        label: what it is, in words.
        relative: whether spread and uncertainty are shares of the value, as of what cannot be negative.
        units: number of units that determine it.
        mean: of the population.
        low: lower end of the 95 % interval of the mean.
        high: upper end.
        nominal: what the model says; None if it has no such number.
        spread: standard deviation between units, beyond their own uncertainty.
        uncertainty: median standard deviation of a unit's own value.
        apart: units that are not like the others.
    """

    name: str
    unit: str
    label: str
    relative: bool
    units: int
    mean: float
    low: float
    high: float
    nominal: float | None
    spread: float
    uncertainty: float
    apart: tuple[str, ...] = ()


@dataclass(frozen=True)
class FleetResult:
    """The content of fleet.json.

    Attributes:
        units: in the order in which they were given.
        parameters: in the order of the fits.
        signal: of the errors, and its unit, e.g. `position [rad]`.
        until: the last step that was asked for.
        provenance: versions, git hash, seed.
    """

    units: tuple[FleetUnit, ...]
    parameters: tuple[FleetParameter, ...]
    signal: str
    until: str
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def save(self, path: Path) -> None:
        """Write fleet.json, whole or not at all."""
        write_json(path, without_nan({"schema": FLEET_SCHEMA, **asdict(self)}))

    @staticmethod
    def load(path: Path) -> FleetResult:
        """Read it back.

        Raises:
            DataError: it is not there, or no JSON.
            FormatError: it is none of this version.
        """
        return build_versioned(FleetResult, read_json(path), str(path), schema=FLEET_SCHEMA, what="result of a fleet")
