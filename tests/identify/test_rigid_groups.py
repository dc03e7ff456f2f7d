"""Bodies without mass, bodies welded together, and masses that MuJoCo works out itself: what of them is fitted."""

import mujoco
import numpy as np
import pytest

from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.timeseries import TimeSeries, same_units
from trueup.dataset import Dataset
from trueup.errors import ConfigError
from trueup.identify import IdentifyConfig, Nominal, Problem, identify, save_identification
from trueup.identify.config import SolverChoice, make_parameters
from trueup.identify.regression import torque_start
from trueup.identify.start import _masses
from trueup.policy.randomization import inertia
from trueup.robots import ControllerSpec, JointSpec, RobotSpec, SimulationSpec, load_robot
from trueup.stages import identifying, import_logs

BODY = ("mass", "com_x", "com_y", "com_z", "inertia_scale", "inertia_d1")

# As ROS-Industrial has it: links without mass between and behind the others.
URDF = """
<robot name="two">
  <link name="base_link"/><link name="base"/><link name="tool0"/><link name="camera"/>
  <link name="carrier"/>
  <link name="upper"><inertial><origin xyz="0 0 -0.15"/><mass value="0.8"/>
    <inertia ixx="0.006" ixy="0" ixz="0" iyy="0.006" iyz="0" izz="0.0005"/></inertial></link>
  <link name="lower"><inertial><origin xyz="0 0 -0.1"/><mass value="0.4"/>
    <inertia ixx="0.002" ixy="0" ixz="0" iyy="0.002" iyz="0" izz="0.0002"/></inertial></link>
  <link name="gripper"><inertial><origin xyz="0 0 -0.02"/><mass value="0.1"/>
    <inertia ixx="0.0001" ixy="0" ixz="0" iyy="0.0001" iyz="0" izz="0.0001"/></inertial></link>
  <joint name="b" type="fixed"><parent link="base_link"/><child link="base"/></joint>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="carrier"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="10" velocity="5"/></joint>
  <joint name="c" type="fixed"><parent link="carrier"/><child link="upper"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0 0 -0.3"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="10" velocity="5"/></joint>
  <joint name="flange" type="fixed"><parent link="lower"/><child link="tool0"/><origin xyz="0 0 -0.2"/></joint>
  <joint name="g" type="fixed"><parent link="tool0"/><child link="gripper"/></joint>
  <joint name="k" type="fixed"><parent link="lower"/><child link="camera"/></joint>
</robot>
"""
JOINTS = ("shoulder", "elbow")


def urdf_robot(folder):
    path = folder / "two.urdf"
    path.write_text(URDF)
    return RobotSpec(
        "two",
        tuple(JointSpec(name) for name in JOINTS),
        path.name,
        controller=ControllerSpec(kind="torque"),
        simulation=SimulationSpec(timestep_s=0.002),
    ), path


def swing(path, *, masses=(), damping=0.1, seconds=3.0, seed=0):
    """Motions of the same file under torque, by plain MuJoCo alone, with other masses."""
    spec = mujoco.MjSpec.from_string(
        path.read_text().replace("</robot>", '<mujoco><compiler fusestatic="false"/></mujoco></robot>')
    )
    model = spec.compile()
    model.opt.timestep, model.dof_damping[:] = 0.002, damping
    for name, factor in dict(masses).items():
        model.body(name).mass *= factor
        model.body(name).inertia *= factor
    data, rows = mujoco.MjData(model), []
    for step in range(round(seconds / 0.002)):
        now = step * 0.002
        torque = [2 * np.sin((1.5 + seed) * now), 0.6 * np.sin((2.3 + seed) * now)]
        rows.append([now, *data.qpos, *data.qvel, *torque])
        data.qfrc_applied[:] = torque
        mujoco.mj_step(model, data)
    table = np.array(rows)
    measured = {"position": table[:, 1:3], "velocity": table[:, 3:5]}
    command = {"torque": table[:, 5:7]}
    return Episode(
        meta=EpisodeMeta(id=f"m{seed}", robot="two"),
        measured=TimeSeries(
            table[:, 0], JOINTS, measured, same_units({"position": "rad", "velocity": "rad/s"}, JOINTS)
        ),
        command=TimeSeries(table[:, 0], JOINTS, command, same_units({"torque": "Nm"}, JOINTS)),
    )


def test_one_massive_body_of_each_rigid_group_is_fitted(tmp_path):
    nominal = Nominal(*urdf_robot(tmp_path))
    assert set(nominal.bodies) == {"carrier", "upper", "lower", "camera", "tool0", "gripper"}
    assert {group[0]: set(group) for group in nominal.rigid_groups} == {
        "upper": {"carrier", "upper"},
        "lower": {"lower", "camera", "tool0", "gripper"},
    }
    for quantity in BODY:
        assert make_parameters({quantity: "all"}, nominal).names == (f"{quantity}[upper]", f"{quantity}[lower]")


