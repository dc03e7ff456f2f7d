"""A replay in parts on a cluster is the replay in this process."""

import shutil

import numpy as np
import pytest

import trueup.stages.replay_parts as replay_parts
from trueup.dataset import Dataset, DatasetWriter
from trueup.errors import DataError
from trueup.robots import load_robot
from trueup.stages import demo_dataset, replay

ROBOT = load_robot("demo_arm")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    return demo_dataset(tmp_path_factory.mktemp("recorded") / "data")


def test_the_run_is_the_same(recorded, tmp_path, monkeypatch):
    monkeypatch.setattr("trueup.stages.replaying.PART", 5)  # three parts of twelve motions
    here, there = (Dataset(shutil.copytree(recorded, tmp_path / name)) for name in ("here", "there"))
    replay(here, ROBOT)
    done = replay(there, ROBOT, ray="local", jobs=2)
    assert (done.replayed, done.failed) == (12, {})
    assert there.run_ids("mujoco/stock") == here.run_ids("mujoco/stock")
    for name in here.ids:
        one, other = (item.episode(name, runs=["mujoco/stock"]).run("mujoco/stock") for item in (here, there))
        for signal in one.signals:
            np.testing.assert_array_equal(one[signal], other[signal])
    again = replay(there, ROBOT, ray="local", resume=True)
    assert (again.replayed, again.kept) == (0, 12)


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
