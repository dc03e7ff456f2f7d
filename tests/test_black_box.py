"""trueup as a sceptical newcomer meets it: numbers that can be checked by hand, and input that nobody should trust."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import trueup
from trueup.cli.main import main

ARM = """<mujoco><worldbody>
  <body><joint name="yaw" axis="0 0 1"/><geom size=".05" mass="1"/>
  <body><joint name="shoulder" axis="0 1 0"/><geom size=".05" pos="0 0 .2" mass=".5"/>
  <body pos="0 0 .3"><joint name="elbow" axis="0 1 0"/><geom size=".05" pos="0 0 .2" mass=".2"/></body></body></body>
</worldbody></mujoco>"""
ROBOT = """name: arm
description: x
model: arm.xml
joints:
  - {name: yaw}
  - {name: shoulder}
  - {name: elbow}
controller: {kind: position, kp: 50.0, kv: 2.0}
simulation: {timestep_s: 0.002}
"""
MAPPING = """joints: [hip]
series:
  measured: {time: t, signals: {position: {columns: [q], unit: rad}}}
  command: {time: t, signals: {position: {columns: [u], unit: rad}}}
"""
ROWS = [f"{0.01 * k:.2f},{np.sin(k / 30):.6f},{np.sin(k / 30 + 0.1):.6f}" for k in range(200)]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("black_box") / "data"
    trueup.demo_dataset(folder)
    with pytest.raises(SystemExit) as left:
        main(["replay", str(folder), "--robot", "demo_arm"])
    assert left.value.code == 0
    return folder


@pytest.fixture
def data(made, tmp_path):
    """A dataset with one run that a test may spoil."""
    return shutil.copytree(made, tmp_path / "data")


@pytest.fixture
def robot(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    (tmp_path / "arm.yaml").write_text(ROBOT)
    return tmp_path / "arm.yaml"


@pytest.fixture
def logs(tmp_path):
    """A folder with one CSV motion of one joint and its mapping."""
    folder = tmp_path / "logs"
    folder.mkdir()
    (folder / "swing.csv").write_text("\n".join(["t,q,u", *ROWS]) + "\n")
    (folder / "mapping.yaml").write_text(MAPPING)
    return folder


@pytest.fixture
def run(capsys):
    """Call the command line; return exit code, output and error; check what holds for every error."""

    def call(*arguments):
        capsys.readouterr()
        with pytest.raises(SystemExit) as left:
            main([str(argument) for argument in arguments])
        printed = capsys.readouterr()
        assert left.value.code in (0, 2, 3), printed.err
        assert "Traceback" not in printed.err
        assert ("error: " in printed.err) == (left.value.code != 0)
        return left.value.code, printed.out, printed.err

    return call


def rmse_by_hand(folder, label, split):
    """Of each motion, the mean over joints of the RMSE, without any of trueup's metrics."""
    data = trueup.Dataset(folder)
    errors = []
    for motion in (name for name, of in data.splits.items() if of == split):
        episode = data.episode(motion, runs=[label])
        simulated, measured = episode.simulated[label], episode.measured
        columns = [np.interp(simulated.time_s, measured.time_s, column) for column in measured["position"].T]
        errors.append(np.sqrt(np.mean((np.column_stack(columns) - simulated["position"]) ** 2, axis=0)).mean())
    return np.array(errors)


def test_the_gap_is_the_rmse_that_numpy_computes(run, made, tmp_path):
    assert run("gap", made, "--out", tmp_path / "gap", "--signals", "position")[0] == 0
    splits = json.loads((tmp_path / "gap" / "gap.json").read_text())["runs"]["mujoco/stock"]["splits"]
    for split in ("train", "val", "test"):
        assert splits[split]["position"]["rmse"]["value"] == pytest.approx(
            rmse_by_hand(made, "mujoco/stock", split).mean(), rel=1e-6
        )
    errors = rmse_by_hand(made, "mujoco/stock", "train")
    draws = np.random.default_rng(0).choice(errors, (4000, len(errors))).mean(axis=1)
    low, high = np.percentile(draws, [2.5, 97.5])
    rmse = splits["train"]["position"]["rmse"]
    assert rmse["low"] < low  # of six motions: wider than the plain bootstrap
    assert rmse["high"] > high


def test_a_paired_difference_is_that_of_the_two_values(run, made, tmp_path):
    assert run("gap", made, "--out", tmp_path / "gap", "--signals", "position")[0] == 0
    tree = json.loads((tmp_path / "gap" / "gap.json").read_text())
    value = {name: of["splits"]["test"]["position"]["rmse"]["value"] for name, of in tree["runs"].items()}
    (pair,) = (p for p in tree["paired"] if (p["split"], p["signal"], p["metric"]) == ("test", "position", "rmse"))
    difference = pair["difference"]
    assert difference["value"] == pytest.approx(value[pair["run"]] - value[pair["baseline"]])
    assert pair["relative"] == pytest.approx(difference["value"] / value[pair["baseline"]])
    assert (pair["verdict"] == "undecided") == (difference["low"] <= 0 <= difference["high"])


