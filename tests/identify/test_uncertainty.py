import numpy as np
import pytest
from scipy.signal import lfilter

from identify.recovery_cases import SERVO, Truth, fit, nominal_of
from trueup.core.parameters import Parameter, ParameterSet
from trueup.identify import Problem, SegmentRule, SolveSettings, make_segments, solve
from trueup.identify.config import make_parameters
from trueup.identify.solvers import GaussNewtonSettings, Loss
from trueup.identify.uncertainty import (
    Posterior,
    as_least_squares,
    fitted_parameters,
    memory_of,
    noise_of,
    open_directions,
    posterior_of,
    whiteness_of,
)


@pytest.mark.parametrize("share", [0.0, 0.5, 0.9])
def test_the_memory_of_an_autoregression_is_that_of_the_textbook(share):
    # x_t = a x_{t-1} + e_t has autocorrelations a^k, which sum up to (1 + a) / (1 - a).
    rng = np.random.default_rng(0)
    pieces = [lfilter([1.0], [1.0, -share], rng.standard_normal(20_000)) for _ in range(4)]
    assert memory_of(pieces) == pytest.approx((1 + share) / (1 - share), rel=0.12)


def test_memory_of_little_or_nothing():
    assert memory_of([]) == 1.0
    assert memory_of([np.zeros(10)]) == 1.0
    assert memory_of([np.ones(2)]) == 1.0


@pytest.fixture
def small(tmp_path):
    robot, nominal = nominal_of(tmp_path, SERVO)
    log = Truth(robot, nominal, {}).log(1, seconds=3.0)
    segments, _ = make_segments([log], nominal.simulator, SegmentRule())
    return Problem(nominal, make_parameters({"damping": "all"}, nominal), segments)


def linear_case(problem, rng, *, truth, sigma, jacobian):
    """A fit of a linear model with known noise, as the solver would leave it."""
    z = problem.parameters.start
    residual = jacobian.T @ (
        np.linalg.solve(jacobian @ jacobian.T, jacobian @ (sigma * rng.standard_normal(problem.size)))
    )
    noise = sigma * rng.standard_normal(problem.size)
    step = np.linalg.solve(jacobian @ jacobian.T, jacobian @ noise)
    return z + truth + step, noise - jacobian.T @ step, residual


@pytest.fixture
def flat(small):
    """The same without priors."""
    own = tuple(Parameter(p.name, p.value, p.unit, p.low, p.high, "log") for p in small.parameters)
    return small.with_parameters(ParameterSet(own))


def test_white_noise_gives_the_textbook_covariance(flat):
    rng, sigma = np.random.default_rng(1), 0.01
    jacobian = rng.standard_normal((2, flat.size)) * 0.1
    found = []
    for _ in range(30):
        z, residual, _ = linear_case(flat, rng, truth=np.zeros(2), sigma=sigma, jacobian=jacobian)
        found.append(posterior_of(flat, z, residual, jacobian).covariance)
    textbook = sigma**2 * np.linalg.inv(jacobian @ jacobian.T)
    # Thirty pieces of a motion disagree by chance, too: that may widen intervals by a tenth, and does not narrow them.
    np.testing.assert_allclose(np.mean(found, axis=0), textbook, rtol=0.25, atol=0.1 * textbook[0, 0])
    assert np.diagonal(found, axis1=1, axis2=2).min() > 0.8 * textbook.diagonal().min()


@pytest.mark.parametrize("where", ["everywhere", "where the parameter shows"])
def test_what_a_model_lacks_widens_intervals_though_noise_hides_it(flat, where):
    """A disturbance of half the noise, which lasts, as the input of a loop that was not logged in full does."""
    rng, sigma = np.random.default_rng(3), 0.01
    shape = next(own for _, _, own in flat.by_segment(np.zeros(flat.size))).shape
    every = np.arange(shape[0])
    slow = np.exp(-0.5 * ((every[:, None] - every) / 6.0) ** 2)
    slow /= np.linalg.norm(slow, axis=1)[:, None]
    shown = 0.1 * np.stack([slow @ rng.standard_normal(shape) for _ in range(2)]).reshape(2, -1)
    inverse = np.linalg.inv(shown @ shown.T)
    errors, stds = [], []
    for _ in range(200):
        lasting = (slow @ rng.standard_normal(shape)).ravel()
        if where != "everywhere":
            lasting *= np.abs(shown[0]) / np.sqrt(np.mean(shown[0] ** 2))
        noise = sigma * (rng.standard_normal(flat.size) + 0.5 * lasting)
        step = inverse @ shown @ noise
        errors.append(step)
        stds.append(posterior_of(flat, flat.parameters.start, noise - shown.T @ step, shown).std)
    ratio = np.sqrt(np.mean(np.square(stds), axis=0)) / np.std(errors, axis=0)
    assert ((ratio > 0.75) & (ratio < 1.5)).all(), ratio  # 0.63 without the pieces, where the parameter shows


def test_without_data_the_prior_stands(small):
    residual = np.random.default_rng(2).standard_normal(small.size) * 0.01
    posterior = posterior_of(small, small.parameters.start, residual, np.zeros((2, small.size)))
    _, std = small.parameters.prior
    np.testing.assert_allclose(posterior.std, std, rtol=1e-6)
    items = fitted_parameters(posterior)
    assert [item.identified for item in items] == ["no", "no"]
    assert items[0].prior_share == pytest.approx(1.0)
    assert "not identifiable" in items[0].sentence
    assert "speeds" in items[0].sentence, "it says what to record"
    directions = open_directions(posterior)
    assert len(directions) == 2
    assert directions[0].gain == pytest.approx(0.0)


