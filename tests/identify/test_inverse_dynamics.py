"""Inverse-dynamics regression against MuJoCo's own inverse dynamics, textbook groupings and known truths."""

import builtins
import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from conftest import shared_folder
from identify.dynamics_cases import torque_driven
from trueup.errors import ConfigError, DataError, FormatError, MissingDependency, MissingSignal, NameMismatch
from trueup.identify.inertial import Inertial
from trueup.identify.regression import (
    InverseDynamicsFit,
    InverseDynamicsSettings,
    fit_inverse_dynamics,
    inverse_dynamics_from_episodes,
    torque_start,
)
from trueup.identify.regression.equation import mechanism_structure, nominal_terms, term_columns, term_names
from trueup.identify.regression.linkage import Linkage
from trueup.identify.regression.pseudo_inertia import (
    deformed,
    deformed_slopes,
    inertial_from,
    parameters_of,
    square_root,
)
from trueup.robots import find_model, load_robot

TWO_LINKS = """
<mujoco>
  <option timestep="0.001" gravity="{gravity}"/>
  <worldbody>
    <body name="first">
      <joint name="a" axis="0 1 0"/>
      <inertial pos="0.2 0 0.05" mass="1.5" diaginertia="0.02 0.03 0.03"/>
      <body name="second" pos="0.4 0 0">
        <joint name="b" axis="0 1 0"/>
        <inertial pos="0.15 0 -0.02" mass="0.8" diaginertia="0.01 0.012 0.012"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""

# Two joints in one body, anchors off the origin, references, a slide, a branch and a welded body.
ODD = """
<mujoco>
  <worldbody>
    <body name="trunk" pos="0.1 0.2 0.3" quat="0.3 0.4 0.5 0.6">
      <joint name="a" axis="1 2 3" pos="0.1 -0.2 0.05" ref="0.4" armature="0.1"/>
      <joint name="b" type="slide" axis="0 1 1" ref="0.1"/>
      <joint name="c" axis="0 1 -1" pos="0.3 0 0"/>
      <geom type="box" size="0.1 0.2 0.3" pos="0.1 0.2 0"/>
      <body name="welded" pos="0.3 0 0.1" quat="1 0.2 0 0">
        <geom type="capsule" size="0.05 0.2"/>
        <body name="hand" pos="0 0 0.2"><joint name="d" axis="1 0 0" pos="0 0.1 0"/><geom size="0.1"/></body>
      </body>
      <body name="other" pos="-0.2 0 0"><joint name="e" axis="0 1 0"/><geom size="0.07" pos="0.2 0.1 0"/></body>
    </body>
  </worldbody>
</mujoco>
"""


def two_links(gravity="0 0 -9.81"):
    return mujoco.MjModel.from_xml_string(TWO_LINKS.format(gravity=gravity))


def panda():
    shared = shared_folder()
    path = shared / "data" / "models" / "panda_nohand.xml" if shared else None
    if path is None or not path.is_file():
        pytest.skip("the reference model of the Panda is not here")
    return mujoco.MjModel.from_xml_string(path.read_text())


def demo_spec():
    return mujoco.MjSpec.from_file(str(find_model(load_robot("demo_arm"))))


MODELS = {
    "two links": two_links,
    "odd": lambda: mujoco.MjModel.from_xml_string(ODD),
    "demo arm": lambda: demo_spec().compile(),
    "panda": panda,
}


def inverse(model, position, velocity, acceleration):
    """MuJoCo's inverse dynamics without friction and springs, (T, J)."""
    bare = mujoco.MjModel.__copy__(model)
    bare.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    bare.dof_damping[:] = 0.0
    bare.jnt_stiffness[:] = 0.0
    data = mujoco.MjData(bare)
    result = np.empty(position.shape)
    for row, state in enumerate(zip(position, velocity, acceleration, strict=True)):
        data.qpos[:], data.qvel[:], data.qacc[:] = state
        mujoco.mj_inverse(bare, data)
        result[row] = data.qfrc_inverse
    return result


