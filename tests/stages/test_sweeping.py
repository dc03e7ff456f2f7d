"""A sweep: each training as alone, wherever it is done; nothing is lost; what is best on val is chosen."""

import dataclasses
import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from augment.augment_cases import RUN, make_dataset
from core.ray_cases import NEEDS_RAY, QUIET, one_worker_killed
from trueup.augment.config import AugmentConfig, DataConfig, NetworkConfig, WindowConfig, preset
from trueup.cli.main import main
from trueup.core.model_card import ModelCard
from trueup.core.sweep_result import SweepError, SweepResult, SweepTraining, ranked, signal_of
from trueup.dataset import Dataset
from trueup.errors import ConfigError, DataError, FormatError, MissingDependency, MissingSignal, OutputExists
from trueup.stages import augment, sweep
from trueup.stages.sweeping import errors_of

pytestmark = QUIET
SMALL = AugmentConfig(
    method="gru",
    network=NetworkConfig(kind="gru", hidden=(6,)),
    data=DataConfig(),
    window=WindowConfig(samples=40),
    batch=4,
    epochs=6,
)
CANDIDATES = {"average": preset("moving-average-rt"), "small": SMALL}
# Takes long enough to be killed in the middle.
LONG = {"long": dataclasses.replace(SMALL, epochs=30, stop_after=0)}
SEEDS = (3, 4)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return make_dataset(tmp_path_factory.mktemp("data") / "arm").path


@pytest.fixture(scope="module")
def done(data, tmp_path_factory):
    out = tmp_path_factory.mktemp("sweep") / "out"
    told = []
    found = sweep([data], out, run=RUN, candidates=CANDIDATES, seeds=SEEDS, jobs=1, on_training=told.append)
    return out, found, told


def numbers(found):
    """All that does not depend on the clock."""
    trainings = [dataclasses.replace(item, seconds=0.0) for item in found.trainings]
    return trainings, [dataclasses.replace(row, seconds=0.0) for row in found.ranking], found.signal, found.chosen


def test_each_training_is_as_alone_and_the_best_on_val_is_chosen(data, done, tmp_path):
    out, found, _ = done
    assert [(item.candidate, item.seed) for item in found.trainings] == [
        (name, seed) for name in CANDIDATES for seed in SEEDS
    ]
    assert {item.state for item in found.trainings} == {"complete"}
    assert (found.signal, found.split) == ("torque", "val")
    alone = augment([Dataset(data)], tmp_path / "m", run=RUN, config=SMALL, name="small-s4", seed=4, jobs=1)
    training = found.trainings[3]
    assert training.folder == "models/small/seed-4"
    weights = (tmp_path / "m" / "weights.safetensors").read_bytes()
    assert (out / training.folder / "weights.safetensors").read_bytes() == weights
    card = alone.augmentation.card
    joints = [card.metrics["val"]["torque"][joint]["corrected"] for joint in card.joints]
    error = training.val["torque"]
    assert error.corrected == pytest.approx(np.sqrt(np.mean(np.square(joints))))
    assert error.unit == "Nm"
    assert training.epochs == 6
    rows = {row.candidate: row for row in found.ranking}
    errors = {name: [t.val["torque"].corrected for t in found.trainings if t.candidate == name] for name in CANDIDATES}
    for name, row in rows.items():
        assert (row.mean, row.low, row.high) == (np.mean(errors[name]), min(errors[name]), max(errors[name]))
        assert (row.complete, row.failed, row.unit) == (2, 0, "Nm")
        assert row.simulated == error.simulated >= row.mean
    assert found.ranking[0].mean == min(row.mean for row in found.ranking)
    chosen = next(item for item in found.trainings if item.folder == found.chosen)
    assert chosen.val["torque"].corrected == found.ranking[0].low
    # Networks of one candidate can be judged side by side, since their names differ.
    assert ModelCard.load(out / found.chosen).name == f"{chosen.candidate}-s{chosen.seed}"


