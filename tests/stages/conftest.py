"""Data and a close that are made once: tests that change them take a copy."""

import shutil

import pytest

from stages.closes import quick
from trueup.stages import demo_dataset


@pytest.fixture(scope="session")
def recorded(tmp_path_factory):
    return demo_dataset(tmp_path_factory.mktemp("recorded") / "data")


@pytest.fixture(scope="session")
def closed(recorded, tmp_path_factory):
    data = shutil.copytree(recorded, tmp_path_factory.mktemp("closed") / "data")
    return quick(data, data.parent / "out")


@pytest.fixture
def data(recorded, tmp_path):
    return shutil.copytree(recorded, tmp_path / "data")
