"""Friction laws: against formulas and integrators of their own, and against what friction must and must not do."""

from dataclasses import astuple, replace

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trueup.core.protocols import RolloutRequest
from trueup.errors import ConfigError
from trueup.identify.candidate import Nominal
from trueup.robots import ControllerSpec, JointFriction, JointGains, JointSpec, RobotSpec, SimulationSpec
from trueup.sim import MujocoSimulator, friction_of, install_friction, set_friction
from trueup.sim.friction import MARK, NAMES, WIDTH, has_friction

STEP_S = 0.0005
INERTIA = 0.05
WEIGHT = 0.4 * 9.81 * 0.25  # torque of the horizontal link [Nm]
# A link that lies horizontally at 0; a positive angle lifts it.
LINK = """
<mujoco>
  <option timestep="0.0005" integrator="implicitfast" gravity="0 0 {gravity}"/>
  <worldbody><body>
    <joint name="a" axis="0 -1 0" damping="{damping}" frictionloss="{frictionloss}"/>
    <inertial pos="0.25 0 0" mass="0.4" diaginertia="0.001 0.025 0.025"/>
  </body></worldbody>
  <actuator>{actuator}</actuator>
</mujoco>
"""
MOTOR = '<motor name="a" joint="a"/>'
TWO_LINKS = """
<mujoco>
  <option timestep="0.0005"/>
  <worldbody><body>
    <joint name="a" axis="0 1 0" damping="0.02" frictionloss="{0}"/>
    <inertial pos="0 0 -0.2" mass="1" diaginertia="0.01 0.01 0.001"/>
    <body pos="0 0 -0.4">
      <joint name="b" axis="0 1 0" damping="0.01" frictionloss="{1}"/>
      <inertial pos="0 0 -0.15" mass="0.5" diaginertia="0.004 0.004 0.001"/>
    </body>
  </body></worldbody>
  <actuator><motor name="a" joint="a"/><motor name="b" joint="b"/></actuator>
</mujoco>
"""
LAWS = {
    "stribeck": JointFriction(stribeck=0.25, stribeck_velocity=0.15),
    "load": JointFriction(load=0.3),
    "asymmetry": JointFriction(asymmetry=0.4),
    "tanh": JointFriction(tanh_coulomb=0.35, tanh_velocity=0.2),
    "sigmoid": JointFriction(sigmoid_level=0.9, sigmoid_slope=6.0, sigmoid_shift=0.08),
    "all": JointFriction(
        stribeck=0.1,
        stribeck_velocity=0.3,
        load=0.1,
        asymmetry=-0.3,
        tanh_coulomb=0.1,
        tanh_velocity=0.3,
        sigmoid_level=0.3,
        sigmoid_slope=4.0,
        sigmoid_shift=-0.1,
    ),
}
# ES thesis, table 2.3: phi_1, phi_2, phi_3 of joints 1 to 7, and eq. 2.1 worked out with 40 digits at three speeds.
TABLE_2_3 = [
    (0.5462, 5.1181, 0.0395, -0.25335473, 0.06604054, 0.24292931),
    (0.8722, 9.0657, 0.0259, -0.47536599, 0.17400319, 0.38505574),
    (0.6407, 10.1360, -0.0461, -0.24432009, 0.15890712, 0.39382168),
    (1.2794, 5.5903, 0.0362, -0.61515573, 0.16790475, 0.57130223),
    (0.8390, 8.3469, 0.0262, -0.44941238, 0.15686602, 0.37365213),
    (0.3030, 17.1330, -0.0210, -0.12449568, 0.11625889, 0.17846405),
    (0.5649, 10.3360, 0.0036, -0.28438432, 0.13300543, 0.27717802),
]
# Table 3.4, the new values.
TABLE_3_4 = [
    (3.40395, 9.67118, 6.748e-05, -1.67569183, 0.76422680, 1.70120508),
    (1.97802, 28.66575, 0.00012, -0.99070986, 0.88117652, 0.98730896),
    (2.51351, 9.82965, -0.00050, -1.23544844, 0.57295425, 1.25970739),
    (2.43842, 18.77921, 0.00057, -1.22552924, 0.89227318, 1.21268474),
    (2.59531, 4.19342, 0.00541, -1.02261446, 0.26750092, 1.24519659),
    (1.19220, 5.74691, -0.00048, -0.53168347, 0.16678710, 0.59311759),
    (1.54853, 1.69810, 0.00169, -0.31045346, 0.06557335, 0.53415599),
]
SPEEDS = np.array([-0.5, 0.1, 1.0])


