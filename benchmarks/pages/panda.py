"""docs/panda.md, from what `python -m benchmarks panda` has measured."""

from collections.abc import Mapping, Sequence
from math import sqrt
from typing import Any

from benchmarks.pages.markdown import table

GOOD, DART, ROUGH, COMMAND = "mujoco/stock", "dart/stock", "mujoco/rough", "command"
JOINTS = tuple(map(str, range(1, 8)))
# Realeasy, Table II, multi-joint motions, simulation against robot [Nm2].
TABLE_II = (36.4, 25.2, 24.2, 19.6, 12.3, 7.17, 7.15)

TEXT = """# The papers' data set

A tenth of the data set of Realeasy and the LSTM thesis on a [virtual Panda](virtual-robot.md):
{motions}. [What learned corrections bring](learned-corrections.md) uses all of it.

```sh
trueup record --robot panda --hardware lab --unit 1 --plan paper --scale 0.1 --out data/panda
trueup replay data/panda --robot panda
trueup replay data/panda --robot panda --engine dart
trueup replay data/panda --robot panda_rough --label mujoco/rough
trueup gap data/panda --runs mujoco/stock,dart/stock,mujoco/rough --out runs/panda
```

`python -m benchmarks panda` measures all of this.

## Gap of the simulated twins

Torque, mean square error in Nm2, by joint. The twin `panda` has the controller that Gazebo had in the papers, a stiff,
poorly damped PID on effort. Its gains were chosen on units 1 and 2 for errors of the papers' size; units 5 and 6 are
held out.

{torque}

Most of it is the twin's own oscillation. The average over 0.5 s leaves what the model does not know of the
robot. RMSE on multi-joint motions, range over the joints (the LSTM thesis, Table 2, reports up to 0.068 rad and 0.0927
rad/s):

{motion}

## What a payload changes

{payload_motions} motions, each with 0, 1, 2 and 3 kg: change of the mean over joints, 95 % interval. Lag is how late
the robot is; it is negative where the twin is later.{dart}

{trends}

Torque errors grow with the payload, which no model knows. The twin's position error hardly changes: the robot's own
controller carries most of a payload. The robot itself follows its command less precisely and later, as in GapONet
(3.3).
"""


def page(result: Mapping[str, Any]) -> str:
    """The page as Markdown."""
    runs = result["runs"]
    motions = ", ".join(f"{count} {group}" for group, count in result["motions"].items()) + " motions"
    return TEXT.format(
        motions=motions,
        torque=_torque(runs, result["unseen"]),
        motion=_motion(runs),
        payload_motions=result["payload_motions"],
        trends=_trends(result["trends"]),
        dart=" DART gives the same verdicts." if _verdicts(result, DART) == _verdicts(result, GOOD) else "",
    )


def _torque(runs: Mapping[str, Any], unseen: Sequence[Mapping[str, Any]]) -> str:
    rows = {}
    for run, groups in runs.items():
        for group, signals in groups.items():
            if run == GOOD or group == "multi-joint":
                rows[f"{_who(run)}, {group}"] = signals["torque"]["mse"]
    for part in unseen:
        who = f"`panda`, multi-joint, unit {part['unit']}"
        rows[who] = part["groups"]["multi-joint"]["torque"]["mse"]
    return _rows({**rows, "Realeasy, Table II, multi-joint": TABLE_II})


def _motion(runs: Mapping[str, Any]) -> str:
    rows = []
    for run in runs:
        ranges = []
        for signal, mse in (("torque", "averaged_mse"), ("position", "mse"), ("velocity", "mse")):
            ends = sorted(sqrt(value) for value in runs[run]["multi-joint"][signal][mse])
            ranges.append(f"{ends[0]:.3g} to {ends[-1]:.3g}")
        rows.append((_who(run), *ranges))
    return table(("", "torque, averaged [Nm]", "position [rad]", "velocity [rad/s]"), rows)


def _trends(trends: Mapping[str, Any]) -> str:
    rows = []
    for run in (GOOD, COMMAND):
        for signal, metrics in trends[run].items():
            for metric, item in metrics.items():
                unit = item["unit"].removesuffix("/kg")
                what = f"{_who(run)}: {signal}, {'RMSE' if metric == 'rmse' else 'lag'} [{unit}]"
                interval = f"{item['value']:+.3g} [{item['low']:+.3g}, {item['high']:+.3g}]"
                rows.append((what, f"{item['at_zero']:.3g}", interval, item["verdict"]))
    return table(("", "without payload", "per kg", "verdict"), rows)


def _verdicts(result: Mapping[str, Any], run: str) -> list[str]:
    return [item["verdict"] for metrics in result["trends"][run].values() for item in metrics.values()]


def _who(run: str) -> str:
    names = {GOOD: "`panda`, MuJoCo", DART: "`panda`, DART", ROUGH: "`panda_rough`, MuJoCo", COMMAND: "the command"}
    return names[run]


def _rows(rows: Mapping[str, Sequence[float]]) -> str:
    return table(("joint", *JOINTS), [(who, *(f"{value:.3g}" for value in values)) for who, values in rows.items()])
