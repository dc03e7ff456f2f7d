import itertools
import json
import pickle

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import trueup.dataset
from dataset.store_cases import INFO, make_episode, make_series, same_episode, same_series
from trueup.core.episode import Episode, EpisodeMeta, Flag
from trueup.core.timeseries import TimeSeries
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter, append, is_dataset, shards, writer
from trueup.dataset.append import StoreWriter
from trueup.dataset.lock import FolderLock
from trueup.errors import ConfigError, DataError, FormatError, MissingSignal, NameMismatch, OutputExists


@pytest.fixture
def small_shards(monkeypatch):
    """Shards of four episodes."""
    monkeypatch.setattr(shards, "MAX_EPISODES", 4)
    monkeypatch.setattr(append, "MAX_PENDING", 4)


def write(path, episodes, **options):
    with DatasetWriter.create(path, INFO, **options) as writer:
        for episode in episodes:
            writer.append(episode)
    return Dataset(path)


def numbers_of_shards(path, series="measured"):
    return sorted(int(file.stem) for file in (path / series).glob("*.parquet"))


def test_public_names_are_there():
    assert all(hasattr(trueup.dataset, name) for name in trueup.dataset.__all__)


def test_episodes_come_back_as_they_were(tmp_path, small_shards):
    episodes = [make_episode(number, flagged=number % 3 == 0) for number in range(11)]
    episodes[5] = Episode(episodes[5].meta, episodes[5].measured)  # passive: no command
    dataset = write(tmp_path / "d", episodes)
    assert len(dataset) == 11
    assert dataset.ids == tuple(episode.id for episode in episodes)
    assert dataset.metas == tuple(episode.meta for episode in episodes)
    assert all(map(same_episode, dataset, episodes))
    for number in (10, 0, 7, 5, 6, -1):
        assert same_episode(dataset[number], episodes[number])
        assert same_episode(dataset[episodes[number].id], episodes[number])
    assert dataset[5].command is None
    assert "e003" in dataset
    assert "e099" not in dataset
    assert numbers_of_shards(tmp_path / "d") == [0, 1, 2]
    assert numbers_of_shards(tmp_path / "d", "command") == [0, 1, 2]
    assert not (tmp_path / "d" / "journal.bin").exists()


def test_a_dataset_of_before_there_were_settings_of_gains_is_read_and_gone_on_with(tmp_path):
    folder = tmp_path / "data"
    with DatasetWriter.create(folder, INFO) as writer:
        for number in range(3):
            writer.append(make_episode(number))
    path = folder / "episodes.parquet"
    table = pq.read_table(path)
    assert table.column("kp_setting").to_pylist() == [None, 100.0, 200.0]
    pq.write_table(table.drop_columns("kp_setting"), path)
    assert [meta.kp_setting for meta in Dataset(folder).metas] == [None] * 3
    with DatasetWriter.resume(folder) as writer:
        writer.append(make_episode(3))
    again = Dataset(folder)
    assert [meta.kp_setting for meta in again.metas] == [None, None, None, 300.0]
    assert again.meta("e003").kp_setting == 300.0
    pq.write_table(pq.read_table(path).drop_columns("payload_kg"), path)
    with pytest.raises(DataError):
        Dataset(folder)


def test_a_person_can_read_the_files(tmp_path):
    dataset = write(tmp_path / "d", [make_episode(0), make_episode(1)])
    file = pq.ParquetFile(tmp_path / "d" / "measured" / "00000.parquet")
    assert file.num_row_groups == 2
    assert file.schema_arrow.names == ["time_s", "position[pan]", "position[lift]", "torque[pan]", "torque[lift]"]
    np.testing.assert_array_equal(file.read_row_group(1)["torque[lift]"], make_series(1)["torque"][:, 1])
    rows = pq.read_table(tmp_path / "d" / "episodes.parquet").to_pylist()
    assert rows[1]["id"] == "e001"
    assert rows[1]["payload_kg"] == 0.5
    assert rows[1]["measured_samples"] == 20
    assert rows[1]["command_samples"] == 23
    assert rows[1]["duration_s"] == pytest.approx(19 * 0.02)
    assert rows[1]["rate_hz"] == pytest.approx(50)
    assert (rows[1]["measured_shard"], rows[1]["measured_group"]) == (0, 1)
    assert dataset.index.num_rows == 2


def test_info_learns_joints_and_units(tmp_path):
    dataset = write(tmp_path / "d", [make_episode(0)])
    assert dataset.info.joints == ("pan", "lift")
    assert dataset.info.units["position"] == {"pan": "rad", "lift": "rad"}
    assert dataset.info.units["command.torque"] == {"pan": "Nm", "lift": "Nm"}
    assert dataset.info.licence == INFO.licence
    assert dataset.info.notes == INFO.notes
    assert is_dataset(tmp_path / "d")
    assert not is_dataset(tmp_path)