def states(joints, rows, seed, reach=0.8, rate_hz=100.0, top_hz=1.2):
    """A smooth motion with its exact derivatives, (3, T, J)."""
    rng = np.random.default_rng(seed)
    clock = np.arange(rows) / rate_hz
    w = 2 * np.pi * rng.uniform(0.2, top_hz, (4, 1, joints))
    phase = rng.uniform(0, 2 * np.pi, w.shape)
    angle = w * clock[:, None] + phase
    return reach / 2 * np.stack([np.sin(angle).sum(0), (w * np.cos(angle)).sum(0), -(w**2 * np.sin(angle)).sum(0)])


@pytest.mark.parametrize("name", MODELS)
def test_regressor_times_parameters_is_the_inverse_dynamics_of_mujoco(name):
    model = MODELS[name]()
    linkage = Linkage(model)
    q, dq, ddq = linkage.sample_states(40, np.random.default_rng(0))
    torque = linkage.regressor(q, dq, ddq) @ linkage.nominal + model.dof_armature * ddq
    np.testing.assert_allclose(torque, inverse(model, q, dq, ddq), atol=1e-9, rtol=1e-9)


def test_a_joint_that_is_not_looked_at_rests_at_its_reference():
    model = mujoco.MjModel.from_xml_string(ODD)
    linkage = Linkage(model, ["d", "a"])
    q, dq, ddq = linkage.sample_states(10, np.random.default_rng(0))
    full = np.zeros((3, 10, model.nv))
    full[0] = model.qpos0
    full[:, :, [3, 0]] = [q, dq, ddq]
    expected = inverse(model, *full)[:, [3, 0]] - model.dof_armature[[3, 0]] * ddq
    np.testing.assert_allclose(linkage.regressor(q, dq, ddq) @ linkage.nominal, expected, atol=1e-9)


def test_groupings_of_a_planar_arm_are_those_of_the_textbook():
    # Joints along y: of each link the moment about the joint and the first moments in the plane x, z can show. The
    # second link's mass acts at the end of the first, l = 0.4 ahead: it adds l to m x of link 1 and l^2 to its moment.
    found = mechanism_structure(Linkage(two_links()), inertial_only=True)
    assert [found.expression(number) for number in range(found.rank)] == [
        "first.mx + 0.4 second.m",
        "first.mz",
        "first.Iyy + 0.16 second.m",
        "second.mx",
        "second.mz",
        "second.Iyy",
    ]
    assert set(found.unseen) == {
        f"{link}.{name}" for link in ("first", "second") for name in ("my", "Ixx", "Ixy", "Ixz", "Iyz", "Izz")
    } | {"first.m"}


def test_without_gravity_four_of_them_are_left():
    # The first link turns about a fixed axis, so that only its moment shows.
    found = mechanism_structure(Linkage(two_links("0 0 0")), inertial_only=True)
    assert [found.names[number] for number in found.kept] == ["first.Iyy", "second.mx", "second.mz", "second.Iyy"]
    assert found.expression(0) == "first.Iyy + 0.16 second.m"


def test_gravity_compensation_of_all_bodies_is_no_gravity():
    spec = mujoco.MjSpec.from_string(TWO_LINKS.format(gravity="0 0 -9.81"))
    for body in spec.bodies[1:]:
        body.gravcomp = 1.0
    assert mechanism_structure(Linkage(spec.compile()), inertial_only=True).rank == 4
    spec.bodies[1].gravcomp = 0.0
    with pytest.raises(ConfigError, match="some bodies"):
        mechanism_structure(Linkage(spec.compile()))


def test_friction_and_offset_add_three_per_joint_and_armature_one_less_than_joints():
    # The armature of the first joint is part of the first moment of inertia.
    found = mechanism_structure(Linkage(two_links()))
    assert found.rank == 6 + 3 * 2 + 1
    assert found.expression(2) == "first.Iyy + 0.16 second.m + a.armature"


def test_a_panda_has_43_base_inertial_parameters():
    # Gaz et al. 2019, "Dynamic Identification of the Franka Emika Panda Robot", section III.
    assert mechanism_structure(Linkage(panda()), inertial_only=True).rank == 43


