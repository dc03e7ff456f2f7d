"""Sentences of docs/learned-corrections.md that depend on what was found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.pages.augment_bars import ARM
from benchmarks.pages.augment_cells import factor, listed, short, span
from benchmarks.pages.augment_data import (
    BASELINES,
    PAPER_OF,
    PRECISE,
    REAL_TIME,
    ROUGH_OF,
    TARGETS,
    TEST_NAMES,
    TESTS,
    THESIS_BAD,
    THESIS_GOOD,
    ZOO,
    Learned,
    counts_of,
    joint_cuts,
)
from trueup.core.augment_result import ALL_JOINTS, AugmentResult
from trueup.core.results import Estimate
from trueup.report.augment_words import against
from trueup.report.numbers import NOTHING


def duel(result: AugmentResult, model: str, other: str, condition: str, signal: str = "torque") -> str:
    """One network against another on the same motions, joints together: `is 1.8 [1.6, 2.0] times smaller than`."""
    found, verdict = against(result, model, other, condition, signal)
    if found is None:
        return f"`{model}` and `{other}` were not compared"
    if verdict == "better":
        return f"the MSE of `{model}` is {factor(found)} times smaller than that of `{other}`"
    if verdict == "worse":
        turned, _ = against(result, other, model, condition, signal)
        return f"the MSE of `{model}` is {factor(turned or found)} times larger than that of `{other}`"
    return f"no significant difference between `{model}` and `{other}` ({factor(found)})"


def rivals(lab: AugmentResult) -> str:
    """Our two networks against the best baseline that may see as much."""
    lines = []
    for test in ("multi-joint", "cartesian"):
        duels = []
        for model in (PRECISE, REAL_TIME):
            other = best_baseline(lab, model, test)
            found, verdict = against(lab, model, other, test, "torque")
            duels.append(f"`{model}` against `{other}` {NOTHING if found is None else factor(found, verdict)}")
        lines.append(f"- {TEST_NAMES[test].capitalize()}: {'; '.join(duels)}.")
    return "\n".join(lines)


def best_baseline(lab: AugmentResult, model: str, test: str) -> str:
    """The baseline that leaves least torque error; only those that run in a control loop beside one that does."""
    causal = lab.model(model).causal
    there = {item.name for item in lab.models}
    known = [name for name in BASELINES if name in there and (lab.model(name).causal or not causal)]
    return min(known, key=lambda name: lab.model(name).cuts[test]["torque"][ALL_JOINTS].mse.value)


def rough(data: Learned) -> str:
    """How much more is left where the simulator's parameters are bad."""
    lines = []
    for model, name in ROUGH_OF.items():
        good = joint_cuts(data.lab, model, "multi-joint", "torque")
        bad = joint_cuts(data.rough, name, "multi-joint", "torque")
        ratios = [bad[joint].rmse.value / good[joint].rmse.value for joint in good]
        left = span((item.rmse.value for item in bad.values()), 2)
        lines.append(f"`{name}` leaves {left} Nm, {span(ratios)} times what `{model}` leaves")
    thesis = [bad / good for bad, good in zip(THESIS_BAD[1], THESIS_GOOD[1], strict=True)]
    simulated = data.rough.simulated["multi-joint"]["torque"]
    before = span((simulated[joint].rmse.value for joint in data.rough.joints), 2)
    return (
        f"Trained on `panda_rough`, whose inertial parameters are worse and torque RMSE is {before} Nm by joint, "
        f"{'; '.join(lines)} (thesis, 6.4: {span(thesis[1:])} times, {thesis[0]:.0f} times on joint 0)."
    )


def losses(amounts: AugmentResult) -> str:
    """Residual against plain loss, and whether more motions still help."""
    counts = counts_of(amounts)
    lines = []
    for test in ("multi-joint", "cartesian"):
        duels = {count: _loss_duel(amounts, count, test) for count in counts}
        said = _loss_words({count: verdict for count, (_, verdict) in duels.items()})
        last, _ = duels[counts[-1]]
        times = "" if last is None else f" ({counts[-1]}: MSE of plain over residual {factor(last)})"
        lines.append(f"- {TEST_NAMES[test].capitalize()}: {said}{times}. {_more_words(amounts, counts, test)}.")
    return "\n".join(lines)


def _loss_duel(amounts: AugmentResult, count: int, test: str) -> tuple[Estimate | None, str]:
    residual, plain = (f"amount-{count}-{target}" for target in TARGETS)
    return against(amounts, residual, plain, test, "torque")


def _loss_words(verdicts: Mapping[int, str]) -> str:
    """`better` is the residual loss."""
    by = {kind: [count for count, verdict in verdicts.items() if verdict == kind] for kind in ("better", "worse")}
    if len(by["worse"]) == len(verdicts):
        return "the plain loss is better with every amount, as in the thesis"
    if not by["better"] and not by["worse"]:
        return "no significant difference between the losses; in the thesis the plain one is better everywhere"
    parts = [
        f"the {loss} loss is better with {listed(map(str, by[kind]))} motions"
        for kind, loss in (("better", "residual"), ("worse", "plain"))
        if by[kind]
    ]
    ending = "unlike in the thesis, where the plain one is better everywhere" if by["better"] else "as in the thesis"
    return f"{'; '.join(parts)}, {ending}"


