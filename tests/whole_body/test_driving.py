"""Motions of whole bodies: no gap where nothing differs, falls, compensators, individuals, and what a payload does."""

from dataclasses import replace

import numpy as np
import pytest

from trueup.errors import ConfigError, DataError
from trueup.lab import VirtualRobot, draw_truth
from trueup.whole_body import (
    UNITS,
    BalanceSettings,
    BaseSpec,
    DrivingSettings,
    GravityFeedForward,
    Lean,
    SimulatedBody,
    Trial,
    VirtualBody,
    WholeBody,
    body_gap,
    design_balance,
    draw_base,
    drive,
)
from trueup.whole_body.hardware import _carrier
from trueup.whole_body.model import load_body
from whole_body.whole_body_cases import (
    QUICK,
    STANDING,
    as_simulated,
    home,
    individual,
    lab,
    of_the_model,
    reaching,
)


def test_the_simulated_body_is_no_way_from_itself():
    trial, targets = Trial(1.0), reaching()
    simulated = trial.simulated(targets)
    again = trial.real(SimulatedBody(1.0), targets, simulated)
    for name in ("arms", "position", "rotation", "torque", "lean"):
        np.testing.assert_array_equal(getattr(again, name), getattr(simulated, name))
    gap = body_gap(again, simulated)
    assert set(gap) == set(UNITS)
    # What is called robustness is the noise that is added.
    assert all(value == 0.0 for name, value in gap.items() if "robustness" not in name)


@pytest.mark.long
def test_hardware_without_effects_moves_as_the_simulation_does():
    """Other code computes the joints; what is left is that two integrators take the same steps in another order."""
    body, targets = SimulatedBody(1.0), reaching()
    body.model.dof_frictionloss[8:] = 0.0  # where a joint that sticks comes to rest is chance
    body.model.opt.timestep = 5e-4
    balance = design_balance(body.model, body.home)
    simulated = drive(body, balance, targets, lean=Lean(body.model), settings=QUICK)
    real = drive(of_the_model(as_simulated(5e-4), 1.0), balance, targets, lean=simulated.lean, settings=QUICK)
    gap = body_gap(real, simulated)
    assert gap["drift_end"] < 1e-4
    assert gap["tilt_max"] < 3e-3
    assert gap["arms_max"] < 5e-4
    # It has moved: the arms by half a radian, and the base with them.
    assert np.ptp(simulated.arms[:, 0]) > 0.5
    assert np.ptp(simulated.position[:, 0]) > 0.2


@pytest.mark.long
def test_an_individual_is_somewhere_else_and_seeds_and_units_decide_where():
    trial, targets = Trial(driving=QUICK), reaching(1.0)
    simulated = trial.simulated(targets)
    body = individual(unit=3)
    assert isinstance(body, WholeBody)
    first, again = (trial.real(body, targets, simulated, seed=1) for _ in range(2))
    np.testing.assert_array_equal(first.position, again.position)
    np.testing.assert_array_equal(first.arms, again.arms)
    other = trial.real(body, targets, simulated, seed=2)
    stranger = trial.real(individual(unit=4), targets, simulated, seed=1)
    assert not np.array_equal(first.position, other.position)
    assert np.abs(first.position - stranger.position).max() > np.abs(first.position - other.position).max()
    assert 5e-4 < body_gap(first, simulated)["drift_mean"] < 0.1


@pytest.mark.long
def test_arms_on_the_base_hang_as_they_do_on_a_waist_that_is_held():
    truth = draw_truth(lab().without("readings"), unit=5)
    held = VirtualRobot(truth, payload_kg=2.0, position=home())
    still = held.execute({"position": np.tile(home(), (2000, 1))}, every=100)
    trial = Trial(2.0, driving=STANDING)
    targets = np.tile(home(), (50, 1))
    done = trial.real(of_the_model(truth, 2.0), targets, trial.simulated(targets))
    # It leans by two degrees, which turns gravity against the arms, and its joints stick where they stop.
    np.testing.assert_allclose(done.arms[-1], still.truth["position"][-1], atol=0.03)
    sags = np.abs(still.truth["position"][-1] - home())
    assert sags.max() > 0.04