@pytest.fixture(autouse=True)
def callbacks_are_put_back():
    before = mujoco.get_mjcb_control(), mujoco.get_mjcb_passive()
    yield
    mujoco.set_mjcb_control(before[0])
    mujoco.set_mjcb_passive(before[1])


def link(law=None, *, gravity=0.0, damping=0.0, frictionloss=0.0, actuator=MOTOR, step_s=STEP_S):
    """One link, compiled, with the law and the callbacks in place."""
    text = LINK.format(gravity=gravity, damping=damping, frictionloss=frictionloss, actuator=actuator)
    spec = mujoco.MjSpec.from_string(text)
    spec.option.timestep = step_s
    if law is not None:
        set_friction(spec, "a", law)
    install_friction()
    return spec.compile()


def move(model, inputs, position=0.0, velocity=0.0):
    """Positions and velocities after each step, under inputs (N,) or (N, U)."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = position, velocity
    rows = []
    for row in np.asarray(inputs, dtype=float).reshape(len(inputs), -1):
        data.ctrl[:] = row
        mujoco.mj_step(model, data)
        rows.append((data.qpos.copy(), data.qvel.copy()))
    return tuple(np.array(column).squeeze() for column in zip(*rows, strict=True))


def braking(law, velocity, carried, frictionloss):
    """Dry and smooth friction [Nm] against the motion, written out from the documentation and nothing else."""

    def logistic(x):
        return 1.0 / (1.0 + np.exp(-x))

    side = np.sign(velocity)
    dry = frictionloss + law.stribeck * np.exp(-((velocity / law.stribeck_velocity) ** 2)) + law.load * np.abs(carried)
    sigmoid = logistic(law.sigmoid_slope * (velocity + law.sigmoid_shift)) - logistic(
        law.sigmoid_slope * law.sigmoid_shift
    )
    smooth = law.tanh_coulomb * np.tanh(np.abs(velocity) / law.tanh_velocity) + law.sigmoid_level * side * sigmoid
    return (1.0 + side * law.asymmetry) * (dry + smooth)


# ---- the formulas


@pytest.mark.parametrize("row", TABLE_2_3 + TABLE_3_4)
def test_the_sigmoid_is_equation_2_1_of_the_thesis(row):
    law = JointFriction(sigmoid_level=row[0], sigmoid_slope=row[1], sigmoid_shift=row[2])
    np.testing.assert_allclose(law.smooth(SPEEDS), row[3:], atol=5e-9)
    assert law.smooth(np.zeros(1))[0] == 0.0


@pytest.mark.parametrize("row", TABLE_2_3 + TABLE_3_4)
def test_a_joint_runs_at_the_speed_at_which_equation_2_1_is_the_torque(row):
    """phi_1 sigma(phi_2 (v + phi_3)) - phi_1 sigma(phi_2 phi_3) = torque, solved for v by hand."""
    level, slope, shift = row[:3]
    rest = 1.0 / (1.0 + np.exp(-slope * shift))
    share = 0.3
    torque = np.array([share * level * (1.0 - rest), -share * level * rest])
    part = torque / level + rest
    speed = np.log(part / (1.0 - part)) / slope - shift
    law = JointFriction(sigmoid_level=level, sigmoid_slope=slope, sigmoid_shift=shift)
    for sign in (0, 1):
        _, velocity = move(link(law), np.full(2000, torque[sign]), velocity=2.0 * speed[sign])
        assert velocity[-1] == pytest.approx(speed[sign], rel=2e-3)


def test_dry_and_smooth_are_the_documented_formulas():
    rng = np.random.default_rng(1)
    velocity, carried = rng.normal(size=50), 3.0 * rng.normal(size=50)
    for law in LAWS.values():
        symmetric = replace(law, asymmetry=0.0)
        found = law.dry(velocity, carried) + np.sign(velocity) * law.smooth(velocity)
        np.testing.assert_allclose(found, braking(symmetric, velocity, carried, 0.0), atol=1e-12)
    assert JointFriction(sigmoid_level=1.0, sigmoid_slope=1e3).smooth(np.array([-1e3, 1e3])) == pytest.approx([-0.5, 0.5])


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        *(({name: np.nan}, f"{name}.*nan.*finite") for name in NAMES),
        *(({name: -0.1}, f"{name}.*-0.1.*>= 0") for name in NAMES if name not in ("asymmetry", "sigmoid_level", "sigmoid_shift")),
        ({"load": np.inf}, "load.*inf"),
        ({"stribeck_velocity": 0.0}, "stribeck_velocity must be positive"),
        ({"tanh_velocity": 0.0}, "tanh_velocity must be positive"),
        ({"asymmetry": 1.0}, "asymmetry must lie between"),
        ({"asymmetry": -1.5}, "asymmetry must lie between"),
    ],
)
def test_a_number_that_makes_no_law_is_named(numbers, message):
    with pytest.raises(ConfigError, match=f"(?s)friction: {message}"):
        JointFriction(**numbers)


# ---- the engine against integrators of our own


@pytest.mark.parametrize("integrator", ["EULER", "IMPLICITFAST"])
@pytest.mark.parametrize("name", LAWS)
def test_two_links_move_as_with_the_formula_applied_by_hand(name, integrator):
    """MuJoCo's stepping in two halves with our own force between them, while both joints keep their direction."""
    law, loss = LAWS[name], (0.1, 0.05)
    torque, start, velocity = np.array([-0.4, -0.2]), np.array([1.2, 0.4]), np.array([-1.0, -1.5])
    spec = mujoco.MjSpec.from_string(TWO_LINKS.format(*loss))
    plain = mujoco.MjSpec.from_string(TWO_LINKS.format(0, 0))
    for each in (spec, plain):
        each.option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator}")
    for joint in ("a", "b"):
        set_friction(spec, joint, law)
    install_friction()
    position, speed = move(spec.compile(), np.tile(torque, (500, 1)), start, velocity)

    model = plain.compile()
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = start, velocity
    expected = []
    for _ in range(500):
        data.ctrl[:] = torque
        mujoco.mj_step1(model, data)
        asymmetric = law.asymmetry * model.dof_damping * np.abs(data.qvel)
        data.qfrc_applied[:] = -np.sign(data.qvel) * braking(law, data.qvel, data.qfrc_bias, np.array(loss)) - asymmetric
        mujoco.mj_step2(model, data)
        expected.append((data.qpos.copy(), data.qvel.copy()))
    expected_position, expected_speed = (np.array(column) for column in zip(*expected, strict=True))
    assert (expected_speed < -0.05).all()
    np.testing.assert_allclose(position, expected_position, atol=2e-6)
    np.testing.assert_allclose(speed, expected_speed, atol=2e-5)
    frictionless, _ = move(model, np.tile(torque, (500, 1)), start, velocity)
    assert np.abs(frictionless - expected_position).max() > 0.03


