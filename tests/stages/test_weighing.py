"""What a robot carries is found, with an interval that holds it, from recordings with it and without it."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml

from check import arm_logs
from payload_arm import PLACE, described, record, save
from trueup.cli.main import main
from trueup.cli.payload import show
from trueup.core.payload_result import PayloadResult, Weighed
from trueup.errors import ConfigError, DataError, NameMismatch, OutputExists
from trueup.identify import IdentifyConfig
from trueup.robots import JointSpec, load_robot
from trueup.robots.written import robot_yaml
from trueup.stages import import_logs, payload

FEW = {
    "fit": {"kp": "all", "damping": "all", "frictionloss": "all", "armature": "all", "mass": {"prior_std": 0.1}},
    "data": {"budget_s": 6.0},
    "solver": {"max_iterations": 8, "tolerance": 0.01},
}


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """Logs of a servo arm without a payload, with 0.4 kg, and with nothing once more; and what the first run left."""
    folder = tmp_path_factory.mktemp("payload")
    _, robot, path = described(folder, "position")
    rng = np.random.default_rng(0)
    logs = {name: record(folder, "position", kg, rng, count=3) for name, kg in KG.items()}
    for name, motions in logs.items():
        save(folder / name, motions)
    (folder / "few.yaml").write_text(yaml.safe_dump(FEW))
    (folder / "robot.yaml").write_text(robot_yaml(replace(robot, model="arm.xml", folder=None)))
    config = IdentifyConfig.load(folder / "few.yaml")
    found = payload(folder / "free", folder / "loaded", robot, out=folder / "out", config=config, jobs=1)
    return folder, robot, path, found


KG = {"free": 0.0, "loaded": 0.4, "nothing": 0.0}


def again(arm, free="free", loaded="nothing", **options):
    """Without another fit."""
    folder, robot, _, _ = arm
    config = IdentifyConfig.load(folder / "few.yaml")
    return payload(folder / free, folder / loaded, robot, fit=folder / "out" / "free", config=config, jobs=1, **options)


def holds(interval, value):
    return interval[0] <= value <= interval[1]


@pytest.mark.long
def test_mass_and_center_are_found(arm):
    folder, _, _, found = arm
    own = found.weighed
    assert found.determined
    assert found.doubts == ()
    assert holds(own.interval_kg, 0.4)
    assert own.mass_kg == pytest.approx(0.4, rel=0.1)
    assert own.center_m == pytest.approx(PLACE, abs=0.01)
    assert all(own.center_seen)
    assert found.body == found.frame == "fore"
    assert found.held_out.with_it < 0.2 * found.held_out.without
    assert found.motions == {"free": 3, "loaded": 2}
    written = PayloadResult.load(folder / "out" / "payload.json")
    assert replace(written, provenance={}) == replace(found, provenance={})


@pytest.mark.long
def test_the_page_shows_what_is_printed(arm, capsys):
    def words(text):
        return re.sub(r"-?\d[\d.]*", "0", text)

    show(arm[3])
    page = (Path(__file__).parents[2] / "docs" / "payload.md").read_text()
    (shown,) = re.findall(r"```console\n(.*?)```", page, re.DOTALL)
    assert words(shown) == words(capsys.readouterr().out)


@pytest.mark.long
def test_the_model_with_it_is_left_for_plain_mujoco(arm):
    folder, _, _, found = arm
    empty, full = (
        mujoco.MjModel.from_xml_path(str(folder / "out" / name / "model.fitted.xml")) for name in ("free", "loaded")
    )
    more = full.body("fore").mass[0] - empty.body("fore").mass[0]
    assert more == pytest.approx(found.weighed.mass_kg, rel=0.1)  # the link itself may have moved a little
    assert load_robot(folder / "out" / "loaded" / "robot.fitted.yaml").joint_names == ("yaw", "lift", "elbow")


@pytest.mark.long
def test_two_recordings_of_one_robot_hold_no_payload(arm):
    found = again(arm)
    assert found.determined
    assert not found.weighed.carries
    assert found.weighed.interval_kg[1] < 0.1
    assert not any(found.weighed.center_seen)


@pytest.mark.long
def test_the_exchanged_are_told(arm, tmp_path):
    """A fit of what is loaded, and motions without: the payload comes out below zero, and is none."""
    folder, robot, _, _ = arm
    fit, config = tmp_path / "fit", IdentifyConfig.load(folder / "few.yaml")
    shutil.copytree(folder / "out" / "free", fit)
    shutil.copy(folder / "out" / "loaded" / "model.fitted.xml", fit / "model.fitted.xml")
    written = json.loads((fit / "fit.json").read_text())
    (link,) = [item for item in written["parameters"] if item["name"] == "mass[fore]"]
    link["value"] = float(mujoco.MjModel.from_xml_path(str(fit / "model.fitted.xml")).body("fore").mass[0])
    (fit / "fit.json").write_text(json.dumps(written))
    found = payload(folder / "loaded", folder / "nothing", robot, fit=fit, config=config, jobs=1)
    assert not found.determined
    assert any("exchanged" in doubt for doubt in found.doubts)
    assert found.weighed.mass_kg == 0.0


@pytest.mark.long
def test_a_vertical_axis_shows_no_weight(tmp_path, capsys):
    """Its inertia may be that of little far out, or of much near the axis."""
    model = """<mujoco><option timestep="0.001"/><worldbody><body name="table">
      <joint name="yaw" axis="0 0 1" range="-170 170" damping="0.2" armature="0.02" frictionloss="0.1"/>
      <inertial pos="0.1 0 0" mass="1.5" diaginertia="0.01 0.01 0.01"/></body></worldbody></mujoco>"""
    _, robot, path = described(tmp_path, "position")
    path.write_text(model)
    robot = replace(robot, joints=(JointSpec("yaw"),))

    def hang(kg):
        def change(own):
            own.body_mass[1] += kg
            own.body_inertia[1] += kg * 0.04

        return change

    rng = np.random.default_rng(3)
    for name, kg in (("free", 0.0), ("loaded", 0.5)):
        save(tmp_path / name, arm_logs.logs(robot, path, rng, count=2, change=hang(kg)))
    (tmp_path / "robot.yaml").write_text(robot_yaml(replace(robot, model="arm.xml", folder=None)))
    (tmp_path / "few.yaml").write_text(yaml.safe_dump({**FEW, "fit": {"kp": "all", "damping": "all"}}))
    code, out, err = call(
        tmp_path / "free", tmp_path / "loaded", "--robot", tmp_path / "robot.yaml",
        "--config", tmp_path / "few.yaml", "--jobs", 1, capsys=capsys,
    )  # fmt: skip
    assert code == 3, out + err
    assert "not determined" in out
    assert "the mass of the payload is not determined" in err


def call(*words, capsys):
    with pytest.raises(SystemExit) as left:
        main(["payload", *map(str, words)])
    return left.value.code, *capsys.readouterr()


@pytest.mark.long
def test_the_command_prints_and_writes_in_the_frame_of_a_site(arm, tmp_path, capsys):
    folder, robot, path, found = arm
    data = import_logs(folder / "loaded", tmp_path / "data", robot=robot).path
    code, out, err = call(
        folder / "free", data, "--robot", folder / "robot.yaml", "--model", path, "--body", "tool",
        "--fit", folder / "out" / "free", "--config", folder / "few.yaml", "--out", tmp_path / "out", "--jobs", 1,
        capsys=capsys,
    )  # fmt: skip
    assert code == 0, err
    assert "payload by the motion: 0." in out
    assert "center of mass in the frame of tool: x -0." in out
    assert "held out (1 motion): position RMSE" in out
    written = PayloadResult.load(tmp_path / "out" / "payload.json")
    assert (written.frame, written.body) == ("tool", "fore")
    assert written.weighed.mass_kg == pytest.approx(found.weighed.mass_kg, rel=0.05)
    assert written.weighed.center_m == pytest.approx(np.subtract(PLACE, (0.22, 0.0, 0.0)), abs=0.01)
    assert (tmp_path / "out" / "loaded" / "model.fitted.xml").is_file()


@pytest.mark.long
@pytest.mark.parametrize(
    ("change", "error", "said"),
    [
        ({"loaded": "free"}, ConfigError, "are the same"),
        ({"loaded": "nowhere"}, DataError, "there are no recordings"),
        ({"loaded": "strange"}, NameMismatch, "wrist"),
        ({"at": "hand"}, ConfigError, "'hand'"),
        ({"fit": "free"}, ConfigError, "holds no fit"),
        ({"out": "out"}, OutputExists, "is not empty"),
    ],
)
def test_what_is_wrong_is_said(arm, change, error, said):
    folder, robot, _, _ = arm
    if not (folder / "strange").exists():
        (folder / "strange").mkdir()
        arrays = dict(np.load(folder / "nothing" / "motion_0.npz"))
        np.savez(folder / "strange" / "m.npz", **{**arrays, "joints": np.array(["base", "arm", "wrist"])})
    given = {"free": "free", "loaded": "nothing", "fit": "out/free", "at": "", **change}
    own = {name: folder / given[name] for name in ("free", "loaded", "fit")}
    out = folder / change["out"] if "out" in change else None
    with pytest.raises(error, match=said) as raised:
        payload(own["free"], own["loaded"], robot, fit=own["fit"], at=given["at"], out=out, jobs=1)
    assert len(raised.value.summary) < 600


def test_an_interval_below_zero_carries_nothing():
    own = Weighed(0.0, (0.0, 0.02), True, (0.0,) * 3, ((0.0, 0.0),) * 3, (False,) * 3)
    assert not own.carries
    assert replace(own, interval_kg=(0.1, 0.2)).carries
