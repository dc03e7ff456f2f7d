"""Shapes and types of the package are checked while the tests run; real recordings are found here."""

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from shape_checks import begin_test, install

install("trueup")

from trueup.core.workers import wait_briefly  # noqa: E402 - what is imported before is not checked

wait_briefly()  # tests run side by side, and more than one of them trains

# A loaded machine must not fail a law; examples are the same in every run.
settings.register_profile(
    "trueup", deadline=None, derandomize=True, max_examples=50, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("trueup")


@pytest.fixture(autouse=True)
def _checks_begin_anew():
    begin_test()


ROOT = Path(__file__).resolve().parent.parent


def shared_folder() -> Path | None:
    """Where the real recordings are: TRUEUP_SHARED, or `shared` beside the project."""
    for candidate in (os.environ.get("TRUEUP_SHARED"), ROOT.parent / "shared"):
        if candidate and (Path(candidate) / "data").is_dir():
            return Path(candidate).resolve()
    return None


def _recording(name: str) -> Path:
    shared = shared_folder()
    if shared is None or not (shared / "data" / name).is_dir():
        pytest.skip(f"real recording {name} not found: set TRUEUP_SHARED, or put `shared` beside the project")
    return shared / "data" / name


@pytest.fixture(scope="session")
def model_cases() -> Path:
    """Small models of other people's kinds, with logs."""
    shared = shared_folder()
    if shared is None or not (shared / "cases" / "models").is_dir():
        pytest.skip("models of cases/models not found: set TRUEUP_SHARED, or put `shared` beside the project")
    return shared / "cases" / "models"


@pytest.fixture(scope="session")
def log_cases() -> Path:
    """Small logs of kinds that went wrong once."""
    shared = shared_folder()
    if shared is None or not (shared / "cases" / "logs").is_dir():
        pytest.skip("logs of cases/logs not found: set TRUEUP_SHARED, or put `shared` beside the project")
    return shared / "cases" / "logs"


@pytest.fixture(scope="session")
def foreign_models() -> Path:
    """Models of other people's robots."""
    return _recording("foreign")


@pytest.fixture(scope="session")
def so101_logs() -> Path:
    """43 motions of a real SO-101 in SAGE's layout."""
    return _recording("so101_sage")


@pytest.fixture(scope="session")
def bam_logs() -> Path:
    """16 motions of a real servo on a pendulum, JSON."""
    return _recording("bam_xl330") / "raw"


@pytest.fixture(scope="session")
def double_pendulum_logs() -> Path:
    """7 motions of a real torque-driven double pendulum, CSV."""
    return _recording("dfki_double_pendulum_A0")


@pytest.fixture(scope="session")
def simple_pendulum_logs() -> Path:
    """6 motions of a real one-joint pendulum, CSV."""
    return _recording("dfki_simple_pendulum")