@pytest.mark.long
def test_a_payload_pulls_the_arms_down_and_the_base_away_and_feed_forward_brings_both_back():
    trial, targets, feed_forward = Trial(3.0, driving=QUICK), reaching(3.0, 1.5), GravityFeedForward()
    simulated = trial.simulated(targets, compensator=feed_forward)
    body = individual(payload_kg=3.0)
    plain = body_gap(trial.real(body, targets, simulated), simulated)
    compensated = body_gap(trial.real(body, targets, simulated, compensator=feed_forward), simulated)
    for name in ("drift_mean", "tilt_rms", "tilt_max", "arms_mae"):
        assert compensated[name] < 0.7 * plain[name], name


def test_feed_forward_holds_simulated_arms_where_they_are_told_to_be():
    trial, feed_forward = Trial(2.0, driving=STANDING), GravityFeedForward()
    targets = np.tile(reaching()[50], (50, 1))
    hanging, held = (trial.simulated(targets, compensator=own).arms[-1] for own in (None, feed_forward))
    gains = np.array([140, 140, 60, 80, 25, 140, 140, 60, 80, 25])
    # Dry friction of 0.3 Nm holds a joint off its target, and the base leans.
    assert (np.abs(held - targets[-1]) < 0.3 / gains + 0.02).all()
    assert np.abs(hanging - targets[-1]).max() > 0.1


def test_feed_forward_of_the_payload_alone_lets_arms_hang_as_with_empty_hands():
    targets, only = np.tile(reaching()[50], (50, 1)), GravityFeedForward(arms=False)
    loaded, plain = (
        Trial(kg, driving=STANDING).simulated(targets, compensator=own).arms[-1]
        for kg, own in ((2.0, only), (2.0, None))
    )
    empty = Trial(0.0, driving=STANDING).simulated(targets, compensator=only).arms[-1]
    assert np.abs(plain - empty).max() > 0.05
    assert np.abs(loaded - empty).max() < 0.02


def test_a_compensator_is_asked_once_per_target_and_its_answer_is_what_is_sent():
    trial, targets, asked = Trial(1.0, driving=STANDING), reaching(1.0), []

    def raised(position, velocity, target, payload_kg):
        asked.append((position, velocity, target, payload_kg))
        return target + 0.1

    simulated = trial.simulated(targets, compensator=raised)
    assert len(asked) == 50 + 50  # settling, motion
    assert {payload for *_, payload in asked} == {1.0}
    np.testing.assert_array_equal([own[2] for own in asked[50:]], targets)
    np.testing.assert_array_equal([own[0] for own in asked[50:]], simulated.arms)
    np.testing.assert_allclose(asked[60][1], (asked[61][0] - asked[59][0]) / 0.04, atol=0.1)
    direct = trial.simulated(targets + 0.1)
    # It starts in the target itself, and is drawn from there.
    np.testing.assert_allclose(simulated.arms[-1], direct.arms[-1], atol=0.03)


@pytest.mark.parametrize("answer", [np.full(10, np.nan), np.zeros(9)])
def test_what_is_no_target_is_not_sent(answer):
    with pytest.raises(DataError, match="one finite target per joint"):
        Trial(driving=STANDING).simulated(reaching(1.0), compensator=lambda *_: answer)


@pytest.mark.long
def test_a_fall_is_seen_and_counts_as_nothing_but_a_fall():
    targets = reaching(4.0)
    simulated = Trial().simulated(targets)
    weak = design_balance(SimulatedBody().model, home(), BalanceSettings(torque_limit_nm=1.0))
    fallen = drive(SimulatedBody(), weak, targets, lean=simulated.lean)
    assert fallen.fallen_s is not None
    assert 0.0 < fallen.fallen_s < 4.0
    assert len(fallen.arms) == len(fallen.position) == round(fallen.fallen_s / 0.02) < len(targets)
    assert np.abs(fallen.tilt[-1]).max() > 0.4
    assert all(np.isnan(value) for value in body_gap(fallen, simulated).values())
    with pytest.raises(DataError, match="the simulated body fell"):
        body_gap(simulated, fallen)
    with pytest.raises(DataError, match="falls on this motion"):
        Trial(balance=BalanceSettings(torque_limit_nm=1.0)).simulated(targets)


