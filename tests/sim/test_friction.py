"""Friction laws: against formulas and integrators of their own, and against what friction must and must not do."""

from dataclasses import astuple, replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mujoco import rollout

from trueup.core.protocols import RolloutRequest
from trueup.errors import ConfigError
from trueup.identify.candidate import Nominal
from trueup.robots import ControllerSpec, JointFriction, JointGains, JointSpec, RobotSpec, SimulationSpec
from trueup.robots.friction import LAWS as TABLE
from trueup.robots.friction import LEAST_WIDTH, MARK, NUMBERS, WIDTH
from trueup.sim import MujocoSimulator, friction_of, install_friction, set_friction
from trueup.sim.friction import has_friction

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
    control = np.asarray(inputs, dtype=float).reshape(1, len(inputs), -1)
    state = np.zeros((1, 1 + model.nq + model.nv + model.na))
    state[0, 1 : 1 + model.nq] = position
    state[0, 1 + model.nq : 1 + model.nq + model.nv] = velocity
    if model.na:
        state[0, 1 + model.nq + model.nv :] = position
    after, _ = rollout.rollout(model, [mujoco.MjData(model)], state, control)
    return after[0, :, 1 : 1 + model.nq].squeeze(), after[0, :, 1 + model.nq : 1 + model.nq + model.nv].squeeze()


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
    np.testing.assert_allclose(np.sign(SPEEDS) * law.brake(SPEEDS), row[3:], atol=5e-9)
    assert law.brake(np.zeros(1))[0] == 0.0


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


def test_friction_is_the_documented_formula():
    rng = np.random.default_rng(1)
    velocity, carried = rng.normal(size=50), 3.0 * rng.normal(size=50)
    for law in LAWS.values():
        found = law.brake(velocity, 0.2, carried)
        np.testing.assert_allclose(found, np.maximum(braking(law, velocity, carried, 0.2), 0.0), atol=1e-12)
    steep = JointFriction(sigmoid_level=1.0, sigmoid_slope=1e3)
    assert steep.brake(np.array([-1e3, 1e3])) == pytest.approx([0.5, 0.5])
    assert (JointFriction(sigmoid_level=-1.0).brake(velocity) == 0.0).all(), "friction does not drive"


@pytest.mark.parametrize("name", [name for name, law in TABLE.items() if law.brake])
def test_the_compiled_formula_of_every_law_is_that_of_numpy(name):
    rng = np.random.default_rng(3)
    numbers = dict(zip((number.name for number in TABLE[name].numbers), rng.uniform(0.3, 0.9, 9), strict=False))
    law = JointFriction(**numbers, asymmetry=0.2)
    model = link(law, gravity=-9.81, frictionloss=0.4)
    data = mujoco.MjData(model)
    for position, velocity in rng.normal(size=(20, 2)):
        data.qpos[:], data.qvel[:] = position, velocity
        mujoco.mj_forward(model, data)
        expected = law.brake(data.qvel, 0.4, data.qfrc_bias, data.qpos)
        np.testing.assert_allclose(data.efc_frictionloss[:1], expected, rtol=1e-13)
    data.qpos[:], data.qvel[:] = 0.3, 0.7
    mujoco.mj_forward(model, data)
    assert abs(data.efc_frictionloss[0] - 1.2 * 0.4) > 1e-3


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        *(({name: np.nan}, f"{name}.*nan.*finite") for name in (number.name for number in NUMBERS)),
        *(
            ({name: -0.1}, f"{name}.*-0.1.*>= 0")
            for name in (number.name for number in NUMBERS if number.domain in ("size", "positive"))
        ),
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
    torque, start, velocity = np.array([-2.0, -1.0]), np.array([0.3, 0.2]), np.array([-1.5, -2.0])
    spec = mujoco.MjSpec.from_string(TWO_LINKS.format(*loss))
    plain = mujoco.MjSpec.from_string(TWO_LINKS.format(0, 0))
    for each in (spec, plain):
        each.option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator}")
    for joint in ("a", "b"):
        set_friction(spec, joint, law)
    install_friction()
    position, speed = move(spec.compile(), np.tile(torque, (300, 1)), start, velocity)

    model = plain.compile()
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = start, velocity
    expected = []
    for _ in range(300):
        data.ctrl[:] = torque
        mujoco.mj_step1(model, data)
        asymmetric = law.asymmetry * model.dof_damping * np.abs(data.qvel)
        data.qfrc_applied[:] = (
            -np.sign(data.qvel) * braking(law, data.qvel, data.qfrc_bias, np.array(loss)) - asymmetric
        )
        mujoco.mj_step2(model, data)
        expected.append((data.qpos.copy(), data.qvel.copy()))
    expected_position, expected_speed = (np.array(column) for column in zip(*expected, strict=True))
    assert (expected_speed < -0.05).all()
    np.testing.assert_allclose(position, expected_position, atol=2e-6)
    np.testing.assert_allclose(speed, expected_speed, atol=2e-5)
    frictionless, _ = move(model, np.tile(torque, (300, 1)), start, velocity)
    assert np.abs(frictionless - expected_position).max() > 0.003


