"""Each effect of the virtual robot against an independent computation, alone in an otherwise perfect robot."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from trueup.errors import ConfigError
from trueup.lab import LabSpec, VirtualRobot, draw_truth
from trueup.lab.plant import friction_level
from trueup.lab.spec import Controller, Elasticity, Friction, Gravity, Readings, Ripple, Saturation, Warming
from trueup.lab.truth import body_of, loaded, tensor, with_ball
from trueup.robots import JointFriction, find_model, load_robot

HOME = np.array([0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4])
# Far from all limits, so that the arm may fall for a while.
RAISED = np.array([0.3, 0.3, -0.4, -1.0, 0.5, 1.5, 0.2])
TICK = 0.001
TORQUE = Controller(kind="torque")


def lab(*effects, torque=False, **sizes):
    """A perfect robot but for these effects."""
    spec = replace(LabSpec().only(*effects), **sizes)
    return replace(spec, controller=TORQUE) if torque else spec


def frictionless_motors(**numbers):
    return Friction(spread=0.0, motor=(0.0,), **numbers)


def model_of_panda(armature=True):
    model = mujoco.MjModel.from_xml_path(str(find_model(load_robot("panda"))))
    model.dof_damping[:] = 0.0
    if not armature:
        model.dof_armature[:] = 0.0
    return model


def weight(position, payload_kg=0.0):
    """Joint torques that carry the arm, by virtual work: the derivative of the potential energy."""
    model = model_of_panda()
    data = mujoco.MjData(model)

    def energy(pose):
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        site = data.site("payload")
        ball = site.xpos + 0.05 * site.xmat.reshape(3, 3)[:, 2]
        return 9.81 * (model.body_mass @ data.xipos[:, 2] + payload_kg * ball[2])

    steps = 1e-6 * np.eye(7)
    return np.array([(energy(position + step) - energy(position - step)) / 2e-6 for step in steps])


def within_limits(position):
    limits = np.array([joint.position_limits for joint in load_robot("panda").joints])
    return bool(((position > limits[:, 0]) & (position < limits[:, 1])).all())


def energy_of(truth_series, model, stiffness=None, motor_inertia=None):
    """Kinetic and potential energy of links, springs and motors at each sample [J]."""
    data = mujoco.MjData(model)
    total = []
    for q, v, theta, omega in zip(
        truth_series["position"],
        truth_series["velocity"],
        truth_series["motor_position"],
        np.gradient(truth_series["motor_position"], TICK, axis=0),
        strict=True,
    ):
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(model, data)
        full = np.empty((7, 7))
        for column in range(7):
            own = np.zeros(7)
            mujoco.mj_mulM(model, data, own, np.eye(7)[column])
            full[:, column] = own
        joules = 0.5 * v @ full @ v + 9.81 * model.body_mass @ data.xipos[:, 2]
        if stiffness is not None:
            joules += 0.5 * stiffness @ (theta - q) ** 2 + 0.5 * motor_inertia @ omega**2
        total.append(joules)
    return np.array(total)


@pytest.mark.long
def test_with_all_effects_off_it_is_the_model():
    spec = lab(torque=True)
    rng = np.random.default_rng(0)
    torque = np.repeat(rng.uniform(-3.0, 3.0, (20, 7)), 25, axis=0)
    seen = VirtualRobot(draw_truth(spec), position=HOME).execute({"torque": torque}).truth
    model = model_of_panda()
    model.opt.timestep, model.opt.integrator = spec.physics_step_s, mujoco.mjtIntegrator.mjINT_EULER
    data = mujoco.MjData(model)
    data.qpos[:] = before = HOME
    for row in torque:
        carried = weight(before)  # known to the robot as of the start of its last physics step
        for _ in range(2):
            before = data.qpos.copy()
            data.qfrc_applied[:] = row + carried
            mujoco.mj_step(model, data)
    np.testing.assert_allclose(seen["position"][-1], data.qpos, atol=1e-6)
    np.testing.assert_allclose(seen["velocity"][-1], data.qvel, atol=1e-5)


@pytest.mark.parametrize("elastic", [False, True])
def test_energy_is_conserved_without_losses(elastic):
    stiffness = Elasticity(damping=(0.0,), spread=0.0)
    # A compensation that is wrong by the whole weight: nothing but gravity acts on the arm.
    spec = lab(*(["elasticity"] if elastic else []), torque=True, elasticity=replace(stiffness, enabled=elastic))
    truth = draw_truth(spec)
    truth = replace(truth, joints={name: replace(joint, gravity_error=-1.0) for name, joint in truth.joints.items()})

    def drift(step):
        fine = replace(truth, spec=replace(spec, physics_step_s=step))
        series = VirtualRobot(fine, position=RAISED).execute({"torque": np.zeros((250, 7))}).truth
        assert within_limits(series["position"])
        numbers = (np.array(spec.elasticity.stiffness), np.full(7, 0.1)) if elastic else (None, None)
        joules = energy_of(series, model_of_panda(armature=not elastic), *numbers)[2:-2]
        moved = np.abs(series["velocity"]).max()
        assert moved > 1.0
        return np.abs(joules - joules[0]).max()

    coarse, fine = drift(0.0005), drift(0.000125)
    assert coarse < 0.1  # of about 20 J that are exchanged
    assert fine < 0.4 * coarse  # first order: a quarter, as the integrator promises


def test_a_perfect_compensation_holds_any_pose_with_any_payload():
    for payload_kg in (0.0, 1.5, 3.0):
        robot = VirtualRobot(draw_truth(lab(torque=True)), position=HOME, payload_kg=payload_kg)
        np.testing.assert_allclose(robot.read()["torque"], weight(HOME, payload_kg), atol=1e-5)
        robot.wait_until_s(1.0)
        np.testing.assert_allclose(robot.read()["position"], HOME, atol=1e-6)


def test_what_the_compensation_gets_wrong():
    spec = lab("gravity", torque=True, gravity=Gravity(error=0.02, spread_nm=0.0, payload_known=0.4))
    truth = draw_truth(spec)
    robot = VirtualRobot(truth, position=HOME, payload_kg=2.0)
    drive = robot.execute({"torque": np.zeros((1, 7))}).truth["motor_torque"][0]
    joints = list(truth.joints.values())
    error, offset = (np.array([getattr(j, name) for j in joints]) for name in ("gravity_error", "gravity_offset_nm"))
    np.testing.assert_allclose(offset, spec.gravity.offset_nm)
    np.testing.assert_allclose(drive, (1 + error) * weight(HOME, 0.8) + offset, atol=1e-5)
    robot.wait_until_s(0.3)
    assert robot.read()["position"][1] > HOME[1] + 0.01  # it sinks, as the thesis's arm did (3.1)


def test_inertias_differ_by_their_sizes_and_stay_possible():
    model = model_of_panda()
    masses, shifts = [], []
    for unit in range(20):
        truth = draw_truth(LabSpec(), unit=unit)
        for name, body in truth.bodies.items():
            nominal = body_of(model, name)
            masses.append(np.log(body.mass / nominal.mass))
            shifts.append(np.array(body.com) - nominal.com)
            first, second, third = np.linalg.eigvalsh(tensor(body))
            assert first > 0
            assert first + second >= third * (1 - 1e-9)
    assert np.std(masses) == pytest.approx(LabSpec().inertia.mass, rel=0.15)
    assert np.std(shifts) == pytest.approx(LabSpec().inertia.com_m, rel=0.1)


def test_a_payload_adds_up_as_mujoco_adds_bodies():
    place, mass, radius = np.array([0.02, -0.01, 0.15]), 2.5, 0.04
    spec = mujoco.MjSpec.from_file(str(find_model(load_robot("panda"))))
    ball = spec.body("link7").add_body(name="ball", pos=place, ipos=np.zeros(3), mass=mass, explicitinertial=True)
    ball.inertia = np.full(3, 0.4 * mass * radius**2)
    fused = with_ball(body_of(model_of_panda(), "link7"), mass, place, radius)
    model, plain = spec.compile(), model_of_panda()
    own = plain.body("link7").id
    plain.body_mass[own], plain.body_ipos[own] = fused.mass, fused.com
    values, axes = np.linalg.eigh(tensor(fused))
    axes[:, 2] *= np.linalg.det(axes)
    plain.body_inertia[own] = values
    mujoco.mju_mat2Quat(plain.body_iquat[own], axes.ravel())
    mujoco.mj_setConst(plain, mujoco.MjData(plain))
    forces = []
    for one in (model, plain):
        data = mujoco.MjData(one)
        data.qpos[:], data.qvel[:], data.qacc[:] = HOME, np.linspace(-1, 1, 7), np.linspace(2, -1, 7)
        mujoco.mj_inverse(one, data)
        forces.append(data.qfrc_inverse.copy())
    damped = model.dof_damping * np.linspace(-1, 1, 7)
    np.testing.assert_allclose(forces[1], forces[0] - damped, atol=1e-9)


@pytest.mark.parametrize("joint", range(7))
@pytest.mark.parametrize("elastic", [False, True])
def test_a_joint_breaks_away_where_table_3_2_says(joint, elastic):
    effects = ("friction", "elasticity") if elastic else ("friction",)
    spec = lab(*effects, torque=True, friction=frictionless_motors(load=0.0))
    for sign, table in ((1, spec.friction.breakaway_positive), (-1, spec.friction.breakaway_negative)):
        robot = VirtualRobot(draw_truth(spec), position=HOME)
        ramp = np.zeros((4000, 7))
        ramp[:, joint] = sign * np.linspace(0.0, 1.2 * table[joint], 4000)
        seen = robot.execute({"torque": ramp}).truth
        moved = np.abs(seen["position"][:, joint] - HOME[joint])
        mean = 0.5 * (spec.friction.breakaway_positive[joint] + spec.friction.breakaway_negative[joint])
        # It sticks like a spring until it breaks away.
        far = spec.friction.presliding_rad * table[joint] / mean
        assert moved[1667] == pytest.approx(0.5 * far, rel=0.1)
        broken = ramp[np.argmax(moved > 1.1 * far), joint]
        assert abs(broken) == pytest.approx(table[joint], rel=0.05)


def test_a_sticking_joint_does_not_creep():
    spec = lab("friction", torque=True, friction=frictionless_motors(load=0.0))
    push = np.tile(0.6 * np.array(spec.friction.breakaway_positive), (4000, 1))
    seen = VirtualRobot(draw_truth(spec), position=HOME).execute({"torque": push}).truth["position"]
    np.testing.assert_allclose(seen[-1], seen[2000], atol=1e-6)


@pytest.mark.parametrize("speed", [-2.0, -0.3, -0.02, 0.02, 0.3, 2.0])
def test_a_joint_that_slides_is_braked_by_the_law(speed):
    # Joint 1 stands upright: neither weight nor, at constant speed, inertia load it.
    spec = lab("friction", "elasticity", friction=frictionless_motors())
    truth = draw_truth(spec)
    count = 1500
    position = np.tile(HOME, (count, 1))
    velocity = np.zeros((count, 7))
    start = -0.5 * speed * count * TICK
    blend = np.clip(np.arange(count) / 300, 0, 1)
    velocity[:, 0] = speed * (3 * blend**2 - 2 * blend**3)
    position[:, 0] = start + np.cumsum(velocity[:, 0]) * TICK
    robot = VirtualRobot(truth, position=position[0])
    seen = robot.execute({"position": position, "velocity": velocity}).truth
    torque = seen["torque"][-400:, 0].mean()
    v = seen["velocity"][-400:, 0].mean()
    own = spec.friction
    static, a = 0.5 * (0.65 + 0.62), (0.65 - 0.62) / (0.65 + 0.62)
    law = JointFriction(
        stribeck=(1 - own.sliding) * static,
        stribeck_velocity=own.stribeck_velocity,
        load=own.load,
        sigmoid_level=own.sigmoid_level[0],
        sigmoid_slope=own.sigmoid_slope[0],
        sigmoid_shift=own.sigmoid_shift[0],
    )
    size = own.viscous[0] * abs(v) + law.brake(np.array(v), own.sliding * static, torque)
    assert v == pytest.approx(speed, rel=0.02)
    assert torque == pytest.approx(np.sign(v) * (1 + a * np.sign(v)) * size, rel=0.03)


def test_the_sigmoid_is_equation_2_1():
    level, slope, shift = 0.8722, 9.0657, 0.0259
    for v in (-1.3, -0.05, 0.0, 0.04, 2.0):
        expected = level / (1 + np.exp(-slope * (v + shift))) - level / (1 + np.exp(-slope * shift))
        assert friction_level(0.0, 0.0, 0.0, 0.1, 0.0, 0.0, level, slope, shift, v, 0.0, 1.0) == pytest.approx(
            abs(expected)
        )


def test_springs_twist_by_what_they_carry_and_swing_at_their_frequency():
    spec = lab("elasticity", elasticity=Elasticity(spread=0.0, damping=(0.0,)))
    robot = VirtualRobot(draw_truth(spec), position=HOME, payload_kg=3.0)
    now = robot.execute({"position": HOME[None]}).truth
    twist = now["motor_position"][0] - now["position"][0]
    np.testing.assert_allclose(np.array(spec.elasticity.stiffness) * twist, weight(HOME, 3.0), atol=1e-4)
    # With the brakes closed the links swing on their springs: the slowest mode of K x = w^2 M x.
    robot.execute({"position": HOME + np.linspace(0, 1, 60)[:, None] * np.array([0.05, 0, 0, 0, 0, 0, 0])})
    robot.stop()
    robot.wait_until_s(robot.now_s() + 0.05)
    velocity = []
    for _ in range(1500):
        robot.wait_until_s(robot.now_s() + TICK)
        velocity.append(robot.read()["velocity"][0])
    model = model_of_panda(armature=False)
    data = mujoco.MjData(model)
    data.qpos[:] = robot.read()["position"]
    fused = with_ball(body_of(model, "link7"), 3.0, np.array([0.0, 0.0, 0.157]), 0.04)
    own = model.body("link7").id
    model.body_mass[own], model.body_ipos[own] = fused.mass, fused.com
    values, axes = np.linalg.eigh(tensor(fused))
    axes[:, 2] *= np.linalg.det(axes)
    model.body_inertia[own] = values
    mujoco.mju_mat2Quat(model.body_iquat[own], axes.ravel())
    mujoco.mj_forward(model, data)
    mobility = np.empty((7, 7))
    mujoco.mj_solveM(model, data, mobility, np.eye(7))
    modes_hz = np.sort(np.sqrt(np.linalg.eigvals(mobility * np.array(spec.elasticity.stiffness)).real)) / (2 * np.pi)
    spectrum = np.abs(np.fft.rfft(np.array(velocity) * np.hanning(1500), 16384))
    peak_hz = np.fft.rfftfreq(16384, TICK)[np.argmax(spectrum)]
    assert np.abs(modes_hz - peak_hz).min() < 0.03 * peak_hz


def test_ripple_has_its_period_in_the_motor_angle_and_its_amplitude():
    spec = lab("ripple", ripple=Ripple(amplitude_nm=(0.4,), spread=0.0, periods_per_turn=40.0))
    truth = draw_truth(spec)
    count = 4000
    position = np.tile(HOME, (count, 1))
    position[:, 0] = np.linspace(-0.8, 0.8, count)
    velocity = np.zeros_like(position)
    velocity[:, 0] = 1.6 / (count * TICK)
    robot = VirtualRobot(truth, position=position[0])
    seen = robot.execute({"position": position, "velocity": velocity}).truth
    own = truth.joints["joint1"]
    angle = 40 * seen["motor_position"][:, 0]
    added = own.ripple_nm * (np.sin(angle + own.ripple_phase) + 0.5 * np.sin(2 * angle + own.ripple_phase_second))
    # Rigid joint: sensor = motor + ripple - motor inertia * acceleration.
    motor = seen["motor_torque"][:, 0] - 0.1 * np.gradient(seen["velocity"][:, 0], TICK)
    residual = (seen["torque"][:, 0] - motor)[500:-5]
    assert own.ripple_nm == 0.4
    design = np.c_[added[500:-5], np.ones_like(residual)]
    share = np.linalg.lstsq(design, residual, rcond=None)[0][0]
    assert share == pytest.approx(1.0, abs=0.05)
    assert np.std(residual - design[:, 0]) < 0.1 * np.std(residual)


def test_motors_saturate():
    limits = Saturation(torque_nm=(20.0,) * 4 + (5.0,) * 3, no_load_speed=(3.0,))
    target = np.tile(HOME + 1.0, (400, 1))
    seen = (
        VirtualRobot(draw_truth(lab("saturation", saturation=limits)), position=HOME)
        .execute({"position": target})
        .truth
    )
    drive, speed = seen["motor_torque"][1:], seen["velocity"][:-1]
    assert np.abs(drive).max(axis=0) == pytest.approx(limits.torque_nm)
    driving = drive * speed > 0
    allowed = np.array(limits.torque_nm) * np.maximum(0, 1 - np.abs(speed) / 3.0)
    assert (np.abs(drive)[driving] <= allowed[driving] + 1e-9).all()
    free = VirtualRobot(draw_truth(lab()), position=HOME).execute({"position": target}).truth
    assert np.abs(free["motor_torque"]).max() > 1000


def test_commanded_torques_change_no_faster_than_table_2_1_allows():
    spec = lab("saturation", torque=True)
    jump = np.tile(np.array([10.0, 0, 0, 0, 0, 0, 0]), (50, 1))
    drive = VirtualRobot(draw_truth(spec), position=HOME).execute({"torque": jump}).truth["motor_torque"][:, 0]
    assert np.abs(np.diff(drive)).max() == pytest.approx(1.0)  # 1000 Nm/s in 1 ms
    assert drive[12] == pytest.approx(10.0, abs=0.2)


def test_sensors_add_bias_and_noise_of_their_size():
    spec = lab("readings", readings=Readings(torque_bias_nm=0.5))
    truth = draw_truth(spec)
    robot = VirtualRobot(truth, position=HOME)
    run = robot.execute({"position": np.tile(HOME, (4000, 1))})
    bias = np.array([joint.torque_bias_nm for joint in truth.joints.values()])
    error = {name: run.measured[name] - run.truth[name] for name in ("position", "velocity", "torque")}
    np.testing.assert_allclose(error["torque"].mean(axis=0), bias, atol=0.01)
    assert np.std(error["torque"] - bias) == pytest.approx(spec.readings.sensors.torque_noise_nm, rel=0.05)
    assert np.std(error["velocity"]) == pytest.approx(spec.readings.sensors.velocity_noise_rad_s, rel=0.05)
    step = spec.readings.sensors.position_step_rad
    np.testing.assert_allclose(run.measured["position"] / step, np.round(run.measured["position"] / step), atol=1e-6)
    assert np.std(bias) > 0.1


def test_joints_warm_up_by_what_they_lose_and_brake_less():
    warming = Warming(copper_w_per_nm2=(0.2,), time_constant_s=4.0)
    spec = lab("friction", "warming", torque=True, warming=warming, friction=frictionless_motors(load=0.0))
    robot = VirtualRobot(draw_truth(spec), position=HOME)
    # At rest, only the windings lose power: a first-order rise towards R r tau^2.
    seen = robot.execute({"torque": np.zeros((6000, 7))}).truth
    goal = warming.rise_k_per_w * 0.2 * weight(HOME) ** 2
    expected = goal * -np.expm1(-seen.time_s[:, None] / warming.time_constant_s)
    np.testing.assert_allclose(seen["rise"], expected, rtol=2e-3, atol=1e-3)
    # Warm, a joint breaks away earlier, by the factor that the spec names.
    heat = robot.execute({"torque": np.zeros((20000, 7))}).truth["rise"][-1, 3]
    factor = np.exp(-warming.softening * heat)
    ramp = np.zeros((4000, 7))
    ramp[:, 3] = np.linspace(0.0, 1.2 * 0.61 * factor, 4000)
    moved = np.abs(robot.execute({"torque": ramp}).truth["position"][:, 3] - HOME[3])
    far = spec.friction.presliding_rad * 0.61 / 0.56 * factor
    assert heat > 20
    assert ramp[np.argmax(moved > 1.1 * far), 3] == pytest.approx(0.61 * factor, rel=0.05)


def test_friction_only_takes_energy_away():
    spec = lab("friction", "elasticity", torque=True, elasticity=Elasticity(spread=0.0))
    truth = draw_truth(spec)
    truth = replace(truth, joints={name: replace(joint, gravity_error=-1.0) for name, joint in truth.joints.items()})
    series = VirtualRobot(truth, position=RAISED).execute({"torque": np.zeros((250, 7))}).truth
    assert within_limits(series["position"])
    joules = energy_of(series, model_of_panda(armature=False), np.array(spec.elasticity.stiffness), np.full(7, 0.1))[
        2:-2
    ]
    assert joules[-1] < joules[0] - 0.3
    assert np.diff(joules[::20]).max() < 0.02


def test_an_unknown_robot_or_payload_site_is_refused():
    with pytest.raises(ConfigError, match="'atlas' is no shipped robot"):
        draw_truth(LabSpec(robot="atlas"))
    with pytest.raises(ConfigError, match="no site 'hook'"):
        VirtualRobot(draw_truth(LabSpec(payload_site="hook")), payload_kg=1.0)
    with pytest.raises(ConfigError, match="not that of a 'demo_arm'"):
        VirtualRobot(replace(draw_truth(), spec=LabSpec(robot="demo_arm")))


@pytest.mark.parametrize("elastic", [False, True])
def test_a_motor_with_dry_friction_stands_until_it_is_overcome(elastic):
    dry = Friction(
        spread=0.0,
        motor=(0.3,),
        load=0.0,
        breakaway_positive=(0.0,),
        breakaway_negative=(0.0,),
        viscous=(0.0,),
        sigmoid_level=(0.0,),
    )
    spec = lab("friction", *(["elasticity"] if elastic else []), torque=True, friction=dry)
    ramp = np.zeros((2000, 7))
    ramp[:, 0] = np.linspace(0.0, -0.4, 2000)
    seen = VirtualRobot(draw_truth(spec), position=HOME).execute({"torque": ramp}).truth
    moved = np.abs(seen["motor_position"][1:, 0] - seen["motor_position"][0, 0])
    stuck = np.abs(ramp[:, 0]) < 0.29
    assert moved[stuck].max() < (1e-9 if elastic else 7e-4)  # a rigid joint sticks on its bristle
    assert moved[-1] > 2e-3
    # Beyond, it takes 0.3 Nm away from the motor; the rest turns the arm, whose other joints stick.
    model = model_of_panda()
    data = mujoco.MjData(model)
    data.qpos[:] = HOME
    mujoco.mj_forward(model, data)
    column = np.zeros(7)
    mujoco.mj_mulM(model, data, column, np.eye(7)[0])
    push = np.trapezoid(np.maximum(np.abs(ramp[:, 0]) - 0.3, 0.0), dx=TICK)
    assert np.abs(seen["velocity"][-1, 0]) == pytest.approx(push / column[0], rel=0.1)


def test_a_payload_may_hang_on_a_flange_without_mass(tmp_path):
    path = find_model(load_robot("panda"))
    spec = mujoco.MjSpec.from_file(str(path))
    place = np.array(spec.site("payload").pos)
    hand = spec.site("payload").parent
    spec.delete(spec.site("payload"))
    hand.add_body(name="tool0", pos=place).add_site(name="payload")
    model = spec.compile()
    truth = draw_truth(lab())
    before, after = loaded(truth, model, 0.0), loaded(truth, model, 1.5)
    assert set(after) - set(before) == {"tool0"}
    assert after["tool0"].mass == 1.5
    np.testing.assert_allclose(after["tool0"].com, [0, 0, 0.05])
