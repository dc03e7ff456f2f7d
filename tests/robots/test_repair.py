"""Masses and inertias that no body has are named by link, and repaired where that is asked for."""

import re

import numpy as np
import pytest

from trueup.cli.main import main
from trueup.draft import draft_robot
from trueup.errors import ConfigError
from trueup.robots import load_robot
from trueup.robots.model import compile_spec, load_spec
from trueup.robots.repair import faults, repaired
from trueup.sim import MujocoSimulator

URDF = """<robot name="arm">
  <link name="base">{base}</link>
  <link name="upper"><inertial><mass value="{mass}"/><inertia ixx="{ixx}" ixy="{ixy}" ixz="0" iyy="{iyy}" iyz="0" izz="{izz}"/></inertial></link>
  <link name="lower"><inertial><mass value=".5"/><inertia ixx=".002" ixy="0" ixz="0" iyy=".002" iyz="0" izz=".001"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="9" velocity="9"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="9" velocity="9"/></joint>
</robot>"""
GOOD = {"base": "", "mass": 1.0, "ixx": 0.002, "ixy": 0.0, "iyy": 0.002, "izz": 0.001}


def write(folder, **numbers):
    path = folder / "arm.urdf"
    path.write_text(URDF.format(**{**GOOD, **numbers}))
    return path


def moments(path, link):
    model = compile_spec(load_spec(path), path)
    return float(model.body(link).mass[0]), np.sort(model.body(link).inertia)


def test_a_possible_robot_has_no_faults(tmp_path):
    path = write(tmp_path)
    assert faults(path) == []
    assert repaired(path)[1] == []


# Water has 1000 kg/m3: a ball of 1 kg has a radius of 62.04 mm, and moments of 0.4 m r2 = 1.539e-3 kg m2.
@pytest.mark.parametrize(
    ("numbers", "mass", "wanted"),
    [
        ({"izz": 0.01}, 1.0, [0.005, 0.005, 0.01]),
        ({"ixx": 0.001, "iyy": 0.003, "izz": 0.008}, 1.0, [0.003, 0.005, 0.008]),
        ({"izz": -1e-4}, 1.0, [2e-6, 0.002, 0.002]),
        ({"izz": 0.0, "ixx": 0.003}, 1.0, [0.001, 0.002, 0.003]),
        ({"ixx": 0.0, "iyy": 0.0, "izz": 0.0}, 1.0, [1.539e-3] * 3),
        ({"ixx": 1e-18, "ixy": 1e-20, "iyy": 0.0, "izz": 0.0}, 1.0, [1.539e-3] * 3),
        ({"mass": 0.0, "ixx": 0.0, "iyy": 0.0, "izz": 0.0, "base": ""}, 1e-3, None),
        ({"mass": "nan"}, 1e-3, None),
    ],
)
def test_impossible_links_are_named_and_repaired(tmp_path, numbers, mass, wanted):
    path = write(tmp_path, **numbers)
    if "mass" not in numbers or numbers["mass"] != 0.0:
        with pytest.raises(ConfigError):
            compile_spec(load_spec(path), path)
    assert [fault.link for fault in faults(path)] == ["upper"]
    text, found = repaired(path)
    path.write_text(text)
    assert faults(path) == []
    weight, inertia = moments(path, "upper")
    assert weight == pytest.approx(mass)
    if wanted is not None:
        np.testing.assert_allclose(inertia, wanted, rtol=1e-3)
    assert inertia[0] + inertia[1] >= inertia[2] * (1 - 1e-9)
    assert found[0].wrong
    assert found[0].done


def test_a_base_that_does_not_move_may_weigh_what_it_likes(tmp_path):
    bad = '<inertial><mass value="0"/><inertia ixx="-1" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial>'
    path = write(tmp_path, base=bad)
    assert faults(path) == []
    assert compile_spec(load_spec(path), path).njnt == 2


def test_masses_that_the_file_does_not_state_are_told(tmp_path, capsys):
    path = write(tmp_path)
    assert not any("states no mass" in line for line in draft_robot(path).unsure)
    text = path.read_text()
    shape = '<collision><geometry><box size=".1 .1 .3"/></geometry></collision>'
    path.write_text(re.sub(r'(<link name="upper">)<inertial>.*?</inertial>', rf"\1{shape}", text, flags=re.S))
    (said,) = [line for line in draft_robot(path).unsure if "states no mass" in line]
    assert "upper" in said
    assert "lower" not in said
    path.write_text(re.sub(r'(<link name="upper">)<inertial>.*?</inertial>', r"\1", text, flags=re.S))
    with pytest.raises(SystemExit) as left:
        main(["init", str(path), "--out", str(tmp_path / "out"), "--yes"])
    assert left.value.code == 0
    assert "upper had no mass and got a tiny one" in capsys.readouterr().err


def test_the_command_says_the_link_and_repairs_a_copy(tmp_path, capsys):
    path = write(tmp_path, izz=0.01)
    before = path.read_bytes()
    with pytest.raises(SystemExit) as left:
        main(["init", str(path), "--out", str(tmp_path / "out")])
    said = capsys.readouterr().err
    assert left.value.code == 2
    assert "upper" in said
    assert "--repair" in said
    with pytest.raises(SystemExit) as left:
        main(["init", str(path), "--out", str(tmp_path / "out"), "--repair"])
    assert left.value.code == 0
    assert "repaired: upper" in capsys.readouterr().out
    assert path.read_bytes() == before
    robot = load_robot(tmp_path / "out" / "robot.yaml")
    assert robot.name == "arm"
    assert robot.model == "arm.repaired.urdf"


def test_yes_repairs_what_needs_it_and_nothing_else(tmp_path, capsys):
    path = write(tmp_path, izz=0.01)
    with pytest.raises(SystemExit) as left:
        main(["init", str(path), "--out", str(tmp_path / "out"), "--yes"])
    assert left.value.code == 0
    assert "repaired: upper" in capsys.readouterr().out
    assert load_robot(tmp_path / "out" / "robot.yaml").model == "arm.repaired.urdf"
    with pytest.raises(SystemExit) as left:
        main(["init", str(write(tmp_path)), "--out", str(tmp_path / "right"), "--yes"])
    assert left.value.code == 0
    assert not list((tmp_path / "right").glob("*.urdf"))


@pytest.mark.parametrize("answer", ["y", "n"])
def test_on_a_terminal_it_asks(tmp_path, answer, monkeypatch, capsys):
    path = write(tmp_path, izz=0.01)
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("typer.confirm", lambda *_, **__: answer == "y")
    with pytest.raises(SystemExit) as left:
        main(["init", str(path), "--out", str(tmp_path / "out")])
    assert left.value.code == (0 if answer == "y" else 2)
    assert "upper" in capsys.readouterr().err
    assert (tmp_path / "out" / "robot.yaml").exists() == (answer == "y")


@pytest.mark.parametrize(("mesh", "content"), [("part.dae", b"<COLLADA/>"), ("part.stl", bytes(84)), ("flat.obj", b"")])
def test_meshes_that_cannot_be_read_are_missing(tmp_path, mesh, content):
    (tmp_path / mesh).write_bytes(content or b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 3 4\n")
    path = write(tmp_path)
    shape = f'<collision><geometry><mesh filename="{mesh}"/></geometry></collision></link>\n  <link name="lower">'
    path.write_text(path.read_text().replace('</link>\n  <link name="lower">', shape))
    model = MujocoSimulator.from_robot(draft_robot(path).robot, path).model
    assert model.njnt == 2
    assert model.body("upper").mass[0] == 1.0
