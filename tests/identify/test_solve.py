"""How solvers take turns: on functions whose minimum is known, in the place of a small arm's simulation."""

from dataclasses import replace

import numpy as np
import pytest

from identify.recovery_cases import SERVO, TORQUE, Truth, arm, nominal_of
from trueup.core.fit_result import FitResult, Whiteness
from trueup.core.parameters import ParameterSet
from trueup.core.results import Estimate
from trueup.errors import DataError
from trueup.identify import (
    IdentifyConfig,
    Nominal,
    Problem,
    SegmentRule,
    SolveSettings,
    identify,
    make_segments,
    solve,
)
from trueup.identify.config import SolverChoice, make_parameters
from trueup.identify.costs import PenalizedSquares, roles_of
from trueup.identify.logged_torque import READ_S, LoggedTorque
from trueup.identify.problem import Weights
from trueup.identify.solution import Checkpoint, fingerprint_of
from trueup.identify.solvers import GaussNewtonSettings
from trueup.identify.uncertainty import fitted_parameters, posterior_of, whiteness_of
from trueup.identify.verdict import Evidence, doubt, verdict
from trueup.identify.window_starts import window_starts

TARGET = np.array([0.9, -0.7])


class Replaced(Problem):
    """A problem whose residuals are a function of how far z is from the model's values."""

    def __init__(self, problem, function, *, origin=None):
        super().__init__(problem.nominal, problem.parameters, problem.segments)
        self.inner, self.function = problem, function
        self.origin = problem.parameters.start if origin is None else origin

    def residuals(self, z):
        self.evaluations += len(z)
        return np.array([self.function(row - self.origin) for row in z])

    def with_parameters(self, parameters):
        other = Replaced(self.inner.with_parameters(parameters), self.function, origin=self.origin)
        other.evaluations = self.evaluations
        return other


@pytest.fixture
def small(tmp_path):
    robot, nominal = nominal_of(tmp_path, SERVO)
    segments, _ = make_segments([Truth(robot, nominal, {}).log(1, seconds=3.0)], nominal.simulator, SegmentRule())
    return Problem(nominal, make_parameters({"damping": "all"}, nominal), segments)


def table_of(size, seed=0, noise=0.05):
    rng = np.random.default_rng(seed)
    return rng.standard_normal((size, 2)) / np.sqrt(size), noise * rng.standard_normal(size) / np.sqrt(size)


def linear(size, **options):
    table, noise = table_of(size, **options)
    return lambda y: table @ (y - TARGET) + noise


def stairs(size):
    """No slope anywhere but near the minimum."""
    smooth = linear(size)
    return lambda y: smooth(y if np.abs(y - TARGET).max() < 0.4 else np.round(y / 0.3) * 0.3)


def curved(size):
    smooth = linear(size)
    return lambda y: np.concatenate([smooth(y)[:-1], [2.0 * (y[1] + y[0] ** 2 + 0.7 - 0.81)]])


def unbound(problem):
    """Without priors."""
    return problem.with_parameters(
        ParameterSet(tuple(replace(item, prior_std=None) for item in problem.parameters.parameters))
    )


# Interruptions


class Interrupted(Exception):
    """Ctrl-C, in a form that a test can raise."""


def assert_resumes_everywhere(problem, settings, folder, *, most_again):
    calls = []
    whole = solve(problem(), settings, on_progress=lambda progress: calls.append(progress.phase))
    assert len(calls) > 3
    for stop_at in range(1, len(calls) + 1):
        count = 0

        def interrupt(_progress, stop_at=stop_at):
            nonlocal count
            count += 1
            if count == stop_at:
                raise Interrupted

        checkpoint = folder / f"{stop_at}" / "fit.json"
        checkpoint.parent.mkdir()
        with pytest.raises(Interrupted):
            solve(problem(), settings, checkpoint=checkpoint, on_progress=interrupt)
        resumed = solve(problem(), settings, checkpoint=checkpoint)
        np.testing.assert_array_equal(resumed.z, whole.z)
        np.testing.assert_array_equal(resumed.jacobian, whole.jacobian)
        np.testing.assert_array_equal(resumed.residual, whole.residual)
        spent = ("seconds", "evaluations")
        assert {k: v for k, v in resumed.solver.items() if k not in spent} == {
            k: v for k, v in whole.solver.items() if k not in spent
        }
        assert resumed.solver["evaluations"] <= whole.solver["evaluations"] + most_again
    return calls, whole


