"""The units of a fleet: a part of a dataset is what the whole says now, and nothing of others is touched."""

import os
from dataclasses import replace

import pytest

from dataset.store_cases import INFO, make_episode
from trueup.core.close_result import CLOSE_NAME
from trueup.core.episode import Flag
from trueup.dataset import Dataset, DatasetWriter
from trueup.errors import ConfigError, FormatError, OutputExists
from trueup.stages import robot_model
from trueup.stages.fleet_units import TRACEBACK, units_of


def written(path, units=("u1", "u2"), *, info=INFO, changed=lambda episode: episode):
    """Two motions of each unit."""
    with DatasetWriter.create(path, info, overwrite=True) as writer:
        for number, unit in enumerate(unit for unit in units for _ in range(2)):
            episode = make_episode(number)
            writer.append(changed(replace(episode, meta=replace(episode.meta, unit=unit))))
    return path


def taken(paths, out, *, model=None, overwrite=False):
    return units_of(paths, out, model=model, overwrite=overwrite)


def other_samples(episode):
    signals = {**episode.measured.signals, "position": 2 * episode.measured["position"]}
    return replace(episode, measured=replace(episode.measured, signals=signals))


CHANGES = {
    "samples": lambda path: written(path, changed=other_samples),
    "splits": lambda path: Dataset(path).set_splits({"e000": "test"}),
    "flags": lambda path: Dataset(path).set_flags({"e001": [Flag("gap")]}),
    "payload": lambda path: written(path, changed=lambda one: replace(one, meta=replace(one.meta, payload_kg=3.0))),
    "fewer": lambda path: written(path, changed=lambda one: replace(one, meta=replace(one.meta, id="n" + one.meta.id))),
}


@pytest.mark.parametrize("change", CHANGES)
def test_what_has_changed_is_taken_anew_or_refused_where_results_were_made_of_it(tmp_path, change):
    path, out = written(tmp_path / "data"), tmp_path / "out"
    first = taken([path], out)
    assert [(unit.name, unit.data, unit.reason) for unit in first] == [
        ("u1", out / "u1" / "dataset", ""),
        ("u2", out / "u2" / "dataset", ""),
    ]
    before = Dataset(out / "u1" / "dataset")
    assert taken([path], out) == first
    (out / "u1" / CLOSE_NAME).write_text("{}")
    assert taken([path], out) == first  # nothing has changed
    CHANGES[change](path)
    one, other = taken([path], out)
    assert "other motions of 'u1'" in one.reason
    assert other.reason == ""
    now = Dataset(out / "u1" / "dataset")
    assert (now.hash, now.metas) == (before.hash, before.metas)
    (out / "u1" / CLOSE_NAME).unlink()
    assert taken([path], out) == first
    whole, now = Dataset(path), Dataset(out / "u1" / "dataset")
    assert [whole.episode(name).meta for name in now.ids] == list(now.metas)
    assert len(now) == 2


def test_more_motions_and_a_part_that_is_broken_are_for_the_close_to_judge(tmp_path):
    path, out = written(tmp_path / "data"), tmp_path / "out"
    taken([path], out)
    (out / "u1" / CLOSE_NAME).write_text("{}")
    with DatasetWriter.resume(path) as writer:
        episode = make_episode(9)
        writer.append(replace(episode, meta=replace(episode.meta, unit="u1")))
    assert [unit.reason for unit in taken([path], out)] == ["", ""]
    assert len(Dataset(out / "u1" / "dataset")) == 3
    (out / "u1" / "dataset" / "episodes.parquet").write_bytes(b"broken")
    assert [unit.reason for unit in taken([path], out)] == ["", ""]
    assert len(Dataset(out / "u1" / "dataset")) == 3


def test_the_model_goes_with_each_unit_wherever_the_dataset_has_it(tmp_path):
    path = written(tmp_path / "data", info=replace(INFO, model="robot/files"))
    (path / "robot" / "files" / "meshes").mkdir(parents=True)
    (path / "robot" / "files" / "arm.xml").write_text("<mujoco/>")
    (path / "robot" / "files" / "meshes" / "a.stl").write_text("solid")
    for _ in range(2):
        for unit in taken([path], tmp_path / "out"):
            assert unit.reason == ""
            part = Dataset(unit.data)
            folder = part.info.model_path(part.path)
            assert (folder / "arm.xml").read_text() == "<mujoco/>"
            assert (folder / "meshes" / "a.stl").read_text() == "solid"


