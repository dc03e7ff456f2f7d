"""How long steps take: a histogram of fixed size."""

from __future__ import annotations

from array import array
from typing import Any

# Bins per doubling of the time, as a power of two: 32 of them, each at most 3 % wide.
_FINE = 5
_BINS_PER_DOUBLING = 1 << _FINE
# All that is longer than 2^40 ns, 18 minutes, goes into the last bin.
_DOUBLINGS = 40 - _FINE
_US = 1e-3


class Latency:
    """Counts durations in bins that grow with the duration, as HdrHistogram does.

    Memory does not grow, and no duration is too short or too long; a percentile is the upper edge of its bin, so up to
    3 % too large and never too small. The maximum is exact.
    """

    def __init__(self) -> None:
        # An array, not a list: a list would hold an object of its own for every count above 256.
        self._counts = array("Q", bytes(8 * _BINS_PER_DOUBLING * (_DOUBLINGS + 1)))
        self._max_ns = 0

    def record(self, duration_ns: int) -> None:
        """Count one duration [ns]."""
        shift = duration_ns.bit_length() - (_FINE + 1)
        bin = (shift << _FINE) + (duration_ns >> shift) if shift > 0 else duration_ns
        try:
            self._counts[bin] += 1
        except IndexError:
            self._counts[-1] += 1
        if duration_ns > self._max_ns:
            self._max_ns = duration_ns

    def __len__(self) -> int:
        """How many durations were counted."""
        return sum(self._counts)

    @property
    def max_us(self) -> float:
        """The longest of them [us]; 0 if there is none."""
        return self._max_ns * _US

    def percentile_us(self, percent: float) -> float:
        """The time within which this share of the steps was done [us]; 0 if there is none.

        Args:
            percent: above 0, up to 100.
        """
        needed, seen = percent / 100 * len(self), 0
        for bin, count in enumerate(self._counts):
            seen += count
            if count and seen >= needed:
                return min(_upper_ns(bin) * _US, self.max_us)
        return self.max_us

    def add(self, other: Latency) -> None:
        """Count another's durations as well."""
        for bin, count in enumerate(other._counts):
            self._counts[bin] += count
        self._max_ns = max(self._max_ns, other._max_ns)

    def clear(self) -> None:
        """Begin to count anew."""
        self._counts[:] = array("Q", bytes(8 * len(self._counts)))
        self._max_ns = 0

    def to_json(self) -> dict[str, Any]:
        """Count, percentiles, maximum and the bins that are not empty, as `[from_us, to_us, count]`."""
        return {
            "count": len(self),
            **{name: self.percentile_us(share) for name, share in PERCENTILES.items()},
            "max_us": self.max_us,
            "bins": [
                [_upper_ns(bin - 1) * _US if bin else 0.0, _upper_ns(bin) * _US, count]
                for bin, count in enumerate(self._counts)
                if count
            ],
        }


# What is shown of a histogram: key of the JSON -> percent.
PERCENTILES = {"p50_us": 50.0, "p99_us": 99.0, "p999_us": 99.9}


def _upper_ns(bin: int) -> int:
    """The end of a bin, which belongs to the next one."""
    shift = (bin >> _FINE) - 1
    return bin + 1 if shift < 1 else (bin - (shift << _FINE) + 1) << shift