def test_base_parameters_hold_all_that_the_torques_depend_on():
    model = demo_spec().compile()
    linkage = Linkage(model)
    structure = mechanism_structure(Linkage(model))
    q, dq, ddq = linkage.sample_states(30, np.random.default_rng(7))
    full = term_columns(linkage, q, dq, ddq, 0.1)
    parameters = np.random.default_rng(8).standard_normal(len(term_names(linkage)))
    np.testing.assert_allclose(
        full[:, :, list(structure.kept)] @ (structure.groups @ parameters), full @ parameters, atol=1e-8
    )


def test_parameters_of_a_pseudo_inertia_are_the_moments_about_the_frame():
    body = Inertial(2.0, np.array([0.1, -0.2, 0.3]), np.diag([0.05, 0.06, 0.07]))
    parameters = parameters_of(body.pseudo_inertia)
    c = body.com
    about = body.inertia + 2.0 * (c @ c * np.eye(3) - np.outer(c, c))
    expected = [2.0, *(2.0 * c), about[0, 0], about[0, 1], about[1, 1], about[0, 2], about[1, 2], about[2, 2]]
    np.testing.assert_allclose(parameters, expected, atol=1e-12)
    back = inertial_from(body.pseudo_inertia)
    np.testing.assert_allclose(back.inertia, body.inertia, atol=1e-12)


def test_every_coordinate_is_a_possible_body_and_its_slope_the_difference_quotient():
    rng = np.random.default_rng(0)
    root = square_root(Inertial(0.4, np.array([0.1, 0.0, 0.02]), np.diag([0.0002, 0.0016, 0.0016])))
    for _ in range(20):
        theta = rng.standard_normal(10)
        found = inertial_from(deformed(root, theta))
        principal = np.linalg.eigvalsh(found.inertia)
        assert found.mass > 0
        assert principal[0] > 0
        assert principal[0] + principal[1] > principal[2]
        numeric = [(deformed(root, theta + step) - deformed(root, theta - step)) / 2e-6 for step in 1e-6 * np.eye(10)]
        np.testing.assert_allclose(deformed_slopes(root, theta), numeric, rtol=1e-5, atol=1e-6 * np.abs(numeric).max())
    np.testing.assert_allclose(deformed(root, np.zeros(10)), root @ root.T)


def other_arm():
    """The demo arm with other bodies and frictions than its model has."""
    spec = demo_spec()
    spec.body("forearm").mass = 0.55
    spec.body("forearm").ipos = [0.13, 0.01, 0.0]
    spec.body("upper_arm").mass = 0.6
    for joint, (armature, damping, friction) in zip(
        spec.joints, [(0.02, 0.6, 0.1), (0.015, 0.5, 0.2), (0.012, 0.3, 0.15)], strict=True
    ):
        joint.armature, joint.frictionloss = armature, friction
        joint.damping[0] = damping
    return spec.compile()


def true_base(model, structure):
    return structure.groups @ nominal_terms(Linkage(model))


def exact_torque(model, q, dq, ddq, epsilon=0.05):
    return inverse(model, q, dq, ddq) + model.dof_damping * dq + model.dof_frictionloss * np.tanh(dq / epsilon)


def colored(rng, shape, rho):
    from scipy.signal import lfilter

    return lfilter([math.sqrt(1 - rho**2)], [1.0, -rho], rng.standard_normal((shape[0] + 200, *shape[1:])), axis=0)[
        200:
    ]


def test_base_parameters_come_back_and_intervals_cover_them():
    true, nominal = other_arm(), demo_spec().compile()
    structure = mechanism_structure(Linkage(nominal))
    expected = true_base(true, structure)
    q, dq, ddq = np.concatenate([states(3, 400, seed) for seed in range(4)], axis=1)
    torque = exact_torque(true, q, dq, ddq)
    motion = np.repeat(np.arange(4), 400)
    inside = []
    for seed in range(10):
        noise = 0.05 * np.array([1.0, 3.0, 0.5]) * colored(np.random.default_rng(seed), torque.shape, 0.8)
        fit = fit_inverse_dynamics(nominal, q, dq, ddq, torque + noise, motion=motion)
        assert fit.rank == fit.structural_rank == 25
        inside.append([item.low <= value <= item.high for item, value in zip(fit.base, expected, strict=True)])
        assert list(fit.rmse.values()) == pytest.approx([0.05, 0.15, 0.025], rel=0.1)
        assert fit.largest_deviation < 3.0
    assert 0.87 <= np.mean(inside) <= 1.0


