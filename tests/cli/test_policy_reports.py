"""`trueup policy eval` of several policies and `trueup policy curves`, on policies that are trained in seconds."""

import re
import shutil

import numpy as np
import pytest
import yaml

from cli.test_policy_command import SMALL
from report.packed import read_json
from trueup.cli.main import main
from trueup.core.policy_card import POLICY_CARD, PolicyCard
from trueup.core.policy_evaluation import EPISODES_NAME, EVALUATION_NAME, PolicyEvaluation
from trueup.measure import paired_difference
from trueup.measure.seeds import seeds_interval
from trueup.report import build_report
from trueup.robots import load_robot
from trueup.stages.policy_judging import judge_policies

GAMMA = {**SMALL, "learner": {**SMALL["learner"], "gamma": 0.5}}


def trained(*arguments):
    with pytest.raises(SystemExit) as caught:
        main(["policy", "train", "--jobs", "1", *map(str, arguments)])
    assert caught.value.code == 0


@pytest.fixture(scope="module")
def policies(tmp_path_factory):
    """Three seeds of one configuration, one of another, and one at another rate."""
    folder = tmp_path_factory.mktemp("policies")
    for name, config in (("small", SMALL), ("gamma", GAMMA)):
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(config))
    for seed in (0, 1, 2):
        trained("--out", folder / "grid" / f"small-{seed}", "--config", folder / "small.yaml", "--seed", seed)
    trained("--out", folder / "grid" / "gamma-0", "--config", folder / "gamma.yaml")
    slow = {**SMALL, "reach": {"control_hz": 12.5, "episode_s": 0.4}}
    (folder / "slow.yaml").write_text(yaml.safe_dump(slow))
    trained("--out", folder / "slow", "--config", folder / "slow.yaml")
    return folder


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        with pytest.raises(SystemExit) as caught:
            main(["policy", *map(str, arguments)])
        printed = capsys.readouterr()
        return caught.value.code, printed.out, printed.err

    return call


@pytest.mark.long
def test_seeds_of_one_configuration_are_judged_together(run, policies, tmp_path):
    grid = policies / "grid"
    given = [grid / name for name in ("small-0", "small-1", "gamma-0", "small-2")]
    code, out, _ = run("eval", *given, "--on", "mujoco,lab", "--goals", 4, "--jobs", 1, "--out", "found")
    assert code == 0
    assert "mean over goals and seeds" in out
    assert "minus small, on the same goals" in out
    assert sorted(file.name for file in (tmp_path / "found").iterdir()) == [
        EPISODES_NAME,
        EVALUATION_NAME,
        "report.html",
    ]
    found = PolicyEvaluation.load(tmp_path / "found" / EVALUATION_NAME)
    assert [item.label for item in found.policies] == ["small-0", "small-1", "gamma-0", "small-2"]
    assert [item.seed for item in found.policies] == [0, 1, 0, 2]
    assert {group.label: group.policies for group in found.groups} == {
        "small": ("small-0", "small-1", "small-2"),
        "gamma-0": ("gamma-0",),
    }
    for place in ("mujoco", "lab-1"):
        values = {item.label: np.array(item.places[place].values["distance"]) for item in found.policies}
        small = np.stack([values[f"small-{seed}"] for seed in (0, 1, 2)])
        own = found.groups[0].places[place]["distance"]
        np.testing.assert_allclose((own.value, own.low, own.high), seeds_interval(small))
        median = found.groups[0].places[place]["distance_median"]
        assert median.value == pytest.approx(np.median(small, axis=1).mean())
        (difference,) = (item for item in found.differences if (item.split, item.metric) == (place, "distance"))
        assert (difference.run, difference.baseline) == ("gamma-0", "small")
        ends = (difference.difference.value, difference.difference.low, difference.difference.high)
        np.testing.assert_allclose(ends, seeds_interval(values["gamma-0"][None], small))
        # Each by itself does what it does among others.
        name = place.partition("-")[0]
        alone = judge_policies([given[3]], load_robot("panda_torque"), places=[name], goals=4, jobs=1)
        np.testing.assert_array_equal(alone.episodes["small-2"][place].values["distance"], values["small-2"])


