"""A URDF is what MuJoCo makes of it, its `<mujoco>` block included; xacro is none."""

import mujoco
import numpy as np
import pytest

from trueup.errors import ConfigError
from trueup.robots import ControllerSpec, JointSpec, RobotSpec, SimulationSpec, load_robot
from trueup.robots.model import load_spec, load_whole_spec
from trueup.sim import MujocoSimulator, make_simulator

OBJ = "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
INERTIA = '<inertia ixx="{0}" ixy="0" ixz="0" iyy="{0}" iyz="0" izz="{1}"/>'
ROBOT = f"""
<robot name="two">{{block}}
  <link name="base"/>
  <link name="upper">
    <inertial><origin xyz="0 0 -0.15"/><mass value="0.8"/>{INERTIA.format(0.006, 0.0005)}</inertial>
    <visual><geometry><mesh filename="{{mesh}}"/></geometry></visual>
    <collision><geometry><mesh filename="{{mesh}}"/></geometry></collision>
  </link>
  <link name="tool">
    <inertial><origin xyz="0 0 -0.05"/><mass value="0.1"/>{INERTIA.format(0.001, "{izz}")}</inertial>
    <visual><geometry><box size=".1 .1 .1"/></geometry></visual>
  </link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="10" velocity="5"/></joint>
  <joint name="flange" type="fixed"><parent link="upper"/><child link="tool"/><origin xyz="0 0 -0.3"/></joint>
</robot>
"""


def write_urdf(folder, block="", *, mesh="arm.obj", at="arm.obj", izz=0.001):
    path = folder / "two.urdf"
    path.write_text(ROBOT.format(block=block, mesh=mesh, izz=izz))
    if at:
        (folder / at).parent.mkdir(parents=True, exist_ok=True)
        (folder / at).write_text(OBJ)
    return path


def block_of(compiler="", more=""):
    return f"<mujoco><compiler {compiler}/>{more}</mujoco>"


OPTION = (
    '<option timestep="0.0005" gravity="0 0 -1.62" integrator="implicitfast" density="1.2" wind="1 0 0">'
    '<flag contact="disable"/></option>'
)
BLOCKS = {
    "nothing": "",
    "options": block_of(more=OPTION),
    "options alone": f"<mujoco>{OPTION}</mujoco>",
    "sizes": block_of(more='<size nuserdata="3" memory="2M"/>'),
    "bounds": block_of('boundmass="0.2" boundinertia="0.004"'),
    "links by name": block_of('fusestatic="false"'),
    "links fused": block_of('fusestatic="true"'),
    "shapes": block_of('discardvisual="false" fusestatic="false"'),
    "shapes as masses": block_of('inertiafromgeom="true" fusestatic="false"'),
    "what MuJoCo passes over": block_of(more='<default><joint damping="7"/></default><actuator/>'),
}
FIELDS = (
    *("qpos0", "jnt_range", "jnt_axis", "dof_damping", "dof_armature", "body_mass", "body_inertia", "body_ipos"),
    *("body_pos", "body_quat", "geom_type", "geom_size", "geom_contype", "jnt_actfrcrange"),
)
OPTIONS = ("timestep", "gravity", "integrator", "density", "wind", "disableflags")


def assert_alike(found, plain):
    for name in FIELDS:
        np.testing.assert_allclose(getattr(found, name), getattr(plain, name), atol=1e-12, err_msg=name)
    for name in OPTIONS:
        np.testing.assert_array_equal(getattr(found.opt, name), getattr(plain.opt, name), err_msg=name)
    assert found.nuserdata == plain.nuserdata


@pytest.mark.parametrize("name", BLOCKS)
def test_what_the_block_says_holds_as_in_plain_mujoco(tmp_path, name):
    path = write_urdf(tmp_path, BLOCKS[name])
    found, plain = load_spec(path).compile(), mujoco.MjModel.from_xml_path(str(path))
    if "fusestatic" in BLOCKS[name]:
        assert_alike(found, plain)
        return
    # Names of fixed links are kept unless somebody says otherwise; what moves is the same.
    assert "tool" in {found.body(number).name for number in range(found.nbody)}
    for option in OPTIONS:
        np.testing.assert_array_equal(getattr(found.opt, option), getattr(plain.opt, option), err_msg=option)
    named = write_urdf(tmp_path, BLOCKS[name].replace("<compiler ", '<compiler fusestatic="false" '))
    if "<compiler " in BLOCKS[name]:
        assert_alike(found, mujoco.MjModel.from_xml_path(str(named)))


def test_an_impossible_inertia_is_balanced_where_the_block_asks_for_it(tmp_path):
    path = write_urdf(tmp_path, block_of('balanceinertia="true" fusestatic="false"'), izz=0.003)
    assert_alike(load_spec(path).compile(), mujoco.MjModel.from_xml_path(str(path)))
    with pytest.raises(ValueError, match="balanceinertia"):
        load_spec(write_urdf(tmp_path, izz=0.003)).compile()