@pytest.mark.long
def test_the_same_question_gets_the_same_answer(run, made, tmp_path):
    trees = []
    for name in ("one", "two"):
        assert run("gap", made, "--out", tmp_path / name, "--signals", "position", "--seed", 3)[0] == 0
        trees.append(json.loads((tmp_path / name / "gap.json").read_text()))
        assert trees[-1]["provenance"].pop("created")
        assert run("report", tmp_path / name, "--out", tmp_path / f"{name}.html")[0] == 0
        assert (tmp_path / f"{name}.html").read_bytes() == (tmp_path / name / "report.html").read_bytes()
    assert trees[0] == trees[1]


def test_the_interval_of_a_single_motion_is_left_out(run, logs, tmp_path):
    assert run("import", logs, "--out", tmp_path / "one")[0] == 0
    (tmp_path / "hip.yaml").write_text("name: one\nmodel: hip.xml\njoints: [{name: hip}]\n")
    code, _, _ = run("gap", tmp_path / "one", "--robot", tmp_path / "hip.yaml", "--out", tmp_path / "gap")
    assert code == 0
    rmse = json.loads((tmp_path / "gap" / "gap.json").read_text())["runs"]["command"]["splits"]["all"]["position"][
        "rmse"
    ]
    by_hand = np.array([[float(cell) for cell in row.split(",")] for row in ROWS])
    assert rmse["value"] == pytest.approx(np.sqrt(np.mean((by_hand[:, 1] - by_hand[:, 2]) ** 2)))
    assert rmse["low"] is None
    assert rmse["high"] is None


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("name: elbow", "name: elbwo", "model [yaw, shoulder, elbow]"),
        ("name: elbow", "name: elbow, sign: 2", "1, -1"),
        ("name: elbow", "name: elbow, log_unit: parsec", "rad, deg"),
        ("kind: position", "kind: positon", "velocity-integrator"),
        ("timestep_s", "timestep", "timestep_s"),
        ("model: arm.xml", "model: leg.xml", "--model"),
        ("description: x", "description: !!python/object/apply:os.system [exit]", "plain YAML"),
    ],
    ids=["joint", "sign", "unit", "kind", "key", "model", "tag"],
)
def test_a_typo_in_robot_yaml_says_what_was_expected(run, data, robot, old, new, says):
    robot.write_text(ROBOT.replace(old, new))
    code, _, err = run("replay", data, "--robot", robot, "--label", "mujoco/typo")
    assert (code, says in err) == (2, True)
    assert trueup.Dataset(data).runs == ("mujoco/stock",)


def test_a_joint_that_counts_the_other_way_round_is_another_robot(run, data, robot):
    robot.write_text(ROBOT.replace("name: elbow", "name: elbow, sign: -1"))
    assert run("replay", data, "--robot", robot, "--label", "mujoco/flipped")[0] == 0
    code, _, err = run("gap", data)
    assert (code, "joint maps" in err) == (2, True)
    assert run("gap", data, "--runs", "mujoco/flipped", "--signals", "position")[0] == 0


@pytest.mark.parametrize("label", ["../outside", "/tmp/outside", "a b", "", "mujoco/stock", "mujoco"])
def test_a_label_is_neither_a_path_nor_taken(run, data, label):
    before = sorted(path.name for path in data.parent.iterdir())
    assert run("replay", data, "--robot", "demo_arm", "--label", label)[0] == 2
    assert sorted(path.name for path in data.parent.iterdir()) == before
    assert trueup.Dataset(data).runs == ("mujoco/stock",)


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        ([], "no rows"),
        ([*ROWS[:100], *ROWS[50:]], "runs backwards"),
        ([*ROWS[:9], "nan,0,0", *ROWS[10:]], "not finite"),
        ([*ROWS[:9], "0.09,inf,0", *ROWS[10:]], "finite"),
        ([*ROWS[:9], "0.09,zero,0", *ROWS[10:]], "line 11"),
        ([*ROWS[:9], "0.09,0", *ROWS[10:]], "wrong length"),
        ([row.replace(".", ",") for row in ROWS], "wrong length"),
    ],
    ids=["empty", "backwards", "nan-clock", "inf", "text", "ragged", "decimal-commas"],
)
def test_a_broken_motion_is_named_and_the_others_are_kept(run, logs, tmp_path, rows, says):
    (logs / "broken.csv").write_text("\n".join(["t,q,u", *rows]) + "\n")
    code, _, err = run("import", logs, "--out", tmp_path / "out")
    assert code == 2
    assert "broken" in err
    assert says in err
    data = trueup.Dataset(tmp_path / "out")
    assert data.ids == ("swing",)
    assert len(data["swing"].measured) == len(ROWS)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("unit: rad", "unit: furlong", "deg"),
        ("position:", "positon:", "position"),
        ("[q]", "[q, u]", "one column each"),
        ("command:", "commnd:", "command"),
        ("joints: [hip]", "joints: [hip]\nepisodes: '(['", "regular expression"),
        ("joints: [hip]", "joints: [hip]\nid: '../../x'", "no episode id"),
        ("joints: [hip]", "joints: [hip]\nrobot: !!python/name:os.system ''", "plain YAML"),
        ("  command: {", "  command: {file: ../../secret.csv, ", "out of the folder"),
    ],
    ids=["unit", "signal", "columns", "series", "regex", "id", "tag", "path"],
)
def test_a_mapping_that_is_wrong_writes_nothing(run, logs, tmp_path, old, new, says):
    (logs / "mapping.yaml").write_text(MAPPING.replace(old, new))
    code, _, err = run("import", logs, "--out", tmp_path / "out")
    assert (code, says in err) == (2, True)
    assert not (tmp_path / "out").exists()


