"""Functions of time against independent computations, and the references made of them."""

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from record.scenes import assert_lawful, panda_scene
from trueup.errors import ConfigError, NameMismatch, NoPlan
from trueup.record import MotionSettings, ReferenceSettings, function_reference, random_reference
from trueup.record.functions import (
    Chebyshev,
    Chirp,
    multisine,
    random_chebyshev,
    random_field,
    taper,
)
from trueup.record.profile import Profile, averaged
from trueup.record.references import FUNCTIONS, draw_function

JOINTS = tuple(f"joint{number}" for number in range(1, 8))
TIME = np.linspace(0, 10, 20001)


@pytest.mark.parametrize("kind", FUNCTIONS)
def test_derivatives_are_those_of_the_value(kind):
    value, first, second = draw_function(kind, np.random.default_rng(4), ReferenceSettings())(TIME)
    step = TIME[1]
    for values, slopes in ((value, first), (first, second)):
        numeric = (values[2:] - values[:-2]) / (2 * step)
        np.testing.assert_allclose(numeric, slopes[1:-1], atol=1e-5 * np.abs(slopes).max())


def test_the_taper_is_smooth_and_rests_at_both_ends():
    value, first, second = taper(TIME, 10.0, 1.0)
    np.testing.assert_allclose((value[2:] - value[:-2]) / (2 * TIME[1]), first[1:-1], atol=1e-5)
    np.testing.assert_allclose((first[2:] - first[:-2]) / (2 * TIME[1]), second[1:-1], atol=1e-2)
    assert np.abs([value, first, second])[:, [0, -1]].max() == 0
    assert np.all(value[(TIME >= 1) & (TIME <= 9)] == 1)


def test_a_chirp_has_the_frequencies_that_it_names():
    value, _, _ = Chirp(0.5, 4.0, 10.0)(TIME)
    crossings = TIME[1:][np.diff(np.sign(value)) != 0]
    rates = 0.5 / np.diff(crossings)
    middles = (crossings[1:] + crossings[:-1]) / 2
    np.testing.assert_allclose(rates, 0.5 + 0.35 * middles, rtol=0.01, atol=0.03)


def test_a_multisine_has_equal_harmonics_of_its_base_and_variance_1():
    value, _, _ = multisine(np.random.default_rng(0), base_hz=0.1, highest_hz=1.0)(TIME[:-1])
    spectrum = np.abs(np.fft.rfft(value)) / len(value) * 2
    np.testing.assert_allclose(spectrum[1:11], np.sqrt(2 / 10), rtol=1e-9)
    assert spectrum[11:].max() < 1e-9
    assert np.var(value) == pytest.approx(1.0)


def test_the_random_field_has_its_covariance():
    length, lags = 0.5, np.array([0.0, 0.25, 0.5, 1.0, 2.0])
    fields = [random_field(np.random.default_rng(seed), length_s=length, duration_s=4.0) for seed in range(6000)]
    for origin in (0.0, 1.7):
        draws = np.array([field(origin + lags)[0] for field in fields])
        np.testing.assert_allclose(draws.T @ draws[:, 0] / len(draws), np.exp(-(lags**2) / (2 * length**2)), atol=0.05)
    # And exactly: the covariance of a Fourier sum with independent coefficients is the sum of its variances' cosines.
    period = 4.0 + 8 * length
    omega = fields[0].omega
    variance = np.sqrt(2 * np.pi) * length / period * np.exp(-((omega * length) ** 2) / 2)
    variance[1:] *= 2
    exact = np.cos(np.outer(np.linspace(0, 4, 50), omega)) @ variance
    np.testing.assert_allclose(exact, np.exp(-(np.linspace(0, 4, 50) ** 2) / (2 * length**2)), atol=1e-8)


def test_chebyshev_polynomials_are_cosines_of_multiples():
    for degree in range(1, 7):
        value, _, _ = Chebyshev(np.eye(8)[degree], 10.0)(TIME)
        np.testing.assert_allclose(value, np.cos(degree * np.arccos(TIME / 5 - 1)), atol=1e-9)
    assert random_chebyshev(np.random.default_rng(0), degree=5, duration_s=1.0).coefficients[0] == 0


def test_averages_are_the_convolution_with_a_box():
    rng = np.random.default_rng(0)
    position = np.cumsum(rng.normal(size=(300, 2)), axis=0)
    velocity = np.gradient(position, 1e-3, axis=0)
    steps = 20
    smooth = averaged(Profile(position, velocity, velocity), steps, 1e-3)
    padded = np.pad(position, ((steps, steps), (0, 0)), mode="edge")
    box = np.r_[0.5, np.ones(steps - 1), 0.5] / steps
    for column in range(2):
        np.testing.assert_allclose(
            smooth.position[:, column], np.convolve(padded[:, column], box, mode="valid"), atol=1e-9
        )
    assert len(smooth.position) == 300 + steps
    np.testing.assert_array_equal(smooth.position[[0, -1]], position[[0, -1]])


@settings(max_examples=12, phases=[Phase.explicit, Phase.generate])
@given(
    st.sampled_from(FUNCTIONS),
    st.integers(0, 2**32 - 2),
    st.sets(st.sampled_from(JOINTS), min_size=1),
    st.floats(0.2, 1.0),
)
def test_references_keep_the_limits_and_use_them(kind, seed, joints, share):
    rng = np.random.default_rng(seed)
    reference = ReferenceSettings(duration_s=4.0, lowest_hz=0.25)
    plan = random_reference(panda_scene(), kind, sorted(joints), rng, velocity_share=share, reference=reference)
    assert plan.kind == kind
    assert_lawful(plan, share=share)
    np.testing.assert_array_equal(plan.start, plan.goal)


def test_without_obstacles_a_reference_is_as_large_as_a_limit_allows():
    scene = panda_scene("empty")
    plan = function_reference(scene, {"joint1": Chirp(0.2, 1.0, 10.0)}, scene.home, kind="chirp")
    used = [
        np.ptp(plan.position[:, 0]) / 2 / (0.9 * 2.8973),
        np.abs(plan.velocity[:, 0]).max() / 2.175,
        np.abs(plan.acceleration[:, 0]).max() / 15,
    ]
    assert max(used) == pytest.approx(1.0, abs=1e-6)


def test_bad_references_are_refused():
    scene, rng = panda_scene(), np.random.default_rng(0)
    for wrong in (
        {"duration_s": -1.0},
        {"lowest_hz": -0.1},
        {"highest_hz": 0.0},
        {"lowest_hz": 2.0},
        {"ramp_s": 6.0},
        {"position_share": 1.5},
        {"degree": 0},
    ):
        with pytest.raises(ConfigError):
            ReferenceSettings(**wrong)
    with pytest.raises(ConfigError, match="must be positive"):
        Chirp(-1.0, 1.0, 10.0)
    with pytest.raises(ConfigError, match="needs a harmonic"):
        multisine(rng, base_hz=1.0, highest_hz=0.5)
    with pytest.raises(NameMismatch, match="elbow"):
        random_reference(scene, "chirp", ["elbow"], rng, velocity_share=1.0)
    below = np.array([0.0, 1.7, 0.0, -0.3, 0.0, 1.5, 0.0])
    with pytest.raises(NoPlan, match="in collision"):
        function_reference(scene, {"joint1": Chirp(0.2, 1.0, 10.0)}, below, kind="chirp", settings=MotionSettings())
