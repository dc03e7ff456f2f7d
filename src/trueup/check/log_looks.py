"""What is seen in logs alone: one function per question, and their table."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from trueup.check.reading import yaml_lines
from trueup.check.setting import Logs, where
from trueup.core.check_result import CheckSeverity, Finding, Mend
from trueup.core.hold import held_rows

# A joint that spans less than this does not move; one that is told to go further is commanded [rad or m].
_LEAST_MOTION, _COMMANDED = 0.002, 0.05
# Rates of robots' logs.
_STAMPS_HZ = (1.0, 30_000.0)


def stamps(logs: Logs) -> Iterator[Finding]:
    """Rates that no robot has: stamps in another unit."""
    rates = [episode.measured.rate_hz for episode in logs.episodes if len(episode.measured) > 2]
    if not rates:
        return
    rate_hz = float(np.median(rates))
    if _STAMPS_HZ[0] <= rate_hz <= _STAMPS_HZ[1]:
        return
    scale = next((one for one in (1e-3, 1e-6, 1e-9, 1e3, 1e6, 1e9) if 5.0 <= rate_hz / one <= 20_000.0), None)
    if scale is None:
        return
    unit = {1e-3: "ms", 1e-6: "us", 1e-9: "ns"}.get(scale)
    says = f"in {unit}" if unit else f"{1 / scale:g} times too small"
    mends = [Mend("robot.yaml", yaml_lines({"clock": {"scale": scale}}), "convert the time stamps to seconds")]
    if unit:
        mends.append(Mend("mapping", f"time: {{column: …, unit: {unit}}}", "or say it when the logs are imported"))
    yield Finding(
        "clock",
        "certain",
        f"A sampling rate of {rate_hz:.3g} Hz is implausible; if stamps are {says}, it is {rate_hz / scale:.4g} Hz.",
        mends=tuple(mends),
        numbers={"scale": scale, "rate_hz": rate_hz},
    )


def no_command(logs: Logs) -> Iterator[Finding]:
    """Nothing was commanded, or not what the robot follows."""
    signal = logs.robot.controller.signal
    lacking = [episode for episode in logs.episodes if episode.command is None or signal not in episode.command]
    if not lacking:
        return
    whole = len(lacking) == len(logs.episodes)
    others = sorted({name for episode in lacking if episode.command is not None for name in episode.command.signals})
    kinds = {"position": "position, with kp and kv", "velocity": "velocity, with kv", "torque": "torque"}
    known = [name for name in others if name in kinds]
    mends = [
        Mend(
            "mapping",
            f"series:\n  command:\n    signals:\n      {signal}: {{columns: …, unit: …}}",
            "name the columns of the command",
        )
    ]
    if known:
        lines = yaml_lines({"controller": {"kind": known[0], "command": known[0]}})
        mends = [
            Mend("robot.yaml", lines, f"let the robot follow what the log commands: kind {kinds[known[0]]}"),
            *mends,
        ]
    elif signal == "torque" and any("torque" in episode.measured for episode in lacking):
        mends = [
            Mend("robot.yaml", "controller: {source: measured}", "use the measured torque as the command"),
            *mends,
        ]
    said = f"command {', '.join(others)}" if others else "have no command"
    yield Finding(
        "no-command",
        "certain" if whole else "likely",
        f"The robot follows a {signal}, and {'all' if whole else len(lacking)} of {len(logs.episodes)} motions {said}.",
        mends=tuple(mends),
        motions=() if whole else tuple(episode.id for episode in lacking),
    )


def idle_joints(logs: Logs) -> Iterator[Finding]:
    """Joints that never move, and recordings in which next to nothing does."""
    spans = _spans([episode.measured["position"] for episode in logs.episodes if "position" in episode.measured])
    if spans is None:
        return
    signal = logs.robot.controller.signal
    told = _spans(
        [
            episode.command[signal]
            for episode in logs.episodes
            if episode.command is not None and signal in episode.command
        ]
    )
    idle = where(spans < _LEAST_MOTION)
    if len(idle) == spans.size:
        text = f"No joint moves by more than {_LEAST_MOTION:g} rad or m in any motion."
        yield Finding("small-motion", "likely", text, mends=(Mend("recording", "", "record motions"),))
        return
    dead = [joint for joint in idle if told is not None and told[joint] > _COMMANDED and signal != "torque"]
    if dead:
        text = f"{logs.listed(dead)}: commanded, and never moved. Unplugged, held, or not logged?"
        yield Finding(
            "idle-joint",
            "likely",
            text,
            logs.names(dead),
            (Mend("recording", "", "look whether it is switched on and logged"),),
        )
    quiet = [joint for joint in idle if joint not in dead]
    if quiet:
        text = f"{logs.listed(quiet)}: never moved. These motions say nothing about it."
        yield Finding(
            "idle-joint",
            "note",
            text,
            logs.names(quiet),
            (Mend("recording", "", "move it, or leave it out of what is fitted"),),
        )
    small = [joint for joint in where(spans < _COMMANDED) if joint not in idle]
    if small:
        text = f"{logs.listed(small)}: moved by less than 0.05 rad or m, where friction and encoders hide much."
        yield Finding(
            "small-motion", "note", text, logs.names(small), (Mend("recording", "", "record larger motions"),)
        )


def same_twice(logs: Logs) -> Iterator[Finding]:
    """The same columns stand for command and measurement."""
    controller = logs.robot.controller
    if controller.source == "measured":
        return
    counts = np.zeros(len(logs.robot.joints), int)
    known = np.zeros(len(logs.robot.joints), int)
    for episode in logs.episodes:
        signal = controller.signal
        if episode.command is None or signal not in episode.command or signal not in episode.measured:
            continue
        done, told = episode.measured, episode.command
        for joint in range(counts.size):
            same = _copies(done.time_s, done[signal][:, joint], told.time_s, told[signal][:, joint])
            if same is not None:
                known[joint] += 1
                counts[joint] += same
    found = [joint for joint in range(counts.size) if known[joint] and counts[joint] == known[joint]]
    if found:
        moved = controller.signal != "torque"
        severity: CheckSeverity = "certain" if moved and len(found) * 2 > np.count_nonzero(known) else "likely"
        yield Finding(
            "command-is-measurement",
            severity,
            f"Command and measured {controller.signal} of {logs.listed(found)} are identical in all motions: one of "
            "them was logged twice, so nothing can be learned about the drive.",
            logs.names(found),
            (
                Mend(
                    "mapping",
                    f"series:\n  measured:\n    signals:\n      {controller.signal}: {{columns: …, unit: …}}",
                    "name the columns that were measured, or those that were commanded",
                ),
            ),
        )


def _spans(values: Sequence[np.ndarray]) -> np.ndarray | None:
    """Largest span of each column in a motion; None without any."""
    known = [
        np.nanmax(item, axis=0) - np.nanmin(item, axis=0) for item in values if np.isfinite(item).any(axis=0).all()
    ]
    return np.max(known, axis=0) if known else None


def _copies(time_s: np.ndarray, done: np.ndarray, asked_s: np.ndarray, asked: np.ndarray) -> bool | None:
    """Whether a measured column is the commanded one, some samples late; None if nothing moves."""
    if np.ptp(done) < _LEAST_MOTION or done.size < 20:
        return None
    period_s = float(np.median(np.diff(time_s)))
    for late in range(4):
        rows = held_rows(asked_s, time_s - late * period_s)
        inside = rows >= 0
        if inside.sum() > 10 and np.mean(np.abs(done[inside] - asked[rows[inside]]) <= 1e-9) > 0.98:
            return True
    return False


LOOKS: Mapping[str, Callable[[Logs], Iterator[Finding]]] = {
    "stamps": stamps,
    "command": no_command,
    "idle": idle_joints,
    "twice": same_twice,
}
