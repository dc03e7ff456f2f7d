"""A fit in words: its status and its parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from trueup.core.fit_result import IDENTIFIED, FitResult, FittedParameter
from trueup.report.numbers import plain, plural, significant

CAUSES = ("delay", "gains", "friction", "gravity", "inertia")
# How sure a parameter is, from good to bad: sign and words, so that color is never the only cue.
KINDS = {
    "yes": ("●", "determined"),
    "effective": ("◐", "effective value"),
    "weakly": ("◆", "weakly determined"),
    "zero": ("○", "ended on zero"),
    "no": ("✕", "not determined"),
    "bound": ("◀▶", "on its bound"),
    "frozen": ("–", "not fitted"),
}


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
        "Some of the fitted numbers are guesses: these motions do not determine them, however well the model moves.",
        "Record motions that show these parameters, or freeze them.",
    ),
    "unexplained": (
        "careful",
        "▲ Not fully explained",
        "The model lacks something: the error exceeds noise, so parameters may be off by more than their intervals.",
        "Look at the remaining error below, and add what is missing to the fit (friction laws, limits, a payload).",
    ),
    "at-bound": (
        "careful",
        "▲ On a bound",
        "Some fitted values ended on a bound: the robot's true values may lie beyond it.",
        "Widen the bound in the configuration, or doubt the structure of the model.",
    ),
    "signal-worse": (
        "bad",
        "✕ A signal got worse",
        "Positions are simulated better than before, but another logged signal is simulated worse.",
        "Check sign, scale and unit of that signal in the logs, or weigh it (signals: {torque: …}) and fit again.",
    ),
    "not-converged": (
        "bad",
        "✕ Not converged",
        "The search stopped early, or searches from other starting points ended elsewhere: do not use these values.",
        "Allow more iterations, time or candidates in the configuration, and run again with --overwrite.",
    ),
    "no-better": (
        "bad",
        "✕ No better than before",
        "Do not use this fit: the fitted model is no better than the one that it started from.",
        "Check that robot, model and logs belong together: joint map, units, delays, payload.",
    ),
}


_SHORT = (
    "careful",
    "▲ Stopped at the time limit",
    "The error shown is valid; parameter values may still change.",
    "Give it more time (--budget), and run again with --overwrite.",
)


def alert_of(fit: FitResult) -> Alert | None:
    """What to say before anything else; None for a fit whose status is `ok`."""
    if fit.status == "ok":
        return None
    # A search that the time has ended is none that went astray: where it is, it is better than where it began.
    tone, title, lead, advice = _SHORT if fit.ended_by_time else _ALERTS[fit.status]
    return Alert(tone, title, lead, tuple(as_sentence(text) for text in fit.statements), advice, fit.status)


def sure_sentence(fit: FitResult) -> str:
    """How many parameters the data determine."""
    free = fit.free
    if not free:
        return "No parameter was fitted."
    counts = {kind: sum(item.identified == kind for item in free) for kind in IDENTIFIED}
    rest = [f"{counts['effective']} more as effective values"] if counts["effective"] else []
    rest += [f"{counts['weakly']} weakly"] if counts["weakly"] else []
    rest += [f"{counts['no']} not at all"] if counts["no"] else []
    which = f"{counts['yes']} of {plural(len(free), 'parameter')}, {listed(rest)}"
    if not rest:
        which = "the parameter that was fitted" if len(free) == 1 else f"all {plural(len(free), 'parameter')}"
    kinds = [kind_of(item) for item in free]
    ends = [f"{kinds.count('bound')} ended on a bound."] if "bound" in kinds else []
    ends += [f"{kinds.count('zero')} ended on zero: the data show none of that."] if "zero" in kinds else []
    return " ".join([f"These motions determine {which}.", *ends])


def kind_of(item: FittedParameter) -> str:
    """One of `KINDS`; a law that ended on zero is one that the robot does not have, no cause for alarm."""
    if item.frozen:
        return "frozen"
    if item.absent or (item.at_bound == "low" and item.low == 0.0):
        return "zero"
    return "bound" if item.at_bound else item.identified


def shown_value(item: FittedParameter) -> float:
    """The value as printed: on a bound it is the bound, without the rest that a transform leaves."""
    return {"low": item.low, "high": item.high}.get(item.at_bound, item.value)


def change_words(item: FittedParameter) -> str:
    """`×0.51` for what is positive by nature, else the difference; `added` to a model that has no such number."""
    value = shown_value(item)
    if value == item.nominal:
        return "unchanged"
    if item.nominal is None:
        return "added"
    if is_factor(item):
        return f"×{significant(value / item.nominal)}"
    return significant(value - item.nominal, sign=True)


def nominal_words(item: FittedParameter) -> str:
    """What the model said."""
    return "none" if item.nominal is None else plain(item.nominal)


def is_factor(item: FittedParameter) -> bool:
    """Whether its change is a factor: on a log scale, and the model has it."""
    return item.transform == "log" and min(item.nominal or 0.0, item.value, *item.interval) > 0.0


def as_sentence(text: str) -> str:
    """With a capital letter and a full stop, unless it begins with a name."""
    first = text.split(" ")[0]
    if first.isalpha():
        text = text[:1].upper() + text[1:]
    return text if not text or text.endswith((".", "!", "?")) else f"{text}."


def listed(names: Sequence[str], *, limit: int = 6) -> str:
    """`a, b and c`; long lists end with how many more there are."""
    if len(names) > limit:
        return f"{', '.join(names[:limit])} and {len(names) - limit} more"
    return " and ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else "".join(names)