def _more_words(amounts: AugmentResult, counts: Sequence[int], test: str) -> str:
    """What the last doubling of the data has brought."""
    before, after = counts[-2:]
    found, verdict = against(amounts, f"amount-{after}-residual", f"amount-{before}-residual", test, "torque")
    told = f"From {before} to {after} motions, the residual loss"
    if found is None:
        return f"{told} was not compared"
    if verdict == "better":
        return f"{told} still improves: MSE {factor(found)} times smaller"
    if verdict == "worse":
        return f"{told} gets worse (factor {factor(found)})"
    return f"{told} does not improve significantly ({factor(found)})"


def promises(data: Learned) -> str:
    """How many intervals cover less than they promise, on motions like those of training, on others, on other units."""
    seen = [(data.lab, model, test) for model in (PRECISE, REAL_TIME) for test in ("multi-joint", "single-joint")]
    lines = [(data.lab, model, "cartesian") for model in (PRECISE, REAL_TIME)]
    units = [(result, model, "") for result in data.others.values() for model in (PRECISE, REAL_TIME, ZOO)]
    groups = {"on motions of the trained kinds": seen, "on straight lines": lines, "on other units": units}
    told = "; ".join(f"{_broken(group)} {where}" for where, group in groups.items())
    return f"Of position, velocity and torque, significantly below: {told}."


def _broken(group: Sequence[tuple[AugmentResult, str, str]]) -> str:
    found = [len(joints) for item in group for joints in below_promise(*item).values()]
    every = sum(len(joints) for result, model, test in group for joints in result.model(model).coverage[test].values())
    together = sum(
        ALL_JOINTS in joints for result, model, test in group for joints in result.model(model).coverage[test].values()
    )
    return f"{sum(found)} of {every - together} outputs"


def below_promise(result: AugmentResult, model: str, test: str) -> dict[str, list[str]]:
    """Signal -> joints whose share of covered samples lies below the promise with its whole interval."""
    evaluation = result.model(model)
    signals = evaluation.coverage.get(test, {})
    return {
        signal: [
            joint
            for joint in result.scored_joints
            if joint in joints and (high := joints[joint].share.high) is not None and high < evaluation.coverage_target
        ]
        for signal, joints in signals.items()
    }


def training(data: Learned) -> str:
    """The papers' configuration against ours: time, and what is left on val."""
    lines = []
    for model, paper in PAPER_OF.items():
        ours, theirs = data.training[model], data.training[paper]
        left = [f"{val_left(item, 'torque'):.1f}" for item in (ours, theirs)]
        times = ours["seconds"] / theirs["seconds"]
        lines.append(f"`{model}` takes {times:.2f} times as long as `{paper}` and leaves {left[0]} %, not {left[1]} %")
    return f"Training, and torque MSE left on val: {'; '.join(lines)}."


def val_left(item: Mapping[str, Any], signal: str) -> float:
    """Percent of the simulator's MSE that is left on val, mean over joints."""
    joints = item["val"].get(signal, {})
    shares = [(own["corrected"] / own["simulated"]) ** 2 for own in joints.values() if own["simulated"] > 0]
    return 100 * sum(shares) / len(shares) if shares else float("nan")


def arm_bars(data: Learned) -> str:
    """Whether the identified simulator keeps the bars by itself: then they say nothing about the networks."""
    if "fitted" not in data.arm_rungs:
        return ""
    own = data.arm_rungs["fitted"].total.value
    kept = [f"`{model}`" for model, bar in ARM.items() if own <= bar]
    if not kept:
        return "The identified simulator alone keeps none of the bars."
    return (
        f"The identified simulator alone, {own:.5f} rad, already keeps the bar of {listed(kept)}, so only the "
        "paired comparison says what a network adds."
    )


def claims(arm: AugmentResult) -> str:
    """What is claimed of the real arm: improvements whose paired interval excludes none, and nothing else."""
    claimed, harmed, open_ones = [], [], []
    for model in arm.models:
        cuts = model.cuts[""]["position"]
        name = f"`{model.name}`"
        total = cuts.get(ALL_JOINTS)
        if total is not None:
            told = f"{name}, joints together ({factor(total.factor)})"
            {"better": claimed, "worse": harmed}.get(total.verdict, open_ones).append(told)
        kinds: dict[str, list[str]] = {}
        for joint in arm.scored_joints:
            if not model.is_off("position", joint):
                kinds.setdefault(cuts[joint].verdict, []).append(joint)
        for kind, joints in kinds.items():
            {"better": claimed, "worse": harmed}.get(kind, open_ones).append(f"{name}: {listed(joints)}")
    lines = [f"Significantly better: {'; '.join(claimed)}." if claimed else "No improvement is significant."]
    lines += [f"Significantly worse: {'; '.join(harmed)}."] if harmed else []
    lines += [f"Not significant: {'; '.join(open_ones)}."] if open_ones and (claimed or harmed) else []
    names = [model.name for model in arm.models]
    lines += [f"Joints together: {duel(arm, names[-1], names[0], '', 'position')}."] if len(names) > 1 else []
    return " ".join(lines)


def harms(lab: AugmentResult) -> str:
    """Every output that one of our two networks makes worse for sure, by name."""
    worse = [
        f"`{model}`: {signal} of {joint}, {TEST_NAMES[test]} (x{short(cut.factor.value)})"
        for model in (PRECISE, REAL_TIME)
        for test in TESTS
        for signal in lab.signals
        for joint, cut in joint_cuts(lab, model, test, signal).items()
        if cut.verdict == "worse"
    ]
    if not worse:
        return f"Neither `{PRECISE}` nor `{REAL_TIME}` makes any output of any test significantly worse."
    return f"Significantly worse: {'; '.join(worse)}."
