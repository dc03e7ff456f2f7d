"""Two processes that are given the same folder: one does its work, the other is told, and the results are whole."""

import contextlib
import fcntl
import functools
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from benchmarks.networks import real_time
from typer.main import get_command

from trueup.augment.config import preset
from trueup.cli.main import app, main
from trueup.core.results import GapResult
from trueup.dataset import Dataset
from trueup.dataset.lock import FolderLock
from trueup.robots import load_robot
from trueup.stages import augment, demo_dataset, replay
from trueup.stages.exporting import export_dataset

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    return demo_dataset(tmp_path_factory.mktemp("data") / "data")


def started(*words):
    return subprocess.Popen(
        [sys.executable, "-m", "trueup.cli.main", *map(str, words)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


# DATA is a dataset with a run, NETWORK was trained on it, LOOP is one for a control loop.
COMMANDS = {
    "close": ("DATA", "--robot", "demo_arm", "--until", "gap"),
    "identify": ("DATA", "--robot", "demo_arm"),
    "torque": ("DATA", "--robot", "demo_arm"),
    "fleet": ("DATA", "--robot", "demo_arm", "--jobs", "1"),
    "payload": ("DATA", "CSV", "--robot", "demo_arm"),
    "demo": ("--robot", "demo_arm", "--until", "gap"),
    "gap": ("DATA",),
    "design": ("--robot", "panda", "--count", "2"),
    "record": ("--robot", "panda", "--scale", "0.001"),
    "import": ("CSV",),
    "augment train": ("DATA", "--method", "moving-average"),
    "augment sweep": ("DATA", "--method", "moving-average", "--seeds", "1"),
    "augment eval": ("DATA", "--model", "NETWORK"),
    "augment robustness": ("DATA", "--model", "NETWORK", "--robot", "demo_arm"),
    "augment time": ("LOOP", "--seconds", "30"),
    "compensate train": ("DATA", "--robot", "demo_arm"),
    "policy train": (),
    "policy grid": (),
    "policy eval": ("zoo:panda-reach", "--goals", "4"),
    "deploy run": ("zoo:panda-reach", "--goals", "1"),
    "deploy ros2": ("LOOP", "--seconds", "30", "--domain", "77", "--localhost"),
}


# A file is there whole, of one or of the other; an export appears as a whole, or is refused since another is there.
ONE_FILE, WHOLE_OR_NOT = ("report", "experiment", "policy curves", "check", "selftest", "init"), ("export",)
PATIENCE_S = 180  # with a machine that does other things


@pytest.fixture(scope="module")
def there(recorded, tmp_path_factory):
    """What the commands read, by the words that stand for it; made when it is asked for."""
    folder = tmp_path_factory.mktemp("there")

    @functools.cache
    def made(word):
        path = folder / word
        match word:
            case "DATA":
                replay(Dataset(shutil.copytree(recorded, path)), load_robot("demo_arm"), jobs=1)
            case "NETWORK":
                data = Dataset(made("DATA"))
                augment([data], path, run=data.runs[0], config=preset("moving-average"), jobs=1)
            case "LOOP":
                real_time(path, hidden=(8, 5))
            case "CSV":
                export_dataset(recorded, path)
            case _:
                return word
        return path

    return made


@contextlib.contextmanager
def written_to(folder):
    """As if another process wrote there: the locks of a folder of results, and of a dataset."""
    folder.mkdir()
    lock = FolderLock(folder)
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
        lock.release()


@pytest.mark.parametrize("name", COMMANDS)
def test_who_comes_second_is_told(name, there, tmp_path, capsys):
    out = tmp_path / "out"
    with written_to(out), pytest.raises(SystemExit) as left:
        main([*name.split(), *map(str, map(there, COMMANDS[name])), "--out", str(out)])
    _, err = capsys.readouterr()
    assert left.value.code == 2, err
    assert "another process" in err
    assert "Traceback" not in err
    assert [path.name for path in out.iterdir()] == [".lock"]


def test_every_command_that_writes_a_folder_is_looked_at():
    writing = {" ".join(words) for words, command in commands_of(get_command(app)) if writes(command)}
    assert writing == {*COMMANDS, *ONE_FILE, *WHOLE_OR_NOT}


def writes(command):
    return any("--out" in parameter.opts for parameter in command.params)


def commands_of(group, *names):
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands_of(command, *names, name)
        else:
            yield (*names, name), command


def is_locked(folder):
    """Whether somebody holds the folder, or the dataset that is in it; looking takes no lock."""
    places = [path for path in (folder, folder / ".lock") if path.exists()]
    held = {line.split()[-3].split(":")[-1] for line in Path("/proc/locks").read_text().splitlines()}
    return any(str(path.stat().st_ino) in held for path in places)


@pytest.mark.parametrize("name", ["close", "identify", "gap", "compensate train", "deploy run"])
def test_the_second_is_told_and_the_first_goes_on(name, there, tmp_path):
    """The first is stopped in the middle, so that it is there when the second comes."""
    out = tmp_path / "out"
    words = [*name.split(), *map(there, COMMANDS[name]), "--out", out]
    first = started(*words)
    until = time.monotonic() + PATIENCE_S
    while not is_locked(out) and first.poll() is None:
        assert time.monotonic() < until
        time.sleep(0.002)
    first.send_signal(signal.SIGSTOP)
    try:
        assert first.poll() is None, first.communicate()
        second = started(*words, "--overwrite")
        _, err = second.communicate(timeout=PATIENCE_S)
        assert second.returncode == 2, err
        assert "another process" in err
        assert "Traceback" not in err
    finally:
        first.send_signal(signal.SIGCONT)
        if name == "close":
            _, err = first.communicate(timeout=PATIENCE_S)
            assert first.returncode == 0, err
            GapResult.load(out / "gap.json")
        else:
            first.kill()
            first.communicate()


def test_many_at_once_leave_one_whole_result(recorded, tmp_path):
    data, out = shutil.copytree(recorded, tmp_path / "data"), tmp_path / "out"
    processes = [started("close", data, *COMMANDS["close"][1:], "--out", out, "--overwrite") for _ in range(3)]
    codes = []
    for process in processes:
        _, err = process.communicate(timeout=PATIENCE_S)
        assert "Traceback" not in err
        assert process.returncode in (0, 2), err
        codes.append(process.returncode)
    assert 0 in codes
    GapResult.load(out / "gap.json")
    assert "</html>" in (out / "report.html").read_text()
