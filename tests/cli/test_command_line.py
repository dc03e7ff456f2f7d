"""The command line as its users meet it: exit codes, one or two lines of error, nothing lost."""

import contextlib
import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cli.hidden_packages import without
from trueup import cli
from trueup.cli import options
from trueup.cli.console import out
from trueup.cli.main import main
from trueup.core.results import GapResult, Ladder
from trueup.dataset import Dataset, DatasetWriter
from trueup.errors import TrueupError
from trueup.stages.demonstrating import demo_dataset


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    return demo_dataset(tmp_path_factory.mktemp("demo") / "data")


@pytest.fixture
def run(capsys):
    def call(*arguments):
        with pytest.raises(SystemExit) as left:
            main([str(argument) for argument in arguments])
        printed = capsys.readouterr()
        return left.value.code, printed.out, printed.err

    return call


@pytest.fixture
def motion(tmp_path):
    """A folder with one SAGE motion, and a function that spoils one of its files."""
    folder = tmp_path / "logs" / "wave"
    folder.mkdir(parents=True)
    (folder / "joint_list.txt").write_text("yaw\nshoulder\nelbow\n")
    rows = [f'{{}},{k * 20000},"[{0.1 * np.sin(k / 9):.6f}, 0.0, 0.1]"' for k in range(200)]
    (folder / "control.csv").write_text("type,timestamp,positions\n" + "\n".join(r.format("CONTROL") for r in rows))
    (folder / "state_motor.csv").write_text(
        "type,timestamp,positions,velocities,torques\n"
        + "\n".join(r.format("STATE_MOTOR") + ',"[0, 0, 0]","[0, 0, 0]"' for r in rows)
    )
    return folder


def test_a_choice_that_is_nearly_right_is_asked_for(run):
    code, _, said = run("close", "logs", "--robot", "demo_arm", "--until", "identfy")
    assert code == 2
    assert "Did you mean 'identify'?" in said
    assert "Value error" not in said
    assert "Did you mean" not in run("close", "logs", "--robot", "demo_arm", "--until", "xyz")[2]


@pytest.mark.long
def test_the_package_is_the_command_too():
    done = subprocess.run([sys.executable, "-m", "trueup", "gap", "nowhere"], capture_output=True, text=True)
    assert done.returncode == 2
    assert "nowhere is no trueup dataset" in done.stderr


@pytest.mark.parametrize(
    ("said", "spins"),
    [({}, "2000"), ({"GOMP_SPINCOUNT": "7"}, "7"), ({"OMP_WAIT_POLICY": "ACTIVE"}, "None")],
)
def test_threads_that_wait_give_their_cores_away_unless_somebody_has_said_otherwise(said, spins):
    """libgomp reads it when it is loaded: before torch is."""
    code = (
        "import contextlib, os, sys\nfrom trueup.cli.main import main\nassert 'torch' not in sys.modules\n"
        "with contextlib.suppress(SystemExit):\n    main(['--version'])\nprint(os.environ.get('GOMP_SPINCOUNT'))"
    )
    own = {name: value for name, value in os.environ.items() if name not in ("GOMP_SPINCOUNT", "OMP_WAIT_POLICY")}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=own | said, check=True)
    assert done.stdout.split()[-1] == spins


def test_no_command_shows_the_commands(run):
    _, out, err = run()
    assert all(name in out + err for name in ("import", "replay", "gap", "report", "close", "demo", "doctor"))


@pytest.mark.parametrize("command", ["import", "export", "replay", "gap", "report", "close", "demo", "doctor"])
def test_every_command_explains_itself(run, command):
    code, out, _ = run(command, "--help")
    assert code == 0
    assert "Usage: trueup" in out


@pytest.mark.parametrize("group", ["", "augment", "compensate", "policy", "deploy"])
def test_what_a_command_does_fits_its_line(run, group, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    _, out, _ = run(*group.split(), "--help")
    _, _, listed = out.partition("Commands:")
    assert listed.strip()
    assert "..." not in listed


def test_an_unknown_option_or_command_is_bad_input(run):
    for arguments in (["gap", "--runz", "x"], ["measure"], ["close"], ["demo", "--until", "tomorrow"]):
        code, _, err = run(*arguments)
        assert code == 2
        assert err.startswith("error: ")
        assert len(err.strip().splitlines()) == 2


def test_doctor_says_what_is_there_and_how_to_get_the_rest(run, monkeypatch):
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "ray" else found(name))
    code, out, _ = run("doctor")
    assert code == 0
    assert "mujoco 3." in out
    assert "'.[ray]'" in out
    assert "'.[dart]'" not in out


