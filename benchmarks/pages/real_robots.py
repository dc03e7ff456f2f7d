"""docs/real-robots.md, from what `python -m benchmarks real_robots` has measured."""

from collections.abc import Mapping
from math import degrees
from typing import Any

from benchmarks.pages.markdown import table

STOCK, FITTED = "mujoco/stock", "mujoco/fitted"
SO101_JOINTS = {
    "shoulder_pan": "pan",
    "shoulder_lift": "lift",
    "elbow_flex": "elbow",
    "wrist_flex": "wrist flex",
    "wrist_roll": "wrist roll",
}

TEXT = """# Real robots

Two recordings that others have published, identified by `trueup identify` without any configuration. This page is made
from what `python -m benchmarks real_robots` measures (`make pages` writes it); {threads} threads.

## SO-101: a hobby arm with position servos

43 motions of an arm with five joints and a gripper, recorded with SAGE ([where to get logs, model and
split](first-hour.md#the-recording)). Errors are the RMSE of positions over whole motions, open loop from the first
measured pose, mean over joints 1 to 5 and over motions. 33 motions are fitted, 4 choose the model, 6 test it.

```sh
trueup import logs/so101_sage --out data/so101
trueup identify data/so101 --robot so101 --out runs/so101
```

{so101}

{so101_models}

`*` was chosen, by val. The command took {so101_seconds:.0f} s. What it says of itself: status `{so101_status}`; of
{so101_count} parameters the motions determine {yes}, {weakly} weakly, {no} not. So the *motion* is right; many of the
numbers rest on what was believed before.

### Which part does friction have?

Nine friction models on the same drive (delay, gain, armature, offset, link masses), each fitted from the same start.
*Soft* is how MuJoCo holds dry friction by default; *hard* is how `identify` does it
([why](friction.md#why-mujocos-friction-creeps)). RMSE in mrad, joint by joint on test.

{friction}

{friction_words}

## Double pendulum: quasi-direct drives, torque-controlled

Seven recordings of 6 to 10 s of a planar double pendulum of the DFKI, 500 Hz, with the numbers that its makers have
identified. They are in
[dfki-ric-underactuated-lab/double_pendulum](https://github.com/dfki-ric-underactuated-lab/double_pendulum)
(BSD-3-Clause), commit `1e8544e67f`: `trajectory_00` to `03` and `11` to `13` of
`data/experiment_records/design_A.0/20220815/sys_id`. The model, `double_pendulum_A0.xml`, is not: it is an MJCF that
was written from the numbers in `data/system_identification/identified_parameters/design_A.0/model_2.0`, two hanging
links on hinges `joint1` and `joint2` with a torque motor each. It lies in the folder `model` beside the recordings, and
a `split.json` has the splits below.

The motion is chaotic, so it is compared over windows of 0.5 s that start from the measured state. Four recordings are
fitted, one chooses, two test.

```sh
trueup import logs/dfki_double_pendulum_A0 --out data/pendulum
trueup identify data/pendulum --robot double_pendulum --out runs/pendulum
```

{pendulum}

{pendulum_models}

By recording, RMSE of joint 1 and joint 2 [deg]:

{pendulum_files}

The command took {pendulum_seconds:.0f} s; status `{pendulum_status}`. Each recording has zeros of its own for its
incremental encoders. Those of the train motions are estimated, to keep them out of the other numbers; test motions are
compared as they come.
"""


def page(result: Mapping[str, Any]) -> str:
    """The page that belongs to a result."""
    arm, pendulum = result["so101"], result["double_pendulum"]
    return TEXT.format(
        threads=result["provenance"]["config"]["threads"],
        so101=run_table(arm["runs"], "rad", lambda value: f"{value:.5f}"),
        so101_models=model_table(arm["models"], "rad", lambda value: f"{value:.5f}"),
        so101_seconds=arm["seconds"],
        so101_status=arm["status"],
        so101_count=sum(arm["counts"].values()),
        **arm["counts"],
        friction=friction_table(result),
        friction_words=friction_words(result["friction"]),
        pendulum=run_table(pendulum["runs"], "deg", lambda value: f"{degrees(value):.2f}"),
        pendulum_models=model_table(pendulum["models"], "deg", lambda value: f"{degrees(value):.2f}"),
        pendulum_files=file_table(pendulum["episodes"]),
        pendulum_seconds=pendulum["seconds"],
        pendulum_status=pendulum["status"],
    )