@pytest.mark.parametrize("quantity", BODY)
def test_a_massless_body_that_is_asked_for_is_refused_and_a_welded_one_is_not(tmp_path, quantity):
    nominal = Nominal(*urdf_robot(tmp_path))
    with pytest.raises(ConfigError, match=f"{quantity} needs a body that has .*tool0") as caught:
        make_parameters({quantity: ["gripper", "tool0"]}, nominal)
    assert "lower" in str(caught.value)
    assert make_parameters({quantity: ["gripper"]}, nominal).names == (f"{quantity}[gripper]",)


def test_a_factor_that_all_bodies_share_is_written_to_all_that_have_mass(tmp_path):
    nominal = Nominal(*urdf_robot(tmp_path))
    problem = Problem(nominal, make_parameters({"inertia_scale": {"shared": True}}, nominal), ())
    found = problem.candidate({"inertia_scale": 2.0}).compile()
    np.testing.assert_allclose(found.body_inertia, 2.0 * nominal.model.body_inertia)


@pytest.mark.long
@pytest.mark.parametrize("fit", [None, {"mass": "all", "damping": "all"}, {"mass": {"shared": True}, "damping": "all"}])
def test_a_robot_with_massless_links_is_fitted_to_its_end(tmp_path, fit):
    robot, path = urdf_robot(tmp_path)
    logs = {"train": [swing(path, masses={"upper": 1.3}, seed=seed) for seed in (0, 1)]}
    config = IdentifyConfig(fit=fit or {}, models={}, solver=SolverChoice(max_iterations=4))
    found = identify(logs, robot, path, config=config)
    save_identification(found, tmp_path)
    fitted = mujoco.MjModel.from_xml_path(str(tmp_path / "model.fitted.xml"))
    assert fitted.body("tool0").mass[0] == 0.0
    if fit == {"mass": "all", "damping": "all"}:
        assert found.result["mass[upper]"].value == pytest.approx(1.04, rel=0.02)
        assert found.result["mass[lower]"].value == pytest.approx(0.4, rel=0.05)


def test_the_start_of_a_mass_is_what_makes_the_sum_of_its_group_as_heavy_as_the_torques_say(tmp_path):
    robot, path = urdf_robot(tmp_path)
    nominal = Nominal(robot, path)
    logs = [swing(path, masses={"upper": 1.3, "lower": 1.4, "gripper": 1.4}, seed=seed) for seed in (0, 1, 2)]
    scales = torque_start(logs, nominal.model, joints=JOINTS).mass_scale
    found = _masses(nominal, scales)
    assert set(found) == {"mass[upper]", "mass[lower]"}
    assert found["mass[upper]"] == pytest.approx(0.8 * scales["carrier"])
    assert found["mass[lower]"] + 0.1 == pytest.approx(0.5 * scales["lower"])
    assert found["mass[upper]"] == pytest.approx(1.04, rel=0.1)


def test_a_massless_flange_can_carry_a_payload_and_draws_leave_it_massless(tmp_path):
    nominal = Nominal(*urdf_robot(tmp_path))
    for body in ("gripper", "camera"):
        assert body in nominal.bodies
    path = tmp_path / "site.xml"
    path.write_text("""<mujoco><worldbody><body name="link"><joint name="j" axis="0 1 0"/>
      <inertial pos="0 0 -.1" mass="1" diaginertia=".01 .01 .01"/>
      <body name="tool0" pos="0 0 -.3"><site name="payload" pos="0 0 -.05"/></body></body></worldbody></mujoco>""")
    robot = RobotSpec("one", (JointSpec("j"),), path.name, controller=ControllerSpec(kind="torque"))
    nominal = Nominal(robot, path)
    assert nominal.payload_place == ("tool0", (0.0, 0.0, -0.05))
    problem = Problem(nominal, make_parameters({"payload_mass": "all"}, nominal), ())
    for mass in (0.0, 0.7):
        model = problem.candidate({"payload_mass": mass}).compile()
        assert model.body("tool0").mass[0] == mass
    np.testing.assert_allclose(model.body("tool0").ipos, [0, 0, -0.05])
    drawn = nominal.candidate()
    inertia(0.1)(drawn, np.random.default_rng(0))
    assert drawn.compile().body("tool0").mass[0] == 0.0


MADE_BY_MUJOCO = """
<mujoco>
  <compiler {compiler}/>
  <worldbody>
    <body name="a"><joint name="j" axis="0 1 0" {joint}/>
      <inertial pos="0 0 -.2" mass="1" diaginertia=".01 .01 .01"/><geom size=".1" mass="2"/>
      <body pos="0 0 -.3"><geom size=".05" mass=".1"/></body><body name="t"/></body>
    <body name="cube" pos="3 0 0"><freejoint/><geom size=".1"/></body>
  </worldbody>
  <actuator><position name="p" joint="j" kp="10" dampratio="1"/></actuator>
</mujoco>
"""


