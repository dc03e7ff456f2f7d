"""Where a network with attention looks in the past; a part of `augment.json`."""

from __future__ import annotations

import math
from dataclasses import dataclass

from trueup.core.results import Estimate
from trueup.errors import ConfigError


@dataclass(frozen=True)
class AttentionProfile:
    """Attention over the lag, mean over the heads and over the samples and joints of a motion (SAT, Fig. 11).

    Attributes:
        rate_hz: samples per second of the network.
        mean: share of each sample, the present one first, then back in time; mean over motions.
        low: 5 % of the motions have a smaller share.
        high: 5 % of the motions have a larger share.
        motions: number of motions.
        half_s: lag within which half of the attention lies [s], with its interval over motions.
        oldest: share on the oldest quarter of the samples.
    """

    rate_hz: float
    mean: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    motions: int
    half_s: Estimate
    oldest: Estimate

    def __post_init__(self) -> None:
        """Refuse what is no profile."""
        if not len(self.mean) == len(self.low) == len(self.high) >= 2:
            raise ConfigError("the columns of an attention profile have unequal lengths, or are too short")
        if not self.rate_hz > 0.0 or self.motions < 1:
            raise ConfigError("an attention profile is of no motion, or of no rate")
        shares = (*self.mean, *self.low, *self.high)
        if not all(0.0 <= share <= 1.0 for share in shares) or not math.isclose(sum(self.mean), 1.0, abs_tol=1e-3):
            raise ConfigError("the shares of an attention profile do not add up to one", got=sum(self.mean))

    @property
    def span_s(self) -> float:
        """How far it looks back [s]."""
        return (len(self.mean) - 1) / self.rate_hz
