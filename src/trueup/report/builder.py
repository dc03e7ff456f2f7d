"""From a run folder to one HTML file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from importlib import resources
from pathlib import Path, PurePath
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from trueup.core.atomic import write_text
from trueup.report.folder import RunFolder
from trueup.report.sections import SECTIONS

REPORT_NAME = "report.html"


def build_report(folder: Path | str) -> str:
    """The report of a finished run as one self-contained HTML page.

    The folder holds gap.json and, if they were made, ladder.json, traces.json with traces.npz, quality.json and
    analysis.json, and what an identification leaves: fit.json, explain.json, graybox.json. A section without its file
    is left out. Equal inputs give equal bytes.

    Raises:
        DataError: there is no gap.json, or a file is broken.
        FormatError: a file holds something else, or was written by another version.
    """
    run = RunFolder.load(Path(folder))
    sections = [section for make in SECTIONS if (section := make(run)) is not None]
    page = _environment().get_template("page.html.j2")
    return page.render(
        title=_title(run),
        subtitle=_subtitle(run),
        sections=sections,
        style=_asset("style.css") + (_asset("identification.css") if run.identified else ""),
        fitted=run.fit is not None,
        scripts=[_plotly(), _asset("report.js"), _asset("traces.js")],
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


def script_json(value: Any) -> Markup:
    """JSON that may stand in a script element: no name in it can end the element or open a comment."""
    text = json.dumps(value, sort_keys=True, allow_nan=False, separators=(",", ":"), ensure_ascii=False)
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)  # noqa: S704  # escaped above


def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("trueup.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["script_json"] = script_json
    return environment


def _title(run: RunFolder) -> str:
    robot = _name_of(run, "robot")
    return f"Sim-to-real gap of {robot}" if robot else "Sim-to-real gap"


def _subtitle(run: RunFolder) -> list[str]:
    stored = run.gap.provenance
    dataset, created = _name_of(run, "dataset"), stored.get("created")
    parts = [f"Data: {dataset}" if dataset else ""]
    parts.append(f"compared on {created[:10]}" if isinstance(created, str) else "")
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
def _plotly() -> Markup:
    # Imported here: it is needed for building pages only.
    from plotly.offline import get_plotlyjs

    return Markup(get_plotlyjs())  # noqa: S704  # the library's own script
