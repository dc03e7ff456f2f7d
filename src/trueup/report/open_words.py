"""What the motions leave open, in words: what to record, and which parameters they do not tell apart."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from trueup.core.fit_result import Direction, FittedParameter
from trueup.core.parameters import split_name
from trueup.report.fit_words import as_sentence, kind_of, listed
from trueup.report.numbers import fixed, percent, significant

# Below this share of the prior's the data say nothing along a direction; see `Direction`.
_NOTHING = 0.05
_ALONE = 0.9
_SHOWN_SHARE = 0.04


def suggestions(parameters: Sequence[FittedParameter]) -> list[tuple[str, str]]:
    """What to record, and the quantities that it would show; joints that need the same share a sentence."""
    found: dict[str, tuple[list[str], list[str]]] = {}
    for item in parameters:
        _, colon, what = item.sentence.partition(": ")
        if kind_of(item) not in ("weakly", "no") or not colon:
            continue
        name, target = split_name(item.name)
        pattern = re.compile(rf"(?<!\w){re.escape(target)}(?!\w)") if target else None
        start = pattern.search(what) if pattern else None
        blank = f"{what[: start.start()]}\0{what[start.end() :]}" if start else what
        targets, quantities = found.setdefault(blank, ([], []))
        targets += [target] if target not in targets else []
        quantities += [name] if name not in quantities else []
    advice = []
    for blank, (targets, quantities) in found.items():
        many = blank.replace(" its ", " their ") if len(targets) > 1 else blank
        advice.append((as_sentence(many.replace("\0", listed(targets, limit=12))), listed(quantities)))
    return advice


def direction_rows(directions: Sequence[Direction]) -> list[tuple[str, str]]:
    """Each direction and what the data say about it; parameters that stand alone share a row."""
    alone: dict[str, list[str]] = {}
    rows: list[tuple[str, str]] = []
    for direction in directions:
        gain, single = gain_words(direction.gain), _alone(direction)
        if single and gain == gain_words(0.0):
            if gain not in alone:
                rows.append(("", gain))  # filled below, where the first of them stands
            alone.setdefault(gain, []).append(single)
        else:
            rows.append((direction_words(direction), gain))
    return [(words or _each_alone(alone[gain]), gain) for words, gain in rows]


def direction_words(direction: Direction) -> str:
    """What to do with the parameters so that the motions hardly change."""
    total = sum(weight**2 for weight in direction.weights.values()) or 1.0
    shares = {name: weight**2 / total for name, weight in direction.weights.items()}
    names = sorted(shares, key=lambda name: -shares[name])
    if single := _alone(direction):
        return f"{single} on its own"
    # A direction may be walked either way: the largest part is the one that is raised.
    sign = 1.0 if not names or direction.weights[names[0]] >= 0 else -1.0
    shown = [name for name in names if shares[name] > _SHOWN_SHARE]
    up = [_with_share(name, shares) for name in shown if sign * direction.weights[name] >= 0]
    down = [_with_share(name, shares) for name in shown if sign * direction.weights[name] < 0]
    return f"raise {listed(up)}" + (f" while lowering {listed(down)}" if down else "")


def gain_words(gain: float) -> str:
    """How much the data say along a direction, against what was assumed beforehand."""
    if gain < _NOTHING:
        return "nothing"
    if gain < 1.0:
        return f"less than the prior ({fixed(gain, 2)} of it)"
    return f"little ({significant(gain, 2)} times the prior)"


def correlation_words(value: float) -> str:
    """What a strong correlation means."""
    how = "practically one number" if abs(value) > 0.9 else "hard to tell apart"
    return f"{how}: {'both rise or fall together' if value > 0 else 'one rises as the other falls'}"


def strongest(correlation: Mapping[str, Mapping[str, float]], *, above: float = 0.7) -> list[tuple[str, str, float]]:
    """Pairs of parameters by the size of their correlation, each pair once."""
    names = list(correlation)
    pairs = [
        (name, other, float(value))
        for place, name in enumerate(names)
        for other, value in correlation[name].items()
        if abs(value) >= above and (other not in correlation or place < names.index(other))
    ]
    return sorted(pairs, key=lambda pair: (-abs(pair[2]), pair[0], pair[1]))


def _alone(direction: Direction) -> str:
    """The parameter that a direction consists of; empty if there are several."""
    total = sum(weight**2 for weight in direction.weights.values())
    return next((name for name, weight in direction.weights.items() if weight**2 > _ALONE * total), "")


def _each_alone(names: Sequence[str]) -> str:
    return f"{listed(names)}, each on its own" if len(names) > 1 else f"{names[0]} on its own"


def _with_share(name: str, shares: Mapping[str, float]) -> str:
    return f"{name} ({percent(shares[name], sign=False)})"
