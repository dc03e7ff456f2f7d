"""A base that moves: arms feel exactly what they feel on a base that really moves, and nothing where it does not."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from trueup.errors import ConfigError
from trueup.lab import LabSpec, VirtualRobot, draw_truth, load_lab
from trueup.lab.base import BaseMotion, draw_base
from trueup.lab.spec import Base
from trueup.robots import find_model, load_robot

DT, G = 0.0005, np.array([0.0, 0.0, -9.81])
PLAIN = load_lab("upper_body")


def robot(spec, *, seed=0, payload_kg=0.0):
    return VirtualRobot(draw_truth(spec), payload_kg=payload_kg, seed=seed)


def on(condition, **sizes):
    return replace(PLAIN, base=Base(condition=condition, **sizes))


def bare(stiffness, damping, **sizes):
    """The model itself on a base that does not tilt."""
    level = {"squat_lean_rad": 0.0, "sway_rad": 0.0, "nod_rad": 0.0, "gait_lean_rad": 0.0, **sizes}
    spec = replace(PLAIN, base=Base(**level)).only("base")
    control = replace(PLAIN.controller, stiffness=(stiffness,), damping=(damping,))
    return replace(spec, controller=control)


def moved_model():
    """The upper body with a torso that slides along three axes."""
    spec = mujoco.MjSpec.from_file(str(find_model(load_robot("upper_body"))))
    for axis in np.eye(3):
        spec.body("torso").add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
    for joint in spec.joints:
        joint.damping[0] = 0.0
        joint.frictionloss = 0.0
    spec.option.timestep = DT
    model = spec.compile()
    return model, mujoco.MjData(model)


def torques(model, data, place, acceleration, q, v, a):
    """What the arms' joints need on a base that moves so: inverse dynamics."""
    data.qpos[:], data.qvel[:] = np.concatenate([place, q]), np.concatenate([np.zeros(3), v])
    data.qacc[:] = np.concatenate([acceleration, a])
    mujoco.mj_inverse(model, data)
    return data.qfrc_inverse[3:].copy()


@pytest.mark.parametrize("condition", ["squat", "gait"])
def test_free_arms_swing_as_on_a_base_that_really_moves(condition):
    it = robot(bare(0.0, 0.0, condition=condition), seed=4)
    base = it._base
    assert base is not None
    steps = 180  # the elbows come to their stops soon after
    start = it.read()["position"] * 0 + it._plant.home
    done = it.execute({"position": np.tile(start, (steps, 1))}).truth
    model, data = moved_model()
    q, v = start.copy(), np.zeros(10)
    for tick in range(steps):
        place, push = (of(np.array([(tick + 0.5) * it.control_step_s]))[0][:3] for of in (base.pose, base.acceleration))
        for _ in range(2):
            bias = torques(model, data, place, push, q, v, np.zeros(10))
            mass = np.empty((model.nv, model.nv))
            mujoco.mj_fullM(model, data, mass)
            v = v + DT * np.linalg.solve(mass[3:, 3:], -bias)
            q = q + DT * v
    np.testing.assert_allclose(done["position"][-1], q, atol=1e-9)
    still = robot(replace(it.truth.spec, base=Base())).execute({"position": np.tile(start, (steps, 1))}).truth
    assert np.abs(still["position"][-1] - q).max() > 1e-4


def test_a_stiff_arm_feels_exactly_the_inertial_torque():
    it = robot(bare(400.0, 4.0, condition="gait", bob_m=0.03), seed=1)
    pose = it._plant.home
    it.execute({"position": np.tile(pose, (500, 1))})
    done = it.execute({"position": np.tile(pose, (500, 1))}).truth
    model, data = moved_model()
    bodily = np.gradient(done["velocity"], done.time_s, axis=0)
    needed, standing = [], []
    for row in range(1, 500):
        middle = done.time_s[row : row + 1] - 0.5 * it.control_step_s
        place, push = it._base.pose(middle)[0, :3], it._base.acceleration(middle)[0]
        here = (done["position"][row], done["velocity"][row], bodily[row])
        # The arm's joints carry their motors' inertia, which the sensor between motor and link does not see.
        own = model.dof_armature[3:] * bodily[row]
        needed.append(torques(model, data, place, push, *here) - own)
        standing.append(torques(model, data, np.zeros(3), np.zeros(3), *here) - own)
    felt = done["torque"][1:500]
    off = np.sqrt(np.mean((felt - needed) ** 2))
    inertial = np.sqrt(np.mean((felt - standing) ** 2))
    assert inertial > 0.3
    assert off < 0.01 * inertial


