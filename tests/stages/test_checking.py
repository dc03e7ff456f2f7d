"""The check as a command, as a step of a close and before an identification."""

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

from stages.closes import METHODS, QUICK, ROBOT, quick
from trueup.check import mended
from trueup.cli.main import main
from trueup.core.check_result import CheckResult
from trueup.core.close_result import CloseResult
from trueup.dataset import Dataset, DatasetWriter
from trueup.errors import DataError
from trueup.robots import load_robot
from trueup.robots.written import robot_yaml
from trueup.stages import check_setup, close, close_steps

pytestmark = pytest.mark.long

PAGE = (Path(__file__).parent.parent.parent / "docs" / "check.md").read_text()


@pytest.fixture(scope="module")
def mirrored(recorded, tmp_path_factory):
    """The demo's motions with the shoulder mirrored where it was measured."""
    given, path = Dataset(recorded), tmp_path_factory.mktemp("mirrored") / "data"
    with DatasetWriter.create(path, given.info) as writer:
        for episode in given:
            signals = {name: values.copy() for name, values in episode.measured.signals.items()}
            column = episode.measured.joints.index("shoulder")
            for values in signals.values():
                values[:, column] *= -1
            writer.append(replace(episode, measured=replace(episode.measured, signals=signals)))
    return path


def run(*arguments):
    with pytest.raises(SystemExit) as left:
        main([*map(str, arguments)])
    return left.value.code


def test_a_demo_is_right(recorded):
    result = check_setup(Dataset(recorded), ROBOT)
    assert result.findings == ()
    assert result.motions == 12


def test_the_page_shows_what_is_printed(mirrored, tmp_path, capsys):
    assert run("check", mirrored, "--robot", "demo_arm", "--out", tmp_path / "check.json") == 3
    printed = capsys.readouterr()
    (shown,) = re.findall(r"^```text\n(error: .*?)^```$", PAGE, re.M | re.S)
    lines = [*printed.err.splitlines(), *printed.out.splitlines()]
    for line in shown.splitlines():
        pattern = re.sub(r"-?\d+", r"-?\\d+", re.escape(line).replace(r"\-", "-"))
        assert any(re.fullmatch(pattern, one) for one in lines), (line, lines)
    # And the example of the file has its keys.
    (example,) = re.findall(r"^```json\n(.*?)^```$", PAGE, re.M | re.S)
    example, written = json.loads(example), json.loads((tmp_path / "check.json").read_text())
    assert example.keys() == written.keys()
    (one,), (first, *_) = example["findings"], written["findings"]
    assert one.keys() == first.keys()
    assert set(one["numbers"]) <= set(first["numbers"])
    assert one["mends"][0].keys() == first["mends"][0].keys()
    assert one["mends"][0]["lines"] == first["mends"][0]["lines"]
    # Nothing is written over.
    assert run("check", mirrored, "--robot", "demo_arm", "--out", tmp_path / "check.json") == 2


def test_a_close_ends_before_the_fit_and_goes_on_if_it_is_told_to(mirrored, tmp_path, capsys):
    config = tmp_path / "quick.yaml"
    config.write_text(
        json.dumps(
            {"fit": {"delay_s": "all", "kp": "all"}, "data": {"budget_s": 12.0}, "solver": {"max_iterations": 4}}
        )
    )
    given = (
        "close",
        mirrored,
        "--robot",
        "demo_arm",
        "--out",
        tmp_path / "out",
        "--until",
        "explain",
        "--config",
        config,
    )
    assert run(*given, "--budget", "none") == 3
    said = capsys.readouterr()
    assert "the set-up is wrong" in said.err
    assert "sign: -1" in said.out
    result = CloseResult.load(tmp_path / "out" / "close.json")
    assert [(step.name, step.status) for step in result.steps] == [
        *(("replay", "done"), ("gap", "done"), ("check", "done"), ("explain", "left out")),
    ]
    assert "certain: sign shoulder" in result.step("check").what
    assert "sign shoulder" in result.step("explain").what
    assert not (tmp_path / "out" / "explain.json").exists()
    # The check is kept, and the rest goes on as it is.
    assert run(*given, "--budget", "none", "--resume", "--force") == 0
    result = CloseResult.load(tmp_path / "out" / "close.json")
    assert result.step("check").status == "kept"
    assert (tmp_path / "out" / "explain.json").exists()