@pytest.mark.long
def test_test_is_not_read(tmp_path, done):
    """Without the motions of test, everything is the same."""
    data = make_dataset(tmp_path / "arm", counts=(8, 4, 0)).path
    found = sweep([data], tmp_path / "out", run=RUN, candidates=CANDIDATES, seeds=SEEDS, jobs=1)
    assert numbers(found) == numbers(done[1])


def test_it_is_written_whenever_a_training_has_ended_and_read_back(done, tmp_path):
    out, found, told = done
    assert SweepResult.load(out / "sweep.json") == found
    assert [sum(item.state == "open" for item in state.trainings) for state in told] == [4, 3, 2, 1, 0]
    assert told[1].chosen == "models/average/seed-3"
    tree = json.loads((out / "sweep.json").read_text())
    assert tree["provenance"]["config"]["candidates"]["small"]["network"]["hidden"] == [6]
    assert tree["provenance"]["data_hash"]
    (tmp_path / "other.json").write_text(json.dumps({**tree, "schema": "trueup.fleet/1"}))
    with pytest.raises(FormatError, match="sweep"):
        SweepResult.load(tmp_path / "other.json")


@pytest.mark.long
def test_in_processes_it_is_the_same(data, done, tmp_path):
    found = sweep([data], tmp_path / "out", run=RUN, candidates=CANDIDATES, seeds=SEEDS, jobs=2)
    assert numbers(found) == numbers(done[1])


@NEEDS_RAY
@pytest.mark.slow
def test_on_ray_a_worker_that_is_killed_loses_nothing(data, tmp_path):
    """It is killed in the middle of a training, which goes on from its checkpoint."""
    here = sweep([data], tmp_path / "here", run=RUN, candidates=LONG, seeds=SEEDS, jobs=1)
    out = tmp_path / "out"
    with one_worker_killed(lambda: any(out.glob("models/*/*/checkpoint.safetensors"))) as killed:
        there = sweep([data], out, run=RUN, candidates=LONG, seeds=SEEDS, jobs=2, ray="local")
    assert killed
    assert numbers(there) == numbers(here)
    for training in here.trainings:
        name = f"{training.folder}/weights.safetensors"
        assert (out / name).read_bytes() == (tmp_path / "here" / name).read_bytes()