@pytest.mark.parametrize("name", LAWS)
def test_a_link_stops_sticks_and_turns_around_as_integrated_by_hand(name):
    """A weight, a swinging torque, and friction that brakes to a stop within a step but not further."""
    law, loss, damping = LAWS[name], 0.3, 0.05
    time_s = np.arange(4000) * STEP_S
    torque = 1.07 * np.sin(5.3 * time_s) * np.cos(time_s)
    start = -1.4  # nearly hanging

    def by_hand(share=1.0):
        q, v = start, 0.0
        rows = []
        for u in torque:
            weight = WEIGHT * np.cos(q)
            free = u - weight - law.asymmetry * damping * abs(v)
            intended = INERTIA * v / STEP_S + free
            # The load is the weight (one joint has no Coriolis forces). At rest, the side is that of the push.
            most = share * braking(law, v or 1e-12 * np.sign(intended), weight, loss)
            held = np.clip(intended, -most, most)
            v = v + STEP_S * (free - held - damping * v) / (INERTIA + STEP_S * damping)
            q = q + STEP_S * v
            rows.append((q, v))
        return np.array(rows).T

    expected_position, expected_speed = by_hand()
    # No push that is just not enough to break away, or another processor's rounding would decide.
    for share in (0.999, 1.001):
        np.testing.assert_allclose(by_hand(share)[0], expected_position, atol=2e-3)
    assert (np.abs(expected_speed) < 1e-3).mean() > 0.03
    assert np.ptp(np.sign(np.round(expected_speed, 2))) == 2
    model = link(law, gravity=-9.81, damping=damping, frictionloss=loss)
    position, speed = move(model, torque, start)
    np.testing.assert_allclose(position, expected_position, atol=2e-3)
    np.testing.assert_allclose(speed, expected_speed, atol=1e-2)
    without, _ = move(link(gravity=-9.81, damping=damping, frictionloss=loss), torque, start)
    assert np.abs(without - expected_position).max() > 0.02


# ---- sticking


def rest(seconds=1.0):
    return round(seconds / STEP_S)


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize(
    ("law", "held"),
    [
        (JointFriction(stribeck=0.2), 0.7),
        (JointFriction(stribeck=0.2, asymmetry=0.2), {1: 0.84, -1: 0.56}),
        (JointFriction(asymmetry=0.2, load=1e-9), {1: 0.6, -1: 0.4}),
        (JointFriction(tanh_coulomb=0.3), 0.5),  # smooth friction holds nothing
    ],
    ids=["stribeck", "stribeck and asymmetry", "asymmetry", "tanh"],
)
def test_a_joint_sticks_below_its_dry_friction_and_slips_above_it(law, held, sign):
    model = link(law, frictionloss=0.5)
    most = sign * (held[sign] if isinstance(held, dict) else held)
    still, _ = move(model, np.full(rest(), 0.97 * most))
    assert np.abs(still).max() < 1e-4
    moving, _ = move(model, np.full(rest(), 1.03 * most))
    assert sign * moving[-1] > 2e-3


def nominal(tmp_path, robot_friction=None, *, hard=True, frictionloss=0.5):
    path = tmp_path / "link.xml"
    path.write_text(LINK.format(gravity=0, damping=0.1, frictionloss=frictionloss, actuator=MOTOR))
    robot = RobotSpec(
        name="link",
        joints=(JointSpec("a"),),
        model=path.name,
        controller=ControllerSpec(kind="torque"),
        simulation=SimulationSpec(timestep_s=0.002),
        friction={} if robot_friction is None else {"a": robot_friction},
    )
    return Nominal(robot, path, hard_friction=hard)


