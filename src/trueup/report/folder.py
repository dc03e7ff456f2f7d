"""The files of a run that a report is made of."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from trueup.core.analysis import Analysis
from trueup.core.atomic import is_inside
from trueup.core.attribution import Attribution
from trueup.core.augment_result import AUGMENT_NAME, AugmentResult
from trueup.core.check_result import CHECK_NAME, CheckResult
from trueup.core.close_result import CLOSE_NAME, CloseResult
from trueup.core.design_result import DESIGN_NAME, DesignResult
from trueup.core.engines import EngineComparison
from trueup.core.fit_result import FIT_CONFIG, STOCK_ROBOT, FitResult
from trueup.core.graybox_result import GrayboxResult
from trueup.core.model_card import CARD_NAME, ModelCard
from trueup.core.policy_evaluation import (
    EPISODES_NAME,
    EVALUATION_NAME,
    Curves,
    PolicyEvaluation,
    load_curves,
)
from trueup.core.quality import Quality
from trueup.core.results import GapResult, Ladder
from trueup.core.robustness_result import ROBUSTNESS_NAME, RobustnessResult
from trueup.core.traces import TraceSet
from trueup.errors import DataError, TrueupError
from trueup.report.body_units import evaluation_for_people, gap_for_people, ladder_for_people
from trueup.report.checks import check_augment, check_fit, check_gap, check_robustness
from trueup.report.labels import COMMAND, ordered_runs
from trueup.report.palette import Style, run_styles

Loaded = TypeVar("Loaded")
GAP_NAME = "gap.json"
# What an identification writes beside fit.json for other programs.
FITTED_FILES = ("robot.fitted.yaml", "model.fitted.xml", "isaac.actuators.yaml", "fit.samples.npz")
# Where a close imports logs to, and where the page proposes to put designed motions.
OWN_DATASET, PLANS = "dataset", "plans"
# Limits that a model states for the planning of motions.
_STATED_LIMIT = re.compile(rb'<numeric[^<>]*\sname="(velocity|acceleration)_limit"')
# Friction laws beyond MuJoCo's own stand in a model file as user data of a joint that begin with this mark.
_FRICTION_LAW = re.compile(rb'<joint[^<>]*\suser="20261[\s"]')


@dataclass(frozen=True)
class RunFolder:
    """Everything that is known about one run; what was not computed is None.

    Attributes:
        gap: gap.json; errors of bodies, here and in the other files, as people speak of them.
        ladder: ladder.json.
        traces: traces.json and traces.npz.
        quality: quality.json.
        analysis: analysis.json.
        engines: engines.json.
        augment: augment.json.
        robustness: robustness.json.
        fit: fit.json.
        attribution: explain.json.
        graybox: graybox.json.
        checked: check.json.
        close: close.json.
        networks: label of a corrected run -> the card of its network, as close.json says.
        fitted_files: those of `FITTED_FILES` that are there.
        given_files: those of `STOCK_ROBOT` and `FIT_CONFIG` that are there.
        friction_laws: whether the fitted model carries friction laws that MuJoCo does not know.
        stated_limits: those of `velocity` and `acceleration` that the fitted model states.
        own_dataset: whether the imported logs lie in the folder.
        design: plans/design.json.
    """

    gap: GapResult
    ladder: Ladder | None = None
    traces: TraceSet | None = None
    quality: Quality | None = None
    analysis: Analysis | None = None
    engines: EngineComparison | None = None
    augment: AugmentResult | None = None
    robustness: RobustnessResult | None = None
    fit: FitResult | None = None
    attribution: Attribution | None = None
    graybox: GrayboxResult | None = None
    checked: CheckResult | None = None
    close: CloseResult | None = None
    networks: Mapping[str, ModelCard] = field(default_factory=dict)
    fitted_files: tuple[str, ...] = ()
    given_files: tuple[str, ...] = ()
    friction_laws: bool = False
    stated_limits: tuple[str, ...] = ()
    own_dataset: bool = False
    design: DesignResult | None = None

    @property
    def identified(self) -> bool:
        """Whether there is anything of an identification to show."""
        return any(item is not None for item in (self.fit, self.attribution, self.graybox))

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
        if not (folder / GAP_NAME).is_file():
            raise DataError(
                f"{folder} holds no {GAP_NAME}",
                available=sorted(item.name for item in folder.iterdir()) if folder.is_dir() else None,
                hint="Run `trueup gap` with this folder as --out, or point the report at the folder of a finished run.",
            )
        gap = _loaded(folder / GAP_NAME, GapResult.load)
        check_gap(gap, folder / GAP_NAME)
        fit = _optional(folder / "fit.json", FitResult.load)
        if fit is not None:
            check_fit(fit, folder / "fit.json")
        augment = _optional(folder / AUGMENT_NAME, AugmentResult.load)
        if augment is not None:
            check_augment(augment, gap, folder / AUGMENT_NAME)
        ladder = _optional(folder / "ladder.json", Ladder.load)
        model = folder / "model.fitted.xml"
        text = model.read_bytes() if model.is_file() else b""
        close = _optional(folder / CLOSE_NAME, CloseResult.load)
        return RunFolder(
            gap=gap_for_people(gap),
            ladder=None if ladder is None else ladder_for_people(ladder),
            fit=fit,
            attribution=_optional(folder / "explain.json", Attribution.load),
            graybox=_optional(folder / "graybox.json", GrayboxResult.load),
            checked=_optional(folder / CHECK_NAME, CheckResult.load),
            close=close,
            networks=_cards(folder, close),
            fitted_files=tuple(name for name in FITTED_FILES if (folder / name).is_file()),
            given_files=tuple(name for name in (STOCK_ROBOT, FIT_CONFIG) if (folder / name).is_file()),
            friction_laws=_FRICTION_LAW.search(text) is not None,
            stated_limits=tuple(sorted({name.decode() for name in _STATED_LIMIT.findall(text)})),
            own_dataset=(folder / OWN_DATASET).is_dir(),
            design=_optional(folder / PLANS / DESIGN_NAME, DesignResult.load),
            traces=_optional(folder / "traces.json", lambda path: TraceSet.load(path.parent)),
            quality=_optional(folder / "quality.json", Quality.load),
            analysis=_optional(folder / "analysis.json", Analysis.load),
            engines=_optional(folder / "engines.json", EngineComparison.load),
            augment=None if augment is None else evaluation_for_people(augment),
            robustness=robustness_of(folder),
        )


def _cards(folder: Path, close: CloseResult | None) -> dict[str, ModelCard]:
    """Of the networks that are still there."""
    found = {}
    for label, name in (close.networks if close else {}).items():
        if is_inside(folder, folder / name) and (folder / name / CARD_NAME).is_file():
            found[label] = _loaded(folder / name / CARD_NAME, lambda path: ModelCard.load(path.parent))
    return found


def robustness_of(folder: Path) -> RobustnessResult | None:
    """robustness.json, which may stand alone; None if there is none.

    Raises:
        DataError: it is broken.
        FormatError: it is something else, or of another version.
    """
    path = folder / ROBUSTNESS_NAME
    result = _optional(path, RobustnessResult.load)
    if result is not None:
        check_robustness(result, path)
    return result


def evaluation_of(folder: Path) -> tuple[PolicyEvaluation, Curves] | None:
    """evaluation.json and episodes.npz, which stand alone; None if there are none.

    Raises:
        DataError: one is broken.
        FormatError: evaluation.json is something else, or of another version.
    """
    found = _optional(folder / EVALUATION_NAME, PolicyEvaluation.load)
    return None if found is None else (found, load_curves(folder / EPISODES_NAME, found))


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