def test_the_control_steps_are_kept_and_shown(run, policies, tmp_path):
    places = ("--on", "mujoco,dart", "--goals", 3, "--jobs", 1)
    assert run("eval", policies / "grid" / "gamma-0", *places, "--out", "found")[0] == 0
    found = PolicyEvaluation.load(tmp_path / "found" / EVALUATION_NAME)
    with np.load(tmp_path / "found" / EPISODES_NAME) as stored:
        assert set(stored) == {f"0.{place}.{name}" for place in ("mujoco", "dart") for name in ("distance_m", "reward")}
        for place in ("mujoco", "dart"):
            own = found.policies[0].places[place]
            assert stored[f"0.{place}.reward"].shape == (3, 10)
            np.testing.assert_allclose(stored[f"0.{place}.reward"].mean(axis=1), own.values["reward"], rtol=1e-5)
            np.testing.assert_allclose(stored[f"0.{place}.distance_m"][:, -1], own.values["distance"], rtol=1e-5)
    page = (tmp_path / "found" / "report.html").read_text()
    assert page == build_report(tmp_path / "found")
    for place in ("mujoco", "dart"):
        assert f'<section id="place-{place}"' in page
    own_words = page.split("<main>")[1].split("</main>")[0]
    assert "http" not in own_words
    assert '<link rel="stylesheet"' not in page
    assert "<script src" not in page
    reward = found.policies[0].places["mujoco"].estimates["reward"].value
    assert f"{abs(reward):.3g}" in own_words


def test_one_policy_against_another_goal_by_goal(policies):
    pair = [policies / "grid" / name for name in ("gamma-0", "small-0")]
    found = judge_policies(pair, load_robot("panda_torque"), goals=5, jobs=1)
    gamma, small = (found.episodes[label]["mujoco"].values for label in ("gamma-0", "small-0"))
    for item in found.evaluation.differences:
        plain = paired_difference(
            small[item.metric],
            gamma[item.metric],
            run="",
            baseline="",
            split="",
            signal="",
            metric=item.metric,
            unit=item.difference.unit,
        )
        assert item.difference == plain.difference
        up = {"better": "worse", "worse": "better"} if item.metric in ("success", "reward") else {}
        assert item.verdict == up.get(plain.verdict, plain.verdict)
    names = {item.metric for item in found.evaluation.differences}
    assert names == set(gamma)


@pytest.mark.long
def test_cards_say_which_trainings_are_alike(policies):
    said = {path.parent.name: PolicyCard.load(path.parent).provenance["alike"] for path in policies.rglob(POLICY_CARD)}
    assert said["small-0"] == said["small-1"] == said["small-2"]
    assert len(set(said.values())) == 3


@pytest.mark.long
def test_what_is_there_is_not_lost(run, policies, tmp_path):
    policy, places = policies / "grid" / "gamma-0", ("--goals", 2, "--jobs", 1)
    assert run("eval", policy, *places, "--out", "found")[0] == 0
    before = (tmp_path / "found" / EVALUATION_NAME).read_text()
    code, _, err = run("eval", policy, *places, "--out", "found")
    assert code == 2
    assert "not empty" in err
    assert (tmp_path / "found" / EVALUATION_NAME).read_text() == before
    assert run("eval", policy, *places, "--out", "found", "--overwrite", "--seed", 1)[0] == 0
    assert (tmp_path / "found" / EVALUATION_NAME).read_text() != before
    code, _, err = run("eval", policy, *places, "--out", "found/report.html", "--overwrite")
    assert code == 2
    assert "is a file" in err


def test_policies_that_cannot_be_compared(run, policies):
    grid = policies / "grid"
    code, _, err = run("eval", grid / "small-0", policies / "slow", "--goals", 2)
    assert code == 2
    assert "not of one task" in err
    assert "control_hz 12.5" in err
    code, _, err = run("eval", grid / "small-0", grid / "small-0", "--goals", 2)
    assert code == 2
    assert "each once" in err
    code, _, err = run("curves", policies, "--out", "all.html")
    assert code == 2
    assert "different robots or rates" in err