@pytest.mark.slow
def test_a_sweep_that_is_killed_goes_on(data, tmp_path):
    """The command is killed in the middle of its second training."""
    small = tmp_path / "long.yaml"
    small.write_text(json.dumps({**tree_of(SMALL), "epochs": 30, "stop_after": 0}))
    words = ["augment", "sweep", data, "--out", tmp_path / "out", "--config", small, "--seeds", 2, "--jobs", 1]
    code = "from trueup.cli.main import main; import sys; main(sys.argv[1:])"
    command = [sys.executable, "-c", code, *map(str, words)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    first, second = (tmp_path / "out" / "models" / "long" / f"seed-{seed}" for seed in (0, 1))
    until = time.monotonic() + 300
    while not (second / "checkpoint.safetensors").exists() and process.poll() is None and time.monotonic() < until:
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert [item.state for item in SweepResult.load(tmp_path / "out" / "sweep.json").trainings] == ["complete", "open"]
    assert not (second / "model.json").exists()
    before = {path: path.stat().st_mtime_ns for path in first.iterdir()}
    epochs = []
    config = AugmentConfig.load(small)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("trueup.stages.sweeping.augment", counting(epochs))
        found = sweep([data], tmp_path / "out", run=RUN, candidates={"long": config}, seeds=(0, 1), jobs=1, resume=True)
    assert {path: path.stat().st_mtime_ns for path in first.iterdir()} == before
    assert 0 < len(epochs) < 30
    whole = augment([Dataset(data)], tmp_path / "m", run=RUN, config=config, name="long-s1", seed=1, jobs=1)
    assert errors_of(whole.augmentation.card) == found.trainings[1].val
    assert (second / "weights.safetensors").read_bytes() == (tmp_path / "m" / "weights.safetensors").read_bytes()


def counting(epochs):
    def counted(*given, **options):
        return augment(*given, **options, on_progress=lambda item: epochs.append(item) if item.epoch else None)

    return counted


def tree_of(config):
    return {
        "method": config.method,
        "network": {"hidden": list(config.network.hidden)},
        "window": {"samples": config.window.samples},
        "batch": config.batch,
    }


def test_one_that_fails_is_noted_and_the_others_go_on(data, tmp_path):
    fast = dataclasses.replace(SMALL, data=DataConfig(rate_hz=500.0))
    candidates = {"fast": fast, "average": CANDIDATES["average"]}
    found = sweep([data], tmp_path / "out", run=RUN, candidates=candidates, seeds=(0,), jobs=1)
    assert [item.state for item in found.trainings] == ["failed", "complete"]
    assert "fewer samples per second than data.rate_hz" in found.trainings[0].reason
    assert [row.candidate for row in found.ranking] == ["average"]
    with pytest.raises(DataError, match=r"no training of the sweep.*rate_hz"):
        sweep([data], tmp_path / "none", run=RUN, candidates={"fast": fast}, seeds=(0,), jobs=1)


def test_seeds_and_networks_may_be_added_but_not_changed(data, done, tmp_path):
    average = {"average": CANDIDATES["average"]}
    out = tmp_path / "out"
    sweep([data], out, run=RUN, candidates=average, seeds=(0,), jobs=1)
    card = out / "models" / "average" / "seed-0" / "model.json"
    before = card.stat().st_mtime_ns
    linear = {"linear": dataclasses.replace(preset("linear"), epochs=1)}
    found = sweep([data], out, run=RUN, candidates=average | linear, seeds=(0, 1), jobs=1, resume=True)
    assert len(found.trainings) == 4
    assert card.stat().st_mtime_ns == before
    other = {"linear": dataclasses.replace(preset("linear"), epochs=2)}
    for candidates, seeds in ((average, (0, 1)), (average | linear, (0,)), (average | other, (0, 1))):
        with pytest.raises(OutputExists, match="a sweep of other data, or with"):
            sweep([data], out, run=RUN, candidates=candidates, seeds=seeds, jobs=1, resume=True)
    with pytest.raises(OutputExists, match="not empty"):
        sweep([data], out, run=RUN, candidates=average, seeds=(0,), jobs=1)
    tree = json.loads((out / "sweep.json").read_text())
    (out / "sweep.json").write_text(json.dumps({**tree, "provenance": {"config": []}}))
    with pytest.raises(DataError, match=r"sweep.json is broken"):
        sweep([data], out, run=RUN, candidates=average, seeds=(0,), jobs=1, resume=True)
    (out / "models" / "average" / "notes.txt").write_text("years of work")
    again = sweep([data], out, run=RUN, candidates=average, seeds=(0,), jobs=1, overwrite=True)
    assert len(again.trainings) == 1
    assert sorted(path.name for path in (out / "models").rglob("*") if path.name[:4] in ("seed", "note")) == [
        "notes.txt",
        "seed-0",
    ]


@pytest.mark.parametrize(
    ("changes", "kind", "told"),
    [
        ({"candidates": {}}, ConfigError, "needs networks to train"),
        ({"candidates": {"a/b": SMALL}}, ConfigError, "this is no name"),
        ({"seeds": ()}, ConfigError, "seeds of a sweep: got none; expected at least one"),
        ({"seeds": (1, 1)}, ConfigError, "each once"),
        ({"run": "dart/stock"}, MissingSignal, "no run 'dart/stock'"),
        ({"by": "current"}, MissingSignal, "--by current is not both simulated and measured: available: position"),
        (
            {"candidates": {"small": SMALL, "bodies": preset("sat-bodies")}},
            ConfigError,
            r"a signal that all of them correct.*bodies: body.position",
        ),
        ({"ray": "127.0.0.1:1"}, ConfigError, "no Ray cluster answers"),
        ({"device": "tpu"}, ConfigError, "--device"),
    ],
)
def test_what_cannot_be(data, tmp_path, changes, kind, told):
    arguments = {"run": RUN, "candidates": CANDIDATES, "seeds": SEEDS, **changes}
    with pytest.raises(kind, match=told):
        sweep([data], tmp_path / "out", jobs=1, **arguments)
    assert not (tmp_path / "out").exists()


def test_nothing_to_choose_by_is_said_before_anything_is_trained(tmp_path):
    data = make_dataset(tmp_path / "arm", counts=(4, 0, 2)).path
    with pytest.raises(MissingSignal, match=r"no motion of the run 'mujoco/stock' is in the split 'val'"):
        sweep([data], tmp_path / "out", run=RUN, candidates=CANDIDATES, seeds=SEEDS, jobs=1)
    assert not (tmp_path / "out").exists()


def test_ray_that_is_missing_is_said(data, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingDependency, match="Ray cluster needs ray") as caught:
        sweep([data], tmp_path / "out", run=RUN, candidates=CANDIDATES, seeds=SEEDS, ray="local")
    assert "'.[ray]'" in caught.value.hint
    assert not (tmp_path / "out").exists()


def test_nothing_of_others_is_deleted(data, tmp_path):
    (tmp_path / "out" / "models" / "x" / "seed-0").mkdir(parents=True)
    for options in ({"overwrite": True}, {"resume": True}):
        with pytest.raises(OutputExists, match="something else than a sweep"):
            sweep([data], tmp_path / "out", run=RUN, candidates=CANDIDATES, seeds=SEEDS, jobs=1, **options)
    assert (tmp_path / "out" / "models" / "x" / "seed-0").is_dir()


def test_a_network_of_which_a_training_failed_comes_last():
    def one(candidate, seed, error, state="complete"):
        val = {"position": SweepError(error, 1.0, "rad")} if state == "complete" else {}
        return SweepTraining(candidate, "gru", seed, f"{candidate}/{seed}", state, val=val)

    trainings = (
        *(one("frail", 0, 0.1), one("frail", 1, 0.0, "failed")),
        *(one("good", 0, 0.2), one("good", 1, 0.4)),
        *(one("bad", 0, 0.5), one("bad", 1, 0.6)),
        one("never", 0, 0.0, "failed"),
    )
    assert signal_of(trainings) == "position"
    assert signal_of(trainings, "torque") == ""
    rows = ranked(trainings, "position")
    assert [row.candidate for row in rows] == ["good", "bad", "frail"]
    assert (rows[0].mean, rows[0].best) == (pytest.approx(0.3), "good/0")


@pytest.fixture
def run(capsys):
    def call(*arguments):
        with pytest.raises(SystemExit) as end:
            main([str(argument) for argument in arguments])
        printed = capsys.readouterr()
        return end.value.code, printed.out, printed.err

    return call


def test_the_command(run, data, tmp_path):
    (tmp_path / "tiny.yaml").write_text(json.dumps({**tree_of(SMALL), "epochs": 2}))
    options = ("--method", "moving-average-rt", "--config", tmp_path / "tiny.yaml", "--seeds", 2, "--jobs", 1)
    code, out, err = run("augment", "sweep", data, "--out", tmp_path / "out", *options, "--by", "torque")
    assert code == 0, err
    for word in ("torque on val over seeds", "moving-average-rt", "tiny", "2/2", "Nm", "lowest", " *"):
        assert word in out
    found = SweepResult.load(tmp_path / "out" / "sweep.json")
    assert f"trueup augment eval {data} --model {tmp_path / 'out' / found.chosen}" in out
    code, _, err = run("augment", "sweep", data, "--out", tmp_path / "out", *options)
    assert code == 2
    assert "--resume" in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "a sweep needs networks to train: expected --method or --config"),
        (("--method", "lstm"), "there is no such method: got lstm; available: realeasy"),
        (("--method", "gru", "--method", "gru"), "two networks of the sweep are called 'gru'"),
        (("--method", "gru", "--seeds", "0"), "'--seeds'"),
        (("--config", "nowhere.yaml"), "nowhere.yaml"),
    ],
)
def test_what_cannot_be_is_said_in_one_line(run, data, tmp_path, arguments, message):
    code, _, err = run("augment", "sweep", data, "--out", tmp_path / "out", *arguments)
    assert code == 2
    assert message in err
    assert "Traceback" not in err
    assert not (tmp_path / "out").exists()
