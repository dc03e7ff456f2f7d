"""Which joint of a model a name in a log means."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from scipy.optimize import linear_sum_assignment

How = Literal["name", "number", "order"]

_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")
# Words that joints, links and drives all have in their names.
_PLAIN = frozenset(
    (
        "joint",
        "jnt",
        "link",
        "motor",
        "servo",
        "actuator",
        "axis",
        "dof",
        "dxl",
        "id",
        "robot",
        "state",
        "states",
        "j",
        "q",
    )
)
# Other words for the same, as makers of arms, hands and legs have them.
_MEANINGS: Mapping[tuple[str, ...], tuple[str, ...]] = {
    ("yaw",): ("pan", "rotation", "rotate", "waist", "azimuth", "base", "basis", "turntable", "y"),
    ("pitch",): ("lift", "flex", "flexion", "tilt", "elevation", "p"),
    ("gripper",): ("jaw", "finger", "claw", "grasp", "greifer", "pince"),
    ("shoulder",): ("sh", "shldr", "schulter", "epaule"),
    ("elbow",): ("el", "elb", "ellbogen", "coude"),
    ("wrist",): ("wr", "wri", "handgelenk", "poignet"),
    ("knee",): ("calf", "kfe", "shank", "kn"),
    ("hip", "pitch"): ("thigh", "hfe"),
    ("hip", "roll"): ("haa", "abad"),
    ("ankle",): ("ank", "foot"),
    ("left",): ("l",),
    ("right",): ("r",),
    ("rear",): ("hind", "back"),
    ("front", "left"): ("fl", "lf"),
    ("front", "right"): ("fr", "rf"),
    ("rear", "left"): ("rl", "lh", "hl", "lr", "bl"),
    ("rear", "right"): ("rr", "rh", "hr", "br"),
}
_SAME = {word: meaning for meaning, words in _MEANINGS.items() for word in words}
_SIDES = frozenset(("left", "right", "front", "rear"))
# Of the words of both names together, the share that a match has at least, and its lead over any other.
_MOST_BEHIND = 2  # numbered names more than the model has joints, which are those of a gripper
_LEAST, _LEAD = 0.45, 0.08


@dataclass(frozen=True)
class Matching:
    """Joints and the names that logs have for them.

    Attributes:
        pairs: joint of the model -> name in the log.
        how: joint -> whether names, numbers in them, or only their order said so.
        strangers: names in the log that no joint of the model has.
        missing: joints of the model of which the log knows nothing.
    """

    pairs: dict[str, str] = field(default_factory=dict)
    how: dict[str, How] = field(default_factory=dict)
    strangers: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()


def match_names(log: Sequence[str], model: Sequence[str]) -> Matching:
    """Joints of a model for the names of a log, each once.

    Rows of numbered names that begin with another number than the model's (`joint_0` to `joint_6` for `joint_1` to
    `joint_7`) come first. Then come names that are the same but for letters' case, and names of the same words, where
    what all names of a side have in front or behind does not count (`panda_joint1`, `fr3_joint1`, `q1`), nor do words
    such as joint and motor; then names with most words in common. Names that are only numbered are matched by their
    numbers, and where nothing matches and there are as many of both, by their order.
    """
    pairs: dict[str, str] = {}
    how: dict[str, How] = {}

    def take(found: Iterable[tuple[str, str]], way: How) -> None:
        for joint, name in found:
            pairs[joint], how[joint] = name, way

    def left() -> tuple[list[str], list[str]]:
        used = set(pairs.values())
        return [name for name in log if name not in used], [joint for joint in model if joint not in pairs]

    take(_counted_otherwise(log, model), "number")
    names, joints = left()
    lower = {name.lower(): name for name in names}
    if len(lower) == len(names):
        take([(joint, lower[joint.lower()]) for joint in joints if joint.lower() in lower], "name")
    names, joints = left()
    if names and joints:
        take(_alike(names, joints, log, model), "name")
    names, joints = left()
    if names and joints:
        take(_numbered(names, joints), "number")
    names, joints = left()
    if names and len(names) == len(joints) and (not pairs or len(names) == 1):
        take(zip(joints, names, strict=True), "order")
    elif (
        not pairs and _MOST_BEHIND >= len(names) - len(joints) > 0 and len(joints) > 2 and _rows(names) == [list(names)]
    ):
        take(zip(joints, names, strict=False), "order")  # what is behind the joints of an arm is its gripper
    names, joints = left()
    return Matching(pairs, how, tuple(names), tuple(joints))


def _alike(
    names: Sequence[str], joints: Sequence[str], log: Sequence[str], model: Sequence[str]
) -> list[tuple[str, str]]:
    """Pairs whose words agree most, none of which could as well be another."""
    said, known = _words(log), _words(model)
    alike = np.array([[_likeness(known[joint], said[name]) for name in names] for joint in joints])
    rows, columns = linear_sum_assignment(-alike)
    found = []
    for row, column in zip(rows.tolist(), columns.tolist(), strict=True):
        if alike[row, column] < _LEAST:
            continue
        # The same words for two joints: which of them is meant is not said.
        twins = [other for other in joints if other != joints[row] and known[other] == known[joints[row]]]
        rivals = [other for other in names if other != names[column] and said[other] == said[names[column]]]
        if not twins and not rivals and _leads(alike, row, column, rows.tolist(), columns.tolist()):
            found.append((joints[row], names[column]))
    return found


def _leads(alike: np.ndarray, row: int, column: int, rows: list[int], columns: list[int]) -> bool:
    """Whether nobody who is left over, and no exchange with another pair, would be about as good."""
    own = alike[row, column]
    spare_rows = [other for other in range(alike.shape[0]) if other not in rows]
    spare_columns = [other for other in range(alike.shape[1]) if other not in columns]
    if max((*alike[spare_rows, column], *alike[row, spare_columns]), default=0.0) > own - _LEAD:
        return False
    return all(
        alike[row, there] + alike[other, column] <= own + alike[other, there] - _LEAD
        for other, there in zip(rows, columns, strict=True)
        if other != row
    )


def _likeness(one: frozenset[str], other: frozenset[str]) -> float:
    """Words in common, as a share of those of both; numbers have to agree."""
    numbers = [{word for word in words if word.isdigit()} for words in (one, other)]
    if numbers[0] and numbers[1] and numbers[0] != numbers[1]:
        return 0.0
    sides = [words & _SIDES for words in (one, other)]
    if sides[0] != sides[1] and sides[0] and sides[1]:
        return 0.0
    if not (one - numbers[0]) & (other - numbers[1]):
        return 0.0
    return len(one & other) / len(one | other)


def _without_accents(name: str) -> str:
    return "".join(sign for sign in unicodedata.normalize("NFKD", name) if not unicodedata.combining(sign))


def _words(names: Sequence[str]) -> dict[str, frozenset[str]]:
    """Of each name, without what all of them have in front and behind."""
    split = {name: [word.lower() for word in _WORD.findall(_without_accents(name))] for name in names}
    lists = list(split.values())
    front = _common(lists) if len(lists) > 1 else 0
    behind = _common([words[::-1] for words in lists]) if len(lists) > 1 else 0
    found = {}
    for name, words in split.items():
        own = words[front : len(words) - behind] or words
        own = [word for word in own if word not in _PLAIN] or own
        # Leading zeros are a matter of style.
        found[name] = frozenset(
            same for word in own for same in _SAME.get(word, (str(int(word)) if word.isdigit() else word,))
        )
    return found


def _common(lists: Sequence[Sequence[str]]) -> int:
    """How many words all lists begin with; numbers, by which joints are told apart, do not count at the end of them."""
    count = 0
    for words in zip(*lists, strict=False):
        if len(set(words)) > 1 or set(_SAME.get(words[0], words[:1])) & _SIDES:
            break
        count += 1
    return min(count, min(len(words) for words in lists) - 1) if lists else 0


def _numbered(names: Sequence[str], joints: Sequence[str]) -> list[tuple[str, str]]:
    """Pairs by the last number in both, counted from the smallest: of names that differ in nothing else.

    A row of joints that is numbered through takes the only row of names with as many numbers.
    """
    said, known = _rows(names), _rows(joints)
    found = []
    for row in known:
        fitting = [own for own in said if len(own) == len(row)]
        if len(fitting) == 1 and sum(len(own) == len(row) for own in known) == 1:
            found += list(zip(row, fitting[0], strict=True))
    return found


def _counted_otherwise(names: Sequence[str], joints: Sequence[str]) -> list[tuple[str, str]]:
    """Pairs of two rows that only their first number tells apart."""
    found = []
    for row in _rows(joints):
        plain = {re.sub(r"\d+", "", name.lower()) for name in row}
        fitting = [own for own in _rows(names) if {re.sub(r"\d+", "", name.lower()) for name in own} == plain]
        if len(fitting) == 1 and len(fitting[0]) == len(row) and fitting[0][0].lower() != row[0].lower():
            found += list(zip(row, fitting[0], strict=True))
    return found


def _rows(names: Sequence[str]) -> list[list[str]]:
    """Names that only a number tells apart, in its order, without gaps."""
    rows: dict[tuple[str, ...], dict[int, str]] = {}
    for name in names:
        words = _WORD.findall(name)
        last = next((place for place in range(len(words) - 1, -1, -1) if words[place].isdigit()), None)
        if last is not None:
            rows.setdefault((*words[:last], "", *words[last + 1 :]), {})[int(words[last])] = name
    ordered = [[own[number] for number in sorted(own)] for own in rows.values() if max(own) - min(own) == len(own) - 1]
    return [row for row in ordered if len(row) > 1]
