"""What a fit says of itself, held against the truth: rows of numbers, counts, named causes, and the bars.

Everything here is a function of what is kept of a cell, so that another question needs no other run.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from statistics import median
from typing import Any

import numpy as np

from benchmarks.table import Row, at_least, at_most, shown
from trueup.core.fit_result import FitResult, FittedParameter

Cell = Mapping[str, Any]
Number = Mapping[str, Any]

# Cause -> kinds of findings of the check that name it, and words of a fit's sentences that do (regular expressions).
ACCEPTED: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "late-feedback": (
        ("late-feedback", "feedback-delay"),
        (r"\blate feedback\b", r"\bfeedback (that )?is late\b", r"\bfeedback delay", r"\bdelay of (the )?feedback\b"),
    ),
    "integral": (("integral",), (r"\bintegral\b", r"\bintegrator\b", r"\bintegrates\b")),
    "backlash": (("backlash",), (r"\bbacklash\b", r"\bplay\b")),
    "elastic": (
        ("elastic", "elasticity"),
        (r"\belastic", r"\bflexib", r"\bcompliant\b", r"\bcompliance\b", r"\bspring"),
    ),
    "payload": (("payload",), (r"\bpayload\b", r"\bcarries more\b")),
    "sign": (("sign",), (r"\bmirrored\b", r"\bother way round\b", r"\bwrong sign\b")),
}
# What a fit has looked for in vain.
_DENIED = re.compile(r"none of .*? explains it")
# Finding of this severity is worth knowing, and accuses nobody.
_NOTE = "note"

COVERAGE, WORST_COVERAGE, WIDER, NOISES, EXPLAINED, OK, ERROR, NAMED = 90.0, 80.0, 3.0, 1.3, 90.0, 70.0, 3.0, 80.0
# Bars, in the order of the page; a robot's name may follow.
HOLD, WORST, WIDE, LEFT, STATUS, FAR, WRONG, CAUSE = NAMES = (
    "A: numbers called determined that hold the truth",
    "A: the same on the worst robot",
    "A: widths over the narrowest that there can be",
    f"A: fits that leave at most {NOISES:g} times the noise",
    "A: fits with the status ok",
    "A: error of numbers called determined, median",
    "B: numbers called determined outside their interval in fits called ok",
    "B: cause named",
)
_DIGITS = 7


def truths(truth: Mapping[str, Any], *, carries: bool = False) -> dict[str, float]:
    """Parameter -> true value, of all that truth.json knows.

    What is welded to a body moves as one with it: a payload belongs to the mass of its body, and that body's center and
    shape have no truth of their own; unless the fit `carries` a payload that hangs there itself.
    """
    found = dict(truth["parameters"])
    found |= {f"torque_limit[{joint}]": limit for joint, limit in truth["limits"].items() if limit is not None}
    if truth["cause"].get("kind") == "payload":
        body, mass = truth["cause"]["body"], truth["cause"]["mass_kg"]
        if carries:
            return {**found, "payload_mass": mass}
        found[f"mass[{body}]"] += mass
        for name in ("com_x", "com_y", "com_z", "inertia_scale"):
            found.pop(f"{name}[{body}]", None)
    return found


def numbers(fit: FitResult, truth: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Every parameter of a fit beside its true value, None where there is none."""
    carries = any(item.name == "payload_mass" and not item.frozen for item in fit.parameters)
    true = truths(truth, carries=carries)
    return [_number(item, true.get(item.name)) for item in fit.parameters]


def _number(item: FittedParameter, true: float | None) -> dict[str, Any]:
    low, high = item.interval
    ends = {"value": item.value, "low": low, "high": high, "truth": true, "nominal": item.nominal}
    return {
        "name": item.name,
        **{key: None if value is None else _short(value) for key, value in ends.items()},
        "identified": item.identified,
        "frozen": item.frozen,
        "at_bound": item.at_bound,
        "transform": item.transform,
    }


def _short(value: float) -> float | None:
    return float(f"{value:.{_DIGITS}g}") if np.isfinite(value) else None


