"""How far a learned correction carries: `robustness.json`, and `robustness.cells.json`, the errors it is made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from trueup.core.atomic import as_read_back, read_json, write_json
from trueup.core.config import build_versioned
from trueup.core.results import Estimate, Verdict

ROBUSTNESS_SCHEMA = "trueup.robustness/1"
ROBUSTNESS_NAME = "robustness.json"
CELLS_SCHEMA = "trueup.robustness-cells/1"
CELLS_NAME = "robustness.cells.json"

ErrorKind = Literal["mae", "max"]
ERROR_KINDS: Mapping[ErrorKind, str] = {"mae": "mean error", "max": "largest error"}


@dataclass(frozen=True)
class Improvement:
    """An error before and after correction, over the same motions.

    Attributes:
        simulated: of the simulator, mean over motions.
        corrected: what is left of it.
        gone: share of it that is gone, with the paired interval over motions; negative where the correction harms.
        verdict: `better` or `worse` where that interval excludes zero, else `undecided`.
    """

    simulated: Estimate
    corrected: Estimate
    gone: Estimate
    verdict: Verdict


@dataclass(frozen=True)
class RobustnessRow:
    """A simulator on a dataset.

    Attributes:
        dataset: name of the dataset.
        motions: number of motions.
        errors: mean absolute error (`mae`) and largest one of a motion (`max`), mean over joints or bodies.
        perturbation: what is off; empty for the simulator as it is.
        share: share of the largest size.
        size: how far off: standard deviations, see `sim.perturbation.Perturbation`.
        draws: number of simulators that were drawn; each motion counts with its mean over them.
        least: share of the mean error that is gone under the draw that leaves most.
    """

    dataset: str
    motions: int
    errors: Mapping[ErrorKind, Improvement]
    perturbation: str = ""
    share: float = 0.0
    size: Mapping[str, float] = field(default_factory=dict)
    draws: int = 1
    least: float | None = None


@dataclass(frozen=True)
class RobustnessResult:
    """The content of robustness.json.

    Attributes:
        network: name of the network.
        method: its method.
        robot: the robot that is simulated.
        signal: `position` of joints, or `body.position`.
        parts: the joints or bodies whose errors count.
        split: of the motions; `all` for all.
        rows: datasets with the simulator as it is, in the order given; then the first of them with simulators that are
            off, by perturbation and share.
        notes: what must be said.
        settings: seeds, draws, shares, bootstrap draws.
        provenance: versions, data hashes, configuration.
    """

    network: str
    method: str
    robot: str
    signal: str
    parts: tuple[str, ...]
    split: str
    rows: tuple[RobustnessRow, ...]
    notes: tuple[str, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def datasets(self) -> tuple[RobustnessRow, ...]:
        """The simulator as it is, one row per dataset."""
        return tuple(row for row in self.rows if not row.perturbation)

    @property
    def perturbed(self) -> Mapping[str, tuple[RobustnessRow, ...]]:
        """Perturbation -> its rows, by growing share."""
        names = dict.fromkeys(row.perturbation for row in self.rows if row.perturbation)
        found = {name: [row for row in self.rows if row.perturbation == name] for name in names}
        return {name: tuple(sorted(rows, key=lambda row: row.share)) for name, rows in found.items()}

    def to_json(self) -> dict[str, Any]:
        """The content of robustness.json."""
        return {"schema": ROBUSTNESS_SCHEMA, **as_read_back(asdict(self))}

    @staticmethod
    def from_json(data: Any, where: str = ROBUSTNESS_NAME) -> RobustnessResult:
        """Read back what `to_json` wrote.

        Raises:
            FormatError: something else, or of another version.
            DataError: broken.
        """
        return build_versioned(
            RobustnessResult, data, where, schema=ROBUSTNESS_SCHEMA, what="result about the robustness of a correction"
        )

    def save(self, path: Path) -> None:
        """Write robustness.json atomically."""
        write_json(path, self.to_json())

    @staticmethod
    def load(path: Path) -> RobustnessResult:
        """Read robustness.json."""
        return RobustnessResult.from_json(read_json(path), str(path))


@dataclass(frozen=True)
class Cell:
    """One simulator on one dataset.

    Attributes:
        errors: motion -> mean and largest error of the simulator, mean and largest error after correction.
        failed: motion -> why it has none.
    """

    errors: Mapping[str, tuple[float, float, float, float]]
    failed: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Cells:
    """The content of robustness.cells.json: what is there when work goes on.

    Attributes:
        inputs: hash of what decides about all cells: datasets, motions, robot, model and network.
        cells: name of a cell -> the cell.
    """

    inputs: str
    cells: Mapping[str, Cell] = field(default_factory=dict)

    def save(self, path: Path) -> None:
        """Write robustness.cells.json atomically."""
        write_json(path, {"schema": CELLS_SCHEMA, **as_read_back(asdict(self))})

    @staticmethod
    def load(path: Path) -> Cells:
        """Read robustness.cells.json.

        Raises:
            FormatError: something else, or of another version.
            DataError: broken.
        """
        return build_versioned(Cells, read_json(path), str(path), schema=CELLS_SCHEMA, what="cells of robustness")
