"""Where the result comes from."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from trueup.core.policy_evaluation import PolicyEvaluation
from trueup.core.robustness_result import RobustnessResult
from trueup.report.folder import RunFolder
from trueup.report.sections.base import Section


def provenance_section(run: RunFolder) -> Section:
    """Versions, git, seed, data hash and configuration, as stored with the result."""
    stored = dict(run.gap.provenance)
    config = stored.pop("config", {})
    return _section(
        stored,
        ("Settings of the comparison", as_json(run.gap.settings)),
        ("Configuration", as_json(config)),
        ("Provenance of the ladder", as_json(run.ladder.provenance if run.ladder else {})),
        ("Provenance of the fit", as_json(run.fit.provenance if run.fit else {})),
        ("Provenance of the attribution", as_json(run.attribution.provenance if run.attribution else {})),
        ("Provenance of the robustness", as_json(run.robustness.provenance if run.robustness else {})),
    )


def provenance_of(result: RobustnessResult | PolicyEvaluation) -> Section:
    """The same where nothing but the robustness of a correction was looked at, or what policies do."""
    stored = dict(result.provenance)
    config = stored.pop("config", {})
    return _section(stored, ("Settings", as_json(result.settings)), ("Configuration", as_json(config)))


def _section(stored: Mapping[str, Any], *parts: tuple[str, str]) -> Section:
    context = {"facts": facts(stored), "parts": [part for part in parts if part[1]]}
    return Section("provenance", "Provenance", context)


def facts(stored: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Name and value pairs, nested names joined by a point; in the order of the names."""
    result: list[tuple[str, str]] = []
    for name, value in sorted(stored.items()):
        if isinstance(value, Mapping):
            result += facts(value, f"{prefix}{name}.")
        else:
            shown = "not recorded" if value is None else value if isinstance(value, str) else json.dumps(value)
            result.append((prefix + name, shown))
    return result


def as_json(tree: Any) -> str:
    """Indented JSON for reading; empty for an empty tree."""
    return json.dumps(tree, indent=2, sort_keys=True, ensure_ascii=False) if tree else ""
