"""Logs in archives, and compressed ones, are read as if they were not."""

import bz2
import gc
import gzip
import io
import lzma
import os
import shutil
import tarfile
import tempfile
import zipfile
from pathlib import Path

import numpy as np
import pytest
from backports import zstd

from trueup.dataset.importers.base import ImportOptions
from trueup.dataset.importers.packed import opened
from trueup.errors import DataError, FormatError
from trueup.stages import import_logs, plan_import

MAPPING = """
joints: [a, b]
series:
  measured: {time: t, signals: {position: {columns: [a, b], unit: rad}}}
"""
T = 0.01 * np.arange(200)
PACKERS = {".gz": gzip.compress, ".bz2": bz2.compress, ".xz": lzma.compress, ".zst": zstd.compress}
TARS = {".tar": "w", ".tar.gz": "w:gz", ".tgz": "w:gz", ".tar.xz": "w:xz", ".tar.bz2": "w:bz2"}


def table(number):
    rows = np.column_stack([T, np.sin(T + number), np.cos(T + number)])
    return "t,a,b\n" + "\n".join(",".join(f"{value:.9f}" for value in row) for row in rows) + "\n"


def plain(folder):
    folder.mkdir(parents=True)
    (folder / "mapping.yaml").write_text(MAPPING)
    for number in range(3):
        (folder / f"run{number}.csv").write_text(table(number))
    return folder


def loaded(path):
    plan = plan_import(path)
    return {source.id: source.load().measured["position"] for source in plan.episodes}


def assert_all(found):
    assert list(found) == ["run0", "run1", "run2"]
    for number, values in enumerate(found.values()):
        np.testing.assert_allclose(values, np.column_stack([np.sin(T + number), np.cos(T + number)]), atol=1e-8)


@pytest.mark.parametrize("ending", PACKERS)
def test_packed_logs_lie_beside_others(tmp_path, ending):
    logs = plain(tmp_path / "logs")
    before = (logs / "run1.csv").read_bytes()
    (logs / f"run1.csv{ending}").write_bytes(PACKERS[ending](before))
    (logs / "run1.csv").unlink()
    assert_all(loaded(logs))
    assert sorted(path.name for path in logs.iterdir()) == ["mapping.yaml", "run0.csv", f"run1.csv{ending}", "run2.csv"]


@pytest.mark.parametrize("ending", PACKERS)
def test_one_packed_log_is_read_with_what_lies_beside_it(tmp_path, ending):
    logs = plain(tmp_path / "logs")
    path = logs / f"other.csv{ending}"
    path.write_bytes(PACKERS[ending](table(5).encode()))
    found = loaded(path)
    assert list(found) == ["other"]
    np.testing.assert_allclose(found["other"][:, 0], np.sin(T + 5), atol=1e-8)


def archived(logs, path):
    ending = path.name.removeprefix("logs")
    if ending == ".zip":
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for file in sorted(logs.iterdir()):
                archive.write(file, f"logs/{file.name}")
    elif ending == ".tar.zst":
        file = io.BytesIO()
        with tarfile.open(fileobj=file, mode="w") as archive:
            archive.add(logs, "logs")
        path.write_bytes(zstd.compress(file.getvalue()))
    else:
        with tarfile.open(path, TARS[ending]) as archive:
            archive.add(logs, "logs")
    return path


@pytest.mark.parametrize("ending", [".zip", ".tar.zst", *TARS])
def test_an_archive_is_the_folder_that_it_holds(tmp_path, ending):
    assert_all(loaded(archived(plain(tmp_path / "logs"), tmp_path / f"logs{ending}")))


