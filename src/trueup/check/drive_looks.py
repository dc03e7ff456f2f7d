"""What is seen beside the model, without comparing ways to read a log: one function per question, and their table."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import mujoco
import numpy as np
from scipy.ndimage import minimum_filter1d

from trueup.check.changes import Looked, follows
from trueup.check.evidence import loss
from trueup.check.reading import yaml_lines
from trueup.check.setting import Setting, percent, where
from trueup.core.check_result import Finding, Mend
from trueup.core.units import UNITS

# At rest the model sags by more than this [rad], and the robot by less than this share of it.
_SAGS, _STANDS = 0.005, 0.2
_COMPENSATED = "simulation: {gravity_compensation: true}"
# A joint that is slower than this rests [rad/s], or than this share of its speed; rows that are looked at of each
# motion, and needed of all.
_REST_SPEED, _SLOW, _MOST_AT_REST, _LEAST_AT_REST = 5e-3, 0.01, 60, 20
_PAYLOADS_KG = np.geomspace(0.02, 30.0, 23)
# Of the joints that move, for it to be the log of another robot.
_HALF_WAY = 0.5
# A line over the command explains this much of a motion that follows it at all.
_FOLLOWS = 0.3


def floating_base(setting: Setting) -> Iterator[Finding]:
    """A free joint that nothing holds."""
    model = setting.evidence.first.simulator.model
    free = [number for number in range(model.njnt) if model.jnt_type[number] == mujoco.mjtJoint.mjJNT_FREE]
    for number in free:
        joint, body = model.joint(number).name, model.body(int(model.jnt_bodyid[number])).name
        # Objects that lie around hold no joint of the robot.
        root = int(model.body_rootid[int(model.jnt_bodyid[number])])
        own = [model.body_rootid[model.jnt_bodyid[model.joint(name).id]] for name in setting.robot.joint_names]
        if root in own:
            yield Finding(
                "floating-base",
                "likely",
                f"The body {body!r} has a free joint ({joint or 'without a name'}): in a replay the robot falls.",
                mends=(
                    Mend(
                        "model", "", f"take the <freejoint> out of the body {body!r} if the robot was held, or weld it"
                    ),
                ),
            )


def velocity_channel(setting: Setting) -> Iterator[Finding]:
    """Measured velocities that are not the derivative of the positions."""
    # A sign and a scale are those of the velocity, too; a unit is the position's alone.
    alone = setting.evidence.rates / setting.reading.clock_scale
    converted = alone * np.abs(setting.reading.measured.factor)
    slopes = np.where(np.abs(alone - 1.0) < np.abs(converted - 1.0), alone, converted)
    own = setting.reading.measured.column == np.arange(slopes.size)
    odd = where(np.isfinite(slopes) & own & ((slopes < 0.6) | (slopes > 1.7)))
    if not odd:
        return
    middle = float(np.median(slopes[odd]))
    known = slopes[np.isfinite(slopes)]
    exact = next((one for one in (0.5, 2.0, 1e3, 1e-3) if abs(middle / one - 1.0) < 0.04), None)
    if exact is not None and len(odd) == known.size > 1 and float(np.ptp(known)) < 0.05 * abs(middle):
        yield Finding(
            "clock",
            "likely",
            f"All positions change {middle:.3g} times as fast as the measured velocities say: the stamps or the "
            f"velocities are {1 / exact:g} of what they should be.",
            mends=(
                Mend("robot.yaml", yaml_lines({"clock": {"scale": exact}}), "if the stamps are wrong"),
                Mend("mapping", "", "if the velocities are wrong: give them in rad/s, or leave them out"),
            ),
            numbers={"scale": exact},
        )
        return
    named = [
        unit
        for unit, (what, factor) in UNITS.items()
        if what == "angular velocity" and factor != 1.0 and abs(middle / factor - 1.0) < 0.1
    ]
    if middle < 0:
        text, mend = (
            "counts the other way round than the position",
            "give the velocity the sign of the position before it is imported",
        )
    elif named:
        text, mend = (
            f"is {1 / middle:.4g} times the derivative of the position, as {named[0]} for rad/s",
            f"say that velocities are in {named[0]}",
        )
    else:
        text, mend = (
            f"is {1 / middle:.4g} times the derivative of the position",
            "give the velocity in rad/s, or leave it out",
        )
    lines = "" if not named else f"series:\n  measured:\n    signals:\n      velocity: {{columns: …, unit: {named[0]}}}"
    yield Finding(
        "velocity-channel",
        "likely",
        f"The measured velocity of {setting.listed(odd)} {text}.",
        setting.names(odd),
        (Mend("mapping", lines, mend),),
        {"factor": middle},
    )


def payload(setting: Setting) -> Iterator[Finding]:
    """A mass at the end that the model does not have."""
    evidence, reading = setting.evidence, setting.reading
    if not evidence.sure:
        return
    score = evidence.score(reading)
    bare, loaded = evidence.needed(reading), evidence.needed(replace(reading, end_mass_kg=1.0))
    base = float(loss(score, score).sum())
    gains = [
        base - float(loss(evidence.score(reading, bare + mass * (loaded - bare)), score).sum()) for mass in _PAYLOADS_KG
    ]
    best = int(np.argmax(gains))
    mass = float(_PAYLOADS_KG[best])
    after = evidence.score(reading, bare + mass * (loaded - bare))
    share = 1.0 - after.left / np.maximum(after.blind, 1e-12)
    had = 1.0 - score.left / np.maximum(score.blind, 1e-12)
    moved = where(np.isfinite(score.left))
    own = [joint for joint in moved if after.left[joint] < score.left[joint] / 3.0]
    if gains[best] < math.log(4.0) or not own or max(share[own]) < 0.6 or best in (0, len(_PAYLOADS_KG) - 1):
        return
    joint = own[int(np.argmax(share[own]))]
    site = evidence.first.end_site
    lines = yaml_lines({"payload": {"sites": [site]}}) if site else ""
    mends = (
        [Mend("robot.yaml", lines, f"say where it hangs, and payload_kg: {mass:.2g} in the mapping")] if site else []
    )
    mends.append(
        Mend(
            "model",
            "",
            f"add about {mass:.2g} kg to the body {evidence.first.end_body!r}, or let identify find it (payload_mass)",
        )
    )
    yield Finding(
        "payload",
        "likely",
        f"With about {mass:.2g} kg more at {evidence.first.end_body!r} the model explains {percent(share[joint])} of "
        f"the torque of {setting.names([joint])[0]}; without it, {percent(had[joint])}.",
        setting.names(own),
        tuple(mends),
        {"mass_kg": mass, "explained": float(share[joint]), "before": float(had[joint])},
    )


def integral(setting: Setting) -> Iterator[Finding]:
    """A servo that stands where it is told to under a load with which the model sags."""
    evidence = setting.evidence
    stiffness = evidence.first.stiffness
    if not evidence.sure or setting.signal != "position" or evidence.first.compensated:
        return
    errors, sags = _at_rest(setting)
    found = []
    for joint in where(np.isfinite(stiffness)):
        known = np.isfinite(errors[:, joint])
        if known.sum() < _LEAST_AT_REST:
            continue
        stands, falls = _rms(errors[known, joint]), _rms(sags[known, joint])
        if falls > _SAGS and stands < _STANDS * falls:
            found.append((joint, stands, falls))
    if not found:
        return
    joint, stands, falls = max(found, key=lambda item: item[2])
    gains = {"kp": np.nanmedian(stiffness), "kv": np.nanmedian(evidence.first.damping), "ki": np.nanmedian(stiffness)}
    tree = {"kind": "pid", "command": "position", **{key: float(f"{value:.3g}") for key, value in gains.items()}}
    yield Finding(
        "integral",
        "likely",
        f"At rest {setting.names([joint])[0]} stands {1e3 * stands:.2g} mrad from its command, where the model sags by "
        f"{1e3 * falls:.2g} mrad: the drive has an integral term, or is stiffer, or something carries the weight.",
        setting.names([item[0] for item in found]),
        (
            Mend("robot.yaml", yaml_lines({"controller": tree}), "give the controller an integral term"),
            Mend("robot.yaml", _COMPENSATED, "if the robot's own controller carries the weight"),
        ),
        {"stands": stands, "sags": falls},
    )


def _at_rest(setting: Setting) -> tuple[np.ndarray, np.ndarray]:
    """Error of each joint where it rests, NaN elsewhere, and how far the model would sag there; (N, J) each."""
    evidence, reading = setting.evidence, setting.reading
    errors, sags = [], []
    for motion in evidence.motions:
        speed = np.abs(reading.measured.of(motion.velocity, moved=False))
        # The filter brings what is before and after into a rest.
        slow = speed < np.maximum(_REST_SPEED, _SLOW * np.percentile(speed, 98, axis=0))
        calm = minimum_filter1d(slow.astype(float), max(3, round(0.4 / motion.step_s)), axis=0) > 0
        rows = np.flatnonzero(motion.usable(reading.lag_s) & calm.any(axis=1))
        if not rows.size:
            continue
        rows = rows[np.unique(np.linspace(0, rows.size - 1, _MOST_AT_REST).astype(int))]
        position = reading.measured.of(motion.position[rows], moved=True)
        command = reading.command.of(motion.commanded(evidence.signal, reading.lag_s)[rows], moved=True)
        errors.append(np.where(calm[rows], command - position, np.nan))
        dynamics = evidence.dynamics[motion.setup.payload_kg]
        sags.append(dynamics.torque(position) / (motion.setup.kp_factor * evidence.first.stiffness))
    width = len(setting.robot.joints)
    return np.concatenate([np.zeros((0, width)), *errors]), np.concatenate([np.zeros((0, width)), *sags])


def speed_limits(setting: Setting) -> Iterator[Finding]:
    """Joints that are no faster when they are further behind."""
    evidence, reading = setting.evidence, setting.reading
    if setting.signal == "torque":
        return
    position, velocity, _ = evidence.state(reading)
    behind = setting.command - (position if setting.signal == "position" else velocity)
    found = []
    for joint in range(position.shape[1]):
        speed = np.abs(velocity[:, joint])
        top = float(np.percentile(speed, 99))
        far = np.abs(behind[:, joint])
        towards = velocity[:, joint] * behind[:, joint] > 0
        fast = towards & (speed > 0.9 * top)
        if top < 0.05 or fast.sum() < 0.06 * max(int(np.count_nonzero(speed > 0.1 * top)), 1) or fast.sum() < 15:
            continue
        low, high = np.percentile(far[fast], (10, 90))
        furthest = towards & (far > np.percentile(far[towards], 80))
        if high > 2.0 * low and high > 0.1 and np.median(speed[furthest]) > 0.9 * top:
            found.append((joint, top, low, high))
    if found:
        words = ", ".join(
            f"{setting.names([joint])[0]} at {top:.3g} per second with errors of {low:.2g} to {high:.2g}"
            for joint, top, low, high in found
        )
        yield Finding(
            "speed-limit",
            "likely",
            f"Joints whose speed does not rise with the tracking error, as at a speed limit: {words}.",
            setting.names([item[0] for item in found]),
            (
                Mend(
                    "recording",
                    "",
                    "command slower motions, or describe the motor, which has a largest speed (kind: servo, motor: …)",
                ),
            ),
            {"speed": found[0][1]},
        )


def saturation(setting: Setting) -> Iterator[Finding]:
    """Commanded torques at the limit of the model."""
    limits = setting.evidence.first.simulator.torque_limits
    if setting.signal != "torque":  # what a servo asks for is what its gains make of its error, and these nobody knows
        return
    command = setting.command
    shares = {}
    for joint, name in enumerate(setting.robot.joint_names):
        if name in limits and np.isfinite(command[:, joint]).all():
            shares[joint] = float(np.mean(np.abs(command[:, joint]) > 0.98 * limits[name]))
    found = [joint for joint, share in shares.items() if share > 0.05]
    if found:
        words = ", ".join(f"{setting.names([joint])[0]} in {percent(shares[joint])} of the time" for joint in found)
        yield Finding(
            "saturation",
            "note",
            f"Commanded torques are at the limit of the drive: {words}. What saturates says nothing about gains.",
            setting.names(found),
            (Mend("robot.yaml", "", "look whether torque_limit is that of the drive, or command calmer motions"),),
        )


def another_robot(setting: Setting) -> Iterator[Finding]:
    """Nothing explains what the joints do."""
    evidence, reading = setting.evidence, setting.reading
    score = evidence.score(reading)
    moved = where(np.isfinite(score.left))
    servo = setting.signal != "torque"
    lost = [joint for joint in moved if score.left[joint] > (0.5 if servo else 0.9)] if servo or evidence.sure else []
    if servo:  # a soft servo with much friction goes where it is told, and not as far
        looked = Looked(evidence, reading, score, ())
        lost = [joint for joint in lost if follows(looked, joint) < _FOLLOWS]
    out = [joint for joint in moved if score.outside[joint] > 0.3 and score.beyond[joint] > 0.2]
    if moved and (len(lost) >= max(1, _HALF_WAY * len(moved)) or len(out) >= max(1, _HALF_WAY * len(moved))):
        words = []
        if lost:
            what = "motion" if servo else "torque"
            words.append(f"the model explains less than half of the {what} of {', '.join(setting.names(lost))}")
        if out:
            words.append(
                f"{', '.join(setting.names(out))} {'is' if len(out) == 1 else 'are'} out of range for much of the time"
            )
        yield Finding(
            "another-robot",
            "likely",
            f"Nothing that was tried explains these motions: {'; '.join(words)}. Is it the log of this robot?",
            setting.names(sorted({*lost, *out})),
            (Mend("robot.yaml", "", "look at the model and at the names of the joints"),),
        )


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


# The first are asked before readings are compared, the others after it.
BEFORE: Mapping[str, Callable[[Setting], Iterator[Finding]]] = {"base": floating_base}
AFTER: Mapping[str, Callable[[Setting], Iterator[Finding]]] = {
    "velocity": velocity_channel,
    "payload": payload,
    "integral": integral,
    "speed": speed_limits,
    "saturation": saturation,
    "robot": another_robot,
}
