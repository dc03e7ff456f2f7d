"""`trueup augment train` as its user sees it."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest

from augment.augment_cases import make_dataset
from trueup.cli.augment_config import configured
from trueup.cli.main import main


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return make_dataset(tmp_path_factory.mktemp("data") / "arm", perfect=("velocity",)).path


@pytest.fixture
def run(capsys):
    def call(*arguments):
        with pytest.raises(SystemExit) as end:
            main([str(argument) for argument in arguments])
        printed = capsys.readouterr()
        return end.value.code, printed.out, printed.err

    return call


def small(folder, **over):
    text = {
        "method": "realeasy-rt",
        "network": {"hidden": [6]},
        "window": {"samples": 40},
        "batch": 4,
        "epochs": 2,
        **over,
    }
    path = folder / "small.yaml"
    path.write_text(json.dumps(text))  # JSON is YAML
    return path


@pytest.mark.long
def test_it_says_how_good_it_is_on_val_and_what_to_do_next(run, data, tmp_path):
    code, out, err = run(
        *("augment", "train", data, "--out", tmp_path / "m", "--config", small(tmp_path), "--name", "arm-rt"),
        *("--jobs", 1, "--tensorboard", tmp_path / "curves"),
    )
    assert code == 0
    assert "arm-rt: RMSE on val, simulator -> corrected" in out
    assert "torque [Nm]" in out
    assert "finished after 2 epochs" in out
    assert f"trueup augment eval {data} --model {tmp_path / 'm'}" in out
    assert "switched off" in err
    assert "velocity of pan" in err
    assert "did not measure" not in err
    assert {path.name for path in (tmp_path / "m").iterdir()} == {"model.json", "model.onnx", "weights.safetensors"}
    assert list((tmp_path / "curves").glob("events.out.tfevents*"))


def test_a_moving_average_needs_no_training(run, data, tmp_path):
    code, out, _ = run("augment", "train", data, "--out", tmp_path / "m", "--method", "moving-average-rt")
    assert code == 0
    assert "epochs" not in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--method", "lstm"], "there is no such method: got lstm; available: realeasy, realeasy-rt"),
        (["--method", "gru", "--config", "paper"], "no paper has a configuration of this method"),
        (["--run", "dart/stock"], "has no run 'dart/stock': available: mujoco/stock"),
        (
            ["--signal", "temperature"],
            "data: signals: got temperature; available: position, velocity, torque, current, voltage",
        ),
        (["--command", "velocity"], "there is no commanded velocity: available: position"),
        (["--device", "cuda"], "torch finds no GPU"),
        (["--epochs", "0"], "epochs: 0 leaves the network untrained"),
    ],
)
def test_what_cannot_be_is_said_in_one_line(run, data, tmp_path, arguments, message):
    code, _, err = run("augment", "train", data, "--out", tmp_path / "m", *arguments)
    assert code == 2
    assert message in err
    assert len([line for line in err.splitlines() if line.startswith("error:")]) == 1
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("over", "message"),
    [
        ({"netwrok": {}}, "has unknown keys ['netwrok']"),
        ({"network": {"hidden": [0]}}, "network: hidden"),
        ({"base": "thesis"}, "base: got thesis; available: default, paper"),
        ({"optimizer": {"rate": -1.0}}, "optimizer: rate: got -1.0; expected above 0"),
        ({"optimizer": {"patience": 0}}, "optimizer: patience"),
        ({"loss": {"weights": {"torque": -1}}}, "loss: weight of torque"),
        ({"network": {"kind": "mlp", "bidirectional": True}}, "mlp has one direction only"),
        ({"batch": 0}, "got (0, 2, 15); expected batch >= 1"),
        (
            {"network": {"kind": "sat", "hidden": [16], "heads": 0}},
            "network: heads of a sat: got 0; expected at least 1",
        ),
        ({"network": {"kind": "sat", "hidden": [30]}}, "got (30,); expected one width, a multiple of 4 heads"),
        ({"method": "sat", "network": {"hidden": [16]}, "data": {"signals": ["torque"]}}, "`blind: []` for none"),
    ],
)
def test_a_wrong_file_is_said_with_the_place(run, data, tmp_path, over, message):
    code, _, err = run("augment", "train", data, "--out", tmp_path / "m", "--config", small(tmp_path, **over))
    assert code == 2
    assert message in err


def test_a_signal_that_is_chosen_need_not_be_the_one_that_its_method_is_blind_to():
    """The SAT does not read the position that it corrects; where it corrects the torque alone, that says nothing."""
    assert configured("sat", None, ["torque"], None, None).data.blind == ()
    assert configured("sat", None, ["torque", "position"], None, None).data.blind == ("position",)
    assert configured("sat", None, None, None, None).data.blind == ("position",)


@pytest.mark.long
def test_what_no_sensor_measured_is_said(run, tmp_path):
    """A servo without a current sensor: its current stays as simulated, and nobody need guess so."""
    path = make_dataset(tmp_path / "arm", unmeasured=("torque",)).path
    code, out, err = run(
        *("augment", "train", path, "--out", tmp_path / "m", "--config", small(tmp_path), "--jobs", 1),
    )
    assert code == 0
    assert "torque" not in out
    assert "note: the robot did not measure torque, which stays as simulated" in err
    code, _, err = run(*("augment", "train", path, "--out", tmp_path / "n", "--method", "sat", "--signal", "torque"))
    assert code == 2
    assert "the measurement of episode 'train0' has no torque: available: position, velocity" in err


@pytest.mark.long
@pytest.mark.parametrize(
    ("method", "history", "said"),
    [("sat", 300, True), ("sat", 20, False), ("mlp", 300, True), ("mlp", 20, False), ("gru", 300, False)],
)
def test_a_history_that_no_motion_has_is_said(run, data, tmp_path, method, history, said):
    """Motions have 60 to 119 samples. A network with a state has no history, whatever stands there."""
    network = {"hidden": [4], "history": history}
    network |= {"heads": 2, "feedback": "zero"} if method == "sat" else {}
    config = small(tmp_path, method=method, network=network, epochs=1)
    code, _, err = run("augment", "train", data, "--out", tmp_path / "m", "--config", config, "--jobs", 1)
    assert code == 0
    assert ("longer than every motion of train" in err) == said


def test_method_and_file_exclude_one_another(run, data, tmp_path):
    code, _, err = run(
        "augment", "train", data, "--out", tmp_path / "m", "--method", "gru", "--config", small(tmp_path)
    )
    assert code == 2
    assert "Write method: into the file." in err


@pytest.mark.long
def test_papers_numbers_come_with_the_word_paper(run, data, tmp_path):
    code, _, _ = run(
        *("augment", "train", data, "--out", tmp_path / "m", "--method", "realeasy", "--config", "paper"),
        *("--epochs", 1, "--jobs", 1),
    )
    assert code == 0
    config = json.loads((tmp_path / "m" / "model.json").read_text())["provenance"]["config"]
    assert config["network"]["hidden"] == [100, 21]
    assert config["network"]["bidirectional"]
    assert (config["batch"], config["window"]["rule"], config["window"]["draws"]) == (16, "half-shortest", 16)
    assert (config["optimizer"]["name"], config["optimizer"]["rate"]) == ("rmsprop", 1e-4)
    assert (config["data"]["normalization"], config["loss"]["scale"]) == ("limits", "normalized")


@pytest.mark.long
def test_killed_and_resumed_from_the_command_line(data, tmp_path):
    config, out = small(tmp_path, epochs=400, window={"samples": 40, "draws": 8}), tmp_path / "m"
    command = [sys.executable, "-m", "trueup.cli.main", "augment", "train", data, "--out", out, "--config", config]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    process = subprocess.Popen([*map(str, command), "--jobs", "1"], env=environment, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 120
    while not (out / "checkpoint.safetensors").is_file():
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not (out / "model.json").exists()
    done = subprocess.run([*map(str, command)], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "Give --overwrite or --resume" in done.stderr
    other = small(tmp_path, epochs=3, window={"samples": 40, "draws": 8})
    resume = [*map(str, command), "--resume", "--jobs", "1"]
    done = subprocess.run(resume, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 2  # the file has changed meanwhile
    assert "another configuration, seed or data" in done.stderr
    assert other == config