def test_an_archive_in_a_folder_counts_where_there_is_nothing_else(tmp_path):
    logs = plain(tmp_path / "made" / "logs")
    (tmp_path / "given").mkdir()
    shutil.move(archived(logs, tmp_path / "made" / "logs.zip"), tmp_path / "given" / "logs.zip")
    assert_all(loaded(tmp_path / "given"))
    shutil.copy(tmp_path / "given" / "logs.zip", tmp_path / "given" / "more.zip")
    plan = plan_import(tmp_path / "given", options=ImportOptions(mapping=logs / "mapping.yaml"))
    assert [source.id for source in plan.episodes] == [
        f"{name}/logs/run{number}" for name in ("logs", "more") for number in range(3)
    ]
    # Beside logs it is taken for a copy of them.
    archived(logs, logs / "logs.zip")
    assert_all(loaded(logs))


def test_packed_within_packed(tmp_path):
    logs = plain(tmp_path / "logs")
    for path in logs.glob("*.csv"):
        path.with_name(f"{path.name}.gz").write_bytes(gzip.compress(path.read_bytes()))
        path.unlink()
    assert_all(loaded(archived(logs, tmp_path / "logs.zip")))


def test_what_was_unpacked_goes_with_the_plan(tmp_path, monkeypatch):
    place = tmp_path / "place"
    place.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(place))
    plan = plan_import(archived(plain(tmp_path / "logs"), tmp_path / "logs.zip"))
    assert list(place.iterdir())
    del plan
    gc.collect()
    assert not list(place.iterdir())


def test_an_import_of_an_archive_says_where_it_is_from(tmp_path):
    archive = archived(plain(tmp_path / "logs"), tmp_path / "logs.tar.gz")
    summary = import_logs(archive, tmp_path / "out")
    assert summary.imported == 3
    assert import_logs(archive, tmp_path / "out", resume=True).kept == 3


def test_members_that_lead_out_are_none(tmp_path):
    with tarfile.open(tmp_path / "logs.tar", "w") as archive:
        archive.add(plain(tmp_path / "logs"), "logs")
        for name in ("../out.csv", "/abs.csv", "logs/../../out.csv", ".hidden.csv"):
            item = tarfile.TarInfo(name)
            item.size = 4
            archive.addfile(item, io.BytesIO(b"evil"))
        link = tarfile.TarInfo("logs/run9.csv")
        link.type, link.linkname = tarfile.SYMTYPE, "/etc/passwd"
        archive.addfile(link)
    logs = opened(tmp_path / "logs.tar")
    assert {path.name for path in Path(logs.path).iterdir()} == {"mapping.yaml", "run0.csv", "run1.csv", "run2.csv"}
    assert not (tmp_path / "out.csv").exists()


def one_packed(tmp_path):
    logs = tmp_path / "logs"
    logs.mkdir()
    (logs / "run.csv.gz").write_bytes(gzip.compress(table(0).encode()))
    (logs / "rules.yaml").write_text(MAPPING)
    (logs / "mapping.yaml").symlink_to("rules.yaml")
    return logs


def test_what_lies_beside_a_packed_log_goes_with_it(tmp_path):
    logs = one_packed(tmp_path)
    (logs / "arm").mkdir()
    (logs / "arm" / "arm.xml").write_text("<mujoco/>")
    (logs / "arm" / "key").symlink_to("/etc/passwd")
    os.mkfifo(logs / "arm" / "pipe")
    (logs / "model").symlink_to("arm")
    import_logs(logs / "run.csv.gz", tmp_path / "out")
    assert [path.name for path in (tmp_path / "out" / "model").iterdir()] == ["arm.xml"]


@pytest.mark.parametrize("name", ["model", "LICENSE", "split.json"])
def test_links_beside_a_packed_log_that_lead_out_are_refused(tmp_path, name):
    logs = one_packed(tmp_path)
    (tmp_path / "secret").mkdir()
    (tmp_path / "secret" / "arm.xml").write_text("<mujoco/>")
    (logs / name).symlink_to(tmp_path / "secret")
    with pytest.raises(DataError, match="leads out of the folder"):
        opened(logs / "run.csv.gz")


