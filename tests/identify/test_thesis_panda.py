"""The hidden Panda of the thesis's experiment: far from the published model, physically possible, seen only by sensors."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from benchmarks.thesis_panda import (
    FOUND_INERTIA_SCALES,
    HOME,
    PUBLISHED,
    HiddenPanda,
    published_panda,
)

from trueup.identify.experiments import Limits, run_coast
from trueup.robots import JointFriction
from trueup.sim import MujocoSimulator

TRUTH = HiddenPanda.draw(0)


def inertia(model, link):
    """Inertia tensor of a link about its center of mass, in the axes of the link."""
    index = model.body(link).id
    axes = np.empty(9)
    mujoco.mju_quat2Mat(axes, model.body_iquat[index])
    axes = axes.reshape(3, 3)
    return axes @ np.diag(model.body_inertia[index]) @ axes.T


@pytest.fixture(scope="module")
def published(tmp_path_factory):
    robot, path = published_panda(tmp_path_factory.mktemp("panda"))
    return MujocoSimulator.from_robot(robot, path)


def test_the_model_has_the_published_friction_and_no_other(published):
    model = published.model
    assert not model.dof_damping.any()
    assert model.dof_frictionloss.max() <= 1e-6
    for number, (level, slope, shift) in enumerate(PUBLISHED, start=1):
        own = published.robot.friction[f"joint{number}"]
        assert own == JointFriction(sigmoid_level=level, sigmoid_slope=slope, sigmoid_shift=shift)
    # Gaz et al., link 4: M11 and M23 as the thesis prints them in Table 3.5.
    assert inertia(model, "link4")[[0, 1], [0, 2]] == pytest.approx([0.02585, 0.008641], abs=5e-6)


@pytest.mark.parametrize("seed", range(5))
def test_a_truth_is_far_from_the_model_and_belongs_to_its_seed(seed):
    truth = HiddenPanda.draw(seed)
    assert truth == HiddenPanda.draw(seed)
    assert truth != HiddenPanda.draw(seed + 1)
    ratio = [own.sigmoid_level / level for own, (level, _, _) in zip(truth.friction, PUBLISHED, strict=True)]
    # Table 3.4: from 1.9 to 6.2 times the old level.
    assert min(ratio) > 1.4
    assert max(ratio) > 3.0


def test_inertias_are_scaled_as_in_the_thesis_and_masses_stay(published):
    plain = replace(TRUTH, inertia_scale=FOUND_INERTIA_SCALES, inertia_shear=(tuple(map(tuple, np.eye(3))),) * 7)
    model = plain.simulator().model
    for link, scale in enumerate(FOUND_INERTIA_SCALES, start=1):
        name = f"link{link}"
        assert inertia(model, name) == pytest.approx(scale * inertia(published.model, name), rel=1e-4, abs=1e-7)
        assert model.body(name).mass == pytest.approx(published.model.body(name).mass, rel=1e-5)
        assert model.body(name).ipos == pytest.approx(published.model.body(name).ipos, abs=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_drawn_inertias_belong_to_possible_bodies(seed, published):
    model = HiddenPanda.draw(seed).simulator().model
    for link in range(1, 8):
        own, old = inertia(model, f"link{link}"), inertia(published.model, f"link{link}")
        moments = np.linalg.eigvalsh(own)
        assert moments[0] > 0
        assert moments[0] + moments[1] >= moments[2] * (1 - 1e-9)
        assert np.linalg.norm(own - old) > 0.01 * np.linalg.norm(old)


def test_under_constant_torque_friction_carries_the_torque():
    robot = TRUTH.robot()
    torque = np.zeros(7)
    torque[6] = 0.5
    robot.write({"torque": torque})
    robot.wait_until_s(1.4)
    speed = np.mean([robot.simulator.step({"torque": torque[None]})["velocity"][0, 6] for _ in range(10)])
    own = TRUTH.friction[6]
    level, slope, shift = own.sigmoid_level, own.sigmoid_slope, own.sigmoid_shift
    # ES thesis, eq. 2.1, and what the hidden robot has besides.
    sigmoid = level / (1 + np.exp(-slope * (speed + shift))) - level / (1 + np.exp(-slope * shift))
    braking = sigmoid + TRUTH.frictionloss[6] + TRUTH.damping[6] * speed
    assert braking == pytest.approx(0.5 + TRUTH.torque_offset[6], rel=0.01)


def test_left_alone_it_stays_at_home():
    robot = TRUTH.robot()
    robot.wait_until_s(0.5)
    assert robot.read()["position"] == pytest.approx(list(HOME.values()), abs=1e-3)


def test_a_recording_holds_readings_and_nothing_of_the_truth():
    robot = TRUTH.robot(seed=3)
    (log,) = run_coast(robot, robot, {"joint6": (0.5,)}, limits=Limits(torque_nm={"joint6": 0.6}))
    assert set(log.command.signals) == {"torque"}
    assert set(log.measured.signals) == {"position", "velocity", "torque"}
    assert len(log.measured) == 2001
    assert log.meta.flags == ()
    position = log.measured["position"]
    step = TRUTH.sensors.position_step_rad
    assert position / step == pytest.approx(np.round(position / step), abs=1e-6)
    assert np.ptp(position[:, 5]) > 0.2
