"""Derivative-free solvers find known minima, keep their promises step by step, and resume where they were."""

import json
from collections import deque

import numpy as np
import pytest

from trueup.errors import ConfigError
from trueup.identify import solvers
from trueup.identify.solvers import (
    AskTell,
    CmaEs,
    CmaSettings,
    Evaluation,
    EvolutionSettings,
    EvolutionStrategy,
    Roles,
    Space,
    compare_ends,
    draw_starts,
    minimize,
)


def box(size, *, low=-2.0, high=2.0, start=0.0, scale=1.0):
    return Space(*(np.full(size, float(value)) for value in (low, high, start, scale)))


def bowl(size, seed=0):
    """A quadratic with correlations and a condition number of 100; its minimum lies in the box."""
    rng = np.random.default_rng(seed)
    axes, _ = np.linalg.qr(rng.normal(size=(size, size)))
    shape = axes @ np.diag(np.geomspace(1.0, 100.0, size)) @ axes.T
    minimum = rng.uniform(-1.0, 1.0, size)
    return minimum, lambda z: Evaluation(np.einsum("ci,ij,cj->c", z - minimum, shape, z - minimum))


def rosenbrock(z):
    return Evaluation(100.0 * (z[:, 1] - z[:, 0] ** 2) ** 2 + (1.0 - z[:, 0]) ** 2)


class Joints:
    """Three joints with two friction parameters and an inertia each; the first friction parameter counts double."""

    def __init__(self, coupling=0.0):
        self.truth = np.tile([0.8, -0.5, 0.3], 3) + np.linspace(-0.2, 0.2, 9)
        self.roles = Roles(np.repeat(np.arange(3), 3), np.tile([1, -1, 0], 3))
        self.coupling = coupling

    def __call__(self, z):
        away = (z - self.truth).reshape(len(z), 3, 3)
        too_much = 2.0 * away[:, :, 0] - away[:, :, 1]
        absolute = np.abs(away).sum(axis=2)
        absolute = absolute + self.coupling * np.roll(absolute, 1, axis=1)
        return Evaluation(absolute.sum(axis=1), too_much, absolute)


def evolution(seed=0, space=None, joints=None, **settings):
    space, joints = space or box(9), joints or Joints()
    return EvolutionStrategy(space, joints.roles, EvolutionSettings(**settings), seed=seed)


def make(kind, seed=0):
    if kind == "cma":
        return CmaEs(box(9), CmaSettings(population=8), seed=seed)
    return evolution(seed, population=int(kind[-1]), acceptance="total" if kind[0] == "t" else "group")


KINDS = ["cma", "group1", "group4", "total1"]


def step(solver, evaluate):
    z = solver.ask()
    solver.tell(z, evaluate(z))
    return z


# Known minima


@pytest.mark.parametrize("size", [10, 20])
def test_cma_finds_the_minimum_of_a_correlated_quadratic(size):
    minimum, evaluate = bowl(size)
    result = minimize(CmaEs(box(size), seed=1), evaluate, max_evaluations=20_000)
    assert result.stop.kind == "converged"
    np.testing.assert_allclose(result.z, minimum, atol=1e-3)


@pytest.mark.parametrize("size", [1, 2, 3])
def test_cma_finds_small_minima_too(size):
    minimum, evaluate = bowl(size)
    result = minimize(CmaEs(box(size)), evaluate, max_evaluations=5000)
    assert result.z.shape == (size,)
    np.testing.assert_allclose(result.z, minimum, atol=1e-3)


def test_cma_finds_the_minimum_of_rosenbrock():
    space = Space(np.array([-3.0, -3.0]), np.array([3.0, 3.0]), np.array([-1.2, 1.0]), np.ones(2))
    result = minimize(CmaEs(space, CmaSettings(cost_tolerance=1e-14)), rosenbrock, max_evaluations=5000)
    np.testing.assert_allclose(result.z, [1.0, 1.0], atol=1e-3)