def test_who_falls_before_the_motion_begins_has_fallen():
    weak = design_balance(SimulatedBody().model, home(), BalanceSettings(torque_limit_nm=1e-3))
    fallen = drive(
        SimulatedBody(), weak, reaching(1.0), lean=np.full(200, 0.05), settings=DrivingSettings(settle_s=3.0)
    )
    assert fallen.fallen_s < 0.0
    assert fallen.arms.shape == (0, 10)
    assert fallen.tilt.shape == (0, 2)


def test_the_figures_are_those_of_a_body_that_was_moved_by_hand():
    simulated = Trial(driving=STANDING).simulated(reaching(1.0))
    turn = np.radians(2.0)
    leaning = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    moved = replace(
        simulated,
        position=simulated.position + np.array([[7.0, 8.0, 0.5]]) + np.linspace(0, 1, 50)[:, None] * [0.03, 0.04, 0.0],
        rotation=simulated.rotation @ leaning,
        arms=simulated.arms + 0.01,
    )
    gap = body_gap(moved, simulated)
    assert gap["drift_mean"] == pytest.approx(0.025)
    assert gap["drift_end"] == pytest.approx(0.05)
    assert gap["tilt_rms"] == pytest.approx(2.0, rel=1e-3)
    assert gap["tilt_max"] == pytest.approx(2.0, rel=1e-3)
    assert gap["arms_mae"] == pytest.approx(0.01)
    assert gap["base_smoothness"] == pytest.approx(0.0, abs=1e-9)
    headed = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    turned = replace(simulated, position=simulated.position @ headed.T, rotation=headed @ simulated.rotation)
    np.testing.assert_allclose(turned.tilt, simulated.tilt, atol=1e-12)
    np.testing.assert_allclose(turned.way, simulated.way, atol=1e-12)


def test_a_base_is_its_own_and_without_effects_that_of_the_model():
    assert draw_base(unit=2) == draw_base(unit=2)
    assert draw_base(unit=2) != draw_base(unit=3)
    plain, same = load_body().compile(), _carrier(draw_base(BaseSpec.none())).compile()
    np.testing.assert_allclose(same.body_mass, plain.body_mass)
    np.testing.assert_allclose(same.body_inertia, plain.body_inertia, atol=1e-12)
    np.testing.assert_allclose(same.body_ipos, plain.body_ipos, atol=1e-12)
    np.testing.assert_array_equal(same.dof_damping, plain.dof_damping)
    np.testing.assert_array_equal(same.dof_frictionloss, plain.dof_frictionloss)
    other = _carrier(draw_base(unit=2)).compile()
    assert not np.allclose(other.body_mass, plain.body_mass)


def test_what_does_not_fit_is_refused():
    trial, targets = Trial(), reaching(1.0)
    simulated = trial.simulated(targets)
    with pytest.raises(DataError, match="another payload"):
        trial.real(SimulatedBody(1.0), targets, simulated)
    with pytest.raises(DataError, match="of another motion"):
        trial.real(SimulatedBody(), reaching(2.0), simulated)
    with pytest.raises(DataError, match="two motions"):
        body_gap(trial.simulated(reaching(2.0)), simulated)
    with pytest.raises(ConfigError, match="another robot"):
        VirtualBody(draw_truth(), draw_base())
    with pytest.raises(ConfigError, match="unit"):
        draw_base(unit=-1)
    with pytest.raises(ConfigError, match="mass"):
        BaseSpec(mass=-0.1)
    with pytest.raises(ConfigError, match="whole number"):
        Trial(driving=DrivingSettings(settle_s=0.03)).simulated(targets)
