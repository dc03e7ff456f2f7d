"""Searching a grid of trainings: every point once, whatever happens in between, and the same whoever trains it."""

import contextlib
import errno
import fcntl
import importlib.util
import json
import os
import signal
import sqlite3
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import optuna
import pytest
import torch
import yaml
from safetensors import safe_open

from stages import grid_errands
from trueup.augment.config import CHECKPOINT_NAME
from trueup.cli.main import main
from trueup.core.atomic import file_hash
from trueup.core.policy_card import PolicyCard
from trueup.errors import DataError, OutputExists
from trueup.policy import training
from trueup.policy.config import LearnerConfig, PolicyConfig
from trueup.policy.grid import read_grid
from trueup.policy.reach import ReachConfig
from trueup.robots import load_robot
from trueup.stages import grid_study, policy_grid
from trueup.stages.policy_grid import search_grid

PANDA = load_robot("panda_torque")
SMALL = {
    "algorithm": "td3",
    "reach": {"control_hz": 25.0, "episode_s": 0.4},
    "learner": {"starts": 40, "updates": 1, "batch": 16, "layers": [16], "buffer": 2000},
    "arms": 4,
    "steps": 160,
    "rounds": 2,
}
CONFIG = PolicyConfig(
    algorithm="td3",
    reach=ReachConfig(control_hz=25.0, episode_s=0.4),
    learner=LearnerConfig(starts=40, updates=1, batch=16, layers=(16,), buffer=2000),
    arms=4,
    steps=160,
    rounds=2,
)
AXES = {"rate": [1.0e-3, 5.0e-2], "gamma": [0.8, 0.95]}
GRID = read_grid(AXES, "grid")


def searched(out, **options):
    return search_grid(PANDA, out, **{"config": CONFIG, "grid": GRID, "jobs": 1, **options})


def states(out):
    """Parameters and state of all trials, as Optuna reads its database."""
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    storage = grid_study._opened(out / "study.db")
    (name,) = optuna.get_all_study_names(storage)
    trials = optuna.load_study(study_name=name, storage=storage).trials
    grid_study._closed(storage)
    return [(tuple(sorted(trial.params.items())), trial.state.name) for trial in trials]


def every_point_once(out, grid=GRID):
    found = states(out)
    assert {state for _, state in found} == {"COMPLETE"}
    assert len(found) == len({values for values, _ in found}) == len(grid)


def cards(out):
    """Time and content of all policies there are."""
    return {file: (file.stat().st_mtime_ns, file_hash(file)) for file in out.glob("trials/*/policy.json")}