@pytest.mark.long
def test_the_steps_one_by_one(run, demo, tmp_path):
    code, out, _ = run("replay", demo, "--robot", "demo_arm", "--label", "mujoco/steps", "--jobs", 2)
    assert (code, "12 episodes replayed" in out) == (0, True)
    code, out, _ = run("gap", demo, "--runs", "mujoco/steps", "--out", tmp_path / "gap")
    assert code == 0
    gap = GapResult.load(tmp_path / "gap" / "gap.json")
    assert set(gap.runs) == {"mujoco/steps", "command"}
    assert gap.groups["payload_kg"].keys() == {"0", "0.4"}
    assert (tmp_path / "gap" / "report.html").stat().st_size > 1e6
    first = (tmp_path / "gap" / "report.html").read_bytes()
    assert run("report", tmp_path / "gap", "--out", tmp_path / "again.html")[0] == 0
    assert (tmp_path / "again.html").read_bytes() == first


def beginnings(dataset, folder, *, count, rows):
    """The first samples of the first motions of a dataset."""
    data = Dataset(dataset)
    with DatasetWriter.create(folder, data.info) as writer:
        for name in data.ids[:count]:
            episode = data.episode(name)
            series = {"measured": episode.measured, "command": episode.command}
            writer.append(replace(episode, **{key: item.rows(np.arange(rows)) for key, item in series.items()}))
    return folder


@pytest.mark.long
def test_a_second_engine_makes_a_run_of_its_own(run, demo, tmp_path):
    demo = beginnings(demo, tmp_path / "short", count=2, rows=100)
    assert run("replay", demo, "--robot", "demo_arm", "--label", "mujoco/one")[0] == 0
    code, out, _ = run("replay", demo, "--robot", "demo_arm", "--engine", "dart", "--jobs", 1)
    assert (code, "run dart/stock" in out) == (0, True)
    again, out, _ = run("replay", demo, "--robot", "demo_arm", "--engine", "dart", "--resume")
    assert (again, "0 episodes replayed, 2 were there" in out) == (0, True)
    code, _, _ = run("gap", demo, "--runs", "mujoco/one,dart/stock", "--out", tmp_path / "gap")
    runs = GapResult.load(tmp_path / "gap" / "gap.json").runs
    errors = [runs[label]["all"]["position"]["rmse"].total.value for label in ("mujoco/one", "dart/stock")]
    assert errors[1] == pytest.approx(errors[0], rel=0.05)
    code, _, err = run("replay", demo, "--robot", "demo_arm", "--engine", "gazebo")
    assert (code, "mujoco, dart" in err) == (2, True)


@pytest.mark.long
def test_close_writes_the_ladder_and_says_whether_it_is_better(run, demo, tmp_path):
    code, out, _ = run("close", demo, "--until", "gap", "--robot", "demo_arm", "--out", tmp_path / "out")
    assert code == 0
    assert "mujoco/stock against command, test: " in out
    ladder = Ladder.load(tmp_path / "out" / "ladder.json")
    assert [rung.name for rung in ladder.rungs] == ["command", "stock"]
    assert [rung.chosen for rung in ladder.rungs] == [False, True]
    gap = GapResult.load(tmp_path / "out" / "gap.json")
    assert ladder.rungs[1].splits["test"] == gap.runs["mujoco/stock"]["test"]


@pytest.mark.long
@pytest.mark.parametrize(
    ("bar", "code"), [("position.rmse=0.001", 3), ("position.rmse=9", 0), (":test:position.rmse=9", 0)]
)
def test_a_bar_that_is_not_met_is_exit_code_3(run, demo, tmp_path, bar, code):
    got, _, err = run(
        "close", demo, "--until", "gap", "--robot", "demo_arm", "--out", tmp_path / "out", "--fail-above", bar
    )
    assert got == code
    assert ("bar not met" in err) == (code == 3)