def test_auto_resumes_in_every_phase_to_the_same_result(small, tmp_path):
    calls, whole = assert_resumes_everywhere(
        lambda: Replaced(small, stairs(small.size)), SolveSettings(max_evaluations=60), tmp_path, most_again=20
    )
    assert set(calls) == {"gauss-newton", "cma-es", "gauss-newton-again"}
    assert whole.solver["name"] == "cma-es, gauss-newton"


def test_auto_does_not_lose_its_way_when_it_resumes_near_the_end(small, tmp_path):
    settings = SolveSettings(gauss_newton=GaussNewtonSettings(max_step=0.3, tolerance=1e-12, max_iterations=12))
    calls, whole = assert_resumes_everywhere(
        lambda: Replaced(small, curved(small.size)), settings, tmp_path, most_again=5
    )
    assert set(calls) == {"gauss-newton"}
    assert whole.solver["name"] == "gauss-newton"


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_candidate_is_simulated_the_same_alone_and_among_others(tmp_path, jobs):
    """To the last bit, or a search that goes on from its checkpoint would leave its way."""
    robot, nominal = nominal_of(tmp_path, SERVO)
    log = Truth(robot, nominal, {"damping[shoulder]": 0.8}).log(1, seconds=3.0)
    segments, _ = make_segments([log], nominal.simulator, SegmentRule(window_s=0.5))
    weights = Weights(
        {"position": 1.0, "torque": 1.0},
        {},
        torque=dict.fromkeys(robot.joint_names, LoggedTorque(kp=30.0, kv=2.0, noise=0.1)),
    )
    parameters = make_parameters({"kp": "all", "damping": "all"}, nominal)
    problem = Problem(nominal, parameters, segments, weights=weights, jobs=jobs)
    z = parameters.start
    problem.starts = window_starts(problem, z)
    assert problem.starts
    assert all(own.pieces for own in problem.starts.values())
    places = z + np.linspace(-0.05, 0.05, 5)[:, None]
    alone = np.concatenate([problem.residuals(place[None]) for place in places])
    np.testing.assert_array_equal(problem.residuals(places), alone)


@pytest.mark.parametrize("noise", [0.0, 0.003, 0.1, 1e3])
def test_the_moment_of_a_torque_is_known_as_well_as_is_said(tmp_path, noise):
    """The sum of squares is r' C^-1 r, with the covariance C of white noise and of unknown moments."""
    robot, nominal = nominal_of(tmp_path, SERVO)
    log = Truth(robot, nominal, {"damping[shoulder]": 0.8}).log(1, seconds=3.0)
    segments, _ = make_segments([log], nominal.simulator, SegmentRule())
    parameters, (kp, kv) = make_parameters({"kp": "all"}, nominal), (30.0, 2.0)
    plain = Weights({"torque": 1.0}, {})
    known = replace(plain, torque=dict.fromkeys(robot.joint_names, LoggedTorque(kp=kp, kv=kv, noise=noise)))
    problem = Problem(nominal, parameters, segments, weights=plain)
    rows = problem.residuals(parameters.start[None]).reshape(-1, 2)
    compared = Problem(nominal, parameters, segments, weights=known).residuals(parameters.start[None]).reshape(-1, 2)
    (course,), plan, step_s = problem.courses(parameters.start).values(), segments[0].plan, nominal.simulator.timestep_s
    slope = np.concatenate([np.zeros((1, 1, 2)), np.diff(course.velocity, axis=1)], axis=1) / step_s
    sooner, later = (plan.told("position", np.full(2, late)) for late in (-0.002, 0.002))
    changes = kp * (sooner - later) / 0.004, kp * plan.at_stamps(course.velocity), kv * plan.at_stamps(slope)
    certain_s = np.median(np.diff(log.command.time_s)) / 12**0.5, READ_S, READ_S
    for joint in range(2):
        spread = np.eye(len(rows))
        for change, std_s in zip(changes, certain_s if noise else certain_s[:1], strict=False):
            effect = std_s / max(noise, 1e-6) * change[-len(rows) :, joint]
            spread += np.outer(effect, effect)
        expected = rows[:, joint] @ np.linalg.solve(spread, rows[:, joint])
        assert compared[:, joint] @ compared[:, joint] == pytest.approx(expected, rel=1e-5)


