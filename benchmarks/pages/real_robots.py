"""docs/real-robots.md, from what `python -m benchmarks real_robots` has measured."""

from collections.abc import Mapping
from math import degrees
from typing import Any

from benchmarks.pages.markdown import table

STOCK, FITTED = "mujoco/stock", "mujoco/fitted"
# Joints that carry weight.
LOADED_JOINTS = {"shoulder_lift": "lift", "elbow_flex": "elbow"}

TEXT = """# Real robots

`trueup identify` without any configuration on two published recordings, {threads} threads. Brackets are 95 % intervals.

```sh
python -m benchmarks real_robots
```

## SO-101: a hobby arm with position servos

43 motions of a five-joint arm with a gripper, recorded with SAGE ([where to get logs, model and
split](first-hour.md#the-recording)): 33 are fitted, 4 choose the model, 6 test it. The error is the position RMSE over
whole motions from the first measured pose, mean over joints 1 to 5 and motions.

```sh
trueup import logs/so101_sage --out data/so101
trueup identify data/so101 --robot so101 --out runs/so101
```

{so101}

{so101_models}

`*` was chosen by val. The command took {so101_seconds:.0f} s. Status `{so101_status}`: of {so101_count}
parameters the motions determine {yes}, {weakly} weakly, {no} not. The motion is right; many values rest on their
priors.

### The role of friction

Nine friction models on the same drive (delay, gain, armature, offset, link masses), fitted from the same start. *Soft*
is MuJoCo's default dry friction; *hard* is what `identify` uses ([why](friction.md#why-mujocos-friction-creeps)). RMSE
in mrad, the joints on test.

{friction}

{friction_words}

## Double pendulum: quasi-direct drives, torque-controlled

Seven recordings of 6 to 10 s at 500 Hz, from DFKI's
[dfki-ric-underactuated-lab/double_pendulum](https://github.com/dfki-ric-underactuated-lab/double_pendulum)
(BSD-3-Clause), commit `1e8544e67f`: `trajectory_00` to `03` and `11` to `13` of
`data/experiment_records/design_A.0/20220815/sys_id`. The model is not in that repository:
`model/double_pendulum_A0.xml` is an MJCF with the values of
`data/system_identification/identified_parameters/design_A.0/model_2.0`, two hanging links on hinges `joint1` and
`joint2` with a torque motor each. `split.json` has the splits: four recordings are fitted, one chooses, two test. The
motion is chaotic, so errors are over windows of 0.5 s from the measured state.

```sh
trueup import logs/dfki_double_pendulum_A0 --out data/pendulum
trueup identify data/pendulum --robot double_pendulum --out runs/pendulum
```

{pendulum}

{pendulum_models}

RMSE of joint 1 and joint 2 [deg] by recording that was not fitted:

{pendulum_files}

The command took {pendulum_seconds:.0f} s; status `{pendulum_status}`. The incremental encoders have a different zero in
each recording. Zeros of train motions are estimated; test motions are compared as they are.
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
        ]
        for row in models
    ]
    return table(["model", "parameters", *(f"{split} [{unit}]" for split in ("train", "val", "test"))], rows)


def friction_table(result: Mapping[str, Any]) -> str:
    """One row per friction model; the stock model above."""
    stock = result["so101"]["runs"][STOCK]
    joints = {name: own["value"] for name, own in stock["test"]["per_joint"].items()}
    rows = [_friction_row("stock model, nothing fitted", 0, stock, joints)]
    rows += [
        _friction_row(row["name"], row["parameters"], row["splits"], row["per_joint"]["test"])
        for row in result["friction"]
    ]
    return table(["friction", "parameters", "val", "test", *LOADED_JOINTS.values()], rows)


def _friction_row(name: str, count: int, splits: Mapping[str, Any], joints: Mapping[str, float]) -> list[str]:
    errors = (f"{1e3 * splits[split]['value']:.2f}" for split in ("val", "test"))
    return [name, str(count), *errors, *(f"{1e3 * joints[joint]:.1f}" for joint in LOADED_JOINTS)]


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
        f"Hard Coulomb friction changes lift from {lift[0]:.1f} to {lift[1]:.1f} mrad and elbow from\n"
        f"{elbow[0]:.1f} to {elbow[1]:.1f}: these joints carry weight, and their standing errors are stiction under\n"
        f"gravity. Best on val: *{best}*, {value(best, 'val'):.2f} mrad."
    )


def file_table(episodes: Mapping[str, Any]) -> str:
    """Each recording that was not fitted, before and after."""
    rows = []
    for name, own in episodes.items():
        if own["split"] == "train":
            continue
        cells = [" / ".join(f"{degrees(value):.1f}" for value in own[label].values()) for label in (STOCK, FITTED)]
        rows.append([name, own["split"], *cells])
    return table(["recording", "split", "stock", "fitted"], rows)