def test_without_noise_the_base_parameters_are_exact():
    true, nominal = other_arm(), demo_spec().compile()
    q, dq, ddq = states(3, 600, 1)
    fit = fit_inverse_dynamics(nominal, q, dq, ddq, exact_torque(true, q, dq, ddq))
    expected = true_base(true, mechanism_structure(Linkage(nominal)))
    np.testing.assert_allclose([item.value for item in fit.base], expected, atol=1e-9)
    assert [item.status for item in fit.base] == ["ok"] * 25
    assert max(fit.rmse_consistent.values()) < 1e-4


def written_back(model_spec, fit):
    """A model with the estimates in it, written by hand."""
    for name, body in fit.bodies.items():
        target = model_spec.body(name)
        target.explicitinertial = True
        target.mass, target.ipos = body.mass_kg, body.com_m
        target.iquat, target.inertia = [1, 0, 0, 0], [0, 0, 0]
        target.fullinertia = body.fullinertia_kg_m2
    for joint in model_spec.joints:
        found = fit.joints[joint.name]
        joint.armature, joint.frictionloss = found.armature, found.frictionloss
        joint.damping[0] = found.damping
    return model_spec.compile()


@pytest.mark.parametrize("seed", [0, 1])
def test_a_simulated_arm_is_recovered_from_a_wrong_model(seed):
    true, nominal = other_arm(), demo_spec()
    true.opt.timestep = 0.0005
    log = torque_driven(
        true, motions=3, seconds=3.0, home=[0, -0.6, 1.0], reach=[0.5] * 3, stiffness=np.full(3, 60.0), seed=seed
    )
    fit = inverse_dynamics_from_episodes(log, nominal.compile())
    fitted = written_back(nominal, fit)  # MuJoCo refuses inertias that no body can have
    for joint in fit.joints.values():
        assert min(joint.armature, joint.damping, joint.frictionloss) >= 0.0
    q, dq, ddq = states(3, 300, 99)
    truth, found, before = (exact_torque(model, q, dq, ddq) for model in (true, fitted, demo_spec().compile()))
    error = np.sqrt(np.mean((found - truth) ** 2, axis=0))
    assert np.all(error < 0.03 * truth.std(axis=0))
    assert np.all(error < 0.1 * np.sqrt(np.mean((before - truth) ** 2, axis=0)))
    for number, name in enumerate(("yaw", "shoulder", "elbow")):
        assert fit.joints[name].damping == pytest.approx(true.dof_damping[number], rel=0.03)
        assert fit.joints[name].frictionloss == pytest.approx(true.dof_frictionloss[number], rel=0.05)
    assert fit.joints["elbow"].armature == pytest.approx(0.012, rel=0.05)
    assert fit.largest_deviation < 3.0


@pytest.mark.parametrize("seed", range(4))
def test_noise_and_little_motion_still_give_possible_bodies(seed):
    true, nominal = other_arm(), demo_spec()
    q, dq, ddq = states(3, 150, seed, reach=0.1)
    torque = exact_torque(true, q, dq, ddq) + 2.0 * np.random.default_rng(seed).standard_normal(q.shape)
    fit = fit_inverse_dynamics(nominal.compile(), q, dq, ddq, torque)
    for body in fit.bodies.values():
        a, b, c, d, e, f = body.fullinertia_kg_m2
        principal = np.linalg.eigvalsh([[a, d, e], [d, b, f], [e, f, c]])
        assert body.mass_kg > 0
        assert principal[0] > 0
        assert principal[0] + principal[1] > principal[2] * (1 - 1e-9)
    written_back(nominal, fit)
    assert {item.status for item in fit.base} & {"weak", "not identifiable"}


