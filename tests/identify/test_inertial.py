"""Every body that a fit can reach is possible, and what was asked for is what the model gets."""

import mujoco
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from identify.recovery_cases import ARM
from trueup.identify.inertial import COMPONENTS, Inertial, apply_inertial, inertial_of

numbers = st.floats(-3.0, 3.0)


def random_body(seed):
    rng = np.random.default_rng(seed)
    points, masses = rng.standard_normal((6, 3)) * 0.1, rng.uniform(0.1, 1.0, 6)
    mass = masses.sum()
    com = masses @ points / mass
    offset = points - com
    inertia = sum(m * (r @ r * np.eye(3) - np.outer(r, r)) for m, r in zip(masses, offset, strict=True))
    return Inertial(float(mass), com, inertia), points, masses


def possible(body):
    return np.linalg.eigvalsh(body.pseudo_inertia).min() > 0


@given(st.integers(0, 1000), st.lists(numbers, min_size=6, max_size=6))
def test_every_deformation_is_a_possible_body_of_the_same_mass_and_centre(seed, theta):
    body, _, _ = random_body(seed)
    other = body.deformed(dict(zip(COMPONENTS, theta, strict=True)))
    assert possible(other)
    moments = np.linalg.eigvalsh(other.inertia)
    assert moments[0] + moments[1] >= moments[2] * (1 - 1e-9)
    assert other.mass == body.mass
    np.testing.assert_array_equal(other.com, body.com)


def test_no_deformation_changes_nothing():
    body, _, _ = random_body(3)
    np.testing.assert_allclose(body.deformed({}).inertia, body.inertia, rtol=1e-12)


def test_a_common_stretch_scales_the_second_moment():
    body, _, _ = random_body(4)
    stretched = body.deformed({"d1": 0.2, "d2": 0.2, "d3": 0.2})
    np.testing.assert_allclose(stretched.second_moment, np.exp(0.4) * body.second_moment, rtol=1e-12)


@given(st.integers(0, 1000))
def test_second_moment_and_pseudo_inertia_are_those_of_the_point_masses(seed):
    body, points, masses = random_body(seed)
    centred = points - body.com
    np.testing.assert_allclose(body.second_moment, (masses * centred.T) @ centred, atol=1e-12)
    extended = np.hstack([points, np.ones((6, 1))])
    np.testing.assert_allclose(body.pseudo_inertia, (masses * extended.T) @ extended, atol=1e-12)


def test_a_rod_can_be_deformed():
    rod = Inertial(1.0, np.zeros(3), np.diag([0.0, 0.02, 0.02]))
    assert possible(rod.deformed({"d1": 0.5, "s12": 0.3}))


def test_two_bodies_as_one_have_the_inertia_of_all_their_points():
    one, points, masses = random_body(5)
    two, other_points, other_masses = random_body(6)
    both = one.plus(two)
    all_points, all_masses = np.vstack([points, other_points]), np.concatenate([masses, other_masses])
    com = all_masses @ all_points / all_masses.sum()
    np.testing.assert_allclose(both.com, com)
    centred = all_points - com
    np.testing.assert_allclose(both.second_moment, (all_masses * centred.T) @ centred, atol=1e-12)


def test_another_mass_keeps_the_radii_of_gyration():
    body, _, _ = random_body(7)
    np.testing.assert_allclose(body.with_mass(3.0).inertia / 3.0, body.inertia / body.mass)


@given(st.integers(0, 200), st.lists(numbers, min_size=6, max_size=6))
def test_what_is_written_into_a_model_is_what_it_compiles_to(seed, theta):
    spec = mujoco.MjSpec.from_string(ARM)
    body = random_body(seed)[0].deformed(dict(zip(COMPONENTS, [0.3 * x for x in theta], strict=True)))
    apply_inertial(spec, "lower", body)
    found = inertial_of(spec.compile(), "lower")
    assert found.mass == body.mass
    np.testing.assert_allclose(found.com, body.com)
    np.testing.assert_allclose(found.inertia, body.inertia, rtol=1e-6, atol=1e-9)


@given(st.integers(0, 1000), st.sampled_from([1, 2]))
def test_points_and_rods_are_bodies_for_mujoco_too(seed, points):
    rng = np.random.default_rng(seed)
    places = rng.standard_normal((points, 3)) * 0.1
    body = Inertial.point(0.3, places[0])
    for place in places[1:]:
        body = body.plus(Inertial.point(0.3, place))
    spec = mujoco.MjSpec.from_string(ARM)
    spec.body("lower").add_body(name="tip")
    apply_inertial(spec, "tip", body)
    found = inertial_of(spec.compile(), "tip")
    assert found.mass == body.mass
    np.testing.assert_allclose(found.com, body.com, atol=1e-12)
    np.testing.assert_allclose(found.inertia, body.inertia, atol=1e-12)


def test_a_plate_stays_possible_whatever_its_mass(tmp_path):
    """The largest moment of a plate is the sum of the others, which rounding must not put above it."""
    path = tmp_path / "plate.xml"
    path.write_text(
        '<mujoco><worldbody><body name="plate"><joint name="j"/>'
        '<inertial pos="0 0 0" mass="0.6" diaginertia="0.001 0.005 0.004"/></body></worldbody></mujoco>'
    )
    model = mujoco.MjModel.from_xml_path(str(path))
    own = inertial_of(model, "plate")
    for factor in np.random.default_rng(0).uniform(0.5, 2.0, 200):
        spec = mujoco.MjSpec.from_file(str(path))
        apply_inertial(spec, "plate", own.with_mass(0.6 * factor))
        moments = np.sort(spec.compile().body_inertia[1])
        np.testing.assert_allclose(moments, factor * np.array([0.001, 0.004, 0.005]), rtol=1e-6)
