"""docs/learned-corrections.md, from what `python -m benchmarks augment` has measured."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.pages import augment_figure, augment_words
from benchmarks.pages.augment_bars import bar_table, bar_words, bars, least_cut
from benchmarks.pages.augment_cells import cut, factor, less, listed, milli, short, span
from benchmarks.pages.augment_data import (
    PRECISE,
    REAL_TIME,
    REALEASY_MSE,
    REALEASY_OTHER_UNIT_PERCENT,
    ROUGH_OF,
    TEST_NAMES,
    TESTS,
    THESIS_BAD,
    THESIS_GOOD,
    ZOO,
    ZOO_UNITS,
    Learned,
    joint_cuts,
)
from benchmarks.pages.markdown import table
from trueup.core.augment_result import ALL_JOINTS, AugmentResult, ModelEvaluation
from trueup.report.augment_words import against
from trueup.report.numbers import NOTHING, significant

OURS = (PRECISE, REAL_TIME)

TEXT = """# What learned corrections bring

The experiments of Realeasy (IV, V) and of the LSTM thesis (6), on the [papers' data set](panda.md): `realeasy` is the
precise network, `realeasy-rt` the one for a control loop, both with [our numbers](augmentation.md#training); `paper`
and `paper-rt` are the same with the papers'. The robot is a [virtual Panda](virtual-robot.md) whose physics the
simulator does not know{and_arm}. This page is made from what
`python -m benchmarks augment` measures (`make pages` writes it).

The bars were set before anything was trained. {bar_words}

{bar_table}

## How it was made

```sh
trueup record --robot panda --hardware lab --unit 1 --seed 1 --plan paper --out data/panda
trueup replay data/panda --robot panda
trueup replay data/panda --robot panda_rough --label mujoco/rough
trueup augment train data/panda --method moving-average --out models/moving-average
trueup augment train data/panda --method realeasy-rt --out models/realeasy-rt
trueup augment eval data/panda --model models/moving-average --model models/realeasy-rt --out runs/learned
python -m benchmarks augment    # everything on this page
```

850 motions of several joints and 870 of one joint are split 80/15/5 into train, val and test; 50 straight lines are
for test only. Test motions here: {motions}. Epochs, switched-off outputs and intervals come from val; nothing was
chosen by test.

Errors are pooled over samples, as in the papers. All intervals are 95 % over whole motions, and those of comparisons
are paired: the same motions are drawn for both ([how to read them](augmentation.md#reading-the-tables)). Every
network was trained once, so intervals say what other motions would change, not what another training would.

## Torque

Mean square error in Nm2, as Table II of Realeasy has it. Its rows are about a real Panda in Gazebo: the size of the
simulation's error is alike, the robot is not the same.

{torque}

How many times smaller the mean square error is than the simulation's, on motions of several joints:

{cuts_multi}

and on straight lines, which no network was trained on:

{cuts_lines}

`~`: the interval holds 1, nothing is claimed; **worse**: it lies below 1; –: no upper end, nothing may be left; off:
switched off by the training. `trueup augment eval` draws a typical motion of each test, like the thesis's Figures 11
and 13, into its report.

{average}

Torque, joints together, network against network on the same motions; `realeasy-rt` is compared with those baselines
only that run in a control loop, too:

{rivals}

## Position, velocity, and motions of one joint

The papers made positions and velocities no better, some worse, since torque dominated their loss. RMSE, each cell
simulation / `realeasy` / `realeasy-rt`:

{signals}

Position and velocity of every joint and test, counted; *least* is the smallest factor on the mean square error that
is not off. Where nothing changes, chance alone calls about one of 42 worse:

{verdicts}

{harms}

## Another unit

Other individuals of the same robot, other motions; all of them, since none was trained on. `realeasy` and
`realeasy-rt` know unit 1 only, `{zoo}` is trained on units {zoo_units}. Motions of each: {unit_motions}. Torque MSE,
percent less than the simulation's, joints together:

{units}

{units_words}

## A simulator with bad parameters

The thesis repeats its experiment with worse inertial parameters (6.4, Tables 2 and 4). Here `rough` and `rough-rt`
are trained and tested on `panda_rough`. Torque RMSE in Nm on motions of several joints:

{rough}

{rough_words}

## How much data, and which loss

`realeasy-rt` with as many training steps whatever the amount, so that only the data differ (thesis, Fig. 12);
*residual* learns what must be added to the simulation, *plain* the signal itself. Torque RMSE in Nm, joints together;
the factor is that of the mean square errors, above 1 if the residual loss leaves less. Both count errors in normalized
units, as in the thesis; in those of the simulator's own error, our default, a network that has to make positions anew,
to milliradians, learns little else:

{amounts}

![Torque error by number of train motions]({figure})

{amounts_words}

## Are the promises kept?

The intervals of a network are to cover {target} of all samples. Share of samples covered, by joint from least to
most, and on how many joints the interval of that share lies below the promise; then the warning "the simulator is far
off here" for torque, [how reliable it is](augmentation.md#can-the-network-be-trusted):

{promises}

{promises_words}

## Training

Seconds are those of trainings side by side, for orientation. *off*: outputs that the training switched off. What is
left on val is the mean over joints, in percent of the simulator's mean square error. What a step takes:
[networks in a control loop](runtime.md).

{training}

{training_words}
"""

ARM = """
## A real arm

The [SO-101](real-robots.md#so-101-a-hobby-arm-with-position-servos), on top of its identified simulator: what
identification has left is what the networks are to learn, from the same motions, and the {motions} test motions were
seen by neither.

{rungs}Position RMSE by joint in mrad, pooled over samples, and how many times smaller its square is:

{table}

{claims}
"""


def page(result: Mapping[str, Any]) -> str:
    """The page as Markdown."""
    return page_of(Learned.of(result))


def page_of(data: Learned) -> str:
    """The page of a result that is read."""
    found = bars(data)
    words = augment_words
    text = TEXT.format(
        and_arm="" if data.arm is None else ", and in the last section a [real arm](#a-real-arm)",
        bar_words=bar_words(found),
        bar_table=bar_table(found),
        motions=_motions(data.lab),
        torque=torque_table(data.lab),
        cuts_multi=cut_table(data.lab, "multi-joint"),
        cuts_lines=cut_table(data.lab, "cartesian"),
        average=words.average(data.lab),
        rivals=words.rivals(data.lab),
        signals=signal_table(data.lab),
        verdicts=verdict_table(data.lab),
        harms=words.harms(data.lab),
        zoo=ZOO,
        zoo_units=listed(map(str, ZOO_UNITS)),
        unit_motions="; ".join(f"unit {unit}, {_motions(item)}" for unit, item in data.others.items()),
        units=unit_table(data),
        units_words=words.units(data),
        rough=rough_table(data),
        rough_words=words.rough(data),
        amounts=amount_table(data),
        figure=augment_figure.NAME,
        amounts_words=words.losses(data.amounts),
        target=f"{100 * data.lab.model(PRECISE).coverage_target:.0f} %",
        promises=promise_table(data),
        promises_words=words.promises(data),
        training=training_table(data),
        training_words=words.training(data),
    )
    return text + (_arm(data, data.arm) if data.arm is not None else "")


def _motions(result: AugmentResult) -> str:
    return ", ".join(f"{result.motions[test]} of {TEST_NAMES[test]}" for test in TESTS)


def figures(result: Mapping[str, Any]) -> dict[str, str]:
    """File in docs/ -> its content."""
    amounts = AugmentResult.from_json(result["amounts"])
    return {augment_figure.NAME: augment_figure.figure(amounts)}


def torque_table(lab: AugmentResult) -> str:
    """Realeasy's Table II, theirs and ours."""
    rows = []
    for test, (before, after) in REALEASY_MSE.items():
        name = TEST_NAMES[test]
        own = [lab.simulated[test]["torque"][joint].mse.value for joint in lab.joints]
        rows.append((f"{name}: simulation", *map(significant, own)))
        for model in OURS:
            left = [item.mse.value for item in joint_cuts(lab, model, test, "torque").values()]
            rows.append((f"{name}: `{model}`", *map(significant, left)))
        rows.append((f"{name}: simulation, Realeasy", *map(significant, before)))
        rows.append((f"{name}: corrected, Realeasy", *map(significant, after)))
    return table(("", *lab.joints), rows)


def cut_table(lab: AugmentResult, test: str) -> str:
    """Every method, and what the paper says of itself."""
    rows = [(f"`{model.name}`", *_cuts(lab, model, test, "torque")) for model in lab.models]
    before, after = REALEASY_MSE[test]
    rows.append(("Realeasy, Table II", *(short(old / new) for old, new in zip(before, after, strict=True))))
    return table(("torque", *lab.joints), rows)


def _cuts(result: AugmentResult, model: ModelEvaluation, test: str, signal: str) -> list[str]:
    cuts = joint_cuts(result, model.name, test, signal)
    return [cut(item, off=model.is_off(signal, joint)) for joint, item in cuts.items()]


def signal_table(lab: AugmentResult) -> str:
    """Simulation, precise and real-time in one cell."""
    rows = []
    for signal, unit in (("position", "mrad"), ("velocity", "mrad/s"), ("torque", "Nm")):
        for test in TESTS if signal != "torque" else ("single-joint",):
            own = [joint_cuts(lab, model, test, signal) for model in OURS]
            shown = significant if signal == "torque" else milli
            cells = []
            for joint in lab.scored_joints:
                left = [f"{shown(cuts[joint].rmse.value)}{_worse(cuts[joint].verdict)}" for cuts in own]
                cells.append(" / ".join([shown(lab.simulated[test][signal][joint].rmse.value), *left]))
            rows.append((f"{signal} [{unit}], {TEST_NAMES[test]}", *cells))
    return table(("", *lab.scored_joints), rows)


def _worse(verdict: str) -> str:
    return " **worse**" if verdict == "worse" else ""


def verdict_table(lab: AugmentResult) -> str:
    """How often each method helps and harms where the papers' did not help."""
    rows = []
    for model in lab.models:
        kinds = {"better": 0, "undecided": 0, "off": 0, "worse": 0}
        on = {}
        for test in TESTS:
            for signal in ("position", "velocity"):
                cuts = joint_cuts(lab, model.name, test, signal)
                for joint, item in cuts.items():
                    kinds["off" if model.is_off(signal, joint) else item.verdict] += 1
                on.update(
                    {f"{test} {signal} {joint}": cuts[joint] for joint in cuts if not model.is_off(signal, joint)}
                )
        lowest = factor((least := least_cut(on)[1]).factor, least.verdict) if on else NOTHING
        worse = f"**{kinds['worse']}**" if kinds["worse"] else "0"
        counts = [str(kinds[kind]) for kind in ("better", "undecided", "off")]
        rows.append((f"`{model.name}`", *counts, worse, lowest))
    return table(("", "better", "undecided", "off", "worse", "least"), rows)


def unit_table(data: Learned) -> str:
    """The known unit and the others, by test, and the joint on which least is gained."""
    groups = [("1, test", data.lab, OURS), *((unit, item, (*OURS, ZOO)) for unit, item in data.others.items())]
    rows = []
    for unit, result, models in groups:
        for model in models:
            cuts = [result.model(model).cuts[test]["torque"][ALL_JOINTS] for test in (*TESTS, "")]
            joint, least = least_cut(joint_cuts(result, model, "", "torque"))
            last = f"x{factor(least.factor, least.verdict)} on {joint}"
            rows.append((f"unit {unit}: `{model}`", *map(less, cuts), last))
    rows.append(("another unit, Realeasy", "", "", f"{REALEASY_OTHER_UNIT_PERCENT}", "", ""))
    return table(("", *(TEST_NAMES[test] for test in (*TESTS, "")), "least cut of a joint, all"), rows)


def rough_table(data: Learned) -> str:
    """Good and bad parameters, here and in the thesis."""
    rows = []
    names = [(data.lab, {model: model for model in OURS}), (data.rough, ROUGH_OF)]
    for result, models in names:
        simulated = result.simulated["multi-joint"]["torque"]
        own = [simulated[joint].rmse.value for joint in result.joints]
        rows.append((f"`{result.run}`: simulation", *map(significant, own)))
        for model in models.values():
            left = [item.rmse.value for item in joint_cuts(result, model, "multi-joint", "torque").values()]
            rows.append((f"`{result.run}`: `{model}`", *map(significant, left)))
    for name, pair in (("good", THESIS_GOOD), ("bad", THESIS_BAD)):
        rows += [
            (f"thesis, {name}: {what}", *map(significant, values))
            for what, values in zip(("simulation", "corrected"), pair, strict=True)
        ]
    return table(("", *data.lab.joints), rows)


def amount_table(data: Learned) -> str:
    """Both losses by number of motions."""
    heads, rows = ["motions"], []
    for test in ("multi-joint", "cartesian"):
        heads += [f"{TEST_NAMES[test]}: residual", "plain", "factor"]
    for count in data.counts:
        cells = []
        for test in ("multi-joint", "cartesian"):
            models = [f"amount-{count}-{target}" for target in ("residual", "plain")]
            own = [data.amounts.model(model).cuts[test]["torque"][ALL_JOINTS] for model in models]
            cells += [significant(item.rmse.value) for item in own]
            found, verdict = against(data.amounts, *models, test, "torque")
            cells.append(NOTHING if found is None else factor(found, verdict))
        rows.append((str(count), *cells))
    return table(heads, rows)


def promise_table(data: Learned) -> str:
    """Coverage of all signals, reliability of warnings about torque."""
    groups = [("", data.lab, TESTS), *((f"unit {unit}, ", item, ("",)) for unit, item in data.others.items())]
    rows = []
    for where, result, tests in groups:
        for model in OURS if not where else (*OURS, ZOO):
            for test in tests:
                cells = [_covered(result, model, test, signal) for signal in ("position", "velocity", "torque")]
                rows.append((f"`{model}`, {where}{TEST_NAMES[test]}", *cells, *_reliability(result, model, test)))
    return table(("", "position", "velocity", "torque", "far off", "calibration error", "skill"), rows)


def _covered(result: AugmentResult, model: str, test: str, signal: str) -> str:
    joints = result.model(model).coverage.get(test, {}).get(signal, {})
    shares = [joints[joint].share.value for joint in result.scored_joints if joint in joints]
    if not shares:
        return NOTHING
    below = augment_words.below_promise(result, model, test)[signal]
    return span(shares) + (f"; **{len(below)} below**" if below else "")


def _reliability(result: AugmentResult, model: str, test: str) -> tuple[str, str, str]:
    found = result.model(model).reliability.get(test, {}).get("torque")
    if found is None:
        return NOTHING, NOTHING, NOTHING
    skill = NOTHING if found.skill is None else f"{found.skill:.2f}"
    return f"{100 * found.far:.1f} %", f"{found.error:.3f}", skill


def training_table(data: Learned) -> str:
    """One row per model; those of the amounts of data have their own section."""
    rows = []
    for name, item in data.training.items():
        if not name.startswith("amount-"):
            left = [augment_words.val_left(item, signal) for signal in ("position", "velocity", "torque")]
            epochs = f"{item['epochs']} ({item['best_epoch']})" if item["epochs"] else NOTHING
            numbers = (epochs, f"{item['seconds']:.0f}", str(item["warmup_steps"]), str(len(item["off"])))
            rows.append((f"`{name}`", *numbers, *map(short, left)))
    heads = ("", "epochs (best)", "s", "warm-up steps", "off", "val: position", "velocity", "torque")
    return table(heads, rows)


def _arm(data: Learned, arm: AugmentResult) -> str:
    return ARM.format(
        motions=arm.motions[""],
        rungs=_rungs(data),
        table=arm_table(arm),
        claims=augment_words.claims(arm),
    )


def _rungs(data: Learned) -> str:
    """Means over motions, which the bars are about."""
    if not data.arm_rungs:
        return ""
    rows = []
    for name, metric in data.arm_rungs.items():
        total = metric.total
        ends = "" if total.low is None or total.high is None else f" [{total.low:.5f}, {total.high:.5f}]"
        rows.append((f"`{name}`", f"{total.value:.5f}{ends}"))
    text = table(("", "position RMSE, test [rad], mean over motions"), rows)
    return f"{text}\n\n{augment_words.arm_bars(data)}\n\n"


def arm_table(arm: AugmentResult) -> str:
    """By joint, and joints together."""
    joints = [joint for joint in (*arm.scored_joints, ALL_JOINTS) if joint in arm.simulated[""]["position"]]
    rows = [(f"`{arm.run}`", *(milli(arm.simulated[""]["position"][joint].rmse.value) for joint in joints))]
    for model in arm.models:
        cuts = model.cuts[""]["position"]
        rows.append((f"`{model.name}`", *(milli(cuts[joint].rmse.value) for joint in joints)))
        factors = [cut(cuts[joint], off=model.is_off("position", joint)) for joint in joints]
        rows.append((f"`{model.name}`, times smaller", *factors))
    return table(("", *(joint or "all joints" for joint in joints)), rows)
