"""What learned corrections are worth: `augment.json`.

Errors are pooled over samples, as in the papers: the mean over all samples of all motions of a group. Intervals are
over whole motions, since samples of one motion are not independent. gap.json beside it has means over motions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from trueup.core.atomic import as_read_back, read_json, without_nan, write_json
from trueup.core.attention import AttentionProfile
from trueup.core.config import build_versioned
from trueup.core.results import Estimate, Verdict
from trueup.core.step_times import StepTimes
from trueup.core.timeseries import BODY_PREFIX
from trueup.errors import ConfigError

AUGMENT_SCHEMA = "trueup.augment/1"
AUGMENT_NAME = "augment.json"
# All motions whatever their condition, and the scored joints together, where they share a unit.
ANY_CONDITION = ""
ALL_JOINTS = ""

ErrorKind = Literal["mse", "rmse"]


def group_title(condition: str) -> str:
    """A group of motions as people call it."""
    return condition or "all motions"


def joint_title(joint: str, signal: str = "") -> str:
    """A joint, or all that are scored together; of a body's signal a body, or all of them."""
    return joint or ("all bodies" if _of_bodies(signal) else "all joints")


def _of_bodies(signal: str) -> bool:
    return signal.startswith(BODY_PREFIX)


@dataclass(frozen=True)
class Pooled:
    """An error over all samples of a group of motions.

    Attributes:
        mse: mean square error, e.g. [(Nm)^2].
        rmse: its root, e.g. [Nm].
    """

    mse: Estimate
    rmse: Estimate


@dataclass(frozen=True)
class Cut:
    """What is left of an error after correction.

    Attributes:
        mse: mean square error of the corrected signal.
        rmse: its root.
        factor: how many times smaller the MSE is than the simulator's on the same motions; below 1 it grew. NaN where
            nothing is left of it, or nothing was there.
        verdict: `better` or `worse` where the paired interval of the factor excludes 1 (so that the interval of the
            difference excludes zero), else `undecided`.
    """

    mse: Estimate
    rmse: Estimate
    factor: Estimate
    verdict: Verdict


@dataclass(frozen=True)
class Coverage:
    """How often the measured value lies in the interval around the corrected one.

    Attributes:
        share: share of samples, mean over motions.
        half_width: mean half width of the interval, likewise.
    """

    share: Estimate
    half_width: Estimate


@dataclass(frozen=True)
class JointGap:
    """How far the bodies of a run are from being joined at a joint; all numbers are means over motions.

    Attributes:
        apart: distance between the two halves, mean over samples [m].
        apart_max: the largest one of a motion.
        turned: angle between them off the joint's axis, mean over samples [rad].
        turned_max: the largest one of a motion.
    """

    apart: Estimate
    apart_max: Estimate
    turned: Estimate
    turned_max: Estimate


@dataclass(frozen=True)
class Reliability:
    """Whether "the simulator is far off here" is right as often as it says, over the joints of one signal.

    Attributes:
        predicted: mean predicted probability of each bin that has samples, increasing.
        observed: share of its samples in which the simulator was far off.
        weight: share of all samples that fall into it.
        far: share of all samples in which the simulator was far off.
        error: expected calibration error, the mean over samples of |observed - predicted| of their bin.
        skill: how much smaller the Brier score is than that of always saying `far`: 1 is perfect, 0 tells nothing;
            None where it is always or never far off.
    """

    predicted: tuple[float, ...]
    observed: tuple[Estimate, ...]
    weight: tuple[float, ...]
    far: float
    error: float
    skill: float | None

    def __post_init__(self) -> None:
        """Refuse columns of unequal length."""
        if not len(self.predicted) == len(self.observed) == len(self.weight):
            raise ConfigError("the columns of a reliability curve have unequal lengths")


@dataclass(frozen=True)
class GatedOutput:
    """An output that its training switched off.

    Attributes:
        signal: signal name.
        joint: joint name.
        reason: why, from the card.
    """

    signal: str
    joint: str
    reason: str


