"""Order and wording of splits, signals, metrics and runs."""

from __future__ import annotations

import html
from collections.abc import Iterable

from trueup.core.graybox_result import HELD_OUT
from trueup.core.ordering import by_number
from trueup.core.results import Metrics
from trueup.measure import METRICS as KNOWN
from trueup.report.numbers import pretty_unit

COMMAND = "command"
SPLITS = ("train", "val", "test", "all")
SIGNALS = ("position", "velocity", "acceleration", "torque", "current", "voltage", "temperature")
# The number that the report is about.
MAIN_METRIC = "rmse"
# In the order of menus.
METRICS = dict.fromkeys(("rmse", "mae", "max", "mse", "nrmse", "mape", "phase_lag", "large_gap_ratio", *KNOWN))
SPLIT_TITLES = {"train": "train", "val": "validation", "test": "test", "all": "all motions", "": "not assigned"}
SPLIT_TITLES[HELD_OUT] = "all motions, each held out in turn"


def ordered(names: Iterable[str], known: Iterable[str]) -> list[str]:
    """Known names in their order, then the others by alphabet."""
    present, first = set(names), list(known)
    return [name for name in first if name in present] + sorted(present.difference(first))


def ordered_runs(labels: Iterable[str]) -> list[str]:
    """The command first, then stock simulators, then the others by alphabet: the order in which a gap is closed."""
    return sorted(labels, key=lambda label: (label != COMMAND, "stock" not in label.split("/")[-1], label))


def group_order(values: Iterable[str]) -> list[str]:
    """Numbers by size, words by alphabet after them."""
    return sorted(values, key=by_number)


def run_title(label: str) -> str:
    """What a run is called where it needs no further words."""
    return "command as motion" if label == COMMAND else label


def source_title(label: str) -> str:
    """What the measured motion lags behind."""
    return "behind the command" if label == COMMAND else f"behind {label}"


def split_title(split: str) -> str:
    """A split as people call it."""
    return SPLIT_TITLES.get(split, split)


def metric_title(metric: str) -> str:
    """A metric with its meaning where it is known."""
    known = KNOWN.get(metric)
    return known.title if known and known.title else metric.replace("_", " ")


def axis_title(signal: str, metric: str, unit: str) -> str:
    """`position RMSE [rad]`."""
    name = f"{signal} {metric_title(metric).split(' (')[0]}"
    return f"{name} [{pretty_unit(unit)}]" if pretty_unit(unit) else name


def plot_text(text: str) -> str:
    """A name as plotly must be given it, whose labels know a few HTML tags."""
    return html.escape(text, quote=False)


def main_split(splits: Iterable[str]) -> str:
    """The split that a verdict is about: what was held back, if anything was."""
    return ordered(splits, ("test", "val", "all", "train"))[0]


def main_signal(metrics: Metrics) -> str:
    """Position if it was compared, else the first signal that was."""
    return ordered(metrics, SIGNALS)[0]