def test_series_of_different_layouts_go_into_shards_of_their_own(tmp_path, small_shards):
    episodes = []
    for number in range(10):
        joints = ("pan", "lift") if number % 2 else ("pan", "lift", "jaw")
        episodes.append(Episode(EpisodeMeta(f"e{number}"), make_series(number, joints=joints)))
    dataset = write(tmp_path / "d", episodes)
    assert all(map(same_episode, dataset, episodes))
    assert dataset.info.joints == ("pan", "lift", "jaw")
    assert numbers_of_shards(tmp_path / "d", "command") == []


def test_one_flush_fills_several_shards(tmp_path, monkeypatch):
    monkeypatch.setattr(shards, "MAX_EPISODES", 4)
    dataset = write(tmp_path / "d", [make_episode(number) for number in range(9)])
    assert numbers_of_shards(tmp_path / "d") == [0, 1, 2]
    with DatasetWriter.resume(tmp_path / "d") as writer:
        for number in range(9, 18):
            writer.append(make_episode(number))
    # The last shard of the first part had one episode: it went into the first of the second.
    assert numbers_of_shards(tmp_path / "d") == [0, 1, 3, 4, 5]
    dataset.reload()
    assert all(same_episode(episode, make_episode(number)) for number, episode in enumerate(dataset))
    assert dataset.index.column("measured_group").to_pylist() == [0, 1, 2, 3] * 4 + [0, 1]


def test_shards_close_at_a_size_too(tmp_path, monkeypatch):
    monkeypatch.setattr("trueup.dataset.append.MAX_BYTES", 20_000)
    dataset = write(tmp_path / "d", [make_episode(number, samples=100) for number in range(10)])
    assert 3 <= len(numbers_of_shards(tmp_path / "d")) <= 6
    assert all(same_episode(episode, make_episode(number, samples=100)) for number, episode in enumerate(dataset))


def test_an_episode_a_day_is_no_file_a_day(tmp_path, monkeypatch):
    monkeypatch.setattr(shards, "MAX_EPISODES", 16)
    path = tmp_path / "d"
    for number in range(40):
        with DatasetWriter.resume(path, INFO) as writer:
            writer.append(make_episode(number))
    assert len(numbers_of_shards(path)) <= 6
    assert len(list((path / "measured").iterdir())) == len(numbers_of_shards(path))
    assert all(same_episode(episode, make_episode(number)) for number, episode in enumerate(Dataset(path)))


@settings(max_examples=8)
@given(st.sets(st.integers(0, 15), max_size=6))
def test_resuming_anywhere_gives_the_same_dataset(tmp_path_factory, stops):
    folder = tmp_path_factory.mktemp("resume")
    episodes = [make_episode(number, samples=3) for number in range(15)]
    whole = write(folder / "whole", episodes)
    cuts = [0, *sorted(stops), len(episodes)]
    for start, stop in itertools.pairwise(cuts):
        with DatasetWriter.resume(folder / "parts", INFO) as writer:
            assert writer.ids == {episode.id for episode in episodes[:start]}
            for episode in episodes[start:stop]:
                writer.append(episode)
    parts = Dataset(folder / "parts")
    assert parts.ids == whole.ids
    assert parts.hash == whole.hash
    assert parts.info == whole.info
    assert all(map(same_episode, parts, whole))


def test_the_hash_is_of_the_samples_not_of_the_order(tmp_path):
    episodes = [make_episode(number) for number in range(4)]
    first = write(tmp_path / "a", episodes)
    assert write(tmp_path / "b", episodes[::-1]).hash == first.hash
    assert write(tmp_path / "c", episodes[:3]).hash != first.hash
    before = first.hash
    first.set_splits({"e001": "test"})
    assert first.hash == before
    changed = [*episodes[:3], make_episode(30, id="e003")]
    assert write(tmp_path / "d", changed).hash != first.hash


def test_reading_while_writing(tmp_path, small_shards):
    path = tmp_path / "d"
    with DatasetWriter.create(path, INFO) as writer:
        assert len(Dataset(path)) == 0
        readers = []
        for number in range(10):
            writer.append(make_episode(number))
            readers.append(Dataset(path))
        for count, reader in enumerate(readers, start=1):
            assert len(reader) == count
            # The journals and shards that the early readers saw are gone by now.
            assert all(same_episode(episode, make_episode(number)) for number, episode in enumerate(reader))
    readers[2].reload()
    assert len(readers[2]) == 10


