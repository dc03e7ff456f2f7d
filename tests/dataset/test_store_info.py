import json

import pytest

from dataset.store_cases import INFO, make_episode
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter
from trueup.errors import ConfigError, DataError, FormatError


@pytest.fixture
def path(tmp_path):
    with DatasetWriter.create(tmp_path / "d", INFO) as writer:
        writer.append(make_episode(0))
    return tmp_path / "d"


def test_json_round_trip():
    info = DatasetInfo(
        "arm", ("a", "b"), {"position": {"a": "rad", "b": "1"}}, "MIT", "model/arm.xml", {"k": [1]}, ("n",)
    )
    assert DatasetInfo.from_json(json.loads(json.dumps(info.to_json()))) == info


def test_the_model_is_found_inside(path):
    (path / "model").mkdir()
    info = DatasetInfo(robot="arm", model="model/arm.xml")
    info.save(path)
    assert Dataset(path).info.model_path(path) == path / "model" / "arm.xml"
    assert DatasetInfo().model_path(path) is None


@pytest.mark.parametrize("model", ["../secret", "/etc/passwd", "model/../../x", "..\\x", "a\0b", "link/x"])
def test_a_model_outside_the_folder_is_refused(path, tmp_path, model):
    (path / "link").symlink_to(tmp_path)
    with pytest.raises(ConfigError, match="outside its folder"):
        DatasetInfo(model=model).save(path)
    data = json.loads((path / "dataset.json").read_text())
    (path / "dataset.json").write_text(json.dumps(data | {"model": model}))
    with pytest.raises(ConfigError, match="outside its folder"):
        Dataset(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"schema": "trueup.dataset/2"}, "trueup.dataset/2"),
        ({"schema": None}, "version"),
        ({"surprise": 1}, "surprise.*available: joints"),
        ({"robot": 3}, "robot"),
        ({"joints": "pan"}, "joints"),
        ({"joints": [["pan"]]}, "joints"),
        ({"units": {"position": "rad"}}, "units"),
        ({"units": {"position": {"pan": 1}}}, "units"),
        ({"provenance": []}, "provenance"),
    ],
)
def test_another_description_is_refused(path, change, message):
    data = json.loads((path / "dataset.json").read_text())
    (path / "dataset.json").write_text(json.dumps(data | change))
    with pytest.raises(FormatError, match=message) as caught:
        Dataset(path)
    assert "dataset.json" in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\xfe", b"[" * 100_000])
def test_what_is_not_json_is_refused(path, content):
    (path / "dataset.json").write_bytes(content)
    with pytest.raises(DataError, match=r"dataset\.json"):
        Dataset(path)


def test_no_list_and_no_folder(path, tmp_path):
    (path / "dataset.json").write_text("[1]")
    with pytest.raises(FormatError, match="list"):
        Dataset(path)
    for nothing in (tmp_path / "nothing", tmp_path):
        with pytest.raises(FormatError, match="trueup import"):
            Dataset(nothing)


def test_a_description_that_is_not_json_is_refused(tmp_path):
    for value in (object(), float("nan"), {1, 2}):
        with pytest.raises(ConfigError, match="JSON"):
            DatasetWriter.create(tmp_path / "d", DatasetInfo(provenance={"x": value}))
