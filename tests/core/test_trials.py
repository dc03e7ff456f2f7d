"""Trainings side by side: what differs between them, and which differ in their seed alone."""

import pytest

from trueup.core.trials import Trial, alike, differing_keys, flattened, grouped, short_names, unlike, without_seed
from trueup.errors import ConfigError

BASE = {
    "algorithm": "sac",
    "learner.gamma": 0.95,
    "friction": "simulator",
    "randomization.friction": 0.0,
    "network": "",
    "delay_s": [0.0, 0.004],
}


def trial(label, seed=0, kind="", **changes):
    config = {"folder": without_seed(label, seed), **BASE, **changes}
    return Trial(label, seed, kind or str(sorted(map(str, changes.items()))), config)


def titles(trials, by=()):
    return {group.title: group.members for group in grouped(trials, by)}


def test_nested_keys():
    assert flattened({"a": {"b": {"c": 1}, "d": [2]}, "e": None}) == {"a.b.c": 1, "a.d": [2], "e": None}


def test_names_without_their_seed():
    assert without_seed("stock-none-0", 0) == "stock-none"
    assert without_seed("stock_12", 12) == "stock"
    assert without_seed("stock-12", 2) == "stock-12"  # another number's last digit
    assert without_seed("7", 7) == "7"
    assert without_seed("reach", 0) == "reach"


def test_groups_are_called_by_what_differs():
    trials = [
        trial("a-0"),
        trial("b", **{"learner.gamma": 0.99}),
        trial("a-1", seed=1),
        trial("c", algorithm="tqc"),
    ]
    assert differing_keys(trials) == ["algorithm", "learner.gamma"]
    assert titles(trials) == {"sac, gamma 0.95": (0, 2), "sac, gamma 0.99": (1,), "tqc, gamma 0.95": (3,)}
    assert titles(trials, ["algorithm"]) == {"sac": (0, 1, 2), "tqc": (3,)}
    assert titles(trials, ["folder"]) == {"a": (0, 2), "b": (1,), "c": (3,)}


def test_a_key_that_only_some_have_differs():
    old = Trial("old", 0, "old", {"folder": "old", **{key: BASE[key] for key in BASE if key != "network"}})
    new = trial("new", network="runs/net")
    assert differing_keys([old, new]) == ["network"]
    assert titles([old, new]) == {"network none": (0,), "network runs/net": (1,)}


def test_other_models_of_the_robot_are_told_by_their_folders():
    trials = [
        trial("stock-none-0", kind="x"),
        trial("identified-none-0", kind="y"),
        trial("stock-none-1", seed=1, kind="x"),
        trial("stock-all-0", kind="z", **{"randomization.friction": 0.1}),
    ]
    assert titles(trials) == {"stock-none": (0, 2), "identified-none": (1,), "stock-all": (3,)}


def test_folders_of_one_name_are_told_by_their_keys_or_numbered():
    trials = [trial("t-0", kind="x"), trial("t-0", kind="y"), trial("t-0", kind="z", algorithm="tqc")]
    assert titles(trials) == {"t, sac": (0,), "t, sac (2)": (1,), "t, tqc": (2,)}


def test_one_training_is_called_like_its_folder():
    assert titles([trial("reach-0")]) == {"reach": (0,)}
    assert titles([trial("reach-0"), trial("reach-1", seed=1)]) == {"reach": (0, 1)}


def test_a_key_that_is_none_lists_those_that_are():
    with pytest.raises(ConfigError, match=r"learner\.gama") as caught:
        grouped([trial("a")], ["learner.gama"])
    assert "learner.gamma" in caught.value.summary


def test_short_names_say_more_where_they_would_not_tell():
    assert short_names(["learner.gamma", "friction"], list(BASE)) == {"learner.gamma": "gamma", "friction": "friction"}
    assert short_names(["randomization.friction"], list(BASE)) == {"randomization.friction": "randomization friction"}


def test_ranges_and_nothing_in_words():
    trials = [trial("a"), trial("b", delay_s=[0.0, 0.01], network="net")]
    assert list(titles(trials)) == ["network none, delay s 0 to 0.004", "network net, delay s 0 to 0.01"]


def test_policies_alike_but_for_their_seed():
    trials = [trial("a-0"), trial("b-0", algorithm="tqc"), trial("a-1", seed=1)]
    assert [(group.title, group.members) for group in alike(trials)] == [("a", (0, 2)), ("b-0", (1,))]
    twice = [trial("a-0"), trial("a-0"), trial("a-1", seed=1)]
    assert [(group.title, group.members) for group in alike(twice)] == [
        ("a-0", (0,)),
        ("a-0 (2)", (1,)),
        ("a-1", (2,)),
    ]
    assert unlike(["a", "a (2)", "a"]) == ["a", "a (2)", "a (3)"]
