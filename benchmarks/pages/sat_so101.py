"""A part of docs/building-blocks.md, from what `python -m benchmarks sat_so101` has measured."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from benchmarks.pages.augment_cells import MARKS, listed
from benchmarks.pages.markdown import table

SIMULATOR, HELD = "simulator", "held"
JOINTS = {
    "shoulder_pan": "pan",
    "shoulder_lift": "lift",
    "elbow_flex": "elbow",
    "wrist_flex": "wrist flex",
    "wrist_roll": "wrist roll",
}
# Name -> trained on, reads sensors.
ABOUT = {
    SIMULATOR: "identified simulator",
    "sat": "SAT of pan, lift, elbow",
    "sat-whole": "SAT, not modular, all joints",
    "realeasy-rt": "Realeasy, real-time, all joints",
    HELD: "sensor: last error held",
    "sat-sensed": "sensor: SAT of pan, lift, elbow",
}

TEXT = """## A real arm: servos it never saw

The [SO-101](real-robots.md#so-101-a-hobby-arm-with-position-servos) has six equal servos. Networks correct its
identified simulator; some never saw the wrist ({unseen}). Mean absolute position error [mrad] on
{count} held-out motions, and its change with the 95 % interval (`~`: undecided; `python -m benchmarks sat_so101`):

{errors}

{verdict}

Position RMSE on the [ladder](augmentation.md#evaluating), in mrad: {rungs}.

{choice_words}
"""


def part(result: Mapping[str, Any]) -> str:
    """The part of the page that belongs to a result."""
    return TEXT.format(
        unseen=listed(JOINTS[joint] for joint in result["unseen"]),
        count=len(result["motions"]),
        errors=error_table(result),
        verdict=verdict(result),
        rungs=rungs(result),
        choice_words=choice_words(result),
    )


def error_table(result: Mapping[str, Any]) -> str:
    """One row per way of saying where the arm is: errors of the wrist and of all joints, and what they differ by."""
    rows = []
    for name, about in ABOUT.items():
        cells = []
        for key in ("unseen", "all"):
            cell = _milli(float(np.mean(result["errors"][name]["mae"][key])))
            if name != SIMULATOR:
                found = _difference(result, name, SIMULATOR, key)
                cell += f"; {_interval(found['difference'])}{MARKS[found['verdict']]}"
            cells.append(cell)
        rows.append([about, *cells])
    return table(["", "wrist", "all five joints"], rows)


def verdict(result: Mapping[str, Any]) -> str:
    """Whether the unseen servos improve, in words, with a sensor and without."""
    lines = []
    joints = [*result["seen"], *result["unseen"]]
    worse = [JOINTS[name] for name in joints if _difference(result, "sat", SIMULATOR, name)["verdict"] == "worse"]
    for name, how in (("sat", "Without a sensor"), ("sat-sensed", "With the encoder's last reading")):
        found = _difference(result, name, SIMULATOR, "unseen")
        lines.append(
            {
                "better": f"{how}, the wrist improves over the identified simulator.",
                "worse": f"{how}, the wrist gets worse than the identified simulator.",
                "undecided": f"{how}, nothing is claimed of the wrist.",
            }[found["verdict"]]
        )
    if worse:
        lines.insert(1, f"By itself, {listed(worse)} gets worse.")
    held = _difference(result, "sat-sensed", HELD, "unseen")
    change = f"{_interval(held['difference'])} mrad"
    lines.append(
        {
            "better": f"The network also beats simply holding the last error: {change}.",
            "worse": f"Simply holding the last error, without a network, is better: the network adds {change}.",
            "undecided": f"Simply holding the last error, without a network, may do as well: {change}, undecided.",
        }[held["verdict"]]
    )
    return "\n".join(lines)


def rungs(result: Mapping[str, Any]) -> str:
    """The ladder, without the repetitions."""
    names = ("fitted", "fitted+sat", "fitted+sat-sensed", "fitted+realeasy-rt")
    return ", ".join(f"`{name}` {_milli(result['rungs'][name]['value'])}" for name in names)


def choice_words(result: Mapping[str, Any]) -> str:
    """What the table says."""
    better = [name for name, own in result["choice"].items() if own["verdict"] == "better"]
    least = min(result["choice"], key=lambda name: result["choice"][name]["difference"]["value"])
    if better:
        return f"With other inputs, this helps a joint that was left out: {listed(f'*{name}*' for name in better)}."
    return (
        "Other inputs (no position, no torque, mirrored, command alone) do not help a joint that was left out; "
        f"*{least}* does least harm."
    )


def _difference(result: Mapping[str, Any], name: str, base: str, joints: str, metric: str = "mae") -> Mapping[str, Any]:
    found: Mapping[str, Any] = result["differences"][f"{name} - {base}"][metric][joints]
    return found


def _milli(value: float) -> str:
    return f"{1e3 * value:.2f}"


def _interval(item: Mapping[str, Any]) -> str:
    texts = [f"{1e3 * item[key]:+.2f}" for key in ("value", "low", "high")]
    return f"{texts[0]} [{texts[1]}, {texts[2]}]".replace("-", "\N{MINUS SIGN}")
