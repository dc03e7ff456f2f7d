"""Parts of a dataset, each replayed by a worker of a Ray cluster."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from trueup.align import JointMap
from trueup.core.episode import Episode
from trueup.core.ray_workers import on_ray, refuse_other_model
from trueup.core.timeseries import TimeSeries
from trueup.dataset import Dataset
from trueup.errors import TrueupError
from trueup.robots import RobotSpec, Setup

if TYPE_CHECKING:
    from trueup.sim import ReplaySettings

# Episodes of a part: a second or so of work; a worker that is killed loses little.
PART = 16

Replayed = list[tuple[str, "TimeSeries | TrueupError"]]


@dataclass(frozen=True)
class ReplayPart:
    """Some episodes in which the robot is the same, and all that decides about their replay.

    The hash is the fingerprint of its simulator, where the replay was asked for.
    """

    dataset: Path
    ids: tuple[str, ...]
    robot: RobotSpec
    model: Path
    engine: str
    model_sha256: str
    setup: Setup
    settings: ReplaySettings


def replayed_on_ray(
    parts: Iterable[ReplayPart], address: str, jobs: int | None
) -> Iterator[tuple[str, TimeSeries | TrueupError]]:
    """What became of each episode, in their order, whichever worker is done first.

    Those of Warp have a GPU each where the cluster has some, and are on processors where it has none.

    Args:
        parts: of a dataset that is on every machine of the cluster, in the same folder.
        address: of the cluster.
        jobs: parts at a time; as many as the cluster has processors if None.

    Raises:
        ConfigError: there is no such cluster, a worker was killed again and again, or has another model or engine.
    """
    numbered = list(enumerate(parts))
    early: dict[int, Replayed] = {}
    next_one = 0
    warp = any(part.engine == "warp" for _, part in numbered)
    done = on_ray(_replayed, numbered, address=address, jobs=jobs, gpu_if_there=warp, begin=_begin)
    for (number, _), results in done:
        early[number] = results
        while next_one in early:
            yield from early.pop(next_one)
            next_one += 1


def readable(
    dataset: Dataset, ids: Sequence[str], joint_map: JointMap, failed: dict[str, TrueupError]
) -> Iterator[Episode]:
    """The episodes that can be read, in the robot's joints; why the others cannot goes to `failed`."""
    for name in ids:
        try:
            yield joint_map.of_episode(dataset.episode(name))
        except TrueupError as error:
            failed[name] = error


def _begin() -> None:
    """Workers need nothing beforehand."""


def _replayed(item: tuple[int, ReplayPart]) -> Replayed:
    from trueup.sim import make_simulator, replay

    _, part = item
    simulator = make_simulator(part.engine, part.robot, part.model, setup=part.setup)
    refuse_other_model(part.model, simulator.fingerprint, part.model_sha256)
    joint_map = JointMap.from_dict(part.robot.joint_rules())
    failed: dict[str, TrueupError] = {}
    episodes = readable(Dataset(part.dataset), part.ids, joint_map, failed)
    results: Replayed = list(replay(episodes, simulator.clone, part.settings, jobs=1))
    return [*results, *failed.items()]
