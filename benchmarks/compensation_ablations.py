"""What each part of the operator is worth: without it, or with more of it, all else equal (GapONet, 5.4).

On the stock simulator, where there is most to be learned, with the updates, batches and windows of `compensation`,
whose operator on the stock simulator is the whole one. `true sensors` asks the simulator itself, k times in each
control step, in place of the predictor: in training by the linear model, in tests by simulating.

`python -m benchmarks compensation_ablations` trains what is not there, under runs/gapo. Its figures are kept in
benchmarks/results/compensation_ablations.json.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.compensation import CONTROL_S, SHORT, STOCK, plants, prepared, table, trained
from benchmarks.gapo_data import FOLDER, SEEN_KG, data_of, robot_of
from benchmarks.table import Row, rounded, shown
from trueup.augment.corrector import Corrector
from trueup.augment.networks.operator import OperatorConfig
from trueup.compensate.closed_loop import closed_loop
from trueup.compensate.config import METHODS, CompensateConfig
from trueup.compensate.correctors import blank, scale
from trueup.compensate.judging import cost, judged
from trueup.compensate.rounds import learn
from trueup.compensate.sensors import Sensors
from trueup.compensate.training import Teacher
from trueup.compensate.windows import Windows
from trueup.core.atomic import as_read_back, json_hash, make_folder, read_json, write_json
from trueup.core.provenance import provenance

RESULT = Path(__file__).parent / "results" / "compensation_ablations.json"
SEEDS = range(3)
WHOLE = OperatorConfig()
TOLD = "true sensors"
VARIANTS: Mapping[str, OperatorConfig] = {
    "whole": WHOLE,
    "no sensors": replace(WHOLE, senses="none"),
    TOLD: replace(WHOLE, senses="true"),
    "payload not read": replace(WHOLE, conditioned=False),
    "5 sensors": replace(WHOLE, sensors=5),
    "60 sensors": replace(WHOLE, sensors=60),
    "no history": replace(WHOLE, history=1),
    "history of 9": replace(WHOLE, history=9),
}
# Asking the simulator takes as long as everything else; a quarter of the val motions says enough.
_JUDGED_TOLD = 4


def run() -> list[Row]:
    """Train what is not there, and simulate the test motions."""
    spawned = multiprocessing.get_context("spawn")
    names = list(VARIANTS)
    with ProcessPoolExecutor(2, mp_context=spawned) as pool:
        parts = list(pool.map(tables_of, (names[::2], names[1::2])))
    result = {
        "tables": {name: own for part in parts for name, own in part.items()},
        "provenance": provenance(config=asdict(SHORT), seed=0, data_hash=data_of("train").hash),
    }
    write_json(RESULT, rounded(result))
    return rows(read_json(RESULT))


def tables_of(names: list[str]) -> dict[str, Any]:
    """Figures of some variants; see `compensation.table`."""
    torch.set_num_threads(1)
    found: dict[str, Any] = {}
    for name in names:
        config = replace(METHODS["operator"], network=VARIANTS[name], training=SHORT)
        if name == TOLD:
            windows = Windows(list(prepared(STOCK).train), WHOLE.history - 1)
            sensors = Sensors.of(windows, WHOLE.sensors, len(robot_of("train").joints))
            networks = [_told(config, windows, sensors, seed) for seed in SEEDS]
            found[name] = table(STOCK, networks, sensors=sensors)
        else:
            # The whole one is that of `compensation`.
            stem = "operator-on-stock" if name == "whole" else f"ablation {name}"
            found[name] = table(STOCK, [trained(stem, STOCK, config, seed).corrector for seed in SEEDS])
        print(f"{name}: done", flush=True)
    return found


def _told(config: CompensateConfig, windows: Windows, sensors: Sensors, seed: int) -> Corrector:
    """As `compensate` trains; it cannot, since what it makes has no simulator to ask."""
    corrector = blank(config, len(robot_of("train").joints), 1.0 / CONTROL_S, seed, sensed=sensors.center.numel())
    scale(corrector, config, windows)
    motions = judged([part.track for part in prepared(STOCK).val])[::_JUDGED_TOLD]
    aims = [motion.state.astype(np.float64) for motion in motions]
    folder = FOLDER / "networks" / f"ablation {TOLD}-{seed}"
    make_folder(folder)
    learn(
        corrector,
        Teacher(windows, config, prepared(STOCK).plants.simulate, told=sensors),
        lambda network: cost(closed_loop(motions, plants(STOCK), network, sensors=sensors), aims, config.loss),
        seed=seed,
        checkpoint=folder / "checkpoint.safetensors",
        inputs=json_hash(as_read_back({"data": prepared(STOCK).data_hash, "config": asdict(config)})),
        resume=True,
    )
    return corrector


def rows(result: Mapping[str, Any]) -> list[Row]:
    rows = []
    for name, tests in result["tables"].items():
        for payload_kg in SEEN_KG:
            values = np.array(tests["test"][f"{payload_kg:g}"]["mae"])
            rows.append(shown(f"{name}, {payload_kg:g} kg: mean error", float(values.mean()), "rad"))
    return rows
