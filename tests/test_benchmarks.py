"""One table of all benchmarks: figures are kept, and each benchmark that is named is there."""

import json
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import pytest
from benchmarks import __main__ as command
from benchmarks.__main__ import LONG, NAMES
from benchmarks.figures import cells, keep, known, own_result, print_all, rows_of, stored
from benchmarks.table import Row, at_least, at_most, bound, shown

ROOT = Path(__file__).parent.parent


def test_figures_are_kept_and_replaced(tmp_path):
    path = tmp_path / "figures.json"
    assert stored(path) == {}
    keep("one", [at_most("time", 2.0, 4.0, "s"), shown("size", 1.23456789, "MB")], path)
    keep("two", [at_least("speed", 3.0, 4.0, "x")], path)
    keep("one", [at_most("time", 3.0, 4.0, "s")], path)
    assert rows_of(stored(path)["one"]) == [Row("time", 3.0, 4.0, "s", ok=True)]
    (line,) = cells("two", stored(path)["two"])
    assert line[:7] == ("two", "speed", "3", "≥ 4", "0.75", "x", "MISSED")


@pytest.mark.parametrize("value", [3.0, 5.0])
def test_a_limit_says_on_which_side_a_figure_must_stay(value):
    assert bound(asdict(at_most("time", value, 4.0, "s"))) == "≤ 4"
    assert bound(asdict(at_least("speed", value, 4.0, "x"))) == "≥ 4"
    assert bound(asdict(at_most("lost", 0, 0, ""))) == "0"
    assert bound(asdict(shown("size", value, "MB"))) == ""


def test_a_training_is_counted_once():
    names = [row["name"] for row in known("compensation_robot")["rows"]]
    assert len(names) == len(set(names))


def test_one_table_of_all(tmp_path, capsys):
    path = tmp_path / "figures.json"
    keep("one", [at_most("lost", 0, 0, "messages"), at_most("a [b]", 2.0, 4.0, "s")], path)
    print_all(["one", "never"], path)
    out = capsys.readouterr().out
    for word in ("a [b]", "0.50", "ok", "never measured here: never"):
        assert word in out


def test_every_benchmark_is_there():
    for name in NAMES:
        assert "def run() -> list[Row]:" in (ROOT / "benchmarks" / f"{name}.py").read_text(), name
    assert set(LONG) < set(NAMES)
    assert set(stored()) <= set(NAMES)
    assert not [name for name in stored() if own_result(name).is_file()]


@pytest.mark.long
def test_the_command_prints_the_table_without_measuring():
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks", "--table"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "all benchmarks" in done.stdout
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks", "nothing"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 2
    assert "no benchmark nothing" in done.stderr


@pytest.mark.long
def test_the_command_measures_in_another_process_and_prints_the_figures():
    lines = ("import runpy, sys, benchmarks.figures as figures", "figures.keep = lambda name, rows: None")
    start = "; ".join(
        (*lines, "sys.argv = ['benchmarks', 'friction']", "runpy.run_module('benchmarks', run_name='__main__')")
    )
    done = subprocess.run(
        [sys.executable, "-c", start], cwd=ROOT, capture_output=True, text=True, timeout=120, check=False
    )
    assert "broke off" not in done.stderr, done.stderr  # how fast it is does not matter here
    assert "full law / MuJoCo's own" in done.stdout


def test_one_that_breaks_off_keeps_no_other_from_its_turn(monkeypatch, capsys):
    kept = {}

    def run_of(name):
        if name == "lab":
            raise OSError("no room")
        return [at_most("time", 1.0, 2.0, "s")]

    monkeypatch.setattr(command, "_run", run_of)
    monkeypatch.setattr(command, "keep", lambda name, rows: kept.update({name: rows}))
    monkeypatch.setattr(sys, "argv", ["benchmarks", "replay", "lab", "fleet"])
    with pytest.raises(SystemExit, match=r"broke off: lab$"):
        command.main()
    assert list(kept) == ["replay", "fleet"]
    assert "no room" in capsys.readouterr().err


@pytest.mark.parametrize("name", [name for name in NAMES if name in stored() or own_result(name).is_file()])
def test_what_is_kept_says_where_it_comes_from(name):
    entry = known(name)
    assert entry["git"]
    assert entry["created"]
    assert json.dumps(entry)
    assert rows_of(entry)


@pytest.mark.parametrize("name", LONG)
def test_what_takes_hours_is_kept(name):
    assert own_result(name).is_file() or name in stored()


def test_figures_of_a_benchmark_are_kept_in_one_place(tmp_path):
    keep("one", [shown("size", 1.0, "MB")], tmp_path / "figures.json")
    (tmp_path / "two.json").write_text("{}")
    keep("two", [shown("size", 1.0, "MB")], tmp_path / "figures.json")
    assert set(stored(tmp_path / "figures.json")) == {"one"}
