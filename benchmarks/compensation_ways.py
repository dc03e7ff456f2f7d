"""Three ways to train one operator, in error, seconds and energy: directly, delta action by delta action, and by PPO.

On the stock simulator, as the paper trains: the same data, network, loss and updates (`direct` and `delta`), and as
many control steps of reinforcement as `--method operator` takes by default. One seed; intervals are over motions.

`python -m benchmarks compensation_ways` trains what is not there, under runs/gapo. Its figures are kept in
benchmarks/results/compensation_ways.json.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.compensation import SHORT, STOCK, table, trained
from benchmarks.gapo_data import SEEN_KG, data_of
from benchmarks.table import Row, rounded, shown
from trueup.compensate.config import METHODS, Way
from trueup.core.atomic import read_json, write_json
from trueup.core.effort import Effort
from trueup.core.provenance import provenance

RESULT = Path(__file__).parent / "results" / "compensation_ways.json"
WAYS: tuple[Way, ...] = ("direct", "delta", "ppo")
SEED = 0


def run() -> list[Row]:
    """Train what is not there, and simulate the test motions."""
    torch.set_num_threads(1)
    result = {
        "ways": {way: _trained(way) for way in WAYS},
        "none": table(STOCK, [None]),
        "provenance": provenance(config=asdict(METHODS["operator"]), seed=SEED, data_hash=data_of("train").hash),
    }
    write_json(RESULT, rounded(result))
    return rows(read_json(RESULT))


def _trained(way: Way) -> dict[str, Any]:
    config = replace(METHODS["operator"], training=replace(SHORT, way=way))
    # Trained directly, it is a network of `compensation`.
    name = "operator-on-stock" if way == "direct" else f"operator by {way}"
    made = trained(name, STOCK, config, SEED)
    said = made.card.provenance["training"]
    effort = Effort(said["seconds"], said["cpu_seconds"])
    return {
        "cpu_seconds": effort.cpu_seconds,
        "joules": effort.joules,
        "val": float(np.mean([item["after"] for item in said["val"]])),
        "tables": table(STOCK, [made.corrector]),
    }


def rows(result: Mapping[str, Any]) -> list[Row]:
    rows = []
    for way, own in result["ways"].items():
        for payload_kg in SEEN_KG:
            values = np.array(own["tables"]["test"][f"{payload_kg:g}"]["mae"])
            rows.append(shown(f"{way}, {payload_kg:g} kg: mean error", float(values.mean()), "rad"))
        rows.append(shown(f"{way}: processor time", own["cpu_seconds"], "s"))
        rows.append(shown(f"{way}: energy, at 8 W a core", own["joules"] / 1e3, "kJ"))
    return rows
