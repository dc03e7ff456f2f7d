import mujoco
import numpy as np
import pytest

from trueup.errors import ConfigError
from trueup.robots import ControllerSpec, JointSpec, RobotSpec
from trueup.robots.model import load_spec
from trueup.sim import MujocoSimulator

URDF = """<?xml version="1.0"?>
<robot name="arm">
  <link name="base"/>
  <link name="arm">
    <inertial><origin xyz="0 0 -0.2"/><mass value="1.5"/><inertia ixx="0.03" iyy="0.03" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><mesh filename="package://arm_description/meshes/arm.dae"/></geometry></visual>
    <collision><geometry><mesh filename="package://arm_description/meshes/arm.stl"/></geometry></collision>
  </link>
  <link name="flange"><inertial><mass value="0.1"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="swing" type="revolute">
    <parent link="base"/><child link="arm"/><axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="5" velocity="2"/>
  </joint>
  <joint name="mount" type="fixed"><parent link="arm"/><child link="flange"/><origin xyz="0 0 -0.4"/></joint>
</robot>
"""


def test_a_urdf_without_its_meshes_moves_by_its_inertials(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(URDF)
    robot = RobotSpec(
        name="arm", joints=(JointSpec("swing"),), model="arm.urdf", controller=ControllerSpec(kind="torque")
    )
    model = MujocoSimulator.from_robot(robot, path).model
    assert model.body("arm").mass[0] == pytest.approx(1.5)
    assert model.body("flange").mass[0] == pytest.approx(0.1)  # fixed links keep their names
    np.testing.assert_allclose(model.joint("swing").range, [-1, 1])


def test_an_mjcf_without_its_meshes_moves_by_its_inertials(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(
        '<mujoco><asset><mesh name="m" file="missing.stl"/></asset><worldbody><body name="b"><joint name="j"/>'
        '<inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/><geom type="mesh" mesh="m"/></body></worldbody></mujoco>'
    )
    model = load_spec(path).compile()
    assert model.body("b").mass[0] == 2.0
    assert model.ngeom == 0


def test_a_body_whose_mass_hangs_on_a_missing_mesh_is_refused(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(
        '<mujoco><asset><mesh name="m" file="missing.stl"/></asset><worldbody><body name="b"><joint name="j"/>'
        '<geom type="mesh" mesh="m"/></body></worldbody></mujoco>'
    )
    with pytest.raises(ConfigError, match=r"(?s)'b' has no <inertial>.*<inertial>"):
        load_spec(path)


@pytest.mark.parametrize("content", ["", "<mujoco", "<mujoco><worldbody><body/></mujoco>", "{}", "\x00\xff"])
def test_what_is_no_model_is_refused(tmp_path, content):
    path = tmp_path / "broken.xml"
    path.write_text(content, encoding="latin-1")
    with pytest.raises(ConfigError, match=r"broken\.xml"):
        load_spec(path).compile()


@pytest.mark.parametrize(
    "piece",
    [
        '<worldbody><replicate count="1000"><replicate count="1000"><geom size="1"/></replicate></replicate></worldbody>',
        '<asset><texture name="t" type="2d" builtin="flat" width="60000" height="60000"/></asset>',
        '<asset><hfield name="h" nrow="60000" ncol="60000" size="1 1 1 1"/></asset>',
    ],
)
def test_a_line_that_asks_for_more_than_a_computer_has_is_refused(tmp_path, piece):
    (tmp_path / "bomb.xml").write_text(f"<mujoco>{piece}</mujoco>")
    with pytest.raises(ConfigError, match="asks for too much"):
        load_spec(tmp_path / "bomb.xml")


def test_the_shipped_pendulum_swings_with_the_period_of_the_textbook(tmp_path):
    """A point mass on a rod of length l: T = 2 pi sqrt(l / g) for small angles."""
    path = tmp_path / "point.xml"
    path.write_text(
        '<mujoco><option timestep="0.001"/><worldbody><body><joint name="j" axis="1 0 0"/>'
        '<inertial pos="0 0 -0.5" mass="0.676" diaginertia="1e-9 1e-9 1e-9"/></body></worldbody></mujoco>'
    )
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qpos[0] = 0.02
    crossings = []
    for _ in range(5000):
        before = data.qpos[0]
        mujoco.mj_step(model, data)
        if before > 0 >= data.qpos[0]:
            crossings.append(data.time)
    assert np.diff(crossings).mean() == pytest.approx(2 * np.pi * np.sqrt(0.5 / 9.81), rel=1e-3)