@pytest.mark.parametrize("sign", [-1, 1])
def test_the_nominal_model_of_a_fit_sticks_and_slips_where_mujoco_creeps(tmp_path, sign):
    def drift(model, torque):
        request = RolloutRequest(np.zeros((1, 1)), np.zeros((1, 1)), {"torque": np.full((1, 1000, 1), sign * torque)})
        return sign * model.simulator.rollout(request).position[0, -1, 0]

    hard, soft = nominal(tmp_path), nominal(tmp_path, hard=False)
    assert drift(hard, 0.48) < 2e-4
    assert drift(hard, 0.52) > 0.05
    assert drift(soft, 0.48) > 0.01  # two seconds of creeping
    law = nominal(tmp_path, JointFriction(stribeck=0.2))
    assert drift(law, 0.68) < 3e-4
    assert drift(law, 0.72) > 0.05


def test_stribeck_needs_more_torque_to_break_away_than_to_go_on():
    model = link(JointFriction(stribeck=0.3, stribeck_velocity=0.05), frictionloss=0.4, damping=0.2)
    ramp = np.linspace(0.0, 1.0, 8000)
    _, speed = move(model, ramp)
    breakaway = ramp[np.argmax(speed > 0.01)]
    assert breakaway == pytest.approx(0.7, rel=0.03)
    _, resting = move(model, np.full(2000, 0.55))
    _, going_on = move(model, np.full(2000, 0.55), velocity=0.5)
    assert np.abs(resting).max() < 1e-3
    assert going_on[-1] == pytest.approx((0.55 - 0.4) / 0.2, rel=0.01)


@pytest.mark.parametrize("position", [0.0, 0.8, -1.2, 2.9])
def test_a_joint_whose_load_dependent_friction_exceeds_the_load_is_not_backdrivable(position):
    idle = np.zeros(2000)
    for load, falls in ((1.02, False), (0.9, True)):
        after, _ = move(link(JointFriction(load=load), gravity=-9.81), idle, position)
        assert bool(abs(after[-1] - position) > 0.01) == falls
    pushed, _ = move(link(JointFriction(load=1.02), gravity=-9.81), np.full(2000, 2.2 * WEIGHT), position)
    assert pushed[-1] - position > 0.01


def test_load_dependent_friction_counts_the_weight_that_something_else_carries():
    """With gravity compensation the transmission still carries the weight: the robot's motors do it."""
    spec = mujoco.MjSpec.from_string(LINK.format(gravity=-9.81, damping=0, frictionloss=0, actuator=MOTOR))
    set_friction(spec, "a", JointFriction(load=0.5))
    for body in spec.bodies:
        body.gravcomp = 1
    install_friction()
    model = spec.compile()
    still, _ = move(model, np.full(rest(), 0.48 * WEIGHT))
    moving, _ = move(model, np.full(rest(), 0.52 * WEIGHT))
    assert abs(still[-1]) < 1e-4
    assert moving[-1] > 0.01


@pytest.mark.parametrize("sign", [-1, 1])
def test_asymmetry_makes_one_direction_slower(sign):
    model = link(JointFriction(asymmetry=0.25), damping=0.4)
    _, speed = move(model, np.full(4000, sign * 0.8))
    assert speed[-1] == pytest.approx(sign * 0.8 / (0.4 * (1 + sign * 0.25)), rel=1e-3)


def test_asymmetric_coulomb_friction_is_a_torque_offset():
    time_s = np.arange(6000) * STEP_S
    torque = 0.9 * np.sin(5.0 * time_s)
    asymmetric, _ = move(link(JointFriction(asymmetry=0.3, load=1e-9), frictionloss=0.4), torque)
    offset, _ = move(link(JointFriction(load=1e-9), frictionloss=0.4), torque - 0.3 * 0.4)
    symmetric, _ = move(link(JointFriction(load=1e-9), frictionloss=0.4), torque)
    np.testing.assert_allclose(asymmetric, offset, atol=2e-3)
    assert np.abs(symmetric - offset).max() > 0.1


# ---- dead band and static threshold

SERVO = '<position name="a" joint="a" kp="40" kv="4"/>'
# Inner length and force of an actuator are those of the joint times and by its gear.
SERVOS = {
    "position": SERVO,
    "geared": '<position name="a" joint="a" kp="10" kv="1" gear="-2"/>',
    "two actuators": '<position name="a" joint="a" kp="40"/><velocity name="b" joint="a" kv="4"/>',
    "clamped command": '<position name="a" joint="a" kp="40" kv="4" ctrlrange="-0.5 0.5"/>',
    "integrated velocity": '<intvelocity name="a" joint="a" kp="40" kv="4" actrange="-3 3"/>',
}


