import os
import struct

import mujoco
import numpy as np
import pytest

from trueup.draft import draft_robot
from trueup.errors import ConfigError
from trueup.robots import ControllerSpec, JointSpec, RobotSpec
from trueup.robots.model import compile_spec, load_spec, load_whole_spec, lost_meshes
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


def test_what_is_left_out_is_said_by_those_who_use_the_model(tmp_path):
    urdf, mjcf = tmp_path / "arm.urdf", tmp_path / "arm.xml"
    urdf.write_text(URDF)
    meshes = "".join(f'<mesh name="m{number}" file="part{number}.stl"/>' for number in range(9))
    shown = "".join(f'<geom type="mesh" mesh="m{number}"/>' for number in range(9))
    mjcf.write_text(
        f'<mujoco><asset>{meshes}</asset><worldbody><body name="b"><joint name="j"/>'
        f'<inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/>{shown}</body></worldbody></mujoco>'
    )
    assert "arm.dae" in lost_meshes(urdf)
    assert "arm.stl" in lost_meshes(urdf)
    assert "part5.stl and 3 more" in lost_meshes(mjcf)
    assert lost_meshes(mjcf) in draft_robot(mjcf).unsure
    mjcf.write_text('<mujoco><worldbody><body name="b"><joint name="j"/><geom size="1"/></body></worldbody></mujoco>')
    assert lost_meshes(mjcf) == ""


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
        '<worldbody><replicate count="10000">' + '<geom size="1"/>' * 1000 + "</replicate></worldbody>",
        '<size nuserdata="2000000000"/>',
        '<size nkey="2000000000"/>',
        '<size nuser_geom="2000000000"/>',
        '<size memory="1T"/>',
        '<size nstack="20000000000"/>',
        '<size njmax="2000000000"/>',
        '<custom><numeric name="n" size="2000000000" data="1"/></custom>',
        '<sensor><user name="s" dim="2000000000"/></sensor>',
        '<actuator><motor joint="j" nsample="2000000000" delay="1"/></actuator>',
        '<sensor><rangefinder camera="c"/></sensor><worldbody><camera name="c" resolution="30000 30000"/></worldbody>',
        '<default><general actdim="2000000000"/></default>',
        '<asset><mesh name="m" builtin="supertorus" params="100000 0.5 1 1"/></asset>',
    ],
)
def test_a_line_that_asks_for_more_than_a_computer_has_is_refused(tmp_path, piece):
    (tmp_path / "bomb.xml").write_text(f"<mujoco>{piece}</mujoco>")
    with pytest.raises(ConfigError, match="asks for too much"):
        load_spec(tmp_path / "bomb.xml")


BOMB = '<replicate count="1000000000"><geom size="1"/></replicate>'


@pytest.mark.parametrize(
    "text",
    [
        f"<mujoco>&x;<worldbody>{BOMB}</worldbody></mujoco>",
        f"<mujoco><option a='1' a='2'/><worldbody>{BOMB}</worldbody></mujoco>",
        f"<!DOCTYPE mujoco [<!-- ><mujoco><worldbody>{BOMB}</worldbody></mujoco><!-- -->]><mujoco/>",
        f"<!DOCTYPE mujoco [<!ENTITY x '{BOMB}'>]><mujoco><worldbody>&x;</worldbody></mujoco>",
        f"<mujoco><custom><text name='t' data='<!--'/></custom><worldbody>{BOMB}</worldbody><!-- - --></mujoco>",
        f"<mujoco><![CDATA[<!--]]><worldbody>{BOMB}</worldbody>--></mujoco>",
        f"<?x <!-- ?><mujoco><worldbody>{BOMB}</worldbody>--></mujoco>",
    ],
    ids=["entity", "attribute", "hidden by a doctype", "in an entity", "attribute as comment", "CDATA", "instruction"],
)
def test_nothing_is_hidden_in_what_is_no_proper_xml(tmp_path, text):
    """MuJoCo reads some files that are none, and others otherwise than the standard says."""
    (tmp_path / "bomb.xml").write_text(text)
    with pytest.raises(ConfigError, match=r"no proper XML|DOCTYPE|asks for too much"):
        load_spec(tmp_path / "bomb.xml")


def test_what_people_write_is_read_although_it_is_no_proper_xml(tmp_path):
    text = '<?xml version="1.0" encoding="GB2312"?><!-- --- für Öl --- --><mujoco><!-----><worldbody/></mujoco>'
    (tmp_path / "arm.xml").write_text("\n" + text, encoding="latin-1")
    load_spec(tmp_path / "arm.xml").compile()


def written(folder, files):
    for name, text in files.items():
        (folder / name).write_text(text)
    return folder / "0.xml"


def attaching(name, times):
    return (
        f'<mujoco><asset><model name="m" file="{name}"/></asset><worldbody><body name="b"><replicate count="{times}">'
        '<attach model="m" body="b" prefix="p"/></replicate></body></worldbody></mujoco>'
    )


def test_files_that_multiply_are_refused(tmp_path):
    """What is too much follows from nine files, each read once: ten to the ninth parts."""
    included = {f"{n}.xml": "<mujoco>" + f'<include file="{n + 1}.xml"/>' * 10 + "</mujoco>" for n in range(9)}
    with pytest.raises(ConfigError, match="asks for too much"):
        load_spec(written(tmp_path, {**included, "9.xml": "<mujoco><worldbody/></mujoco>"}))
    attached = {f"{n}.xml": attaching(f"{n + 1}.xml", 10) for n in range(9)}
    last = '<mujoco><worldbody><body name="b"/></worldbody></mujoco>'
    with pytest.raises(ConfigError, match="asks for too much"):
        load_spec(written(tmp_path, {**attached, "9.xml": last}))


