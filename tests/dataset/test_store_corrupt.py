"""Files that a disk, a sync tool or a person has damaged: a clear error, or the right values; never anything else."""

import json
import random
import shutil

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from dataset.store_cases import INFO, make_episode, make_series, same_episode
from trueup.dataset import Dataset, DatasetWriter, RunWriter
from trueup.dataset.journal import Journal, JournalReader, pack, unpack
from trueup.dataset.writer import dataset_spec
from trueup.errors import DataError, FormatError, TrueupError

EPISODES = 4


@pytest.fixture(scope="module")
def pristine(tmp_path_factory):
    """Three episodes in shards, one in the journal of a dead writer, and a run."""
    path = tmp_path_factory.mktemp("pristine") / "d"
    with DatasetWriter.create(path, INFO) as writer:
        for number in range(EPISODES - 1):
            writer.append(make_episode(number, flagged=True))
    with RunWriter(path, "mujoco/stock", run_info={"x": 1}) as run:
        run.append("e000", make_series(50))
    writer = DatasetWriter.resume(path)
    writer.append(make_episode(EPISODES - 1, flagged=True))
    writer._store._lock.release()
    return path


@pytest.fixture
def path(pristine, tmp_path):
    return shutil.copytree(pristine, tmp_path / "d")


def read_everything(path):
    dataset = Dataset(path)
    dataset.metas, dataset.hash, dataset.splits  # noqa: B018
    episodes = {episode.id: episode for episode in dataset}
    for label in dataset.runs:
        dataset.run_info(label)
        for id in dataset.run_ids(label):
            dataset.episode(id, runs=[label])
    return episodes


def files_of(path):
    return sorted(file for file in path.rglob("*") if file.is_file() and file.stat().st_size)


def test_the_pristine_one_is_fine(path):
    assert len(read_everything(path)) == EPISODES
    assert len(files_of(path)) == 8


def damage(data, draw):
    """One of the things that happen to files."""
    kind = draw.randrange(6)
    position = draw.randrange(len(data))
    if kind == 0:
        return data[:position]
    if kind == 1:
        return bytes(draw.randbytes(len(data)))
    if kind == 2:
        return data[:position] + bytes(min(512, len(data) - position)) + data[position + 512 :]
    if kind == 3:
        return data + draw.randbytes(20)
    changed = bytearray(data)
    for _ in range(1 if kind == 4 else 8):
        # Footers and headers are at the ends: look there more often.
        place = draw.choice([position, draw.randrange(max(0, len(data) - 900), len(data))])
        changed[place] ^= 1 << draw.randrange(8)
    return bytes(changed)


@pytest.mark.parametrize("seed", range(4))
def test_no_damage_gives_other_values_or_other_errors(path, pristine, seed):
    draw = random.Random(seed)
    refused = 0
    files = files_of(path)
    for _ in range(80):
        file = draw.choice(files)
        original = file.read_bytes()
        file.write_bytes(damage(original, draw))
        try:
            episodes = read_everything(path)
        except TrueupError as error:
            refused += 1
            said = str(error)
        else:
            said = str(path)
            # A torn end of the journal takes its last episode along; the others are what they were.
            lost = {"e003"} if file.name == "journal.bin" else set()
            assert {f"e{number:03d}" for number in range(EPISODES)} - set(episodes) <= lost
            for id, episode in episodes.items():
                if file.name != "dataset.json":
                    assert same_episode(episode, make_episode(int(id[1:]), flagged=True))
        assert str(path) in said
        file.write_bytes(original)
    assert refused > 40
    assert len(read_everything(path)) == EPISODES


def replace_index(path, change):
    """Rewrite the index with other rows, all checksums right."""
    spec = dataset_spec(path)
    table = pq.read_table(spec.index_path)
    rows = table.to_pylist()
    change(rows)
    pq.write_table(pa.Table.from_pylist(rows, schema=table.schema), spec.index_path)