@dataclass(frozen=True)
class ModelEvaluation:
    """One network on these motions; the mappings go condition -> signal -> joint.

    Attributes:
        name: from its card.
        method: likewise.
        run: label of the corrected run.
        trained_run: run that it was trained to correct.
        trained_robot: kind of robot that it was trained for.
        causal: whether it can run in a control loop.
        signals: those that it was trained to correct, whether they are switched off or not.
        cuts: what is left of each error.
        gated: outputs that are switched off.
        coverage: of its intervals; only where it has some.
        coverage_target: share that they are to cover.
        coverage_note: what limits that.
        reliability: condition -> signal -> of the probability that the simulator is far off.
        latency: of one step; None where it was not timed.
        gaps: joint -> how far corrected bodies are apart there, where bodies are corrected.
        attention: where it looks in the past; None of a network without attention, or where that is not known.
    """

    name: str
    method: str
    run: str
    trained_run: str
    trained_robot: str
    causal: bool
    signals: tuple[str, ...]
    cuts: Mapping[str, Mapping[str, Mapping[str, Cut]]]
    gated: tuple[GatedOutput, ...] = ()
    coverage: Mapping[str, Mapping[str, Mapping[str, Coverage]]] = field(default_factory=dict)
    coverage_target: float = 0.9
    coverage_note: str = ""
    reliability: Mapping[str, Mapping[str, Reliability]] = field(default_factory=dict)
    latency: StepTimes | None = None
    gaps: Mapping[str, JointGap] = field(default_factory=dict)
    attention: AttentionProfile | None = None

    @property
    def off_reasons(self) -> list[str]:
        """Why outputs are switched off, each reason once."""
        return list(dict.fromkeys(item.reason for item in self.gated if item.reason))

    def is_off(self, signal: str, joint: str) -> bool:
        """Whether the training switched this output off; see `AugmentResult.is_off` for all joints together."""
        return any((item.signal, item.joint) == (signal, joint) for item in self.gated)


@dataclass(frozen=True)
class ModelPair:
    """One network against another on the same motions, the scored joints together.

    Attributes:
        model: the one that is judged.
        baseline: the other.
        condition: group of motions.
        signal: signal name.
        factor: MSE of the baseline over that of the model.
        verdict: of the model.
    """

    model: str
    baseline: str
    condition: str
    signal: str
    factor: Estimate
    verdict: Verdict


