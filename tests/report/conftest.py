"""A realistic run folder for all tests of the report."""

from pathlib import Path

import pytest

from report.run_folders import make_run


@pytest.fixture(scope="session")
def run_folder(tmp_path_factory) -> Path:
    """Eight motions, three joints, two simulators; tests that change files copy it first."""
    return make_run(tmp_path_factory.mktemp("runs") / "first")