@pytest.mark.parametrize("direction", [-1, 1])
@pytest.mark.parametrize("name", SERVOS)
def test_a_dead_band_leaves_a_standing_error(name, direction):
    """Under a constant load the error is the band and what the gain needs to hold: e = band + torque / kp."""
    band, target = 0.03, 0.5
    model = link(JointFriction(dead_band=band), gravity=-9.81 * direction, actuator=SERVOS[name])
    signal = {"geared": -2 * target, "clamped command": 2.0, "integrated velocity": 0.0}.get(name, target)
    inputs = np.zeros((8000, model.nu))
    inputs[:, 0] = signal
    position, velocity = move(model, inputs, target)
    assert abs(velocity[-1]) < 1e-6
    error = target - position[-1]
    assert error == pytest.approx(direction * band + WEIGHT * direction * np.cos(position[-1]) / 40, abs=1e-6)


def test_within_its_dead_band_a_servo_only_damps():
    model = link(JointFriction(dead_band=0.05), actuator=SERVO)
    position, _ = move(model, np.zeros(500), 0.049)
    np.testing.assert_array_equal(position, 0.049)
    outside, _ = move(model, np.zeros(4000), 0.2)
    assert outside[-1] == pytest.approx(0.05, abs=1e-3)


@pytest.mark.parametrize("limit", ["joint", "actuator"])
def test_a_dead_band_takes_nothing_from_a_saturated_servo(limit):
    saturated = SERVO.replace("/>", ' forcerange="-1 1"/>') if limit == "actuator" else SERVO
    motion = []
    for band in (0.0, 0.01):
        text = LINK.format(gravity=0, damping=0.5, frictionloss=0, actuator=saturated)
        if limit == "joint":
            text = text.replace('name="a" axis', 'name="a" actuatorfrclimited="true" actuatorfrcrange="-1 1" axis')
        spec = mujoco.MjSpec.from_string(text)
        set_friction(spec, "a", JointFriction(dead_band=band))
        install_friction()
        motion.append(move(spec.compile(), np.full(300, 2.0))[0])
    np.testing.assert_array_equal(*motion)


def test_a_disabled_servo_has_no_dead_band():
    model = link(JointFriction(dead_band=0.05), actuator=SERVO)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    position, _ = move(model, np.ones(200), 0.0)
    np.testing.assert_array_equal(position, 0.0)


# ES thesis, table 3.2: torques that break the static friction of joints 1, 5 and 6.
@pytest.mark.parametrize(("positive", "negative"), [(0.65, 0.62), (0.44, 0.67), (0.40, 0.23)])
def test_a_commanded_torque_within_the_static_threshold_moves_nothing(positive, negative):
    model = link(JointFriction(static_positive=positive, static_negative=negative))
    for torque in (0.99 * positive, -0.99 * negative):
        position, _ = move(model, np.full(200, torque))
        np.testing.assert_array_equal(position, 0.0)
    for torque in (1.01 * positive, -1.01 * negative):
        _, speed = move(model, np.full(200, torque))
        assert speed[-1] == pytest.approx(200 * STEP_S * torque / INERTIA, rel=1e-9)
    # It is no friction: above 0.03 rad/s the whole torque acts.
    _, moving = move(model, np.full(200, 0.5 * positive), velocity=0.031)
    assert moving[-1] == pytest.approx(0.031 + 200 * STEP_S * 0.5 * positive / INERTIA, rel=1e-9)


def test_a_static_threshold_is_for_torque_commands_only():
    model = link(JointFriction(static_positive=5.0, static_negative=5.0), actuator=SERVO)
    plain = link(actuator=SERVO)
    np.testing.assert_array_equal(move(model, np.full(300, 0.05))[0], move(plain, np.full(300, 0.05))[0])


# ---- what friction must never do

finite = st.floats(0.0, 1.0)
random_laws = st.builds(
    JointFriction,
    stribeck=finite,
    stribeck_velocity=st.floats(0.001, 1.0),
    load=finite,
    asymmetry=st.floats(-0.9, 0.9),
    tanh_coulomb=finite,
    tanh_velocity=st.floats(1e-5, 1.0),
    sigmoid_level=st.floats(-1.0, 1.0),
    sigmoid_slope=st.floats(0.0, 1e4),
    sigmoid_shift=st.floats(-1.0, 1.0),
)