@dataclass(frozen=True)
class AugmentResult:
    """Corrections of one simulated run, side by side.

    Attributes:
        run: label of the simulated run that is corrected.
        split: split that was evaluated; `all` for all motions.
        joints: all joints, in order.
        scored_joints: those that stand for all.
        motions: condition -> number of motions, `ANY_CONDITION` first.
        simulated: condition -> signal -> joint -> error of the simulator.
        models: one item per network, in the order given.
        pairs: every network against those that were named before it.
        conditions_of: motion -> its condition.
        gaps: joint -> how far the simulated bodies are apart there, which a simulator keeps small.
        measured_gaps: the same of the bodies as they were measured: what the robot is built differently from its model.
        notes: what must be said.
        settings: bootstrap draws, seed, bins of the reliability.
        provenance: versions, data hash, hashes of the cards.
    """

    run: str
    split: str
    joints: tuple[str, ...]
    scored_joints: tuple[str, ...]
    motions: Mapping[str, int]
    simulated: Mapping[str, Mapping[str, Mapping[str, Pooled]]]
    models: tuple[ModelEvaluation, ...]
    pairs: tuple[ModelPair, ...] = ()
    conditions_of: Mapping[str, str] = field(default_factory=dict)
    gaps: Mapping[str, JointGap] = field(default_factory=dict)
    measured_gaps: Mapping[str, JointGap] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def signals(self) -> tuple[str, ...]:
        """The signals that were compared."""
        return tuple(self.simulated.get(ANY_CONDITION, {}))

    @property
    def main_signal(self) -> str:
        """The torque, which simulators have worst, where a network corrects it; else the first that one corrects."""
        corrected = {signal for model in self.models for signal in model.signals}
        known = [signal for signal in self.signals if signal in corrected] or list(self.signals)
        return "torque" if "torque" in known else known[0]

    @property
    def conditions(self) -> tuple[str, ...]:
        """The groups worth a table of their own: all motions last, and only where they are not one group anyway."""
        named = tuple(name for name in self.motions if name != ANY_CONDITION)
        return named if len(named) == 1 and self._covers_all(named[0]) else (*named, ANY_CONDITION)

    def _covers_all(self, condition: str) -> bool:
        return self.motions[condition] == self.motions[ANY_CONDITION]

    def model(self, name: str) -> ModelEvaluation:
        """The network of this name."""
        return next(item for item in self.models if item.name == name)

    def joints_of(self, condition: str, signal: str) -> list[str]:
        """Those whose errors are known, in the robot's order, or its bodies; all together last."""
        known = self.simulated[condition].get(signal, {})
        names = [name for name in known if name != ALL_JOINTS] if _of_bodies(signal) else self.joints
        return [name for name in (*names, ALL_JOINTS) if name in known]

    def _bodies_of(self, signal: str) -> list[str]:
        return [name for name in self.joints_of(ANY_CONDITION, signal) if name != ALL_JOINTS]

    def unit_of(self, condition: str, signal: str, error: ErrorKind) -> str:
        """The unit of all errors of a signal; empty if its joints have different ones."""
        units = {getattr(pooled, error).unit for pooled in self.simulated[condition][signal].values()}
        return units.pop() if len(units) == 1 else ""

    def is_off(self, model: ModelEvaluation, signal: str, joint: str) -> bool:
        """Whether the training of a network switched an output off; all together if all scored joints are."""
        every = self._bodies_of(signal) if _of_bodies(signal) else self.scored_joints
        return all(model.is_off(signal, name) for name in (every if joint == ALL_JOINTS else (joint,)))

    def off_outputs(self, model: ModelEvaluation) -> list[str]:
        """What the training of a network switched off, signal by signal, e.g. `torque of joint1, joint2`."""
        joints: dict[str, list[str]] = {}
        for item in model.gated:
            joints.setdefault(item.signal, []).append(item.joint)
        return [
            f"{signal} of " + (joint_title(ALL_JOINTS, signal) if self._are_all(signal, names) else ", ".join(names))
            for signal, names in joints.items()
        ]

    def _are_all(self, signal: str, names: Sequence[str]) -> bool:
        every = self._bodies_of(signal) if _of_bodies(signal) else self.joints
        return set(every) <= set(names)

    def best(self, signal: str) -> ModelEvaluation | None:
        """The network that leaves least of a signal's error, over all motions; None without networks."""

        def left(model: ModelEvaluation) -> float:
            cuts = model.cuts.get(ANY_CONDITION, {}).get(signal, {})
            known = [cuts[ALL_JOINTS]] if ALL_JOINTS in cuts else list(cuts.values())
            return sum(cut.mse.value for cut in known) / len(known) if known else math.inf

        return min(self.models, key=left, default=None)

    def to_json(self) -> dict[str, Any]:
        """The content of augment.json."""
        return {"schema": AUGMENT_SCHEMA, **as_read_back(without_nan(asdict(self)))}

    @staticmethod
    def from_json(data: Any, where: str = AUGMENT_NAME) -> AugmentResult:
        """Read back what `to_json` wrote.

        Raises:
            FormatError: something else, or of another version.
            DataError: broken.
        """
        return build_versioned(AugmentResult, _with_nan(data), where, schema=AUGMENT_SCHEMA, what="evaluation")

    def save(self, path: Path) -> None:
        """Write augment.json atomically."""
        write_json(path, self.to_json())

    @staticmethod
    def load(path: Path) -> AugmentResult:
        """Read augment.json."""
        return AugmentResult.from_json(read_json(path), str(path))


def _with_nan(tree: Any) -> Any:
    """An estimate without a value is one that is not defined."""
    if isinstance(tree, Mapping):
        missing = {"value", "unit"} <= tree.keys() and tree["value"] is None
        return {key: _with_nan(value) for key, value in tree.items()} | ({"value": math.nan} if missing else {})
    return [_with_nan(value) for value in tree] if isinstance(tree, list) else tree