@pytest.mark.long
@pytest.mark.parametrize("solver", ["cma-es", "evolution"])
def test_derivative_free_searches_resume_to_the_same_result(small, tmp_path, solver):
    settings = SolveSettings(solver=solver, max_evaluations=40)
    assert_resumes_everywhere(lambda: Replaced(small, linear(small.size)), settings, tmp_path, most_again=5)


def test_several_starts_resume_where_they_were(small, tmp_path):
    settings = SolveSettings(starts=3, gauss_newton=GaussNewtonSettings(max_step=0.5))
    calls, whole = assert_resumes_everywhere(
        lambda: Replaced(small, linear(small.size)), settings, tmp_path, most_again=15
    )
    assert whole.agreement.verdict == "agree"
    assert len(calls) >= 9


# Checkpoints of other problems


def test_a_fingerprint_is_that_of_everything_that_is_simulated(tmp_path):
    robot, path = arm(tmp_path, SERVO)
    nominal = Nominal(robot, path)
    log = Truth(robot, nominal, {}).log(1, seconds=3.0)

    def of(own=log, *, rule=None, model=nominal):
        segments, _ = make_segments([own], model.simulator, rule or SegmentRule())
        problem = Problem(model, make_parameters({"damping": "all"}, model), segments)
        return fingerprint_of(problem, SolveSettings())

    def measured(name, change):
        signals = {**log.measured.signals, name: change(log.measured[name])}
        return replace(log, measured=replace(log.measured, signals=signals))

    doubled = replace(log.command, signals={"position": 2.0 * log.command["position"]})
    late = replace(robot, controller=replace(robot.controller, delay_s=0.05))
    others = {
        "window of 0.5 s": of(rule=SegmentRule(window_s=0.5)),
        "window of 0.2 s": of(rule=SegmentRule(window_s=0.2)),
        "delay": of(model=Nominal(late, path)),
        "command": of(replace(log, command=doubled)),
        "clock": of(replace(log, measured=replace(log.measured, time_s=log.measured.time_s + 0.001))),
        "velocity": of(measured("velocity", lambda v: v + 0.1)),
        "torque": of(measured("torque", lambda t: t + 0.1)),
        "position": of(measured("position", lambda q: q + 0.1)),
        "motion": of(replace(log, meta=replace(log.meta, id="another"))),
    }
    assert of() == of()
    assert len({of(), *others.values()}) == 1 + len(others)


# What CMA-ES is for


def test_auto_looks_everywhere_where_there_is_no_slope(small):
    found = solve(Replaced(small, stairs(small.size)), SolveSettings(max_evaluations=200))
    np.testing.assert_allclose(found.z - small.parameters.start, TARGET, atol=0.05)
    assert "could not reduce the error" in found.solver["remark"]


def test_auto_looks_everywhere_where_a_slope_is_an_artefact_of_a_jump(small):
    smooth = linear(small.size)
    start = smooth(np.zeros(2))
    drawn = np.column_stack([start, np.random.default_rng(4).standard_normal((small.size, 2))])
    jumps = 2.0 * np.linalg.norm(start) * np.linalg.qr(drawn)[0][:, 1:]
    # A hole with walls that point nowhere.
    problem = Replaced(small, lambda y: smooth(y) + jumps @ (np.sign(y) * (np.abs(y).max() < 0.25)))
    found = solve(problem, SolveSettings(max_evaluations=200))
    assert found.solver["name"] == "cma-es, gauss-newton"
    np.testing.assert_allclose(found.z - small.parameters.start, TARGET, atol=0.1)


@pytest.mark.parametrize("loss", ["linear", "soft_l1"])
def test_a_start_at_the_minimum_is_left_alone(small, loss):
    settings = SolveSettings(gauss_newton=GaussNewtonSettings(loss=loss))
    first = solve(Replaced(small, linear(small.size)), settings)
    moved = Replaced(small, linear(small.size)).with_parameters(small.parameters.at(first.values))
    again = solve(moved, settings)
    assert again.solver["name"] == "gauss-newton"
    assert "remark" not in again.solver
    assert again.solver["evaluations"] < 40
    np.testing.assert_allclose(again.z, first.z, atol=1e-3)


