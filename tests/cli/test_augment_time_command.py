"""`trueup augment time` as its user sees it."""

import hashlib
import re
from dataclasses import replace

import pytest
from benchmarks.networks import bidirectional, real_time

from trueup.cli.main import main
from trueup.core.model_card import Input
from trueup.core.step_times import StepTimes


@pytest.fixture
def run(capsys):
    def call(*arguments):
        with pytest.raises(SystemExit) as end:
            main(["augment", "time", *(str(argument) for argument in arguments)])
        printed = capsys.readouterr()
        return end.value.code, printed.out, printed.err

    return call


def test_times_stand_beside_the_network(run, tmp_path):
    """A network of 100 Hz in a loop at 500 Hz; one of its channels has no range."""
    made = real_time(tmp_path / "panda-rt", hidden=(8, 5), rate_hz=100.0)
    folder, first = made.folder, made.card.inputs[0]
    free = Input(first.signal, first.joint, first.unit)
    replace(made.card, inputs=(free, *made.card.inputs[1:])).save(folder)
    code, out, err = run(folder, "--rate", 500, "--seconds", 0.2)
    assert code == 0
    assert "one step of panda-rt, in a loop at 500 Hz" in out
    assert "0.2 s without a word" in err
    times = StepTimes.load(folder / "latency.json")
    assert times.period_us == pytest.approx(2000.0)
    left_out = int(re.search(r"(\d+) cycles left out", out)[1])
    assert times.count + left_out == 100
    assert 0 < times.p50_us <= times.p99_us <= times.p999_us <= times.max_us
    assert sum(count for *_, count in times.bins) == times.count
    assert times.machine in " ".join(out.split())
    assert times.network == hashlib.sha256((folder / "model.onnx").read_bytes()).hexdigest()


def test_times_go_where_one_wants_them(run, tmp_path):
    folder = real_time(tmp_path / "rt", hidden=(8, 5)).folder
    code, out, _ = run(folder, "--seconds", 0.05, "--out", tmp_path / "else" / "where")
    assert code == 0
    assert str(tmp_path / "else" / "where" / "latency.json") in out.replace("\n", "")
    assert not (folder / "latency.json").exists()
    assert StepTimes.load(tmp_path / "else" / "where" / "latency.json").period_us == pytest.approx(1000.0)


def test_a_place_that_takes_no_file_is_found_out_before_the_loop(run, tmp_path):
    folder = real_time(tmp_path / "rt", hidden=(8, 5)).folder
    (tmp_path / "file").write_text("mine")
    code, out, err = run(folder, "--seconds", 3600, "--out", tmp_path / "file")
    assert (code, out) == (2, "")
    assert "cannot make the folder" in err
    assert (tmp_path / "file").read_text() == "mine"


def test_a_mistyped_model_is_not_made(run, tmp_path):
    code, _, err = run(tmp_path / "tr", "--seconds", 0.05)
    assert code == 2
    assert "holds no network: got no such folder; expected model.json" in err
    assert not (tmp_path / "tr").exists()


@pytest.mark.long
def test_one_cycle_is_enough(run, tmp_path):
    """Also where the period times the rate is a little less than 1."""
    assert (1 / 49) * 49 < 1
    folder = real_time(tmp_path / "rt", hidden=(8, 5)).folder
    code, _, _ = run(folder, "--rate", 49, "--seconds", 1 / 49)
    assert code == 0
    assert StepTimes.load(folder / "latency.json").count == 1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--rate", 0), "positive rate"),
        (("--seconds", "nan"), "positive number"),
        (("--seconds", "inf"), "positive number"),
        (("--seconds", 0.0007), "no cycle in so short a time: got 0.0007 s at 1000 Hz; expected at least 0.001 s"),
        (("--seconds", 0.0003), "no cycle in so short a time"),
    ],
    ids=str,
)
def test_senseless_loops_are_refused(run, tmp_path, options, words):
    folder = real_time(tmp_path / "rt", hidden=(8, 5)).folder
    code, _, err = run(folder, *options)
    assert code == 2
    assert words in " ".join(err.split())
    assert not (folder / "latency.json").exists()


def test_a_network_that_needs_the_future_is_refused(run, tmp_path):
    code, _, err = run(bidirectional(tmp_path / "precise").folder)
    assert code == 2
    assert "looks into the future" in err
    assert "realeasy-rt" in err
