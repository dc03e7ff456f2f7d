"""The files of a run that a report is made of."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from trueup.core.analysis import Analysis
from trueup.core.quality import Quality
from trueup.core.results import Estimate, GapResult, Ladder, Metrics
from trueup.core.traces import TraceSet
from trueup.errors import DataError, TrueupError
from trueup.report.labels import COMMAND, ordered_runs
from trueup.report.palette import Style, run_styles

Loaded = TypeVar("Loaded")
# run, episode, signal, metric, joint
EPISODE_LEVELS = 5


@dataclass(frozen=True)
class RunFolder:
    """Everything that is known about one run; what was not computed is None.

    Attributes:
        gap: gap.json.
        ladder: ladder.json.
        traces: traces.json and traces.npz.
        quality: quality.json.
        analysis: analysis.json.
    """

    gap: GapResult
    ladder: Ladder | None = None
    traces: TraceSet | None = None
    quality: Quality | None = None
    analysis: Analysis | None = None

    @property
    def runs(self) -> list[str]:
        """All run labels of the gap, in the order of the report."""
        return ordered_runs(self.gap.runs)

    @property
    def simulators(self) -> list[str]:
        """Run labels without the command."""
        return [label for label in self.runs if label != COMMAND]

    @property
    def styles(self) -> dict[str, Style]:
        """How each run is drawn, in all figures alike."""
        labels = set(self.gap.runs)
        if self.analysis:
            labels |= {*self.analysis.bins, *self.analysis.lags, *self.analysis.horizon}
        if self.traces:
            labels |= {run for item in self.traces.episodes.values() for trace in item.traces for run in trace.runs}
        return run_styles(labels)

    @staticmethod
    def load(folder: Path) -> RunFolder:
        """Read a run folder.

        Raises:
            DataError: there is no gap.json, or a file is broken.
            FormatError: a file holds something else, or another version.
        """
        if not (folder / "gap.json").is_file():
            raise DataError(
                f"{folder} holds no gap.json",
                available=sorted(item.name for item in folder.iterdir()) if folder.is_dir() else None,
                hint="Run `trueup gap` with this folder as --out, or point the report at the folder of a finished run.",
            )
        gap = _loaded(folder / "gap.json", GapResult.load)
        _check_gap(gap, folder / "gap.json")
        ladder = _optional(folder / "ladder.json", Ladder.load)
        if ladder is not None:
            _check_ladder(ladder, folder / "ladder.json")
        return RunFolder(
            gap=gap,
            ladder=ladder,
            traces=_optional(folder / "traces.json", lambda path: TraceSet.load(path.parent)),
            quality=_optional(folder / "quality.json", Quality.load),
            analysis=_optional(folder / "analysis.json", Analysis.load),
        )


def _optional(path: Path, load: Callable[[Path], Loaded]) -> Loaded | None:
    return _loaded(path, load) if path.is_file() else None


def _loaded(path: Path, load: Callable[[Path], Loaded]) -> Loaded:
    """Read a file; what its reader did not expect is a broken file, and every message names the file."""
    try:
        return load(path)
    except TrueupError as error:
        if str(path.parent) in error.what:
            raise
        raise type(error)(f"{path}: {error.what}", got=error.details or None, hint=error.hint) from error
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise DataError(f"{path} is broken", got=f"{type(error).__name__}: {error}") from error


def _check_gap(gap: GapResult, path: Path) -> None:
    """Refuse what has the right keys and the wrong values, before it fails in the middle of a page."""
    if not gap.runs or not any(gap.runs[label] for label in gap.runs):
        raise DataError(f"{path} holds no runs")
    for splits in gap.runs.values():
        for metrics in splits.values():
            _check_estimates(metrics, path)
    for values in gap.groups.values():
        for runs in values.values():
            for metrics in runs.values():
                _check_estimates(metrics, path)
    for item in gap.paired:
        _check_estimate(item.difference, path)
        _check_types(path, *((name, str) for name in (item.run, item.baseline, item.split, item.signal, item.metric)))
        if item.verdict not in ("better", "worse", "undecided"):
            raise DataError(f"{path} holds a broken paired difference", got=item)
    _check_types(path, *((name, str) for name in (*gap.joints, *gap.scored_joints)))
    _check_types(path, (gap.settings, Mapping), (gap.provenance, Mapping), (gap.splits, Mapping))
    _check_types(path, *((split, str) for split in gap.splits.values()))
    _check_types(path, *((value, float | int) for value in _leaves(gap.episodes, EPISODE_LEVELS, path)))


def _check_ladder(ladder: Ladder, path: Path) -> None:
    for rung in ladder.rungs:
        _check_types(path, (rung.name, str), (rung.seconds, int | float))
        for metrics in rung.splits.values():
            _check_estimates(metrics, path)


def _check_estimates(metrics: Metrics, path: Path) -> None:
    for results in metrics.values():
        for result in results.values():
            _check_types(path, (result.episodes, int))
            for estimate in (result.total, *result.per_joint.values()):
                _check_estimate(estimate, path)


def _check_estimate(estimate: Estimate, path: Path) -> None:
    number = int | float | None
    _check_types(path, (estimate.unit, str), (estimate.low, number), (estimate.high, number))


def _check_types(path: Path, *pairs: tuple[object, Any]) -> None:
    for value, kind in pairs:
        if not isinstance(value, kind):
            raise DataError(f"{path} is broken", got=repr(value), expected=getattr(kind, "__name__", kind))


def _leaves(tree: Any, depth: int, path: Path) -> Iterator[object]:
    """The values of mappings that are nested `depth` levels deep."""
    if depth == 0:
        yield tree
        return
    _check_types(path, (tree, Mapping))
    for value in tree.values():
        yield from _leaves(value, depth - 1, path)
