"""docs/runtime.md: its Python runs, and its tables hold every status, flag and setting with its default."""

import re
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from benchmarks.networks import JOINTS, bidirectional, by_signal, motion, real_time

from trueup.deploy import Status, StreamSettings, Why, run_loop
from trueup.deploy.agreement import RATE_TOLERANCE
from trueup.record import RecordSettings

TEXT = (Path(__file__).parent.parent.parent / "docs" / "runtime.md").read_text()

# Of the recordings that `models/panda-rt` is trained on.
RATE_HZ = RecordSettings().record_hz


class Rig:
    """The robot and the simulator of the page's examples."""

    joints = JOINTS

    def __init__(self, samples):
        self.samples, self.written, self.stopped = samples, [], 0

    def read(self):
        return next(self.samples)

    def write(self, command):
        self.written.append(command["torque"])

    def stop(self):
        self.stopped += 1


def test_the_python_of_the_page_runs(tmp_path, monkeypatch, capsys):
    """On a network of the rate at which the page on learned correction has it recorded and trained."""
    monkeypatch.chdir(tmp_path)
    made = real_time(Path("models/panda-rt"), hidden=(8, 5), rate_hz=RATE_HZ)
    bidirectional(Path("models/panda-precise"), hidden=(8, 5), rate_hz=RATE_HZ)
    x = motion(made.card, 400)
    rig = Rig(by_signal(made.card, x[k % 400, 0]) for k in range(10**9))
    names = {"robot": rig, "simulator": rig, "controller": lambda p, v, t: t - p - v, "x": x}
    # A short loop, at the page's rate.
    rates = []

    def loop(step, *, rate_hz, duration_s):
        rates.append((rate_hz, duration_s))
        return run_loop(step, rate_hz=rate_hz, duration_s=0.2)

    monkeypatch.setattr("trueup.deploy.run_loop", loop)
    blocks = re.findall(r"^```python\n(.*?)^```$", TEXT, re.M | re.S)
    assert len(blocks) == 4
    for block in blocks:
        exec(compile(block, "runtime.md", "exec"), names)
    assert rates == [(RATE_HZ, 60.0)]
    assert len(rig.written) > 0
    assert rig.stopped == 0
    assert names["corrected"].shape == (400, 1, 21)
    assert names["so_far"].shape == (1, 21)
    assert len(capsys.readouterr().out.splitlines()) == 2


def rows(head):
    """First cells of the table whose first heading this is, and the cells beside them."""
    table = TEXT.split(f"| {head} |")[1].split("\n\n")[0]
    return dict(re.findall(r"^\| `(\w+)` \| ([^|]+) \|", table, re.M))


def test_every_status_and_flag_is_explained():
    assert set(rows("`status`")) == {status.name for status in Status}
    assert set(rows("`why`")) == {flag.name for flag in Why if flag}


def test_the_bound_of_the_rate_is_the_one_that_the_page_says():
    assert f"another rate than the network's (by more than {100 * RATE_TOLERANCE:g} %" in TEXT


def test_every_setting_is_explained_with_its_default():
    found = rows("setting")
    assert set(found) == {item.name for item in fields(StreamSettings)}
    for item in fields(StreamSettings):
        shown = "the card's" if item.default is None else str(item.default).lower()
        assert found[item.name].strip() == shown


@pytest.mark.parametrize(
    "sentence", ["more than 1.5 periods", "more than 3 times", "more than 10 %", "longer than 5 periods"]
)
def test_the_numbers_of_the_flags_are_the_defaults(sentence):
    assert sentence in TEXT
    given = StreamSettings()
    assert (given.missed_periods, given.stalled_steps, given.rate_tolerance, given.gap_periods) == (1.5, 3, 0.1, 5.0)
    assert np.isclose(1 / given.rate_tolerance, 10)
