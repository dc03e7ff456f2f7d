"""What `trueup init` makes of logs that are called, ordered, signed and counted otherwise than the model has it.

Robots of other people (`foreign_robots`), whose numbers are not the model's, are moved by plain MuJoCo at a fine step
and logged to CSV files in the ways of `KINDS`. robot.yaml is drafted from model and logs with `--yes`, and the logs are
read through it. A column is right if what is read is what was meant: joint, sign, unit and zero, and of a command the
signal.

`python -m benchmarks drafting` measures all 204 logs (ten minutes). `--only TEXT` prints those whose name holds a text.
"""

import argparse
import re
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from zlib import crc32

import mujoco
import numpy as np

from benchmarks.foreign_cases import CASES
from benchmarks.foreign_truth import make
from benchmarks.table import Row, at_least, at_most, shown
from trueup.align import JointMap
from trueup.core.atomic import write_json
from trueup.core.provenance import provenance
from trueup.dataset.importers.base import ImportOptions
from trueup.errors import TrueupError
from trueup.stages import draft, plan_import

RESULT = Path(__file__).parent / "results" / "drafting.json"
ROBOTS = (
    *("ur5e", "iiwa14_torque", "vx300s", "h1_leg", "g1_arm", "gr1_arm"),
    *("allegro", "tidybot_arm", "panda", "demo_arm", "iiwa14", "h1_arms"),
)
MOTIONS = 4
# Of a log of 40 motions of the first robot.
_MANY, _LONGEST_S = 40, 10.0
# What is read may span so much more or less than what was meant, and be this far away [rad or m].
_SPAN, _ZERO, _ALIKE = 0.05, 0.06, 0.98
_LATE_S = 0.2  # by which a command may be shifted in time
_COMMAND_WORDS = {"position": "q", "velocity": "dq", "torque": "tau"}


@dataclass(frozen=True)
class Motion:
    """Stamps and positions as measured, stamps and commands, each (T,) or (T, J)."""

    done_s: np.ndarray
    done: np.ndarray
    told_s: np.ndarray
    told: np.ndarray


@dataclass(frozen=True)
class Log:
    """Motions of a robot, and how their columns are called.

    Attributes:
        joints: of the model, in the order of the arrays.
        signal: that is commanded.
        limits: of the joints, (J, 2).
        motions: of the robot.
        done: names of the columns of measured positions.
        told: names of the columns of commands.
        order: which joint stands in each place of the file.
        numbered: whether names go by the place, and not by the joint.
    """

    joints: tuple[str, ...]
    signal: str
    limits: np.ndarray
    motions: tuple[Motion, ...]
    done: tuple[str, ...]
    told: tuple[str, ...]
    order: tuple[int, ...]
    numbered: bool = False

    @staticmethod
    def of(base: Path, name: str) -> "Log":
        """As the robot means it."""
        model = mujoco.MjModel.from_xml_path(str(base / "model.xml"))
        case = _case(name)
        rows = [model.joint(joint).id for joint in case.joints]
        limits = [model.jnt_range[row] if model.jnt_limited[row] else (-np.pi, np.pi) for row in rows]
        motions = []
        for path in sorted((base / "logs").glob("*.npz")):
            with np.load(path) as file:
                keys = ("measured.time_s", "measured.position", "command.time_s", f"command.{case.drive}")
                motions.append(Motion(*(file[key] for key in keys)))
        done, told = ([f"{joint}_{word}" for joint in case.joints] for word in ("pos", f"{case.drive}_cmd"))
        order = tuple(range(len(case.joints)))
        return Log(case.joints, case.drive, np.array(limits), tuple(motions), tuple(done), tuple(told), order)

    def write(self, folder: Path) -> None:
        """A CSV file for each motion; commands are held between their stamps."""
        folder.mkdir(parents=True)
        places = range(len(self.order)) if self.numbered else self.order
        header = ",".join(["time", *(self.done[place] for place in places), *(self.told[place] for place in places)])
        order = list(self.order)
        for number, motion in enumerate(self.motions):
            rows = np.searchsorted(motion.told_s, motion.done_s + 1e-9, side="right") - 1
            kept = rows >= 0
            table = [motion.done_s[kept], motion.done[kept][:, order], motion.told[rows[kept]][:, order]]
            path = folder / f"m{number:02d}.csv"
            np.savetxt(path, np.column_stack(table), "%.7g", delimiter=",", header=header, comments="")


Change = Callable[[Log, np.random.Generator], Log]


def numbered(first: int) -> Change:
    """Joints are called by number."""

    def change(log: Log, _: np.random.Generator) -> Log:
        numbers, word = range(first, first + len(log.joints)), _COMMAND_WORDS[log.signal]
        done, told = (tuple(f"{name}{number}" for number in numbers) for name in ("q", f"{word}_des"))
        if first == 0:
            done = tuple(f"actual_position_{number}" for number in numbers)
            told = tuple(f"target_{log.signal}_{number}" for number in numbers)
        return replace(log, done=done, told=told, numbered=True)

    return change


