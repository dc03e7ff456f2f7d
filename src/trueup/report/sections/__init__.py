"""The sections of the report, in reading order."""

from collections.abc import Callable

from trueup.report.folder import RunFolder
from trueup.report.sections.attribution import attribution_section
from trueup.report.sections.augmentation import augmentation_section
from trueup.report.sections.base import Section as Section
from trueup.report.sections.causes import causes_section
from trueup.report.sections.engines import engines_section
from trueup.report.sections.episodes import episodes_section
from trueup.report.sections.flags import flags_section
from trueup.report.sections.graybox import graybox_section
from trueup.report.sections.groups import groups_section
from trueup.report.sections.joints import joints_section
from trueup.report.sections.ladder import ladder_section
from trueup.report.sections.left import left_section
from trueup.report.sections.open_questions import open_section
from trueup.report.sections.parameters import parameters_section
from trueup.report.sections.provenance import provenance_section
from trueup.report.sections.robustness import robustness_section
from trueup.report.sections.setup import setup_section
from trueup.report.sections.steps import steps_section
from trueup.report.sections.traces import traces_section
from trueup.report.sections.usage import usage_section
from trueup.report.sections.verdict import verdict_section

# Each takes the run and returns its section, or None when there is nothing to show.
SECTIONS: tuple[Callable[[RunFolder], Section | None], ...] = (
    verdict_section,
    setup_section,
    ladder_section,
    attribution_section,
    parameters_section,
    augmentation_section,
    robustness_section,
    traces_section,
    open_section,
    usage_section,
    left_section,
    graybox_section,
    joints_section,
    groups_section,
    engines_section,
    causes_section,
    flags_section,
    episodes_section,
    steps_section,
    provenance_section,
)

__all__ = ["SECTIONS", "Section"]