def test_scales_that_differ_by_orders_of_magnitude_do_not_matter_to_cma():
    unit = box(6)
    factor = 10.0 ** np.array([-4.0, 0.0, 3.0, -2.0, 5.0, 1.0])
    stretched = Space(unit.low * factor, unit.high * factor, unit.start, factor)
    minimum, evaluate = bowl(6)
    plain = minimize(CmaEs(unit), evaluate, max_evaluations=3000)
    other = minimize(CmaEs(stretched), lambda z: evaluate(z / factor), max_evaluations=3000)
    np.testing.assert_allclose(other.z / factor, minimum, atol=1e-3)
    assert other.evaluations == plain.evaluations


@pytest.mark.parametrize("solver", ["cma", "evolution"])
def test_a_minimum_beyond_a_bound_is_found_on_the_bound(solver):
    space = box(4)
    minimum = np.array([0.5, 3.0, -0.5, -9.0])

    def evaluate(z):
        assert np.all(z >= space.low)
        assert np.all(z <= space.high)
        return Evaluation(((z - minimum) ** 2).sum(axis=1))

    asked = CmaEs(space) if solver == "cma" else EvolutionStrategy(space, settings=EvolutionSettings(finer_decades=3.0))
    result = minimize(asked, evaluate, max_evaluations=4000)
    np.testing.assert_allclose(result.z, [0.5, 2.0, -0.5, -2.0], atol=0.02)


@pytest.mark.parametrize("kind", KINDS)
def test_candidates_that_fail_lose_and_the_search_goes_on(kind):
    joints, failures = Joints(), 0

    def evaluate(z):
        nonlocal failures
        found = joints(z)
        # The start is fine, but close to it, and close to the minimum, simulations diverge.
        bad = (z[:, 0] < -0.05) | (z[:, 4] > 0.1) | (z[:, 8] > 0.52)
        failures += bad.sum()
        lost = np.where(bad, np.where(z[:, 1] > 0, np.inf, np.nan), found.cost)
        return Evaluation(lost, found.signed, found.absolute)

    result = minimize(make(kind), evaluate, max_evaluations=3000)
    assert failures > 20
    start = joints(np.zeros((1, 9))).cost[0]
    assert result.cost < (0.7 if kind == "total1" else 0.1) * start
    assert not ((result.z[0] < -0.05) | (result.z[4] > 0.1) | (result.z[8] > 0.52))


@pytest.mark.parametrize("coupling", [0.0, 0.2])
def test_the_evolution_strategy_cuts_the_error_of_every_joint(coupling):
    joints = Joints(coupling)
    solver = evolution(1, joints=joints, finer_decades=1.5)
    result = minimize(solver, joints, max_evaluations=4000)
    before, after = joints(np.zeros((1, 9))).absolute[0], joints(result.z[np.newaxis]).absolute[0]
    assert np.all(after < 0.05 * before)


def test_joints_that_accept_alone_are_faster_than_joints_that_accept_together():
    joints = Joints()
    alone, together = (
        np.median([minimize(make(kind, seed), joints, max_evaluations=300).cost for seed in range(5)])
        for kind in ("group1", "total1")
    )
    assert alone < 0.5 * together


def test_the_best_of_coupled_joints_was_evaluated_as_a_whole():
    joints, seen = Joints(coupling=3.0), {}

    def evaluate(z):
        found = joints(z)
        seen.update(zip(map(bytes, z), found.cost.tolist(), strict=True))
        return found

    solver = evolution(joints=joints)
    costs = []
    for _ in range(300):
        step(solver, evaluate)
        z, cost = solver.best
        assert seen[bytes(z)] == cost
        costs.append(cost)
    assert costs == sorted(costs, reverse=True)
    assert costs[-1] < 0.5 * costs[0]


# What every solver promises


@pytest.mark.parametrize("kind", KINDS)
def test_the_start_is_among_the_first_candidates_and_all_are_inside(kind):
    solver, joints = make(kind), Joints()
    assert isinstance(solver, AskTell)
    first = solver.ask()
    np.testing.assert_array_equal(first[0], np.zeros(9))
    np.testing.assert_array_equal(solver.ask(), first)
    space = box(9, low=-0.3, high=0.2, scale=2.0)
    narrow = CmaEs(space) if kind == "cma" else evolution(space=space)
    on_bound = 0
    for _ in range(100):
        z = step(narrow, joints)
        assert np.all((space.low <= z) & (z <= space.high))
        on_bound += np.sum((z == space.low) | (z == space.high))
    if kind == "cma":  # candidates cut at the bounds would mislead its covariance
        assert on_bound == 0