def chain(law, step_s, links=4, *, weight=0.0):
    """Light links without armature whose joints push each other around."""
    body = (
        '<body pos="0 0 {0}"><joint name="{1}" axis="0 1 0" damping="0.001"/>'
        '<inertial pos="0 0 -0.15" mass="0.3" diaginertia="0.003 0.003 0.0005"/>'
    )
    text = "".join(body.format(-0.3 if index else 0.0, f"j{index}") for index in range(links)) + "</body>" * links
    spec = mujoco.MjSpec.from_string(f"<mujoco><worldbody>{text}</worldbody></mujoco>")
    spec.option.timestep, spec.option.gravity = step_s, [0.0, 0.0, -weight]
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    for joint in spec.joints:
        if law is not None:
            set_friction(spec, joint.name, law)
    install_friction()
    return spec.compile()


def energies(model, position, velocity, seconds):
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = position, velocity
    rows = []
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
        rows.append(data.energy.sum())
    return np.array(rows), data


@given(law=random_laws, seed=st.integers(0, 10_000), step_s=st.sampled_from([0.0005, 0.002]))
def test_friction_never_adds_energy(law, seed, step_s):
    rng = np.random.default_rng(seed)
    start = rng.uniform(-2, 2, 2), rng.uniform(-2, 2, 2)
    for weight in (0.0, 9.81):
        energy, data = energies(chain(law, step_s, links=2, weight=weight), *start, 0.3)
        free, _ = energies(chain(None, step_s, links=2, weight=weight), *start, 0.3)
        # What the integrator alone makes of the energy in one step.
        slack = 1e-4 * max(1.0, np.abs(energy).max()) + np.abs(np.diff(free)).max()
        assert np.diff(energy).max() < slack
        assert energy[-1] - energy[0] < 10 * slack
        assert np.isfinite(data.qpos).all()


@pytest.mark.parametrize("step_s", [0.001, 0.004, 0.01])
@pytest.mark.parametrize(
    "law",
    [
        JointFriction(tanh_coulomb=2.0, tanh_velocity=0.05),
        JointFriction(tanh_coulomb=2.0, tanh_velocity=1e-4),
        JointFriction(sigmoid_level=4.0, sigmoid_slope=1e4),
        JointFriction(tanh_coulomb=50.0, tanh_velocity=1e-3),
        JointFriction(stribeck=5.0, stribeck_velocity=5.0),
    ],
    ids=["tanh", "steep tanh", "steep sigmoid", "huge tanh", "stribeck"],
)
def test_steep_laws_at_coarse_steps_brake_and_do_not_shake(law, step_s):
    """Inertias of 0.01 kg m2 against slopes up to 5e4 Nm s/rad: explicit friction would need steps of 1e-7 s."""
    model = chain(law, step_s)
    energy, data = energies(model, np.zeros(4), np.ones(4), 2.0)
    free, _ = energies(chain(None, step_s), np.zeros(4), np.ones(4), 2.0)
    assert np.diff(energy).max() <= 1e-6
    assert energy[-1] < 1e-3 * energy[0] < 0.1 * free[-1]
    assert np.abs(data.qvel).max() < 0.2


# ---- inside MuJoCo

FULL = replace(LAWS["all"], dead_band=0.002)


def arm(law=FULL, *, threads=1):
    """Two links with position servos, as a simulator."""
    spec = mujoco.MjSpec.from_string(TWO_LINKS.format(0.05, 0.02))
    robot = RobotSpec(
        name="arm",
        joints=(JointSpec("a", torque_limit=4.0), JointSpec("b", torque_limit=2.0)),
        model="arm.xml",
        controller=ControllerSpec(kind="position", kp=20.0, kv=0.6, per_joint={"b": JointGains(kp=8.0)}),
        friction={} if law is None else {"a": law, "b": replace(law, load=0.0)},
    )
    return MujocoSimulator.from_spec(spec, robot, origin=Path("arm.xml"), threads=threads)


def swing(count=1, steps=400, seed=0):
    rng = np.random.default_rng(seed)
    time_s = np.arange(steps)[:, None] * STEP_S
    command = 0.6 * np.sin(rng.uniform(5, 20, (count, 1, 2)) * time_s + rng.uniform(0, 6, (count, 1, 2)))
    return RolloutRequest(rng.normal(size=(count, 2)), rng.normal(size=(count, 2)), {"position": command})


