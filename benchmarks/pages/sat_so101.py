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
    "unseen": "wrist",
    "all": "all five",
}
# Name -> trained on, reads sensors.
ABOUT = {
    SIMULATOR: "identified simulator alone",
    "sat": "SAT, one network; pan, lift, elbow",
    "sat-all": "SAT, one network; all joints",
    "sat-whole": "SAT, not modular; all joints",
    "realeasy-rt": "Realeasy, real-time; all joints",
    "realeasy": "Realeasy, precise; all joints",
    HELD: "*sensor:* the last error held, no network",
    "sat-sensed": "*sensor:* SAT, one network; pan, lift, elbow",
}

TEXT = """## A real arm: servos it never saw

The [SO-101](real-robots.md#so-101-a-hobby-arm-with-position-servos) has six equal servos. One network for a servo is
trained on {seen} alone, on top of the identified simulator, and tested on {unseen},
which it never saw, in {count} motions that nobody saw. Identification did see all joints, in the train motions: a
network can only take away what identification leaves.

```sh
python -m benchmarks sat_so101
```

Mean absolute error of the position on the test motions in mrad, mean over motions; of what was trained more than once
({repeated}), the mean of {seeds} trainings. `~`: the paired interval of the difference to the simulator
holds zero; **worse**: it lies above.

{errors}

A network of the whole arm (*not modular*) has the channels of the joints that it was trained on. Trained on three, it
would have nothing to say of the wrist, so it is shown trained on all five.

Difference to the identified simulator, 95 % interval over whole motions, in mrad:

{differences}

{verdict}

### What is left

Of the squared error of the identified simulator on test: the share at rest (slower than 0.05 rad/s), and the shares
that one offset, or one delay, of each motion would take away.

{left}

### Rungs

Position RMSE on test as the [ladder](augmentation.md#evaluating) has it, mean over motions and the five joints:

{rungs}

### What carries over

What the networks above read was chosen on train and val, and among {seen} only: two are trained on, the third
is judged, on motions that are not trained on. That a network is a SAT was not: of the left-out joints, SATs made
one worse there, and were kept because they are what this page is about. Small recurrent networks, which train in
seconds; RMSE in mrad before and after. `mirrored` and `blind` are [options](augmentation.md#one-network-for-all-joints)
made for this.

{choice}

{choice_words}
"""


def part(result: Mapping[str, Any]) -> str:
    """The part of the page that belongs to a result."""
    repeated = [name for name, runs in result["training"].items() if len(runs) > 1]
    return TEXT.format(
        seen=listed(JOINTS[joint] for joint in result["seen"]),
        unseen=listed(JOINTS[joint] for joint in result["unseen"]),
        count=len(result["motions"]),
        repeated=listed(f"`{name}`" for name in repeated) or "nothing",
        seeds=max(len(runs) for runs in result["training"].values()),
        errors=error_table(result),
        differences=difference_table(result),
        verdict=verdict(result),
        left=left_table(result),
        rungs=rung_table(result),
        choice=choice_table(result),
        choice_words=choice_words(result),
    )


def error_table(result: Mapping[str, Any]) -> str:
    """One row per way of saying where the arm is."""
    rows = []
    for name, about in ABOUT.items():
        own = result["errors"][name]["mae"]
        cells = []
        for key in JOINTS:
            mark = "" if name == SIMULATOR else MARKS[_difference(result, name, SIMULATOR, key)["verdict"]]
            cells.append(f"{_milli(float(np.mean(own[key])))}{mark}")
        rows.append([about, *cells])
    return table(["", *JOINTS.values()], rows)


def difference_table(result: Mapping[str, Any]) -> str:
    """MAE and RMSE of the wrist, and of all joints."""
    rows = []
    for name, about in ABOUT.items():
        if name == SIMULATOR:
            continue
        cells = [
            _interval(_difference(result, name, SIMULATOR, key, metric)["difference"])
            for key in ("unseen", "all")
            for metric in ("mae", "rmse")
        ]
        rows.append([about, *cells])
    return table(["", "wrist, MAE", "wrist, RMSE", "all five, MAE", "all five, RMSE"], rows)