@pytest.mark.parametrize("name", LAWS)
def test_a_link_stops_sticks_and_turns_around_as_integrated_by_hand(name):
    """A weight, a swinging torque, and friction that brakes to a stop within a step but not further."""
    law, loss, damping = LAWS[name], 0.3, 0.05
    time_s = np.arange(6000) * STEP_S
    torque = WEIGHT + 1.2 * np.sin(2.5 * time_s) * np.cos(0.9 * time_s)
    q, v = 0.3, 0.0
    expected = []
    for u in torque:
        weight = WEIGHT * np.cos(q)
        free = u - weight - law.asymmetry * damping * abs(v)
        # Coriolis forces do not exist with one joint, so the load is the weight.
        most = braking(law, v, weight, loss)
        intended = INERTIA * v / STEP_S + free
        held = np.clip(intended, -most, most)
        v = v + STEP_S * (free - held - damping * v) / (INERTIA + STEP_S * damping)
        q = q + STEP_S * v
        expected.append((q, v))
    expected_position, expected_speed = np.array(expected).T
    assert (np.abs(expected_speed) < 1e-3).mean() > 0.03
    assert np.ptp(np.sign(np.round(expected_speed, 2))) == 2
    model = link(law, gravity=-9.81, damping=damping, frictionloss=loss)
    if name == "asymmetry":
        assert model.opt.iterations == 100
    position, speed = move(model, torque, 0.3)
    np.testing.assert_allclose(position, expected_position, atol=2e-3)
    np.testing.assert_allclose(speed, expected_speed, atol=1e-2)
    without, _ = move(link(gravity=-9.81, damping=damping, frictionloss=loss), torque, 0.3)
    assert np.abs(without - expected_position).max() > 0.02