def test_a_model_without_laws_is_the_same_bit_for_bit_with_the_callbacks_installed():
    """Also if its joints carry user data of their own, and contacts and tendons fill the solver's rows."""
    text = """
    <mujoco>
      <size nuser_jnt="14"/>
      <worldbody>
        <geom type="plane" size="1 1 0.1"/>
        <body pos="0 0 0.2"><freejoint/><geom type="box" size="0.1 0.1 0.1" mass="1"/></body>
        <body pos="0 0 1">
          <joint name="a" axis="0 1 0" damping="0.1" frictionloss="0.1" user="1 2 3"/>
          <geom size="0.05" pos="0.4 0 0" mass="1"/>
        </body>
      </worldbody>
      <tendon><fixed name="t" frictionloss="0.05"><joint joint="a" coef="1"/></fixed></tendon>
    </mujoco>
    """
    motions = []
    for installed in (False, True):
        mujoco.set_mjcb_control(None)
        mujoco.set_mjcb_passive(None)
        if installed:
            install_friction()
        motions.append(move(mujoco.MjModel.from_xml_string(text), np.zeros((800, 0)), [0, 0, 0.2, 1, 0, 0, 0, 0.3]))
    np.testing.assert_array_equal(motions[0][0], motions[1][0])
    np.testing.assert_array_equal(motions[0][1], motions[1][1])


def test_a_law_of_zeros_changes_nothing():
    request = swing()
    np.testing.assert_allclose(
        arm(JointFriction()).rollout(request).position, arm(None).rollout(request).position, atol=1e-9
    )


def test_rollouts_batched_steps_and_plain_steps_are_one_motion():
    simulator, request = arm(), swing()
    result = simulator.rollout(request)
    simulator.reset(request.position, request.velocity)
    data = mujoco.MjData(simulator.model)
    data.qpos[:], data.qvel[:] = request.position[0], request.velocity[0]
    for row in range(400):
        command = request.command["position"][:, row]
        state = simulator.step({"position": command})
        data.ctrl[:] = command[0]
        mujoco.mj_step(simulator.model, data)
        np.testing.assert_allclose(state["position"], result.position[:, row + 1], atol=1e-12)
        np.testing.assert_allclose(data.qpos, result.position[0, row + 1], atol=1e-12)
    assert np.abs(arm(None).rollout(request).position - result.position).max() > 0.01


def test_candidates_with_different_laws_in_one_rollout_do_not_see_each_other():
    laws = [None, FULL, LAWS["tanh"], LAWS["stribeck"], FULL, JointFriction(sigmoid_level=2.0), LAWS["load"]]
    simulators = [arm(law) for law in laws]
    one = swing()
    many = RolloutRequest(
        np.repeat(one.position, len(laws), axis=0),
        np.repeat(one.velocity, len(laws), axis=0),
        {"position": np.repeat(one.command["position"], len(laws), axis=0)},
    )
    together = arm(FULL, threads=2).rollout_candidates(many, [simulator.model for simulator in simulators])
    for row, simulator in enumerate(simulators):
        np.testing.assert_allclose(together.position[row], simulator.rollout(one).position[0], atol=1e-10)
    np.testing.assert_array_equal(together.position[1], together.position[4])
    assert np.abs(np.diff(together.position[[0, 2, 3, 5, 6]], axis=0)).max(axis=(1, 2)).min() > 1e-3


def test_a_law_acts_on_its_own_joint_among_others():
    """Joints without friction rows, free joints and tendons of the same numbers lie between and behind."""
    text = """
    <mujoco>
      <worldbody>
        <body pos="1 0 0"><joint name="x" axis="0 0 1"/><geom size="0.1" pos="0.2 0 0" mass="1"/></body>
        <body pos="2 0 0"><joint name="y" axis="0 0 1"/><geom size="0.1" pos="0.2 0 0" mass="1"/></body>
        <body pos="3 0 0"><joint name="z" axis="0 0 1"/><geom size="0.1" pos="0.2 0 0" mass="1"/></body>
        <body pos="4 0 0"><freejoint/><geom size="0.1" mass="1"/></body>
      </worldbody>
      <tendon>
        <fixed name="t0"><joint joint="x" coef="1"/></fixed>
        <fixed name="t1"><joint joint="y" coef="1"/></fixed>
        <fixed name="t2" frictionloss="0.02"><joint joint="z" coef="1"/></fixed>
      </tendon>
    </mujoco>
    """
    spec = mujoco.MjSpec.from_string(text)
    # The laws of x and z need no rows, and the row of tendon 2 is not that of z, whose number is 2 as well.
    set_friction(spec, "x", JointFriction(asymmetry=0.5))
    set_friction(spec, "z", JointFriction(asymmetry=0.4))
    set_friction(spec, "y", JointFriction(tanh_coulomb=0.7, tanh_velocity=1e-3))
    install_friction()
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qvel[:3] = 1.0
    mujoco.mj_forward(model, data)
    assert data.nf == 2
    assert list(data.efc_id[:2]) == [1, 2]
    np.testing.assert_allclose(data.efc_frictionloss[:2], [0.7 + 1e-6, 0.02], rtol=1e-12)