def test_a_model_that_is_too_large_is_not_left_out_silently(tmp_path, monkeypatch):
    path = written(tmp_path / "data")
    (path / "model").mkdir()
    (path / "model" / "arm.xml").write_text("<mujoco/>")
    monkeypatch.setattr(robot_model, "_MAX_BYTES", 3)
    assert ["too large" in unit.reason for unit in taken([path], tmp_path / "out")] == [True, True]
    given = taken([path], tmp_path / "out", model=path / "model" / "arm.xml")
    assert [unit.reason for unit in given] == ["", ""]
    assert not (given[0].data / "model").exists()


def test_no_links_of_a_model_are_followed(tmp_path):
    """What people share holds nothing that lies elsewhere on their disks."""
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "id_rsa").write_text("secret")
    path = written(tmp_path / "data")
    (path / "model").mkdir()
    (path / "model" / "arm.xml").write_text("<mujoco/>")
    (path / "model" / "key").symlink_to(tmp_path / "home" / "id_rsa")
    (path / "model" / "zero").symlink_to("/dev/zero")
    (path / "model" / "all").symlink_to(tmp_path / "home")
    os.mkfifo(path / "model" / "pipe")
    for unit in taken([path], tmp_path / "out"):
        assert [file.name for file in (unit.data / "model").rglob("*")] == ["arm.xml"]
    other = written(tmp_path / "other")
    (other / "model").symlink_to(tmp_path / "home")
    for unit in taken([other], tmp_path / "out2"):
        assert not (unit.data / "model").exists()


def test_a_dataset_that_cannot_be_read_is_a_unit_that_fails(tmp_path):
    good, bad, empty, none = (tmp_path / name for name in ("good", "bad", "empty", "none"))
    written(good)
    written(bad)
    (bad / "episodes.parquet").write_bytes(b"broken")
    written(empty, ())
    none.mkdir()
    found = taken([bad, good, empty, none], tmp_path / "out")
    assert [unit.name for unit in found] == ["bad", "u1", "u2", "empty", "none"]
    assert [bool(unit.reason) for unit in found] == [True, False, False, True, True]
    assert "no motions" in found[3].reason
    with pytest.raises(FormatError, match="no such folder"):
        taken([good, tmp_path / "godo"], tmp_path / "out")
    with pytest.raises(FormatError, match="no trueup dataset") as error:
        taken([none, bad], tmp_path / "out")
    assert "trueup import" in error.value.hint


def test_one_motion_that_cannot_be_read_fails_its_unit_alone(tmp_path, monkeypatch):
    path = written(tmp_path / "data")
    read = Dataset.episode

    def episode(self, id, **options):
        if id == "e002":
            raise OSError(5, "Input/output error")
        return read(self, id, **options)

    monkeypatch.setattr(Dataset, "episode", episode)
    one, other = taken([path], tmp_path / "out")
    assert one.reason == ""
    assert "Input/output error" in other.reason


def test_a_robot_does_not_count_twice(tmp_path, monkeypatch):
    path = written(tmp_path / "data")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "link").symlink_to(path)
    for again in (path, path.relative_to(tmp_path), tmp_path / "link"):
        with pytest.raises(ConfigError, match="given twice"):
            taken([path, again], tmp_path / "out")
    other = written(tmp_path / "line-2")
    assert [unit.name for unit in taken([path, other], tmp_path / "out")] == ["u1", "u2", "line-2-u1", "line-2-u2"]


def test_nothing_is_removed_before_all_is_known_to_be_right(tmp_path):
    path, out = written(tmp_path / "data"), tmp_path / "out"
    taken([path], out)
    clash = written(tmp_path / "x" / "data", ("u1",))
    clash_again = written(tmp_path / "y" / "data", ("u1",))
    with pytest.raises(ConfigError, match="two units are called"):
        taken([path, clash, clash_again], out, overwrite=True)
    with pytest.raises(ConfigError, match="would remove"):
        taken([path, out / "u2" / "dataset"], out, overwrite=True)
    (out / "u3").mkdir()
    (out / "u3" / "thesis.tex").write_text("years of work")
    with pytest.raises(OutputExists, match="no results of a fleet"):
        taken([path, written(tmp_path / "z", ("u3",))], out, overwrite=True)
    assert (out / "u1" / "dataset" / "dataset.json").is_file()
    (out / "u1" / "old").write_text("")
    (out / "u3" / "thesis.tex").rename(out / "u3" / TRACEBACK)
    taken([path, tmp_path / "z"], out, overwrite=True)
    assert not (out / "u1" / "old").exists()
    assert not (out / "u3").exists()
