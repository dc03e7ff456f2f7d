"""Unitree's `LowState` and `LowCmd`: what the motors of a Go1, Go2, B2 or G1 report, and what they are told.

Motors have numbers, not names, and messages no stamps. All messages of a type have their numbers at the same places, so
that many are decoded at a time: a minute of a G1 at 500 Hz takes 0.4 s, and 2.9 s in the bag library alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from trueup.core.episode import Flag
from trueup.dataset.importers.bagtypes import LOW_COMMANDS
from trueup.dataset.importers.samples import Samples
from trueup.errors import ConfigError, DataError

# In the order of the motors; names are those of Unitree's own models.
QUADRUPED = tuple(f"{leg}_{part}_joint" for leg in ("FR", "FL", "RR", "RL") for part in ("hip", "thigh", "calf"))
_LEG = ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")
_ARM = ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow", "wrist_roll", "wrist_pitch", "wrist_yaw")
HUMANOID = (
    *(f"{side}_{part}_joint" for side in ("left", "right") for part in _LEG),
    *(f"waist_{axis}_joint" for axis in ("yaw", "roll", "pitch")),
    *(f"{side}_{part}_joint" for side in ("left", "right") for part in _ARM),
)
_WHOSE = {"unitree_go": ("a Go1, Go2 or B2", QUADRUPED), "unitree_hg": ("a G1", HUMANOID)}
# Behind the legs, a Go2-W and a B2-W have a motor for each wheel. An H1 says more, in an order of its own.
_WHEELS = slice(12, 16)
# A G1 has both joints on both sides, or, with 23 joints, on none. An H1-2 has other joints at these places.
_WRISTS = ((20, 21), (27, 28))

_SEEN = {"position": "q", "velocity": "dq", "torque": "tau_est"}
_TOLD = ("q", "dq", "tau", "kp", "kd")
_BLOCK = 8192


def named_for(kind: str) -> str:
    """Whose joints the motors of messages of this type are taken for."""
    return _WHOSE[kind.partition("/")[0]][0]


@dataclass(frozen=True, eq=False)
class Motors:
    """What a topic says.

    Attributes:
        samples: of all messages; none if it says nothing.
        flags: what was left out, and the gains that were sent.
        kp_setting: the position gain [Nm/rad] that was sent to all joints all the time; None if there is no such.
    """

    samples: list[Samples]
    flags: tuple[Flag, ...] = ()
    kp_setting: float | None = None


class MotorDecoder:
    """Decodes a topic of `LowState` or `LowCmd`, block by block.

    Args:
        types: those of the bag.
        kind: type of the messages.
        source: file and topic, for error messages.
        ros1: whether the bytes are ROS 1's, which have no encapsulation header and no alignment.
        joints: names of the motors from the first on, as the user stated them; Unitree's order if there are none.
    """

    def __init__(self, types: Typestore, kind: str, source: str, *, ros1: bool, joints: Sequence[str] = ()) -> None:
        self._source, self._header, self._told = source, 0 if ros1 else 4, kind in LOW_COMMANDS
        self._robot, names = _WHOSE[kind.partition("/")[0]]
        places: dict[str, tuple[str, int]] = {}
        self._size = _walk(types, (Nodetype.NAME, kind), "", self._header, places, aligned=not ros1)
        part, fields = ("motor_cmd", _TOLD) if self._told else ("motor_state", tuple(_SEEN.values()))
        self._motors = sum(f"/{part}/{number}/q" in places for number in range(len(places)))
        self._starts = {
            field: np.array([places[f"/{part}/{number}/{field}"][1] for number in range(self._motors)])
            for field in fields
        }
        if len(joints) > self._motors:
            raise ConfigError(
                f"{source}: more joints are stated than there are motors", got=len(joints), expected=self._motors
            )
        self._stated, self._names = bool(joints), tuple(joints) or names
        self._raws: list[bytes] = []
        self._logs: list[int] = []
        self._blocks: list[dict[str, Float32[np.ndarray, "N M"]]] = []

    def push(self, log_ns: int, raw: bytes) -> None:
        """Add one message.

        Raises:
            DataError: it is longer or shorter than its type, or encoded in another way.
        """
        # CDR may be padded to a multiple of four bytes.
        if not self._size <= len(raw) <= self._size + (3 if self._header else 0):
            raise DataError(
                f"message {len(self._logs) + 1} of {self._source} is damaged, or of another version",
                got=f"{len(raw)} bytes",
                expected=self._size,
            )
        if self._header and raw[:2] != b"\x00\x01":
            raise DataError(f"{self._source} is not little-endian CDR", got=raw[:2].hex(), expected="0001")
        self._raws.append(raw)
        self._logs.append(log_ns)
        if len(self._raws) == _BLOCK:
            self._decode_block()

    def samples(self, names: Sequence[str]) -> Motors:
        """All messages pushed so far.

        Args:
            names: of the measured joints; what is told to others is left out of commands, if any of them are told.

        Raises:
            ConfigError: the motors that report something are not those of the robots that are known.
        """
        if self._raws:
            self._decode_block()
        if not self._blocks:
            return Motors([])
        values = {field: np.concatenate([block[field] for block in self._blocks]) for field in self._starts}
        log_ns = np.array(self._logs, dtype=np.int64)
        return self._commanded(values, log_ns, names) if self._told else self._measured(values, log_ns)

    def _decode_block(self) -> None:
        raws, self._raws = self._raws, []
        matrix = np.frombuffer(b"".join(raw[: self._size] for raw in raws), dtype=np.uint8)
        matrix = matrix.reshape(len(raws), self._size)
        bytes_of = {field: starts[:, np.newaxis] + np.arange(4) for field, starts in self._starts.items()}
        self._blocks.append(
            {
                field: np.ascontiguousarray(matrix[:, index]).view("<f4")[..., 0].astype(np.float32)
                for field, index in bytes_of.items()
            }
        )

    def _measured(self, values: dict[str, Float32[np.ndarray, "N M"]], log_ns: Int64[np.ndarray, "N"]) -> Motors:
        live = np.any([np.any(own != 0, axis=0) for own in values.values()], axis=0)
        if not live.any():
            return Motors([])
        if not self._stated:
            self._refuse_others(live)
        taken = [number for number in range(len(self._names)) if self._stated or live[number]]
        detail = f"motors of {self._source} are named in the order "
        detail += "that was stated" if self._stated else f"that Unitree has for {self._robot}"
        silent = [number for number in range(self._motors) if not live[number] and number not in taken]
        beyond = [number for number in range(self._motors) if live[number] and number not in taken]
        detail += f"; left out since they report nothing: {_ranges(silent)}" if silent else ""
        detail += f"; left out since they have no name: {_ranges(beyond)}" if beyond else ""
        signals = {signal: values[field][:, taken].astype(np.float64) for signal, field in _SEEN.items()}
        samples = _samples([self._names[number] for number in taken], log_ns, signals)
        return Motors([samples], (Flag(kind="motors", detail=detail, severity="note"),))

    def _refuse_others(self, live: Bool[np.ndarray, "M"]) -> None:
        """Refuse robots that have their motors in an order of their own: their joints would get wrong names."""
        if self._names == QUADRUPED:
            others = bool(live[_WHEELS.stop :].any())
        else:
            left, right = (bool(live[list(motors)].any()) for motors in _WRISTS)
            others = left != right or bool(live[len(HUMANOID) :].any())
        if others:
            raise ConfigError(
                f"{self._source}: the motors are not those of {self._robot}",
                got=f"motors {_ranges(np.flatnonzero(live).tolist())} report something",
                hint="State their names in the file given with --mapping, from motor 0 on: `joints: [name0, ...]`.",
            )

    def _commanded(
        self, values: dict[str, Float32[np.ndarray, "N M"]], log_ns: Int64[np.ndarray, "N"], names: Sequence[str]
    ) -> Motors:
        told = (values["kp"] != 0) | (values["kd"] != 0) | (values["tau"] != 0)
        taken = [number for number in range(len(self._names)) if told[:, number].any()]
        known = [number for number in taken if self._names[number] in names]
        taken = known or taken
        if not taken:
            detail = f"{self._source} tells the motors nothing: all gains and torques are zero"
            return Motors([], (Flag(kind="gains", series="command", detail=detail),))
        active = np.flatnonzero(told[:, taken].any(axis=1))
        rows = slice(int(active[0]), int(active[-1]) + 1)
        own = {field: values[field][rows][:, taken] for field in _TOLD}
        joints = [self._names[number] for number in taken]
        signals = _signals(own)
        gains, kp_setting = _gains(own, joints)
        flags = [*gains, *_beside(own), *_changing(signals, joints)]
        if idle := len(log_ns) - (rows.stop - rows.start):
            detail = f"{idle} messages that tell the motors nothing, before or after the motion, were left out"
            flags.append(Flag(kind="gains", series="command", detail=detail, severity="note"))
        return Motors([_samples(joints, log_ns[rows], signals)], tuple(flags), kp_setting)


def _samples(
    joints: Sequence[str], log_ns: Int64[np.ndarray, "N"], signals: dict[str, Float64[np.ndarray, "N J"]]
) -> Samples:
    return Samples(tuple(joints), np.arange(log_ns.size), np.zeros_like(log_ns), log_ns, signals)


def _signals(own: dict[str, Float32[np.ndarray, "N J"]]) -> dict[str, Float64[np.ndarray, "N J"]]:
    """What each joint follows: NaN where it follows something else, or nothing."""
    position = own["kp"] != 0
    velocity = ~position & (own["kd"] != 0)
    free = ~position & ~velocity
    torque = free & np.any(free & (own["tau"] != 0), axis=0)
    follows = {"position": ("q", position), "velocity": ("dq", velocity), "torque": ("tau", torque)}
    return {
        signal: np.where(where, own[field], np.nan).astype(np.float64)
        for signal, (field, where) in follows.items()
        if where.any()
    }


def _gains(own: dict[str, Float32[np.ndarray, "N J"]], joints: Sequence[str]) -> tuple[list[Flag], float | None]:
    """The gains of each joint, and the position gain that all have all the time."""
    groups: dict[str, list[str]] = {}
    moving: list[str] = []
    every: set[float] = set()
    for number, joint in enumerate(joints):
        on = (own["kp"][:, number] != 0) | (own["kd"][:, number] != 0)
        if not on.any():
            continue
        said = []
        for name in ("kp", "kd"):
            # As they were written: 0.3, not the float32 next to it.
            found = [float(str(value)) for value in np.unique(own[name][on, number])]
            said.append(f"{name} {found[0]:g}" + (f" to {found[-1]:g}" if len(found) > 1 else ""))
            every |= set(found) if name == "kp" else set()
        changes = any(" to " in words for words in said)
        groups.setdefault(", ".join(said), []).append(joint)
        moving += [joint] if changes else []
    if not groups:
        return [], None
    detail = "gains that were sent: "
    detail += "; ".join(f"{said} ({_some(group, of=joints)})" for said, group in groups.items())
    setting = every.pop() if len(every) == 1 else None
    if moving:
        detail += "; they change within the motion, which a model with one gain does not follow: cut the motion there"
    elif not setting and own["kp"].any():
        detail += "; kp_setting says none, since it holds for all joints"
    severity = "warning" if moving else "note"
    return [Flag(kind="gains", series="command", detail=detail, severity=severity)], setting or None


def _beside(own: dict[str, Float32[np.ndarray, "N J"]]) -> list[Flag]:
    """What was told beside what a joint follows, and is left out."""
    served = (own["kp"] != 0) | (own["kd"] != 0)
    found = {
        "torques of up to {} Nm": np.abs(own["tau"][served]),
        "velocities of up to {} rad/s": np.abs(own["dq"][(own["kp"] != 0) & (own["kd"] != 0)]),
    }
    said = [text.format(f"{values.max():.3g}") for text, values in found.items() if values.size and values.max() > 0]
    if not said:
        return []
    detail = f"the drives were also told {' and '.join(said)}, which the command does not have"
    return [Flag(kind="gains", series="command", detail=detail, severity="note")]


def _changing(signals: dict[str, Float64[np.ndarray, "N J"]], joints: Sequence[str]) -> list[Flag]:
    """Joints that follow one signal, and then another."""
    follows = np.array([np.isfinite(values).any(axis=0) for values in signals.values()])
    flags = []
    for number in np.flatnonzero(follows.sum(axis=0) > 1).tolist():
        own = [name for name, has in zip(signals, follows[:, number], strict=True) if has]
        detail = f"it was told {' and '.join(own)} within one motion: cut the motion there"
        flags.append(Flag(kind="gains", series="command", joint=joints[number], detail=detail))
    return flags


def _some(names: Sequence[str], *, of: Sequence[str]) -> str:
    return "all joints" if len(names) == len(of) else ", ".join(names)


def _ranges(numbers: Sequence[int]) -> str:
    """Such as `0 to 11, 15`."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    return ", ".join(str(run[0]) if len(run) == 1 else f"{run[0]} to {run[-1]}" for run in runs)


def _walk(
    types: Typestore, node: Any, path: str, position: int, places: dict[str, tuple[str, int]], *, aligned: bool
) -> int:
    """Where the numbers of a message of fixed length are.

    Args:
        types: those of the bag.
        node: a type, as the bag library has it.
        path: of this part, `/motor_state/3/q`.
        position: of its first byte.
        places: path -> kind of number and position; is added to.
        aligned: whether numbers are aligned to their size, counted from the encapsulation header's end.

    Returns:
        The position after it.
    """
    tag, value = node
    if tag == Nodetype.NAME:
        for name, child in types.fielddefs[value][1]:
            position = _walk(types, child, f"{path}/{name}", position, places, aligned=aligned)
        return position
    if tag == Nodetype.ARRAY:
        for number in range(value[1]):
            position = _walk(types, value[0], f"{path}/{number}", position, places, aligned=aligned)
        return position
    size = int(np.dtype(value[0]).itemsize)
    if aligned:
        position = 4 + -(-(position - 4) // size) * size
    places[path] = (value[0], position)
    return position + size
