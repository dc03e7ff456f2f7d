"""Two processes that are given the same folder: one does its work, the other is told, and the results are whole."""

import shutil
import signal
import subprocess
import sys
import time

import pytest

from trueup.core.results import GapResult
from trueup.stages import demo_dataset


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    return demo_dataset(tmp_path_factory.mktemp("data") / "data")


def started(*words):
    return subprocess.Popen(
        [sys.executable, "-m", "trueup.cli.main", *map(str, words)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


COMMANDS = {
    "close": ("--robot", "demo_arm", "--until", "gap"),
    "identify": ("--robot", "demo_arm"),
    "fleet": ("--robot", "demo_arm", "--jobs", "1"),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_the_second_is_told_and_the_first_goes_on(name, recorded, tmp_path):
    """The first is stopped in the middle, so that it is there when the second comes."""
    data, out = shutil.copytree(recorded, tmp_path / "data"), tmp_path / "out"
    first = started(name, data, *COMMANDS[name], "--out", out)
    until = time.monotonic() + 60
    while not (out.is_dir() and any(out.iterdir())) and first.poll() is None:
        assert time.monotonic() < until
        time.sleep(0.005)
    if first.poll() is not None:
        pytest.skip("it was done before it could be stopped")
    first.send_signal(signal.SIGSTOP)
    try:
        second = started(name, data, *COMMANDS[name], "--out", out, "--overwrite")
        _, err = second.communicate(timeout=60)
        assert second.returncode == 2, err
        assert "another process" in err
        assert "Traceback" not in err
    finally:
        first.send_signal(signal.SIGCONT)
        if name == "close":
            _, err = first.communicate(timeout=120)
            assert first.returncode == 0, err
            GapResult.load(out / "gap.json")
        else:
            first.kill()
            first.communicate()


def test_many_at_once_leave_one_whole_result(recorded, tmp_path):
    data, out = shutil.copytree(recorded, tmp_path / "data"), tmp_path / "out"
    processes = [started("close", data, *COMMANDS["close"], "--out", out, "--overwrite") for _ in range(3)]
    codes = []
    for process in processes:
        _, err = process.communicate(timeout=180)
        assert "Traceback" not in err
        assert process.returncode in (0, 2), err
        codes.append(process.returncode)
    assert 0 in codes
    GapResult.load(out / "gap.json")
    assert "</html>" in (out / "report.html").read_text()