def test_a_reader_follows_a_merged_shard(tmp_path):
    path = tmp_path / "d"
    reader = write(path, [make_episode(0), make_episode(1)])
    with DatasetWriter.resume(path) as writer:
        writer.append(make_episode(2))
    assert numbers_of_shards(path) == [1]
    assert len(reader) == 2
    assert same_episode(reader[1], make_episode(1))


def test_one_writer_at_a_time(tmp_path):
    path = tmp_path / "d"
    with DatasetWriter.create(path, INFO) as writer:
        writer.append(make_episode(0))
        with pytest.raises(DataError, match="another process is writing"):
            DatasetWriter.resume(path)
        with pytest.raises(DataError, match="another process is writing"):
            DatasetWriter.create(path, INFO, overwrite=True)
        with pytest.raises(DataError, match="another process is writing"):
            Dataset(path).set_splits({"e000": "val"})
        writer.append(make_episode(1))
    assert len(Dataset(path)) == 2


def test_a_dataset_that_another_process_has_finished_meanwhile_is_kept(tmp_path, monkeypatch):
    path = tmp_path / "d"

    def meanwhile(folder):
        monkeypatch.undo()
        write(folder, [make_episode(0)])

    monkeypatch.setattr(writer, "make_folder", meanwhile)
    with pytest.raises(OutputExists, match="--resume"):
        DatasetWriter.create(path, INFO)
    assert Dataset(path).ids == ("e000",)


def test_nobody_comes_between_deleting_and_writing(tmp_path, monkeypatch):
    def looked_at(spec, lock=None):
        with pytest.raises(DataError, match="another process"):
            FolderLock(spec.folder)
        return StoreWriter(spec, lock)

    monkeypatch.setattr(writer, "StoreWriter", looked_at)
    write(tmp_path / "d", [make_episode(0)], overwrite=True)
    FolderLock(tmp_path / "d").release()


def test_what_append_refuses(tmp_path):
    with DatasetWriter.create(tmp_path / "d", INFO) as writer:
        writer.append(make_episode(0))
        with pytest.raises(DataError, match="there already"):
            writer.append(make_episode(0))
        for id in ("", "a b", "../x", "/x", "x/", "x/../y", "x//y", ".", "x\n"):
            with pytest.raises(DataError, match="no id"):
                writer.append(Episode(EpisodeMeta(id), make_series(0)))
        bad = Flag("odd")
        object.__setattr__(bad, "start_s", object())  # what no importer should do
        with pytest.raises(DataError, match="flags"):
            writer.append(Episode(EpisodeMeta("x", flags=(bad,)), make_series(0)))
        half = TimeSeries(np.arange(2.0), ("a",), {"position": np.zeros((2, 1), "f2")}, {"position": ("rad",)})
        with pytest.raises(DataError, match="float16"):
            writer.append(Episode(EpisodeMeta("x"), half))
        writer.append(Episode(EpisodeMeta("größe/1.b-c", source="caf\udce9.csv"), make_series(0)))
    with pytest.raises(DataError, match="closed"):
        writer.append(make_episode(9))
    dataset = Dataset(tmp_path / "d")
    assert dataset.ids == ("e000", "größe/1.b-c")
    assert dataset[1].meta.source == "caf?.csv"


def test_creating_over_something(tmp_path):
    precious = tmp_path / "home" / "thesis.tex"
    precious.parent.mkdir()
    precious.write_text("years of work")
    for overwrite in (False, True):
        with pytest.raises(OutputExists, match="no trueup dataset"):
            DatasetWriter.create(precious.parent, INFO, overwrite=overwrite)
        with pytest.raises(OutputExists):
            DatasetWriter.create(precious, INFO, overwrite=overwrite)
    with pytest.raises(FormatError, match="no trueup dataset"):
        DatasetWriter.resume(precious.parent, INFO)
    assert precious.read_text() == "years of work"

    (tmp_path / "empty").mkdir()
    write(tmp_path / "empty", [make_episode(0), make_episode(1)])
    with pytest.raises(OutputExists, match="--resume"):
        DatasetWriter.create(tmp_path / "empty", INFO)
    (tmp_path / "empty" / "my notes.md").write_text("mine")
    dataset = write(tmp_path / "empty", [make_episode(2)], overwrite=True)
    assert dataset.ids == ("e002",)
    assert same_episode(dataset[0], make_episode(2))
    assert (tmp_path / "empty" / "my notes.md").read_text() == "mine"


