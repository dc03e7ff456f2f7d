"""A replay in parts on a cluster is the replay in this process."""

import dataclasses
import shutil
from pathlib import Path

import numpy as np
import pytest

import trueup.stages.replay_parts as replay_parts
from core.ray_cases import NEEDS_RAY, QUIET, local_cluster, one_worker_killed
from trueup.dataset import Dataset, DatasetWriter
from trueup.errors import ConfigError, DataError
from trueup.robots import PayloadSpec, Setup, find_model, load_robot
from trueup.sim import ReplaySettings
from trueup.stages import replay
from trueup.stages.replay_parts import ReplayPart, replayed_on_ray

pytestmark = QUIET
ROBOT = load_robot("demo_arm")
# Its replay takes long enough for a worker to be killed in the middle.
FINE = dataclasses.replace(ROBOT, simulation=dataclasses.replace(ROBOT.simulation, timestep_s=4e-4))


@pytest.fixture(scope="module")
def cluster():
    """Its workers are started once."""
    with local_cluster():
        yield


def same_runs(one, other):
    """Bit by bit."""
    assert one.run_ids("mujoco/stock") == other.run_ids("mujoco/stock") == one.ids
    for name in one.ids:
        left, right = (item.episode(name, runs=["mujoco/stock"]).run("mujoco/stock") for item in (one, other))
        for signal in left.signals:
            np.testing.assert_array_equal(left[signal], right[signal])


@pytest.mark.long
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


def test_a_worker_with_another_model_is_refused(recorded, tmp_path, monkeypatch):
    """Its motions would be stored as those of the model that the command was given."""
    data = Dataset(shutil.copytree(recorded, tmp_path / "data"))
    model, older = tmp_path / "arm.xml", tmp_path / "older.xml"
    text = find_model(ROBOT).read_text()
    model.write_text(text)
    older.write_text(text.replace('mass="0.4"', 'mass="0.5"'))

    def there(work, items, **_):
        for item in items:
            if data.runs:  # the first part is that of a worker which has the same
                item = (item[0], dataclasses.replace(item[1], model=older))
            yield item, work(item)

    monkeypatch.setattr(replay_parts, "on_ray", there)
    monkeypatch.setattr("trueup.stages.replaying.PART", 4)
    with pytest.raises(ConfigError, match=r"the model that .* makes of .*older\.xml is not that of the command"):
        replay(data, ROBOT, model=model, ray="somewhere")
    assert data.run_ids("mujoco/stock") == data.ids[:4]


def test_a_model_with_a_payload_and_a_mesh_is_the_same_there(recorded, tmp_path, monkeypatch):
    """The command is given its path from where it is, a worker the whole path, which MuJoCo keeps of meshes."""

    def there(work, items, **_):
        return ((item, work(item)) for item in items)

    monkeypatch.setattr(replay_parts, "on_ray", there)
    monkeypatch.chdir(tmp_path)
    text = (
        find_model(ROBOT)
        .read_text()
        .replace(' pos="0.22 0 0">', ' pos="0.22 0 0"><site name="tool"/><geom type="mesh" mesh="a"/>')
    )
    Path("arm.xml").write_text(text.replace("<worldbody>", '<asset><mesh name="a" file="a.obj"/></asset><worldbody>'))
    Path("a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    robot = dataclasses.replace(ROBOT, payload=PayloadSpec(("tool",)))
    with DatasetWriter.create("data", Dataset(recorded).info) as writer:
        for number, name in enumerate(Dataset(recorded).ids[:2]):
            episode = Dataset(recorded).episode(name)
            writer.append(
                dataclasses.replace(episode, meta=dataclasses.replace(episode.meta, payload_kg=float(number)))
            )
    assert replay(Dataset("data"), robot, model=Path("arm.xml"), ray="somewhere").replayed == 2


def test_parts_of_warp_ask_for_a_gpu(monkeypatch):
    asked = []

    def there(*_, gpu_if_there, **__):
        asked.append(gpu_if_there)
        return iter(())

    monkeypatch.setattr(replay_parts, "on_ray", there)
    for engine in ("warp", "mujoco"):
        part = ReplayPart(Path("data"), (), ROBOT, Path("arm.xml"), engine, "", Setup(), ReplaySettings.of(ROBOT))
        assert list(replayed_on_ray([part], "somewhere", None)) == []
    assert asked == [True, False]