def in_words(log: Log, _: np.random.Generator) -> Log:
    """Joints are called as another program would write their names."""
    names = ["".join(word.capitalize() for word in re.split(r"[_/ ]", joint)) for joint in log.joints]
    done, told = (tuple(f"{name} {what}" for name in names) for what in ("Actual Position", f"Goal {log.signal}"))
    return replace(log, done=done, told=told)


def shuffled(log: Log, rng: np.random.Generator) -> Log:
    """Columns in another order."""
    return replace(log, order=tuple(rng.permutation(len(log.joints)).tolist()))


def moved(log: Log, joints: Sequence[int], factor: np.ndarray, offset: np.ndarray, sides: str) -> Log:
    """Positions, and commands as these take part in it, times a factor, plus an offset; in the series of `sides`."""
    own = list(joints)
    to_commands = {"position": (factor, offset), "velocity": (factor, 0.0), "torque": (np.sign(factor), 0.0)}
    motions = []
    for motion in log.motions:
        done, told = motion.done.copy(), motion.told.copy()
        if "measured" in sides:
            done[:, own] = done[:, own] * factor + offset
        if "command" in sides:
            by, more = to_commands[log.signal]
            told[:, own] = told[:, own] * by + more
        motions.append(replace(motion, done=done, told=told))
    return replace(log, motions=tuple(motions))


def mirrored(sides: str) -> Change:
    """One joint counts the other way round."""
    return lambda log, rng: moved(log, [int(rng.integers(len(log.joints)))], np.array([-1.0]), np.zeros(1), sides)


def in_degrees(sides: str) -> Change:
    """All joints in degrees."""
    return lambda log, _: moved(
        log, range(len(log.joints)), np.full(len(log.joints), 180 / np.pi), np.zeros(len(log.joints)), sides
    )


def in_ticks(log: Log, _: np.random.Generator) -> Log:
    """All joints in counts of an encoder with 4096 per turn."""
    count = len(log.joints)
    log = moved(log, range(count), np.full(count, 2048 / np.pi), np.full(count, 2048.0), "measured, command")
    told = log.signal == "position"
    whole = [
        replace(one, done=np.round(one.done), told=np.round(one.told) if told else one.told) for one in log.motions
    ]
    return replace(log, motions=tuple(whole))


def in_percent(log: Log, _: np.random.Generator) -> Log:
    """All joints from -100 to 100 of their range, or of a turn where there is none."""
    low, high = log.limits.T
    factor = 200.0 / (high - low)
    return moved(log, range(len(log.joints)), factor, -0.5 * (high + low) * factor, "measured, command")


def shifted(sides: str, far: Callable[[np.random.Generator], float]) -> Change:
    """The zero of one joint elsewhere."""
    return lambda log, rng: moved(log, [int(rng.integers(len(log.joints)))], np.ones(1), np.array([far(rng)]), sides)


def late(log: Log, rng: np.random.Generator) -> Log:
    """Stamps of commands by another clock."""
    by_s = rng.uniform(0.05, 0.15) * rng.choice([-1, 1])
    return replace(log, motions=tuple(replace(motion, told_s=motion.told_s + by_s) for motion in log.motions))


BOTH = "measured, command"
# Ways in which logs differ from what the model says; several are gone one after the other.
KINDS: Mapping[str, Sequence[Change]] = {
    "as it is": (),
    "renamed by number": (numbered(1),),
    "renamed by number from 0": (numbered(0),),
    "renamed in words": (in_words,),
    "permuted": (shuffled,),
    "permuted and without names": (numbered(1), shuffled),
    "mirrored": (mirrored(BOTH),),
    "mirrored measurement": (mirrored("measured"),),
    "mirrored command": (mirrored("command"),),
    "degrees": (in_degrees(BOTH),),
    "measured in degrees": (in_degrees("measured"),),
    "ticks": (in_ticks,),
    "percent": (in_percent,),
    "shifted by a quarter": (shifted(BOTH, lambda rng: float(rng.choice([-0.5, 0.5, 1.0]) * np.pi)),),
    "measurement shifted": (shifted("measured", lambda rng: float(rng.choice([-1, 1]) * rng.uniform(0.2, 1.2))),),
    "late": (late,),
    "renamed, in degrees, mirrored": (in_words, in_degrees(BOTH), mirrored("measured")),
}


