"""Randomization: what is drawn has the spread that was asked for, moves nothing else, and stays physical."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from trueup.core.atomic import read_json, write_json
from trueup.errors import ConfigError, DataError, NameMismatch
from trueup.identify.candidate import Nominal
from trueup.identify.inertial import inertial_of
from trueup.policy.arms import MujocoArms
from trueup.policy.delay_line import DelayLine
from trueup.policy.environment import ReachVector
from trueup.policy.posterior import Posterior
from trueup.policy.randomization import THESIS, Individuals, RandomizationConfig, delay
from trueup.policy.reach import ReachConfig
from trueup.policy.reaching import Reaching
from trueup.robots import JointFriction, find_model, load_robot

PANDA = load_robot("panda_torque")
RUBBED = replace(
    PANDA,
    friction={
        name: JointFriction(sigmoid_level=1.0 + k, sigmoid_slope=8.0, sigmoid_shift=0.02)
        for k, name in enumerate(PANDA.joint_names)
    },
)
COUNT = 300


@pytest.fixture(scope="module")
def nominal():
    return Nominal(RUBBED, find_model(PANDA))


def drawn(nominal, config, count=COUNT, seed=0):
    make, rng = Individuals(nominal, config.draws()), np.random.default_rng(seed)
    return [make(rng) for _ in range(count)]


def numbers(models, field, rows=slice(None)):
    return np.array([getattr(model, field)[rows] for model, _ in models])


def uniform(values, low, high):
    """Whether all lie within, and fill it evenly: mean and spread of a uniform distribution, within five errors."""
    assert values.min() >= low - 1e-9
    assert values.max() <= high + 1e-9
    spread = (high - low) / np.sqrt(12)
    assert values.mean(axis=0) == pytest.approx((low + high) / 2, abs=5 * spread / np.sqrt(len(values)))
    assert values.std(axis=0) == pytest.approx(spread, rel=0.15)


def test_nothing_asked_for_is_the_model_itself(nominal):
    (model, delays), plain = drawn(nominal, RandomizationConfig(), 1)[0], nominal.model
    for field in ("dof_damping", "dof_frictionloss", "body_mass", "body_inertia", "jnt_user", "actuator_gainprm"):
        np.testing.assert_allclose(getattr(model, field), getattr(plain, field), rtol=1e-12)
    assert not delays.any()


@pytest.mark.long
def test_friction_is_the_thesis_ten_percent_number_by_number(nominal):
    models, plain = drawn(nominal, RandomizationConfig(friction=0.1)), nominal.model
    damping = numbers(models, "dof_damping") / plain.dof_damping
    uniform(damping, 0.9, 1.1)
    assert np.abs(np.corrcoef(damping.T) - np.eye(7)).max() < 0.25
    levels = numbers(models, "jnt_user")
    there = np.abs(plain.jnt_user) > 0
    moved = (levels / np.where(there, plain.jnt_user, 1.0))[:, there]
    moving = moved[:, moved.std(axis=0) > 1e-9]
    assert moving.shape[1] == 21  # three numbers of seven joints; what marks them stays
    uniform(moving, 0.9, 1.1)
    for field in ("body_mass", "body_inertia", "actuator_gainprm"):
        np.testing.assert_allclose(numbers(models, field)[-1], getattr(plain, field), rtol=1e-12)


@pytest.mark.long
def test_inertia_is_the_thesis_five_percent_and_such_as_bodies_can_have(nominal):
    models, plain = drawn(nominal, RandomizationConfig(inertia=0.05)), nominal.model
    for body in nominal.bodies:
        own = inertial_of(plain, body).inertia
        found = np.array([inertial_of(model, body).inertia for model, _ in models])
        for row, column in ((0, 0), (1, 1), (2, 2), (0, 1)):
            if abs(own[row, column]) > 1e-2 * np.abs(own).max():
                ratio = found[:, row, column] / own[row, column]
                assert ratio.min() >= 0.95 - 1e-6
                assert ratio.max() <= 1.05 + 1e-6
        moments = np.array([inertial_of(model, body).second_moment for model, _ in models])
        assert np.linalg.eigvalsh(moments).min() >= -1e-12
        assert found[:, 0, 0].std() > 0
    np.testing.assert_allclose(numbers(models, "body_mass")[-1], plain.body_mass, rtol=1e-12)


def test_what_mujoco_derives_follows(nominal):
    for model, _ in drawn(nominal, THESIS, 5):
        derived = model.dof_invweight0.copy(), model.body_subtreemass.copy()
        mujoco.mj_setConst(model, mujoco.MjData(model))
        np.testing.assert_allclose(model.dof_invweight0, derived[0], rtol=1e-9)
        np.testing.assert_allclose(model.body_subtreemass, derived[1], rtol=1e-12)
        assert np.abs(model.dof_invweight0 / nominal.model.dof_invweight0 - 1).max() > 1e-3


@pytest.mark.long
def test_gains_delays_and_payloads(nominal):
    models = drawn(nominal, RandomizationConfig(gains=0.2, delay_s=(0.001, 0.005), payload_kg=(0.5, 2.0)))
    plain = nominal.model
    uniform(numbers(models, "actuator_gainprm")[:, :, 0] / plain.actuator_gainprm[:, 0], 0.8, 1.2)
    delays = np.array([own for _, own in models])
    assert (delays == delays[:, :1]).all()
    uniform(delays[:, 0], 0.001, 0.005)
    uniform(numbers(models, "body_mass").sum(axis=1) - plain.body_mass.sum(), 0.5, 2.0)


def test_stamps_that_are_late_make_no_torque_early(nominal):
    """A fit finds a negative delay where a log's stamps are late."""
    early = Individuals(nominal, (delay(-0.02, -0.01),))
    _, delays = early(np.random.default_rng(0))
    assert not delays.any()


