"""docs/learned-corrections.md, from what `python -m benchmarks augment` has measured."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from benchmarks.pages import augment_figure, augment_words
from benchmarks.pages.augment_bars import bar_table, bar_words, bars, least_cut
from benchmarks.pages.augment_cells import cut, factor, less, listed, milli
from benchmarks.pages.augment_data import (
    PRECISE,
    REAL_TIME,
    REALEASY_MSE,
    REALEASY_OTHER_UNIT_PERCENT,
    TEST_NAMES,
    TESTS,
    ZOO,
    ZOO_UNITS,
    Learned,
    joint_cuts,
)
from benchmarks.pages.markdown import table
from trueup.core.augment_result import ALL_JOINTS, AugmentResult
from trueup.report.augment_words import against
from trueup.report.numbers import NOTHING, significant

OURS = (PRECISE, REAL_TIME)

TEXT = """# What learned corrections bring

A network learns the error of a simulator on a [virtual Panda](virtual-robot.md) whose physics the simulator does not
know{and_arm}. This note repeats the experiments of Realeasy (IV, V) and of the LSTM thesis (6) on the
[papers' data set](panda.md). `realeasy` sees the whole motion, `realeasy-rt` runs in a control loop; `paper` and
`paper-rt` are the same networks with the papers' hyperparameters.

The bars were set before anything was trained. {bar_words} How many times smaller the mean square error (MSE) is than
the simulation's, on the joint with the least gain:

{bar_table}

## How it was made

```sh
trueup record --robot panda --hardware lab --unit 1 --seed 1 --plan paper --out data/panda
trueup replay data/panda --robot panda
trueup augment train data/panda --method realeasy-rt --out models/realeasy-rt
trueup augment eval data/panda --model models/realeasy-rt --out runs/learned
python -m benchmarks augment    # everything on this page
```

850 motions of several joints and 870 of one joint are split 80/15/5 into train, val and test; 50 straight lines are
only for test. Test motions: {motions}. Intervals are 95 % over whole motions, comparisons are paired
([how to read them](augmentation.md#reading-the-tables)). Each network was trained once, so intervals do not include the
variation between trainings.

## Torque

MSE in Nm2, range over the joints, beside Table II of Realeasy (real Panda, Gazebo):

{torque}

MSE of the simulation over that of each method. No network was trained on straight lines. `~`: the interval contains 1;
off: switched off by the training. {average}

{cuts}

The same factor between networks, above 1 if the first is better; `realeasy-rt` only meets baselines that run in a
control loop:

{rivals}

{training_words}

## Position and velocity

The papers' networks did not improve positions and velocities, since torque dominated their loss. RMSE, range over the
joints:

{signals}

{verdicts}

{harms}

## Another unit

`realeasy` and `realeasy-rt` know unit 1 only; `{zoo}` is trained on units {zoo_units}. Reduction
of the torque MSE on all motions of other units, joints together, in percent (Realeasy: {other_percent} % on a part of
the lines), and how many times smaller the MSE of `{zoo}` is than that of `realeasy-rt`:

{units}

## A simulator with bad parameters

`rough` and `rough-rt` are trained and tested on `panda_rough`, a simulator with worse inertial parameters. Torque
RMSE on motions of several joints, by joint: {rough}

## How much data, and which loss

`realeasy-rt` with the same number of training steps for each amount of data (thesis, Fig. 12). *Residual* learns the
correction, *plain* the signal itself, both in normalized units. Torque RMSE in Nm, joints
together; the MSE factor is above 1 if the residual loss is better:

{amounts}

![Torque error by number of train motions]({figure})

{amounts_words}

## Are the promises kept?

Intervals should cover {target} of samples. Least share of a joint, and on how many joints it is significantly lower:

{promises}

{promises_words}
"""

ARM = """
## A real arm

The [SO-101](real-robots.md#so-101-a-hobby-arm-with-position-servos) on top of its identified simulator: networks learn
the remaining error from the same motions. Position RMSE on {motions} test motions, and how many times smaller the MSE
gets:

{rungs}{claims}
"""


def page(result: Mapping[str, Any]) -> str:
    """The page as Markdown."""
    return page_of(Learned.of(result))


def page_of(data: Learned) -> str:
    """The page of a result that is read."""
    found = bars(data)
    words = augment_words
    text = TEXT.format(
        and_arm="" if data.arm is None else ", and on a [real arm](#a-real-arm)",
        bar_words=bar_words(found),
        bar_table=bar_table(found),
        motions=_motions(data.lab),
        torque=torque_table(data.lab),
        cuts=cut_table(data.lab),
        average=words.average(),
        rivals=words.rivals(data.lab),
        signals=signal_table(data.lab),
        verdicts=verdict_words(data.lab),
        harms=words.harms(data.lab),
        zoo=ZOO,
        zoo_units=listed(map(str, ZOO_UNITS)),
        other_percent=REALEASY_OTHER_UNIT_PERCENT,
        units=unit_table(data),
        rough=words.rough(data),
        amounts=amount_table(data),
        figure=augment_figure.NAME,
        amounts_words=words.losses(data.amounts),
        target=f"{100 * data.lab.model(PRECISE).coverage_target:.0f} %",
        promises=promise_table(data),
        promises_words=words.promises(data),
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
    """Ours, and Realeasy's Table II."""
    rows = []
    for test in TESTS:
        cells = [_range(lab.simulated[test]["torque"][joint].mse.value for joint in lab.joints)]
        cells += [_range(item.mse.value for item in joint_cuts(lab, model, test, "torque").values()) for model in OURS]
        cells += map(_range, REALEASY_MSE[test]) if test in REALEASY_MSE else (NOTHING, NOTHING)
        rows.append((TEST_NAMES[test], *cells))
    heads = ("", "simulation", *(f"`{model}`" for model in OURS), "simulation, Realeasy", "corrected, Realeasy")
    return table(heads, rows)


def cut_table(lab: AugmentResult) -> str:
    """Every method: joints together, and the joint on which least is gained."""
    rows = []
    for model in lab.models:
        several, lines = (model.cuts[test]["torque"][ALL_JOINTS] for test in ("multi-joint", "cartesian"))
        joint, least = least_cut(joint_cuts(lab, model.name, "multi-joint", "torque"))
        cells = (
            factor(several.factor, several.verdict),
            cut(least, off=model.is_off("torque", joint)),
            factor(lines.factor, lines.verdict),
        )
        rows.append((f"`{model.name}`", *cells))
    return table(("", "several joints", "their worst joint", "straight lines"), rows)


def signal_table(lab: AugmentResult) -> str:
    """Simulation, precise and real-time, from the best joint to the worst."""
    rows = []
    for signal, unit in (("position", "mrad"), ("velocity", "mrad/s")):
        for test in ("multi-joint", "cartesian"):
            cells = [_range((lab.simulated[test][signal][joint].rmse.value for joint in lab.scored_joints), milli)]
            for model in OURS:
                cuts = joint_cuts(lab, model, test, signal)
                worse = [joint for joint, item in cuts.items() if item.verdict == "worse"]
                named = f", **worse** on {listed(worse)}" if worse else ""
                cells.append(_range((item.rmse.value for item in cuts.values()), milli) + named)
            rows.append((f"{signal} [{unit}], {TEST_NAMES[test]}", *cells))
    return table(("", "simulation", *(f"`{model}`" for model in OURS)), rows)


def _range(values: Iterable[float], shown: Callable[[float], str] = significant) -> str:
    """From the least to the largest."""
    ends = sorted(values)
    return " to ".join(dict.fromkeys((shown(ends[0]), shown(ends[-1]))))


def verdict_words(lab: AugmentResult) -> str:
    """How often each method helps and harms where the papers' did not help."""
    better, rows, count = [], [], 0
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
        count = sum(kinds.values())
        if kinds["better"] == count:
            better.append(f"`{model.name}` ({lowest})")
        else:
            rows.append((f"`{model.name}`", *counts, worse, lowest))
    told = []
    if better:
        told.append(
            f"Better on all {count} outputs (position and velocity, every joint and test), with the smallest MSE "
            f"factor: {', '.join(better)}."
        )
    if rows:
        told.append("Outputs of the other methods:")
        told.append(table(("", "better", "undecided", "off", "worse", "least"), rows))
    return "\n\n".join(told)


def unit_table(data: Learned) -> str:
    """Reductions on units that the first two networks never saw, and the gain from several units."""
    rows = [
        (f"`{model}`", *(less(result.model(model).cuts[""]["torque"][ALL_JOINTS]) for result in data.others.values()))
        for model in (*OURS, ZOO)
    ]
    duels = (against(result, ZOO, REAL_TIME, "", "torque") for result in data.others.values())
    gains = (NOTHING if found is None else factor(found, verdict) for found, verdict in duels)
    return table(("", *(f"unit {unit}" for unit in data.others)), [*rows, ("times smaller", *gains)])


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
    """Coverage of all signals."""
    groups = [("", data.lab, TESTS), *((f"unit {unit}, ", item, ("",)) for unit, item in data.others.items())]
    rows = []
    for where, result, tests in groups:
        for model in OURS if not where else (*OURS, ZOO):
            for test in tests:
                cells = [_covered(result, model, test, signal) for signal in ("position", "velocity", "torque")]
                rows.append((f"`{model}`, {where}{TEST_NAMES[test] if test else ''}".removesuffix(", "), *cells))
    return table(("", "position", "velocity", "torque"), rows)


def _covered(result: AugmentResult, model: str, test: str, signal: str) -> str:
    joints = result.model(model).coverage.get(test, {}).get(signal, {})
    shares = [joints[joint].share.value for joint in result.scored_joints if joint in joints]
    if not shares:
        return NOTHING
    below = augment_words.below_promise(result, model, test)[signal]
    return f"{min(shares):.2f}" + (f"; **{len(below)} below**" if below else "")


def _arm(data: Learned, arm: AugmentResult) -> str:
    return ARM.format(motions=arm.motions[""], rungs=_rungs(data, arm), claims=augment_words.claims(arm))


def _rungs(data: Learned, arm: AugmentResult) -> str:
    """Means over motions, which the bars are about, and the paired comparison with the identified simulator."""
    if not data.arm_rungs:
        return ""
    cuts = {f"fitted+{model.name}": model.cuts[""]["position"][ALL_JOINTS] for model in arm.models}
    rows = []
    for name, metric in data.arm_rungs.items():
        total = metric.total
        ends = "" if total.low is None or total.high is None else f" [{total.low:.5f}, {total.high:.5f}]"
        times = factor(cuts[name].factor, cuts[name].verdict) if name in cuts else NOTHING
        rows.append((f"`{name}`", f"{total.value:.5f}{ends}", times))
    text = table(("", "position RMSE [rad]", "times smaller"), rows)
    return f"{text}\n\n{augment_words.arm_bars(data)}\n\n"