def test_derivatives_of_a_step_are_those_of_the_step():
    """MuJoCo repeats parts of a step for them; a law must not be added twice."""
    model = link(replace(FULL, dead_band=0.0), gravity=-9.81, frictionloss=0.1, damping=0.1)

    def after(position, velocity, torque):
        return np.concatenate(np.atleast_1d(*move(model, [torque], position, velocity)))

    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = 0.4, 0.8
    by_state, by_input = np.zeros((2, 2)), np.zeros((2, 1))
    mujoco.mjd_transitionFD(model, data, 1e-6, True, by_state, by_input, None, None)
    point, nudge = np.array([0.4, 0.8, 0.0]), 1e-6
    for column, found in enumerate((*by_state.T, *by_input.T)):
        step = nudge * np.eye(3)[column]
        np.testing.assert_allclose(found, (after(*(point + step)) - after(*(point - step))) / (2 * nudge), atol=1e-5)


def test_the_forward_dynamics_can_be_repeated():
    model = link(FULL, gravity=-9.81, frictionloss=0.1, damping=0.1, actuator=SERVO)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = 0.4, 0.8
    mujoco.mj_forward(model, data)
    acceleration = data.qacc.copy()
    for stage in (mujoco.mjtStage.mjSTAGE_VEL, mujoco.mjtStage.mjSTAGE_POS, mujoco.mjtStage.mjSTAGE_NONE):
        mujoco.mj_forwardSkip(model, data, stage, 0)
        np.testing.assert_allclose(data.qacc, acceleration, rtol=1e-9)


# ---- in the model file


def test_a_law_is_kept_in_the_model_and_read_back():
    spec = mujoco.MjSpec.from_string(TWO_LINKS.format(0.0, 0.0))
    assert friction_of(spec, "a") == JointFriction()
    set_friction(spec, "a", FULL)
    assert (friction_of(spec, "a"), friction_of(spec, "b")) == (FULL, JointFriction())
    model = spec.compile()
    assert model.jnt_user.shape == (2, WIDTH)
    np.testing.assert_array_equal(model.jnt_user[0], (MARK, *astuple(FULL)))
    np.testing.assert_array_equal(model.jnt_user[1], 0.0)
    set_friction(spec, "a", replace(FULL, load=0.7))
    assert friction_of(spec, "a").load == 0.7
    assert friction_of(spec.copy(), "a").load == 0.7


@pytest.mark.parametrize("digits", ["few", "many"])
def test_a_model_file_with_laws_gives_the_same_motion(tmp_path, digits):
    law = FULL
    if digits == "many":
        rng = np.random.default_rng(5)
        law = JointFriction(*(value * rng.uniform(0.9, 1.1) for value in astuple(FULL)))
    simulator = arm(law)
    path = tmp_path / "arm.xml"
    spec = mujoco.MjSpec.from_string(TWO_LINKS.format(0.05, 0.02))
    for joint, own in (("a", law), ("b", replace(law, load=0.0))):
        set_friction(spec, joint, own)
    spec.compile()
    path.write_text(spec.to_xml())
    model = mujoco.MjModel.from_xml_path(str(path))  # plain MuJoCo
    assert has_friction(model)
    if digits == "few":
        assert friction_of(mujoco.MjSpec.from_file(str(path)), "a") == law
        np.testing.assert_array_equal(model.jnt_user, spec.compile().jnt_user)
    else:
        np.testing.assert_allclose(
            astuple(friction_of(mujoco.MjSpec.from_file(str(path)), "a")), astuple(law), rtol=5e-6
        )
    robot = replace(simulator.robot, friction={})
    again = MujocoSimulator.from_robot(robot, path)
    request = swing(count=3)
    expected = simulator.rollout(request).position
    found = again.rollout(request).position
    np.testing.assert_allclose(found, expected, atol=1e-12 if digits == "few" else 1e-6 * np.ptp(expected))