@pytest.mark.filterwarnings("ignore:.*settotalmass")
@pytest.mark.parametrize(
    ("compiler", "joint"),
    [
        ("", ""),
        ('inertiafromgeom="true"', ""),
        ('settotalmass="10"', ""),
        ('boundmass=".5" boundinertia=".02"', ""),
        ("", 'springdamper="1 .1"'),
    ],
)
def test_a_written_mass_stays_as_written_and_changes_nothing_else(tmp_path, compiler, joint):
    path = tmp_path / "m.xml"
    path.write_text(MADE_BY_MUJOCO.format(compiler=compiler, joint=joint))
    robot = RobotSpec("m", (JointSpec("j"),), path.name, controller=ControllerSpec(command="position"))
    nominal, plain = Nominal(robot, path), mujoco.MjModel.from_xml_path(str(path))
    before = nominal.model
    for name in ("body_mass", "body_inertia", "actuator_biasprm"):
        np.testing.assert_allclose(getattr(before, name), getattr(plain, name), atol=1e-12, err_msg=name)
    for name in ("dof_damping", "jnt_stiffness"):  # the cube's joint is held
        np.testing.assert_allclose(getattr(before, name), getattr(plain, name)[:1], atol=1e-12, err_msg=name)
    after = Problem(nominal, make_parameters({"mass": ["a"]}, nominal), ()).candidate({"mass[a]": 3.0}).compile()
    assert after.body("a").mass[0] == pytest.approx(3.0)
    np.testing.assert_allclose(np.delete(after.body_mass, 1), np.delete(before.body_mass, 1))
    for name in ("actuator_biasprm", "dof_damping", "jnt_stiffness"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name), err_msg=name)


def test_bodies_without_a_name_get_one_and_what_lies_about_is_no_part_of_the_robot(tmp_path):
    path = tmp_path / "m.xml"
    path.write_text(MADE_BY_MUJOCO.format(compiler="", joint="").replace('name="t"', 'name="body2"'))
    robot = RobotSpec("m", (JointSpec("j"),), path.name, controller=ControllerSpec(command="position"))
    nominal = Nominal(robot, path)
    assert nominal.bodies == ("a", "body3", "body2")
    assert nominal.payload_place[0] == "body2"
    assert make_parameters({"mass": ["body3"]}, nominal).names == ("mass[body3]",)
    assert make_parameters({"mass": "all"}, nominal).names == ("mass[a]",)
    with pytest.raises(ConfigError, match="cube"):
        make_parameters({"mass": ["cube"]}, nominal)


def test_a_point_has_a_mass_but_no_inertia_to_fit(tmp_path):
    path = tmp_path / "m.xml"
    path.write_text("""<mujoco><worldbody><body name="link"><joint name="j" axis="0 1 0" armature=".01"/>
      <inertial pos="0 0 -.1" mass="1" diaginertia="1e-3 1e-3 1e-3"/>
      <body name="tip" pos="0 0 -.3"><inertial pos="0 0 0" mass=".2" diaginertia="0 0 0"/></body></body>
      </worldbody></mujoco>""")
    nominal = Nominal(RobotSpec("m", (JointSpec("j"),), path.name, controller=ControllerSpec(kind="torque")), path)
    assert make_parameters({"mass": ["tip"]}, nominal).names == ("mass[tip]",)
    with pytest.raises(ConfigError, match="inertia_scale needs a body that has a rotational inertia"):
        make_parameters({"inertia_scale": ["tip"]}, nominal)
    heavier = Problem(nominal, make_parameters({"mass": ["tip"]}, nominal), ()).candidate({"mass[tip]": 0.5})
    assert heavier.compile().body("tip").mass[0] == 0.5


@pytest.mark.long
def test_the_case_of_a_massless_flange(model_cases, tmp_path):
    case = model_cases / "tool0"
    import_logs(case / "logs", tmp_path / "data", format="npz")
    dataset = Dataset(tmp_path / "data")
    robot = load_robot(case / "arm.yaml")
    fit = {"mass": "all", "damping": "all"}
    done = identifying.fit(dataset, robot, tmp_path / "fit", config=IdentifyConfig(fit=fit, models={}))
    assert done.fit["damping[elbow]"].value == pytest.approx(0.1, rel=0.01)
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "fit" / "model.fitted.xml")).body("tool0").mass[0] == 0.0
    with pytest.raises(ConfigError, match="tool0"):
        identifying.fit(dataset, robot, tmp_path / "other", config=IdentifyConfig(fit={"mass": ["tool0"]}))
