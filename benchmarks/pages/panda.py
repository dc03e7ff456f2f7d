"""docs/panda.md, from what `python -m benchmarks panda` has measured."""

from collections.abc import Mapping, Sequence
from math import sqrt
from typing import Any

from benchmarks.pages.markdown import table

GOOD, DART, ROUGH, COMMAND = "mujoco/stock", "dart/stock", "mujoco/rough", "command"
JOINTS = tuple(f"joint {number}" for number in range(1, 8))
# Realeasy, Table II, multi-joint motions, simulation against robot [Nm2].
TABLE_II = (36.4, 25.2, 24.2, 19.6, 12.3, 7.17, 7.15)

TEXT = """# The papers' data set

A tenth of the data set of Realeasy and the LSTM thesis, on a [virtual Panda](virtual-robot.md): {motions}. This page is
made from what `python -m benchmarks panda` measures (`make pages` writes it);
[what learned corrections bring](learned-corrections.md) on all of its motions has its own. By hand:

```sh
trueup record --robot panda --hardware lab --unit 1 --plan paper --scale 0.1 --out data/panda
trueup replay data/panda --robot panda
trueup replay data/panda --robot panda --engine dart
trueup replay data/panda --robot panda_rough --label mujoco/rough
trueup gap data/panda --runs mujoco/stock,dart/stock,mujoco/rough --out runs/panda
```

## How far the twins are from the robot

Torque, mean square error in Nm2, by joint. The twin `panda` is driven as Gazebo drove the papers': by a stiff, poorly
damped PID on effort; its gains were chosen on units 1 and 2 so that errors have this size.

{torque}

Most of it is the twin's own oscillation. Averaged over half a second, RMSE in Nm; what is left is what the model does
not know of the robot, and more of it where inertial parameters are rough:

{averaged}

Positions and velocities on the motions of several joints, RMSE by joint. The LSTM thesis (Table 2) found up to 0.068
rad and 0.0927 rad/s.

{motion}

## What a payload changes

{payload_motions} motions, each with 0, 1, 2 and 3 kg, compared with themselves. Change per kilogram of the mean of the
joints, 95 % interval. A lag is how late the robot is, in s; it is negative where the twin is later than the robot:

{trends}

Torques are wrong by what the payload weighs, since no model knows of it. Positions of the twin hardly change: the
robot's own controller carries most of a payload, and the twin's sag is larger than the rest. The robot itself follows
its command less well and later, as the rows of the command say (GapONet, 3.3: larger gaps and longer delays).
"""


def page(result: Mapping[str, Any]) -> str:
    """The page as Markdown."""
    runs = result["runs"]
    motions = ", ".join(f"{count} {group} motions" for group, count in result["motions"].items())
    return TEXT.format(
        motions=motions,
        torque=_torque(runs, result["unseen"]),
        averaged=_rows({_who(run): _rmse(runs[run]["multi-joint"]["torque"]["averaged_mse"]) for run in runs}),
        motion=_motion(runs),
        payload_motions=result["payload_motions"],
        trends=_trends(result["trends"]),
    )


def _torque(runs: Mapping[str, Any], unseen: Sequence[Mapping[str, Any]]) -> str:
    rows = {}
    for run, groups in runs.items():
        for group, signals in groups.items():
            if run == GOOD or group == "multi-joint":
                rows[f"{_who(run)}, {group}"] = signals["torque"]["mse"]
    for part in unseen:
        who = f"`panda`, multi-joint, unit {part['unit']}, other motions"
        rows[who] = part["groups"]["multi-joint"]["torque"]["mse"]
    return _rows({**rows, "Realeasy, Table II, multi-joint": TABLE_II})


def _motion(runs: Mapping[str, Any]) -> str:
    return _rows(
        {
            f"{_who(run)}, {signal} [{unit}]": _rmse(runs[run]["multi-joint"][signal]["mse"])
            for signal, unit in (("position", "rad"), ("velocity", "rad/s"))
            for run in runs
        }
    )


def _trends(trends: Mapping[str, Any]) -> str:
    rows = []
    for run in (GOOD, DART, COMMAND):
        for signal, metrics in trends[run].items():
            for metric, item in metrics.items():
                what = f"{signal}, {'RMSE' if metric == 'rmse' else 'lag'}"
                interval = f"{item['value']:+.3g} [{item['low']:+.3g}, {item['high']:+.3g}] {item['unit']}"
                rows.append((_who(run), what, f"{item['at_zero']:.3g}", interval, item["verdict"]))
    return table(("", "of", "without payload", "per kg", "with the payload it"), rows)


def _who(run: str) -> str:
    names = {GOOD: "`panda`, MuJoCo", DART: "`panda`, DART", ROUGH: "`panda_rough`, MuJoCo", COMMAND: "the command"}
    return names[run]


def _rmse(mse: Sequence[float]) -> list[float]:
    return [sqrt(value) for value in mse]


def _rows(rows: Mapping[str, Sequence[float]]) -> str:
    return table(("", *JOINTS), [(who, *(f"{value:.3g}" for value in values)) for who, values in rows.items()])
