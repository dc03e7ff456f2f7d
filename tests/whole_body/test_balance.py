"""The regulator and what it is designed on: poles, the linear model against the simulation, rest, the profile."""

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trueup.errors import ConfigError
from trueup.robots import find_model, load_robot
from trueup.robots.model import compile_spec, load_spec
from trueup.whole_body import BalanceSettings, BaseProfile, Lean, SimulatedBody, design_balance, drive
from trueup.whole_body.model import WHEELS, Axle, load_body
from whole_body.whole_body_cases import STANDING, home, reaching


def falling_rate(model):
    """Of a pendulum on a cart, from its mass, the height of that above the axle, and its inertia about it [1/s]."""
    lean = Lean(model)
    data = lean.posed(home(), lean(home()))
    axle, radius, rotor = data.xpos[1], 0.15, model.dof_armature[6]
    wheels = [model.body(name).id for name in WHEELS]
    above = [number for number in range(1, model.nbody) if number not in wheels]
    arms = data.xipos[above] - axle
    mass = model.body_mass[above]
    turns = data.ximat[above].reshape(-1, 3, 3)
    own = (turns[:, 1] ** 2 * model.body_inertia[above]).sum()
    swing = own + (mass * (arms[:, 0] ** 2 + arms[:, 2] ** 2)).sum() + 2 * rotor
    cart = mass.sum() + sum(model.body_mass[wheels] + (model.body_inertia[wheels].max(axis=1) + rotor) / radius**2)
    lever = (mass * arms[:, 2]).sum() - 2 * rotor / radius
    weight = 9.81 * (mass * arms[:, 2]).sum()
    # cart x'' + lever p'' = 0 and lever x'' + swing p'' = weight p
    return np.sqrt(weight * cart / (cart * swing - lever**2))


@pytest.mark.parametrize("payload_kg", [0.0, 3.0])
def test_alone_it_falls_and_with_the_regulator_every_deviation_dies_out(payload_kg):
    body = SimulatedBody(payload_kg)
    balance = design_balance(body.model, body.home)
    assert balance.poles.max() < 1.0
    alone = np.abs(np.linalg.eigvals(balance.advance)).max()
    assert np.log(alone) / balance.settings.step_s == pytest.approx(falling_rate(body.model), rel=0.02)


def test_the_linear_model_says_what_the_simulation_does():
    body = SimulatedBody()
    balance, lean = design_balance(body.model, body.home), Lean(body.model)(body.home)
    torques = np.array([3.0, 1.0])
    # Motors and joints that only turn with the arms are held; what is dry in a wheel is no part of a linear model.
    body.model.dof_frictionloss[:] = 0.0
    body.restart(body.home, lean)
    for _ in range(250):  # arms and floor give way to the weight
        stance = body.reading().stance(balance.axle)
        body.advance(body.home, balance.torque(stance, np.array([0.0, lean, 0.0, 0.0, 0.0, 0.0])), 0.004)
    first = body.reading().stance(balance.axle)
    aim = np.array([0.0, lean, 0.0, 0.0, 0.0, 0.0])
    expected = first - aim
    for _ in range(50):
        expected = balance.advance @ expected + balance.effect @ torques
        body.advance(body.home, torques, 0.004)
    change = body.reading().stance(balance.axle) - first
    np.testing.assert_allclose(change, expected - (first - aim), rtol=0.1, atol=2e-3)


@pytest.mark.parametrize("payload_kg", [0.0, 2.0])
def test_leaning_as_it_says_the_body_neither_falls_forward_nor_backward(payload_kg):
    model, data = SimulatedBody(payload_kg).model, None
    lean = Lean(model)
    for arms in (home(), reaching()[50]):
        pulls = {}
        for off in (-0.01, 0.0, 0.01):
            data = lean.posed(arms, lean(arms) + off)
            pulls[off] = -data.qfrc_bias[4]  # about the axle
        weight = 9.81 * model.body_subtreemass[1]
        assert abs(pulls[0.0]) < 1e-6 * weight
        assert pulls[0.01] > 1e-3 * weight
        assert pulls[-0.01] < -1e-3 * weight