def test_a_simulated_fit_that_starts_at_its_minimum_is_left_alone(tmp_path):
    robot, nominal = nominal_of(tmp_path, SERVO)
    truth = Truth(robot, nominal, {"damping[shoulder]": 0.9, "damping[elbow]": 0.5})
    segments, _ = make_segments([truth.log(1, seconds=4.0)], nominal.simulator, SegmentRule())
    problem = Problem(nominal, make_parameters({"damping": "all", "frictionloss": "all"}, nominal), segments)
    first = solve(problem, SolveSettings())
    again = solve(problem.with_parameters(problem.parameters.at(first.values)), SolveSettings())
    assert again.solver["name"] == "gauss-newton"
    assert again.solver["evaluations"] - first.solver["evaluations"] < 60


# The cost of CMA-ES


def test_the_cost_of_a_candidate_does_not_change_when_a_better_one_is_found(small):
    problem = Replaced(small, linear(small.size))
    cost = PenalizedSquares(problem)
    z = problem.parameters.start + np.array([[0.0, 0.0], [0.3, -0.2]])
    before = cost(z, problem.residuals(z)).cost
    best = problem.parameters.start + TARGET[None]
    assert cost(best, problem.residuals(best)).cost[0] < before.min()
    np.testing.assert_array_equal(cost(z, problem.residuals(z)).cost, before)
    np.testing.assert_array_equal(PenalizedSquares(problem, cost.observations)(z, problem.residuals(z)).cost, before)


def test_cma_es_weighs_the_prior_as_gauss_newton_does(small):
    # Twenty observations of one parameter, whose prior knows a fifth as much, and none of the other.
    table = np.zeros((small.size, 2))
    table[:, 0] = 0.01
    noise = 0.5 * np.random.default_rng(2).standard_normal(small.size)
    problem = Replaced(small, lambda y: table @ (y - TARGET) + noise)
    derived = solve(problem, SolveSettings(solver="gauss-newton", gauss_newton=GaussNewtonSettings(tolerance=1e-10)))
    found = solve(problem, SolveSettings(solver="cma-es", max_evaluations=2000))
    best = np.linalg.lstsq(table[:, :1], table @ TARGET - noise, rcond=None)[0][0]
    start = small.parameters.start
    assert abs(derived.z[0] - start[0]) < 0.8 * abs(best), "the prior holds it back"
    assert found.z[0] == pytest.approx(derived.z[0], abs=0.05 * abs(best))
    assert found.z[1] == pytest.approx(start[1], abs=0.02)


@pytest.mark.parametrize("solver", ["gauss-newton", "cma-es", "evolution"])
def test_progress_shows_the_root_mean_square_of_the_residual(small, solver):
    seen = []
    problem = Replaced(small, linear(small.size))
    found = solve(problem, SolveSettings(solver=solver, max_evaluations=60), on_progress=seen.append)
    assert seen[-1].rms == pytest.approx(np.linalg.norm(problem.residuals(found.z[None])[0]), rel=1e-9)
    assert seen[-1].rms == pytest.approx(found.rms)


def test_the_evolution_strategy_knows_the_joint_of_an_encoder_zero(tmp_path):
    robot, nominal = nominal_of(tmp_path, TORQUE)
    log = Truth(robot, nominal, {}).log(1, seconds=3.0)
    segments, _ = make_segments([log], nominal.simulator, SegmentRule())
    problem = Problem(nominal, make_parameters({"encoder_zero": "all", "mass": "all"}, nominal, [log.id]), segments)
    assert roles_of(problem).group.tolist() == [0, 1, 0, 1]


# Several starts


def judged(problem, solution, errors=None, torque=None, ratios=(), suspects=()):
    posterior = posterior_of(problem, solution.z, solution.residual, solution.jacobian)
    items = fitted_parameters(posterior)
    left = {name: replace(item, white=True) for name, item in whiteness_of(problem, solution.residual).items()}
    left |= {f"j{number}": Whiteness(ratio, 0.1, False, "", 1.0) for number, ratio in enumerate(ratios)}
    errors = errors or {
        "nominal": {"val": Estimate(2.0, "rad", 1.9, 2.1)},
        "fitted": {"val": Estimate(1.0, "rad", 0.9, 1.1)},
    }
    signals, size = ({"torque": {"j": torque}}, {"torque": {"j": 1.0}}) if torque else ({}, {})
    evidence = Evidence(
        solution, items, left, errors, signals, size, chosen_by_user=True, torque_seen=True, suspects=suspects
    )
    status, statements = verdict(evidence, ())
    doubtful = ("unexplained", "signal-worse", "no-better", "not-converged")
    assert bool(doubt(evidence)) == (status in doubtful)
    return status, statements


