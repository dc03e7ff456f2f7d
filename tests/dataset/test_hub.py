"""Datasets of the Hugging Face Hub by name; the package that fetches them is played by the test."""

import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from trueup.dataset.importers.hub import local_copy
from trueup.errors import DataError
from trueup.stages import plan_import

NAME = "someone/so101_pick"


@pytest.fixture
def here(tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path / "here"


@pytest.fixture
def asked(tmp_path, monkeypatch):
    """What the Hub is asked for; it has one dataset."""
    logs, asked = tmp_path / "snapshot", []
    logs.mkdir()
    (logs / "mapping.yaml").write_text(
        "joints: [a]\nseries:\n  measured: {time: t, signals: {position: {columns: [a], unit: rad}}}\n"
    )
    (logs / "run.csv").write_text("t,a\n" + "".join(f"{0.01 * row},{row}\n" for row in range(50)))

    def fetch(name, **how):
        asked.append((name, how))
        if name != NAME:
            raise RuntimeError("404 Client Error\nand a page of text")
        return str(logs)

    monkeypatch.setitem(sys.modules, "huggingface_hub", SimpleNamespace(snapshot_download=fetch))
    return asked


@pytest.mark.parametrize("source", [f"hf://{NAME}", NAME])
def test_a_dataset_is_read_without_its_videos(here, asked, source):
    assert [item.id for item in plan_import(Path(source)).episodes] == ["run"]
    ((name, how),) = asked
    assert name == NAME
    assert how["repo_type"] == "dataset"
    # Nobody is connected to who has not asked for it.
    assert how["local_files_only"] == (source == NAME)
    assert "videos/x.mp4" not in how["allow_patterns"]
    assert not any(pattern in ("*", "**") for pattern in how["allow_patterns"])


@pytest.mark.parametrize("source", ["someone/else", "someone", "a/b/c", "/someone/x", "../someone/x", "some one/x"])
def test_what_lies_here_or_is_no_name_is_a_path(here, asked, source):
    (here / "someone").mkdir()
    assert local_copy(Path(source)) == Path(source)
    assert not asked


@pytest.mark.parametrize("source", ["hf://someone/else", "someone/else"])
def test_what_is_not_there_is_said_in_two_lines(here, asked, source):
    with pytest.raises(DataError, match="someone/else") as error:
        plan_import(Path(source))
    assert str(error.value).count("\n") <= 1
    assert "page of text" not in str(error.value)
    assert ("hf auth login" if source.startswith("hf") else "hf://someone/else") in str(error.value)


@pytest.mark.parametrize("source", [f"hf://{NAME}", NAME])
def test_without_the_package(here, monkeypatch, source):
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(DataError, match="pip install huggingface_hub" if source.startswith("hf") else "hf://someone"):
        plan_import(Path(source))
