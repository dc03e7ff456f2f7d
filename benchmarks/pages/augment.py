"""docs/learned-corrections.md, from what `python -m benchmarks augment` has measured."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from benchmarks.pages import augment_figure, augment_words
from benchmarks.pages.augment_bars import ARM as ARM_BARS
from benchmarks.pages.augment_bars import bar_table, bar_words, bars, least_cut
from benchmarks.pages.augment_cells import factor, less, listed, milli
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
TORQUE = "torque"

TEXT = """# What learned corrections bring

A network learns the error of a simulator on a [virtual Panda](virtual-robot.md) whose physics the simulator does not
know{and_arm}. This note repeats the experiments of Realeasy (IV, V) and of the LSTM thesis (6) on the
[papers' data set](panda.md). `realeasy` sees the whole motion, `realeasy-rt` runs in a control loop; `paper` and
`paper-rt` are the same networks with the papers' hyperparameters.

The bars were set before anything was trained. {bar_words} How many times smaller the mean square error (MSE) is than
the simulation's, on the joint with the least gain (bar), with 95 % intervals over whole motions:

{bar_table}

All figures, by joint, are in `benchmarks/results/augment.json`.

## How it was made

```sh
trueup record --robot panda --hardware lab --unit 1 --seed 1 --plan paper --out data/panda
trueup replay data/panda --robot panda
trueup augment train data/panda --method realeasy-rt --out models/realeasy-rt
trueup augment eval data/panda --model models/realeasy-rt --out runs/learned
python -m benchmarks augment    # this page
```

850 motions of several joints and 870 of one joint are split 80/15/5 into train, val and test. Test motions:
{motions}. Each network was trained once: intervals do not include the variation between
trainings. Comparisons are [paired](augmentation.md#reading-the-tables).

## Torque

{torque}

MSE of the simulation over that of each method, none of which saw straight lines in training; `moving-average` is the
thesis's simple rival:

{cuts}

The same against the best baseline that may see as much; above 1 is better, `~`: the interval contains 1.

{rivals}

{training_words}

## Position and velocity

The papers' networks did not improve positions and velocities. {signals}

{verdicts}

{harms}

## Another unit

{units}

## A simulator with bad parameters

{rough}

## How much data, and which loss

`realeasy-rt` with the same number of training steps for each amount of data (thesis, Fig. 12). *Residual* learns the
correction, *plain* the signal itself.

![Torque error by number of train motions]({figure})

{amounts_words}

## Are the promises kept?

Intervals should cover {target} of samples. For torque, the least share of a joint, and how many joints are
significantly below:

{promises}

{promises_words}
"""

ARM = """
## A real arm

Networks learn the error that the identified simulator of the
[SO-101](real-robots.md#so-101-a-hobby-arm-with-position-servos) leaves. On {motions} test motions:

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
        bar_table=bar_table([bar for bar in found if "SO-101" not in bar.what]),
        motions=_motions(data.lab),
        torque=torque_words(data.lab),
        cuts=cut_table(data.lab),
        rivals=words.rivals(data.lab),
        signals=signal_words(data.lab),
        verdicts=verdict_words(data.lab),
        harms=words.harms(data.lab),
        units=unit_words(data),
        rough=words.rough(data),
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


def torque_words(lab: AugmentResult) -> str:
    """Ours, and Realeasy's Table II."""
    before = _range(lab.simulated["multi-joint"][TORQUE][joint].mse.value for joint in lab.joints)
    ours = (
        f"`{model}` leaves {_range(item.mse.value for item in joint_cuts(lab, model, 'multi-joint', TORQUE).values())}"
        for model in OURS
    )
    there, left = map(_range, REALEASY_MSE["multi-joint"])
    return (
        f"On several joints, the simulation's MSE is {before} Nm2, by joint; {', '.join(ours)}. In Realeasy's Table II "
        f"(real Panda, Gazebo), {there} Nm2 became {left}."
    )


def cut_table(lab: AugmentResult) -> str:
    """Every method, joints together."""
    rows = []
    for model in lab.models:
        cuts = (model.cuts[test][TORQUE][ALL_JOINTS] for test in REALEASY_MSE)
        rows.append((f"`{model.name}`", *(factor(own.factor, own.verdict) for own in cuts)))
    return table(("", *(TEST_NAMES[test] for test in REALEASY_MSE)), rows)


def signal_words(lab: AugmentResult) -> str:
    """Simulation, precise and real-time, from the best joint to the worst."""
    told = []
    for signal, unit in (("position", "mrad"), ("velocity", "mrad/s")):
        before = _range((lab.simulated["multi-joint"][signal][joint].rmse.value for joint in lab.scored_joints), milli)
        ours = (
            f"`{model}` leaves "
            + _range((item.rmse.value for item in joint_cuts(lab, model, "multi-joint", signal).values()), milli)
            for model in OURS
        )
        told.append(f"of {before} {unit}, {' and '.join(ours)}")
    return f"RMSE by joint, several joints: {'; '.join(told)}."


def _range(values: Iterable[float], shown: Callable[[float], str] = significant) -> str:
    """From the least to the largest."""
    ends = sorted(values)
    return " to ".join(dict.fromkeys((shown(ends[0]), shown(ends[-1]))))


def verdict_words(lab: AugmentResult) -> str:
    """How often each method helps and harms where the papers' did not help."""
    better, others, count = [], [], 0
    for model in lab.models:
        kinds = {"better": 0, "undecided": 0, "off": 0, "worse": 0}
        on = {}
        for test in TESTS:
            for signal in ("position", "velocity"):
                for joint, item in joint_cuts(lab, model.name, test, signal).items():
                    off = model.is_off(signal, joint)
                    kinds["off" if off else item.verdict] += 1
                    if not off:
                        on[f"{test} {signal} {joint}"] = item
        count = sum(kinds.values())
        lowest = f" ({factor((least := least_cut(on)[1]).factor, least.verdict)})" if on else ""
        if kinds["better"] == count:
            better.append(f"`{model.name}`{lowest}")
        else:
            told = (f"**{own} worse**" if kind == "worse" else f"{own} {kind}" for kind, own in kinds.items() if own)
            others.append(f"- `{model.name}`{lowest}: {', '.join(told)}")
    head = f"Of {count} outputs (position and velocity, every joint and test), with the smallest MSE factor:"
    return "\n".join([head, "", *[f"- All better: {', '.join(better)}"] * bool(better), *others])


def unit_words(data: Learned) -> str:
    """Reductions on units that the first two networks never saw, and the gain from several units."""
    cuts = {
        model: listed(f"{less(own.model(model).cuts[''][TORQUE][ALL_JOINTS])} %" for own in data.others.values())
        for model in (*OURS, ZOO)
    }
    duels = (against(own, ZOO, REAL_TIME, "", TORQUE) for own in data.others.values())
    gains = listed(NOTHING if found is None else factor(found, verdict) for found, verdict in duels)
    ours = "; ".join(f"`{model}` removes {cuts[model]}" for model in OURS)
    return (
        f"Torque MSE of all motions of units {listed(data.others)}, joints together: {ours} (Realeasy: "
        f"{REALEASY_OTHER_UNIT_PERCENT} % on a part of the lines). `{ZOO}`, trained on units "
        f"{listed(map(str, ZOO_UNITS))}, removes {cuts[ZOO]}: its MSE is {gains} times smaller than that of "
        f"`{REAL_TIME}`."
    )


def promise_table(data: Learned) -> str:
    """Coverage of torque."""
    groups: list[tuple[str, AugmentResult, str, tuple[str, ...]]]
    groups = [(TEST_NAMES[test], data.lab, test, OURS) for test in TESTS]
    groups += [(f"unit {unit}", item, "", (*OURS, ZOO)) for unit, item in data.others.items()]
    rows = [
        (
            title,
            *(_covered(own, model, test, TORQUE) if model in models else "" for model in (*OURS, ZOO)),
        )
        for title, own, test, models in groups
    ]
    return table(("", *(f"`{model}`" for model in (*OURS, ZOO))), rows)


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
        bar = ARM_BARS.get(name.removeprefix("fitted+"))
        asked = "" if bar is None else f" (≤ {bar:.4f}){'' if total.value <= bar else ' **missed**'}"
        rows.append((f"`{name}`", f"{total.value:.5f}{ends}{asked}", times))
    text = table(("", "position RMSE [rad] (bar)", "MSE, times smaller"), rows)
    return f"{text}\n\n{augment_words.arm_bars(data)}\n\n"
