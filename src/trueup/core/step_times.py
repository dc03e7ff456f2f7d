"""How long the steps of a stream take: `latency.json`, beside the network that was timed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from trueup.core.atomic import as_read_back, read_json, write_json
from trueup.core.config import build_versioned

LATENCY_SCHEMA = "trueup.latency/1"
LATENCY_NAME = "latency.json"


@dataclass(frozen=True)
class StepTimes:
    """Times of single steps, and the loop that they were taken in.

    Attributes:
        count: steps that were timed.
        p50_us: median [us].
        p99_us: 99 % take no longer [us].
        p999_us: 99.9 % take no longer [us].
        max_us: longest [us].
        bins: histogram: from [us], to [us], steps; bins without steps are left out.
        period_us: period of the loop [us]; None where steps were timed without one.
        missed: deadlines that were missed because of a step; None without a loop.
        machine: what it ran on, for people.
        network: SHA-256 of the `model.onnx` that was timed; empty where nobody has said.
    """

    count: int
    p50_us: float
    p99_us: float
    p999_us: float
    max_us: float
    bins: tuple[tuple[float, float, int], ...]
    period_us: float | None = None
    missed: int | None = None
    machine: str = ""
    network: str = ""

    @staticmethod
    def of_loop(report: Mapping[str, Any], *, machine: str = "", network: str = "") -> StepTimes:
        """From the report of a real-time loop (`deploy.LoopReport.to_json`).

        Args:
            report: what it says.
            machine: what it ran on, for people.
            network: SHA-256 of the `model.onnx` that was timed.
        """
        step = {**report["step"], "bins": tuple(tuple(item) for item in report["step"]["bins"])}
        period_us, missed = 1e6 / report["rate_hz"], report["overran_by_step"]
        return StepTimes(**step, period_us=period_us, missed=missed, machine=machine, network=network)

    def to_json(self) -> dict[str, Any]:
        """The content of latency.json."""
        return {"schema": LATENCY_SCHEMA, **as_read_back(asdict(self))}

    @staticmethod
    def from_json(data: Any, where: str = LATENCY_NAME) -> StepTimes:
        """Read back what `to_json` wrote.

        Raises:
            FormatError: something else, or of another version.
            DataError: broken.
        """
        return build_versioned(StepTimes, data, where, schema=LATENCY_SCHEMA, what="times")

    def save(self, path: Path) -> None:
        """Write latency.json atomically."""
        write_json(path, self.to_json())

    @staticmethod
    def load(path: Path) -> StepTimes:
        """Read latency.json."""
        return StepTimes.from_json(read_json(path), str(path))