def test_friction_laws_get_a_solver_that_can_hold_them():
    for law, iterations in ((LAWS["tanh"], 100), (JointFriction(dead_band=0.1), 10)):
        spec = mujoco.MjSpec.from_string(TWO_LINKS.format(0, 0))
        spec.option.iterations, spec.option.ls_iterations = 10, 200
        set_friction(spec, "a", law)
        assert (spec.option.iterations, spec.option.ls_iterations) == (iterations, 200)
        assert (spec.joint("a").frictionloss > 0) == (law.tanh_coulomb > 0)
        assert spec.joint("b").frictionloss == 0


def test_user_data_of_somebody_else_are_not_overwritten():
    text = TWO_LINKS.format(0, 0).replace("<worldbody>", '<size nuser_jnt="2"/><worldbody>')
    spec = mujoco.MjSpec.from_string(text.replace('name="b" axis', 'name="b" user="0 7" axis'))
    with pytest.raises(ConfigError, match="user data that are not friction laws"):
        set_friction(spec, "a", FULL)
    assert list(spec.joint("b").userdata) == [0, 7]
    assert not has_friction(spec.compile())
    assert friction_of(spec, "b") == JointFriction()


def test_a_law_of_another_release_is_refused_and_not_ignored():
    spec = mujoco.MjSpec.from_string(TWO_LINKS.format(0, 0))
    spec.nuser_jnt = 5
    spec.joint("a").userdata = [MARK, 1, 2, 3, 4]
    with pytest.raises(ConfigError, match=r"another release.*got 4 numbers; expected 13 to"):
        has_friction(spec.compile())
    with pytest.raises(ConfigError, match="another release"):
        friction_of(spec, "a")


def test_the_numbers_of_a_model_file_keep_their_places():
    """Files that were written before the last laws came have fewer numbers, and mean what they meant."""
    assert [number.name for number in NUMBERS][: LEAST_WIDTH - 1] == [
        *("stribeck", "stribeck_velocity", "load", "asymmetry", "tanh_coulomb", "tanh_velocity"),
        *("sigmoid_level", "sigmoid_slope", "sigmoid_shift"),
        *("dead_band", "static_positive", "static_negative", "static_velocity"),
    ]
    assert [number.domain for number in NUMBERS if number.domain != "size"][:5] == [
        *("positive", "share", "positive", "signed", "signed"),
    ]
    assert len({number.name for number in NUMBERS}) == len(NUMBERS)


def test_a_joint_that_does_not_exist_is_named():
    spec = mujoco.MjSpec.from_string(TWO_LINKS.format(0, 0))
    for call in (lambda: set_friction(spec, "elbow", FULL), lambda: friction_of(spec, "elbow")):
        with pytest.raises(ConfigError, match=r"no joint 'elbow'.*available: a, b"):
            call()


def test_a_dead_band_in_front_of_a_plugin_is_refused(tmp_path):
    path = tmp_path / "link.xml"
    path.write_text(LINK.format(gravity=0, damping=0, frictionloss=0, actuator=MOTOR))
    robot = RobotSpec(
        name="link",
        joints=(JointSpec("a"),),
        model=path.name,
        controller=ControllerSpec(kind="pid", kp=10.0, ki=1.0),
        friction={"a": JointFriction(dead_band=0.01)},
    )
    with pytest.raises(ConfigError, match=r"joint 'a'.*dead_band.*plugin of 'a\.pid'"):
        MujocoSimulator.from_robot(robot, path)
    dry = replace(robot, friction={"a": JointFriction(stribeck=0.1)})
    assert has_friction(MujocoSimulator.from_robot(dry, path).model)


@pytest.mark.parametrize("name", ["mjcb_control", "mjcb_passive"])
def test_a_callback_of_somebody_else_is_not_replaced(name):
    ready = arm()
    install_friction()  # twice is once
    mujoco.set_mjcb_control(None)
    mujoco.set_mjcb_passive(None)
    calls = []
    getattr(mujoco, f"set_{name}")(lambda *_: calls.append(1))
    with pytest.raises(ConfigError, match=rf"{name}, is installed.*\n.*set_{name}\(None\)"):
        install_friction()
    with pytest.raises(ConfigError, match=name):
        ready.clone()
    mujoco.mj_step(ready.model, mujoco.MjData(ready.model))
    assert calls