def sums(fit: FitResult, draws: Mapping[str, np.ndarray], truth: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The sums that truth.json knows, with 95 % of the fit's draws.

    The product states no sums, so these are shown and belong to no bar. A part that it calls determined counts by
    itself.
    """
    found = []
    for name, true in truth["sums"].items():
        first, _, rest = name.partition("+")
        second, target = rest.rstrip("]").split("[")
        parts = [f"{first}[{target}]", f"{second}[{target}]"]
        if all(part in draws for part in parts):
            low, high = np.percentile(sum(draws[part] for part in parts), (2.5, 97.5))
            ends = {"value": sum(fit[part].value for part in parts), "low": low, "high": high, "truth": true}
            found.append({"name": name, **{key: _short(float(value)) for key, value in ends.items()}})
    return found


def called(rows: Iterable[Number]) -> list[Number]:
    """The rows that the product calls determined."""
    return [row for row in rows if row["identified"] == "yes" and not row["frozen"]]


def judged(rows: Iterable[Number]) -> list[Number]:
    """Those of them that have a truth."""
    return [row for row in called(rows) if row["truth"] is not None and None not in (row["low"], row["high"])]


def holds(row: Number) -> bool:
    """Whether an interval holds the truth."""
    return bool(row["low"] <= row["truth"] <= row["high"])


def off(row: Number) -> float:
    """How far the truth is from a number, in units of its interval on its side: within -1 to 1 if it holds it."""
    ends = [row[key] for key in ("value", "low", "high", "truth")]
    scaled = np.log(ends) if row["transform"] == "log" and min(ends) > 0 else np.array(ends)
    value, low, high, truth = map(float, scaled)
    reach = high - value if truth > value else value - low
    return 0.0 if truth == value else float((truth - value) / max(reach, 1e-300))


def error(row: Number) -> float | None:
    """Of a number that is positive by nature, relative to its truth; None of offsets and places."""
    positive = row["transform"] == "log" or row["name"].startswith("delay_s[")
    return abs(row["value"] / row["truth"] - 1) if positive and row["truth"] else None


def middle_error(rows: Iterable[Number]) -> float | None:
    """Median relative error of the numbers called determined, a share."""
    found = [own for row in judged(rows) if (own := error(row)) is not None]
    return median(found) if found else None


def coverage(rows: Iterable[Number]) -> float | None:
    """Share of the numbers called determined whose interval holds the truth."""
    found = [holds(row) for row in judged(rows)]
    return sum(found) / len(found) if found else None


def left(cell: Cell) -> float | None:
    """What a fit leaves of the positions over the noise that was added to them, root mean square over joints."""
    ratios = [own["rms"] / cell["noise"] for own in cell["left"].values()]
    return float(np.sqrt(np.mean(np.square(ratios)))) if ratios else None


def width(row: Number) -> float:
    """Of an interval: the logarithm of high over low on a logarithmic scale."""
    return float(
        np.log(row["high"] / row["low"]) if row["transform"] == "log" and row["low"] > 0 else row["high"] - row["low"]
    )


def wider(cell: Cell, oracle: Cell) -> float | None:
    """Widths over the narrowest that there can be: median over the numbers called determined."""
    known = {row["name"]: width(row) for row in called(oracle["numbers"])}
    ratios = [width(row) / known[row["name"]] for row in called(cell["numbers"]) if known.get(row["name"], 0.0) > 0]
    return median(ratios) if ratios else None


def naming(cell: Cell) -> list[str]:
    """What the product said that names the cause: sentences of findings and of the fit."""
    cause = cell["cause"]
    kinds, words = ACCEPTED[cause["kind"]]
    pattern = re.compile("|".join(words), re.IGNORECASE)
    found = [
        item["evidence"]
        for item in accusations(cell)
        if item["kind"] in kinds and _about(item["joints"], cause["joints"])
    ]
    for said in cell["statements"]:
        text = _DENIED.sub("", said)
        joints = [joint for joint in cell["joints"] if re.search(rf"(?<![\w/]){re.escape(joint)}(?![\w/])", text)]
        if pattern.search(text) and _about(joints, cause["joints"]):
            found.append(said)
    return found


def accusations(cell: Cell) -> list[Mapping[str, Any]]:
    """Findings of the check that are certain or likely."""
    return [item for item in cell["findings"] if item["severity"] != _NOTE]


def _about(named: Sequence[str], meant: Sequence[str]) -> bool:
    return not named or bool(set(named) & set(meant))


def wrong_but_ok(cell: Cell) -> list[Number]:
    """Numbers of a fit called ok that are called determined and are not in their interval."""
    return [row for row in judged(cell["numbers"]) if not holds(row)] if cell["status"] == "ok" else []


def of_group(cells: Mapping[str, Cell], group: str) -> dict[str, list[Cell]]:
    """Case -> its cells by seed, of one group, in the order in which they are given."""
    found: dict[str, list[Cell]] = {}
    for cell in cells.values():
        if cell["group"] == group:
            found.setdefault(cell["case"], []).append(cell)
    return found


def all_numbers(cells: Iterable[Cell]) -> list[Number]:
    """Rows of several cells."""
    return [row for cell in cells for row in cell["numbers"]]


def all_sums(cells: Iterable[Cell]) -> list[Number]:
    """Sums of the cells of group A, whichever of their parts are determined."""
    return [row for cell in cells if cell["group"] == "A" for row in cell["sums"]]


def sum_error(sums: Iterable[Number]) -> float:
    """Median relative error of sums, a share."""
    return median(abs(row["value"] / row["truth"] - 1) for row in sums)


def ratios(result: Mapping[str, Any]) -> dict[str, float]:
    """Case -> how much wider its intervals are than the narrowest that there can be, for cells that have both."""
    found = {}
    for key, oracle in result["oracles"].items():
        if key in result["cells"] and (own := wider(result["cells"][key], oracle)) is not None:
            found[result["cells"][key]["case"]] = own
    return found


def bars(result: Mapping[str, Any]) -> list[Row]:
    """The bars, as far as there is anything to hold against them."""
    return [*_bars_a(result), *_bars_b(result)]


def _bars_a(result: Mapping[str, Any]) -> Iterator[Row]:
    cases = of_group(result["cells"], "A")
    cells = [cell for own in cases.values() for cell in own]
    if not cells:
        return
    rows = all_numbers(cells)
    if judged(rows):
        yield at_least(HOLD, 100 * _known(coverage(rows)), COVERAGE, "%")
        shares = {case: share for case, own in cases.items() if (share := coverage(all_numbers(own))) is not None}
        worst = min(shares, key=shares.__getitem__)
        yield at_least(f"{WORST}, {worst}", 100 * shares[worst], WORST_COVERAGE, "%")
    if wide := ratios(result):
        worst = max(wide, key=wide.__getitem__)
        yield at_most(f"{WIDE}, {worst}", wide[worst], WIDER, "x")
    explained = [own is not None and own <= NOISES for own in map(left, cells)]
    yield at_least(LEFT, _percent(explained), EXPLAINED, "%")
    yield at_least(STATUS, _percent([cell["status"] == "ok" for cell in cells]), OK, "%")
    if (middle := middle_error(rows)) is not None:
        yield at_most(FAR, 100 * middle, ERROR, "%")


def _bars_b(result: Mapping[str, Any]) -> Iterator[Row]:
    cells = [cell for own in of_group(result["cells"], "B").values() for cell in own]
    if not cells:
        return
    wrong = sum(len(wrong_but_ok(cell)) for cell in cells)
    yield at_most(WRONG, wrong, 0, "numbers")
    yield at_least(CAUSE, _percent([bool(naming(cell)) for cell in cells]), NAMED, "%")


def rows(result: Mapping[str, Any]) -> list[Row]:
    """The bars, and what belongs to them."""
    cells = result["cells"]
    found = bars(result)
    if both := all_sums(cells.values()):
        found.append(shown("A: error of sums of kv and damping, median", 100 * sum_error(both), "%"))
    if cells:
        found.append(shown("whole command, median", median(cell["seconds"] for cell in cells.values()), "s"))
    return [*found, shown("cells", len(cells), "fits")]


def _percent(held: Sequence[bool]) -> float:
    return 100 * sum(held) / len(held)


def _known(value: float | None) -> float:
    assert value is not None
    return value