def test_the_test_motions_decide_nothing_about_the_status(small):
    problem = Replaced(small, linear(small.size))
    worse = {"train": Estimate(0.9, "rad"), "test": Estimate(3.0, "rad")}
    errors = {"nominal": {name: Estimate(2.0, "rad") for name in worse}, "fitted": worse}
    status, statements = judged(problem, solve(problem, SolveSettings()), errors)
    assert status == "ok"
    assert any("there are no val motions" in line for line in statements)
    errors["fitted"] = {"train": Estimate(2.5, "rad"), "test": Estimate(1.0, "rad")}
    assert judged(problem, solve(problem, SolveSettings()), errors)[0] == "no-better"


@pytest.mark.parametrize(
    ("ratio", "suspects", "status"),
    [(1.1, None, "unexplained"), (1.1, (), "ok"), (0.9, None, "ok"), (1.5, None, "unexplained")],
)
def test_what_nobody_has_looked_into_is_not_ok(small, ratio, suspects, status):
    problem = Replaced(small, linear(small.size))
    found, statements = judged(problem, solve(problem, SolveSettings()), ratios=(ratio,), suspects=suspects)
    assert found == status
    assert any("no time was left to look for causes" in line for line in statements) == (suspects is None)


@pytest.mark.parametrize(
    ("torque", "status"),
    [((0.5, 0.4), "ok"), ((0.5, 0.54), "ok"), ((0.5, 0.6), "signal-worse"), ((1e-4, 2e-4), "ok"), ((1.2, 2.0), "ok")],
)
def test_a_signal_becomes_worse_only_visibly_and_where_it_was_explained(small, torque, status):
    problem = Replaced(small, linear(small.size))
    found, statements = judged(problem, solve(problem, SolveSettings()), torque=torque)
    assert found == status
    assert any("torque of j (0.5 -> 0.6)" in line for line in statements) == (status != "ok")


@pytest.mark.parametrize(
    ("ratios", "status"), [((1.2, 1.2), "ok"), ((1.3, 1.0, 1.0), "ok"), ((1.3, 1.3), "ok"), ((1.5, 1.0), "unexplained")]
)
def test_one_joint_that_is_not_explained_is_enough(small, ratios, status):
    problem = Replaced(small, linear(small.size))
    found, statements = judged(problem, solve(problem, SolveSettings()), ratios=ratios)
    assert found == status
    assert any("largest at j0" in line for line in statements) == (status != "ok")


def test_starts_that_agree_leave_the_status_alone_and_say_so(small):
    problem = Replaced(small, linear(small.size))
    status, statements = judged(problem, solve(problem, SolveSettings(starts=4)))
    assert status == "ok"
    assert "4 of 4 starts end in the same best place" in statements


def test_starts_that_end_as_good_elsewhere_are_not_identifiable(small):
    table, noise = table_of(small.size)
    problem = Replaced(unbound(small), lambda y: table[:, 0] * (y[0] - 0.5) + noise)
    solution = solve(problem, SolveSettings(solver="gauss-newton", starts=4))
    status, statements = judged(problem, solution)
    assert solution.agreement.verdict == "not-unique"
    assert status == "not-identifiable"
    assert any("damping[elbow] not determined by the data" in line for line in statements)


def test_a_best_place_that_only_one_start_finds_is_not_converged(small):
    table, noise = table_of(small.size)

    def wells(y):
        """A deep well that few starts see, and a shallow one at zero."""
        deep = np.abs(y - [0.45, 0.0]).max() < 0.12
        return table @ (y - [0.45, 0.0] if deep else 0.3 * y) + noise + (0.0 if deep else 0.5 / np.sqrt(small.size))

    problem = Replaced(unbound(small), wells)
    for seed in range(20):
        solution = solve(problem, SolveSettings(solver="gauss-newton", starts=4, seed=seed))
        if solution.agreement.verdict == "local-minima":
            break
    status, statements = judged(problem, solution)
    assert status == "not-converged"
    assert any("end in worse places" in line for line in statements)