@pytest.mark.parametrize(
    "bar", ["position.rmse", "position.rmse=x", "rmse=1", "position.magic=1", "position.pearson=1"]
)
def test_a_bar_that_is_none_is_refused_before_the_work(run, demo, tmp_path, bar):
    code, _, err = run(
        "close", demo, "--until", "gap", "--robot", "demo_arm", "--out", tmp_path / "out", "--fail-above", bar
    )
    assert code == 2
    assert err.count("\n") <= 2
    assert not (tmp_path / "out").exists()


@pytest.mark.long
def test_results_are_not_overwritten_unasked(run, demo, tmp_path):
    assert run("close", demo, "--until", "gap", "--robot", "demo_arm", "--out", tmp_path / "out")[0] == 0
    code, _, err = run("close", demo, "--until", "gap", "--robot", "demo_arm", "--out", tmp_path / "out")
    assert code == 2
    assert "--overwrite" in err
    assert run("close", demo, "--until", "gap", "--robot", "demo_arm", "--out", tmp_path / "out", "--overwrite")[0] == 0


def test_logs_of_another_robot_print_both_lists_of_joints(run, demo, tmp_path):
    code, _, err = run(
        "close", demo, "--until", "gap", "--robot", "double_pendulum", "--model", demo, "--out", tmp_path / "out"
    )
    assert code == 2
    model = tmp_path / "double_pendulum_A0.xml"
    model.write_text(
        '<mujoco><worldbody><body><joint name="joint1"/><geom size=".1"/><body><joint name="joint2"/>'
        '<geom size=".1"/></body></body></worldbody><actuator><motor name="a" joint="joint1"/>'
        '<motor name="b" joint="joint2"/></actuator></mujoco>'
    )
    code, _, err = run(
        "close", demo, "--until", "gap", "--robot", "double_pendulum", "--model", model, "--out", tmp_path / "out2"
    )
    assert code == 2
    assert "yaw, shoulder, elbow" in err
    assert "joint1, joint2" in err


def test_an_import_with_one_broken_motion_keeps_the_others(run, motion, tmp_path):
    other = motion.parent / "broken"
    other.mkdir()
    for path in motion.iterdir():
        (other / path.name).write_bytes(path.read_bytes())
    text = (other / "state_motor.csv").read_text().replace("[0, 0, 0]", "[0, 0]", 1)
    (other / "state_motor.csv").write_text(text)
    code, _, err = run("import", motion.parent, "--out", tmp_path / "data")
    assert code == 2
    assert "broken was not imported" in err
    assert "state_motor.csv" in err
    assert Dataset(tmp_path / "data").ids == ("wave",)
    assert run("import", motion.parent, "--out", tmp_path / "again", "--skip-bad")[0] == 0


@pytest.mark.parametrize(
    "spoil",
    [
        lambda folder: (folder / "state_motor.csv").write_text(""),
        lambda folder: (folder / "control.csv").write_bytes(b"\xff\xfe\x00\x01"),
        lambda folder: (folder / "joint_list.txt").write_text("yaw\nshoulder\n"),
        lambda folder: (folder / "control.csv").write_text('type,timestamp,positions\nCONTROL,nan,"[0,0,0]"\n'),
    ],
    ids=["empty", "binary", "joints", "nan-clock"],
)
def test_a_broken_log_is_one_or_two_lines(run, motion, tmp_path, spoil):
    spoil(motion)
    code, _, err = run("import", motion.parent, "--out", tmp_path / "data")
    assert code == 2
    errors = [line for line in err.splitlines() if not line.startswith("note: ")]
    assert 1 <= len(errors) <= 2
    assert "wave" in err
    assert "Traceback" not in err


def test_a_dry_run_writes_nothing(run, motion, tmp_path):
    code, out, _ = run("import", motion.parent, "--out", tmp_path / "data", "--dry-run")
    assert code == 0
    assert "wave" in out
    assert not (tmp_path / "data").exists()