def test_a_pickle_in_an_npz_is_never_run(run, tmp_path):
    class Trap:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "sprung"),)

    (tmp_path / "logs").mkdir()
    trap = np.array([[Trap()]], dtype=object)
    arrays = {"joints": np.array(["hip"]), "measured.time_s": np.zeros(1), "measured.position": trap}
    np.savez(tmp_path / "logs" / "trap.npz", **arrays)
    code, _, err = run("import", tmp_path / "logs", "--out", tmp_path / "out")
    assert (code, "pickle" in err) == (2, True)
    assert not (tmp_path / "sprung").exists()


@pytest.mark.parametrize(
    ("split", "code", "says"),
    [
        ({"train": ["nobody", "swing"]}, 0, "nobody"),
        ({"train": ["swing"], "test": ["swing"]}, 2, "two splits"),
        ({"training": ["swing"]}, 2, "training"),
        (["swing"], 2, "no split file"),
    ],
    ids=["unknown-motion", "twice", "unknown-split", "list"],
)
def test_a_split_that_fits_badly_is_told(run, logs, tmp_path, split, code, says):
    (logs / "split.json").write_text(json.dumps(split))
    got, out, err = run("import", logs, "--out", tmp_path / "out")
    assert (got, says in out + err) == (code, True)


def test_logs_are_never_written_over(run, logs, tmp_path):
    before = {path.name: path.read_bytes() for path in logs.iterdir()}
    for out in (logs, logs / ".." / logs.name):
        for more in ([], ["--overwrite"]):
            assert run("import", logs, "--out", out, *more)[0] == 2
    assert {path.name: path.read_bytes() for path in logs.iterdir()} == before


