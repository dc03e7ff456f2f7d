"""The motions of a dataset in the robot's names, by split, and why others cannot be used."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from trueup.align import JointMap
from trueup.core.episode import Episode
from trueup.dataset import Dataset
from trueup.errors import DataError, MissingSignal, TrueupError
from trueup.robots import RobotSpec
from trueup.stages.importing import checked


@dataclass(frozen=True)
class Motions:
    """What a dataset has to fit and to judge by.

    Attributes:
        by_split: split -> motions.
        refused: split -> motion -> why it cannot be used.
    """

    by_split: dict[str, list[Episode]]
    refused: dict[str, dict[str, str]]


def readable(
    dataset: Dataset, robot: RobotSpec, ids: Iterable[str], signal: str
) -> tuple[list[Episode], dict[str, TrueupError]]:
    """Episodes in the robot's names that command a signal, and why others are none.

    Where the robot's description states other units than the dataset, the quality of a recording is looked at anew.
    """
    joint_map = JointMap.from_dict(robot.joint_rules())
    other_units = any(rule.log_unit or rule.scale != 1.0 for rule in joint_map.rules)
    found, refused = [], {}
    for name in ids:
        try:
            stored = dataset.episode(name)
            episode = joint_map.of_episode(checked(stored, robot) if other_units else stored)
            _ = episode.commanded()[signal]
        except TrueupError as error:
            refused[name] = error
            continue
        found.append(episode)
    return found, refused


def motions_of(dataset: Dataset, robot: RobotSpec) -> Motions:
    """The motions of a dataset that have a split; without any split all are `train`.

    A motion that cannot be brought into the robot's names, or has no command that the robot follows, is left out if
    others can be used.

    Raises:
        MissingSignal: no motion is in train.
        DataError: no motion of a split is there.
        TrueupError: no motion of train can be used; what is wrong with the first.
    """
    assigned = {name: split for name, split in dataset.splits.items() if split} or dict.fromkeys(dataset.ids, "train")
    if "train" not in assigned.values():
        raise MissingSignal("the dataset has no train split to fit", available=sorted(set(assigned.values())))
    found: dict[str, list[Episode]] = {}
    refused: dict[str, dict[str, str]] = {}
    for split in dict.fromkeys(assigned.values()):
        ids = [name for name in dataset.ids if assigned.get(name) == split]
        own, errors = readable(dataset, robot, ids, robot.controller.signal)
        if split == "train" and not own:
            raise next(iter(errors.values()), DataError("the dataset has no episode in the train split"))
        if own:
            found[split] = own
        if errors:
            refused[split] = {name: error.summary for name, error in errors.items()}
    return Motions(found, refused)
