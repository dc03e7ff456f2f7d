"""A replay in parts on a cluster is the replay in this process."""

import dataclasses
import shutil

import numpy as np
import pytest

import trueup.stages.replay_parts as replay_parts
from core.ray_cases import NEEDS_RAY, QUIET, local_cluster, one_worker_killed
from trueup.dataset import Dataset, DatasetWriter
from trueup.errors import DataError
from trueup.robots import load_robot
from trueup.stages import demo_dataset, replay

pytestmark = QUIET
ROBOT = load_robot("demo_arm")
# Its replay takes long enough for a worker to be killed in the middle.
FINE = dataclasses.replace(ROBOT, simulation=dataclasses.replace(ROBOT.simulation, timestep_s=4e-4))


@pytest.fixture(scope="module")
def cluster():
    """Its workers are started once."""
    with local_cluster():
        yield


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    return demo_dataset(tmp_path_factory.mktemp("recorded") / "data")


def same_runs(one, other):
    """Bit by bit."""
    assert one.run_ids("mujoco/stock") == other.run_ids("mujoco/stock") == one.ids
    for name in one.ids:
        left, right = (item.episode(name, runs=["mujoco/stock"]).run("mujoco/stock") for item in (one, other))
        for signal in left.signals:
            np.testing.assert_array_equal(left[signal], right[signal])


@NEEDS_RAY
def test_the_run_is_the_same(recorded, tmp_path, monkeypatch, cluster):
    monkeypatch.setattr("trueup.stages.replaying.PART", 5)  # three parts of twelve motions
    here, there = (Dataset(shutil.copytree(recorded, tmp_path / name)) for name in ("here", "there"))
    replay(here, ROBOT)
    done = replay(there, ROBOT, ray="local", jobs=2)
    assert (done.replayed, done.failed) == (12, {})
    same_runs(here, there)
    again = replay(there, ROBOT, ray="local", resume=True)
    assert (again.replayed, again.kept) == (0, 12)


@NEEDS_RAY
@pytest.mark.slow
def test_a_worker_that_is_killed_loses_nothing(recorded, tmp_path, monkeypatch, cluster):
    """Its part is replayed by another one, and stored in its place."""
    monkeypatch.setattr("trueup.stages.replaying.PART", 1)
    here, there = (Dataset(shutil.copytree(recorded, tmp_path / name)) for name in ("here", "there"))
    replay(here, FINE)
    arrived = []

    def track(items, what, total=None):
        for item in items:
            arrived.append(item[0])
            yield item

    with one_worker_killed(lambda: arrived) as killed:
        done = replay(there, FINE, ray="local", jobs=2, track=track)
    assert killed
    assert (done.replayed, done.failed) == (12, {})
    same_runs(here, there)


def test_an_episode_that_cannot_be_read_is_listed_and_the_others_are_there(recorded, tmp_path, monkeypatch):
    """Parts come in any order; what is stored is in the dataset's."""
    parts = []

    def backwards(work, items, **_):
        parts.extend(items)
        return ((item, work(item)) for item in reversed(parts))

    monkeypatch.setattr(replay_parts, "on_ray", backwards)
    monkeypatch.setattr("trueup.stages.replaying.PART", 4)
    source = Dataset(recorded)
    with DatasetWriter.create(tmp_path / "data", source.info) as writer:
        for name in source.ids:
            writer.append(source.episode(name))
    data = Dataset(tmp_path / "data")
    monkeypatch.setattr(Dataset, "episode", _broken(Dataset.episode, source.ids[5]))
    done = replay(data, ROBOT, ray="somewhere")
    assert len(parts) == 3
    assert list(done.failed) == [source.ids[5]]
    assert data.run_ids("mujoco/stock") == tuple(name for name in source.ids if name != source.ids[5])


def _broken(read, name):
    def episode(self, id, **options):
        if id == name:
            raise DataError("a shard is damaged")
        return read(self, id, **options)

    return episode