def test_overwriting_does_not_follow_links(tmp_path):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "precious").write_text("x")
    write(tmp_path / "d", [make_episode(0)])
    (tmp_path / "d" / "model").symlink_to(elsewhere)
    write(tmp_path / "d", [make_episode(1)], overwrite=True)
    assert (elsewhere / "precious").exists()
    assert not (tmp_path / "d" / "model").exists()


def test_a_part_of_a_dataset_that_is_a_link_is_not_written_through(tmp_path):
    write(tmp_path / "d", [make_episode(0)])
    (tmp_path / "d" / "measured").rename(tmp_path / "elsewhere")
    (tmp_path / "d" / "measured").symlink_to(tmp_path / "elsewhere")
    assert same_episode(Dataset(tmp_path / "d")[0], make_episode(0))
    with pytest.raises(DataError, match="leads out of"):
        DatasetWriter.resume(tmp_path / "d", INFO)


def test_resume_needs_the_same_robot(tmp_path):
    write(tmp_path / "d", [make_episode(0)])
    with pytest.raises(NameMismatch, match=r"other.*arm"):
        DatasetWriter.resume(tmp_path / "d", DatasetInfo(robot="other"))
    with pytest.raises(FormatError):
        DatasetWriter.resume(tmp_path / "nothing")


def test_select_splits_and_flags(tmp_path):
    dataset = write(tmp_path / "d", [make_episode(number, flagged=number in (1, 4)) for number in range(6)])
    with pytest.raises(MissingSignal, match="no split 'train'"):
        dataset.select(split="train")
    dataset.set_splits({"e000": "train", "e001": "train", "e002": "val", "e004": "test"})
    assert dataset.splits == {"e000": "train", "e001": "train", "e002": "val", "e004": "test"}
    assert dataset.metas[2].split == "val"
    assert dataset.select(split="train") == ("e000", "e001")
    assert dataset.select(split="train", drop_flagged=True) == ("e000",)
    assert dataset.select() == dataset.ids
    assert dataset.select(drop_flagged=True) == ("e000", "e002", "e003", "e005")
    dataset.set_flags(
        {"e001": (), "e002": [Flag("nan", detail="…", start_s=float("nan"))], "e003": [Flag("x", severity="note")]}
    )
    assert dataset.select(drop_flagged=True) == ("e000", "e001", "e003", "e005")
    assert Dataset(tmp_path / "d").metas[2].flags[0].detail == "…"
    dataset.set_splits({"e000": ""})
    assert "e000" not in dataset.splits
    assert [episode.id for episode in dataset.episodes(dataset.select(split="train"))] == ["e001"]
    assert all(same_series(episode.measured, make_series(number)) for number, episode in enumerate(dataset))
    with pytest.raises(ConfigError, match="holdout"):
        dataset.set_splits({"e000": "holdout"})
    for change in (dataset.set_splits, dataset.set_flags):
        with pytest.raises(MissingSignal, match="e077"):
            change({"e077": ""})


def test_unknown_names_list_the_known_ones(tmp_path):
    dataset = write(tmp_path / "d", [make_episode(0)])
    for ask in (lambda: dataset["e9"], lambda: dataset.meta("e9"), lambda: dataset.episode("e9")):
        with pytest.raises(MissingSignal, match=r"no episode 'e9'.*e000"):
            ask()
    with pytest.raises(MissingSignal, match="no run 'mujoco/stock'"):
        dataset.episode("e000", runs=["mujoco/stock"])
    with pytest.raises(IndexError):
        dataset[1]


def test_a_dataset_travels_and_reopens(tmp_path):
    dataset = write(tmp_path / "d", [make_episode(0)])
    there = pickle.loads(pickle.dumps(dataset))
    assert same_episode(there[0], make_episode(0))
    dataset.close()
    assert same_episode(dataset[0], make_episode(0))


def test_an_error_in_the_block_keeps_what_was_finished(tmp_path):
    def interrupted():
        with DatasetWriter.create(tmp_path / "d", INFO) as writer:
            writer.append(make_episode(0))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert same_episode(Dataset(tmp_path / "d")[0], make_episode(0))


def test_the_index_is_json_free_of_python(tmp_path):
    flag = Flag("gap", end_s=np.float64(1.5))
    object.__setattr__(flag, "start_s", np.float32(0.5))  # easily taken from a float32 clock
    write(tmp_path / "d", [Episode(EpisodeMeta("x", payload_kg=np.float64(0.5), flags=(flag,)), make_series(0))])
    row = pq.read_table(tmp_path / "d" / "episodes.parquet").to_pylist()[0]
    assert json.loads(row["flags"])[0]["start_s"] == 0.5
    assert Dataset(tmp_path / "d").meta("x").payload_kg == 0.5