def test_a_split_by_shares_is_drawn_by_whole_motion(run, motion, tmp_path):
    for index in range(9):
        other = motion.parent / f"wave{index}"
        other.mkdir()
        for path in motion.iterdir():
            if path.is_file():
                (other / path.name).write_bytes(path.read_bytes())
    assert run("import", motion.parent, "--out", tmp_path / "data", "--splits", "60/20/20")[0] == 0
    splits = Dataset(tmp_path / "data").splits
    assert sorted(set(splits.values())) == ["test", "train", "val"]
    assert len(splits) == 10
    assert run("import", motion.parent, "--out", tmp_path / "x", "--splits", "nothing.json")[0] == 2
    assert run("import", motion.parent, "--out", tmp_path / "x", "--splits", "70/20/20")[0] == 2


@pytest.mark.long
@pytest.mark.parametrize("format", ["csv", "lerobot"])
def test_an_export_can_be_imported_again(run, demo, tmp_path, format):
    assert run("export", demo, "--out", tmp_path / "export", "--format", format)[0] == 0
    assert run("import", tmp_path / "export", "--out", tmp_path / "data")[0] == 0
    original, again = Dataset(demo), Dataset(tmp_path / "data")
    assert len(again) == len(original)
    before = original[0]
    after = again[before.id] if format == "csv" else again[0]  # LeRobot numbers its episodes
    np.testing.assert_allclose(after.measured["position"], before.measured["position"], atol=1e-6)
    np.testing.assert_allclose(after.commanded()["position"], before.commanded()["position"], atol=1e-6)


def test_a_bug_is_exit_code_1_and_a_traceback_only_with_debug(run, demo, tmp_path, monkeypatch):
    def broken(*args, **kwargs):
        raise RuntimeError("inner matter")

    monkeypatch.setattr("trueup.stages.gap", broken)
    code, _, err = run("gap", demo)
    assert code == 1
    assert "RuntimeError: inner matter" in err
    assert "--debug" in err
    with pytest.raises(RuntimeError, match="inner matter"):
        main(["gap", str(demo), "--debug"])


def test_quiet_leaves_results_and_errors(run, demo):
    _, table, err = run("gap", demo, "--overwrite")
    assert "note:" in err
    assert run("gap", demo, "--overwrite", "--quiet") == (0, table, "")
    code, _, err = run("--quiet", "gap", demo.parent / "nowhere")
    assert code == 2
    assert err.startswith("error: ")


def test_json_is_the_result_and_nothing_else(run, demo):
    code, printed, _ = run("gap", demo, "--overwrite", "--json")
    assert code == 0
    found = json.loads(printed)
    assert found["schema"].startswith("trueup.gap/")
    assert set(found["runs"]) >= {"command"}
    assert not out.quiet  # for what the same process prints afterwards
    code, printed, err = run("export", demo, "--format", "csv", "--out", demo.parent / "as-csv", "--json")
    assert (code, printed) == (0, "")
    assert "no result to print as JSON" in err


def test_every_command_with_a_table_has_json():
    """A module of commands that prints a table answers --json, too."""
    modules = [path for path in Path(cli.__file__).parent.glob("*.py") if path.name != "console.py"]
    tables = [path for path in modules if re.search(r"out\.print\([a-z_]*table", path.read_text())]
    assert len(tables) > 15
    assert [path.name for path in tables if "answer(" not in path.read_text()] == []


def test_the_shell_completes_commands(monkeypatch, capsys):
    words = {"_TRUEUP_COMPLETE": "complete_bash", "COMP_WORDS": "trueup cl", "COMP_CWORD": "1"}
    for name, value in words.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(SystemExit):
        main([])
    assert capsys.readouterr().out.split() == ["close"]


def test_a_way_to_draw_that_is_not_installed_is_no_bug(run, demo, monkeypatch):
    """PyOpenGL finds no library of that name, and says so in words that only it understands."""
    library = {"__name__": "OpenGL.raw.GL"}
    exec("def missing(*_, **__): return None.glGetError", library)
    monkeypatch.setattr("trueup.stages.gap", library["missing"])
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    code, _, err = run("gap", demo)
    assert code == 2
    assert "MUJOCO_GL=osmesa" in err
    assert "Unset MUJOCO_GL" in err