def verdict(result: Mapping[str, Any]) -> str:
    """Whether the unseen servos improve, in words, with a sensor and without."""
    lines = []
    for name, how in (("sat", "Without a sensor"), ("sat-sensed", "With the encoder's last reading")):
        found = _difference(result, name, SIMULATOR, "unseen")
        change = f"{_interval(found['difference'])} mrad"
        lines.append(
            {
                "better": f"{how}, the wrist improves over the identified simulator beyond chance: {change}.",
                "worse": f"{how}, the wrist gets worse than the identified simulator: {change}.",
                "undecided": f"{how}, nothing is claimed of the wrist: {change} holds zero.",
            }[found["verdict"]]
        )
    held = _difference(result, "sat-sensed", HELD, "unseen")
    change = f"{_interval(held['difference'])} mrad"
    lines.append(
        "That is the reading more than the network: "
        + {
            "better": f"yet it leaves less than the last error held, without any network: {change}.",
            "worse": f"the last error held, without any network, leaves still less; the network leaves {change} more.",
            "undecided": f"between it and the last error held, without any network, nothing is decided: {change}.",
        }[held["verdict"]]
    )
    return "\n".join(lines)


def left_table(result: Mapping[str, Any]) -> str:
    """Shares of what the simulator leaves, joint by joint."""
    rows = [
        [JOINTS[joint], *(f"{100 * own[key]:.0f} %" for key in ("rest", "offset", "delay"))]
        for joint, own in result["left"].items()
    ]
    return table(["", "at rest", "one offset", "one delay"], rows)


def rung_table(result: Mapping[str, Any]) -> str:
    """The ladder, without the repetitions."""
    rows = [
        [f"`{name}`", _interval(item, sign=False)]
        for name, item in result["rungs"].items()
        if "." not in name.rpartition("+")[2]
    ]
    return table(["rung", "RMSE [mrad]"], rows)


def choice_table(result: Mapping[str, Any]) -> str:
    """What was read, and what it brought to the joint that was left out."""
    rows = [
        [
            name,
            *(" / ".join(_milli(value) for value in own["joints"][joint]) for joint in result["seen"]),
            f"{_interval(own['difference'])}{MARKS[own['verdict']]}",
        ]
        for name, own in result["choice"].items()
    ]
    return table(["reads", *(f"{JOINTS[joint]} left out" for joint in result["seen"]), "difference"], rows)


def choice_words(result: Mapping[str, Any]) -> str:
    """What the table says."""
    better = [name for name, own in result["choice"].items() if own["verdict"] == "better"]
    least = min(result["choice"], key=lambda name: result["choice"][name]["difference"]["value"])
    if better:
        return f"Beyond chance, this helps a joint that was left out: {listed(f'*{name}*' for name in better)}."
    return (
        f"Nothing of it helps a joint that was left out beyond chance; least harm is done by *{least}*. What\n"
        "identification leaves is of each servo by itself: where it stops within its dry friction. The simulator's\n"
        "torque does not carry over: position commands do not show its scale, and each joint has its own."
    )


def _difference(result: Mapping[str, Any], name: str, base: str, joints: str, metric: str = "mae") -> Mapping[str, Any]:
    found: Mapping[str, Any] = result["differences"][f"{name} - {base}"][metric][joints]
    return found


def _milli(value: float) -> str:
    return f"{1e3 * value:.2f}"


def _interval(item: Mapping[str, Any], *, sign: bool = True) -> str:
    places = "+.2f" if sign else ".2f"
    texts = [format(1e3 * item[key], places) for key in ("value", "low", "high")]
    return f"{texts[0]} [{texts[1]}, {texts[2]}]".replace("-", "\N{MINUS SIGN}")
