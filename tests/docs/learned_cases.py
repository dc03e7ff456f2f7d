"""Results of learned corrections with factors of one's choice, in the form that benchmarks/augment.py stores."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from math import sqrt
from typing import Any

from benchmarks.pages.augment_data import Learned

from trueup.core.augment_result import (
    ALL_JOINTS,
    AugmentResult,
    Coverage,
    Cut,
    GatedOutput,
    ModelEvaluation,
    ModelPair,
    Pooled,
    Reliability,
    Verdict,
)
from trueup.core.results import Estimate, MetricResult

JOINTS = tuple(f"joint{number}" for number in range(1, 8))
CONDITIONS = ("", "multi-joint", "single-joint", "cartesian")
# Mean square error of the simulation.
MSE = {"position": 1e-4, "velocity": 2.5e-3, "torque": 16.0}
METHODS = (
    *("realeasy", "realeasy-rt", "paper", "paper-rt", "gru", "mlp", "linear", "transformer"),
    *("moving-average", "moving-average-rt"),
)
COUNTS = (86, 172, 344)
# (model, condition, signal, joint) -> how many times smaller the mean square error gets.
Factor = Callable[[str, str, str, str], float]


def twenty(model: str, condition: str, signal: str, joint: str) -> float:
    """Everything is cut by the same factor."""
    return 20.0


def estimate(value: float, unit: str = "1", spread: float = 1.25) -> Estimate:
    """With an interval that holds what is within the spread."""
    return Estimate(value, unit, value / spread, value * spread)


def verdict_of(factor: Estimate) -> Verdict:
    """As the evaluation gives it."""
    if factor.low > 1.0:
        return "better"
    return "worse" if factor.high < 1.0 else "undecided"


def cut_of(signal: str, value: float) -> Cut:
    """What a factor leaves."""
    mse = MSE[signal] / value
    return Cut(estimate(mse), estimate(sqrt(mse)), estimate(value), verdict_of(estimate(value)))


def coverage_of(share: float) -> Coverage:
    """With an interval of two percent to both sides."""
    return Coverage(Estimate(share, "1", share - 0.02, share + 0.02), estimate(1.0))


def evaluation(
    names: tuple[str, ...], factor: Factor = twenty, run: str = "mujoco/stock", share: float = 0.9
) -> AugmentResult:
    """An evaluation of all signals, joints and conditions."""
    everywhere = (*JOINTS, ALL_JOINTS)
    cuts = {
        name: {
            condition: {
                signal: {joint: cut_of(signal, factor(name, condition, signal, joint)) for joint in everywhere}
                for signal in MSE
            }
            for condition in CONDITIONS
        }
        for name in names
    }
    covered = {
        condition: {signal: {joint: coverage_of(share) for joint in everywhere} for signal in MSE}
        for condition in CONDITIONS
    }
    reliable = Reliability((0.1,), (estimate(0.1),), (1.0,), 0.1, 0.01, 0.5)
    models = tuple(
        ModelEvaluation(
            name,
            name,
            f"{run}+{name}",
            run,
            "panda",
            causal=name not in ("realeasy", "paper", "moving-average", "rough"),
            signals=tuple(MSE),
            cuts=cuts[name],
            coverage=covered,
            reliability={condition: {"torque": reliable} for condition in CONDITIONS},
        )
        for name in names
    )
    pairs = []
    for number, name in enumerate(names):
        for other in names[:number]:
            for condition in CONDITIONS:
                for signal in MSE:
                    left, before = (cuts[item][condition][signal][ALL_JOINTS].mse.value for item in (name, other))
                    found = estimate(before / left)
                    pairs.append(ModelPair(name, other, condition, signal, found, verdict_of(found)))
    pooled = {
        signal: {joint: Pooled(estimate(mse), estimate(sqrt(mse))) for joint in everywhere}
        for signal, mse in MSE.items()
    }
    return AugmentResult(
        run=run,
        split="test",
        joints=JOINTS,
        scored_joints=JOINTS,
        motions=dict.fromkeys(CONDITIONS, 40),
        simulated=dict.fromkeys(CONDITIONS, pooled),
        models=models,
        pairs=tuple(pairs),
    )


def trained(seconds: float = 100.0) -> Mapping[str, Any]:
    """How a training went."""
    val = {signal: {joint: {"simulated": 2.0, "corrected": 1.0} for joint in JOINTS} for signal in MSE}
    return {"seconds": seconds, "epochs": 40, "best_epoch": 38, "val": val, "warmup_steps": 9, "off": []}


def learned(factor: Factor = twenty, *, arm: bool = True, share: float = 0.9) -> Learned:
    """All evaluations, with the same factors."""
    amounts = tuple(f"amount-{count}-{target}" for count in COUNTS for target in ("residual", "plain"))
    robots = ("so101-rt", "so101-precise")
    units = evaluation(("realeasy", "realeasy-rt", "panda-realeasy-rt"), factor)
    rungs = {"fitted": 0.0101, **{f"fitted+{name}": 0.005 for name in robots}}
    return Learned(
        lab=evaluation(METHODS, factor, share=share),
        rough=evaluation(("rough", "rough-rt"), factor, "mujoco/rough"),
        amounts=evaluation(amounts, factor),
        others={"2": units, "3": units},
        arm=evaluation(robots, factor, "mujoco/fitted") if arm else None,
        arm_rungs={name: MetricResult(estimate(value, "rad"), {}, 6) for name, value in rungs.items()} if arm else {},
        training={name: trained() for name in (*METHODS, "rough", "rough-rt", *amounts)},
    )


def without(result: AugmentResult, name: str, signals: tuple[str, ...]) -> AugmentResult:
    """The same, but a network has these signals switched off."""
    off = tuple(GatedOutput(signal, joint, "") for signal in signals for joint in JOINTS)
    return replace(
        result, models=tuple(replace(model, gated=off) if model.name == name else model for model in result.models)
    )


def stored(data: Learned) -> dict[str, Any]:
    """What `python -m benchmarks augment` stores of it."""
    return {
        "schema": "trueup.learned/1",
        "lab": data.lab.to_json(),
        "rough": data.rough.to_json(),
        "amounts": data.amounts.to_json(),
        "others": {unit: item.to_json() for unit, item in data.others.items()},
        "so101": None if data.arm is None else data.arm.to_json(),
        "so101_rungs": {name: metric.to_json() for name, metric in data.arm_rungs.items()},
        "training": data.training,
        "provenance": {},
    }