@pytest.mark.parametrize("wrong", [True, False])
def test_a_gap_of_a_wrong_set_up_is_not_told_without_a_word(wrong, recorded, mirrored, tmp_path, capsys):
    given = ("close", mirrored if wrong else recorded, "--robot", "demo_arm", "--until", "gap")
    assert run(*given, "--out", tmp_path / "out") == 0
    said = capsys.readouterr()
    assert ("this gap says little, since the set-up is wrong: shoulder" in said.out + said.err) == wrong


@pytest.mark.parametrize("wrong", [True, False])
def test_where_nothing_can_be_simulated_a_wrong_set_up_is_named(
    wrong, recorded, mirrored, tmp_path, capsys, monkeypatch
):
    def diverged(*_, **__):
        raise DataError("no episode could be replayed", got="the simulation diverged")

    monkeypatch.setattr(close_steps, "replay_unless_same", diverged)
    data = mirrored if wrong else recorded
    given = ("close", data, "--robot", "demo_arm", "--until", "check")
    assert run(*given, "--out", tmp_path / "out") == (3 if wrong else 2)
    said = capsys.readouterr()
    assert ("sign: -1" in said.out) == wrong
    assert ("the set-up is wrong" if wrong else "no episode could be replayed") in said.err
    assert run(*given, "--out", tmp_path / "forced", "--force") == 2
    assert "no episode could be replayed" in capsys.readouterr().err


def test_the_mended_robot_is_closed_on(mirrored, tmp_path):
    first = quick(mirrored, tmp_path / "first", until="check")
    assert not first.stopped or first.result.steps[-1].name == "check"
    right = mended(ROBOT, first.checked.certain[0].mends[0].lines)
    done = close(mirrored, right, tmp_path / "out", config=QUICK, methods=METHODS, until="check", jobs=2)
    assert done.checked.findings == ()
    (total,) = [rung.splits["test"]["position"]["rmse"].total for rung in done.ladder.rungs if rung.name == "stock"]
    assert total.value < 0.05  # as without the mistake
    # And is the same when it is written and read.
    (tmp_path / "right.yaml").write_text(robot_yaml(right))
    again = load_robot(tmp_path / "right.yaml")
    assert again.joint_rules() == right.joint_rules()


def test_an_identification_is_refused(mirrored, tmp_path, capsys):
    assert run("identify", mirrored, "--robot", "demo_arm", "--out", tmp_path / "out") == 3
    said = capsys.readouterr()
    assert "error: the set-up is wrong" in said.err
    assert "--force" in said.err
    assert "sign: -1" in said.out
    assert not (tmp_path / "out").exists()


def test_a_check_is_read_back(mirrored, tmp_path):
    result = check_setup(Dataset(mirrored), ROBOT, ids=Dataset(mirrored).ids[:4])
    result.save(tmp_path / "check.json")
    assert CheckResult.load(tmp_path / "check.json") == replace(
        result, provenance=json.loads(json.dumps(result.provenance))
    )


@pytest.mark.parametrize(
    ("logs", "robot"),
    [("so101_logs", "so101"), ("double_pendulum_logs", "double_pendulum"), ("simple_pendulum_logs", "simple_pendulum")],
)
def test_real_recordings_are_no_wrong_set_ups(logs, robot, tmp_path, request):
    import trueup

    data = tmp_path / "data"
    trueup.import_logs(request.getfixturevalue(logs), data)
    result = check_setup(Dataset(data), load_robot(robot))
    assert result.certain == ()
    assert result.seconds < 60.0