def kill_after(logs, out, *, episodes):
    """Start an import and kill -9 it when so many episodes are there."""
    command = [sys.executable, "-m", "trueup.cli.main", "import", str(logs), "--out", str(out)]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    while process.poll() is None:
        with contextlib.suppress(TrueupError):  # not there yet
            if len(Dataset(out)) >= episodes:
                break
        time.sleep(0.002)
    process.kill()
    process.wait(timeout=60)


@pytest.mark.long
def test_an_import_that_was_killed_goes_on_with_resume(motion, tmp_path, run):
    """kill -9 in the middle: what was finished is readable, and a rerun completes it."""
    for index in range(60):
        other = motion.parent / f"motion{index:03d}"
        other.mkdir()
        for path in motion.iterdir():
            if path.is_file():
                os.link(path, other / path.name)
    for _ in range(10):  # a fast import may end before it is killed: try again
        shutil.rmtree(tmp_path / "data", ignore_errors=True)
        kill_after(motion.parent, tmp_path / "data", episodes=5)
        partial = Dataset(tmp_path / "data")
        if len(partial) < 61:
            break
    assert 5 <= len(partial) < 61
    for episode in partial:
        assert len(episode.measured) == 200
    assert run("import", motion.parent, "--out", tmp_path / "data")[0] == 2  # exists
    assert run("import", motion.parent, "--out", tmp_path / "data", "--resume")[0] == 0
    whole = Dataset(tmp_path / "data")
    assert len(whole) == 61
    assert run("import", motion.parent, "--out", tmp_path / "straight")[0] == 0
    assert whole.hash == Dataset(tmp_path / "straight").hash


@pytest.mark.long
def test_gap_json_is_what_other_programs_read(run, demo, tmp_path):
    run("replay", demo, "--robot", "demo_arm", "--label", "mujoco/json")
    run("gap", demo, "--runs", "mujoco/json", "--out", tmp_path / "gap")
    tree = json.loads((tmp_path / "gap" / "gap.json").read_text())
    rmse = tree["runs"]["mujoco/json"]["splits"]["test"]["position"]["rmse"]
    assert {"value", "low", "high", "unit", "per_joint"} <= set(rmse)
    assert rmse["value"] == pytest.approx(
        np.mean([rmse["per_joint"][joint]["value"] for joint in tree["scored_joints"]])
    )
    assert {"trueup", "git", "seed", "data_hash", "config", "packages"} <= set(tree["provenance"])


@pytest.mark.parametrize(("text", "seconds"), [("90s", 90.0), ("10m", 600.0), ("1.5h", 5400.0), ("none", None)])
def test_a_budget_is_a_time(text, seconds):
    assert options.budget_s(text) == seconds


@pytest.mark.parametrize("text", ["", "m", "0", "-3s", "ten minutes", "nan", "inf", "1e400h", "10 m!"])
def test_what_is_no_time_is_no_budget(run, demo, tmp_path, text):
    code, _, err = run("close", demo, "--robot", "demo_arm", "--out", tmp_path / "out", "--budget", text)
    assert code == 2
    assert "--budget" in err
    assert not (tmp_path / "out").exists()


def test_a_budget_without_a_unit_is_asked_which(run, demo, tmp_path):
    code, _, err = run("close", demo, "--robot", "demo_arm", "--out", tmp_path / "out", "--budget", "10")
    assert code == 2
    assert "no unit: got 10" in err
    assert "10s for seconds, or 10m for minutes" in err


@pytest.mark.parametrize("group", ["augment", "compensate", "policy", "deploy"])
def test_a_group_alone_shows_its_help_and_names_its_commands_where_one_is_none(run, group):
    code, out, err = run(group)
    assert (code, err) == (0, "")
    assert out.splitlines()[0].startswith(f"Usage: trueup {group}")
    commands = [line.split()[0] for line in out.partition("Commands:")[2].splitlines() if line.startswith("  ")]
    code, out, err = run(group, "nope")
    assert (code, out) == (2, "")
    said, following = err.strip().splitlines()
    assert "'nope'" in said
    assert all(name in said for name in commands)
    assert f"trueup {group} --help" in following