def test_draws_depend_on_the_generator_alone(nominal):
    one, same, other = (drawn(nominal, THESIS, 3, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(numbers(one, "dof_damping"), numbers(same, "dof_damping"))
    assert not np.array_equal(numbers(one, "dof_damping"), numbers(other, "dof_damping"))


PARAMETER = {
    "name": "damping[joint1]",
    "value": 1.0,
    "unit": "Nm s/rad",
    "nominal": 1.0,
    "start": 1.0,
    "low": 0.001,
    "high": 100.0,
    "interval": [0.8, 1.2],
    "at_bound": "",
    "identified": "yes",
    "prior_share": None,
    "sentence": "",
    "cause": "friction",
    "transform": "log",
}


def fitted(folder, status="ok", samples=None):
    """A folder of an identification with correlated damping and armature of joint1."""
    rng = np.random.default_rng(0)
    common = rng.standard_normal(1000)
    if samples is None:
        samples = {
            "damping[joint1]": 1.0 + 0.1 * common,
            "armature[joint1]": 0.1 - 0.009 * common + 1e-4 * rng.standard_normal(1000),
            "delay_s": np.clip(0.003 + 0.0005 * rng.standard_normal(1000), 0, None),
        }
    folder.mkdir(exist_ok=True)
    np.savez(folder / "fit.samples.npz", **samples)
    tree = {"schema": "trueup.fit/1", "status": status, "statements": ["Joint 1 never moved."], "solver": {}}
    empty = {key: {} for key in ("errors", "correlation", "whiteness", "data", "provenance")}
    write_json(folder / "fit.json", {**tree, **empty, "parameters": [], "directions": [], "models": []})
    return folder


@pytest.mark.long
def test_a_posterior_keeps_what_hangs_together(nominal, tmp_path):
    models = drawn(nominal, RandomizationConfig(posterior=str(fitted(tmp_path / "fit"))), 600)
    joint = int(nominal.model.joint("joint1").dofadr[0])
    damping, armature = (numbers(models, name, joint) for name in ("dof_damping", "dof_armature"))
    assert damping.mean() == pytest.approx(1.0, abs=0.02)
    assert damping.std() == pytest.approx(0.1, rel=0.1)
    assert np.corrcoef(damping, armature)[0, 1] < -0.99
    others = [k for k in range(7) if k != joint]
    np.testing.assert_array_equal(numbers(models, "dof_damping", others)[5], nominal.model.dof_damping[others])
    delays = np.array([own for _, own in models])
    assert delays.mean() == pytest.approx(0.003, abs=2e-4)
    assert delays.std() == pytest.approx(0.0005, rel=0.15)


def test_an_identification_that_is_not_ok_is_refused_unless_forced(nominal, tmp_path):
    folder = fitted(tmp_path / "fit", status="not-identifiable")
    config = RandomizationConfig(posterior=str(folder))
    with pytest.raises(ConfigError, match=r"not-identifiable: Joint 1 never moved.*status ok"):
        config.draws()
    assert len(config.draws(force=True)) == 1
    (folder / "fit.samples.npz").write_bytes(b"PK nonsense")
    with pytest.raises(DataError, match="holds no samples"):
        Posterior.load(folder, force=True)
    (folder / "fit.samples.npz").unlink()
    with pytest.raises(DataError, match="is not there"):
        Posterior.load(folder, force=True)
    with pytest.raises(NameMismatch, match="unknown parameters"):
        Posterior.load(fitted(tmp_path / "odd", samples={"colour[joint1]": np.ones(3)}))
    with pytest.raises(DataError, match="not finite"):
        Posterior.load(fitted(tmp_path / "nan", samples={"damping[joint1]": np.array([1.0, np.nan])}))
    with pytest.raises(DataError, match="different numbers of samples"):
        Posterior.load(fitted(tmp_path / "odd", samples={"delay_s": np.zeros(3), "damping[joint1]": np.ones(4)}))
    bounded = fitted(tmp_path / "bounded", samples={"damping[joint1]": np.array([1.0, -50.0])})
    tree = read_json(bounded / "fit.json")
    write_json(bounded / "fit.json", {**tree, "parameters": [PARAMETER]})
    with pytest.raises(DataError, match=r"damping\[joint1\] outside its bounds: got -50 to 1; expected 0.001 to 100"):
        Posterior.load(bounded)
    assert read_json(folder / "fit.json")["status"] == "not-identifiable"


def test_an_identification_of_another_robot_is_refused_with_both_lists(nominal, tmp_path):
    for name, known in (("damping[elbow]", "joint4"), ("mass[upper_arm]", "link4")):
        config = RandomizationConfig(posterior=str(fitted(tmp_path / "other", samples={name: np.ones(3)})))
        with pytest.raises(NameMismatch, match="identification of another robot") as caught:
            config.draws(nominal)
        assert known in str(caught.value)
        assert name.partition("[")[2].removesuffix("]") in str(caught.value)


def test_widths_that_are_none():
    for wrong in ({"friction": -0.1}, {"inertia": 1.5}, {"delay_s": (0.01, 0.0)}, {"noise_rad": np.inf}):
        with pytest.raises(ConfigError, match="randomization"):
            RandomizationConfig(**wrong)


def test_every_arm_is_another_and_a_new_one_after_each_episode(nominal):
    config = ReachConfig(episode_s=0.1)
    make = Individuals(nominal, RandomizationConfig(friction=0.1, delay_s=(0.0, 0.01)).draws())
    arms = MujocoArms(nominal.simulator, 3, config.control_s, draw=make)
    vector = ReachVector(Reaching(arms, nominal.model, config), seed=0)
    vector.reset()
    first = [model.dof_damping[0] for model in arms._models]
    assert len(set(first)) == 3
    for _ in range(5):
        vector.step_async(np.ones((3, 7)))
        vector.step_wait()
    assert not set(first) & {model.dof_damping[0] for model in arms._models}


@pytest.mark.parametrize("steps", [0, 10, 20, 50])
def test_a_late_torque_acts_late(nominal, steps):
    """Within a control step, after one, and after two and a half."""

    def moved(delay_s):
        late = lambda _: (nominal.model, np.full(7, delay_s))  # noqa: E731
        arms = MujocoArms(nominal.simulator, 1, 0.02, draw=late)
        arms.begin(np.zeros(1, int), nominal.model.key("home").qpos[None, :7], np.random.default_rng(0))
        way = []
        for torque in np.random.default_rng(1).uniform(-3, 3, (10, 1, 7)):
            arms.step(torque)
            way.append(arms.position[0].copy())
        return np.array(way)

    # By hand: each physics step of 1 ms has the torque that was told so many steps ago.
    data = mujoco.MjData(nominal.model)
    data.qpos[:7] = nominal.model.key("home").qpos[:7]
    told = np.repeat(np.random.default_rng(1).uniform(-3, 3, (10, 7)), 20, axis=0)
    acting, way = np.concatenate([np.zeros((steps, 7)), told])[: len(told)], []
    for number, torque in enumerate(acting, 1):
        data.ctrl[:] = torque
        mujoco.mj_step(nominal.model, data)
        if number % 20 == 0:
            way.append(data.qpos[:7].copy())
    found = moved(steps * 0.001)
    np.testing.assert_allclose(found, way, atol=1e-9)
    assert (np.abs(found - moved(0.0)).max() > 1e-3) == (steps > 0)
    with pytest.raises(ConfigError, match="act later, not earlier"):
        moved(-0.001)


def test_arms_are_late_each_by_its_own_and_forget_when_they_begin(nominal):
    """Against a list of what was told, for joints with delays of their own that change from episode to episode."""
    rng = np.random.default_rng(4)
    line = DelayLine(nominal.simulator, 0.02, count=2)
    told = {0: [], 1: []}
    late = np.zeros((2, 7))
    for number in range(40):
        if number in (0, 7, 23):
            row = np.array([number % 2])
            late[row] = rng.uniform(0, 0.07, 7)
            line.set(row, late[row[0]])
            line.clear(row)
            told[int(row[0])] = []
        torque = rng.standard_normal((2, 7))
        acting = line.acting(torque)
        assert acting.shape == (2, 20, 7)
        for arm in range(2):
            told[arm] += [torque[arm]] * 20
            for joint in range(7):
                for step in range(20):
                    # Of what acts within a physics step, the mean.
                    whole, part = int(np.floor(late[arm, joint] / 0.001)), late[arm, joint] / 0.001 % 1
                    place = len(told[arm]) - 20 + step - whole
                    newer, older = (told[arm][k][joint] if k >= 0 else 0.0 for k in (place, place - 1))
                    assert acting[arm, step, joint] == pytest.approx((1 - part) * newer + part * older, abs=1e-6)
