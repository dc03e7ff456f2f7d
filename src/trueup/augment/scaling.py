"""Numbers of a network's size: what is subtracted from and divided out of inputs and outputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64, Int

from trueup.augment.components import POSITION
from trueup.augment.pairs import Pairs
from trueup.core.model_card import Channel, counterparts

# An input that never changes in training must not be blown up when it does.
_STILL = 1e-6
# MuJoCo's stops give way by a few milliradians under the weight of an arm [rad or m].
_STOP_WIDTHS = (0.002, 0.01)


@dataclass(frozen=True, eq=False)
class Summary:
    """What one pass over the train split finds.

    Attributes:
        mean: of the inputs, commands relative to their counterparts, (I,).
        deviation: their standard deviation, (I,).
        low: smallest inputs as they are, (I,).
        high: largest inputs, (I,).
        read_low: smallest inputs, commands relative to their counterparts, (I,).
        read_high: largest of these, (I,).
        simulator_rms: error of the simulator, RMS, (K,).
        measured_mean: of the measured outputs, (K,).
        measured_deviation: their standard deviation, (K,).
    """

    mean: Float64[np.ndarray, "I"]
    deviation: Float64[np.ndarray, "I"]
    low: Float64[np.ndarray, "I"]
    high: Float64[np.ndarray, "I"]
    read_low: Float64[np.ndarray, "I"]
    read_high: Float64[np.ndarray, "I"]
    simulator_rms: Float64[np.ndarray, "K"]
    measured_mean: Float64[np.ndarray, "K"]
    measured_deviation: Float64[np.ndarray, "K"]


def summarize(pairs: Pairs, base: Int[np.ndarray, "K"]) -> Summary:
    """Moments of a split, motion by motion.

    Args:
        pairs: the train split.
        base: for each output the input that it corrects, (K,).
    """
    count, rms = 0, np.zeros(base.size)
    # A servo's error is small beside the range of its joint: read as a number of its own it would drown.
    relative = counterparts(pairs.inputs)
    low, high = np.full((2, len(pairs.inputs)), np.inf), np.full((2, len(pairs.inputs)), -np.inf)
    moments = [_Moments(len(pairs.inputs)), _Moments(base.size)]
    for _, x, y in pairs:
        rms += ((y.astype(float) - x[:, base]) ** 2).sum(axis=0)
        count += len(x)
        read = x - np.where(relative >= 0, x[:, relative], 0)
        low = np.minimum(low, [x.min(axis=0), read.min(axis=0)])
        high = np.maximum(high, [x.max(axis=0), read.max(axis=0)])
        for moment, values in zip(moments, (read, y), strict=True):
            moment.add(values)
    return Summary(
        mean=moments[0].mean,
        deviation=moments[0].deviation,
        low=low[0],
        high=high[0],
        read_low=low[1],
        read_high=high[1],
        simulator_rms=np.sqrt(rms / count),
        measured_mean=moments[1].mean,
        measured_deviation=moments[1].deviation,
    )


class _Moments:
    """Mean and standard deviation, by Chan's update of blocks."""

    def __init__(self, width: int) -> None:
        self.count = 0
        self.mean = np.zeros(width)
        self._squares = np.zeros(width)

    def add(self, values: np.ndarray) -> None:
        values = values.astype(float)
        mean, total = values.mean(axis=0), self.count + len(values)
        shift = mean - self.mean
        self._squares += ((values - mean) ** 2).sum(axis=0) + shift**2 * self.count * len(values) / total
        self.mean = self.mean + shift * len(values) / total
        self.count = total

    @property
    def deviation(self) -> np.ndarray:
        return np.sqrt(self._squares / self.count)


@dataclass(frozen=True, eq=False)
class Scaling:
    """z = (x - center) / scale for inputs; a network's output o stands for `out_center + out_scale * o`.

    With the target `residual` that is what is added to the simulator, with `plain` the signal itself.

    Attributes:
        center: (I,).
        scale: (I,), positive; infinite for inputs that are not read.
        out_center: (K,).
        out_scale: (K,), positive.
        loss_scale: errors are counted in units of this, (K,), positive.
    """

    center: Float64[np.ndarray, "I"]
    scale: Float64[np.ndarray, "I"]
    out_center: Float64[np.ndarray, "K"]
    out_scale: Float64[np.ndarray, "K"]
    loss_scale: Float64[np.ndarray, "K"]


