"""What a stream answers to a sample."""

from __future__ import annotations

from enum import Enum, IntFlag

import numpy as np
from jaxtyping import Float64, Int

from trueup.core.model_card import ModelCard
from trueup.deploy.confidence import Confidence
from trueup.deploy.span import Span, index_of
from trueup.errors import MissingSignal


class Status(Enum):
    """What the values of a step are."""

    WARMING = "warming"
    """The simulator's: the network has not seen enough samples yet."""
    OK = "ok"
    """The network's."""
    HELD = "held"
    """Those of an earlier step: the sample cannot be used, or none came."""
    FALLBACK = "fallback"
    """The simulator's: the network is not to be trusted with this input."""


class Why(IntFlag):
    """What is wrong with a sample, or with the time at which it came."""

    NONE = 0
    NAN = 1
    """An input, or its time or that of a poll, is not a finite number."""
    MISSED = 2
    """More time than a period has passed since the sample before."""
    STALLED = 4
    """Time or simulator do not go on."""
    OUT_OF_RANGE = 8
    """An input is outside of what training covered, margin included; `Step.channels` names it."""
    OFF_RATE = 16
    """Samples come at another rate than the network was trained at."""
    DIVERGED = 32
    """The network's output is not finite; its state was thrown away."""
    LIMITED = 64
    """Of a compensator: what the network adds is larger or faster than it may be, or leads out of the limits."""
    TARGET = 128
    """Of a compensator: the target itself is not finite, or out of the robot's limits."""
    PAYLOAD = 256
    """Of a compensator: training covered no such payload."""
    NO_PAYLOAD = 512
    """Of a compensator: nobody has said what the robot carries, and the network reads it."""


class Step:
    """The answer to the latest sample.

    A stream has one such object, and every sample overwrites it: copy what you keep. What it does not need for every
    sample (`interval`, `far_off`, `channels`) is computed when it is asked for, before the next sample.

    Args:
        card: of the network.
        values: the buffer that the stream writes its outputs to, (K,).
        inputs: the buffer that the stream reads its inputs from, (I,).
        span: where inputs may be.

    Attributes:
        status: what the values are.
        values: the output channels in the card's order, SI, (K,), not to be written to. NaN as long as no sample was
            usable, because any other number would pass for a state of the robot.
        age_s: how old the sample is that the values were made from [s]; 0 unless they are held.
        flags: `why` as a plain number.
    """

    __slots__ = ("_base", "_card", "_confidence", "_inputs", "_rows", "_span", "age_s", "flags", "status", "values")

    def __init__(
        self,
        card: ModelCard,
        values: Float64[np.ndarray, "K"],
        inputs: Float64[np.ndarray, "I"],
        span: Span,
    ) -> None:
        self.status = Status.HELD
        self.flags = 0
        self.age_s = float("inf")
        self.values = values.view()
        self.values.flags.writeable = False
        self._card, self._inputs, self._span = card, inputs, span
        self._base = index_of(card.base)
        self._confidence = Confidence(card)
        self._rows = {
            signal: index_of(_signal_rows(card, signal))
            for signal in dict.fromkeys(output.signal for output in card.outputs)
        }

    @property
    def why(self) -> Why:
        """What is wrong with the latest sample; `Why.NONE` if nothing is."""
        return Why(self.flags)

    def __getitem__(self, signal: str) -> Float64[np.ndarray, "J"]:
        """The values of one signal, joints in the robot's order, SI.

        Raises:
            MissingSignal: the network does not correct it.
        """
        try:
            return self.values[self._rows[signal]]
        except KeyError:
            raise MissingSignal(
                f"model {self._card.name!r} does not correct {signal!r}", available=self._rows
            ) from None

    def interval(self) -> Float64[np.ndarray, "K"]:
        """Half widths of the intervals around the values, SI; infinite where none is known.

        They hold for what the network says of a sample: so they are known only while the status is OK, and only where
        training had enough motions for them.
        """
        if self.status is not Status.OK:
            return np.full(self.values.size, np.inf)
        return self._confidence.half_width(self._correction())

    def far_probability(self) -> Float64[np.ndarray, "K"]:
        """Probability that the simulator is far off, by output; NaN where it is not known."""
        if self.status is not Status.OK:
            return np.full(self.values.size, np.nan)
        return self._confidence.far_off(self._correction())

    @property
    def far_off(self) -> bool:
        """Whether the simulator is more likely far off than not in any output; False where it is not known."""
        return self.status is Status.OK and bool(self._confidence.is_far_off(self._correction()).any())

    def channels(self) -> tuple[str, ...]:
        """Names of the input channels of the latest sample that are not finite, or out of range."""
        return tuple(self._card.inputs[number].name for number in self._span.outside(self._inputs))

    def _correction(self) -> Float64[np.ndarray, "K"]:
        correction: Float64[np.ndarray, "K"] = self.values - self._inputs[self._base]
        return correction


def _signal_rows(card: ModelCard, signal: str) -> Int[np.ndarray, "J"]:
    """Where the outputs of a signal are, joints in the robot's order."""
    place = {output.joint: number for number, output in enumerate(card.outputs) if output.signal == signal}
    return np.array([place[joint] for joint in card.joints if joint in place])