def test_starts_that_fail_are_counted(small):
    smooth = linear(small.size)
    problem = Replaced(small, lambda y: np.full(small.size, np.nan) if y[0] < -0.01 else smooth(y))
    solution = solve(problem, SolveSettings(solver="gauss-newton", starts=4))
    assert 0 < solution.agreement.failed < 4
    assert f"{solution.agreement.failed} of 4 failed" in " ".join(judged(problem, solution)[1])
    nothing = Replaced(small, lambda _: np.full(small.size, np.nan))
    with pytest.raises(DataError, match="from any of the starts"):
        solve(nothing, SolveSettings(solver="gauss-newton", starts=3))


def test_a_rescue_is_said(small):
    smooth = linear(small.size)
    problem = Replaced(small, lambda y: np.full(small.size, np.nan) if np.abs(y).max() < 0.05 else smooth(y))
    _, statements = judged(problem, solve(problem, SolveSettings()))
    assert any("diverges at the start" in line for line in statements)


@pytest.mark.long
def test_starts_and_their_agreement_reach_the_result(tmp_path):
    robot, nominal = nominal_of(tmp_path, SERVO)
    truth = Truth(robot, nominal, {"damping[shoulder]": 0.9, "damping[elbow]": 0.5})
    logs = {"train": [truth.log(1, seconds=3.0)], "val": [truth.log(2, seconds=3.0)]}
    config = IdentifyConfig(fit={"damping": "all"}, models={}, solver=SolverChoice(starts=2))
    found = identify(logs, robot, tmp_path / "arm.xml", config=config)
    assert "2 of 2 starts end in the same best place" in found.result.statements
    found.result.save(tmp_path / "fit.json")
    assert FitResult.load(tmp_path / "fit.json").solver["starts"] == "2 of 2 starts end in the same best place"


def test_a_spent_budget_still_gives_the_start(small):
    problem = Replaced(small, stairs(small.size))
    for solver in ("auto", "gauss-newton", "cma-es"):
        found = solve(problem, SolveSettings(solver=solver, max_seconds=1e-9))
        assert found.solver["stop"] == "time"
        assert np.isfinite(found.rms)


def test_a_checkpoint_of_a_search_that_has_found_nothing_is_read_back(tmp_path):
    state = {"rms": np.inf, "history": [[12, -np.inf, 0.5], [24, np.nan, 1.0]], "solver": {"name": "Infinite", "n": 3}}
    Checkpoint(tmp_path / "fit.json", "same").save(state)
    read = Checkpoint(tmp_path / "fit.json", "same").load()
    np.testing.assert_equal(read, state)
    assert Checkpoint(tmp_path / "fit.json", "other").load() == {}


@pytest.mark.parametrize("known", ["right", "turned round", "of fewer samples"])
def test_a_search_that_goes_on_is_led_by_the_derivatives_of_the_one_before(small, known):
    settings, slope = SolveSettings(solver="gauss-newton"), linear(600)
    origin = small.parameters.start
    first = solve(Replaced(small, slope, origin=origin), settings)
    slopes = {"right": first.jacobian, "turned round": -first.jacobian, "of fewer samples": first.jacobian[:, 1:]}
    near = small.with_parameters(small.parameters.at({name: 1.2 * value for name, value in first.values.items()}))
    anew, led = (solve(Replaced(near, slope, origin=origin), settings, slopes=own) for own in (None, slopes[known]))
    np.testing.assert_allclose(led.z, first.z, atol=2e-3)
    assert led.solver["stop"] == "converged"
    fewer = led.solver["evaluations"] < 0.7 * anew.solver["evaluations"]
    assert fewer == (known == "right")


def test_a_whole_motion_begins_in_a_finer_simulation_as_in_that_of_its_derivatives(small):
    """Both take the slopes of the larger time step, and these are simulated once."""
    fine = Problem(small.nominal, small.parameters, small.segments, coarse=small)
    z = small.parameters.start
    found = window_starts(fine, z, whole=True)
    small.starts = window_starts(small, z, whole=True)
    before = small.evaluations
    again = window_starts(fine, z, whole=True)
    assert small.evaluations == before
    for segment in fine.segments:
        for (rows, basis), (other, expected) in zip(again[segment].pieces, found[segment].pieces, strict=True):
            np.testing.assert_array_equal(rows, other)
            np.testing.assert_array_equal(basis, expected)
        assert again[segment].lasting