def scaling_of(
    summary: Summary,
    inputs: Sequence[Channel],
    base: Int[np.ndarray, "K"],
    *,
    normalization: Literal["limits", "statistics"],
    target: Literal["residual", "plain"],
    loss_scale: Literal["simulator", "normalized"],
    limits: Mapping[tuple[str, str], tuple[float, float]],
    blind: Sequence[str] = (),
) -> Scaling:
    """The scaling of a configuration.

    Args:
        summary: of the train split.
        inputs: I channels.
        base: for each output the input that it corrects, (K,).
        normalization: `limits` maps limits to [0, 1] (Realeasy, IV-B); `statistics` takes mean and deviation.
        target: what the network's output stands for.
        loss_scale: units of the loss.
        limits: (signal, joint) -> lowest and highest value; the range of the train split where there are none.
        blind: simulated signals that are not read.
    """
    if normalization == "limits":
        ends = [limits.get((channel.signal, channel.joint)) for channel in inputs]
        low = np.array([end[0] if end else found for end, found in zip(ends, summary.low, strict=True)])
        high = np.array([end[1] if end else found for end, found in zip(ends, summary.high, strict=True)])
        relative = counterparts(inputs) >= 0
        center = np.where(relative, summary.mean, low)
        scale = _positive(np.where(relative, summary.deviation, high - low))
        out_center, out_scale = center[base], scale[base]
        simulator_rms = _positive(summary.simulator_rms)
    else:
        outputs = [inputs[place] for place in base]
        center, scale = _of_quantities(inputs, summary.mean, summary.deviation)
        out_center, out_scale = _of_quantities(outputs, summary.measured_mean, summary.measured_deviation)
        _, simulator_rms = _of_quantities(outputs, np.zeros(base.size), summary.simulator_rms)
    if target == "residual":
        out_center = np.zeros(base.size)
        out_scale = out_scale if normalization == "limits" else simulator_rms
    units = scale[base] if loss_scale == "normalized" else simulator_rms
    unread = np.array([channel.series == "simulated" and channel.signal in blind for channel in inputs])
    center, scale = np.where(unread, 0.0, center), np.where(unread, np.inf, scale)
    return Scaling(center, scale, out_center, out_scale, units)


def _of_quantities(
    channels: Sequence[Channel], mean: Float64[np.ndarray, "N"], deviation: Float64[np.ndarray, "N"]
) -> tuple[Float64[np.ndarray, "N"], Float64[np.ndarray, "N"]]:
    """Center and scale of channels; those of bodies have one scale for each quantity (SAT, V-A).

    The axes of the world mean nothing to a body, so none of them must be stretched. An origin may be chosen, which
    positions have and other quantities have not: a shifted rotation is none.
    """
    center, scale = mean.copy(), deviation.copy()
    for quantity in {channel.quantity for channel in channels if channel.of_body}:
        own = [number for number, channel in enumerate(channels) if channel.quantity == quantity]
        if quantity != POSITION:
            center[own] = 0.0
        scale[own] = np.sqrt((deviation[own] ** 2 + (mean[own] - center[own]) ** 2).mean())
    return center, _positive(scale)


@dataclass(frozen=True, eq=False)
class Stops:
    """Inputs near their limits: N numbers clip((x[index] - edge) slope, 0, 2), which are 1 at a limit.

    Attributes:
        index: input, (N,).
        edge: from where on a limit is felt, (N,).
        slope: one over how far that is from the limit, positive for an upper one, (N,).
    """

    index: Int[np.ndarray, "N"]
    edge: Float64[np.ndarray, "N"]
    slope: Float64[np.ndarray, "N"]

    @staticmethod
    def none(count: int = 0) -> Stops:
        """No limits are felt; or so many, which are to be filled in."""
        return Stops(np.zeros(count, int), np.zeros(count), np.ones(count))

    @staticmethod
    def of(inputs: Sequence[Channel], limits: Mapping[tuple[str, str], tuple[float, float]]) -> Stops:
        """Those of the simulated positions whose limits are known, near and nearer."""
        index, edge, slope = [], [], []
        for number, channel in enumerate(inputs):
            known = limits.get(("position", channel.joint)) if channel.signal == "position" else None
            if known is None or channel.series != "simulated":
                continue
            for width in _STOP_WIDTHS:
                index += [number, number]
                edge += [known[0] + width, known[1] - width]
                slope += [-1 / width, 1 / width]
        return Stops(np.array(index, int), np.array(edge, float), np.array(slope, float))


def _positive(values: Float64[np.ndarray, "N"]) -> Float64[np.ndarray, "N"]:
    return np.where(values > _STILL, values, 1.0)