@pytest.mark.parametrize("kind", KINDS)
def test_the_seed_decides_and_the_global_generator_does_not(kind):
    joints = Joints()
    runs = []
    for seed in (3, 3, 4):
        # The very generator that must not matter.
        np.random.seed(len(runs))  # noqa: NPY002
        runs.append(minimize(make(kind, seed), joints, max_evaluations=200))
    np.testing.assert_array_equal(runs[0].z, runs[1].z)
    assert runs[0].cost == runs[1].cost
    assert not np.array_equal(runs[0].z, runs[2].z)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("failing", [False, True])
def test_a_resumed_search_is_the_uninterrupted_one(kind, failing):
    joints = Joints(coupling=0.1)

    def evaluate(z):
        found = joints(z)
        return Evaluation(np.where(failing & (z[:, 2] > 0.02), np.nan, found.cost), found.signed, found.absolute)

    whole = make(kind)
    asked = [step(whole, evaluate) for _ in range(120)]
    for stop_after in (0, 1, 37, 119):
        first = make(kind)
        for _ in range(stop_after):
            step(first, evaluate)
        first.ask()  # interrupted while the candidates were being evaluated
        text = json.dumps(first.state(), allow_nan=False)
        resumed = make(kind)
        resumed.restore(json.loads(text))
        assert resumed.evaluations == sum(map(len, asked[:stop_after]))
        for expected in asked[stop_after:]:
            np.testing.assert_array_equal(step(resumed, evaluate), expected)
        assert resumed.state() == whole.state()
        np.testing.assert_array_equal(resumed.best[0], whole.best[0])


def test_a_resumed_cma_search_stops_where_the_uninterrupted_one_does():
    _, evaluate = bowl(4)
    states = []
    solver = CmaEs(box(4))
    whole = minimize(solver, evaluate, on_step=lambda _: states.append(solver.state()))
    middle = len(states) // 2
    resumed = CmaEs(box(4))
    resumed.restore(states[middle])
    rest = minimize(resumed, evaluate, history=whole.history[: middle + 1])
    assert rest.stop == whole.stop
    assert [(point.evaluations, point.cost) for point in rest.history] == [
        (point.evaluations, point.cost) for point in whole.history
    ]


@pytest.mark.parametrize("kind", KINDS)
def test_a_checkpoint_of_another_search_is_refused(kind):
    state = make(kind, seed=1).state()
    with pytest.raises(ConfigError, match="other seed"):
        make(kind, seed=2).restore(state)
    other = "group1" if kind == "cma" else "cma"
    with pytest.raises(ConfigError, match="another search"):
        make(other, seed=1).restore(state)
    with pytest.raises(ConfigError, match="lacks"):
        make(kind, seed=1).restore({"setup": state["setup"]})
    elsewhere = (
        CmaEs(box(9, high=3.0), CmaSettings(population=8)) if kind == "cma" else evolution(space=box(9, high=3.0))
    )
    with pytest.raises(ConfigError, match="other space"):
        elsewhere.restore(state)


def test_a_cma_checkpoint_that_cannot_be_drawn_again_is_refused():
    solver = make("cma")
    for _ in range(5):
        step(solver, Joints())
    state = solver.state()
    state["last"][3] += 0.01
    with pytest.raises(ConfigError, match="drawn again"):
        make("cma").restore(state)


@pytest.mark.parametrize("kind", KINDS)
def test_only_the_answer_to_the_question_is_accepted(kind):
    solver, joints = make(kind), Joints()
    with pytest.raises(ConfigError, match="ask"):
        solver.tell(np.zeros((1, 9)), joints(np.zeros((1, 9))))
    z = solver.ask()
    with pytest.raises(ConfigError, match="other candidates"):
        solver.tell(z + 0.1, joints(z))
    with pytest.raises(ConfigError, match="cost"):
        solver.tell(z, joints(np.vstack([z, z])))


