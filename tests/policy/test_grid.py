"""Grids of trainings: the thesis's numbers, what YAML may say, and points that are trainings of their own."""

import subprocess
import sys
from dataclasses import replace

import pytest

from trueup.errors import ConfigError
from trueup.policy.config import ALGORITHMS, LAPTOP, PAPER, PolicyConfig
from trueup.policy.grid import NAMES, THESIS, read_grid

NOISES = {("none", 0.1), ("normal", 0.2), ("normal", 0.1), ("ou", 0.2), ("ou", 0.1)}


def values(algorithm):
    return {axis.title: set(axis.rows) for axis in THESIS[algorithm].axes}


def test_the_thesis_grids():
    """ES thesis, 2.3.2; the noises are those of 2.3, and sigma is the width of one."""
    rates, taus = {(0.005,), (0.002,), (0.001,)}, {(0.005,), (0.01,), (0.02,)}
    assert values("ddpg") == {
        "learner.rate": rates,
        "learner.gamma": {(0.99,), (0.97,), (0.95,)},
        "learner.noise, learner.sigma": NOISES,
        "learner.tau": taus,
    }
    for algorithm in ("sac", "td3"):
        assert values(algorithm) == {
            "learner.rate": rates,
            "learner.gamma": {(0.99,), (0.95,)},
            "learner.noise, learner.sigma": NOISES,
            "learner.tau": taus,
        }
    assert values("tqc") == {
        "learner.rate": rates,
        "learner.gamma": {(0.99,), (0.95,)},
        "learner.tau": {(0.9,), (0.8,)},
    }
    assert {name: len(grid) for name, grid in THESIS.items()} == {"ddpg": 135, "sac": 90, "td3": 90, "tqc": 12}


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("laptop", [True, False])
def test_what_the_thesis_found_best_is_a_point_of_its_grid(algorithm, laptop):
    base = replace(LAPTOP, algorithm=algorithm) if laptop else PolicyConfig(algorithm, PAPER[algorithm])
    points = THESIS[algorithm].points(base, seed=3)
    assert len({point.id for point in points}) == len(points) == len(THESIS[algorithm])
    assert {point.seed for point in points} == {3}
    assert all(point.config.algorithm == algorithm for point in points)
    if not laptop:
        assert PAPER[algorithm] in [point.config.learner for point in points]


def test_names_and_values_become_configurations():
    grid = read_grid({"rate": [1, 2.0e-3], "layers": [[8], [16, 16]], "seed": [0, 5], "arms": [2]}, "g.yaml")
    points = grid.points(LAPTOP, seed=1)
    assert len(points) == len(grid) == 8
    first, last = points[0], points[-1]
    assert (first.config.learner.rate, first.config.learner.layers, first.seed) == (1.0, (8,), 0)
    assert (last.config.learner.rate, last.config.learner.layers, last.seed) == (0.002, (16, 16), 5)
    assert {point.config.arms for point in points} == {2}
    assert last.values == {"learner.rate": 0.002, "learner.layers": [16, 16], "seed": 5, "arms": 2}
    assert last.config == replace(LAPTOP, arms=2, learner=replace(LAPTOP.learner, rate=0.002, layers=(16, 16)))


def test_a_point_is_called_the_same_in_every_spelling_and_grid():
    one = read_grid({"rate": [1.0], "gamma": [0.9]}, "g").points(LAPTOP)[0]
    other = read_grid({"learner.gamma": [0.8, 0.9], "learner.rate": [1]}, "g").points(LAPTOP, seed=4)[1]
    assert one.id == other.id
    assert one.id != read_grid({"rate": [1.0]}, "g").points(LAPTOP)[0].id
    assert len(one.id) == 12


def test_what_belongs_together_is_one_axis():
    grid = read_grid({"noise, sigma": [["none", 0.1], ["ou", 0.2]], "last_rate": [None, 1.0e-4]}, "g")
    found = [(p.config.learner.noise, p.config.learner.sigma, p.config.learner.last_rate) for p in grid.points(LAPTOP)]
    assert found == [("none", 0.1, None), ("none", 0.1, 1e-4), ("ou", 0.2, None), ("ou", 0.2, 1e-4)]


@pytest.mark.parametrize(
    ("tree", "said"),
    [
        ({}, "has no names"),
        ({"rte": [1.0]}, r"unknown names \['rte'\].*learner.rate"),
        ({"reach.control_hz": [25]}, "unknown names"),
        ({3: [1.0]}, "unknown names"),
        ({"rate": 1.0e-3}, "must be a list of values"),
        ({"rate": []}, "must be a list of values"),
        ({"rate": ["fast"]}, "rate has the wrong type"),
        ({"rate": [0.001, -1.0]}, "rate: got -1.0; expected a positive number"),
        ({"gamma": [1.5]}, "at most 1"),
        ({"noise": ["pink"]}, "noise is not a choice"),
        ({"batch": [2.5]}, "batch has the wrong type"),
        ({"seed": [-1]}, "seed: got -1; expected a whole number"),
        ({"arms": [True]}, "arms: got True"),
        ({"steps": [0]}, "steps: got 0"),
        ({"rate": [0.1], "learner.rate": [0.2]}, "names twice: got learner.rate"),
        ({"noise, sigma": ["ou", 0.1]}, "list of lists"),
        ({"noise, sigma": [["ou"]]}, "2 values each"),
    ],
)
def test_bad_grids(tree, said):
    with pytest.raises(ConfigError, match=f"(?s)g.yaml.*{said}"):
        read_grid(tree, "g.yaml")


def test_all_known_names_are_listed():
    with pytest.raises(ConfigError) as caught:
        read_grid({"x": [1]}, "g.yaml")
    assert all(name in str(caught.value) for name in NAMES)
    assert {"learner.rate", "learner.layers", "arms", "steps", "rounds", "seed"} <= set(NAMES)


def test_points_that_are_no_training_or_the_same_one():
    with pytest.raises(ConfigError, match=r"no training with steps 10, arms 16: .*a control step of each arm"):
        read_grid({"steps": [400_000, 10], "arms": [16]}, "g").points(PolicyConfig())
    with pytest.raises(ConfigError, match="same training") as caught:
        read_grid({"noise": ["none", "ou"], "sigma": [0.1, 0.2]}, "g").points(PolicyConfig())
    assert "noise none, sigma 0.1, and noise none, sigma 0.2" in str(caught.value)
    assert '"noise, sigma"' in caught.value.hint
    with pytest.raises(ConfigError, match="same training"):
        read_grid({"rate": [1, 1.0]}, "g").points(PolicyConfig())
    with pytest.raises(ConfigError, match="too many points: got 10100"):
        read_grid({"seed": [*range(101)], "starts": [*range(1, 101)]}, "g").points(PolicyConfig())


@pytest.mark.long
def test_grids_are_read_without_optuna_or_ray():
    code = "import sys, trueup.policy.grid, trueup.policy.training, trueup.stages.policy_grid, trueup.cli.main; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert "trueup.policy.grid" in loaded
    assert not {"optuna", "ray", "sqlalchemy"} & set(loaded)