def test_what_the_torques_do_not_tell_stays_at_the_model():
    nominal = demo_spec().compile()
    q, dq, ddq = states(3, 600, 3)
    fit = fit_inverse_dynamics(nominal, q, dq, ddq, exact_torque(nominal, q, dq, ddq))
    for name in ("column", "upper_arm", "forearm", "tool"):
        assert fit.bodies[name].mass_kg == pytest.approx(nominal.body(name).mass[0], rel=1e-4)
    assert fit.joints["yaw"].armature == pytest.approx(0.01, rel=1e-3)


def test_a_joint_that_stands_still_is_named():
    nominal = demo_spec().compile()
    q, dq, ddq = states(3, 600, 3)
    q[:, 0], dq[:, 0], ddq[:, 0] = 0.3, 0.0, 0.0
    torque = exact_torque(nominal, q, dq, ddq) + 0.01 * np.random.default_rng(0).standard_normal(q.shape)
    fit = fit_inverse_dynamics(nominal, q, dq, ddq, torque)
    assert fit.rank < fit.structural_rank
    assert "yaw.damping" in fit.notes[0]
    assert f"{fit.rank} of {fit.structural_rank}" in fit.notes[0]
    assert not {"yaw.damping", "yaw.frictionloss", "column.Izz"} & {item.name for item in fit.base}


def test_masked_values_do_not_count():
    nominal = demo_spec().compile()
    q, dq, ddq = states(3, 600, 4)
    torque = exact_torque(nominal, q, dq, ddq)
    weight = np.ones(q.shape)
    weight[100:200, 1] = 0.0
    torque[100:200, 1] = 12.0
    fit = fit_inverse_dynamics(nominal, q, dq, ddq, torque, weight=weight)
    np.testing.assert_allclose(
        [item.value for item in fit.base], true_base(nominal, mechanism_structure(Linkage(nominal))), atol=1e-8
    )


def test_a_spring_of_the_model_is_taken_off():
    spec = mujoco.MjSpec.from_string(TWO_LINKS.format(gravity="0 0 -9.81"))
    spec.joints[1].stiffness[0] = 5.0
    spec.joints[1].springref = 0.3
    model = spec.compile()
    q, dq, ddq = states(2, 500, 0)
    torque = exact_torque(model, q, dq, ddq)
    torque[:, 1] += 5.0 * (q[:, 1] - model.qpos_spring[1])
    fit = fit_inverse_dynamics(model, q, dq, ddq, torque)
    np.testing.assert_allclose(
        [item.value for item in fit.base], true_base(model, mechanism_structure(Linkage(model))), atol=1e-8
    )


def test_the_result_survives_its_file(tmp_path):
    model = two_links()
    q, dq, ddq = states(2, 300, 0)
    fit = fit_inverse_dynamics(model, q, dq, ddq, exact_torque(model, q, dq, ddq) + 0.1 * np.sin(40 * q))
    fit.save(tmp_path / "inverse_dynamics.json")
    assert InverseDynamicsFit.load(tmp_path / "inverse_dynamics.json") == fit
    with pytest.raises(FormatError):
        InverseDynamicsFit.from_json({"schema": "trueup.fit/1"})
    with pytest.raises(DataError):
        InverseDynamicsFit.from_json({**fit.to_json(), "bodies": 3})


def test_bad_input_is_refused_in_words(monkeypatch):
    model = two_links()
    q, dq, ddq = states(2, 300, 0)
    with pytest.raises(NameMismatch):
        Linkage(model, ["elbow"])
    with pytest.raises(DataError, match="too few"):
        fit_inverse_dynamics(model, q[:20], dq[:20], ddq[:20], q[:20])
    free = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><freejoint/><geom size='0.1'/></body></worldbody></mujoco>"
    )
    with pytest.raises(ConfigError, match="hinge"):
        Linkage(free)
    with pytest.raises(ConfigError):
        InverseDynamicsSettings(prior_deviation=0.0)
    with pytest.raises(DataError, match="no episodes"):
        inverse_dynamics_from_episodes([], model)

    real_import = builtins.__import__

    def without_pinocchio(name, *rest, **options):
        if name == "pinocchio":
            raise ImportError(name)
        return real_import(name, *rest, **options)

    monkeypatch.setattr(builtins, "__import__", without_pinocchio)
    with pytest.raises(MissingDependency) as caught:
        Linkage(model)
    assert "pip install '.[dynamics]'" in str(caught.value)