@pytest.mark.parametrize("kind", KINDS)
def test_a_search_in_which_everything_fails_ends_and_says_so(kind):
    def evaluate(z):
        nothing = np.full((len(z), 3), np.nan)
        return Evaluation(np.full(len(z), np.nan), nothing, nothing)

    result = minimize(make(kind), evaluate, max_evaluations=10_000)
    assert result.stop.kind == "failed"
    assert "every candidate failed in" in result.stop.text
    assert result.cost == np.inf
    np.testing.assert_array_equal(result.z, np.zeros(9))
    assert result.evaluations < 1000


def test_cma_creeps_out_of_a_start_around_which_everything_fails():
    minimum = np.full(6, 0.01)

    def evaluate(z):
        away = np.linalg.norm(z - minimum, axis=1)
        return Evaluation(np.where(away < 0.05, away, np.nan))

    result = minimize(CmaEs(box(6)), evaluate, max_evaluations=3000)
    np.testing.assert_allclose(result.z, minimum, atol=1e-5)


def test_a_cost_that_does_not_depend_on_anything_is_told():
    result = minimize(CmaEs(box(5)), lambda z: Evaluation(np.full(len(z), 7.0)), max_evaluations=5000)
    assert result.evaluations < 1000
    assert result.stop.kind == "stalled"
    assert "the cost does not depend on what is searched" in result.stop.text


# Smart adjustment and worse counter (ES thesis 3.2.1)


def one_joint(signed, costs):
    """Answers with one sign of the error, and with the costs in their order, whatever the candidates are."""
    left = deque(costs)

    def evaluate(z):
        cost = np.array([left.popleft() for _ in z])
        return Evaluation(cost, np.full((len(z), 1), float(signed)), cost[:, np.newaxis])

    return evaluate


def one_joint_search(**settings):
    roles = Roles(np.zeros(3, dtype=int), np.array([1, -1, 0]))
    return EvolutionStrategy(box(3), roles, EvolutionSettings(**settings))


@pytest.mark.parametrize("acceptance", ["group", "total"])
@pytest.mark.parametrize("signed", [-3.0, 2.0])
def test_friction_moves_only_where_the_sign_asks_until_the_first_threshold(signed, acceptance):
    solver = one_joint_search(ignore_after=20, widen_after=60, acceptance=acceptance)
    evaluate = one_joint(signed, [1.0] + [2.0] * 100)
    step(solver, evaluate)
    moves = np.array([step(solver, evaluate)[0] for _ in range(100)])
    # Too much friction (a positive sign): what raises friction falls, what lowers it rises.
    early, late = np.sign(signed) * moves[:21], moves[21:]
    assert np.all(early[:, 0] < 0.0)
    assert np.all(early[:, 1] > 0.0)
    assert {-1.0, 1.0} == set(np.sign(early[:, 2]))
    for column in late.T:
        assert 0.25 < np.mean(column > 0.0) < 0.75
    # Beyond the second threshold the neighborhood is three times as wide.
    settings = EvolutionSettings()
    assert np.abs(moves[:61]).max() <= settings.step
    assert 2.0 * settings.step < np.abs(moves[61:]).max() <= 3.0 * settings.step


def test_without_smart_adjustment_or_sign_friction_moves_both_ways():
    for settings, signed in (({"smart": False}, 1.0), ({}, np.nan), ({}, 0.0)):
        solver = one_joint_search(ignore_after=100, **settings)
        evaluate = one_joint(signed, [1.0] + [2.0] * 50)
        moves = np.array([step(solver, evaluate)[0] for _ in range(51)])[1:]
        assert all({-1.0, 1.0} == set(np.sign(column)) for column in moves.T)


def test_the_worse_counter_counts_and_a_new_best_resets_it():
    solver = one_joint_search()
    evaluate = one_joint(1.0, [5.0, 6.0, 5.0, 7.0, 4.0, 4.5, np.nan, 3.0])
    counters = []
    for _ in range(8):
        step(solver, evaluate)
        counters.append(solver.state()["worse"][0])
    assert counters == [0, 1, 2, 3, 0, 1, 2, 0]
    assert solver.best[1] == 3.0


