"""The ladder: from the raw command to the best correction, every rung on every split."""

from __future__ import annotations

from collections.abc import Sequence

from trueup.core.results import Estimate, Ladder, Rung
from trueup.report.chooser import Chooser, Menu, Table, TableRow, Variant, make_chooser
from trueup.report.figures import bars_figure
from trueup.report.fit_words import listed
from trueup.report.folder import RunFolder
from trueup.report.labels import MAIN_METRIC, METRICS, SIGNALS, SPLITS, axis_title, metric_title, ordered, split_title
from trueup.report.palette import split_styles
from trueup.report.sections.base import Section
from trueup.report.sections.cells import change_cell, seconds_cell

_ROLES = {"train": "fitted on train", "val": "chosen on validation", "test": "judged on test"}


def ladder_section(run: RunFolder) -> Section | None:
    """Only where rungs were climbed."""
    if run.ladder is None or not run.ladder.rungs:
        return None
    chooser = ladder_chooser(run.ladder)
    return None if chooser is None else Section("ladder", "Ladder: which correction helps", {"chooser": chooser})


def ladder_chooser(ladder: Ladder) -> Chooser | None:
    """Table and bars per signal and metric."""
    found = {
        (signal, metric)
        for rung in ladder.rungs
        for metrics in rung.splits.values()
        for signal, results in metrics.items()
        for metric in results
    }
    signals = ordered({signal for signal, _ in found}, SIGNALS)
    metrics = ordered({metric for _, metric in found}, METRICS)
    menus = [
        Menu("Signal", [(signal, signal) for signal in signals]),
        Menu("Metric", [(metric, metric_title(metric)) for metric in metrics]),
    ]

    def make(signal: str, metric: str) -> Variant | None:
        return _variant(ladder, signal, metric) if (signal, metric) in found else None

    return make_chooser("ladder-chooser", menus, make, preferred=("position", MAIN_METRIC))


def rung_estimate(rung: Rung, split: str, signal: str, metric: str) -> Estimate | None:
    """The total of one rung; None where it was not computed."""
    result = rung.splits.get(split, {}).get(signal, {}).get(metric)
    return result.total if result else None


def _variant(ladder: Ladder, signal: str, metric: str) -> Variant:
    present = {split for rung in ladder.rungs for split in rung.splits}
    # "all" mixes what was fitted with what was held back, so it is shown only where there is nothing else.
    splits = ordered(present - {"all"} or present, SPLITS)
    rows: list[TableRow] = []
    bars: dict[str, dict[str, Estimate]] = {split_title(split): {} for split in splits}
    unit = ""
    for rung in ladder.rungs:
        estimates = {split: rung_estimate(rung, split, signal, metric) for split in splits}
        for split, estimate in estimates.items():
            if estimate is not None:
                bars[split_title(split)][_name(rung)] = estimate
                unit = estimate.unit
        first = None if rung is ladder.rungs[0] else ladder.rungs[0]
        cells = [
            change_cell(estimate, rung_estimate(first, split, signal, metric) if first else None)
            for split, estimate in estimates.items()
        ]
        note = "chosen on validation" if rung.chosen else ""
        rows.append(TableRow(_name(rung), [*cells, seconds_cell(rung.seconds)], note=note, strong=rung.chosen))
    columns = ["Rung", *(split_title(split).capitalize() for split in splits), "Time to compute"]
    caption = (
        f"{metric_title(metric)} of {signal}, 95 % interval below it; the percentage is the change against the first "
        "rung."
    )
    caption += _roles(splits, chosen=any(rung.chosen for rung in ladder.rungs))
    styles = {split_title(split): style for split, style in split_styles(splits).items()}
    names = [_name(rung) for rung in ladder.rungs]
    figure = bars_figure(names, bars, styles, title=axis_title(signal, metric, unit))
    return Variant(tables={"ladder": Table(columns, rows, caption)}, figures={"ladder": figure})


def _roles(splits: Sequence[str], *, chosen: bool) -> str:
    """What the motions of each split are for, with a space before it; empty where there are no such splits."""
    roles = [_ROLES[split] for split in splits if split in _ROLES]
    words = f" Rungs are {listed(roles)}." if roles else ""
    if chosen and "val" in splits and "test" not in splits:
        words += " There are no test motions, so what validation says of the chosen one is a little too kind."
    return words


def _name(rung: Rung) -> str:
    return f"★ {rung.name}" if rung.chosen else rung.name
