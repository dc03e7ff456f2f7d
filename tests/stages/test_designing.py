"""`design`: from a robot to a plan set, and what it says of it."""

import json
from dataclasses import replace

import numpy as np
import pytest

from identify.design_cases import SPEEDS, THRUSTS, ranged
from trueup.cli.main import main
from trueup.core.fit_result import FitResult
from trueup.errors import ConfigError, NameMismatch, NoPlan, OutputExists
from trueup.identify import IdentifyConfig
from trueup.identify.candidate import Nominal
from trueup.identify.quantities import quantity
from trueup.record import Box, DesignSettings, PlanSet, Workspace, check_plan
from trueup.robots import find_model, load_robot
from trueup.stages import design

CONFIG = IdentifyConfig(fit={"kp": "all", "damping": "all", "torque_offset": "all"})
QUICK = DesignSettings(duration_s=3.0, harmonics=3, evaluations=28)
FREE = Workspace(floor_m=None)


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arm")
    robot, _, scene = ranged(folder)
    return replace(robot, folder=folder), scene


def run(robot, out, **changes):
    usual = {"count": 2, "config": CONFIG, "workspace": FREE, "settings": QUICK, "seed": 4, "jobs": 1}
    limits = {"velocity_limits": SPEEDS, "acceleration_limits": THRUSTS}
    return design(robot, out, **{**usual, **limits, **changes})


def contents(path):
    files = {str(file.relative_to(path)): file.read_bytes() for file in path.rglob("*") if file.is_file()}
    for name in ("plans.json", "design.json"):
        tree = json.loads(files[name])
        del tree["provenance"]
        files[name] = json.dumps(tree).encode()
    return files


@pytest.fixture(scope="module")
def made(arm, tmp_path_factory):
    out = tmp_path_factory.mktemp("designs") / "set"
    return run(arm[0], out), out


@pytest.mark.long
def test_motions_are_stored_as_a_plan_set(arm, made):
    designed, out = made
    plans = PlanSet(out)
    assert plans.complete
    assert (plans.robot, plans.joints) == ("arm", arm[0].joint_names)
    assert list(plans.ids()) == ["excitation/00000", "excitation/00001"]
    for plan, own in zip(plans, designed.plans, strict=True):
        np.testing.assert_array_equal(plan.position, own.position)
        assert check_plan(plan, arm[1].limits, arm[1]) == ()
        assert (plan.kind, plan.split, plan.seed) == ("excitation", "train", 4)
        assert plan.end_s - plan.start_s == pytest.approx(3.0)
    assert np.abs(designed.plans[0].position - designed.plans[1].position).max() > 0.1
    assert plans.origin["by"] == "design"


def test_it_says_what_the_motions_promise(arm, made):
    designed, out = made
    items = {item.name: item for item in designed.parameters}
    assert set(items) == {f"{name}[{joint}]" for name in CONFIG.fit for joint in ("shoulder", "elbow")}
    # The priors of the catalogue: a factor of e^2 for gains, and a share of what the joint carries for offsets.
    assert items["kp[elbow]"].before == pytest.approx(2.0)
    robot, _ = arm
    carried = Nominal(robot, find_model(robot)).size("elbow").torque
    share = quantity("torque_offset").search.scale
    assert items["torque_offset[elbow]"].before == pytest.approx(share * carried)
    assert all(0 < item.designed < item.before for item in items.values())
    assert all(0 < item.random < item.before for item in items.values())
    ratios = [item.random / item.designed for item in items.values()]
    assert designed.gain == pytest.approx(np.exp(np.mean(np.log(ratios))))
    assert designed.gain > 1.0
    stored = json.loads((out / "design.json").read_text())
    assert stored["schema"] == "trueup.design/1"
    assert [row["designed"] for row in stored["parameters"]] == [item.designed for item in designed.parameters]