def test_worse_candidates_are_reverted():
    solver = one_joint_search(step=0.01, widen=1.0)
    evaluate = one_joint(1.0, [5.0, 4.0] + [6.0] * 20)
    step(solver, evaluate)
    best = step(solver, evaluate)[0]
    for _ in range(20):
        assert np.abs(step(solver, evaluate)[0] - best).max() <= 0.01
        np.testing.assert_array_equal(solver.best[0], best)


def test_each_joint_keeps_its_own_parameters_and_its_own_counter():
    roles = Roles(np.array([0, 1]), np.zeros(2, dtype=int))
    solver = EvolutionStrategy(box(2), roles)
    answers = deque([(5.0, 5.0), (4.0, 9.0), (4.0, 5.0), (9.0, 3.0), (4.0, 3.0), (8.0, 8.0)])

    def evaluate(z):
        absolute = np.array([answers.popleft() for _ in z])
        return Evaluation(absolute.sum(axis=1), None, absolute)

    start, first = step(solver, evaluate)[0], step(solver, evaluate)[0]
    np.testing.assert_array_equal(solver.best[0], start)
    joined = step(solver, evaluate)[0]
    np.testing.assert_array_equal(joined, [first[0], start[1]])
    np.testing.assert_array_equal(solver.best[0], joined)
    assert solver.state()["worse"][:2] == [0, 1]
    second = step(solver, evaluate)[0]  # 12 is more than 9, but joint 1 gained
    assert solver.state()["worse"][:2] == [1, 2]
    np.testing.assert_array_equal(step(solver, evaluate)[0], [first[0], second[1]])
    assert solver.state()["worse"][:2] == [1, 0]
    assert solver.best[1] == 7.0
    step(solver, evaluate)
    assert solver.state()["worse"][:2] == [2, 1]


def test_a_counter_is_reset_by_what_is_better_than_the_point_that_stands():
    roles = Roles(np.array([0, 1]), np.zeros(2, dtype=int))
    solver = EvolutionStrategy(box(2), roles)
    # The second candidate wins as a whole, the third joins it with the start, the fourth is better than the third.
    answers = deque([(5.0, 5.0), (2.0, 6.0), (2.5, 5.0), (2.2, 4.9)])

    def evaluate(z):
        absolute = np.array([answers.popleft() for _ in z])
        return Evaluation(absolute.sum(axis=1), None, absolute)

    counters = []
    for _ in range(4):
        step(solver, evaluate)
        counters.append(solver.state()["worse"][:2])
    assert counters == [[0, 0], [0, 1], [0, 1], [0, 0]]
    assert solver.best[1] == pytest.approx(7.1)


@pytest.mark.parametrize("seed", range(12))
def test_around_joined_parameters_each_joint_goes_by_the_sign_it_was_seen_with(seed):
    settings = EvolutionSettings(population=2)
    solver = EvolutionStrategy(box(2), Roles(np.array([0, 1]), np.array([1, 1])), settings, seed=seed)
    z = solver.ask()
    absolute = np.array([[5.0, 5.0], [4.0, 9.0]])
    solver.tell(z, Evaluation(absolute.sum(axis=1), np.array([[1.0, 1.0], [-1.0, -1.0]]), absolute))
    joined, drawn = solver.ask()
    np.testing.assert_array_equal(joined, [z[1, 0], z[0, 1]])
    assert drawn[0] > joined[0]
    assert drawn[1] < joined[1]


def test_joints_that_do_not_go_together_are_reverted():
    roles = Roles(np.array([0, 1]), np.zeros(2, dtype=int))
    solver = EvolutionStrategy(box(2), roles, EvolutionSettings(step=0.01))
    answers = deque([(5.0, 5.0), (4.0, 9.0), (4.0, 8.0), (9.0, 9.0)])

    def evaluate(z):
        absolute = np.array([answers.popleft() for _ in z])
        return Evaluation(absolute.sum(axis=1), None, absolute)

    for _ in range(3):
        step(solver, evaluate)
    np.testing.assert_array_equal(solver.best[0], np.zeros(2))
    next_one = step(solver, evaluate)[0]
    assert np.all(next_one != 0.0)  # a new candidate, not the refused point again
    assert np.abs(next_one).max() <= 0.01


