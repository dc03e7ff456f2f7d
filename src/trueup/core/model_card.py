"""What a trained network says of itself: `model.json`, beside `model.onnx` and `weights.safetensors`.

Everything that is needed to run it is here or in `model.onnx`, so that a robot needs neither torch nor a simulator.

`model.onnx` takes and returns SI values as they are; normalization, gate and the sum with the simulator's signal are
inside. With B copies side by side and any number T of samples:

    x (T, B, I) float32            the input channels, in the card's order
    STATE (..., B, ...) float32    one tensor per state of the card, axis `batch_axis` is B
    ->
    y (T, B, K) float32            the corrected output channels, in the card's order
    STATE_out                      the states after the last sample, same shapes

A network that looks into the future (`causal: false`) has no states and takes whole motions. A modular one has the
channels of one joint, called `*`: it takes all joints of a robot side by side, whichever robot it is (`of_joints`). A
network for bodies has channels of bodies where others have those of joints.

`step.npz`, where there is one, holds the weights as the machine code of `deploy.sat_machine` reads them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Int

from trueup.core.atomic import file_hash, read_json, write_json
from trueup.core.card import sealed, unsealed, verified, what_is
from trueup.core.config import build
from trueup.core.timeseries import BODY_PREFIX, TimeSeries
from trueup.errors import ConfigError, DataError, MissingSignal

CARD_SCHEMA = "trueup.model/1"
CARD_NAME = "model.json"
ONNX_NAME = "model.onnx"
WEIGHTS_NAME = "weights.safetensors"
STEP_NAME = "step.npz"
ANY_JOINT = "*"
# Beyond, an input would be in range whatever it is.
LARGEST_MARGIN = 1e6


@dataclass(frozen=True)
class Channel:
    """One number per sample.

    Attributes:
        signal: signal name, e.g. `torque`; of a body one of its components, e.g. `body.position.x`.
        joint: joint name, as the robot has it, or name of the body; empty for what is of no joint.
        unit: SI unit.
        series: where it comes from: the simulator, the command that robot and simulator follow, what the robot's
            sensors have said one sample before, or the condition that a motion is under, such as its payload.
    """

    signal: str
    joint: str
    unit: str
    series: Literal["simulated", "command", "measured", "condition"] = "simulated"

    @property
    def name(self) -> str:
        """E.g. `simulated.torque.joint1`."""
        return f"{self.series}.{self.signal}.{self.joint}".rstrip(".")

    @property
    def of_body(self) -> bool:
        """Whether it is of a body, and not of a joint."""
        return self.signal.startswith(BODY_PREFIX)

    @property
    def quantity(self) -> str:
        """The signal of the robot that it is of: `body.position` for `body.position.x`."""
        return self.signal.rpartition(".")[0] if self.of_body else self.signal


@dataclass(frozen=True)
class Input(Channel):
    """An input channel and the range that training covered.

    Attributes:
        low: smallest value of the train split.
        high: largest value of the train split.
        relative: whether both are of how far it is from the simulated channel of its signal and joint, which is itself
            not read.
    """

    low: float = -math.inf
    high: float = math.inf
    relative: bool = False


@dataclass(frozen=True)
class Output(Channel):
    """An output channel: a simulated signal after correction, and how far it can be trusted.

    Attributes:
        base: number of the input channel that is corrected.
        gate: share of the network's correction that is used; 0 is switched off.
        reason: why it is switched off; empty if it is not.
        interval: half width of the interval [unit] for a correction c: `interval[0] + interval[1] * |c|`; None if there
            is none.
        far: a simulator that is off by more than this is far off [unit].
        far_correction: corrections at which the probability of "far off" is known, increasing [unit].
        far_probability: those probabilities, not decreasing.
    """

    base: int = 0
    gate: float = 1.0
    reason: str = ""
    interval: tuple[float, float] | None = None
    far: float | None = None
    far_correction: tuple[float, ...] = ()
    far_probability: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        """Refuse numbers that a file cannot hold."""
        numbers = (self.gate, *(self.interval or ()), self.far or 0.0, *self.far_correction, *self.far_probability)
        if not all(math.isfinite(number) for number in numbers):
            raise ConfigError(f"output {self.name}", got=numbers, expected="finite numbers, or None for no interval")


@dataclass(frozen=True)
class State:
    """A tensor that a stream carries from sample to sample.

    Attributes:
        name: of the input of the ONNX graph; the output is called `NAME_out`.
        shape: with 1 for the batch axis.
        batch_axis: which axis that is.
        start: `zero`, or `first`: a (N, B, I) buffer whose rows are all the first input.
    """

    name: str
    shape: tuple[int, ...]
    batch_axis: int = 1
    start: Literal["zero", "first"] = "zero"

    def __post_init__(self) -> None:
        """Refuse what is no tensor, or has no axis for copies."""
        if not self.shape or min(self.shape) < 0:
            raise ConfigError(f"state {self.name!r}: shape", got=self.shape, expected="sizes >= 0, at least one")
        if not 0 <= self.batch_axis < len(self.shape):
            raise ConfigError(
                f"state {self.name!r}: batch_axis", got=self.batch_axis, expected=f"an axis of {self.shape}"
            )

    def initial(self, first: Float[np.ndarray, "B I"]) -> np.ndarray:
        """The tensor before the first sample, float32."""
        shape = list(self.shape)
        shape[self.batch_axis] = len(first)
        out = np.zeros(shape, np.float32)
        if self.start == "first":
            out[:] = first
        return out


@dataclass(frozen=True)
class ModelCard:
    """The content of model.json.

    Attributes:
        name: e.g. `panda-realeasy-rt`.
        method: e.g. `realeasy-rt`.
        robot: name of the kind of robot.
        joints: names of its joints, in order; of its bodies, where channels are of bodies.
        run: label of the simulated run that it was trained to correct, e.g. `mujoco/stock`.
        rate_hz: samples per second that it was trained at.
        causal: whether it needs no sample of the future.
        inputs: I channels.
        outputs: K channels.
        states: what a stream carries; empty if not causal.
        modular: whether it is a network for a joint or a body, and each one of a robot goes through it (SAT, IV).
        warmup_steps: samples after a start from which on the state is informative.
        margin: share of a channel's training range by which an input may leave it.
        coverage: share of samples that the intervals are to cover.
        coverage_note: what limits that, e.g. too few val motions; empty if nothing does.
        metrics: split -> signal -> joint -> {`simulated`, `corrected`} RMSE [unit].
        files: name -> SHA-256 of the files beside the card.
        description: for people.
        provenance: versions, seed, data hash, configuration.
    """

    name: str
    method: str
    robot: str
    joints: tuple[str, ...]
    run: str
    rate_hz: float
    causal: bool
    inputs: tuple[Input, ...]
    outputs: tuple[Output, ...]
    states: tuple[State, ...] = ()
    modular: bool = False
    warmup_steps: int = 0
    margin: float = 0.1
    coverage: float = 0.9
    coverage_note: str = ""
    metrics: Mapping[str, Any] = field(default_factory=dict)
    files: Mapping[str, str] = field(default_factory=dict)
    description: str = ""
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse a card that describes no network."""
        if not (math.isfinite(self.rate_hz) and self.rate_hz > 0):
            raise ConfigError(f"model {self.name!r}: rate_hz", got=self.rate_hz, expected="a positive number")
        if not (0 <= self.margin <= LARGEST_MARGIN and 0 < self.coverage < 1 and self.warmup_steps >= 0):
            raise ConfigError(
                f"model {self.name!r}: margin, coverage, warmup_steps",
                got=(self.margin, self.coverage, self.warmup_steps),
                expected=f"a share up to {LARGEST_MARGIN:g}, one between 0 and 1, and a number of steps",
            )
        if not self.inputs or not self.outputs:
            raise ConfigError(f"model {self.name!r} has no inputs or no outputs")
        for output in self.outputs:
            if not 0 <= output.base < len(self.inputs):
                raise ConfigError(f"model {self.name!r}: {output.name} corrects no input", got=output.base)
        for channel, other in zip(self.inputs, counterparts(self.inputs), strict=True):
            if channel.relative and other < 0:
                raise ConfigError(f"model {self.name!r}: {channel.name} is relative to an input that is not there")

    @property
    def base(self) -> Int[np.ndarray, "K"]:
        """For each output the input that it corrects, (K,)."""
        return np.array([output.base for output in self.outputs])

    @property
    def copies(self) -> int:
        """How often one robot goes through the network: its joints or bodies, where that is modular."""
        return len(self.joints) if self.modular else 1

    def of_joints(self, joints: Sequence[str]) -> ModelCard:
        """The card for a robot with these joints: the channels of a modular one for each of them, one after the other.

        Of a network for bodies, the names are those of bodies (`blocks_of`). Any other card, or one that has joints
        already, is returned as it is.
        """
        if not self.modular or self.joints != (ANY_JOINT,):
            return self
        outputs = tuple(
            replace(output, joint=joint, base=number * len(self.inputs) + output.base)
            for number, joint in enumerate(joints)
            for output in self.outputs
        )
        inputs = tuple(replace(channel, joint=joint) for joint in joints for channel in self.inputs)
        return replace(self, joints=tuple(joints), inputs=inputs, outputs=outputs)

    def blocks_of(self, series: TimeSeries) -> tuple[str, ...]:
        """The joints of a simulated run, or its bodies if this is a network for bodies.

        A network for the joints that turn leaves those that slide alone, and the other way around.

        Raises:
            MissingSignal: the run has no bodies.
        """
        first = self.outputs[0]
        if not first.of_body:
            if not self.modular or first.signal not in series:
                return series.joints
            fitting = zip(series.joints, series.units[first.signal], strict=True)
            # Where none fits, all are named, and the error says which unit the network has.
            return tuple(joint for joint, unit in fitting if unit == first.unit) or series.joints
        if not series.bodies:
            raise MissingSignal(
                f"the network {self.name!r} corrects bodies, and the run has none",
                available=series.signals,
                hint="Name them in robot.yaml, `simulation: {bodies: [...]}`, and replay again.",
            )
        return series.bodies

    def to_json(self) -> dict[str, Any]:
        """The content of model.json, with a hash over all the rest."""
        return sealed(CARD_SCHEMA, asdict(self))

    @staticmethod
    def from_json(data: Any, where: str = CARD_NAME) -> ModelCard:
        """Read back what `to_json` wrote.

        Raises:
            FormatError: not a model, or of another version.
            DataError: a model, but changed after it was written, or broken.
        """
        content = unsealed(data, where, schema=CARD_SCHEMA, what="network")
        try:
            content["inputs"] = [_with_open_ends(item) for item in content.get("inputs", ())]
            return build(ModelCard, content, where)
        except ConfigError as error:
            raise DataError(f"{where} is broken", got=error.summary) from error
        except TypeError as error:
            raise DataError(f"{where} is broken", got=f"inputs: {error}") from error

    def save(self, folder: Path) -> ModelCard:
        """Write model.json, last of all files: with the hashes of the others; returns the card as written."""
        files = {
            name: file_hash(folder / name) for name in (ONNX_NAME, WEIGHTS_NAME, STEP_NAME) if (folder / name).is_file()
        }
        write_json(folder / CARD_NAME, replace(self, files=files).to_json())
        return ModelCard.load(folder)

    @staticmethod
    def load(folder: Path) -> ModelCard:
        """Read model.json; the other files are not looked at.

        Raises:
            DataError: missing, truncated or changed.
            FormatError: of another version.
        """
        where = folder / CARD_NAME
        if not where.exists():
            found = what_is(folder)
            policies = "`trueup deploy run` and `trueup policy eval` take policies. " if found == "a policy" else ""
            raise DataError(
                f"{folder} holds no network",
                got=found,
                expected=CARD_NAME,
                hint=f"{policies}Give a folder that `trueup augment train` or `trueup compensate train` has written, "
                "or zoo:panda-realeasy-rt.",
            )
        return ModelCard.from_json(read_json(where), str(where))

    def verified(self, folder: Path, name: str) -> bytes:
        """The bytes of a file beside the card, after a look at its hash.

        Raises:
            DataError: it is missing, truncated or changed, or the card does not know it.
        """
        return verified(folder, name, self.files, CARD_NAME)


def counterparts(inputs: Sequence[Channel]) -> Int[np.ndarray, "I"]:
    """For each commanded or measured input the simulated one of its signal and joint, (I,); -1 where there is none."""
    simulated = {(c.signal, c.joint): number for number, c in enumerate(inputs) if c.series == "simulated"}
    return np.array([simulated.get((c.signal, c.joint), -1) if c.series != "simulated" else -1 for c in inputs])


def _with_open_ends(item: Mapping[str, Any]) -> dict[str, Any]:
    """The input with infinity for null, which stands for it in JSON."""
    ends = {"low": -math.inf, "high": math.inf}
    return {**item, **{key: end for key, end in ends.items() if item.get(key) is None}}
