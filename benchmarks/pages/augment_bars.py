"""What was asked of learned corrections before any was trained, and whether it is kept."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from benchmarks.pages.augment_cells import factor, listed
from benchmarks.pages.augment_data import PRECISE, REAL_TIME, TEST_NAMES, TESTS, ZOO, Learned, joint_cuts
from benchmarks.pages.markdown import table
from trueup.core.augment_result import AugmentResult, Cut

# Model -> how many times smaller the torque MSE of every joint must be on motions of several joints.
TORQUE = {PRECISE: 10.0, REAL_TIME: 7.0}
LINES = 5.0
OTHER_UNIT = 2.2
# Model -> position RMSE on the test motions of the real arm [rad].
ARM = {"so101-rt": 0.0105, "so101-precise": 0.0100}


@dataclass(frozen=True)
class Bar:
    """One bar.

    Attributes:
        what: of which network, on what.
        bar: the bar in words.
        found: the figure that is held against it.
        verdict: `kept`, `missed`, or `undecided`.
    """

    what: str
    bar: str
    found: str
    verdict: str


def bars(data: Learned) -> list[Bar]:
    """All of them, in the order of the page."""
    found = [_least(data.lab, model, "multi-joint", bar) for model, bar in TORQUE.items()]
    found += [_least(data.lab, model, "cartesian", LINES) for model in TORQUE]
    found += [_no_worse(data.lab, model) for model in TORQUE]
    found += [
        _least(result, model, "", OTHER_UNIT, f"unit {unit}")
        for model in (PRECISE, REAL_TIME, ZOO)
        for unit, result in data.others.items()
    ]
    return [*found, *_arm(data)]


def bar_table(found: Sequence[Bar]) -> str:
    """The bars of the lab, and which of them are kept: a row for each test, a column for each network."""
    cells: dict[str, dict[str, str]] = {}
    for bar in found:
        model, _, where = bar.what.partition(": ")
        ending = "" if bar.verdict == "kept" else f" **{bar.verdict}**"
        cells.setdefault(where, {})[model] = f"{bar.found} ({bar.bar}){ending}"
    models = list(dict.fromkeys(model for own in cells.values() for model in own))
    return table(("", *models), [(where, *(own.get(model, "") for model in models)) for where, own in cells.items()])


def bar_words(found: Sequence[Bar]) -> str:
    """How many are kept."""
    counts = {verdict: sum(bar.verdict == verdict for bar in found) for verdict in ("kept", "missed", "undecided")}
    if counts["kept"] == len(found):
        return f"All {len(found)} are kept."
    parts = [f"{count} {'is' if count == 1 else 'are'} {verdict}" for verdict, count in counts.items() if count]
    return f"Of {len(found)}, {listed(parts)}."


def _least(result: AugmentResult, model: str, condition: str, bar: float, where: str = "") -> Bar:
    """Torque MSE, by the joint on which least is gained."""
    joint, cut = least_cut(joint_cuts(result, model, condition, "torque"))
    what = f"`{model}`: torque, {where or TEST_NAMES[condition]}"
    verdict = "kept" if _gained(cut) >= bar else "missed"
    return Bar(what, f"≥ {bar:g}", f"{factor(cut.factor)} {joint}", verdict)


def least_cut(cuts: Mapping[str, Cut]) -> tuple[str, Cut]:
    """The joint on which least is gained."""
    return min(cuts.items(), key=lambda item: _gained(item[1]))


def _gained(cut: Cut) -> float:
    """Where nothing is left of an error, everything is gained."""
    return math.inf if math.isnan(cut.factor.value) else cut.factor.value


def _no_worse(result: AugmentResult, model: str) -> Bar:
    """Position and velocity, every joint of every test."""
    found = [
        (item, f"{signal} of {joint}, {TEST_NAMES[test]}")
        for test in TESTS
        for signal in ("position", "velocity")
        for joint, item in joint_cuts(result, model, test, signal).items()
    ]
    worse = [where for item, where in found if item.verdict == "worse"]
    item, where = min(found, key=lambda pair: _gained(pair[0]))
    verdict = "missed" if worse else "kept" if _gained(item) >= 1.0 else "undecided"
    told = f"{len(worse)} of {len(found)} worse; {factor(item.factor, item.verdict)} {where}"
    return Bar(f"`{model}`: position, velocity, all tests", "0 worse", told, verdict)


def _arm(data: Learned) -> Iterator[Bar]:
    """RMSE as identification counts it: means over motions."""
    for model, bar in ARM.items():
        rung = data.arm_rungs.get(f"fitted+{model}")
        if rung is not None:
            value = rung.total.value
            what, asked = f"`{model}`: SO-101, position, test", f"≤ {bar:.4f} rad"
            yield Bar(what, asked, f"{value:.5f} rad", "kept" if value <= bar else "missed")