@pytest.mark.parametrize(
    ("compiler", "mesh", "at"),
    [
        ("", "arm.obj", "arm.obj"),
        ('strippath="true"', "package://two_description/meshes/arm.obj", "arm.obj"),
        ('meshdir="meshes" strippath="true"', "package://two_description/visual/arm.obj", "meshes/arm.obj"),
        ('meshdir="meshes"', "visual/arm.obj", "meshes/visual/arm.obj"),
        ('strippath="false"', "visual/arm.obj", "visual/arm.obj"),
        ('assetdir="meshes"', "arm.obj", "meshes/arm.obj"),
    ],
)
def test_meshes_are_found_where_mujoco_finds_them(tmp_path, compiler, mesh, at):
    block = block_of(f'fusestatic="false" discardvisual="false" {compiler}')
    path = write_urdf(tmp_path, block, mesh=mesh, at=at)
    plain = mujoco.MjModel.from_xml_path(str(path))
    assert plain.nmesh == 1
    found = load_spec(path).compile()
    assert_alike(found, plain)
    np.testing.assert_allclose(found.mesh_vert, plain.mesh_vert)


@pytest.mark.parametrize("mesh", ["package://two_description/meshes/arm.obj", "file://{0}/two/meshes/arm.obj"])
def test_packages_are_looked_up_above_the_urdf(tmp_path, mesh):
    (tmp_path / "two" / "urdf").mkdir(parents=True)
    (tmp_path / "two" / "meshes").mkdir()
    (tmp_path / "two" / "meshes" / "arm.obj").write_text(OBJ)
    path = write_urdf(tmp_path / "two" / "urdf", mesh=mesh.format(tmp_path), at="")
    assert load_spec(path).compile().nmesh == 1


def test_the_block_reaches_simulations_and_robot_yaml_wins_over_it(tmp_path):
    path = write_urdf(tmp_path, f"<mujoco>{OPTION}</mujoco>")
    robot = RobotSpec("two", (JointSpec("shoulder"),), path.name, controller=ControllerSpec(kind="torque"))
    assert MujocoSimulator.from_robot(robot, path).timestep_s == 0.0005
    faster = RobotSpec(
        *("two", (JointSpec("shoulder"),), path.name),
        controller=ControllerSpec(kind="torque"),
        simulation=SimulationSpec(timestep_s=0.001),
    )
    simulator = MujocoSimulator.from_robot(faster, path)
    assert simulator.timestep_s == 0.001
    np.testing.assert_array_equal(simulator.model.opt.gravity, [0, 0, -1.62])


def test_contacts_are_not_simulated_without_the_shapes_that_touch(tmp_path):
    controller, simulation = ControllerSpec(kind="torque"), SimulationSpec(contacts=True)
    urdf = write_urdf(tmp_path, at="")
    mjcf = tmp_path / "two.xml"
    mjcf.write_text(
        '<mujoco><asset><mesh name="m" file="gone.obj"/></asset><worldbody><body name="b"><joint name="shoulder"/>'
        '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><geom type="mesh" mesh="m"/></body></worldbody></mujoco>'
    )
    for path in (urdf, mjcf):
        robot = RobotSpec("r", (JointSpec("shoulder"),), path.name, controller=controller)
        assert MujocoSimulator.from_robot(robot, path).model.ngeom == 0
        touching = RobotSpec("r", (JointSpec("shoulder"),), path.name, controller=controller, simulation=simulation)
        with pytest.raises(ConfigError, match="contacts are simulated"):
            MujocoSimulator.from_robot(touching, path)


XACRO = (
    '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:property name="m" value="1"/><link name="a"/></robot>',
    '<robot name="r" xmlns:x="http://ros.org/wiki/xacro"><x:include filename="arm.xacro"/><link name="a"/></robot>',
    '<robot name="r"><xacro:arm prefix="left"/><link name="a"/></robot>',
    '<robot name="r"><link name="${prefix}a"/></robot>',
    '<robot name="r"><link name="a"><visual><geometry><mesh filename="$(find r)/a.stl"/></geometry></visual></link></robot>',
)


@pytest.mark.parametrize("text", XACRO)
@pytest.mark.parametrize("load", [load_spec, load_whole_spec])
def test_xacro_is_called_xacro(tmp_path, text, load):
    path = tmp_path / "arm.urdf.xacro"
    path.write_text(text)
    with pytest.raises(ConfigError, match="xacro that has not been expanded") as caught:
        load(path)
    assert "xacro arm.urdf.xacro > arm.expanded.urdf" in str(caught.value)


def test_an_expanded_urdf_may_still_declare_xacro(tmp_path):
    path = write_urdf(tmp_path)
    head = '<robot name="two" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    path.write_text(path.read_text().replace('<robot name="two">', head))
    assert load_spec(path).compile().njnt == 1


def test_the_case_of_a_block_in_a_urdf(model_cases):
    robot = load_robot(model_cases / "ext" / "a.yaml")
    simulator = make_simulator("mujoco", robot, model_cases / "ext" / "a.urdf")
    assert simulator.timestep_s == 0.0005
    np.testing.assert_array_equal(simulator.model.opt.gravity, [0, 0, -1.62])
    assert simulator.model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST


@pytest.mark.parametrize("name", ["a", "b", "c"])
def test_the_cases_of_xacro(model_cases, name):
    with pytest.raises(ConfigError, match="xacro that has not been expanded"):
        load_spec(model_cases / "xacro" / f"{name}.urdf")
