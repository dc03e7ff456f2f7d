"""`trueup compensate`: from a dataset to a network and a run of it, and bad input in a line or two."""

import pytest

from cli.hidden_packages import without
from compensate.arm_cases import arm_of, recorded
from trueup.cli.main import main
from trueup.dataset import Dataset

ROBOT = """
schema: trueup.robot/1
name: arm
model: arm.xml
joints: [{name: shoulder, position_limits: [-2, 2]}, {name: elbow, position_limits: [-2, 2]}]
controller: {kind: position, kp: 40, kv: 1}
payload: {sites: [payload]}
simulation: {timestep_s: 0.004}
"""
CONFIG = """
network: {kind: operator, hidden: [12], history: 3, features: 4, trunk: [8], sensors: 4, predictor: [8]}
training: {updates: 16, rounds: 2, batch: 24, horizon: 6, rate: 0.01}
"""


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    folder = tmp_path_factory.mktemp("command")
    robot, path = arm_of(folder / "robot", friction=False)
    (folder / "robot" / "arm.yaml").write_text(ROBOT)
    (folder / "small.yaml").write_text(CONFIG)
    recorded(folder / "data", robot, path, offset=lambda _, command, kg: 0 * command - 0.05 - 0.03 * kg)
    return folder


@pytest.fixture
def run(capsys):
    def call(*arguments):
        with pytest.raises(SystemExit) as left:
            main(["compensate", *map(str, arguments)])
        printed = capsys.readouterr()
        return left.value.code, printed.out, printed.err

    return call


@pytest.mark.long
@pytest.mark.parametrize("command", [("train", "--out", "net"), ("replay", "--network", "net")])
def test_without_torch_one_is_told_how_to_get_it(world, tmp_path, command):
    words = ["compensate", command[0], str(world / "data"), "--robot", "demo_arm", *command[1:]]
    code, said = without("torch", words, tmp_path)
    assert code == 2
    assert "needs torch" in said
    assert said.endswith("next: pip install '.[learn]' in the checkout of trueup")
    assert not any(tmp_path.iterdir())


@pytest.mark.long
def test_train_and_replay(world, run):
    robot, data = ("--robot", world / "robot" / "arm.yaml"), world / "data"
    code, out, err = run(
        "train", data, *robot, "--out", world / "net", "--config", world / "small.yaml", "--jobs", 1, "--name", "small"
    )
    assert (code, "error" in err) == (0, False)
    assert "small: positions on val, simulator - robot" in out
    assert "0 kg" in out
    assert "1 kg" in out
    assert "trueup compensate replay" in out
    code, out, _ = run("replay", data, *robot, "--network", world / "net", "--jobs", 1)
    assert code == 0
    assert "8 episodes replayed" in out
    assert "mujoco/stock+small" in Dataset(data).runs
    code, _, err = run("replay", data, *robot, "--network", world / "net", "--jobs", 1)
    assert code == 2
    assert "mujoco/stock+small" in err
    code, out, _ = run(
        "train", data, *robot, "--out", world / "own", "--config", world / "small.yaml", "--jobs", 1,
        "--twin-robot", world / "robot" / "arm.yaml", "--empty-handed",
    )  # fmt: skip
    assert code == 0
    assert "robot's twin - simulator" in out
    code, _, err = run("replay", data, *robot, "--network", world / "own")
    assert code == 2
    assert "corrects commands of the robot" in err


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--method", "gapo"), "there is no such method"),
        (("--empty-handed",), "Give --twin-robot"),
        (("--control-hz", "100"), "another rate"),
        (("--config", "nothing.yaml"), "nothing.yaml"),
    ],
)
def test_bad_input_is_a_line_or_two_and_leaves_no_model(world, run, tmp_path, options, said):
    code, _, err = run(
        "train", world / "data", "--robot", world / "robot" / "arm.yaml", "--out", tmp_path / "net", *options
    )
    assert code == 2
    assert said in err
    lines = [line for line in err.strip().splitlines() if not line.startswith("differentiate")]
    assert len(lines) <= 2, err
    assert not (tmp_path / "net" / "model.json").exists()
