import errno
import json
import os
from pathlib import Path

import pytest

from trueup.core.atomic import appearing, read_json, replacing, write_json, write_text
from trueup.errors import DataError


def test_an_interrupted_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "result.json"
    write_text(path, "old")

    def interrupted():
        with replacing(path) as temporary:
            temporary.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_full_disk_leaves_the_old_file_and_says_which(tmp_path):
    path = tmp_path / "result.json"
    write_text(path, "old")
    with pytest.raises(DataError, match=r"cannot write .*result\.json: got No space left"), replacing(path):
        raise OSError(28, "No space left on device")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.fixture
def order(monkeypatch):
    """What reaches the disk in which order: what is synced, by its name and content, and what is renamed."""
    seen, sync, replace, rename = [], os.fsync, Path.replace, Path.rename

    def fsync(descriptor):
        path = Path(f"/proc/self/fd/{descriptor}").readlink()
        seen.append(("sync", path, path.read_text() if path.is_file() else None))
        sync(descriptor)

    def moved(how):
        def move(path, target):
            seen.append(("rename", path, Path(target)))
            return how(path, target)

        return move

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(Path, "replace", moved(replace))
    monkeypatch.setattr(Path, "rename", moved(rename))
    return seen


def test_a_file_is_on_disk_before_its_name_and_its_name_before_the_end(order, tmp_path):
    """Else a power cut leaves a name without its content, or the old content after the command has said it is done."""
    write_text(tmp_path / "result.json", "new")
    (first, temporary, content), (second, source, target), third = order
    assert (first, second) == ("sync", "rename")
    assert content == "new"
    assert (source, target) == (temporary, tmp_path / "result.json")
    assert third == ("sync", tmp_path, None)


def test_a_folder_is_on_disk_with_all_that_is_in_it_before_its_name(order, tmp_path):
    with appearing(tmp_path / "data") as temporary:
        (temporary / "inner").mkdir()
        (temporary / "inner" / "a").write_text("content")
    place = [what for what, *_ in order].index("rename")
    synced = {path.relative_to(temporary) for _, path, _ in order[:place]}
    assert synced == {Path(), Path("inner"), Path("inner/a")}
    assert order[place][1:] == (temporary, tmp_path / "data")
    assert order[place + 1 :] == [("sync", tmp_path, None)]


def test_a_file_system_that_cannot_sync_folders_is_no_error(monkeypatch, tmp_path):
    sync = os.fsync

    def refusing(descriptor):
        if Path(f"/proc/self/fd/{descriptor}").readlink().is_dir():
            raise OSError(errno.EINVAL, "Invalid argument")
        sync(descriptor)

    monkeypatch.setattr(os, "fsync", refusing)
    write_text(tmp_path / "result.json", "new")
    assert (tmp_path / "result.json").read_text() == "new"


def test_json_keeps_the_order_of_keys(tmp_path):
    write_json(tmp_path / "a.json", {"yaw": 1, "elbow": [1.5, None]})
    assert list(json.loads((tmp_path / "a.json").read_text())) == ["yaw", "elbow"]


def test_nan_is_no_json(tmp_path):
    with pytest.raises(ValueError, match="JSON compliant"):
        write_json(tmp_path / "a.json", {"a": float("nan")})
    assert not (tmp_path / "a.json").exists()


def test_a_pipe_a_device_and_a_number_that_nothing_holds_are_not_read(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "device").symlink_to("/dev/zero")
    (tmp_path / "number").write_text("9" * 400)
    for name in ("pipe", "device", "number"):
        with pytest.raises(DataError, match=name):
            read_json(tmp_path / name)


def test_a_file_does_not_take_the_place_of_a_link_to_a_folder(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "link").symlink_to("mine")
    with pytest.raises(DataError, match="got a folder"):
        write_text(tmp_path / "link", "x")
    assert (tmp_path / "link").is_symlink()