def figures(found):
    """What does not depend on the clock."""
    return [
        (trial.point.id, trial.reason, [(item.steps, item.reward, item.distance_m) for item in trial.rounds])
        for trial in found.trials
    ]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A search that was not interrupted."""
    out = tmp_path_factory.mktemp("whole")
    return searched(out), out


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.yaml").write_text(yaml.safe_dump(SMALL))
    (tmp_path / "grid.yaml").write_text(yaml.safe_dump(AXES, sort_keys=False))

    def call(*arguments, config="small.yaml", grid="grid.yaml"):
        with pytest.raises(SystemExit) as caught:
            main(["policy", "grid", "--config", config, "--grid", grid, *map(str, arguments)])
        printed = capsys.readouterr()
        return caught.value.code, printed.out, printed.err

    return call


@pytest.mark.long
def test_from_a_grid_to_the_best_policy(run, tmp_path, whole):
    code, out, err = run("--out", "g", "--jobs", 2)
    assert code == 0
    assert "grid: 0/4 trials" in err
    assert "I 20" not in err  # Optuna's own log
    said = json.loads((tmp_path / "g" / "grid.json").read_text())
    best = max(said["trials"], key=lambda item: item["reward"])
    assert said["best"] == best["id"]
    assert f"best policy: g/trials/{said['best']}" in out
    assert f"next: trueup policy eval g/trials/{said['best']} --robot panda_torque" in out
    assert said["schema"] == "trueup.policy-grid/1"
    assert said["axes"] == {"learner.rate": [[0.001], [0.05]], "learner.gamma": [[0.8], [0.95]]}
    assert said["provenance"]["config"]["steps"] == 160
    assert [item["values"]["learner.gamma"] for item in said["trials"]] == [0.8, 0.95, 0.8, 0.95]
    assert said["curve"] == ["steps", "seconds", "reward", "distance_m"]
    for item in said["trials"]:
        assert item["state"] == "complete"
        card = PolicyCard.load(tmp_path / "g" / item["folder"])
        history = card.provenance["history"]
        assert item["curve"] == [[entry[name] for name in said["curve"]] for entry in history]
        assert item["reward"] == max(entry["reward"] for entry in history)
        assert item["distance_m"] == max(history, key=lambda entry: entry["reward"])["distance_m"]
        assert card.provenance["config"]["learner"]["rate"] == item["values"]["learner.rate"]
        assert not (tmp_path / "g" / item["folder"] / CHECKPOINT_NAME).exists()
    every_point_once(tmp_path / "g")
    # Neither the number of processes nor what is beside a trial has a part in it.
    again = searched(tmp_path / "g", resume=True)
    assert figures(again) == figures(whole[0])
    for trial in again.trials:
        assert file_hash(trial.folder / "policy.onnx") == file_hash(
            whole[1] / "trials" / trial.point.id / "policy.onnx"
        )


@pytest.mark.long
def test_what_is_there_is_not_lost(run, tmp_path):
    assert run("--out", "g", "--jobs", 1)[0] == 0
    before = cards(tmp_path / "g")
    code, _, err = run("--out", "g", "--jobs", 1)
    assert code == 2
    assert "is not empty" in err
    assert "--resume" in err
    (tmp_path / "other.yaml").write_text(yaml.safe_dump({**SMALL, "rounds": 4}))
    (tmp_path / "finer.yaml").write_text(yaml.safe_dump({**AXES, "gamma": [0.8, 0.9]}))
    for other in ({"config": "other.yaml"}, {"grid": "finer.yaml"}):
        code, _, err = run("--out", "g", "--resume", "--jobs", 1, **other)
        assert code == 2
        assert "another grid, or one of another robot, configuration or seed" in err
        assert "next: Give --overwrite" in err
    assert "another grid" in run("--out", "g", "--resume", "--jobs", 1, "--seed", 1)[2]
    assert cards(tmp_path / "g") == before
    every_point_once(tmp_path / "g")
    code, out, _ = run("--out", "g", "--resume", "--jobs", 1)
    assert code == 0
    assert "4 trials, all in g/grid.json" in out
    assert cards(tmp_path / "g") == before
    (tmp_path / "g" / "trials" / "notes.txt").write_text("mine")
    assert run("--out", "g", "--overwrite", "--jobs", 1, "--seed", 1, grid="finer.yaml")[0] == 0
    assert (tmp_path / "g" / "trials" / "notes.txt").read_text() == "mine"
    assert len(cards(tmp_path / "g")) == 4
    assert not set(cards(tmp_path / "g").values()) & set(before.values())
    every_point_once(tmp_path / "g")


def test_a_folder_of_something_else_is_left_alone(run, tmp_path):
    (tmp_path / "mine" / "trials").mkdir(parents=True)
    (tmp_path / "mine" / "thesis.txt").write_text("mine")
    for option in ("--overwrite", "--resume"):
        code, _, err = run("--out", "mine", option)
        assert code == 2
        assert "something else than a grid" in err
    assert sorted(file.name for file in (tmp_path / "mine").iterdir()) == ["thesis.txt", "trials"]


def test_nothing_is_made_for_points_or_robots_that_cannot_be(run, tmp_path):
    (tmp_path / "odd.yaml").write_text("steps: [160, 4]\n")
    code, _, err = run("--out", "g", grid="odd.yaml")
    assert code == 2
    assert "no training with steps 4" in err
    code, _, err = run("--out", "g", "--robot", "panda")
    assert code == 2
    assert "follows them" in err
    assert not (tmp_path / "g").exists()


def stand(checkpoint):
    """The rounds that a checkpoint comes after; none if there is none at this moment."""
    with contextlib.suppress(Exception), safe_open(checkpoint, framework="pt") as file:
        return json.loads(file.metadata()["state"])["history"]
    return []


def everybody_gone(group):
    deadline = time.monotonic() + 30
    while time.monotonic() < deadline:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.05)
    return False


@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_a_search_that_was_killed_goes_on(tmp_path, how):
    """Trials that were finished are left alone, others go on from their checkpoints."""
    (tmp_path / "small.yaml").write_text(yaml.safe_dump({**SMALL, "steps": 4800, "rounds": 40}))
    # One trial is over soon, so that others are half trained when it ends.
    axes = {"steps": [160, 4800], "gamma": [0.8, 0.95]}
    (tmp_path / "grid.yaml").write_text(yaml.safe_dump(axes))
    command = [sys.executable, "-m", "trueup.cli.main", "policy", "grid", "--out", "g", "--resume", "--jobs", "2"]
    command += ["--config", "small.yaml", "--grid", "grid.yaml"]
    process = subprocess.Popen(command, cwd=tmp_path, start_new_session=True, stderr=subprocess.PIPE, text=True)
    out = tmp_path / "g"

    def half():
        checkpoints = list(out.glob(f"trials/*/{CHECKPOINT_NAME}"))
        told = [state for _, state in states(out)].count("COMPLETE") if (out / "study.db").exists() else 0
        return told and any(5 <= len(stand(checkpoint)) <= 25 for checkpoint in checkpoints)

    deadline = time.monotonic() + 120
    while not half() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(how)  # to the first process only; the others end with it
    _, problems = process.communicate(timeout=60)
    assert everybody_gone(process.pid)
    assert "Traceback" not in problems
    if how == signal.SIGINT:
        assert process.returncode == 130
        assert "What was finished is kept" in problems
    finished = cards(out)
    assert 1 <= len(finished) < 4
    assert not (out / "grid.json").exists()
    assert "RUNNING" in {state for _, state in states(out)}
    begun = {file.parent: stand(file) for file in out.glob(f"trials/*/{CHECKPOINT_NAME}")}
    assert any(begun.values())

    with pytest.raises(SystemExit) as caught:
        main(
            [
                *command[3:-4],
                "--out",
                str(out),
                *("--config", str(tmp_path / "small.yaml")),
                "--grid",
                str(tmp_path / "grid.yaml"),
            ]
        )
    assert caught.value.code == 0
    every_point_once(out)
    now = cards(out)
    assert len(now) == 4
    assert {file: now[file] for file in finished} == finished
    for folder, rounds in begun.items():
        history = PolicyCard.load(folder).provenance["history"]
        assert history[: len(rounds)] == rounds  # with the seconds that they took
        assert len(history) == 40
    said = json.loads((out / "grid.json").read_text())
    assert [item["state"] for item in said["trials"]] == ["complete"] * 4
    assert {len(item["curve"]) for item in said["trials"]} == {40}


@pytest.mark.slow
def test_a_search_that_was_killed_while_it_asked_has_every_point_once(tmp_path, monkeypatch):
    """Between the steps in which Optuna writes a trial down."""

    class Killed(BaseException):
        pass

    def at(moment):
        own = getattr(grid_study.RDBStorage, moment)
        left = [2]

        def killed(self, *given, **options):
            left[0] -= 1
            if left[0] < 0:
                raise Killed
            return own(self, *given, **options)

        return killed

    writes = ("_create_new_trial", "set_trial_system_attr", "_set_trial_param", "set_trial_user_attr")
    for moment in (*writes, "set_trial_state_values"):
        out = tmp_path / moment
        with monkeypatch.context() as patch:
            patch.setattr(grid_study.RDBStorage, moment, at(moment))
            with pytest.raises(Killed):
                searched(out)
        if moment != "_create_new_trial":
            assert "RUNNING" in {state for _, state in states(out)}
        finished = cards(out)
        found = searched(out, resume=True)
        assert len(found.trials) == 4
        every_point_once(out)
        assert {file: cards(out)[file] for file in finished} == finished


@pytest.fixture
def diverging(monkeypatch):
    """Trainings with the high rate come to numbers that are not finite in their second round."""
    begun = []
    write, make = training._write, training.make_learner

    def counted(config, *given, **options):
        begun.append(config.learner.rate)
        return make(config, *given, **options)

    def poisoned(path, stand, learner, best):
        write(path, stand, learner, best)
        if learner.learning_rate == 0.05:
            with torch.no_grad():
                next(iter(learner.policy.actor.parameters())).fill_(float("nan"))

    monkeypatch.setattr(training, "_write", poisoned)
    monkeypatch.setattr(training, "make_learner", counted)
    return begun


@pytest.mark.long
def test_a_trial_that_diverges_is_noted_and_not_tried_again(tmp_path, diverging, whole):
    found = searched(tmp_path)
    assert sorted(diverging) == [0.001, 0.001, 0.05, 0.05]
    assert [bool(trial.reason) for trial in found.trials] == [False, False, True, True]
    said = json.loads((tmp_path / "grid.json").read_text())
    failed = [item for item in said["trials"] if item["state"] == "failed"]
    assert {item["values"]["learner.rate"] for item in failed} == {0.05}
    for item in failed:
        assert "training diverged: got round 2" in item["reason"]
        assert item["reward"] is item["distance_m"] is None
        assert len(item["curve"]) == 1  # the round before
        assert not list((tmp_path / item["folder"]).iterdir())
    assert figures(found)[:2] == figures(whole[0])[:2]
    assert {state for _, state in states(tmp_path)} == {"COMPLETE", "FAIL"}
    diverging.clear()
    assert figures(searched(tmp_path, resume=True)) == figures(found)
    assert diverging == []


def test_a_search_whose_trials_all_diverge(run, tmp_path, diverging):
    (tmp_path / "high.yaml").write_text("rate: [0.05]\n")
    code, _, err = run("--out", "g", "--jobs", 1, grid="high.yaml")
    assert code == 2
    assert "every trial of the grid has diverged" in err
    assert "next: Lower learner.rate" in err
    assert json.loads((tmp_path / "g" / "grid.json").read_text())["best"] is None


@pytest.mark.long
def test_a_table_says_how_many_failed(run, diverging):
    code, out, err = run("--out", "g", "--jobs", 1)
    assert code == 0
    assert "2 of 4 trials failed" in err
    assert "best of 4 trials" in out
    assert out.count(" cm ") == 4  # two rows, two distances each


@pytest.mark.long
@pytest.mark.parametrize("after", [3, 6, 9])
def test_a_full_disk_is_said_and_nothing_is_lost(run, tmp_path, monkeypatch, after, whole):
    sync, left = os.fsync, [after]

    def full(descriptor):
        left[0] -= 1
        if left[0] < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        sync(descriptor)

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        code, _, err = run("--out", "g", "--jobs", 1)
    assert code == 2
    lines = [line for line in err.splitlines() if not line.startswith("grid:")]
    assert len(lines) == 2
    assert "error: trial " in lines[0]
    assert "No space left on device" in lines[0]
    assert "--resume" in lines[1]
    finished = cards(tmp_path / "g")
    assert "FAIL" not in {state for _, state in states(tmp_path / "g")}
    assert run("--out", "g", "--jobs", 1, "--resume")[0] == 0
    every_point_once(tmp_path / "g")
    assert {file: cards(tmp_path / "g")[file] for file in finished} == finished
    assert not list((tmp_path / "g").rglob("*.tmp"))
    assert figures(searched(tmp_path / "g", resume=True)) == figures(whole[0])


@pytest.mark.long
def test_a_database_that_cannot_grow(run, tmp_path, monkeypatch):
    opened = sqlite3.connect

    def small(path, *given, **options):
        connection = opened(path, *given, **options)
        if Path(path).name == "study.db":
            pages = connection.execute("PRAGMA page_count").fetchone()[0]
            connection.execute(f"PRAGMA max_page_count = {pages}")
        return connection

    (tmp_path / "small.yaml").write_text(yaml.safe_dump({**SMALL, "rounds": 20}))
    assert run("--out", "g", "--jobs", 1)[0] == 0
    finished = cards(tmp_path / "g")
    with opened(tmp_path / "g" / "study.db") as connection:  # as it is while the last trials are under way
        connection.execute("DELETE FROM trial_values")
        connection.execute("DELETE FROM trial_user_attributes")
        connection.execute("UPDATE trials SET state = 'RUNNING'")
        connection.commit()
        connection.execute("VACUUM")
    connection.close()
    with monkeypatch.context() as patch:
        patch.setattr(grid_study.sqlite3, "connect", small)
        code, _, err = run("--out", "g", "--jobs", 1, "--resume")
    assert code == 2
    assert "cannot use the database" in err
    assert "database or disk is full" in err
    assert "Trials are kept" in err
    assert run("--out", "g", "--jobs", 1, "--resume")[0] == 0
    assert cards(tmp_path / "g") == finished
    every_point_once(tmp_path / "g")


@pytest.mark.long
def test_a_broken_database_and_a_second_search(run, tmp_path):
    assert run("--out", "g", "--jobs", 1)[0] == 0
    content = (tmp_path / "g" / "study.db").read_bytes()
    for broken in (b"no database" * 1000, content[:5000], b""):
        (tmp_path / "g" / "study.db").write_bytes(broken)
        code, _, err = run("--out", "g", "--jobs", 1, "--resume")
        assert code == 2
        assert "study.db" in err or "another grid" in err
        assert "bug" not in err
    (tmp_path / "g" / "study.db").write_bytes(content)
    descriptor = os.open(tmp_path / "g", os.O_RDONLY)
    fcntl.flock(descriptor, fcntl.LOCK_EX)
    code, _, err = run("--out", "g", "--jobs", 1, "--resume")
    os.close(descriptor)
    assert code == 2
    assert "another process writes into" in err


@pytest.mark.long
def test_killed_before_there_was_a_database_it_begins(tmp_path, whole):
    for name in (".study.db.k3j2.tmp", ".study.db.k3j2.tmp-journal"):
        (tmp_path / name).write_bytes(b"half of it")
    assert figures(searched(tmp_path, resume=True)) == figures(whole[0])
    assert not list(tmp_path.glob(".*"))


@pytest.mark.long
def test_a_trial_of_something_else_stops_the_search_and_says_where(tmp_path):
    found = searched(tmp_path)
    victim = found.trials[1]
    (victim.folder / "policy.json").write_text("{")
    (tmp_path / "study.db").unlink()
    with pytest.raises(DataError, match=rf"trial {victim.point.id}.*policy.json") as caught:
        searched(tmp_path, resume=True)
    assert "--resume" in caught.value.hint
    for file in victim.folder.iterdir():
        file.unlink()
    assert figures(searched(tmp_path, resume=True)) == figures(found)


@pytest.mark.long
def test_seeds_are_an_axis_and_layers_are_lists(tmp_path):
    grid = read_grid({"seed": [0, 1], "layers": [[8], [8, 8]]}, "grid")
    found = searched(tmp_path, grid=grid, config=replace(CONFIG, steps=80, rounds=1))
    assert [trial.point.values for trial in found.trials] == [
        {"seed": seed, "learner.layers": layers} for seed in (0, 1) for layers in ([8], [8, 8])
    ]
    seeds = {PolicyCard.load(trial.folder).provenance["seed"] for trial in found.trials}
    assert seeds == {0, 1}
    assert len({trial.rounds[-1].reward for trial in found.trials}) == 4
    assert [trial.point.id for trial in found.ranking] == [
        found.trials[index].point.id for index in np.argsort([-trial.best.reward for trial in found.trials])
    ]
    every_point_once(tmp_path, grid)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::FutureWarning:ray")
@pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="Ray is not installed: pip install '.[ray]'")
def test_on_ray_a_worker_that_is_killed_loses_nothing(tmp_path, monkeypatch, whole):
    tests = str(Path(grid_errands.__file__).parents[1])
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([tests, *sys.path]))
    monkeypatch.setattr(policy_grid, "_train", grid_errands.train_but_die_once)
    found = searched(tmp_path, ray="local", jobs=2)
    assert (tmp_path / "killed").exists()
    every_point_once(tmp_path)
    assert figures(found) == figures(whole[0])
    with pytest.raises(OutputExists, match="is not empty"):
        searched(tmp_path)
