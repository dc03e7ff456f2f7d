import pytest

from dataset.store_cases import INFO, make_episode, make_series, same_episode, same_series
from trueup.core.episode import Episode
from trueup.dataset import Dataset, DatasetWriter, RunWriter, shards
from trueup.errors import ConfigError, DataError, FormatError, MissingSignal, OutputExists

RUN_INFO = {"engine": "mujoco", "joints": {"pan": "shoulder_pan"}}


@pytest.fixture
def path(tmp_path):
    with DatasetWriter.create(tmp_path / "d", INFO) as writer:
        for number in range(6):
            writer.append(make_episode(number))
    return tmp_path / "d"


def simulated(number):
    return make_series(100 + number, samples=5, joints=("shoulder_pan", "shoulder_lift"))


def run(path, label, numbers, **options):
    with RunWriter(path, label, run_info=RUN_INFO, **options) as writer:
        for number in numbers:
            writer.append(f"e{number:03d}", simulated(number))


def test_runs_come_back_with_their_episodes(path):
    run(path, "mujoco/stock", [3, 0])
    run(path, "mujoco/fitted+realeasy", range(6))
    dataset = Dataset(path)
    assert dataset.runs == ("mujoco/fitted+realeasy", "mujoco/stock")
    assert dataset.run_info("mujoco/stock") == RUN_INFO
    assert dataset.run_ids("mujoco/stock") == ("e003", "e000")
    episode = dataset.episode("e003", runs=dataset.runs)
    assert same_series(episode.run("mujoco/stock"), simulated(3))
    assert same_series(episode.measured, make_series(3))
    assert dataset["e003"].simulated == {}
    with pytest.raises(MissingSignal, match=r"no episode 'e001'.*e003, e000"):
        dataset.episode("e001", runs=["mujoco/stock"])
    with pytest.raises(MissingSignal, match=r"no run 'dart/stock'.*mujoco/stock"):
        dataset.run_info("dart/stock")


def test_overwrite_and_resume(path, monkeypatch):
    monkeypatch.setattr(shards, "MAX_EPISODES", 2)
    run(path, "mujoco/stock", range(5))
    dataset = Dataset(path)
    assert same_series(dataset.episode("e001", runs=["mujoco/stock"]).run("mujoco/stock"), simulated(1))
    with pytest.raises(OutputExists, match="--resume"):
        run(path, "mujoco/stock", [])
    with RunWriter(path, "mujoco/stock", run_info={}, resume=True) as writer:
        assert writer.ids == {f"e{number:03d}" for number in range(5)}
        with pytest.raises(DataError, match="there already"):
            writer.append("e000", simulated(0))
        writer.append("e005", simulated(5))
        with pytest.raises(DataError, match="another process"):
            RunWriter(path, "mujoco/stock", run_info={}, overwrite=True)
    assert dataset.run_info("mujoco/stock") == RUN_INFO
    assert len(dataset.run_ids("mujoco/stock")) == 6
    with RunWriter(path, "mujoco/stock", run_info={"new": 1}, overwrite=True) as writer:
        writer.append("e001", simulated(77))
    # A dataset that is open follows.
    assert dataset.run_info("mujoco/stock") == {"new": 1}
    assert same_series(dataset.episode("e001", runs=["mujoco/stock"]).run("mujoco/stock"), simulated(77))
    run(path, "mujoco/late", [0], resume=True)
    assert len(dataset.runs) == 2


def test_a_run_is_seen_while_it_is_written(path):
    dataset = Dataset(path)
    with RunWriter(path, "mujoco/stock", run_info={}) as writer:
        writer.append("e001", simulated(1))
        assert dataset.run_ids("mujoco/stock") == ("e001",)
        assert same_series(dataset.episode("e001", runs=["mujoco/stock"]).run("mujoco/stock"), simulated(1))
        writer.append("e002", simulated(2))
        assert dataset.run_ids("mujoco/stock") == ("e001", "e002")


def test_what_a_run_refuses(path, tmp_path):
    for label in ("", "..", "a/../b", "/etc", "a//b", "a/", "a b", "x..y", ".hidden", "a/b/c/d", "ä", "a\nb"):
        with pytest.raises(ConfigError, match="no label"):
            RunWriter(path, label, run_info={})
    with RunWriter(path, "mujoco/stock", run_info={}) as writer, pytest.raises(MissingSignal, match="e077"):
        writer.append("e077", simulated(0))
    for label in ("mujoco", "mujoco/stock/again"):
        with pytest.raises(ConfigError, match="inside another"):
            RunWriter(path, label, run_info={})
    with pytest.raises(ConfigError, match="JSON"):
        RunWriter(path, "mujoco/odd", run_info={"x": object()})
    with pytest.raises(FormatError):
        RunWriter(tmp_path / "nothing", "mujoco/stock", run_info={})
    assert Dataset(path).runs == ("mujoco/stock",)


def test_overwriting_a_run_touches_nothing_else(path):
    run(path, "mujoco/stock", range(6))
    notes = path / "simulated" / "mujoco" / "stock" / "notes.md"
    notes.write_text("mine")
    run(path, "mujoco/stock", [1], overwrite=True)
    dataset = Dataset(path)
    assert notes.read_text() == "mine"
    assert all(same_episode(episode, make_episode(number)) for number, episode in enumerate(dataset))


def test_episodes_bring_their_runs(tmp_path):
    episodes = [
        Episode(made.meta, made.measured, made.command, {"mujoco/stock": simulated(number)} if number else {})
        for number, made in ((number, make_episode(number)) for number in range(3))
    ]
    with DatasetWriter.create(tmp_path / "d", INFO) as writer:
        for episode in episodes:
            writer.append(episode)
    dataset = Dataset(tmp_path / "d")
    assert dataset.runs == ("mujoco/stock",)
    assert same_episode(dataset.episode("e002", runs=dataset.runs), episodes[2])
    assert dataset.run_ids("mujoco/stock") == ("e001", "e002")
