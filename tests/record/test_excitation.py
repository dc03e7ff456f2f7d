"""Designed excitations: more information than random ones, within the same limits."""

import numpy as np
import pytest

from record.scenes import assert_lawful, panda_scene
from trueup.errors import ConfigError, NameMismatch, NotIdentifiable
from trueup.record import DesignSettings, design_excitation

SHORT = DesignSettings(duration_s=6.0, harmonics=4, evaluations=120)


def information(position, velocity, acceleration):
    """Inertia, viscous and Coulomb friction, gravity and offset of two joints, each on its own."""
    regressors = [
        np.stack([a, v, np.tanh(v / 0.01), np.sin(q), np.ones_like(q)], axis=1)
        for q, v, a in zip(position.T[:2], velocity.T[:2], acceleration.T[:2], strict=True)
    ]
    return sum(np.kron(np.diag(np.eye(2)[row]), x.T @ x) for row, x in enumerate(regressors))


@pytest.fixture(scope="module")
def design():
    return design_excitation(panda_scene(), information, moving=["joint1", "joint2"], seed=3, design=SHORT)


def test_the_search_adds_information_and_the_plan_has_it(design):
    assert design.log_det > design.random_log_det + 0.5
    assert design.evaluations <= SHORT.evaluations
    plan = design.plan
    rows = slice(*np.searchsorted(plan.time_s, [plan.start_s - 1e-9, plan.end_s + 1e-9]))
    found = information(plan.position[rows][::10], plan.velocity[rows][::10], plan.acceleration[rows][::10])
    assert np.linalg.slogdet(found)[1] == pytest.approx(design.log_det, abs=0.1)


def test_the_design_keeps_every_limit(design):
    assert design.plan.moving == ("joint1", "joint2")
    assert_lawful(design.plan)


def test_the_same_seed_designs_the_same(design):
    again = design_excitation(panda_scene(), information, moving=["joint1", "joint2"], seed=3, design=SHORT)
    np.testing.assert_array_equal(again.plan.position, design.plan.position)


def test_what_no_motion_shows_is_said():
    def singular(position, velocity, acceleration):
        x = np.stack([velocity[:, 0], 2 * velocity[:, 0]], axis=1)
        return x.T @ x

    with pytest.raises(NotIdentifiable, match="no motion that was tried"):
        design_excitation(panda_scene(), singular, moving=["joint1"], design=SHORT)


def ragged(position, velocity, acceleration):
    return position[:2, :3]


def test_bad_designs_are_refused():
    scene = panda_scene()
    with pytest.raises(NameMismatch, match="elbow"):
        design_excitation(scene, information, moving=["elbow"])
    with pytest.raises(ConfigError, match="no square matrix"):
        design_excitation(scene, ragged, moving=["joint1"], design=SHORT)
    with pytest.raises(ConfigError):
        DesignSettings(evaluations=0)
