"""What training minimizes: the error of the correction, and how far position and velocity are from one another."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float64
from torch import Tensor

from trueup.augment.components import components
from trueup.augment.config import LossConfig
from trueup.augment.corrector import Corrector
from trueup.augment.windows import Batch
from trueup.core.model_card import Channel
from trueup.errors import ConfigError


class Loss:
    """The loss of a batch.

    Args:
        config: what is minimized.
        outputs: K channels.
        rate_hz: samples per second.
        quantiles: that the network says, (Q,); none if it says one number.

    Raises:
        ConfigError: weights leave nothing to learn, or are of signals that are not corrected.
    """

    def __init__(
        self, config: LossConfig, outputs: Sequence[Channel], rate_hz: float, quantiles: Sequence[float] = ()
    ) -> None:
        self._kind = config.kind
        self._consistency = config.consistency
        self._rate_hz = rate_hz
        # With weights that add up to 1, the sum over outputs is their weighted mean.
        self._weight = torch.tensor(_weights(config, outputs), dtype=torch.float32)
        places = {(channel.signal, channel.joint): number for number, channel in enumerate(outputs)}
        self._pairs = torch.tensor(
            [
                (place, places["velocity", joint])
                for (signal, joint), place in places.items()
                if signal == "position" and ("velocity", joint) in places
            ]
        ).reshape(-1, 2)
        if self._consistency and not len(self._pairs):
            raise ConfigError(
                "loss: consistency holds between position and velocity",
                got=sorted({channel.signal for channel in outputs}),
                expected="data: signals with both of them",
            )
        self._quantiles = torch.tensor(quantiles, dtype=torch.float32)

    def of(self, corrector: Corrector, batch: Batch) -> Tensor:
        """The mean over all valid samples; in training as the network learns, else as it runs."""
        x, y, lengths = on_device(corrector, batch)
        out, wanted = corrector.outputs(x, y, lengths)
        unit = corrector.out_scale / corrector.loss_scale
        each = self._each(out, wanted, unit) @ self._weight.to(x.device)
        valid = None if lengths is None else torch.arange(len(x), device=x.device)[:, None] < lengths
        total = _mean(each, valid)
        if self._consistency and len(x) > 1:
            both = None if valid is None else valid[1:]
            said = out[..., len(self._quantiles) // 2, :] if out.ndim == 4 else out  # the median
            total = total + self._consistency * _mean(self._apart(said * corrector.out_scale, corrector), both)
        return total

    def _each(self, out: Tensor, wanted: Tensor, unit: Tensor) -> Tensor:
        """The loss of each output, (T, B, K)."""
        if out.ndim == 4:  # in training: quantiles, (T, B, Q, K)
            short = (wanted[:, :, None] - out) * unit
            share = self._quantiles.to(out.device)[:, None]
            return torch.maximum(share * short, (share - 1) * short).sum(dim=2)
        error = (out - wanted) * unit
        return error**2 if self._kind == "squares" else error.abs()

    def _apart(self, added: Tensor, corrector: Corrector) -> Tensor:
        """How far the slope of an added position is from the added velocity (SAT, eq. 3), mean over joints, (T-1, B).

        Between two samples, so that it is exactly zero where position is the trapezoidal integral of velocity; in units
        of the loss of the velocity.
        """
        position, velocity = added[..., self._pairs[:, 0]], added[..., self._pairs[:, 1]]
        slope = (position[1:] - position[:-1]) * self._rate_hz
        off = slope - 0.5 * (velocity[1:] + velocity[:-1])
        return (off / corrector.loss_scale[self._pairs[:, 1]]).abs().mean(dim=-1)


def on_device(corrector: Corrector, batch: Batch) -> tuple[Tensor, Tensor, Tensor | None]:
    """A batch on the corrector's device; no lengths where nothing is padded."""
    place = corrector.center.device
    full = bool(np.all(batch.lengths == len(batch.x)))
    x, y = (torch.from_numpy(values).to(place) for values in (batch.x, batch.y))
    return x, y, None if full else torch.from_numpy(batch.lengths).to(place)


def _mean(values: Tensor, valid: Tensor | None) -> Tensor:
    return values.mean() if valid is None else (values * valid).sum() / valid.sum().clamp(min=1)


def _weights(config: LossConfig, outputs: Sequence[Channel]) -> Float64[np.ndarray, "K"]:
    signals = list(dict.fromkeys(channel.quantity for channel in outputs))
    unknown = sorted(set(config.weights) - set(signals))
    if unknown:
        raise ConfigError(f"loss: weights of {', '.join(unknown)}, which is not corrected", available=signals)
    # The components of a vector or rotation share the weight of one number.
    weights = np.array(
        [config.weights.get(channel.quantity, 1.0) / len(components(channel.quantity)) for channel in outputs]
    )
    if weights.sum() <= 0:
        raise ConfigError("loss: weights leave nothing to learn", got=dict(config.weights))
    shares: np.ndarray = weights / weights.sum()
    return shares
