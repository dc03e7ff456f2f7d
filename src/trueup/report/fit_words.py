"""A fit in words: its status, its parameters and what the motions leave open."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from trueup.core.fit_result import Direction, FitResult, FittedParameter
from trueup.report.numbers import fixed, percent, plural, significant

CAUSES = ("delay", "gains", "friction", "gravity", "inertia")
QUANTITIES = {
    "delay_s": "delay of the command",
    "kp": "stiffness of the servo",
    "kv": "damping of the servo",
    "torque_gain": "torque per commanded torque",
    "torque_limit": "torque limit",
    "damping": "viscous friction",
    "frictionloss": "Coulomb friction",
    "stribeck": "static friction above Coulomb friction",
    "stribeck_velocity": "speed at which that excess is gone",
    "load": "friction per transmitted torque",
    "asymmetry": "friction by direction",
    "tanh_coulomb": "smoothed Coulomb friction",
    "tanh_velocity": "smoothing of that friction",
    "sigmoid_level": "sigmoid friction, level",
    "sigmoid_slope": "sigmoid friction, slope",
    "sigmoid_shift": "sigmoid friction, shift",
    "dead_band": "dead band of the servo",
    "static_positive": "breakaway torque, positive",
    "static_negative": "breakaway torque, negative",
    "torque_offset": "constant torque",
    "joint_offset": "zero of the joint",
    "mass": "mass",
    "com_x": "center of mass, x",
    "com_y": "center of mass, y",
    "com_z": "center of mass, z",
    "armature": "rotor inertia at the joint",
    "inertia_scale": "rotational inertia, factor",
    "payload_mass": "mass of the payload",
    "payload_x": "payload, x",
    "payload_y": "payload, y",
    "payload_z": "payload, z",
}
# How sure a parameter is, from good to bad: sign and words, so that color is never the only cue.
KINDS = {
    "yes": ("●", "determined"),
    "weakly": ("◆", "weakly determined"),
    "zero": ("○", "ended on zero"),
    "no": ("✕", "not determined"),
    "bound": ("◀", "on its bound"),
    "frozen": ("–", "not fitted"),
}
# The data must say this much more than the prior before a direction needs no mention; see `Direction`.
_NOTHING = 0.05
_ALONE = 0.9
_SHOWN_SHARE = 0.04


@dataclass(frozen=True)
class Alert:
    """What must not be overlooked.

    Attributes:
        tone: `bad` (do not use it) or `careful`.
        title: the status in two or three words, with a sign.
        lead: one sentence.
        statements: what the fit itself says.
        advice: the next step.
        status: as in fit.json.
    """

    tone: str
    title: str
    lead: str
    statements: tuple[str, ...]
    advice: str
    status: str


_ALERTS = {
    "not-identifiable": (
        "careful",
        "▲ Not identifiable",
        "Some of the fitted numbers are guesses: these motions do not determine them, even where the simulator "
        "moves like the robot.",
        "Record motions that show these parameters, or freeze them.",
    ),
    "at-bound": (
        "careful",
        "▲ On a bound",
        "Some of the fitted numbers ended on a bound: they say where the search had to stop, not what the robot is.",
        "Widen the bound in the configuration, or doubt the structure of the model.",
    ),
    "not-converged": (
        "bad",
        "✕ Not converged",
        "The search stopped before it converged: these numbers are no result.",
        "Run again with --resume, or allow more iterations in the configuration.",
    ),
    "no-better": (
        "bad",
        "✕ No better than before",
        "Do not use this fit: the fitted model is no better than the one that it started from.",
        "Check that robot, model and logs belong together: joint map, units, delays, payload.",
    ),
}


def alert_of(fit: FitResult) -> Alert | None:
    """What to say before anything else; None for a fit whose status is `ok`."""
    if fit.status == "ok":
        return None
    tone, title, lead, advice = _ALERTS[fit.status]
    return Alert(tone, title, lead, tuple(as_sentence(text) for text in fit.statements), advice, fit.status)


def free_parameters(fit: FitResult) -> list[FittedParameter]:
    """Those that were fitted."""
    return [item for item in fit.parameters if not item.frozen]


def sure_sentence(fit: FitResult) -> str:
    """How many parameters the data determine."""
    free = free_parameters(fit)
    if not free:
        return "No parameter was fitted."
    counts = {kind: sum(item.identified == kind for item in free) for kind in ("yes", "weakly", "no")}
    if counts["yes"] == len(free):
        which = "the parameter that was fitted" if len(free) == 1 else f"all {plural(len(free), 'parameter')}"
        return f"These motions determine {which}."
    rest = [f"{counts['weakly']} weakly"] if counts["weakly"] else []
    rest += [f"{counts['no']} not at all"] if counts["no"] else []
    return f"These motions determine {counts['yes']} of {plural(len(free), 'parameter')}, {' and '.join(rest)}."


def split_name(name: str) -> tuple[str, str]:
    """`damping[elbow]` -> quantity and target; the target is empty for what the robot has once."""
    quantity, bracket, target = name.partition("[")
    return (quantity, target.removesuffix("]")) if bracket else (name, "")


def kind_of(item: FittedParameter) -> str:
    """One of `KINDS`; a law that ended on zero is one that the robot does not have, no cause for alarm."""
    if item.frozen:
        return "frozen"
    if item.at_bound == "low" and item.low == 0.0:
        return "zero"
    return "bound" if item.at_bound else item.identified


def shown_value(item: FittedParameter) -> float:
    """The value as printed: on a bound it is the bound, without the rest that a transform leaves."""
    return {"low": item.low, "high": item.high}.get(item.at_bound, item.value)


def change_words(item: FittedParameter) -> str:
    """`×0.51` for what is positive by nature, else the difference; empty where nothing changed."""
    value = shown_value(item)
    if value == item.nominal:
        return "unchanged"
    if is_factor(item):
        return f"×{significant(value / item.nominal)}"
    return significant(value - item.nominal, sign=True)


def is_factor(item: FittedParameter) -> bool:
    """Whether its change is a factor: on a log scale, and the model has it."""
    return item.transform == "log" and min(item.nominal, item.value, *item.interval) > 0.0


def as_sentence(text: str) -> str:
    """With a capital letter and a full stop, unless it begins with a name."""
    first = text.split(" ")[0]
    if first.isalpha():
        text = text[:1].upper() + text[1:]
    return text if not text or text.endswith((".", "!", "?")) else f"{text}."


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
    return [
        (as_sentence(blank.replace("\0", listed(targets))), listed(quantities))
        for blank, (targets, quantities) in found.items()
    ]


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


def listed(names: Sequence[str], *, limit: int = 6) -> str:
    """`a, b and c`; long lists end with how many more there are."""
    if len(names) > limit:
        return f"{', '.join(names[:limit])} and {len(names) - limit} more"
    return " and ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else "".join(names)


def _alone(direction: Direction) -> str:
    """The parameter that a direction consists of; empty if there are several."""
    total = sum(weight**2 for weight in direction.weights.values())
    return next((name for name, weight in direction.weights.items() if weight**2 > _ALONE * total), "")


def _each_alone(names: Sequence[str]) -> str:
    return f"{listed(names)}, each on its own" if len(names) > 1 else f"{names[0]} on its own"


def _with_share(name: str, shares: Mapping[str, float]) -> str:
    return f"{name} ({percent(shares[name], sign=False)})"
