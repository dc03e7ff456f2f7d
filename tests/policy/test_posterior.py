"""Models drawn from an identification are the same whether one begins with the model as it came or the fitted one."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from policy.test_randomization import PARAMETER, fitted, numbers
from trueup.core.atomic import read_json, write_json
from trueup.errors import ConfigError
from trueup.identify.candidate import CARRIED, Nominal
from trueup.identify.export import fitted_robot, robot_yaml, save_model
from trueup.identify.inertial import Inertial
from trueup.identify.quantities import quantity
from trueup.policy.config import PolicyConfig
from trueup.policy.randomization import Individuals, RandomizationConfig
from trueup.policy.simulated import simulated
from trueup.robots import find_model, load_robot

PANDA = load_robot("panda_torque")
WEIGHS = replace(PANDA, simulation=replace(PANDA.simulation, gravity_compensation=False))
VALUES = {
    "mass[link3]": 2.1,
    "com_x[link3]": 0.03,
    "inertia_scale[link4]": 1.5,
    "inertia_d1[link5]": 0.3,
    "inertia_s12[link5]": -0.4,
    "inertia_scale[link7]": 0.7,
    "inertia_d2[link7]": 0.2,
    "payload_mass": 1.0,
    "payload_x": 0.05,
    "payload_z": 0.1,
}


def identified(folder, robot, values=VALUES):
    """What an identification with these values leaves, with samples around them."""
    rng = np.random.default_rng(3)
    samples = {name: value * (1 + 0.1 * rng.uniform(-1, 1, 50)) for name, value in values.items()}
    fitted(folder, samples=samples)
    tree = read_json(folder / "fit.json")
    parameters = [
        {**PARAMETER, "name": name, "value": value, "low": -10.0, "high": 10.0} for name, value in values.items()
    ]
    write_json(folder / "fit.json", {**tree, "parameters": parameters})
    candidate = Nominal(robot, find_model(robot)).candidate()
    for name, value in values.items():
        about, _, target = name.partition("[")
        quantity(about).write(candidate, target.removesuffix("]"), value)
    save_model(candidate, folder / "model.fitted.xml")
    (folder / "robot.fitted.yaml").write_text(robot_yaml(fitted_robot(candidate)))
    return load_robot(folder / "robot.fitted.yaml")


def drawn(robot, folder, count=5):
    nominal = Nominal(robot, find_model(robot))
    make = Individuals(nominal, RandomizationConfig(posterior=str(folder)).draws(nominal))
    rng = np.random.default_rng(0)
    return [make(rng) for _ in range(count)]


@pytest.mark.parametrize("robot", [PANDA, WEIGHS], ids=["weight is carried", "it weighs"])
def test_factors_are_not_applied_twice(tmp_path, robot):
    found = drawn(identified(tmp_path / "fit", robot), tmp_path / "fit")
    expected = drawn(robot, tmp_path / "fit")
    for (one, _), (other, _) in zip(found, expected, strict=True):
        names = [one.body(k).name for k in range(one.nbody)]
        assert names == [other.body(k).name for k in range(other.nbody)]
        for body in names:
            a, b = one.body(body), other.body(body)
            assert a.mass == pytest.approx(b.mass, rel=1e-5, abs=1e-12)
            assert one.body_gravcomp[a.id] == other.body_gravcomp[b.id]
            np.testing.assert_allclose(a.ipos, b.ipos, atol=1e-5)
            np.testing.assert_allclose(np.sort(a.inertia), np.sort(b.inertia), rtol=2e-4, atol=1e-9)
    # Torques that hold and accelerate the arm are the same, however inertia is written down.
    for (one, _), (other, _) in zip(found, expected, strict=True):
        forces = []
        for model in (one, other):
            data = mujoco.MjData(model)
            data.qpos[:7], data.qvel[:7] = model.key("home").qpos[:7], np.linspace(-1, 1, 7)
            data.qacc[:7] = np.linspace(2, -2, 7)
            mujoco.mj_inverse(model, data)
            forces.append(data.qfrc_inverse[:7].copy())
        np.testing.assert_allclose(*forces, rtol=1e-3, atol=1e-4)
    assert numbers(found, "body_inertia").std(axis=0).max() > 0


def test_a_copy_of_the_fitted_model_is_known_and_another_one_refused(tmp_path):
    robot = identified(tmp_path / "fit", PANDA)
    model = find_model(robot)
    nominal = Nominal(replace(robot, folder=None), model)
    RandomizationConfig(posterior=str(tmp_path / "fit")).draws(nominal)
    model.write_text(model.read_text().replace("1.5", "1.6") + "<!-- by hand -->")
    identified(tmp_path / "again", PANDA)
    with pytest.raises(ConfigError, match=r"inertia_scale.*another identified one.*as it was written"):
        RandomizationConfig(posterior=str(tmp_path / "again")).draws(nominal)
    # Numbers that the model says itself need no beginning.
    identified(tmp_path / "plain", PANDA, {"mass[link3]": 2.0})
    RandomizationConfig(posterior=str(tmp_path / "plain")).draws(nominal)


def test_gains_are_drawn_around_what_the_posterior_says(tmp_path):
    fitted(tmp_path / "fit", samples={"torque_gain[joint1]": np.full(3, 1.3)})
    nominal = Nominal(PANDA, find_model(PANDA))
    config = RandomizationConfig(posterior=str(tmp_path / "fit"), gains=0.1)
    make, rng = Individuals(nominal, config.draws(nominal)), np.random.default_rng(0)
    gains = numbers([make(rng) for _ in range(50)], "actuator_gainprm")[:, :, 0]
    assert gains[:, 0].min() >= 1.3 * 0.9 - 1e-9
    assert gains[:, 0].max() <= 1.3 * 1.1 + 1e-9
    assert gains[:, 1].min() >= 0.9 - 1e-9
    assert gains[:, 0].std() > 0.05


@pytest.mark.parametrize("robot", [PANDA, WEIGHS], ids=["weight is carried", "it weighs"])
def test_nobody_tells_a_robot_what_it_carries(robot):
    """A payload bends an arm by its own weight, whether or not that of the links is carried."""
    start = load_robot("panda_torque")

    def moved(payload_kg):
        config = replace(PolicyConfig(), arms=1, randomization=RandomizationConfig(payload_kg=(payload_kg, payload_kg)))
        reaching = simulated(config, robot, find_model(start))
        home = Nominal(robot, find_model(start)).model.key("home").qpos[None, :7]
        reaching.arms.begin(np.zeros(1, int), home, np.random.default_rng(0))
        for _ in range(5):
            reaching.arms.step(np.zeros((1, 7)))
        return reaching.arms.position[0] - home[0]

    bent = moved(3.0) - moved(0.0)
    assert np.abs(bent).max() > 1e-2
    # By hand: the balance of torques says which way: joint 2 is pushed forward by what hangs in front of it.
    assert bent[1] > 0


def test_a_payload_that_hangs_by_itself_is_one_body_however_often_it_is_written():
    candidate = Nominal(PANDA, find_model(PANDA)).candidate()
    masses = []
    for mass in (0.0, 2.0, 3.0):
        quantity("payload_mass").write(candidate, "", mass)
        model = candidate.compile()
        masses.append(model.body(CARRIED).mass[0])
        assert model.body_gravcomp[model.body(CARRIED).id] == 0
        assert [model.body(k).name for k in range(model.nbody)].count(CARRIED) == 1
    assert masses == [0.0, 2.0, 3.0]
    assert CARRIED not in candidate.nominal.bodies


def test_what_was_deformed_and_added_is_undone():
    rng = np.random.default_rng(0)
    for _ in range(20):
        root = rng.standard_normal((3, 3))
        moment = root @ root.T
        body = Inertial(rng.uniform(0.1, 3), rng.standard_normal(3), np.trace(moment) * np.eye(3) - moment)
        theta = dict(zip(("d1", "d2", "d3", "s12", "s13", "s23"), rng.uniform(-1, 1, 6), strict=True))
        np.testing.assert_allclose(body.deformed(theta).undeformed(theta).inertia, body.inertia, rtol=1e-9, atol=1e-12)
        other = Inertial.point(rng.uniform(0.1, 2), rng.standard_normal(3))
        back = body.plus(other).minus(other)
        assert back.mass == pytest.approx(body.mass)
        np.testing.assert_allclose(back.com, body.com, atol=1e-9)
        np.testing.assert_allclose(back.inertia, body.inertia, atol=1e-8)