@pytest.mark.parametrize("source", ["command", "measured"])
def test_start_values_for_torque_driven_logs_are_near_the_truth(source):
    true, nominal = other_arm(), demo_spec().compile()
    log = torque_driven(
        true, motions=4, seconds=2.0, home=[0, -0.6, 1.0], reach=[0.5] * 3, stiffness=np.full(3, 60.0), seed=2
    )
    start = torque_start(log, nominal, torque=source)
    for number, name in enumerate(("yaw", "shoulder", "elbow")):
        assert start.damping[name] == pytest.approx(true.dof_damping[number], rel=0.1)
        assert start.frictionloss[name] == pytest.approx(true.dof_frictionloss[number], rel=0.15)
        assert start.armature[name] == pytest.approx(true.dof_armature[number], rel=0.3)
    assert start.mass_scale["column"] == pytest.approx(1.0, abs=0.01)  # no torque depends on it
    assert start.mass_scale["forearm"] > 1.2


def test_start_values_of_a_true_model_are_the_model():
    true = demo_spec().compile()
    log = torque_driven(
        true,
        motions=2,
        seconds=3.0,
        home=[0, -0.6, 1.0],
        reach=[0.5] * 3,
        stiffness=np.full(3, 60.0),
        seed=0,
        noise=(1e-6, 0.001),
    )
    start = torque_start(log, true)
    assert list(start.mass_scale.values()) == pytest.approx([1.0, 1.0, 1.0], abs=0.03)
    assert list(start.damping.values()) == pytest.approx([0.4] * 3, rel=0.03)
    assert max(map(abs, start.offset.values())) < 0.02


def test_vibration_above_the_motion_lowers_the_low_pass():
    true = demo_spec().compile()
    options = {
        "motions": 2,
        "seconds": 2.0,
        "home": [0, -0.6, 1.0],
        "reach": [0.5] * 3,
        "stiffness": np.full(3, 60.0),
        "seed": 0,
    }
    calm = torque_start(torque_driven(true, **options), true)
    shaken = []
    for episode in torque_driven(true, **options):
        wobble = 0.01 * np.sin(2 * np.pi * 14.0 * episode.measured.time_s)[:, None]
        signals = {**episode.measured.signals, "position": episode.measured["position"] + wobble}
        shaken.append(replace(episode, measured=replace(episode.measured, signals=signals)))
    found = torque_start(shaken, true)
    assert found.cutoff_hz < calm.cutoff_hz
    assert found.cutoff_hz < 14.0
    fixed = torque_start(shaken, true, cutoff_hz=33.0)
    assert abs(found.mass_scale["forearm"] - 1.0) < abs(fixed.mass_scale["forearm"] - 1.0)


def test_start_values_name_what_is_missing():
    true = demo_spec().compile()
    log = list(
        torque_driven(
            true, motions=1, seconds=1.0, home=[0, -0.6, 1.0], reach=[0.5, 0.5, 0.0], stiffness=np.full(3, 60.0), seed=0
        )
    )
    with pytest.raises(MissingSignal):
        torque_start([replace(log[0], command=None)], true)
    with pytest.raises(DataError, match="no episodes"):
        torque_start([], true)
    with pytest.raises(NameMismatch):
        torque_start(log, two_links())


def test_start_values_of_a_real_pendulum_are_of_the_size_that_its_makers_found(double_pendulum_logs, tmp_path):
    from trueup.dataset import Dataset
    from trueup.stages import import_logs

    import_logs(double_pendulum_logs, tmp_path / "set")
    dataset = Dataset(tmp_path / "set")
    train = [episode for episode in dataset.episodes() if episode.meta.split == "train"]
    model = mujoco.MjModel.from_xml_path(str(double_pendulum_logs / "model" / "double_pendulum_A0.xml"))
    start = torque_start(train, model, torque="measured")
    dataset.close()
    # README: identified by the makers with their own tools; friction 0.093 and 0.078 Nm.
    assert all(0.8 < scale < 1.2 for scale in start.mass_scale.values())
    assert all(0.03 < value < 0.15 for value in start.frictionloss.values())