def test_the_errors_that_the_evolution_strategy_needs_are_asked_for():
    joints = Joints()
    cases = [({}, "absolute", lambda z: Evaluation(joints(z).cost, joints(z).signed))]
    cases += [({"acceptance": "total"}, "signed", lambda z: Evaluation(joints(z).cost))]
    cases += [({}, "signed", lambda z: Evaluation(joints(z).cost, None, joints(z).absolute))]
    cases += [
        ({}, "absolute", lambda z: Evaluation(joints(z).cost, joints(z).signed[:, :2], joints(z).absolute[:, :2]))
    ]
    for settings, name, evaluate in cases:
        with pytest.raises(ConfigError, match=f"needs the {name} error of each group"):
            step(evolution(**settings), evaluate)
    step(evolution(acceptance="total", smart=False), lambda z: Evaluation(joints(z).cost))


# The loop


class Clock:
    """One second further at every look."""

    def __init__(self):
        self.now = -1.0

    def __call__(self):
        self.now += 1.0
        return self.now


def test_budgets_stop_the_loop():
    joints = Joints()
    by_count = minimize(make("group4"), joints, max_evaluations=10)
    assert by_count.stop.kind == "evaluations"
    assert by_count.evaluations == 12
    # Two looks a step: 19 s are reached when nine and a half steps are done.
    by_time = minimize(make("group1"), joints, max_seconds=19.0, clock=Clock())
    assert by_time.stop.kind == "time"
    assert len(by_time.history) == 9
    assert [point.seconds for point in by_time.history] == [2.0 * index for index in range(1, 10)]


def test_the_history_of_a_checkpoint_is_continued():
    joints, solver, seen = Joints(), make("group1"), []
    first = minimize(solver, joints, max_evaluations=20, clock=Clock())
    second = minimize(solver, joints, on_step=seen.append, max_evaluations=50, history=first.history, clock=Clock())
    assert second.history[:20] == first.history
    assert list(second.history[20:]) == seen
    assert [point.evaluations for point in second.history] == list(range(1, 51))
    assert np.all(np.diff([point.seconds for point in second.history]) > 0.0)
    assert np.all(np.diff([point.cost for point in second.history]) <= 0.0)


# Space and settings


@pytest.mark.parametrize(
    ("field", "value", "what"),
    [
        ("low", 3.0, "bounds contradict each other"),
        ("low", 2.0, "bounds contradict each other"),
        ("high", np.inf, "bounds must be finite"),
        ("start", 2.5, "start lies outside the bounds"),
        ("start", np.nan, "start lies outside the bounds"),
        ("scale", 0.0, "scale must be above 0"),
        ("scale", np.nan, "scale must be above 0"),
    ],
)
def test_a_space_that_makes_no_sense_is_refused_by_name(field, value, what):
    vectors = {"low": -2.0, "high": 2.0, "start": 0.0, "scale": 1.0}
    arrays = {name: np.full(3, number) for name, number in vectors.items()}
    arrays[field][1] = value
    with pytest.raises(ConfigError, match=what) as caught:
        Space(**arrays, names=("kp", "damping", "armature"))
    assert "damping" in str(caught.value)
    assert "kp" not in str(caught.value)


def test_settings_and_roles_that_make_no_sense_are_refused():
    roles = Roles(np.zeros(3, dtype=int), np.array([1, -1, 0]))
    for wrong in (
        lambda: Space(np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0)),
        lambda: Space(-np.ones(2), np.ones(2), np.zeros(2), np.ones(2), names=("one",)),
        lambda: CmaSettings(population=2),
        lambda: CmaSettings(step=0.0),
        lambda: EvolutionSettings(population=0),
        lambda: EvolutionSettings(step=-1.0),
        lambda: EvolutionStrategy(box(4), roles),
        lambda: EvolutionStrategy(box(3), Roles(roles.group, np.array([2, 0, 0]))),
        lambda: EvolutionStrategy(box(3), Roles(roles.group - 2, roles.effect)),
        lambda: draw_starts(box(2), 0),
        lambda: draw_starts(box(2), 2, spread=0.0),
    ):
        with pytest.raises(ConfigError):
            wrong()


