"""The solver on functions whose minimum is known, and one number that all joints share."""

import numpy as np
import pytest

from identify.recovery_cases import SERVO, Truth, fit, nominal_of
from trueup.errors import ConfigError
from trueup.identify import Problem, SegmentRule, SolveSettings, make_segments, solve
from trueup.identify.config import make_parameters
from trueup.identify.solvers import GaussNewton, GaussNewtonState
from trueup.identify.solvers.gauss_newton import GaussNewtonSettings
from trueup.identify.start import swept_start


class Counted:
    """A batch of residuals, and how many were asked for."""

    def __init__(self, function):
        self.function, self.asked = function, []

    def __call__(self, z):
        self.asked.append(len(z))
        return np.array([self.function(row) for row in z])


def search(function, start, *, logarithmic=None, low=-20.0, high=20.0, **settings):
    size = len(start)
    counted = Counted(function)
    solver = GaussNewton(
        counted,
        np.full(size, low),
        np.full(size, high),
        GaussNewtonState(np.array(start, dtype=float)),
        prior_mean=np.zeros(size),
        prior_std=np.full(size, np.inf),
        prior_weight=lambda _residual: 1.0,
        logarithmic=logarithmic,
        settings=GaussNewtonSettings(**settings),
    )
    while not solver.done:
        solver.step()
    return solver, counted


RNG = np.random.default_rng(3)
TABLE = RNG.standard_normal((40, 3))
NOISE = 0.01 * RNG.standard_normal(40)
VALUES = np.array([2.0, 0.5, 1.3])


def test_a_residual_that_is_linear_in_the_values_takes_one_jacobian_from_four_times_off():
    true = TABLE @ VALUES + NOISE
    best = np.linalg.lstsq(TABLE, true, rcond=None)[0]
    start = np.log(VALUES * [4.0, 0.25, 4.0])
    solver, counted = search(
        lambda z: TABLE @ np.exp(z) - true, start, logarithmic=np.ones(3, dtype=bool), steps=(1e-6,), max_iterations=1
    )
    np.testing.assert_allclose(np.exp(solver.state.z), best, rtol=1e-3)
    assert sum(counted.asked) <= 1 + 3 + 3 * 3
    plain, _ = search(lambda z: TABLE @ np.exp(z) - true, start, steps=(1e-6,), max_iterations=1)
    assert plain.state.cost > 10 * solver.state.cost


def test_a_jacobian_serves_again_only_where_the_cost_falls_as_it_said():
    linear, counted = search(lambda z: TABLE @ z - 1.0, [5.0, -5.0, 5.0], steps=(1e-6,), max_step=2.0, max_iterations=1)
    assert counted.asked == [1, 3, 3, 3, 3]
    np.testing.assert_allclose(linear.state.z, np.linalg.lstsq(TABLE, np.ones(40), rcond=None)[0], atol=1e-3)
    # A full step on arctan leads beyond its zero, to less than half of the decrease that its slope had promised.
    _, counted = search(np.arctan, [1.2], max_step=5.0, max_iterations=1)
    assert counted.asked == [1, 1, 3]


def test_rosenbrock_is_solved_to_its_minimum():
    solver, _ = search(
        lambda z: np.array([10.0 * (z[1] - z[0] ** 2), 1.0 - z[0]]), [-1.2, 1.0], steps=(1e-7,), max_iterations=60
    )
    assert solver.state.reason == "converged"
    np.testing.assert_allclose(solver.state.z, [1.0, 1.0], atol=1e-4)


def test_a_minimum_on_a_bound_and_candidates_that_fail_are_no_obstacle():
    def half(z):
        return np.full(40, np.nan) if z[0] > 3.0 else TABLE @ z - TABLE @ [5.0, 1.0, -2.5]

    solver, _ = search(half, [0.0, 0.0, 0.0], low=-2.0, high=4.0, steps=(1e-6,))
    assert solver.state.z[2] == pytest.approx(-2.0)
    assert 2.0 < solver.state.z[0] <= 3.0
    assert np.isfinite(solver.state.cost)


def test_the_jacobian_of_the_end_is_simulated_again_only_if_the_last_is_from_afar():
    solver, counted = search(lambda z: TABLE @ z - 1.0, [0.5, 0.5, 0.5], steps=(1e-6,))
    before = len(counted.asked)
    jacobian = solver.final_jacobian()
    np.testing.assert_allclose(jacobian, TABLE.T, atol=1e-6)
    assert len(counted.asked) == before
    solver.state.z = solver.state.z + 0.1
    solver.final_jacobian()
    assert len(counted.asked) == before + 1


def test_one_delay_for_all_joints_is_one_parameter(tmp_path):
    robot, nominal = nominal_of(tmp_path, SERVO)
    true = {"delay_s[shoulder]": 0.018, "delay_s[elbow]": 0.018}
    truth = Truth(robot, nominal, true)
    got, solution = fit(truth, [truth.log(1)], {"delay_s": {"shared": True, "start": 0.005}})
    assert list(got) == ["delay_s"]
    low, high = got["delay_s"].interval
    assert low <= 0.018 <= high
    assert high - low < 0.002
    assert solution.values["delay_s"] == pytest.approx(0.018, abs=5e-4)


def test_a_shared_parameter_goes_through_the_coarse_look_and_the_evolution_strategy(tmp_path):
    robot, nominal = nominal_of(tmp_path, SERVO)
    truth = Truth(robot, nominal, {"delay_s[shoulder]": 0.02, "delay_s[elbow]": 0.02})
    segments, _ = make_segments([truth.log(1, seconds=4.0)], nominal.simulator, SegmentRule())
    parameters = make_parameters({"delay_s": {"shared": True}}, nominal)
    swept = swept_start(Problem(nominal, parameters, segments))
    assert swept["delay_s"].value == pytest.approx(0.02)
    problem = Problem(nominal, parameters, segments)
    found = solve(problem, SolveSettings(solver="evolution", max_evaluations=200))
    assert found.values["delay_s"] == pytest.approx(0.02, abs=0.005)


@pytest.mark.parametrize("choice", [{"shared": "yes"}, {"shared": True, "targets": ["elbow"]}])
def test_a_shared_parameter_has_no_targets(choice, tmp_path):
    _, nominal = nominal_of(tmp_path, SERVO)
    with pytest.raises(ConfigError, match="shared"):
        make_parameters({"delay_s": choice}, nominal)