def test_a_wrong_option_names_the_help_of_its_command(run):
    assert "trueup deploy run --help" in run("deploy", "run", "zoo:panda-reach", "--nope")[2]


def test_what_the_machine_refuses_has_a_next_step(run, demo):
    code, _, err = run("gap", demo, "--out", "a" * 300)
    said, following = err.strip().splitlines()
    assert code == 2
    assert said.endswith("got File name too long")
    assert following == "  next: Give a shorter name."


@pytest.mark.parametrize("command", ["export", "gap"])
def test_a_path_that_leads_to_itself_is_no_bug(run, demo, tmp_path, command):
    (tmp_path / "loop").symlink_to("loop")
    code, _, err = run(command, demo, "--out", tmp_path / "loop")
    assert code == 2
    assert "bug" not in err
    assert (tmp_path / "loop").is_symlink()


def test_a_file_that_is_larger_than_the_memory_is_no_bug(run, tmp_path):
    (tmp_path / "logs").mkdir()
    with (tmp_path / "logs" / "run.jsonl").open("wb") as file:
        file.truncate(1 << 43)
    code, _, err = run("import", tmp_path / "logs", "--out", tmp_path / "out")
    assert code == 2
    assert "too little memory" in err
    assert "next:" in err
    assert not (tmp_path / "out").exists()


def test_the_loop_of_doctor_is_asked_for(run):
    code, out, err = run("doctor", "--hz", "100", "--cpu", "0")
    assert (code, out) == (2, "")
    assert "--hz, --cpu" in err
    assert "Give --realtime" in err


OUT_IS_A_FOLDER = {
    "export": ("export", "DATA"),
    "gap": ("gap", "DATA"),
    "identify": ("identify", "DATA", "--robot", "demo_arm"),
    "close": ("close", "DATA", "--robot", "demo_arm"),
    "demo": ("demo", "--robot", "demo_arm"),
    "record": ("record",),
    "design": ("design", "--robot", "demo_arm", "--count", "1"),
    "fleet": ("fleet", "DATA", "--robot", "demo_arm"),
    "augment train": ("augment", "train", "DATA"),
    "augment sweep": ("augment", "sweep", "DATA", "--method", "linear"),
    "augment eval": ("augment", "eval", "DATA", "--model", "zoo:panda-realeasy-rt"),
    "augment robustness": ("augment", "robustness", "DATA", "--model", "zoo:panda-realeasy-rt", "--robot", "panda"),
    "augment time": ("augment", "time", "zoo:panda-realeasy-rt"),
    "compensate train": ("compensate", "train", "DATA", "--robot", "demo_arm"),
    "policy train": ("policy", "train"),
    "policy grid": ("policy", "grid"),
    "policy eval": ("policy", "eval", "zoo:panda-reach"),
    "deploy run": ("deploy", "run", "zoo:panda-reach"),
    "deploy ros2": ("deploy", "ros2", "zoo:panda-realeasy-rt", "--localhost", "--domain", "98"),
}


@pytest.mark.long
@pytest.mark.parametrize("words", OUT_IS_A_FOLDER.values(), ids=OUT_IS_A_FOLDER)
@pytest.mark.parametrize("place", ["file", "file/below"])
def test_an_out_that_is_a_file_is_refused_before_any_work(run, demo, tmp_path, words, place):
    (tmp_path / "file").write_text("mine")
    code, out, err = run(*(demo if word == "DATA" else word for word in words), "--out", tmp_path / place)
    assert (code, out) == (2, "")
    said, following = err.strip().splitlines()
    assert said.startswith("error: ")
    assert following.startswith("  next: ")
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.long
def test_results_are_not_taken_for_data(run, tmp_path):
    assert run("demo", "--robot", "demo_arm", "--until", "gap", "--out", tmp_path / "results")[0] == 0
    results, data = tmp_path / "results", tmp_path / "results" / "dataset"
    for words in (("gap", results), ("close", results, "--robot", "demo_arm"), ("import", results)):
        code, _, err = run(*words, "--out", tmp_path / "out")
        assert code == 2
        assert f"{results} holds results; its data are in {data}" in err
    shutil.rmtree(data)
    assert "holds results, no data" in run("import", results, "--out", tmp_path / "out")[2]
    assert not (tmp_path / "out").exists()


