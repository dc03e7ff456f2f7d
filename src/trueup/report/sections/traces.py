"""Curves of every motion, joint and signal, drawn by the page's script."""

from __future__ import annotations

import math
from typing import Any

from trueup.core.traces import COMMAND, EpisodeTraces
from trueup.report.embed import BUDGET_BYTES, Embedded, fit_to_budget, pack
from trueup.report.folder import RunFolder
from trueup.report.labels import SIGNALS, SPLITS, ordered, run_title, split_title
from trueup.report.numbers import plural, quantity_with_degrees
from trueup.report.sections.base import Section
from trueup.report.sections.episodes import joint_errors, scored_mean
from trueup.report.verdict import extreme_joints, find_headline, stock_label

# What the section of learned corrections takes, and every network in all sections.
_AUGMENT_BYTES = 250_000
_NETWORK_BYTES = 250_000
# More simulated curves than these lie on each other.
_MOST_RUNS = 3


def traces_section(run: RunFolder) -> Section | None:
    """Only where curves were kept."""
    if run.traces is None or not any(item.traces for item in run.traces.episodes.values()):
        return None
    worst_first = by_error(run, [item for item in run.traces.episodes.values() if item.traces])
    taken = 0 if run.augment is None else _AUGMENT_BYTES + _NETWORK_BYTES * len(run.augment.models)
    embedded = fit_to_budget(worst_first, budget_bytes=BUDGET_BYTES - taken)
    listed = sorted(embedded.episodes, key=lambda item: (_split_rank(item.split), item.id))
    packed = pack(listed)
    data = {
        "styles": {label: {**style.to_json(), "title": run_title(label)} for label, style in run.styles.items()},
        "episodes": [{**index, **_about(run, item)} for item, index in zip(listed, packed.index, strict=True)],
        "signals": ordered({trace.signal for item in listed for trace in item.traces}, SIGNALS),
        "joints": ordered({trace.joint for item in listed for trace in item.traces}, run.gap.joints),
        "start": first_choice(run, worst_first),
        "command": COMMAND,
        "runs": list(run.styles),
        "hidden": hidden_first(run),
    }
    context = {"data": data, "curves": packed.text, "notes": size_notes(embedded)}
    return Section("traces", "Traces", context)


def by_error(run: RunFolder, episodes: list[EpisodeTraces]) -> list[EpisodeTraces]:
    """The motions of the judged split first, the largest error first within it; unknown errors last."""
    headline = find_headline(run.gap, run.ladder)

    def key(item: EpisodeTraces) -> tuple[bool, float, str]:
        if headline is None:
            return False, 0.0, item.id
        error = scored_mean(joint_errors(run.gap, headline.run, item.id, headline.signal), run.gap.scored_joints)
        judged = headline.split in ("all", item.split)
        return not judged, -error if math.isfinite(error) else math.inf, item.id

    return sorted(episodes, key=key)


def first_choice(run: RunFolder, worst_first: list[EpisodeTraces]) -> dict[str, str]:
    """What is drawn first: the worst motion of the judged split at the worst joint."""
    headline = find_headline(run.gap, run.ladder)
    extremes = extreme_joints(headline, run.gap) if headline else None
    return {
        "episode": worst_first[0].id,
        "signal": headline.signal if headline else "",
        "joint": extremes[0].joint if extremes else "",
    }


def hidden_first(run: RunFolder) -> list[str]:
    """Runs that are drawn only when they are asked for: of many, all but the model as it came and the judged one."""
    simulated = [label for label in run.runs if label != COMMAND]
    headline = find_headline(run.gap, run.ladder)
    if len(simulated) <= _MOST_RUNS or headline is None:
        return []
    return [label for label in simulated if label not in (headline.run, stock_label(headline.run, simulated))]


def size_notes(embedded: Embedded) -> list[str]:
    """What was left out to keep the page small."""
    notes = []
    if embedded.thinned:
        notes.append(
            f"Long curves are thinned to at most {embedded.max_points} points; "
            "the extremes of the curves and of the residuals are kept. All errors are computed from all samples."
        )
    if embedded.left_out:
        notes.append(f"{plural(embedded.left_out, 'motion')} with smaller errors did not fit into this page.")
    return notes


def _about(run: RunFolder, item: EpisodeTraces) -> dict[str, Any]:
    """Printed RMSE per signal, joint and run, and the flags of one motion."""
    errors: dict[str, dict[str, dict[str, str]]] = {}
    for trace in item.traces:
        for label in run.runs:
            value = joint_errors(run.gap, label, item.id, trace.signal).get(trace.joint)
            if value is not None and math.isfinite(value):
                joint = errors.setdefault(trace.signal, {}).setdefault(trace.joint, {})
                joint[label] = quantity_with_degrees(value, trace.unit)
    checked = run.quality.episodes.get(item.id) if run.quality else None
    flags = [flag.to_json() for flag in checked.flags] if checked else []
    return {"splitTitle": split_title(item.split), "errors": errors, "flags": flags}


def _split_rank(split: str) -> tuple[int, str]:
    return (SPLITS.index(split) if split in SPLITS else len(SPLITS), split)