@pytest.mark.long
def test_an_interrupted_design_goes_on_and_other_threads_design_the_same(arm, made, tmp_path):
    _, out = made

    class Stop(Exception):
        pass

    def stop(done, total, skipped):
        raise Stop

    with pytest.raises(Stop):
        run(arm[0], tmp_path / "parts", progress=stop, jobs=2)
    assert not PlanSet(tmp_path / "parts").complete
    seen = []
    run(arm[0], tmp_path / "parts", progress=lambda *state: seen.append(state))
    assert seen == [(2, 2, 0)]
    assert contents(tmp_path / "parts") == contents(out)
    with pytest.raises(OutputExists, match="another plan set"):
        run(arm[0], tmp_path / "parts", seed=5)
    fewer = run(arm[0], tmp_path / "parts", seed=5, count=1, overwrite=True)
    assert len(PlanSet(tmp_path / "parts")) == len(fewer.plans) == 1


def test_bad_input_is_refused_before_anything_is_written(arm, tmp_path):
    robot, out = arm[0], tmp_path / "never"
    with pytest.raises(ConfigError, match="no velocity limit") as caught:
        run(robot, out, velocity_limits=None)
    assert "velocity_limits" in caught.value.hint
    with pytest.raises(ConfigError, match="not a joint of the robot"):
        run(robot, out, config=IdentifyConfig(fit={"kp": ["wrist"]}))
    with pytest.raises(ConfigError, match="no motion to design"):
        run(robot, out, count=0)
    with pytest.raises(NameMismatch, match="velocity limits for"):
        run(robot, out, velocity_limits={**SPEEDS, "wrist": 1.0})
    other = FitResult("ok", (), {}, (), {}, (), {}, provenance=provenance_of("leg"))
    with pytest.raises(NameMismatch, match="another robot"):
        run(robot, out, config=None, fit=other)
    with pytest.raises(ConfigError, match="not both"):
        run(robot, out, fit=other)
    assert not out.exists()


def provenance_of(name):
    robot = {"name": name, "joints": [{"name": "shoulder"}, {"name": "elbow"}]}
    return {"config": {"robot": robot, "model": "arm.xml", "identify": IdentifyConfig().to_json()}}


def test_a_robot_that_is_walled_in_is_told_so(tmp_path):
    wall = Workspace(floor_m=None, boxes=(Box("crate", (0.0, 0.0, 0.2), (1.2, 1.2, 0.4)),))
    with pytest.raises(NoPlan, match="in the way of every motion"):
        design(
            load_robot("demo_arm"),
            tmp_path / "out",
            count=1,
            config=CONFIG,
            workspace=wall,
            velocity_limits=dict.fromkeys(("yaw", "shoulder", "elbow"), 2.0),
            acceleration_limits=dict.fromkeys(("yaw", "shoulder", "elbow"), 9.0),
            settings=QUICK,
        )


def test_the_command_designs_for_what_a_fit_has_left_unsure(tmp_path, capsys):
    config = tmp_path / "fit.yaml"
    config.write_text("fit: {kp: [elbow], damping: all, delay_s: {shared: true}}\n")
    out = tmp_path / "set"
    options = ["--velocity-limit", "2.5", "--velocity-limit", "yaw=1.5", "--acceleration-limit", "12", "--seed", "3"]
    small = ["--count", "1", "--duration", "3", "--evaluations", "20", "--jobs", "1", *options]
    with pytest.raises(SystemExit) as left:
        main(["design", "--robot", "demo_arm", "--config", str(config), "--out", str(out), *small])
    printed = capsys.readouterr()
    assert left.value.code == 0, printed.err
    for word in ("kp[elbow]", "damping[yaw]", "delay_s", "designed", "random", "%"):
        assert word in printed.out
    plan = PlanSet(out)["excitation/00000"]
    speed = np.abs(plan.velocity).max(axis=0)
    assert np.all(speed <= np.array([1.5, 2.5, 2.5]) * (1 + 1e-6))
    assert speed[0] > 0.5

    refusals = {
        ("--velocity-limit", "yaw=fast"): "NUMBER or JOINT=NUMBER",
        ("--workspace", "kitchen"): "no workspace",
        ("--fit", str(tmp_path / "none.json")): "none.json",
    }
    for extra, words in refusals.items():
        with pytest.raises(SystemExit) as left:
            main(["design", "--robot", "demo_arm", "--out", str(tmp_path / "bad"), *small, *extra])
        printed = capsys.readouterr()
        assert left.value.code == 2
        assert words in printed.err
