"""The check of a set-up: motions and a robot's description in, findings out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from trueup.check.changes import Proposal
from trueup.check.drive_looks import AFTER, BEFORE
from trueup.check.dynamics import Dynamics
from trueup.check.evidence import Evidence, loss
from trueup.check.log_looks import LOOKS
from trueup.check.reading import Reading, Side, Unit, joint_lines, yaml_lines
from trueup.check.samples import Motion, motion_of
from trueup.check.search import INSIDE, OUTSIDE, Accepted, accepted, nominal
from trueup.check.setting import Logs, Setting, listed, percent
from trueup.core.check_result import SEVERITIES, Finding, Mend
from trueup.core.episode import Episode
from trueup.core.units import si_factor
from trueup.robots import RobotSpec, refuse_unknown_gains, setup_of

# A mirrored joint that changes less than this of what is left (of the logarithm) cannot be told from one that is not.
_UNSEEN = 0.7


def check_motions(
    episodes: Sequence[Episode], robot: RobotSpec, model: Path
) -> tuple[tuple[Finding, ...], tuple[str, ...]]:
    """What is wrong with how logs, robot.yaml and model fit together, without a fit.

    Args:
        episodes: in the robot's names and units; some dozens are enough.
        robot: its description.
        model: MJCF or URDF.

    Returns:
        Findings, the gravest first, and what these motions cannot show.

    Raises:
        ConfigError: motions were recorded at several settings of the position gain, and nobody has said which is the
            robot's.
    """
    refuse_unknown_gains(robot, (episode.meta for episode in episodes))
    findings = [finding for look in LOOKS.values() for finding in look(Logs(robot, episodes))]
    scale = next((finding.numbers["scale"] for finding in findings if finding.kind == "clock"), 1.0)
    if scale != 1.0:
        episodes = [_rescaled(episode, scale) for episode in episodes]
    signal = robot.controller.signal
    motions: list[Motion] = []
    for episode in episodes:
        motion = motion_of(episode, robot.joint_names, setup_of(robot, episode.meta), robot.delay_s)
        if motion is not None and motion.known.any():
            motions.append(motion)
    usable = [motion for motion in motions if signal in motion.command]
    dynamics = {
        payload_kg: Dynamics(robot, model, payload_kg=payload_kg)
        for payload_kg in sorted({motion.setup.payload_kg for motion in usable} or {0.0})
    }
    if not usable:
        return _ordered(findings), ("No motion has a command and enough samples to look at.",)
    evidence = Evidence(usable, dynamics, signal)
    setting = Setting(robot, episodes, evidence, Reading.as_it_is(evidence.joints))
    findings += [finding for look in BEFORE.values() for finding in look(setting)]
    lengths = tuple(si_factor(unit)[0] for unit in episodes[0].measured.select(robot.joint_names).units["position"])
    copied = any(finding.kind == "command-is-measurement" for finding in findings)
    if copied and signal != "torque":
        return _ordered(findings), ("The drive cannot be checked: command and measurement are identical.",)
    changes, reading = accepted(evidence, nominal(evidence), lengths)
    units: dict[tuple[str, int], Unit] = {}
    for change in changes:
        findings.append(_finding(robot, evidence, change, units, lengths))
        units |= change.proposal.units
    setting = replace(setting, reading=reading)
    # What follows from an explanation that is only likely is no finding of its own.
    told = [
        name for name in AFTER if not changes or changes[-1].severity == "certain" or name in ("velocity", "saturation")
    ]
    findings += [finding for name in told for finding in AFTER[name](setting)]
    return _ordered(findings), tuple(_unseen(robot, evidence, reading))


def _finding(
    robot: RobotSpec, evidence: Evidence, change: Accepted, units: dict[tuple[str, int], Unit], lengths: Sequence[str]
) -> Finding:
    proposal = change.proposal
    names = tuple(robot.joint_names[joint] for joint in proposal.joints)
    joint = int(max(change.joints, key=lambda one: change.before.left[one] / (change.after.left[one] + 1e-9)))
    said, numbers = _explained(robot, evidence, change, joint)
    subject = listed(names) + " " if names else ""
    text = f"{subject}{proposal.words(robot.joint_names)}: {said}"
    mends = _mends(robot, evidence, proposal, units | proposal.units, lengths)
    others = []
    for other in change.others:
        alternative = _mends(robot, evidence, other, {**units, **other.units}, lengths)[:1]
        about = "the log cannot tell it from this" if other.alike == proposal.alike else "explains nearly as much"
        subject = listed([robot.joint_names[own] for own in other.joints])
        words = f"{subject} {other.words(robot.joint_names)}".strip()
        others += [replace(mend, words=f"{words} ({about})") for mend in alternative]
    return Finding(
        proposal.kind,
        change.severity,
        f"{text[0].upper() if not names else text[0]}{text[1:]}.",
        names,
        (*mends, *others),
        numbers,
    )


def _explained(robot: RobotSpec, evidence: Evidence, change: Accepted, joint: int) -> tuple[str, dict[str, float]]:
    """What a change explains, in words and numbers, by the joint that it makes most of."""
    before, after = change.before, change.after
    name = robot.joint_names[joint]
    signal = evidence.followed(change.proposal.reading)
    numbers = {
        "left": float(after.left[joint]),
        "left_before": float(before.left[joint]),
        "outside": float(after.outside[joint]),
        "outside_before": float(before.outside[joint]),
        "value": change.proposal.value,
    }
    ways = []
    if before.outside[joint] > OUTSIDE and after.outside[joint] < INSIDE:
        ways.append(
            f"{name} stays within its range (as configured, it is outside {percent(before.outside[joint])} of the time)"
        )
    if signal == "torque":
        ways.append(
            f"the model explains {_share(after.left[joint])} of the torque of {name} "
            f"(as configured, {_share(before.left[joint])} of it)"
        )
    elif before.left[joint] > 0.1:
        ways.append(
            f"the command explains {_share(after.left[joint])} of the motion of {name} "
            f"(as configured, {_share(before.left[joint])} of it)"
        )
    else:
        share, was = (1.0 - one.left[joint] / max(one.blind[joint], 1e-12) for one in (after, before))
        numbers |= {"explained": float(share), "explained_before": float(was)}
        ways.append(
            f"the model explains {percent(share)} of the tracking error of {name} (as configured, {percent(was)} of it)"
        )
    return "with this change, " + ", and ".join(ways), numbers


def _mends(
    robot: RobotSpec,
    evidence: Evidence,
    proposal: Proposal,
    units: dict[tuple[str, int], Unit],
    lengths: Sequence[str],
) -> tuple[Mend, ...]:
    reading = proposal.reading
    if proposal.joints:
        names = [robot.joint_names[joint] for joint in sorted(proposal.joints)]
        lines = joint_lines(robot, reading, units, signal=evidence.followed(reading), lengths=lengths, only=names)
        return (Mend("robot.yaml", lines, f"{listed(names)} {proposal.words(robot.joint_names)}"),)
    if proposal.kind == "delay":
        lag_s, shift_s = round(reading.lag_s, 3), round(robot.clock.command_shift_s + reading.lag_s, 3)
        clock = Mend(
            "robot.yaml",
            yaml_lines({"clock": {"command_shift_s": shift_s}}),
            "if the clocks of command and measurement differ",
        )
        if lag_s < 0 or any(gains.delay_s is not None for gains in robot.controller.per_joint.values()):
            return (clock,)
        lag_s = round(robot.controller.delay_s + lag_s, 3)
        return (
            Mend("robot.yaml", yaml_lines({"controller": {"delay_s": lag_s}}), "if the drive acts that late"),
            clock,
        )
    if proposal.kind == "clock":
        unit = {1e-3: "ms", 1e-6: "us", 1e-9: "ns"}.get(round(reading.clock_scale, 12))
        lines = yaml_lines({"clock": {"scale": float(f"{robot.clock.scale * reading.clock_scale:.9g}")}})
        mapping = (
            (Mend("mapping", f"time: {{column: …, unit: {unit}}}", "or say it when the logs are imported"),)
            if unit
            else ()
        )
        return (Mend("robot.yaml", lines, "convert the time stamps to seconds"), *mapping)
    if proposal.kind == "gravity" and reading.gravity is not None:
        vector = " ".join(f"{part:g}" for part in reading.gravity)
        return (
            Mend(
                "model", f'<option gravity="{vector}"/>', "turn gravity to where it pulls on the robot as it is mounted"
            ),
        )
    if proposal.kind == "gravity-compensation":
        on = str(not reading.uncompensated).lower()
        return (Mend("robot.yaml", f"simulation: {{gravity_compensation: {on}}}", "set gravity compensation"),)
    return _mode_mends(robot, evidence, proposal)


def _mode_mends(robot: RobotSpec, evidence: Evidence, proposal: Proposal) -> tuple[Mend, ...]:
    """Another controller, with the gains that the motions ask for."""
    signal = evidence.followed(proposal.reading)
    score = evidence.score(proposal.reading)
    tree: dict[str, object] = {"kind": signal, "command": signal}
    if signal != "torque":
        known = np.isfinite(score.gain) & (score.gain > 0)
        stiffness = float(np.median(1.0 / score.gain[known])) if known.any() else 100.0
        damping = float(np.median(score.damping[known] / score.gain[known])) if known.any() else 0.0
        gains = {"kp": stiffness, "kv": damping} if signal == "position" else {"kv": stiffness}
        tree |= {key: float(f"{value:.3g}") for key, value in gains.items()}
    tree |= {key: 0.0 for key in ("kp", "kv", "ki") if key not in tree and getattr(robot.controller, key)}
    own = evidence.signal
    mapping = Mend(
        "mapping",
        f"series:\n  command:\n    signals:\n      {signal}: {{columns: …, unit: …}}",
        f"call the command a {signal} where the logs are imported, not a {own}",
    )
    return (
        Mend("robot.yaml", yaml_lines({"controller": tree}), f"together with the mapping: the command is a {signal}"),
        mapping,
    )


def _unseen(robot: RobotSpec, evidence: Evidence, reading: Reading) -> list[str]:
    """Questions to which these motions have no answer."""
    if not evidence.sure:
        why = "its base is free or moves, or joints are passive or coupled"
        return [
            f"Gravity, and signs flipped in command and measurement, cannot be checked: torques are unsure, as {why}."
        ]
    score = evidence.score(reading)
    base = loss(score, score).sum()
    moved = np.flatnonzero(np.isfinite(score.left))
    side: Side = "both" if evidence.followed(reading) == "position" else "measured"

    def quiet(side: Side, **change: float) -> str:
        names = []
        for joint in moved:
            other = reading.with_columns(side, lambda columns: columns.changed(int(joint), **change))  # noqa: B023
            if abs(loss(evidence.score(other), score).sum() - base) < _UNSEEN:
                names.append(robot.joint_names[int(joint)])
        return ", ".join(names)

    signs, zeros = quiet("both", factor=-1.0), quiet(side, offset=0.5 * np.pi)
    said = []
    if signs:
        said.append(
            f"These motions cannot show whether the signs of {signs} are right: they would look the same with both "
            "command and measurement negated."
        )
    if zeros:
        said.append(f"These motions cannot show whether the zeros of {zeros} are those of the model.")
    return said


def _rescaled(episode: Episode, scale: float) -> Episode:
    measured = replace(episode.measured, time_s=scale * episode.measured.time_s)
    command = None if episode.command is None else replace(episode.command, time_s=scale * episode.command.time_s)
    return replace(episode, measured=measured, command=command)


def _ordered(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    return tuple(sorted(findings, key=lambda finding: SEVERITIES.index(finding.severity)))


def _share(left: float) -> str:
    return percent(1.0 - left)
