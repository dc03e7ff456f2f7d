"""What docs/learned-corrections.md is made of: the stored result as objects, and the papers' own numbers beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.pages.panda import TABLE_II
from trueup.core.augment_result import AugmentResult, Cut
from trueup.core.results import MetricResult

PRECISE, REAL_TIME, ZOO = "realeasy", "realeasy-rt", "panda-realeasy-rt"
# As benchmarks/augment_models.py trains it; reading that here would load torch.
ZOO_UNITS = (1, 4, 6, 7)
BASELINES = ("gru", "mlp", "linear", "transformer", "moving-average", "moving-average-rt")
# The same network with the papers' numbers, and with ours.
PAPER_OF = {PRECISE: "paper", REAL_TIME: "paper-rt"}
ROUGH_OF = {PRECISE: "rough", REAL_TIME: "rough-rt"}
TESTS = ("multi-joint", "single-joint", "cartesian")
TEST_NAMES = {"multi-joint": "several joints", "single-joint": "one joint", "cartesian": "straight lines", "": "all"}
TARGETS = ("residual", "plain")

# Realeasy, Table II: torque [Nm2] of joints 0 to 6; before, after.
REALEASY_MSE: Mapping[str, tuple[Sequence[float], Sequence[float]]] = {
    "multi-joint": (TABLE_II, (1.52, 2.84, 1.51, 1.56, 0.0738, 0.102, 0.0693)),
    "cartesian": ((12.3, 6.67, 7.52, 5.34, 2.13, 2.60, 1.65), (0.902, 1.21, 0.921, 0.768, 0.0589, 0.0519, 0.118)),
}
# Realeasy, V: on a part of the lines, on another robot.
REALEASY_OTHER_UNIT_PERCENT = 53
# LSTM thesis, Tables 2 and 4: torque RMSE [Nm] with good and with bad parameters of the simulator; before, after.
THESIS_GOOD = ((5.65, 5.41, 4.61, 4.33, 3.20, 2.75, 2.26), (1.17, 1.78, 1.42, 1.42, 0.317, 0.345, 0.241))
THESIS_BAD = ((44.0, 19.3, 44.6, 11.7, 7.91, 4.37, 4.62), (14.4, 2.33, 1.69, 1.84, 0.354, 0.364, 0.261))


@dataclass(frozen=True)
class Learned:
    """The stored result.

    Attributes:
        lab: all methods on the test motions of the unit that they were trained on.
        rough: networks trained on a simulator with rough parameters, on the same motions.
        amounts: the real-time network by number of motions and loss, `amount-COUNT-TARGET`.
        others: unit -> all its motions; none was trained on.
        arm: the SO-101, on top of its identified simulator.
        arm_rungs: rung -> its position RMSE on the test motions of the SO-101, mean over motions, as identification
            counts; empty without the arm.
        training: model -> how its training went.
    """

    lab: AugmentResult
    rough: AugmentResult
    amounts: AugmentResult
    others: Mapping[str, AugmentResult]
    arm: AugmentResult | None
    arm_rungs: Mapping[str, MetricResult]
    training: Mapping[str, Mapping[str, Any]]

    @staticmethod
    def of(result: Mapping[str, Any]) -> Learned:
        """From the content of benchmarks/results/augment.json."""
        arm = result["so101"]
        return Learned(
            lab=AugmentResult.from_json(result["lab"]),
            rough=AugmentResult.from_json(result["rough"]),
            amounts=AugmentResult.from_json(result["amounts"]),
            others={unit: AugmentResult.from_json(item) for unit, item in result["others"].items()},
            arm=None if arm is None else AugmentResult.from_json(arm),
            arm_rungs={rung: MetricResult.from_json(item) for rung, item in result.get("so101_rungs", {}).items()},
            training=result["training"],
        )

    @property
    def counts(self) -> list[int]:
        """How many motions the networks of `amounts` were trained on, increasing."""
        return counts_of(self.amounts)


def counts_of(amounts: AugmentResult) -> list[int]:
    """Numbers of motions in the names `amount-COUNT-TARGET`, increasing."""
    return sorted({int(model.name.split("-")[1]) for model in amounts.models})


def joint_cuts(result: AugmentResult, model: str, condition: str, signal: str) -> dict[str, Cut]:
    """Joint -> what is left, in the robot's order; without those that are not scored."""
    cuts = result.model(model).cuts[condition].get(signal, {})
    return {joint: cuts[joint] for joint in result.scored_joints if joint in cuts}