def test_without_motors_and_friction_no_energy_comes_or_goes():
    spec = load_body()
    for joint in spec.joints:
        joint.damping[0], joint.frictionloss = 0.0, 0.0
    spec.option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    spec.option.gravity = [0, 0, -9.81]
    spec.option.timestep = 1e-4
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qvel[:] = np.random.default_rng(0).standard_normal(model.nv)
    mujoco.mj_forward(model, data)
    before = data.energy.sum()
    mujoco.mj_step(model, data, 2000)
    assert data.energy.sum() == pytest.approx(before, abs=1e-6 * abs(before))


def test_the_upper_body_on_the_base_is_the_one_that_stands_alone():
    path = find_model(load_robot("upper_body"))
    alone, whole = compile_spec(load_spec(path), path), load_body().compile()
    for number in range(1, alone.nbody):
        name = alone.body(number).name
        for field in ("mass", "inertia", "ipos", "iquat"):
            np.testing.assert_array_equal(getattr(alone.body(name), field), getattr(whole.body(name), field))
    for number in range(alone.njnt):
        name = alone.joint(number).name
        for field in ("axis", "range", "armature", "damping", "frictionloss"):
            np.testing.assert_array_equal(getattr(alone.joint(name), field), getattr(whole.joint(name), field))
    data = mujoco.MjData(whole)
    mujoco.mj_forward(whole, data)
    assert data.body("torso").xpos == pytest.approx([0.0, 0.0, alone.body("torso").pos[2]])
    assert Axle.of(whole) == Axle(radius_m=0.15, track_m=0.5)


def test_a_push_is_forgotten():
    body = SimulatedBody()
    balance, lean = design_balance(body.model, body.home), Lean(body.model)
    aims = np.full(250, lean(body.home))
    body_aims = aims.copy()
    aims[:50] += 0.05  # leaning forward by three degrees, it has to run after its mass
    done = drive(body, balance, np.tile(body.home, (200, 1)), lean=aims, settings=STANDING)
    assert done.fallen_s is None
    assert np.abs(done.position[:20, 0]).max() > 0.05
    assert np.abs(done.position[-1, 0]) < 0.01
    assert done.tilt[-1] == pytest.approx([body_aims[0], 0.0], abs=2e-3)


def test_it_turns_back_to_its_heading():
    body = SimulatedBody()
    balance, lean = design_balance(body.model, body.home), Lean(body.model)(body.home)
    body.restart(body.home, lean)
    aim = np.array([0.0, lean, 0.3, 0.0, 0.0, 0.0])
    for _ in range(750):
        body.advance(body.home, balance.torque(body.reading().stance(balance.axle), aim), 0.004)
    turned = body.chassis.rotation()
    assert np.arctan2(turned[1, 0], turned[0, 0]) == pytest.approx(0.3, abs=0.02)
    np.testing.assert_allclose(body.chassis.position()[:2], 0.0, atol=0.01)


@given(
    speed=st.floats(0.0, 1.0),
    times=st.tuples(st.floats(0.1, 3.0), st.floats(0.0, 3.0), st.floats(0.1, 3.0), st.floats(0.0, 3.0)),
)
def test_the_way_is_the_sum_of_the_speed_and_leads_back(speed, times):
    profile = BaseProfile(speed, *times)
    clock = np.linspace(-1.0, 4 * profile.round_s, 8001)
    way, rate = profile.way(clock)
    summed = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(clock))])
    np.testing.assert_allclose(way, summed, atol=2e-3)
    assert np.abs(rate).max() <= speed + 1e-12
    assert way[clock < 0] == pytest.approx(0.0)
    there, back = (profile.way(np.array([(turn + 1 - 1e-9) * profile.round_s]))[0][0] for turn in (0, 1))
    assert there == pytest.approx(speed * (0.5 * times[0] + times[1] + 0.5 * times[2]))
    assert back == pytest.approx(0.0, abs=1e-6)


def test_what_cannot_be_balanced_or_followed_is_refused():
    with pytest.raises(ConfigError, match="way_m must be positive"):
        BalanceSettings(way_m=0.0)
    with pytest.raises(ConfigError, match="accelerate_s"):
        BaseProfile(accelerate_s=0.0)
    body = SimulatedBody()
    hung = load_body()
    hung.option.gravity = [0, 0, 9.81]
    with pytest.raises(ConfigError, match="lies too low"):
        design_balance(hung.compile(), body.home)
    with pytest.raises(ConfigError, match="whole number"):
        body.advance(body.home, np.zeros(2), 0.003)