def test_two_parameters_that_act_alike_are_named_together(small):
    rng = np.random.default_rng(3)
    one = rng.standard_normal(small.size)
    jacobian = np.stack([one, one * (1 + 1e-9)])
    posterior = posterior_of(small, small.parameters.start, 0.01 * rng.standard_normal(small.size), jacobian)
    items = fitted_parameters(posterior)
    assert all(item.identified != "yes" for item in items)
    assert "damping[elbow]" in items[0].sentence
    worst = open_directions(posterior)[0]
    assert worst.gain < 1e-6
    weights = list(worst.weights.values())
    assert np.abs(weights) == pytest.approx([0.707, 0.707], abs=0.01)
    assert weights[0] * weights[1] < 0, "their difference is open, their sum is known"


def test_samples_have_the_covariance_and_stay_inside_the_bounds():
    free = tuple(Parameter(f"damping[{n}]", 1.0, "Nm s/rad", 0.5, 3.0, "log", prior_std=1.0) for n in "ab")
    covariance = np.array([[0.04, 0.03], [0.03, 0.09]])
    posterior = Posterior(ParameterSet(free), np.zeros(2), covariance, np.eye(2))
    drawn = posterior.draw(20_000, np.random.default_rng(0))
    logs = np.log([drawn["damping[a]"], drawn["damping[b]"]])
    inside = np.all((logs > np.log(0.5)) & (logs < np.log(3.0)), axis=0)
    assert np.corrcoef(logs)[0, 1] == pytest.approx(0.5, abs=0.05)
    assert all(values.min() >= 0.5 and values.max() <= 3.0 for values in drawn.values())
    assert inside.mean() > 0.9


def test_noise_and_whiteness_know_a_forgetful_residual_from_a_stubborn_one(small):
    rng = np.random.default_rng(4)
    white = rng.standard_normal(small.size)
    slow = np.repeat(rng.standard_normal((small.size // small.columns.size // 20 + 1, 2)), 20, axis=0)
    slow = slow[: small.size // 2].reshape(-1)[: small.size]
    assert noise_of(small, white).effective == pytest.approx(small.size, rel=0.2)
    assert noise_of(small, slow).effective < small.size / 8
    assert all(item.white for item in whiteness_of(small, white).values())
    stubborn = whiteness_of(small, slow)
    assert not any(item.white for item in stubborn.values())
    assert "model error" in stubborn["elbow"].sentence


def test_the_sentence_of_a_bound_names_it(tmp_path):
    robot, nominal = nominal_of(tmp_path, SERVO)
    truth = Truth(robot, nominal, {"damping[shoulder]": 2.0})
    got, _ = fit(truth, [truth.log(1, seconds=3.0)], {"damping": {"targets": ["shoulder"], "high": 0.9}})
    item = got["damping[shoulder]"]
    assert item.at_bound == "high"
    assert "bound 0.9" in item.sentence


class Linear(Problem):
    """A linear model in place of the simulation."""

    table: np.ndarray
    seen: np.ndarray

    def residuals(self, z):
        return z @ self.table - self.seen


@pytest.mark.long
def test_intervals_of_a_robust_fit_are_those_of_an_m_estimator(small):
    """Huber's variance, against the scatter of 150 fits of data of which 5 % are twenty times as noisy."""
    flat = ParameterSet(tuple(Parameter(p.name, 1.0, "", -50.0, 50.0) for p in small.parameters))
    problem = Linear(small.nominal, flat, small.segments)
    rng = np.random.default_rng(5)
    problem.table = rng.standard_normal((2, problem.size)) / np.sqrt(problem.size)
    settings = SolveSettings(solver="gauss-newton", gauss_newton=GaussNewtonSettings(loss="soft_l1", tolerance=1e-7))
    truth, found, std, hits = np.array([1.5, -0.5]), [], [], []
    for _ in range(150):
        noise = rng.standard_normal(problem.size)
        noise[rng.uniform(size=problem.size) < 0.05] *= 20.0
        problem.seen = truth @ problem.table + 0.05 * noise
        solution = solve(problem, settings)
        posterior = posterior_of(problem, solution.z, solution.residual, solution.jacobian)
        found.append(solution.z)
        std.append(posterior.std)
        hits.append(np.abs(solution.z - truth) < 1.96 * posterior.std)
    scatter = np.std(found, axis=0)
    # 150 draws tell the scatter to 6 %, and pieces of a motion that disagree by chance widen intervals by as much.
    np.testing.assert_allclose(np.mean(std, axis=0), scatter, rtol=0.2)
    assert 0.9 <= np.mean(hits) <= 0.99
    # Least squares would scatter by sqrt(0.95 + 0.05 * 400) as much as without outliers.
    assert np.all(scatter < 0.05 * 1.5)


def test_least_squares_is_its_own_equivalent(small):
    residual = np.random.default_rng(6).standard_normal(small.size)
    counted, factor = as_least_squares(small, residual, Loss())
    np.testing.assert_array_equal(counted, residual)
    np.testing.assert_array_equal(factor, np.ones(small.size))
