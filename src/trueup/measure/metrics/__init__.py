"""Metrics by name, from one file for each family of them."""

from collections.abc import Mapping
from importlib import import_module

from trueup.errors import MissingSignal
from trueup.measure.metrics.base import Metric

# In the order of gap.json and of the tables; a file offers `METRICS`.
_FILES = (
    "error",
    "similarity",
    "distribution",
    "shape",
    "lag",
    "body",
)
METRICS: Mapping[str, Metric] = {
    entry.name: entry for file in _FILES for entry in import_module(f"{__name__}.{file}").METRICS
}


def metric(name: str) -> Metric:
    """The metric of this name.

    Raises:
        MissingSignal: there is no such metric; the message lists those that there are.
    """
    try:
        return METRICS[name]
    except KeyError:
        raise MissingSignal(f"there is no metric {name!r}", available=METRICS) from None
