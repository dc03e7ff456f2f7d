"""What decides about the results of a close: a call that goes on from an earlier one must ask for the same."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trueup.core.atomic import json_hash
from trueup.dataset import Dataset, read_split
from trueup.errors import OutputExists
from trueup.robots import RobotSpec
from trueup.stages.replaying import carried_kg, kp_factors
from trueup.stages.robot_model import model_file

if TYPE_CHECKING:
    from trueup.identify import IdentifyConfig

# How it is called by people, and what they give for it.
_WORDS = {
    "config": "configuration (--config)",
    "robot": "robot (--robot)",
    "model": "model (--model)",
    "data": "data or splits",
    "carried": "payload of motions (payload_kg)",
    "gains": "setting of position gains (kp_setting)",
    "splits": "splits (--splits)",
    "seed": "seed (--seed)",
    "drop_flagged": "choice of motions (--drop-flagged)",
    "metrics": "metrics",
}
# These can be read; of the others there are hashes.
_PLAIN = ("seed", "drop_flagged")


def asked_beforehand(
    robot: RobotSpec,
    config: IdentifyConfig | None,
    *,
    seed: int,
    drop_flagged: bool | None,
    metrics: Sequence[str] | None,
    splits: Path | Mapping[str, float] | None,
) -> dict[str, Any]:
    """What is known before any data are read. The time is no part of it, and other methods add networks.

    Raises:
        DataError: the file of the splits cannot be read.
        FormatError: it is none.
    """
    from trueup.identify import IdentifyConfig

    return {
        "config": json_hash((config or IdentifyConfig()).to_json()),
        "robot": json_hash(robot.to_dict()),
        "seed": seed,
        "drop_flagged": drop_flagged,
        "metrics": None if metrics is None else list(metrics),
        "splits": json_hash(read_split(splits) if isinstance(splits, Path) else splits),
    }


def asked_of_data(dataset: Dataset, robot: RobotSpec, model: Path | None) -> dict[str, Any]:
    """What is known when there is a dataset.

    Raises:
        ConfigError: there is no model.
    """
    from trueup.sim import MujocoSimulator

    path = model_file(robot, dataset, given=model)
    return {
        "data": json_hash([dataset.hash, dict(dataset.splits)]),
        "carried": json_hash(carried_kg(dataset, robot)),
        "gains": json_hash(kp_factors(dataset, robot)),
        "model": MujocoSimulator.from_robot(robot, path).fingerprint,
    }


def refuse_other(folder: Path, earlier: Mapping[str, Any], asked: Mapping[str, Any]) -> None:
    """Refuse to go on from results that were asked for otherwise.

    Raises:
        OutputExists: something is not the same.
    """
    changed = [name for name in asked if name in earlier and earlier[name] != asked[name]]
    if changed:
        plain = [name for name in changed if name in _PLAIN]
        raise OutputExists(
            f"{folder} holds what a close made with another {' and another '.join(_WORDS[name] for name in changed)}",
            got=", ".join(f"{name} {asked[name]}" for name in plain) or None,
            expected=", ".join(f"{name} {earlier[name]}" for name in plain) or None,
            hint="Resume with what the first call was given, give --overwrite to begin anew, or choose another --out.",
        )