def run_table(runs: Mapping[str, Any], unit: str, shown: Any) -> str:
    """Stock against fitted, on every split."""
    rows = []
    for label, splits in runs.items():
        cells = []
        for split in ("train", "val", "test"):
            item = splits[split]
            ends = "" if item["low"] is None else f" [{shown(item['low'])}, {shown(item['high'])}]"
            cells.append(shown(item["value"]) + ends)
        less = 1 - splits["test"]["value"] / runs[STOCK]["test"]["value"]
        rows.append([f"`{label}`", *cells, "" if label == STOCK else f"{100 * less:.1f} %"])
    return table(["run", *(f"{split} [{unit}]" for split in ("train", "val", "test")), "less, test"], rows)


def model_table(models: list[Mapping[str, Any]], unit: str, shown: Any) -> str:
    """The models that the default tried."""
    rows = [
        [
            row["name"] + (" *" if row["chosen"] else ""),
            str(row["parameters"]),
            *(shown(row["splits"][split]["value"]) for split in ("train", "val", "test")),
            f"{row['seconds']:.0f}",
        ]
        for row in models
    ]
    return table(["model", "parameters", *(f"{split} [{unit}]" for split in ("train", "val", "test")), "s"], rows)


def friction_table(result: Mapping[str, Any]) -> str:
    """One row per friction model; the stock model above."""
    stock = result["so101"]["runs"][STOCK]
    rows = [
        [
            "stock model, nothing fitted",
            "0",
            *(f"{1e3 * stock[split]['value']:.2f}" for split in ("train", "val", "test")),
            *(f"{1e3 * stock['test']['per_joint'][joint]['value']:.1f}" for joint in SO101_JOINTS),
        ]
    ]
    rows += [
        [
            row["name"],
            str(row["parameters"]),
            *(f"{1e3 * row['splits'][split]['value']:.2f}" for split in ("train", "val", "test")),
            *(f"{1e3 * row['per_joint']['test'][joint]:.1f}" for joint in SO101_JOINTS),
        ]
        for row in result["friction"]
    ]
    return table(["friction", "parameters", "train", "val", "test", *SO101_JOINTS.values()], rows)


def friction_words(rows: list[Mapping[str, Any]]) -> str:
    """What the table says, in words, from its own numbers."""
    own = {row["name"]: row for row in rows}

    def value(name: str, split: str) -> float:
        return 1e3 * float(own[name]["splits"][split]["value"])

    soft, hard = "viscous, Coulomb, soft", "viscous, Coulomb, hard"
    lift = [1e3 * own[name]["per_joint"]["test"]["shoulder_lift"] for name in (soft, hard)]
    elbow = [1e3 * own[name]["per_joint"]["test"]["elbow_flex"] for name in (soft, hard)]
    best = min(own, key=lambda name: value(name, "val"))
    return (
        f"On val, viscous friction alone leaves {value('viscous', 'val'):.1f} mrad, Coulomb friction that creeps\n"
        f"{value(soft, 'val'):.1f}, Coulomb friction that holds {value(hard, 'val'):.1f}. On test, holding changes\n"
        f"lift from {lift[0]:.1f} to {lift[1]:.1f} mrad and elbow from {elbow[0]:.1f} to {elbow[1]:.1f}: the joints\n"
        "that carry weight, whose standing errors are stiction under gravity.\n"
        f"Best on val: *{best}*, {value(best, 'val'):.2f} mrad."
    )


def file_table(episodes: Mapping[str, Any]) -> str:
    """Each recording before and after."""
    rows = []
    for name, own in episodes.items():
        cells = [" / ".join(f"{degrees(value):.1f}" for value in own[label].values()) for label in (STOCK, FITTED)]
        rows.append([name, own["split"], *cells])
    return table(["recording", "split", "stock", "fitted"], rows)