@pytest.mark.parametrize("file", ["0.xml", "1.xml"])
def test_a_file_that_is_a_part_of_itself_is_refused(tmp_path, file):
    files = {"0.xml": attaching(file, 1), "1.xml": attaching("0.xml", 1)}
    with pytest.raises(ConfigError, match="a part of itself"):
        load_spec(written(tmp_path, files))


@pytest.mark.parametrize("place", ["1.xml", "parts/1.xml"])
def test_what_is_included_is_looked_at_wherever_mujoco_finds_it(tmp_path, place):
    """Beside the model, or else beside the file that includes it."""
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "part.xml").write_text('<mujoco><include file="1.xml"/></mujoco>')
    path = written(tmp_path, {"0.xml": '<mujoco><include file="parts/part.xml"/></mujoco>'})
    (tmp_path / place).write_text('<mujoco><worldbody><geom size="1"/></worldbody></mujoco>')
    assert load_spec(path).compile().ngeom == 1
    (tmp_path / place).write_text(f"<mujoco><worldbody>{BOMB}</worldbody></mujoco>")
    with pytest.raises(ConfigError, match="asks for too much"):
        load_spec(path)


def test_what_is_attached_is_looked_at_and_what_includes_the_line_that_attaches_it(tmp_path):
    model = '<mujoco><worldbody><body name="b"><replicate count="10000"><geom size="1"/></replicate></body></worldbody></mujoco>'
    line = '<mujoco><worldbody><replicate count="10000"><attach model="m" body="b" prefix="p"/></replicate></worldbody></mujoco>'
    first = '<mujoco><asset><model name="m" file="1.xml"/></asset><include file="2.xml"/></mujoco>'
    with pytest.raises(ConfigError, match="asks for too much: got 10000 parts of other models"):
        load_spec(written(tmp_path, {"0.xml": first, "1.xml": model, "2.xml": line}))


def test_a_robot_that_is_attached_a_hundred_times_is_read(tmp_path):
    arm = '<mujoco><worldbody><body name="b"><joint name="j"/><geom size="1"/></body></worldbody></mujoco>'
    model = load_spec(written(tmp_path, {"0.xml": attaching("1.xml", 100), "1.xml": arm})).compile()
    assert model.njnt == 100


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


def png(width, height):
    """The head of a picture of this size, without its pixels."""
    sizes = struct.pack(">II", width, height)
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + b"IHDR" + sizes + bytes(5)


@pytest.mark.parametrize(
    "asset", ['<texture name="q" type="2d" file="b.png"/>', '<hfield name="q" size="1 1 1 1" file="b.png"/>']
)
def test_a_picture_that_unpacks_to_more_than_a_computer_has_is_refused_unread(tmp_path, asset):
    (tmp_path / "b.png").write_bytes(png(30_000, 30_000))
    path = tmp_path / "m.xml"
    path.write_text(
        f"<mujoco><asset>{asset}</asset><worldbody><body><joint/><geom size='1'/></body></worldbody></mujoco>"
    )
    for load in (load_spec, load_whole_spec):
        with pytest.raises(ConfigError, match=r"b\.png is too large a picture: got 9e\+08 pixels"):
            load(path)


PARTS_THAT_ARE_PIPES = [
    '<include file="pipe"/>',
    '<asset><model name="q" file="pipe"/></asset>',
    '<asset><mesh name="q" file="pipe.stl"/></asset>',
    '<asset><texture name="q" type="2d" file="pipe.png"/></asset>',
    '<asset><hfield name="q" size="1 1 1 1" file="pipe.png"/></asset>',
    '<asset><skin name="q" file="pipe.skn"/></asset>',
]


@pytest.mark.parametrize("part", PARTS_THAT_ARE_PIPES)
@pytest.mark.parametrize("load", [load_spec, load_whole_spec])
def test_a_part_that_is_a_pipe_is_refused(tmp_path, part, load):
    """MuJoCo would wait for it for good, and no signal ends it."""
    for name in ("pipe", "pipe.stl", "pipe.png", "pipe.skn"):
        os.mkfifo(tmp_path / name)
    path = tmp_path / "m.xml"
    path.write_text(f"<mujoco>{part}<worldbody><body><joint/><geom size='1'/></body></worldbody></mujoco>")
    with pytest.raises(ConfigError, match="a pipe or a device"):
        load(path)


@pytest.mark.parametrize(
    ("joint", "name"),
    [
        ("armature='nan'", "dof_armature"),
        ("damping='inf'", "dof_damping"),
        ("axis='nan 0 1'", "jnt_axis"),
        ("ref='nan'", "qpos0"),
    ],
)
def test_numbers_that_are_not_finite_are_refused_by_name(tmp_path, joint, name):
    """MuJoCo takes them; simulations then diverge, whatever their time step, and mass matrices have no inverse."""
    path = tmp_path / "m.xml"
    path.write_text(f"<mujoco><worldbody><body><joint {joint}/><geom size='1'/></body></worldbody></mujoco>")
    with pytest.raises(ConfigError, match=f"{name} that is not finite"):
        compile_spec(load_spec(path), path)


@pytest.mark.parametrize("step", ["nan", "inf", "0", "-1", "2", "1e300"])
def test_a_model_whose_time_step_makes_no_simulation_is_refused(tmp_path, step):
    path = tmp_path / "m.xml"
    path.write_text(
        f"<mujoco><option timestep='{step}'/>"
        "<worldbody><body><joint name='j'/><geom size='1'/></body></worldbody></mujoco>"
    )
    robot = RobotSpec("arm", (JointSpec("j"),), path.name, controller=ControllerSpec(kind="torque"))
    with pytest.raises(ConfigError, match="time step"):
        MujocoSimulator.from_robot(robot, path)
