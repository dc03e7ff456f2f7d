"""A training that begins with what another one has learned: its networks, its seeds, and what cannot be begun with."""

from dataclasses import replace

import pytest
import torch

import trueup.zoo
from policy.test_training import AHEAD, PANDA, SMALL, weights
from trueup.core.policy_card import POLICY_LEARNER, PolicyCard
from trueup.core.trials import Trial, alike, grouped
from trueup.errors import ConfigError, DataError, NameMismatch, OutputExists
from trueup.policy import training
from trueup.policy.config import ALGORITHMS
from trueup.policy.grid import read_grid
from trueup.policy.learned import read_learned
from trueup.robots import load_robot
from trueup.stages.policy_grid import search_grid
from trueup.stages.policy_training import train_policy

SAC = replace(AHEAD, algorithm="sac", steps=160, rounds=1)


def made(folder, config=SAC, seed=0, **options):
    return train_policy(PANDA, folder, config=config, seed=seed, jobs=1, **options)


@pytest.fixture(scope="module")
def start(tmp_path_factory):
    return made(tmp_path_factory.mktemp("start") / "stock-0").folder


def networks(folder, config=SAC):
    return read_learned(replace(config, start=str(folder)), PANDA.joint_names)


@pytest.mark.long
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_all_that_was_learned_is_begun_with(algorithm, tmp_path, monkeypatch):
    """As it is: the learner that comes out of `begin_with` has the networks of the best round, critics included."""
    config = replace(SAC, algorithm=algorithm)
    first = made(tmp_path / "first", config).folder
    begun = []
    whole = training.begin_with

    def noted(learner, learned):
        fresh = weights(learner)
        whole(learner, learned)
        entropy = getattr(learner, "log_ent_coef", None)
        begun.append((fresh, weights(learner), None if entropy is None else entropy.detach().clone()))

    monkeypatch.setattr(training, "begin_with", noted)
    made(tmp_path / "second", replace(config, start=str(first)), seed=1)
    learned = networks(first, config)
    (fresh, own, entropy), _ = begun  # at the end its own best round
    assert {f"policy.{name}" for name in own} == {name for name in learned if name != "log_ent_coef"}
    for name, value in own.items():
        assert torch.equal(value, learned[f"policy.{name}"]), name
    assert any(not torch.equal(fresh[name], value) for name, value in own.items())
    assert ("log_ent_coef" in learned) == (algorithm in ("sac", "tqc")) == (entropy is not None)
    if entropy is not None:
        assert torch.equal(learned["log_ent_coef"], entropy)
        assert entropy != 0


@pytest.mark.long
def test_it_acts_before_it_learns(start, tmp_path):
    """Of 160 control steps of four arms, 64 are not learned from: two updates after each of the 24 others."""
    whole = made(tmp_path / "a", replace(SAC, start=str(start)))
    assert whole.history[-1].updates == 2 * (160 - 64) // 4
    still = made(tmp_path / "b", replace(SAC, start=str(start), learner=replace(SAC.learner, starts=10_000)))
    assert still.history[-1].updates == 0
    assert still.history[-1].steps == 160
    for name, value in networks(still.folder).items():
        assert torch.equal(value, networks(start)[name]), name


