"""How far a correction carries, in plain words."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from trueup.core.results import Estimate
from trueup.core.robustness_result import RobustnessResult, RobustnessRow
from trueup.report.numbers import percent, plain, plural

# Field of a perturbation -> what is off, and how its size is said.
OFF = {"mass": "masses", "com_m": "centers of mass", "joint_m": "joint positions", "resistance": "resistance"}
_LENGTHS = ("com_m", "joint_m")


def size_words(size: Mapping[str, float]) -> str:
    """`masses by 50 %, joint positions by 2 mm`."""
    parts = []
    for name, value in size.items():
        if value:
            amount = f"{plain(1e3 * value)} mm" if name in _LENGTHS else f"{plain(100.0 * value)} %"
            parts.append(f"{OFF.get(name, name)} by {amount}")
    return ", ".join(parts)


def gone_words(gone: Estimate) -> str:
    """`69 % (66 to 71)`, with the interval in percent."""
    ends = gone_interval(gone)
    return percent(gone.value, sign=False) + (f" ({ends})" if ends else "")


def gone_interval(gone: Estimate) -> str:
    """`66 to 71` in percent; empty where there is no interval."""
    if gone.low is None or gone.high is None:
        return ""
    low, high = (percent(end, sign=False).split("\N{NO-BREAK SPACE}")[0] for end in (gone.low, gone.high))
    return f"{low} to {high}"


def lead(result: RobustnessResult) -> str:
    """What the correction takes away with the simulator as it is, on the first dataset."""
    row = result.datasets[0]
    item = row.errors["mae"]
    where = f"of {result.robot} on {row.dataset} ({plural(row.motions, 'motion')})"
    if item.verdict == "undecided":
        return (
            f"It is not decided whether {result.network} helps {where}: {gone_words(item.gone)} of the error is gone."
        )
    if item.verdict == "worse":
        return f"{result.network} does not help {where}: the mean position error grows."
    return f"{result.network} takes {gone_words(item.gone)} of the mean position error {where} away."


def sentences(result: RobustnessResult) -> list[str]:
    """Until where it helps: over datasets, and over simulators that are off."""
    lines = []
    if len(result.datasets) > 1:
        unsure = [row.dataset for row in result.datasets if not _helps(row)]
        if unsure:
            lines.append(f"It does not help for sure on {', '.join(unsure)}.")
        else:
            lines.append(f"On every dataset it helps: least on {_least(result.datasets, lambda row: row.dataset)}.")
    if result.perturbed:
        # Of each perturbation the smallest size at which nothing is certain.
        first = [next((row for row in own if not _helps(row)), None) for own in result.perturbed.values()]
        limits = [size_words(row.size) for row in first if row is not None]
        rows = [row for own in result.perturbed.values() for row in own]
        if limits:
            lines.append(f"It does not help for sure where the simulator is off in {'; in '.join(limits)}, or more.")
        else:
            least = _least(rows, lambda row: size_words(row.size))
            lines.append(f"It helps with every simulator that is off: least with one off in {least}.")
    return lines


def _helps(row: RobustnessRow) -> bool:
    return row.errors["mae"].verdict == "better"


def _least(rows: Sequence[RobustnessRow], name: Callable[[RobustnessRow], str]) -> str:
    row = min(rows, key=lambda item: item.errors["mae"].gone.value)
    return f"{name(row)}, {gone_words(row.errors['mae'].gone)}"