def test_a_base_that_stands_still_changes_nothing():
    command = {"position": np.tile(robot(PLAIN)._plant.home + 0.1, (300, 1))}
    runs = [
        robot(spec, seed=3).execute(command)
        for spec in (PLAIN, on("fixed"), on("stance"), replace(on("gait"), base=Base(False, "gait")))
    ]
    for other in runs[1:]:
        for signal, values in runs[0].measured.signals.items():
            np.testing.assert_array_equal(other.measured[signal], values)
    gait = robot(on("gait"), seed=3).execute(command)
    assert np.abs(gait.measured["position"] - runs[0].measured["position"]).max() > 1e-3


def test_the_motion_of_a_base_depends_on_the_seed_and_on_nothing_before():
    it = robot(on("gait"), seed=3)
    command = {"position": np.tile(it._plant.home, (200, 1))}
    first = it.execute(command).measured["position"]
    it.restart(seed=4)
    other = it.execute(command).measured["position"]
    it.restart(seed=3)
    np.testing.assert_array_equal(it.execute(command).measured["position"], first)
    assert not np.array_equal(other, first)


def test_a_motion_in_pieces_is_that_of_the_whole_and_a_new_payload_keeps_the_base_moving():
    whole, pieces = robot(on("gait"), seed=3), robot(on("gait"), seed=3)
    pose = np.tile(whole._plant.home, (200, 1))
    expected = whole.execute({"position": pose}).truth["position"]
    parts = [pieces.execute({"position": pose[rows]}).truth["position"] for rows in (slice(0, 70), slice(70, 200))]
    np.testing.assert_array_equal(np.concatenate([parts[0], parts[1][1:]]), expected)
    pieces.load(1.0)
    expected_pull = pieces._base.gravity(np.array([(200 + 0.5) * pieces.control_step_s]), G)[0]
    np.testing.assert_allclose(pieces._plant.model.opt.gravity, expected_pull)


@pytest.mark.parametrize("condition", ["squat", "gait"])
def test_acceleration_is_the_second_derivative_of_the_place(condition):
    base = draw_base(Base(condition=condition), np.random.default_rng(0))
    time_s, step = np.linspace(0, 3, 50), 1e-4
    before, here, after = (base.pose(time_s + shift)[:, :3] for shift in (-step, 0.0, step))
    np.testing.assert_allclose((before - 2 * here + after) / step**2, base.acceleration(time_s), atol=1e-4)


def test_sizes_are_what_the_spec_says():
    time_s = np.linspace(0, 8, 20001)
    squat = draw_base(Base(condition="squat", spread=0.0), np.random.default_rng(1)).pose(time_s)
    assert np.ptp(squat[:, 2]) == pytest.approx(0.2, rel=1e-4)
    assert squat[:, 2].max() == pytest.approx(0.0, abs=1e-5)
    assert squat[:, 4].max() == pytest.approx(0.25, rel=1e-4)
    gait = draw_base(Base(condition="gait", spread=0.0, strike_m=0.0), np.random.default_rng(1)).pose(time_s)
    assert np.ptp(gait, axis=0) == pytest.approx([0.016, 0.05, 0.03, 0.04, 0.02], rel=1e-3)
    strength = np.abs(np.fft.rfft(gait[:-1] - gait[:-1].mean(axis=0), axis=0))
    hertz = np.fft.rfftfreq(len(gait) - 1, time_s[1])[strength.argmax(axis=0)]
    assert hertz == pytest.approx([2.0, 1.0, 2.0, 1.0, 2.0])


def test_a_tilted_base_turns_gravity_and_keeps_its_size():
    tilted = BaseMotion(np.zeros(1), np.zeros((1, 5)), np.zeros((1, 5)), np.array([0, 0, 0, 0.0, 0.3]))
    pull = tilted.gravity(np.zeros(1), G)[0]
    np.testing.assert_allclose(pull, 9.81 * np.array([np.sin(0.3), 0, -np.cos(0.3)]))  # forward, as it leans
    rolled = replace(tilted, mean=np.array([0, 0, 0, 0.2, 0.3])).gravity(np.zeros(1), G)[0]
    axes = np.empty(9)
    turn = np.empty(4)
    mujoco.mju_euler2Quat(turn, np.array([0.0, 0.3, 0.2]), "zyx")
    mujoco.mju_quat2Mat(axes, turn)
    np.testing.assert_allclose(rolled, axes.reshape(3, 3).T @ G, atol=1e-12)


def test_a_base_that_is_none_is_refused():
    with pytest.raises(ConfigError, match="bob_m"):
        replace(LabSpec(), base=Base(condition="gait", bob_m=-1.0))
    with pytest.raises(ConfigError, match="spread"):
        replace(LabSpec(), base=Base(spread=9.0))
