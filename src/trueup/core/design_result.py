"""What designed motions promise, parameter by parameter: `design.json`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from trueup.core.atomic import read_json, write_json
from trueup.core.config import build_versioned

DESIGN_NAME = "design.json"
DESIGN_SCHEMA = "trueup.design/1"


@dataclass(frozen=True)
class Foreseen:
    """How well one parameter would be known; standard deviations, of the logarithm for those on the scale `log`.

    Attributes:
        name: `QUANTITY[TARGET]`.
        value: around which the motions are designed.
        unit: of the value, and of the deviations on the scale `linear`.
        transform: `log` (0.1 is about 10 %) or `linear`.
        before: without new motions.
        designed: with the designed ones.
        random: with as many random ones of the same duration; None if there are none.
    """

    name: str
    value: float
    unit: str
    transform: Literal["linear", "log"]
    before: float
    designed: float
    random: float | None


@dataclass(frozen=True)
class DesignResult:
    """The content of design.json.

    Attributes:
        parameters: what the motions promise.
        provenance: versions, seed, and what the motions were designed for.
    """

    parameters: tuple[Foreseen, ...]
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def save(self, path: Path) -> None:
        """Write design.json atomically."""
        write_json(path, {"schema": DESIGN_SCHEMA, **asdict(self)})

    @staticmethod
    def load(path: Path) -> DesignResult:
        """Read design.json.

        Raises:
            FormatError: something else, or another version.
            DataError: broken.
        """
        return build_versioned(DesignResult, read_json(path), str(path), schema=DESIGN_SCHEMA, what="design of motions")