@pytest.mark.long
def test_it_acts_as_long_whatever_the_rounds(start, tmp_path):
    learner = replace(SAC.learner, starts=200)
    found = made(tmp_path / "a", replace(SAC, start=str(start), learner=learner, steps=480, rounds=3))
    assert [item.updates for item in found.history] == [0, 2 * (320 - 200) // 4, 2 * (480 - 200) // 4]
    assert [item.steps for item in found.history] == [160, 320, 480]


@pytest.mark.long
@pytest.mark.parametrize("starts", [64, 200])
def test_one_that_is_interrupted_goes_on_to_the_same_weights(start, tmp_path, starts):
    learner = replace(SAC.learner, starts=starts)
    config = replace(SAC, start=str(start), steps=480, rounds=3, learner=learner)

    def stop(done, _):
        if done.number == 1:
            raise KeyboardInterrupt

    whole = made(tmp_path / "whole", config)
    with pytest.raises(KeyboardInterrupt):
        made(tmp_path / "parts", config, on_round=stop)
    made(tmp_path / "parts", config, resume=True)
    for name, value in networks(whole.folder).items():
        assert torch.equal(value, networks(tmp_path / "parts")[name]), name
    with pytest.raises(OutputExists):
        made(tmp_path / "whole", replace(config, start=""), resume=True)


@pytest.mark.long
def test_seeds_that_begin_with_seeds_are_one_group(start, tmp_path):
    other = made(tmp_path / "stock-1", seed=1).folder
    cards = {}
    for seed, begun in ((0, start), (1, other)):
        folder = made(tmp_path / f"fine-{seed}", replace(SAC, start=str(begun)), seed=seed).folder
        cards[folder] = PolicyCard.load(folder)
    fresh = Trial.of(PolicyCard.load(start), start)
    trials = [fresh, *(Trial.of(card, folder) for folder, card in cards.items())]
    assert [group.members for group in alike(trials)] == [(0,), (1, 2)]
    assert [group.title for group in grouped(trials)] == ["start none", "start stock"]


@pytest.mark.parametrize(
    ("config", "said"),
    [
        (replace(SAC, algorithm="tqc"), "got algorithm sac; expected algorithm tqc"),
        (replace(SAC, learner=replace(SAC.learner, layers=(8, 8))), r"got layers \[16\]; expected layers \[8, 8\]"),
        (replace(SAC, learner=replace(SAC.learner, goal_scale=1.0)), "got goal_scale 20.0; expected goal_scale 1.0"),
        (replace(SAC, reach=replace(SAC.reach, control_hz=50.0)), "got rate_hz 25.0; expected rate_hz 50.0"),
        (replace(SAC, reach=replace(SAC.reach, torque_nm=(1.0,) * 7)), "got torque_nm"),
    ],
)
def test_what_does_not_fit_is_refused_before_anything_is_lost(config, said, start, tmp_path):
    there = made(tmp_path / "there").folder
    before = (there / "policy.json").read_bytes()
    with pytest.raises(ConfigError, match=said):
        made(there, replace(config, start=str(start)), overwrite=True)
    assert (there / "policy.json").read_bytes() == before


def test_a_grid_is_refused_as_a_whole(start, tmp_path):
    grid = read_grid({"layers": [[16], [8, 8]]}, "grid")
    with pytest.raises(ConfigError, match=r"expected layers \[8, 8\]"):
        search_grid(PANDA, tmp_path / "grid", config=replace(SAC, start=str(start)), grid=grid, jobs=1)
    assert not (tmp_path / "grid").exists()


def test_a_policy_that_does_not_say_what_was_learned(start, tmp_path):
    with pytest.raises(DataError, match=r"does not say what was learned: expected learner\.safetensors"):
        networks(trueup.zoo.folder("panda-reach"))
    with pytest.raises(DataError, match="holds no policy"):
        networks(tmp_path)
    with pytest.raises(NameMismatch, match="another robot"):
        read_learned(replace(SAC, start=str(start)), load_robot("so101").joint_names)
    mixed = made(tmp_path / "mixed", seed=5).folder
    whole = (start / POLICY_LEARNER).read_bytes()
    (mixed / POLICY_LEARNER).write_bytes(whole)
    with pytest.raises(DataError, match="of another policy than the card"):
        networks(mixed)
    (mixed / POLICY_LEARNER).write_bytes(whole[:-7])
    with pytest.raises(DataError, match="is no checkpoint"):
        networks(mixed)


def test_fresh_networks_need_no_folder():
    assert read_learned(SMALL, PANDA.joint_names) is None
