"""One process at a time writes to a folder of results."""

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from trueup.core.sole_writer import sole_writer, writes_alone
from trueup.errors import DataError

HOLD = """
import sys, time
from pathlib import Path
from trueup.core.sole_writer import sole_writer
with sole_writer(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


def holding(folder):
    """Another process that holds the folder."""
    process = subprocess.Popen([sys.executable, "-c", HOLD, str(folder)], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "held\n"
    return process


def ended(process):
    process.send_signal(signal.SIGKILL)
    process.communicate()


def test_a_second_process_is_refused_until_the_first_is_gone(tmp_path):
    other = holding(tmp_path / "out")
    try:
        with pytest.raises(DataError, match="another process writes into"), sole_writer(tmp_path / "out"):
            pass
        with sole_writer(tmp_path / "elsewhere"):
            pass
    finally:
        ended(other)
    with sole_writer(tmp_path / "out"):
        pass
    assert not list((tmp_path / "out").iterdir())


def test_steps_of_one_process_may_take_it_again(tmp_path):
    with sole_writer(tmp_path):
        with sole_writer(tmp_path / "." / ""):
            pass
        other = subprocess.run([sys.executable, "-c", HOLD, str(tmp_path)], capture_output=True, text=True, check=False)
        assert "another process" in other.stderr  # the inner one has not let go of the outer one's
    ended(holding(tmp_path))


def test_an_error_inside_lets_go(tmp_path):
    with pytest.raises(ValueError, match="inside"), sole_writer(tmp_path):
        raise ValueError("inside")
    ended(holding(tmp_path))


def test_a_folder_that_cannot_be_made_is_said(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="file"), sole_writer(tmp_path / "file" / "out"):
        pass
    with pytest.raises(DataError), sole_writer(tmp_path / "file"):
        pass


def test_threads_of_one_process_do_not_wait_for_each_other(tmp_path):
    done = []

    def take():
        with sole_writer(tmp_path):
            done.append(os.getpid())

    with sole_writer(tmp_path):
        thread = threading.Thread(target=take)
        thread.start()
        thread.join(5.0)
    assert done


@writes_alone()
def work(out: Path | None, *, end: Exception | None = None) -> str:
    """Asks another process whether it may write there, too."""
    if end is not None:
        raise end
    if out is None or out.is_file():
        return "nothing to lock"
    code = "import sys; from pathlib import Path; from trueup.core.sole_writer import sole_writer\n"
    code += "with sole_writer(Path(sys.argv[1])): pass"
    return subprocess.run([sys.executable, "-c", code, str(out)], capture_output=True, text=True, check=False).stderr


def test_a_function_is_alone_with_the_folder_that_it_is_given(tmp_path):
    assert "another process writes into" in work(tmp_path / "a" / "out")
    assert "another process writes into" in work(out=tmp_path / "a" / "out")
    assert work(None) == "nothing to lock"
    (tmp_path / "file").touch()
    for place in ("file", "file/below"):
        with pytest.raises(DataError, match=r"cannot make the folder .*: (it|.*file) is a file") as error:
            work(tmp_path / place)
        assert "choose another name" in error.value.hint


def test_a_folder_that_was_made_for_nothing_is_gone(tmp_path):
    (tmp_path / "there").mkdir()
    for folder in ("there", "there/x/y"):
        with pytest.raises(ValueError, match="wrong"):
            work(tmp_path / folder, end=ValueError("wrong"))
    assert [path.name for path in tmp_path.rglob("*")] == ["there"]


def test_what_an_error_leaves_stays(tmp_path):
    def fails():
        with sole_writer(tmp_path / "out"):
            (tmp_path / "out" / "kept").touch()
            raise ValueError("wrong")

    with pytest.raises(ValueError, match="wrong"):
        fails()
    assert (tmp_path / "out" / "kept").is_file()
