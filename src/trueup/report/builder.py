"""From a run folder to one HTML file."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import resources
from pathlib import Path, PurePath
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from trueup.core.atomic import write_text
from trueup.report.embed import packed
from trueup.report.folder import GAP_NAME, RunFolder, evaluation_of, robustness_of
from trueup.report.sections import SECTIONS, Section
from trueup.report.sections.judged import judged_sections
from trueup.report.sections.provenance import provenance_of
from trueup.report.sections.robustness import section_of

REPORT_NAME = "report.html"
_MOTIONS = "residual = measured − simulated · RMSE: root mean square error · intervals: 95 %, bootstrap over motions"
_GOALS = "intervals: 95 %, bootstrap over goals, and over seeds where there are several"


def build_report(folder: Path | str) -> str:
    """The report of a finished run as one self-contained HTML page.

    The folder holds gap.json and, if they were made, ladder.json, traces.json with traces.npz, quality.json and
    analysis.json, and what an identification leaves: fit.json, explain.json, graybox.json; or robustness.json, alone or
    beside them. Or it holds evaluation.json and episodes.npz, of policies. A section without its file is left out.
    Equal inputs give equal bytes.

    Raises:
        DataError: there is no gap.json, robustness.json or evaluation.json, or a file is broken.
        FormatError: a file holds something else, or was written by another version.
    """
    folder = Path(folder)
    alone = None if (folder / GAP_NAME).is_file() else robustness_of(folder)
    if alone is not None:
        title = f"Robustness of {alone.network} on {alone.robot}"
        return render_page(title, _facts(alone.provenance), [section_of(alone), provenance_of(alone)])
    judged = None if (folder / GAP_NAME).is_file() else evaluation_of(folder)
    if judged is not None:
        sections = [*judged_sections(*judged), provenance_of(judged[0])]
        title = f"Reaching by torques, {judged[0].settings.get('robot', 'robot')}"
        return render_page(title, _facts(judged[0].provenance), sections, footer=_GOALS)
    run = RunFolder.load(folder)
    sections = [section for make in SECTIONS if (section := make(run)) is not None]
    footer = f"{_MOTIONS}; of fitted parameters: from how the residual bends at the fit" if run.fit else _MOTIONS
    return render_page(_title(run), _subtitle(run), sections, identified=run.identified, footer=footer)


def render_page(
    title: str,
    subtitle: Sequence[str],
    sections: Sequence[Section],
    *,
    identified: bool = False,
    footer: str = _MOTIONS,
) -> str:
    """Sections as one self-contained page.

    Args:
        title: of the page.
        subtitle: facts below it.
        sections: at least one.
        identified: whether one of them is about an identification, which has a style sheet of its own.
        footer: how the numbers are to be read.
    """
    return (
        _environment()
        .get_template("page.html.j2")
        .render(
            title=title,
            subtitle=subtitle,
            sections=sections,
            style=_asset("style.css") + (_asset("identification.css") if identified else ""),
            footer=footer,
            library=_plotly(),
            scripts=[_asset("report.js"), _asset("traces.js")],
        )
    )


def write_report(folder: Path | str, out: Path | str | None = None) -> Path:
    """Build the report of a run and write it atomically.

    Args:
        folder: the run.
        out: where to write; `report.html` in the folder if it is not given.

    Returns:
        The path that was written.

    Raises:
        TrueupError: as `build_report`, or the file cannot be written.
    """
    path = Path(folder) / REPORT_NAME if out is None else Path(out)
    write_text(path, build_report(folder))
    return path


def packed_json(value: Any) -> str:
    """JSON as the page's script unpacks it; in base64, no name in it can end the element that it stands in."""
    return packed(json.dumps(value, sort_keys=True, allow_nan=False, separators=(",", ":")).encode())


def breakable(text: str) -> Markup:
    """A name that may go on in the next line: after `/` and `+`, as labels of runs, and before `[`, as parameters."""
    parts = [str(escape(part)) for part in re.split(r"(?<=[/+])|(?=\[)", text)]
    return Markup("<wbr>".join(parts))  # noqa: S704  # escaped above


def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("trueup.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["packed_json"] = packed_json
    environment.filters["breakable"] = breakable
    return environment


def _title(run: RunFolder) -> str:
    robot = _name_of(run, "robot")
    return f"Sim-to-real gap of {robot}" if robot else "Sim-to-real gap"


def _subtitle(run: RunFolder) -> list[str]:
    dataset = _name_of(run, "dataset")
    return [*([f"Data: {dataset}"] if dataset else []), *_facts(run.gap.provenance)]


def _facts(stored: Mapping[str, Any]) -> list[str]:
    """When a result was made, and by which version."""
    created = stored.get("created")
    parts = [f"compared on {created[:10]}" if isinstance(created, str) else ""]
    parts.append(f"trueup {stored['trueup']}" if isinstance(stored.get("trueup"), str) else "")
    return [part for part in parts if part]


def _name_of(run: RunFolder, key: str) -> str:
    """A name from the settings, or the last part of a path in the configuration; empty if neither has one."""
    named = run.gap.settings.get(key)
    if isinstance(named, str) and named:
        return named
    config = run.gap.provenance.get("config")
    path = config.get(key) if isinstance(config, Mapping) else None
    return PurePath(path.replace("\\", "/")).stem if isinstance(path, str) else ""


def _asset(name: str) -> Markup:
    """A file of the package that stands in the page as it is."""
    text = resources.files("trueup.report").joinpath("assets", name).read_text(encoding="utf-8")
    return Markup(text)  # noqa: S704  # our own file


@cache
def _plotly() -> str:
    """The library that draws: a third of its 4.8 MB."""
    # Imported here: it is needed for building pages only.
    from plotly.offline import get_plotlyjs

    return packed(get_plotlyjs().encode())
