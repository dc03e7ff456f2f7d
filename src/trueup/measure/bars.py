"""Bars that a result must not exceed, for use in continuous integration."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from trueup.core.results import GapResult
from trueup.errors import ConfigError, MissingSignal
from trueup.measure.comparison import COMMAND_RUN
from trueup.measure.gap import ALL
from trueup.measure.metrics import METRICS

_FORM = "SIGNAL.METRIC=VALUE or RUN:SPLIT:SIGNAL.METRIC=VALUE, e.g. position.rmse=0.02 or :test:position.rmse=0.02"


@dataclass(frozen=True)
class Bar:
    """An upper limit for one metric.

    Attributes:
        signal: signal name.
        metric: metric name; of a signed metric the absolute value counts.
        limit: the largest value that passes, in the metric's unit.
        run: run label; empty for every run but `command`.
        split: split; empty for all episodes.
    """

    signal: str
    metric: str
    limit: float
    run: str = ""
    split: str = ""

    def __str__(self) -> str:
        """The form that `parse_bar` reads."""
        where = f"{self.run}:{self.split}:" if self.run or self.split else ""
        return f"{where}{self.signal}.{self.metric}={self.limit:g}"


@dataclass(frozen=True)
class BarFailure:
    """A bar that one run did not meet.

    Attributes:
        bar: the bar.
        run: the run.
        split: the split.
        value: what was measured; NaN when the metric is not defined, which never passes.
        unit: unit of value and limit.
    """

    bar: Bar
    run: str
    split: str
    value: float
    unit: str

    def __str__(self) -> str:
        """One line for people."""
        where = f"{self.bar.signal}.{self.bar.metric} of {self.run} ({self.split})"
        value = "not defined" if math.isnan(self.value) else f"{self.value:.6g} {self.unit}"
        return f"{where}: {value}, allowed {self.bar.limit:g} {self.unit}"


def parse_bar(text: str) -> Bar:
    """Read `position.rmse=0.02` or `mujoco/stock:test:position.rmse=0.02`; run and split may be empty.

    Raises:
        ConfigError: another form, an unknown metric, one of which higher is better, or no finite number.
    """
    left, equals, number = text.rpartition("=")
    where = left.rsplit(":", 2)
    signal, dot, name = where[-1].rpartition(".")
    if not (equals and dot and signal and name) or len(where) == 2:
        raise ConfigError("not a valid bar", got=repr(text), expected=_FORM)
    if name not in METRICS:
        raise ConfigError(f"a bar on an unknown metric {name!r}", got=repr(text), available=METRICS)
    if METRICS[name].lower_is_better is False:
        lower = [item for item, entry in METRICS.items() if entry.lower_is_better is not False]
        raise ConfigError(f"higher {name} is better, so that it cannot have an upper limit", available=lower)
    try:
        limit = float(number)
    except ValueError:
        limit = math.nan
    if not math.isfinite(limit):
        raise ConfigError("the limit of a bar must be a finite number", got=repr(text), expected=_FORM)
    run, split = (where[0].strip(), where[1].strip()) if len(where) == 3 else ("", "")
    return Bar(signal=signal.strip(), metric=name, limit=limit, run=run, split=split)


def refuse_unknown(bars: Iterable[Bar], *, runs: Iterable[str], splits: Iterable[str] | None = None) -> None:
    """Refuse bars on what will not be measured, before anything is.

    Raises:
        MissingSignal: a bar names another run, or, where they are known, another split.
    """
    for bar in bars:
        for what, key, known in (("run", bar.run, runs), ("split", bar.split, splits)):
            if key and known is not None and key not in {*known, COMMAND_RUN if what == "run" else ALL}:
                raise MissingSignal(f"the bar {bar} names a {what} that is not there: {key!r}", available=known)


def check_bars(result: GapResult, bars: Iterable[Bar]) -> list[BarFailure]:
    """The bars that the result does not meet, run by run; empty when all are met.

    Raises:
        MissingSignal: a bar names a run, split, signal or metric that the result does not have.
    """
    failures = []
    for bar in bars:
        labels = [bar.run] if bar.run else [label for label in result.runs if label != COMMAND_RUN]
        if not labels:
            raise MissingSignal(f"the bar {bar} needs a simulated run", available=result.runs)
        for label in labels:
            split = bar.split or ALL
            found: object = result.runs
            for what, key in (("run", label), ("split", split), ("signal", bar.signal), ("metric", bar.metric)):
                if key not in found:  # type: ignore[operator]
                    raise MissingSignal(f"the bar {bar} names a {what} that was not measured: {key!r}", available=found)  # type: ignore[arg-type]
                found = found[key]  # type: ignore[index]
            total = result.runs[label][split][bar.signal][bar.metric].total
            if not abs(total.value) <= bar.limit:
                failures.append(BarFailure(bar, label, split, total.value, total.unit))
    return failures