def test_overwrite_deletes_no_folder_that_is_not_a_dataset(run, logs, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("years")
    (tmp_path / "file").write_text("days")
    for out in ("mine", "file"):
        assert run("import", logs, "--out", tmp_path / out, "--overwrite")[0] == 2
    assert (tmp_path / "mine" / "thesis.txt").read_text() == "years"
    assert (tmp_path / "file").read_text() == "days"


@pytest.mark.parametrize("how", ["flipped", "cut", "empty"])
@pytest.mark.parametrize(
    "name", ["measured/00000.parquet", "simulated/mujoco/stock/00000.parquet", "episodes.parquet", "dataset.json"]
)
def test_a_damaged_file_is_found_not_read(run, data, name, how):
    whole = (data / name).read_bytes()
    middle = len(whole) // 3
    flipped = whole[:middle] + bytes(byte ^ 255 for byte in whole[middle : middle + 8]) + whole[middle + 8 :]
    (data / name).write_bytes({"flipped": flipped, "cut": whole[: len(whole) // 2], "empty": b""}[how])
    code, out, err = run("gap", data, "--signals", "position")
    assert (code, name in err) == (2, True)
    assert "rad" not in out


@pytest.mark.parametrize(
    "change", [{"schema": "trueup.dataset/99"}, {"model": "../.."}, {"model": "/etc"}, {"joints": "abc"}]
)
def test_a_dataset_of_another_version_or_that_points_outside_is_refused(run, data, change):
    path = data / "dataset.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    assert run("gap", data)[0] == 2
    assert run("replay", data, "--robot", "demo_arm", "--label", "mujoco/x")[0] == 2


@pytest.mark.parametrize("name", ["gap.json", "analysis.json", "quality.json", "traces.json", "traces.npz"])
def test_a_report_of_broken_results_is_refused_and_the_old_one_kept(run, made, tmp_path, name):
    out = tmp_path / "gap"
    assert run("gap", made, "--out", out, "--signals", "position")[0] == 0
    before = (out / "report.html").read_bytes()
    (out / name).write_bytes((out / name).read_bytes()[:300])
    code, _, err = run("report", out)
    assert (code, name.split(".")[0] in err) == (2, True)
    assert (out / "report.html").read_bytes() == before


@pytest.mark.long
@pytest.mark.parametrize(
    ("bar", "code"),
    [
        ("position.rmse=0.0001", 3),
        ("position.rmse=nan", 2),
        ("position.rmse<1", 2),
        ("current.rmse=1", 2),
        ("nobody::position.rmse=1", 2),
        (":nowhere:position.rmse=1", 2),
        ("position.pearson=0.9", 2),
        ("mujoco/stock:test:position.rmse=1", 0),
    ],
)
def test_a_bar_never_passes_by_mistake(run, made, bar, code):
    assert run("gap", made, "--fail-above", bar)[0] == code


@pytest.mark.long
def test_a_bar_needs_a_simulated_run(run, data):
    shutil.rmtree(data / "simulated")
    assert run("gap", data, "--robot", "demo_arm", "--fail-above", "position.rmse=9")[0] == 2


def limited(*arguments, kilobytes):
    """Run trueup where no file may grow beyond a size, as on a full disk."""
    code = "import resource, sys; from trueup.cli.main import main; size = 1024 * int(sys.argv.pop(1)); "
    code += "resource.setrlimit(resource.RLIMIT_FSIZE, (size, size)); main()"
    command = [sys.executable, "-c", code, str(kilobytes), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.long
def test_a_full_disk_loses_nothing_that_was_finished(run, logs, tmp_path):
    rows = [f"{0.001 * k:.3f},{np.sin(k * k):.9f},{np.cos(k * k):.9f}" for k in range(4000)]
    for index in range(6):
        (logs / f"long{index}.csv").write_text("\n".join(["t,q,u", *rows]) + "\n")
    full = limited("import", logs, "--out", tmp_path / "out", kilobytes=300)
    assert full.returncode == 2, full.stderr
    assert "Traceback" not in full.stderr
    partial = trueup.Dataset(tmp_path / "out")
    assert len(partial) < 7
    for episode in partial:
        assert len(episode.measured) in (200, 4000)
    assert run("import", logs, "--out", tmp_path / "out", "--resume")[0] == 0
    assert run("import", logs, "--out", tmp_path / "straight")[0] == 0
    assert trueup.Dataset(tmp_path / "out").hash == trueup.Dataset(tmp_path / "straight").hash


@pytest.mark.long
def test_a_replay_that_was_killed_is_completed_and_only_with_the_same_settings(run, data):
    command = [
        sys.executable,
        "-m",
        "trueup.cli.main",
        "replay",
        str(data),
        "--robot",
        "demo_arm",
        "--label",
        "cut/off",
    ]
    process = subprocess.Popen([*command, "--jobs", "1"], stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    deadline = time.monotonic() + 30
    while time.monotonic() < deadline and process.poll() is None and not (data / "simulated" / "cut" / "off").exists():
        time.sleep(0.002)
    time.sleep(0.03)
    process.send_signal(signal.SIGKILL)
    process.wait()
    partial = trueup.Dataset(data)
    for motion in partial.run_ids("cut/off") if "cut/off" in partial.runs else ():
        assert len(partial.episode(motion, runs=["cut/off"]).simulated["cut/off"]) > 900
    again = ("replay", data, "--robot", "demo_arm", "--label", "cut/off")
    if "cut/off" in partial.runs:
        assert run(*again)[0] == 2
        assert run(*again, "--resume", "--delay-s", 0.1)[0] == 2
    assert run(*again, "--resume")[0] == 0
    whole = trueup.Dataset(data)
    assert len(whole.run_ids("cut/off")) == len(whole)
    np.testing.assert_allclose(
        rmse_by_hand(data, "cut/off", "test"), rmse_by_hand(data, "mujoco/stock", "test"), rtol=1e-12
    )


@pytest.mark.long
def test_of_two_imports_into_one_folder_one_is_whole(logs, tmp_path):
    for index in range(30):
        shutil.copy(logs / "swing.csv", logs / f"swing{index}.csv")
    command = [sys.executable, "-m", "trueup.cli.main", "import", str(logs), "--out", str(tmp_path / "out")]
    both = [subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) for _ in range(2)]
    errors = [process.communicate(timeout=60)[1] for process in both]
    assert sorted(process.returncode for process in both) == [0, 2]
    assert "Traceback" not in "".join(errors)
    assert len(list(trueup.Dataset(tmp_path / "out"))) == 31