def test_a_large_model_beside_a_packed_log_is_left_there(tmp_path):
    logs = one_packed(tmp_path)
    (logs / "model").mkdir()
    (logs / "model" / "arm.xml").write_text("<mujoco/>")
    with (logs / "model" / "meshes.bin").open("wb") as file:
        file.truncate(1 << 40)
    import_logs(logs / "run.csv.gz", tmp_path / "out")
    assert not (tmp_path / "out" / "model").exists()


@pytest.mark.parametrize("ending", [".gz", ".zip", ".tar.gz", ".zst"])
def test_what_unpacks_to_gigabytes_is_refused(tmp_path, ending, monkeypatch):
    monkeypatch.setattr("trueup.core.unpacking.FEW_BYTES", 1 << 20)
    path = tmp_path / ("run.csv" + ending if ending in PACKERS else "logs" + ending)
    zeros = bytes(8 << 20)
    if ending in PACKERS:
        path.write_bytes(PACKERS[ending](zeros))
    else:
        (tmp_path / "logs").mkdir()
        (tmp_path / "logs" / "run.csv").write_bytes(zeros)
        archived(tmp_path / "logs", path)
    with pytest.raises(DataError, match="unpacks to more than"):
        opened(path)


@pytest.mark.parametrize("name", ["run.csv", ".hidden", "../out.csv"])
def test_what_is_passed_over_in_an_archive_is_counted(tmp_path, name, monkeypatch):
    """What is left out has to be unpacked all the same, to find what follows it: petabytes would take days."""
    monkeypatch.setattr("trueup.core.unpacking.FEW_BYTES", 1 << 20)
    head = tarfile.TarInfo(name)
    head.size = 1 << 50
    packed = bz2.compress(head.tobuf(tarfile.GNU_FORMAT)) + 100 * bz2.compress(bytes(1 << 20))
    (tmp_path / "logs.tar.bz2").write_bytes(packed)
    with pytest.raises(DataError, match="unpacks to more than"):
        opened(tmp_path / "logs.tar.bz2")


@pytest.mark.parametrize("kind", [tarfile.XHDTYPE, tarfile.XGLTYPE, tarfile.GNUTYPE_LONGNAME, tarfile.GNUTYPE_LONGLINK])
def test_names_and_remarks_in_an_archive_are_bounded(tmp_path, kind):
    """tarfile takes them into memory in one piece, and looks for remarks for minutes."""
    head = tarfile.TarInfo("x")
    head.size, head.type = 64 << 20, kind
    (tmp_path / "logs.tar.gz").write_bytes(gzip.compress(head.tobuf(tarfile.USTAR_FORMAT) + b"0" * head.size))
    with pytest.raises(DataError, match="a name or a remark of 67108864 bytes"):
        opened(tmp_path / "logs.tar.gz")


def test_members_of_any_kind_are_counted(tmp_path, monkeypatch):
    monkeypatch.setattr("trueup.dataset.importers.packed._MOST_FILES", 20)
    with tarfile.open(tmp_path / "logs.tar", "w") as archive:
        for number in range(30):
            item = tarfile.TarInfo(f"folder{number}")
            item.type = tarfile.DIRTYPE
            archive.addfile(item)
    with pytest.raises(DataError, match="more than 20 files"):
        opened(tmp_path / "logs.tar")


@pytest.mark.parametrize("ending", [*PACKERS, ".zip", ".tar.gz"])
@pytest.mark.parametrize("cut", [0, 10, 0.5])
def test_damaged_ones_are_said_in_a_line(tmp_path, ending, cut):
    path = tmp_path / ("run.csv" + ending if ending in PACKERS else "logs" + ending)
    if ending in PACKERS:
        path.write_bytes(PACKERS[ending](table(0).encode()))
    else:
        archived(plain(tmp_path / "logs"), path)
    data = path.read_bytes()
    path.write_bytes(data[: int(cut * len(data)) if isinstance(cut, float) else cut])
    with pytest.raises((DataError, FormatError)) as error:
        plan_import(path)
    assert str(error.value).count("\n") < 2