def test_a_damaged_dataset_is_not_taken_for_logs(run, demo, tmp_path):
    broken = shutil.copytree(demo, tmp_path / "broken")
    text = (broken / "dataset.json").read_text()
    (broken / "dataset.json").write_text(text[:100])
    for words in (("gap", broken), ("close", broken, "--robot", "demo_arm"), ("import", broken)):
        code, _, err = run(*words, "--out", tmp_path / "out")
        assert code == 2
        assert "dataset.json is broken" in err
        assert "import the logs again" in err
    assert not (tmp_path / "out").exists()


@pytest.mark.long
def test_a_demo_that_was_interrupted_goes_on_with_what_it_recorded(run, tmp_path):
    words = ("demo", "--robot", "demo_arm", "--out", tmp_path / "out")
    assert run(*words, "--until", "replay")[0] == 0
    index = tmp_path / "out" / "dataset" / "episodes.parquet"
    made = index.stat().st_mtime_ns
    code, _, err = run(*words, "--until", "gap")
    assert (code, "--resume" in err) == (2, True)
    code, _, err = run(*words, "--until", "gap", "--resume", "--seed", "1")
    assert (code, "holds another recording" in err) == (2, True)
    assert run(*words, "--until", "gap", "--resume")[0] == 0
    assert index.stat().st_mtime_ns == made
    assert (tmp_path / "out" / "gap.json").is_file()


@pytest.mark.long
def test_a_demo_with_a_failed_step_is_exit_code_3(run, tmp_path, monkeypatch):
    monkeypatch.setattr("trueup.cli.close.lacking", lambda _: ["identify failed"])
    code, _, err = run("demo", "--robot", "demo_arm", "--until", "gap", "--out", tmp_path / "out")
    assert code == 3
    assert "identify failed" in err


def test_a_demo_of_another_robot_is_refused_before_it_is_announced(run, tmp_path):
    code, _, err = run("demo", "--robot", "nosuch", "--out", tmp_path / "out")
    assert code == 2
    assert err.startswith("error: ")
    assert "demo_arm" in err


def test_a_package_that_is_missing_somewhere_deep_is_no_bug(run, demo, monkeypatch):
    def lacking(*args, **kwargs):
        raise ModuleNotFoundError("No module named 'mink.lie'", name="mink.lie")

    monkeypatch.setattr("trueup.stages.gap", lacking)
    code, _, err = run("gap", demo)
    assert code == 2
    assert err.strip().endswith("next: pip install '.[plan]' in the checkout of trueup")


@pytest.mark.long
@pytest.mark.parametrize(
    ("package", "words"),
    [
        ("torch", ("augment", "train", "DATA", "--out", "made")),
        ("torch", ("policy", "train", "--out", "made")),
        ("onnxruntime", ("deploy", "run", "zoo:panda-reach")),
        ("cyclonedds", ("deploy", "serve")),
    ],
)
def test_a_package_that_is_not_installed_is_named_with_its_extra(demo, tmp_path, package, words):
    code, said = without(package, [str(demo) if word == "DATA" else word for word in words], tmp_path)
    assert code == 2
    assert package in said
    assert "pip install '.[" in said


def test_results_have_a_place_of_their_own_where_none_is_given(run, motion, tmp_path, monkeypatch):
    """Logs in logs/arm: data/arm, runs/arm; a fit of data/arm: runs/arm-fit; of what a close has imported, as that."""
    monkeypatch.chdir(tmp_path)
    code, _, err = run("import", motion.parent)
    assert code == 0, err
    assert Dataset(Path("data") / "logs").ids == ("wave",)
    assert options.folder_for(None, Path("logs/arm.csv.gz")) == Path("runs/arm")
    assert options.folder_for(None, Path("data/arm"), of="fit") == Path("runs/arm-fit")
    assert options.folder_for(None, Path("runs/first/dataset"), of="fit") == Path("runs/first-fit")
    assert options.folder_for(Path("here"), Path("data/arm")) == Path("here")
