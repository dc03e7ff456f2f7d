"""`trueup policy`: a small training, its policy judged on two engines and virtual hardware, and bad input in a line."""

import json

import numpy as np
import pytest
import torch
import yaml

from policy.test_randomization import fitted
from trueup.augment.config import CHECKPOINT_NAME
from trueup.cli.main import main
from trueup.core.policy_card import PolicyCard

SMALL = {
    "reach": {"control_hz": 25.0, "episode_s": 0.4},
    "learner": {"starts": 40, "updates": 1, "batch": 16, "layers": [16], "buffer": 2000},
    "arms": 4,
    "steps": 160,
    "rounds": 2,
}


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.yaml").write_text(yaml.safe_dump(SMALL))

    def call(*arguments):
        with pytest.raises(SystemExit) as caught:
            main(["policy", *map(str, arguments)])
        printed = capsys.readouterr()
        return caught.value.code, printed.out, printed.err

    return call


@pytest.mark.long
def test_from_nothing_to_figures(run, tmp_path):
    code, out, _ = run("train", "--out", "reach", "--config", "small.yaml", "--algorithm", "sac", "--jobs", 1)
    assert code == 0
    assert "panda_torque-sac: median distance" in out
    assert "trueup policy eval reach" in out
    assert not (tmp_path / "reach" / CHECKPOINT_NAME).exists()
    card = PolicyCard.load(tmp_path / "reach")
    assert card.provenance["config"]["algorithm"] == "sac"
    assert [item["number"] for item in card.provenance["history"]] == [1, 2]
    again = run("train", "--out", "reach", "--config", "small.yaml", "--algorithm", "sac", "--resume", "--jobs", 1)
    assert again[:2] == (code, out)
    places = ("eval", "reach", "--on", "mujoco,dart,lab", "--unit", 1, "--unit", 3, "--goals", 3)
    code, out, _ = run(*places, "--out", "found", "--jobs", 1)
    assert code == 0
    for label in ("mujoco", "dart", "lab-1", "lab-3"):
        assert label in out
    found = json.loads((tmp_path / "found" / "evaluation.json").read_text())["policies"][0]
    assert set(found["places"]) == {"mujoco", "dart", "lab-1", "lab-3"}
    one, other = (np.array(found["places"][label]["values"]["distance"]) for label in ("mujoco", "dart"))
    np.testing.assert_allclose(one, other, atol=5e-3)
    assert found["places"]["lab-1"]["goals"] == found["places"]["mujoco"]["goals"]


def test_what_is_there_is_not_lost(run, tmp_path):
    assert run("train", "--out", "reach", "--config", "small.yaml", "--jobs", 1)[0] == 0
    card = (tmp_path / "reach" / "policy.json").read_text()
    code, _, err = run("train", "--out", "reach", "--config", "small.yaml")
    assert code == 2
    assert "is not empty" in err
    code, _, err = run("train", "--out", "reach", "--config", "small.yaml", "--seed", 1, "--resume")
    assert code == 2
    assert "another robot, configuration or seed" in err
    assert (tmp_path / "reach" / "policy.json").read_text() == card
    assert run("train", "--out", "reach", "--config", "small.yaml", "--seed", 1, "--overwrite", "--jobs", 1)[0] == 0
    assert (tmp_path / "reach" / "policy.json").read_text() != card


def test_a_training_knows_which_posterior_it_drew_from(run, tmp_path):
    folder = fitted(tmp_path / "fit")
    small = ("train", "--out", "reach", "--config", "small.yaml", "--randomize", "fit", "--jobs", 1)
    assert run(*small)[0] == 0
    assert run(*small, "--resume")[0] == 0
    fitted(folder, samples={"damping[joint1]": np.full(10, 2.0)})
    code, _, err = run(*small, "--resume")
    assert code == 2
    assert "another robot, configuration or seed" in err


