"""One network for all servos of a real arm: trained on three of them, tested on two that it never saw (SAT, VI-A).

Identifies the recorded SO-101, trains what is missing under runs/sat_so101 and evaluates it on the test motions; writes
`benchmarks/results/sat_so101.json`, from which a part of docs/building-blocks.md is made.

    python -m benchmarks sat_so101
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.augment_models import ARM_MODELS, so101
from benchmarks.table import Row, at_most, shown
from trueup.augment import AugmentConfig, preset
from trueup.augment.config import DataConfig
from trueup.core.atomic import make_folder, write_text
from trueup.core.model_card import ModelCard
from trueup.core.provenance import provenance
from trueup.core.results import GapResult
from trueup.dataset import Dataset
from trueup.measure import paired_difference
from trueup.robots import load_robot
from trueup.stages import FITTED, augment, evaluate

RESULT = Path(__file__).parent / "results" / "sat_so101.json"
FOLDER = Path("runs") / "sat_so101"
SEEN = ("shoulder_pan", "shoulder_lift", "elbow_flex")
UNSEEN = ("wrist_flex", "wrist_roll")
SEEDS = (0, 1, 2)
METRICS = ("mae", "rmse")
SIMULATOR = "simulator"


def sat(*, modular: bool = True, joints: tuple[str, ...] = ()) -> AugmentConfig:
    """A SAT as `leave_one_out` chose it, on two of the three joints at a time."""
    config = preset("sat")
    return replace(
        config,
        data=DataConfig(
            signals=("position",),
            reads=("velocity", "torque"),
            command=("position",),
            joints=joints,
            stops=False,
            modular=modular,
        ),
    )


# What stands in the tables: name -> how it is trained. All correct the position on the identified simulator.
MODELS: Mapping[str, AugmentConfig] = {
    "sat": sat(joints=SEEN),
    "sat-all": sat(),
    "sat-whole": sat(modular=False),
    "realeasy-rt": ARM_MODELS["so101-rt"].config,
    "realeasy": ARM_MODELS["so101-precise"].config,
}


@dataclass(frozen=True)
class Errors:
    """Of one run on the test motions, in radians.

    Attributes:
        motions: episode ids.
        values: metric -> joint -> one value per motion.
    """

    motions: tuple[str, ...]
    values: Mapping[str, Mapping[str, np.ndarray]]

    def over(self, metric: str, joints: tuple[str, ...]) -> np.ndarray:
        """The mean over joints, one value per motion."""
        found: np.ndarray = np.mean([self.values[metric][joint] for joint in joints], axis=0)
        return found


def run() -> list[Row]:
    """Identify, train, evaluate, write the result file; nothing without the recordings."""
    arm = so101()
    if arm is None:
        return []
    for name in MODELS:
        for seed in SEEDS:
            train(arm, name, seed)
    folders = [_folder(name, seed) for name in MODELS for seed in SEEDS]
    evaluated = evaluate(arm, folders, FOLDER / "evaluated", run=FITTED, overwrite=True)
