import json
import os

import pytest

from trueup.core.atomic import read_json, replacing, write_json, write_text
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