def test_every_public_name_is_there():
    assert all(hasattr(solvers, name) for name in solvers.__all__)


# Several starts


@pytest.mark.parametrize("count", [1, 2, 7, 33])
def test_starts_are_seeded_inside_and_spread_evenly(count):
    space = box(5, low=-1.0, high=3.0)
    starts = draw_starts(space, count, seed=4)
    assert starts.shape == (count, 5)
    np.testing.assert_array_equal(starts[0], space.start)
    assert np.all((space.low <= starts) & (starts <= space.high))
    np.testing.assert_array_equal(starts, draw_starts(space, count, seed=4))
    if count == 33:
        assert not np.array_equal(starts, draw_starts(space, count, seed=5))
        cells = np.floor((starts[1:] + 1.0) / 4.0 * 32)
        for column in cells.T:  # one point into each of 32 slices of every axis
            assert sorted(column) == list(range(32))


def test_starts_around_the_start_stay_near_it_and_inside():
    space = box(3, start=1.9, scale=0.5)
    starts = draw_starts(space, 40, spread=2.0)
    assert starts.min() >= 0.9
    assert starts.max() <= 2.0
    assert starts.min() < 1.0


def ends_of(space, starts, evaluate):
    found = [
        minimize(
            CmaEs(Space(space.low, space.high, start, 0.2 * space.scale, space.names), CmaSettings(step=0.1)),
            evaluate,
            max_evaluations=1500,
        )
        for start in starts
    ]
    return np.array([result.z for result in found]), np.array([result.cost for result in found])


def compared(space, z, cost):
    return compare_ends(space, z, cost, cost_tolerance=0.01, place_tolerance=0.05)


def test_starts_that_agree_say_so():
    _, evaluate = bowl(3)
    space = box(3)
    agreement = compared(space, *ends_of(space, draw_starts(space, 4), evaluate))
    assert agreement.verdict == "agree"
    assert agreement.same == 4
    assert agreement.spread.max() < 0.05
    assert agreement.text == "4 of 4 starts end in the same best place"


def test_a_parameter_without_effect_is_named():
    space = Space(-2 * np.ones(2), 2 * np.ones(2), np.zeros(2), np.ones(2), ("gain", "payload"))

    def evaluate(z):
        return Evaluation(1.0 + (z[:, 0] - 0.3) ** 2)

    agreement = compared(space, *ends_of(space, draw_starts(space, 4), evaluate))
    assert agreement.verdict == "not-unique"
    assert "payload not determined" in agreement.text
    assert "gain" not in agreement.text
    assert agreement.spread[1] > 0.5


def test_local_minima_are_told_apart():
    def evaluate(z):
        return Evaluation(1.0 + (z[:, 0] ** 2 - 1.0) ** 2 + 0.3 * z[:, 0])

    space = box(1, start=1.0)
    agreement = compared(space, *ends_of(space, np.array([[1.0], [1.5], [-1.5], [0.5]]), evaluate))
    assert agreement.verdict == "local-minima"
    assert (agreement.same, agreement.worse) == (1, 3)


def test_the_spread_is_that_of_the_ends_as_good_as_the_best():
    z, cost = np.array([[0.0], [1.0], [0.02], [5.0], [7.0]]), np.array([1.0, 1.005, 1.2, 9.0, np.inf])
    agreement = compared(box(1, scale=2.0), z, cost)
    assert agreement.verdict == "not-unique"
    assert (agreement.same, agreement.elsewhere, agreement.worse, agreement.failed) == (2, 1, 1, 1)
    assert agreement.spread[0] == pytest.approx(0.5)
    assert agreement.text.endswith("; 1 of 5 failed")


def test_starts_that_fail_are_counted():
    space = box(1)
    one = compared(space, np.array([[-1.0], [1.5], [0.5]]), np.array([np.inf, np.nan, 1.0]))
    assert (one.verdict, one.failed) == ("single", 2)
    assert "2 of 3 failed" in one.text
    nothing = compared(space, np.array([[-1.0], [1.5]]), np.full(2, np.inf))
    assert (nothing.verdict, nothing.failed) == ("failed", 2)