def judged(meant: Log, model: Path, logs: Path, folder: Path) -> dict[str, Any]:
    """What is wrong with each column of a disturbed log as the draft has it read, and how long the draft took [s]."""
    began = time.monotonic()
    try:
        found = draft(model, logs, out=folder, ask=lambda _: True)
        plan = plan_import(logs, options=ImportOptions(mapping=folder / "mapping.yaml"))
        read = JointMap.from_dict(found.robot.joint_rules()).of_episode(plan.episodes[0].load())
    except TrueupError as error:
        wrong = {f"{name}, {side}": str(error)[:120] for name in meant.joints for side in ("measured", "command")}
        return {"columns": len(wrong), "wrong": wrong, "seconds": round(time.monotonic() - began, 2)}
    seconds, motion, wrong = time.monotonic() - began, meant.motions[0], {}
    rows = np.maximum(np.searchsorted(motion.told_s, motion.done_s + 1e-9, side="right") - 1, 0)
    for joint, name in enumerate(meant.joints):
        for side, series, signal, want in (
            ("measured", read.measured, "position", motion.done[:, joint]),
            ("command", read.command, meant.signal, motion.told[rows, joint]),
        ):
            if series is None or name not in series.joints or signal not in series:
                wrong[f"{name}, {side}"] = "not read"
            elif said := compared(
                series.select([name])[signal][:, 0], want, round(_LATE_S / float(np.diff(motion.done_s[:2])[0]))
            ):
                wrong[f"{name}, {side}"] = said
    return {"columns": 2 * len(meant.joints), "wrong": wrong, "seconds": round(seconds, 2)}


def compared(own: np.ndarray, want: np.ndarray, late: int) -> str:
    """What is wrong with a column, brought together in time by at most so many rows; empty if nothing is."""
    count = min(len(own), len(want))
    own, want = own[-count:], want[-count:]
    shifts = range(-late, late + 1)
    pairs = [(own[max(0, by) : count + min(0, by)], want[max(0, -by) : count + min(0, -by)]) for by in shifts]
    own, want = max(pairs, key=lambda pair: abs(np.corrcoef(*pair)[0, 1]))
    alike, span = float(np.corrcoef(own, want)[0, 1]), float(np.ptp(own) / np.ptp(want))
    if abs(alike) < _ALIKE:
        return f"joint (correlation {alike:.2f})"
    if alike < 0:
        return "sign"
    if abs(span - 1.0) > _SPAN:
        return f"unit ({span:.3g} times as large)"
    zero = float(np.median(own - want))
    return f"zero ({zero:.2f} away)" if abs(zero) > _SPAN * np.ptp(want) + _ZERO else ""


def rows(result: Mapping[str, Any]) -> list[Row]:
    """Figures of what is kept."""
    logs = result["logs"]
    columns, wrong = (sum(count(item) for item in logs.values()) for count in (_columns, _wrong))
    whole = sum(not item["wrong"] for item in logs.values())
    return [
        at_least(
            f"columns of {len(logs)} disturbed logs that are read as meant", 100 * (1 - wrong / columns), 95.0, "%"
        ),
        shown("logs of which every column is", 100 * whole / len(logs), "%"),
        at_most(f"init, {_MANY} motions of {ROBOTS[0]}", result["many_s"], _LONGEST_S, "s"),
    ]


def _columns(item: Mapping[str, Any]) -> int:
    return int(item["columns"])


def _wrong(item: Mapping[str, Any]) -> int:
    return len(item["wrong"])


def run() -> list[Row]:
    """Measure all, and keep it."""
    logs = _measured("")
    result = {
        "schema": "trueup.drafting/1",
        "logs": logs,
        "many_s": _of_many(),
        "provenance": provenance(config={}, seed=0),
    }
    write_json(RESULT, result)
    return rows(result)


def run_with(arguments: Sequence[str]) -> list[Row]:
    """Measure some, and keep nothing."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks drafting")
    parser.add_argument("--only", default="", metavar="TEXT", help="logs whose name, `ROBOT: KIND`, holds it")
    _measured(parser.parse_args(arguments).only)
    return []


def _measured(only: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as place:
        for name in ROBOTS:
            kinds = [kind for kind in KINDS if only in f"{name}: {kind}"]
            base = Path(place) / name
            if kinds:
                make(replace(_case(name), motions=MOTIONS), 0, base)
            for number, kind in enumerate(kinds):
                meant = log = Log.of(base, name)
                rng = np.random.default_rng(crc32(f"{name} {kind}".encode()))
                for change in KINDS[kind]:
                    log = change(log, rng)
                folder = base / f"{number}"
                log.write(folder / "logs")
                item = found[f"{name}: {kind}"] = judged(meant, base / "model.xml", folder / "logs", folder / "out")
                print(f"{name}: {kind}: {_columns(item) - _wrong(item)} of {_columns(item)}, {item['seconds']} s")
                for column, what in item["wrong"].items():
                    print(f"    {column}: {what}", flush=True)
    return found


def _of_many() -> float:
    """How long a draft from many motions takes [s]."""
    with tempfile.TemporaryDirectory() as place:
        base = Path(place)
        make(replace(_case(ROBOTS[0]), motions=MOTIONS), 0, base)
        log = Log.of(base, ROBOTS[0])
        replace(log, motions=log.motions * (_MANY // MOTIONS)).write(base / "many")
        began = time.monotonic()
        draft(base / "model.xml", base / "many", out=base / "out")
        return round(time.monotonic() - began, 2)


def _case(name: str) -> Any:
    return next(case for case in CASES if case.name == name)