@pytest.mark.long
def test_an_old_policy_stays_until_the_new_one_takes_its_place(run, tmp_path, monkeypatch):
    import trueup.policy.export as exporting

    small = ("train", "--out", "reach", "--config", "small.yaml", "--jobs", 1)
    assert run(*small)[0] == 0
    card = (tmp_path / "reach" / "policy.json").read_text()
    whole = exporting.export

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(exporting, "export", interrupted)
    assert run(*small, "--seed", 1, "--overwrite")[0] == 130
    assert (tmp_path / "reach" / "policy.json").read_text() == card
    assert run("eval", "reach", "--goals", 2, "--jobs", 1)[0] == 0
    monkeypatch.setattr(exporting, "export", whole)
    # Resumed, it is the new one that is meant.
    assert run(*small, "--seed", 1, "--resume")[0] == 0
    assert PolicyCard.load(tmp_path / "reach").provenance["seed"] == 1
    names = sorted(file.name for file in (tmp_path / "reach").iterdir())
    assert names == ["learner.safetensors", "policy.json", "policy.onnx"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("train", "--out", "x", "--algorithm", "dqn"), "no such algorithm"),
        (("train", "--out", "x", "--robot", "panda"), "follows them"),
        (("train", "--out", "x", "--randomize", "nowhere"), "nowhere"),
        (("train", "--out", "x", "--config", "odd.yaml"), "learner"),
        (("train", "--out", "x", "--config", "tiny.yaml", "--device", "cuda"), "finds no GPU"),
        (("eval", "nowhere"), "policy.json"),
        (("eval", "x", "--goals", 1), "goals"),
    ],
)
def test_bad_input(run, tmp_path, arguments, said):
    if "cuda" in arguments and torch.cuda.is_available():
        pytest.skip("there is a GPU")
    (tmp_path / "odd.yaml").write_text("learner: {rate: -1.0}\n")
    (tmp_path / "tiny.yaml").write_text(yaml.safe_dump(SMALL))
    code, _, err = run(*arguments)
    assert code == 2
    assert said in err
    assert "Traceback" not in err


def test_an_identification_that_is_not_ok_is_forced_or_refused(run, tmp_path):
    folder = fitted(tmp_path / "fit", status="at-bound")
    small = ("train", "--config", "small.yaml", "--jobs", 1, "--randomize", folder)
    code, _, err = run(*small, "--out", "refused")
    assert code == 2
    assert "the identification is at-bound: Joint 1 never moved" in err
    assert not (tmp_path / "refused" / "policy.json").exists()
    assert run(*small, "--out", "forced", "--force")[0] == 0
    foreign = fitted(tmp_path / "foreign", samples={"damping[elbow]": np.ones(3)})
    code, _, err = run(*small[:-1], foreign, "--out", "new")
    assert code == 2
    assert "another robot" in err
    assert "joint4" in err


def test_a_place_that_is_none_and_a_robot_that_does_not_fit(run):
    assert run("train", "--out", "reach", "--config", "small.yaml", "--jobs", 1)[0] == 0
    code, _, err = run("eval", "reach", "--on", "gazebo")
    assert code == 2
    assert "gazebo" in err
    assert "mujoco" in err
    code, _, err = run("eval", "reach", "--robot", "upper_body")
    assert code == 2
    assert "another robot" in err


def test_configurations_by_name_and_options_over_them(tmp_path):
    from trueup.cli.policy_config import configured
    from trueup.policy.config import LAPTOP, PAPER

    assert configured("laptop", None, None, None) == LAPTOP
    assert configured("laptop", "tqc", None, 5000).algorithm == "tqc"
    assert configured("laptop", None, None, 5000).steps == 5000
    assert configured("paper", None, None, None).learner == PAPER["tqc"]
    assert configured("paper", "ddpg", "thesis", None).learner == PAPER["ddpg"]
    assert configured("paper", "ddpg", "thesis", None).randomization.friction == 0.1
    (tmp_path / "own.yaml").write_text("algorithm: td3\nrandomization: {inertia: 0.2}\n")
    own = configured(str(tmp_path / "own.yaml"), None, None, None)
    assert (own.algorithm, own.randomization.inertia) == ("td3", 0.2)
    over = configured(str(tmp_path / "own.yaml"), "sac", "none", None)
    assert (over.algorithm, over.randomization.inertia) == ("sac", 0.0)


@pytest.mark.parametrize("command", [("policy", "eval"), ("deploy", "run")])
def test_a_folder_without_a_policy_says_what_to_give(command, tmp_path, capsys):
    with pytest.raises(SystemExit) as end:
        main([*command, str(tmp_path)])
    assert end.value.code == 2
    said = capsys.readouterr().err
    assert "holds no policy: got an empty folder; expected policy.json" in " ".join(said.split())
    assert "zoo:panda-reach" in said


def test_curves_of_a_policy_of_the_zoo(tmp_path, capsys):
    with pytest.raises(SystemExit) as end:
        main(["policy", "curves", "zoo:panda-reach", "--out", str(tmp_path / "curves.html")])
    assert end.value.code == 0, capsys.readouterr().err
    assert "panda-reach" in (tmp_path / "curves.html").read_text()
