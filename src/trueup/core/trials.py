"""Trained policies side by side: what their configurations have in common, and which differ in nothing but the seed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trueup.core.atomic import json_hash
from trueup.core.policy_card import PolicyCard
from trueup.errors import ConfigError

# The key that stands for the name of a policy's folder, without its seed.
FOLDER = "folder"
_ENDS = "-_. "


@dataclass(frozen=True)
class Trial:
    """A trained policy.

    Attributes:
        label: name of its folder.
        seed: of its training.
        kind: what it shares with those that were trained like it but for the seed; see `PolicyCard.provenance`.
        config: flattened key, such as `learner.gamma`, -> value; and `folder`.
        history: its rounds, see `policy.training.Round`.
    """

    label: str
    seed: int
    kind: str
    config: Mapping[str, Any]
    history: tuple[Mapping[str, int | float], ...] = ()

    @staticmethod
    def of(card: PolicyCard, folder: Path) -> Trial:
        """What a card says of its training.

        Cards say in `alike` what a training was made from, all but name and seed. One that does not is like others
        with its configuration whose folders have its name, but for the seed at its end.
        """
        stored = card.provenance
        seed, config = int(stored.get("seed") or 0), stored.get("config", {})
        label = folder.resolve().name
        stem = without_seed(label, seed)
        own = {FOLDER: stem, **flattened(config)}
        if begun := own.get("start"):
            own["start"] = without_seed(Path(begun).name, seed)
        kind = str(stored.get("alike") or json_hash([stem, card.robot, config]))
        return Trial(label, seed, kind, own, tuple(stored.get("history", ())))


@dataclass(frozen=True)
class TrialGroup:
    """Policies that do not differ in what is asked about.

    Attributes:
        title: what they have in common and others have not, in words.
        members: numbers of their trials.
    """

    title: str
    members: tuple[int, ...]


def without_seed(name: str, seed: int) -> str:
    """`reach` of `reach-3`, where 3 is the seed."""
    bare = name.removesuffix(str(seed))
    return (bare.rstrip(_ENDS) if bare != name and bare.endswith(tuple(_ENDS)) else name) or name


def flattened(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested keys joined by points: `{"learner": {"gamma": 1}}` is `{"learner.gamma": 1}`."""
    found: dict[str, Any] = {}
    for key, value in tree.items():
        found |= flattened(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {prefix + key: value}
    return found


def differing_keys(trials: Sequence[Trial]) -> list[str]:
    """The keys of the configurations that have several values, or are not in all; without `folder`."""
    keys = dict.fromkeys(key for trial in trials for key in trial.config if key != FOLDER)
    return [key for key in keys if len({_words(trial.config, key) for trial in trials}) > 1]


def grouped(trials: Sequence[Trial], by: Sequence[str] = ()) -> list[TrialGroup]:
    """Trials by what they have in common, in the order in which they come.

    Args:
        trials: at least one.
        by: keys of the configurations whose values make the groups. If there are none, each group was trained alike but
            for the seed, and is called by the keys that differ; by its folders where they do not tell it, as with
            another model of the robot.

    Raises:
        ConfigError: no configuration has a key.
    """
    known = list(dict.fromkeys(key for trial in trials for key in trial.config))
    if unknown := [key for key in by if key not in known]:
        raise ConfigError("--by", got=", ".join(unknown), available=known)
    if by:
        names = short_names(by, known)
        groups = _rows([[_words(trial.config, key) for key in by] for trial in trials])
        return [TrialGroup(_title(names, values), tuple(rows)) for values, rows in groups.items()]
    parts = list(_rows([[trial.kind] for trial in trials]).values())
    firsts = [trials[rows[0]] for rows in parts]
    keys = differing_keys(trials)
    for chosen in (keys, [FOLDER], [FOLDER, *keys]):
        names = short_names(chosen, known)
        titles = [_title(names, [_words(trial.config, key) for key in chosen]) for trial in firsts]
        if all(titles) and len(set(titles)) == len(titles):
            break
    return [TrialGroup(title, tuple(rows)) for title, rows in zip(unlike(titles), parts, strict=True)]


def alike(trials: Sequence[Trial]) -> list[TrialGroup]:
    """Trials that share everything but their seed; each group is called like its folders, no two the same."""
    parts: list[list[int]] = []
    for rows in _rows([[trial.kind] for trial in trials]).values():
        # The same seed twice is the same policy twice, or another one: either way, not a further draw.
        different = len({trials[row].seed for row in rows}) == len(rows)
        parts += [rows] if different else [[row] for row in rows]
    titles = [trials[part[0]].config[FOLDER] if len(part) > 1 else trials[part[0]].label for part in parts]
    return [TrialGroup(title, tuple(part)) for title, part in zip(unlike(titles), parts, strict=True)]


def unlike(names: Sequence[str]) -> list[str]:
    """The names, with numbers behind those that were there before."""
    found: list[str] = []
    for name in names:
        number, free = 2, name
        while free in found:
            free, number = f"{name} ({number})", number + 1
        found.append(free)
    return found


def short_names(keys: Sequence[str], known: Sequence[str]) -> dict[str, str]:
    """Key -> the last part of its name, or all of it in words where another key ends alike."""
    last = [key.rpartition(".")[2] for key in known]
    return {
        key: (leaf if last.count(leaf := key.rpartition(".")[2]) == 1 else key).replace(".", " ").replace("_", " ")
        for key in keys
    }


def _rows(marks: Sequence[Sequence[str]]) -> dict[tuple[str, ...], list[int]]:
    """Marks -> the rows that have them."""
    found: dict[tuple[str, ...], list[int]] = {}
    for row, own in enumerate(marks):
        found.setdefault(tuple(own), []).append(row)
    return found


def _title(names: Mapping[str, str], values: Sequence[str]) -> str:
    """`tqc, gamma 0.95`: names that say what they are stand alone."""
    alone = (FOLDER, "algorithm")
    return ", ".join(
        value if key in alone else f"{name} {value}" for (key, name), value in zip(names.items(), values, strict=True)
    )


def _words(config: Mapping[str, Any], key: str) -> str:
    value = config.get(key)
    if value is None or value == "":
        return "none"
    if isinstance(value, (list, tuple)):
        return " to ".join(map(_number, value)) if len(value) == 2 else " × ".join(map(_number, value))
    return _number(value)


def _number(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
