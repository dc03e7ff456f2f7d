import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trueup.dataset import assign_splits, match_splits, read_split
from trueup.errors import ConfigError, DataError, FormatError

THIRDS = {"train": 0.6, "val": 0.2, "test": 0.2}


def test_reading(tmp_path):
    path = tmp_path / "split.json"
    path.write_text('{"train": ["a", "b.csv"], "test": []}')
    assert read_split(path) == {"train": ("a", "b.csv"), "test": ()}
    for text in ("[]", '{"train": "a"}', '{"train": [1]}', '{"trian": ["a"]}'):
        path.write_text(text)
        with pytest.raises(FormatError, match=r"split\.json"):
            read_split(path)
    path.write_text("{")
    with pytest.raises(DataError, match=r"split\.json"):
        read_split(path)


@pytest.mark.parametrize(
    ("entry", "id", "source"),
    [
        ("chirp", "chirp", ""),
        ("trajectory_00.csv", "trajectory_00", ""),
        ("trajectory_00", "trajectory_00.csv", ""),
        ("chirp", "session1/chirp", ""),
        ("session1/chirp.npz", "session1/chirp", ""),
        ("energy (data_1kg.csv)", "energy/data_1kg", ""),
        ("energy (data_1kg.csv)", "energy_1kg", "energy/data_1kg.csv"),
        ("energy", "energy_0", "energy/data.csv"),
        ("pd/system", "pd/system", "pd/system/data.csv"),
        ("v1.2", "v1.2", ""),
        ("./chirp/", "chirp", ""),
    ],
)
def test_spellings_of_an_entry(entry, id, source):
    ids = ["other", id, "another/one"]
    match = match_splits({"val": [entry]}, ids, sources={id: source})
    assert match.splits == {id: "val"}


def test_a_file_with_its_own_entry_leaves_its_folder():
    entries = {"train": ["energy", "pd/system"], "test": ["energy (data_1kg.csv)"]}
    ids = ["energy/data", "energy/data_1kg", "pd/system", "energy2/data"]
    match = match_splits(entries, ids)
    assert match.splits == {"energy/data": "train", "energy/data_1kg": "test", "pd/system": "train"}
    assert match.notes == ("1 of 4 episodes are in no split: energy2/data",)


def test_an_entry_of_blanks_takes_no_time():
    """Hours, if each of them were the beginning of a run of its own."""
    entry = "a" + " " * 1_000_000 + "b"
    assert match_splits({"train": [entry, "x  (a.csv)"]}, ["x/a"]).splits == {"x/a": "train"}


def test_what_does_not_match_is_said():
    match = match_splits({"train": ["a", "gone"], "val": ["also_gone.csv"]}, ["a", "b"])
    assert match.splits == {"a": "train"}
    assert len(match.notes) == 3
    assert "'gone'" in match.notes[0]
    assert match_splits({"train": ["gone"]}, ["a"]).splits == {}


def test_an_episode_in_two_splits_is_refused():
    with pytest.raises(DataError, match=r"in two splits.*'a' and 'test' by entry 'a\.csv'"):
        match_splits({"train": ["a"], "test": ["a.csv"]}, ["a"])
    with pytest.raises(DataError, match="several episodes"):
        match_splits({"train": ["data"]}, ["x/data", "y/data"])


def test_real_split_files(so101_logs, double_pendulum_logs, simple_pendulum_logs):
    motions = sorted(path.parent.name for path in so101_logs.glob("*/control.csv"))
    match = match_splits(read_split(so101_logs / "split.json"), motions)
    assert match.notes == ()
    assert [list(match.splits.values()).count(split) for split in ("train", "val", "test")] == [33, 4, 6]
    files = sorted(path.name for path in double_pendulum_logs.glob("*.csv"))
    match = match_splits(read_split(double_pendulum_logs / "split.json"), [name.removesuffix(".csv") for name in files])
    assert match.notes == ()
    assert match.splits["trajectory_13"] == "val"
    files = sorted(path.relative_to(simple_pendulum_logs) for path in simple_pendulum_logs.rglob("data_measured*.csv"))
    match = match_splits(
        read_split(simple_pendulum_logs / "split.json"), [path.with_suffix("").as_posix() for path in files]
    )
    assert match.notes == ()
    assert len(match.splits) == 6
    assert match.splits["control_method_energy_shaping/data_measured_1kg"] == "test"
    assert match.splits["control_method_energy_shaping/data_measured"] == "train"


@given(st.sets(st.text(min_size=1, max_size=6), min_size=3, max_size=60), st.integers(0, 2**40))
def test_every_episode_has_a_split_and_every_split_an_episode(ids, seed):
    splits = assign_splits(sorted(ids), THIRDS, seed=seed)
    assert set(splits) == ids
    assert set(splits.values()) == set(THIRDS)
    assert splits == assign_splits(sorted(ids, reverse=True), THIRDS, seed=seed)


@pytest.mark.parametrize(
    ("total", "counts"),
    [
        (3, (1, 1, 1)),
        (6, (4, 1, 1)),
        (7, (5, 1, 1)),
        (8, (6, 1, 1)),
        (10, (7, 2, 1)),
        (20, (14, 3, 3)),
        (43, (30, 7, 6)),
    ],
)
def test_as_many_as_the_shares_say(total, counts):
    ids = [f"motion_{number}" for number in range(total)]
    found = list(assign_splits(ids, {"train": 0.7, "val": 0.15, "test": 0.15}, seed=0).values())
    assert tuple(found.count(split) for split in ("train", "val", "test")) == counts


def test_shares_seeds_and_stability():
    ids = [f"motion_{number}" for number in range(4000)]
    splits = assign_splits(ids, THIRDS, seed=3)
    for split, share in THIRDS.items():
        assert abs(list(splits.values()).count(split) - share * 4000) <= 1
    more = assign_splits([*ids, "another"], THIRDS, seed=3)
    assert sum(more[id] != split for id, split in splits.items()) <= 2
    other = assign_splits(ids, THIRDS, seed=4)
    assert sum(splits[id] != other[id] for id in ids) > 1000
    assert set(assign_splits(ids, {"train": 1.0, "test": 0.0}, seed=0).values()) == {"train"}


@pytest.mark.parametrize(
    "fractions",
    [{}, {"train": 0.5}, {"train": 1.5, "val": -0.5}, {"train": 0.5, "holdout": 0.5}, {"train": float("nan")}],
)
def test_fractions_that_make_no_sense(fractions):
    with pytest.raises(ConfigError, match="fractions"):
        assign_splits(["a", "b", "c"], fractions, seed=0)
    with pytest.raises(ConfigError, match="too few"):
        assign_splits(["a", "b"], THIRDS, seed=0)


def test_a_split_file_of_what_was_drawn_reads_back(tmp_path):
    ids = [f"s{number % 3}/motion_{number}" for number in range(30)]
    splits = assign_splits(ids, THIRDS, seed=1)
    entries = {split: [id for id in ids if splits[id] == split] for split in THIRDS}
    (tmp_path / "split.json").write_text(json.dumps(entries))
    assert match_splits(read_split(tmp_path / "split.json"), ids).splits == splits