@pytest.mark.long
def test_a_policy_meets_friction_as_it_was_trained_with_it(policies, tmp_path, monkeypatch):
    """Friction of actions in simulators, also in DART; on hardware what its gravity lacks (ES thesis, 2.4.2, 3.1)."""
    pytest.importorskip("dartpy")
    from trueup.policy import reaching

    (tmp_path / "thesis.yaml").write_text(yaml.safe_dump({**SMALL, "friction": "thesis"}))
    trained("--out", tmp_path / "thesis", "--config", tmp_path / "thesis.yaml")
    made = []

    class Noted(reaching.Reaching):
        def __init__(self, arms, model, config, **options):
            super().__init__(arms, model, config, **options)
            made.append((type(arms).__name__, options.get("friction"), options.get("offset_nm"), arms))

    for module in ("reaching", "simulated"):
        monkeypatch.setattr(f"trueup.policy.{module}.Reaching", Noted)
    both = [tmp_path / "thesis", policies / "grid" / "small-0"]
    judged = judge_policies(both, load_robot("panda_torque"), places=("mujoco", "dart", "lab"), goals=2, jobs=1)
    assert judged.evaluation.settings["friction"] == {"thesis": "thesis", "small-0": "simulator"}
    names = [kind for kind, *_ in made]
    assert names == 2 * ["MujocoArms", "EngineArm", "HardwareArm"]
    assert [friction is not None for _, friction, *_ in made] == [True, True, False, False, False, False]
    assert [offset is not None for *_, offset, _ in made] == [False, False, True, False, False, False]
    damping = [max(arms._simulator.model.dof_damping) for *_, arms in (made[1], made[4])]
    assert damping[0] == 0 < damping[1]
    assert not made[0][3]._models[0].dof_damping.any()


@pytest.mark.long
def test_tasks_that_differ_in_their_reward_or_goals_are_not_compared(run, policies, tmp_path):
    for name, reach in (("reward", {"reward": {"speed": 0.3}}), ("goals", {"lowest_m": 0.3})):
        other = {**SMALL, "reach": {**SMALL["reach"], **reach}}
        (tmp_path / f"{name}.yaml").write_text(yaml.safe_dump(other))
        trained("--out", tmp_path / name, "--config", tmp_path / f"{name}.yaml")
        code, _, err = run("eval", policies / "grid" / "small-0", tmp_path / name, "--goals", 2)
        assert code == 2
        assert next(iter(reach)) in err


def test_curves_of_a_folder_with_policies_below_it(run, policies, tmp_path):
    code, out, _ = run("curves", policies / "grid", "--out", "curves.html")
    assert code == 0
    page = (tmp_path / "curves.html").read_text()
    for text in (out, page):
        assert "gamma 0.5" in text
        assert "gamma 0.97" in text
    assert "http" not in page.split("<main>")[1].split("</main>")[0]
    history = [PolicyCard.load(policies / "grid" / f"small-{seed}").provenance["history"] for seed in (0, 1, 2)]
    best = np.mean([min(item["distance_m"] for item in own) for own in history])
    (line,) = (line for line in out.splitlines() if "gamma 0.97" in line)
    assert f"{100 * best:.1f} cm" in line
    (data,) = (
        own
        for own in map(read_json, re.findall(r'class="chooser-data">(.*?)</script>', page))
        if "gamma 0.97" in str(own) and "'Over'" in str(own)
    )
    curves = {item["name"]: item for item in data["variants"]["steps"]["figures"]["reward"]["data"] if "name" in item}
    expected = np.mean([[item["reward"] for item in own] for own in history], axis=0)
    np.testing.assert_allclose(curves["gamma 0.97"]["y"], expected, rtol=1e-5)


@pytest.mark.long
def test_curves_by_a_key_and_of_one_policy(run, policies):
    code, out, _ = run("curves", policies / "grid", "--out", "by.html", "--by", "algorithm")
    assert code == 0
    assert "trainings" in out
    code, out, _ = run("curves", policies / "grid" / "small-1", "--out", "one.html")
    assert code == 0
    assert "small" in out
    code, _, err = run("curves", policies / "grid", "--out", "odd.html", "--by", "learner.gama")
    assert code == 2
    assert "learner.gama" in err
    assert "learner.gamma" in err


def test_curves_of_what_is_none(run, policies, tmp_path):
    (tmp_path / "empty").mkdir()
    for folder in ("empty", "nowhere"):
        code, _, err = run("curves", folder, "--out", "x.html")
        assert code == 2
        assert "holds no policy" in err
    (tmp_path / "x.html").write_text("mine")
    code, _, err = run("curves", policies / "grid", "--out", "x.html")
    assert code == 2
    assert "exists" in err
    assert (tmp_path / "x.html").read_text() == "mine"
    assert run("curves", policies / "grid", "--out", "x.html", "--overwrite")[0] == 0
    assert run("curves", policies / "grid", "--out", "empty", "--overwrite")[0] == 2
    silent = shutil.copytree(policies / "grid" / "small-0", tmp_path / "silent")
    card = PolicyCard.load(silent)
    kept = {key: value for key, value in card.provenance.items() if key != "history"}
    type(card)(**{**vars(card), "provenance": kept}).save(silent)
    code, _, err = run("curves", "silent", "--out", "y.html")
    assert code == 2
    assert "history" in err