@pytest.mark.parametrize(
    "changes",
    [
        {"measured_shard": 77},
        {"measured_shard": -1},
        {"measured_shard": None},
        {"measured_group": 1},
        {"measured_group": 99},
        {"measured_group": -1},
        {"measured_samples": 10**12},
        {"measured_samples": None},
        {"command_shard": None},
        {"hash": "0" * 64},
        {"flags": "{"},
        {"flags": '[{"odd": 1}]'},
        {"id": "e001"},
        {"id": "../../x"},
        {"id": "/home/u/data"},
        {"id": "a/./b"},
        {"id": ""},
    ],
)
def test_an_index_that_lies_is_found_out(path, changes):
    replace_index(path, lambda rows: rows[0].update(changes))
    with pytest.raises(DataError, match="damaged"):
        read_everything(path)


def test_missing_files(path):
    for name in ("measured/00000.parquet", "command/00000.parquet", "episodes.parquet", "dataset.json"):
        shutil.move(path / name, path / "aside")
        with pytest.raises((DataError, FormatError), match=path.name) as caught:
            read_everything(path)
        assert caught.value.hint
        shutil.move(path / "aside", path / name)
    assert len(read_everything(path)) == EPISODES


def test_a_lost_index_costs_no_shards(path):
    (path / "episodes.parquet").rename(path / "aside")
    before = [file.name for file in files_of(path)]
    with pytest.raises(DataError, match="index is missing"):
        DatasetWriter.resume(path, INFO)
    (path / "journal.bin").rename(path / "journal.aside")
    with pytest.raises(DataError, match="index is missing"):
        DatasetWriter.resume(path, INFO)
    assert len(files_of(path)) == len(before)
    (path / "journal.aside").rename(path / "journal.bin")
    (path / "aside").rename(path / "episodes.parquet")
    assert len(read_everything(path)) == EPISODES


def test_files_of_another_dataset_are_found_out(path, tmp_path):
    with DatasetWriter.create(tmp_path / "other", INFO) as writer:
        for number in range(3):
            writer.append(make_episode(number + 7))
    shutil.copy(tmp_path / "other" / "measured" / "00000.parquet", path / "measured" / "00000.parquet")
    with pytest.raises(DataError, match="not what was written"):
        read_everything(path)


def test_another_version_of_index_or_run(path):
    file = path / "episodes.parquet"
    table = pq.read_table(file)
    pq.write_table(table.replace_schema_metadata({"trueup": "trueup.index/9"}), file)
    with pytest.raises(FormatError, match=r"trueup\.index/9"):
        Dataset(path)
    pq.write_table(table.drop_columns(["hash"]), file)
    with pytest.raises(DataError, match=r"episodes\.parquet"):
        Dataset(path)
    pq.write_table(table, file)
    (path / "simulated" / "mujoco" / "stock" / "run.json").write_text(json.dumps({"schema": "trueup.run/9"}))
    with pytest.raises(FormatError, match=r"trueup\.run/9"):
        Dataset(path).run_info("mujoco/stock")


@pytest.mark.parametrize(
    "change",
    [
        {"series": ["x"]}, {"series": []}, {"duration_s": None}, {"measured_samples": "many"}, {"robot": 1},
        {"id": "../x"}, {"id": "/home/u/data"},
    ],
)  # fmt: skip
def test_a_journal_that_lies_is_found_out(path, change):
    """Its checksums are right: whoever wrote it knew how."""
    row, tables = unpack(
        next(JournalReader(path / "journal.bin").frames(salvage=False)).payload, ["measured", "command"]
    )
    pieces = pack({**row, "series": list(tables)} | change, tables)
    if "series" in change:
        text = json.dumps({**row, **change}).encode()
        pieces = [len(text).to_bytes(4, "little"), text, *pieces[2:]]
    journal = Journal(path / "journal.bin")
    journal.append(pieces)
    for use in (read_everything, DatasetWriter.resume):
        with pytest.raises(DataError, match=r"journal|index"):
            use(path)
