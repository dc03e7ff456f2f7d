"""What policies do with goals: all of them in numbers, and each place in figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from trueup.core.policy_evaluation import Curves, PolicyEvaluation
from trueup.core.results import Estimate, PairedDifference
from trueup.report.chooser import Cell, Chooser, Menu, Table, TableRow, Variant, make_chooser
from trueup.report.episode_curves import chosen_episodes
from trueup.report.numbers import fixed, has_interval, interval, percent, plural, significant, with_unit
from trueup.report.palette import Style, cycled_styles
from trueup.report.policy_figures import (
    VIEWS,
    demands_figure,
    distance_figure,
    finals_figure,
    map_figure,
    reward_figure,
)
from trueup.report.sections.base import Section

# Column of the table -> metric.
COLUMNS = {
    "Success": "success",
    "Distance, median": "distance_median",
    "Distance, mean": "distance",
    "Overshoot": "overshoot",
    "Smoothness": "smoothness",
    "Torque at limit": "torque_at_limit",
    "Too fast": "velocity_violation",
    "Reward": "reward",
}
_SHARES = ("success", "torque_at_limit", "velocity_violation")
_DEMANDS = {"torque at limit": "torque_at_limit", "too fast": "velocity_violation"}


def judged_sections(evaluation: PolicyEvaluation, curves: Curves) -> list[Section]:
    """The result, and a section per place."""
    return [_result(evaluation), *(_place(evaluation, curves, place) for place in evaluation.places)]


def value_words(value: float, name: str, *, sign: bool = False) -> str:
    """A metric as people read it: shares in percent, lengths in centimeters."""
    if name in _SHARES:
        return percent(value, sign=sign)
    if name.startswith(("distance", "overshoot")):
        return with_unit(significant(100.0 * value, sign=sign), "cm")
    return significant(value, sign=sign)


def metric_cell(own: Estimate, name: str, *, sign: bool = False, tone: str = "") -> Cell:
    """A metric with its interval below it."""
    note = ""
    if has_interval(own) and own.low is not None and own.high is not None:
        if name in _SHARES:
            note = f"{fixed(100.0 * own.low, 1, sign=sign)} to {fixed(100.0 * own.high, 1, sign=sign)}"
        else:
            factor = 100.0 if name.startswith(("distance", "overshoot")) else 1.0
            scaled = replace(own, value=factor * own.value, low=factor * own.low, high=factor * own.high)
            note = interval(scaled, sign=sign)
    return Cell(value_words(own.value, name, sign=sign), note=note, tone=tone)


def _result(evaluation: PolicyEvaluation) -> Section:
    goals = len(next(iter(evaluation.policies[0].places.values())).goals)
    first = evaluation.groups[0]
    who = first.label if len(evaluation.policies) == 1 else f"{len(evaluation.policies)}\u00a0policies"
    sentences = [
        f"{whose}{place}: {value_words(own['distance_median'].value, 'distance')} from the goal at the end (median), "
        f"{percent(own['success'].value, sign=False)} within {significant(100 * evaluation.near_m, 1)}\u00a0cm."
        for group in evaluation.groups
        for whose in [f"{group.label}, " if len(evaluation.groups) > 1 else ""]
        for place, own in group.places.items()
    ]
    lost = [
        f"{item.label}, {place}: {plural(own.lost, 'arm')} lost, where the engine or the policy said what is no number."
        for item in evaluation.policies
        for place, own in item.places.items()
        if own.lost
    ]
    context = {
        "lead": f"{who} reached for the same {plural(goals, 'goal')} in {plural(len(evaluation.places), 'place')}.",
        "sentences": sentences,
        "notes": lost,
        "numbers": _numbers_chooser(evaluation),
        "differences": _differences_chooser(evaluation),
        "baseline": first.label,
    }
    return Section("judged", "Result", context)


def _seeds(labels: tuple[str, ...]) -> str:
    return f"seeds: {len(labels)}" if len(labels) > 1 else ""


def _numbers_chooser(evaluation: PolicyEvaluation) -> Chooser | None:
    several = any(len(group.policies) > 1 for group in evaluation.groups)
    caption = (
        f"Mean over goals{' and seeds' if several else ''}, with 95 % intervals over "
        f"{'both' if several else 'goals'}. Smoothness: change of the torques from step to step, in shares of the "
        "largest. Torque at limit, too fast: share of the time. Reward: of a control step."
    )

    def make(place: str) -> Variant:
        rows = [
            TableRow(
                group.label,
                [metric_cell(group.places[place][name], name) for name in COLUMNS.values()],
                note=_seeds(group.policies),
            )
            for group in evaluation.groups
        ]
        return Variant({"numbers": Table(["Policy", *COLUMNS], rows, caption)})

    if len(evaluation.groups) > 1:
        menu = Menu("Place", [(place, place) for place in evaluation.places])
        return make_chooser("judged-numbers", [menu], make, preferred=("",))
    (group,) = evaluation.groups
    rows = [
        TableRow(place, [metric_cell(own[name], name) for name in COLUMNS.values()], note=_seeds(group.policies))
        for place, own in group.places.items()
    ]
    variant = Variant({"numbers": Table(["Place", *COLUMNS], rows, caption)})
    return make_chooser("judged-numbers", [], lambda: variant, preferred=())


def _differences_chooser(evaluation: PolicyEvaluation) -> Chooser | None:
    if not evaluation.differences:
        return None
    columns = {title: name for title, name in COLUMNS.items() if name != "distance_median"}
    found: dict[tuple[str, str, str], PairedDifference] = {
        (item.run, item.split, item.metric): item for item in evaluation.differences
    }

    def make(place: str) -> Variant:
        rows = []
        for group in evaluation.groups[1:]:
            own = [found[group.label, place, name] for name in columns.values()]
            cells = [metric_cell(item.difference, item.metric, sign=True, tone=item.verdict) for item in own]
            rows.append(TableRow(group.label, cells, note=_seeds(group.policies)))
        caption = (
            f"Minus {evaluation.groups[0].label}, goal by goal, with 95 % intervals. Colored where the interval leaves "
            "zero out."
        )
        return Variant({"differences": Table(["Policy", *columns], rows, caption)})

    menu = Menu("Place", [(place, place) for place in evaluation.places])
    return make_chooser("judged-differences", [menu], make, preferred=("",))


def _place(evaluation: PolicyEvaluation, curves: Curves, place: str) -> Section:
    styles = cycled_styles(["", *(group.label for group in evaluation.groups)])
    context = {
        "together": _together(evaluation, curves, place, styles),
        "single": _single(evaluation, curves, place),
        # Of as many goals, every policy has as many.
        "panels": len(chosen_episodes(_metric(evaluation, evaluation.policies[0].label, place, "reward"))),
    }
    return Section(f"place-{place}", place, context, kind="place")


def _together(evaluation: PolicyEvaluation, curves: Curves, place: str, styles: Mapping[str, Style]) -> Chooser | None:
    distances = {
        group.label: np.concatenate([curves[label, place]["distance_m"] for label in group.policies])
        for group in evaluation.groups
    }
    finals = {
        group.label: np.concatenate([_metric(evaluation, label, place, "distance") for label in group.policies])
        for group in evaluation.groups
    }
    variant = Variant(
        figures={
            "distance": distance_figure(distances, styles, control_s=evaluation.control_s, near_m=evaluation.near_m),
            "finals": finals_figure(finals, styles, near_m=evaluation.near_m),
        }
    )
    return make_chooser(f"together-{place}", [], lambda: variant, preferred=())


def _single(evaluation: PolicyEvaluation, curves: Curves, place: str) -> Chooser | None:
    style = cycled_styles(["", "episode"])["episode"]
    # One scale for all that can be chosen, so that they compare.
    rewards = {item.label: curves[item.label, place]["reward"] for item in evaluation.policies}
    seen = np.concatenate([own[np.isfinite(own)] for own in rewards.values()])
    low, high = (float(seen.min()), float(seen.max())) if seen.size else (-1.0, 0.0)
    span = (low - 0.04 * (high - low or 1.0), high + 0.04 * (high - low or 1.0))
    most = max(float(_metric(evaluation, item.label, place, "distance").max()) for item in evaluation.policies)

    def make(label: str) -> Variant:
        reward = rewards[label]
        final = _metric(evaluation, label, place, "distance")
        figures = {
            f"episode-{number}": reward_figure(
                f"{title}: {value_words(float(final[row]), 'distance')} at the end",
                reward,
                row,
                style,
                control_s=evaluation.control_s,
                span=span,
            )
            for number, (title, row) in enumerate(chosen_episodes(_metric(evaluation, label, place, "reward")))
        }
        goals = np.array(evaluation.policy(label).places[place].goals)
        reached = _metric(evaluation, label, place, "success")
        for view in VIEWS:
            figures[view] = map_figure(view, goals, final, reached, start_m=evaluation.start_m, most_m=most)
        demands = {words: _metric(evaluation, label, place, name) for words, name in _DEMANDS.items()}
        return Variant(figures={**figures, "demands": demands_figure(demands, style)})

    menu = Menu("Policy", [(item.label, item.label) for item in evaluation.policies])
    return make_chooser(f"single-{place}", [menu], make, preferred=("",))


def _metric(evaluation: PolicyEvaluation, label: str, place: str, name: str) -> Float[np.ndarray, "E"]:
    return np.array(evaluation.policy(label).places[place].values[name])
