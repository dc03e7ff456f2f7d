import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

from trueup.sim.dry_friction import friction_impulse


def problem(seed, count):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(count, count)) * 10 ** rng.uniform(-1, 1, (count, 1))
    mobility = root @ root.T + 1e-3 * np.eye(count)
    most = rng.uniform(0, 1, count) * (rng.uniform(size=count) > 0.2) * 10 ** rng.uniform(-2, 1)
    return mobility, rng.normal(size=count), most


@given(st.integers(0, 100_000), st.integers(1, 8), st.booleans())
def test_a_joint_rests_or_is_braked_with_all_there_is(seed, count, warm):
    mobility, velocity, most = problem(seed, count)
    guess = np.random.default_rng(seed).normal(size=count) if warm else None
    impulse = friction_impulse(mobility, velocity, most, guess)
    after = velocity + mobility @ impulse
    assert (np.abs(impulse) <= most).all()
    scale = (np.abs(velocity) + np.abs(mobility) @ most).max()
    moving = np.abs(after) > 1e-9 * scale
    np.testing.assert_allclose(impulse[moving], -np.sign(after[moving]) * most[moving], atol=1e-12)
    # It takes energy away: half the sum of the velocities before and after, times the impulse, is the work done.
    assert impulse @ (velocity + after) <= 1e-12 * scale


@pytest.mark.parametrize("seed", range(5))
def test_it_is_the_least_of_the_dissipation(seed):
    mobility, velocity, most = problem(seed, 5)
    mobility = mobility / np.abs(mobility).max()
    found = minimize(
        lambda p: p @ (velocity + 0.5 * mobility @ p),
        np.zeros(5),
        jac=lambda p: velocity + mobility @ p,
        bounds=np.stack([-most, most], axis=1),
        method="L-BFGS-B",
        options={"ftol": 1e-16, "gtol": 1e-12, "maxiter": 5000},
    )
    impulse = friction_impulse(mobility, velocity, most)
    assert impulse @ (velocity + 0.5 * mobility @ impulse) <= found.fun + 1e-12


def test_one_joint_by_hand():
    mobility = np.array([[2.0]])
    for velocity, most, expected in (
        (1.0, 0.2, -0.2),
        (-1.0, 0.2, 0.2),
        (1.0, 0.7, -0.5),
        (1.0, 0.0, 0.0),
        (0.0, 1.0, 0.0),
    ):
        assert friction_impulse(mobility, np.array([velocity]), np.array([most])) == pytest.approx(expected)
