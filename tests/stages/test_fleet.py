"""A fleet: each unit by itself, the same wherever it is done, and one that is not like the others is found."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import trueup.stages.fleet as fleet_stage
from core.ray_cases import one_worker_killed
from identify.recovery_cases import Truth, arm
from stages import fleet_errands
from trueup.cli.main import main
from trueup.core.fleet_result import FLEET_NAME, FleetResult, FleetUnit
from trueup.core.spread import go_to
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter
from trueup.errors import ConfigError, DataError, FormatError, OutputExists
from trueup.identify import IdentifyConfig, Nominal
from trueup.identify.config import SolverChoice
from trueup.robots import load_robot
from trueup.stages import fit
from trueup.stages.fleet import fleet

KP = {"arm-1": 41.0, "arm-2": 43.0, "arm-3": 45.0, "arm-4": 44.0, "arm-5": 30.0}
QUICK = IdentifyConfig(fit={"kp": "all", "damping": "all"}, solver=SolverChoice(max_iterations=6))


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """A robot with its model, and a dataset of five units, three motions each."""
    home = tmp_path_factory.mktemp("home")
    spec, model = arm(home)
    (home / "robot.yaml").write_text(json.dumps(replace(spec, folder=None).to_dict()))
    robot = load_robot(home / "robot.yaml")
    nominal = Nominal(robot, model)
    with DatasetWriter.create(home / "data", DatasetInfo(robot="arm")) as writer:
        for unit, kp in KP.items():
            truth = Truth(robot, nominal, {"kp[shoulder]": kp, "kp[elbow]": kp, "damping[shoulder]": 0.6})
            for number, split in enumerate(("train", "train", "test")):
                log = truth.log(10 * number + int(unit[-1]), seconds=4.0)
                meta = replace(log.meta, id=f"{unit}/{number}", unit=unit, robot="arm", split=split)
                writer.append(replace(log, meta=meta))
    return home


@pytest.fixture(scope="module")
def robot(home):
    return load_robot(home / "robot.yaml")


@pytest.fixture(scope="module")
def done(home, robot, tmp_path_factory):
    out = tmp_path_factory.mktemp("fleet") / "out"
    return out, fleet([home / "data"], robot, out, config=QUICK, jobs=2)


@pytest.mark.long
def test_what_units_have_in_common_and_which_is_not_like_them(done):
    _, found = done
    assert [unit.name for unit in found.units] == list(KP)
    assert found.signal == "position [rad]"
    for unit in found.units:
        assert unit.errors["fitted"]["test"] < 0.3 * unit.errors["stock"]["test"]
        for joint in ("shoulder", "elbow"):
            value = unit.parameters[f"kp[{joint}]"]
            assert value.low < value.value < value.high
            assert value.value == pytest.approx(KP[unit.name], rel=0.03)
    rows = {row.name: row for row in found.parameters}
    row = rows["kp[shoulder]"]
    assert (row.units, row.nominal, row.relative) == (5, 40.0, True)
    assert row.spread == pytest.approx(np.std(np.log(list(KP.values())), ddof=1), rel=0.15)
    assert row.low < np.exp(np.mean(np.log(list(KP.values())))) < row.high
    assert row.apart == ("arm-5",)
    assert rows["damping[shoulder]"].spread < 0.1
    assert rows["damping[shoulder]"].mean == pytest.approx(0.6, rel=0.1)


@pytest.mark.long
def test_each_unit_is_as_alone(done, home, robot, tmp_path):
    out, found = done
    alone = fit(Dataset(out / "arm-3" / "dataset"), robot, tmp_path / "alone", config=QUICK, jobs=1)
    unit = next(unit for unit in found.units if unit.name == "arm-3")
    assert {p.name: p.value for p in alone.fit.parameters} == {n: v.value for n, v in unit.parameters.items()}
    assert (out / "arm-3" / "report.html").exists() or (out / "arm-3" / "close.json").is_file()
    # The dataset that was given is as it was.
    assert Dataset(home / "data").runs == ()


@pytest.mark.long
def test_it_is_read_back_and_refuses_what_it_is_not(done, tmp_path):
    out, found = done
    assert FleetResult.load(out / FLEET_NAME) == found
    tree = json.loads((out / FLEET_NAME).read_text())
    (tmp_path / "other.json").write_text(json.dumps({**tree, "schema": "trueup.fit/1"}))
    with pytest.raises(FormatError, match="fleet"):
        FleetResult.load(tmp_path / "other.json")


@pytest.mark.slow
def test_a_worker_that_is_killed_loses_nothing(done, home, robot, tmp_path):
    """On a Ray cluster of two processes, one of which is killed in the middle of a fit."""
    with one_worker_killed(lambda: any(tmp_path.glob("out/*/checkpoints/*"))) as killed:  # a fit has begun
        found = fleet([home / "data"], robot, tmp_path / "out", config=QUICK, jobs=2, ray="local")
    assert killed
    _, before = done
    assert found.parameters == before.parameters
    assert [unit.errors for unit in found.units] == [unit.errors for unit in before.units]


@pytest.mark.long
def test_what_is_finished_is_kept(done, home, robot, tmp_path):
    out, before = done
    out = shutil.copytree(out, tmp_path / "out")
    files = {path: path.stat().st_mtime_ns for path in out.glob("*/fit.json")}
    with pytest.raises(OutputExists, match="not empty"):
        fleet([home / "data"], robot, out, config=QUICK, jobs=1)
    again = fleet([home / "data"], robot, out, config=QUICK, jobs=1, resume=True)
    assert again.parameters == before.parameters
    assert {path: path.stat().st_mtime_ns for path in files} == files


@pytest.mark.slow
def test_a_unit_that_fails_does_not_stop_the_others(home, robot, tmp_path):
    data = Dataset(home / "data")
    with DatasetWriter.create(tmp_path / "data", data.info) as writer:
        for name in ("arm-1/0", "arm-1/1", "arm-1/2"):
            writer.append(data.episode(name))
        broken = data.episode("arm-2/0")
        series = replace(broken.measured, joints=("left", "right"))
        command = replace(broken.command, joints=("left", "right"))
        writer.append(replace(broken, measured=series, command=command))
    found = fleet([tmp_path / "data"], robot, tmp_path / "out", config=QUICK, jobs=1)
    assert [unit.status == "failed" for unit in found.units] == [False, True]
    assert "left" in found.units[1].reason
    assert found.parameters[0].units == 1
    with pytest.raises(DataError, match="nothing could be done with any unit"):
        fleet([tmp_path / "out" / "arm-2" / "dataset"], robot, tmp_path / "none", config=QUICK, jobs=1)


@pytest.mark.long
def test_measured_only(home, robot, tmp_path):
    found = fleet([home / "data"], robot, tmp_path / "out", until="gap", jobs=1)
    assert {unit.status for unit in found.units} == {"measured"}
    assert found.parameters == ()
    assert set(found.units[0].errors) == {"command", "stock"}


@pytest.mark.slow
def test_the_command(home, tmp_path, capsys):
    (tmp_path / "fit.yaml").write_text("fit: {kp: all}\nsolver: {max_iterations: 4}\n")
    options = ("--robot", home / "robot.yaml", "--config", tmp_path / "fit.yaml", "--jobs", "1")
    with pytest.raises(SystemExit) as left:
        main([str(item) for item in ("fleet", home / "data", *options, "--out", tmp_path / "out")])
    printed = capsys.readouterr()
    assert left.value.code == 0, printed.err
    for word in (*KP, "kp[shoulder]", "not like the others", "spread"):
        assert word in printed.out + printed.err
    with pytest.raises(SystemExit) as left:
        main([str(item) for item in ("fleet", home / "data", *options, "--out", tmp_path / "out")])
    assert left.value.code == 2
    assert "--resume" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"datasets": []}, "no dataset"),
        ({"until": "replay"}, "no such last step"),
        ({"jobs": 0}, "jobs"),
        ({"ray": "127.0.0.1:1"}, "no Ray cluster"),
        ({"ray": "cluster"}, "no Ray cluster"),
    ],
)
def test_what_cannot_be(home, robot, tmp_path, changes, told):
    arguments = {"datasets": [home / "data"], **changes}
    with pytest.raises(ConfigError, match=told):
        fleet(arguments.pop("datasets"), robot, tmp_path / "out", config=QUICK, **arguments)


def test_nothing_of_others_is_deleted(home, robot, tmp_path):
    (tmp_path / "out" / "arm-1").mkdir(parents=True)
    (tmp_path / "out" / "arm-1" / "thesis.tex").write_text("years of work")
    with pytest.raises(OutputExists, match="no results of a fleet"):
        fleet([home / "data"], robot, tmp_path / "out", config=QUICK, overwrite=True)
    assert Path(tmp_path / "out" / "arm-1" / "thesis.tex").read_text() == "years of work"


@pytest.mark.long
def test_whatever_goes_wrong_with_a_unit_the_others_go_on(home, robot, tmp_path, monkeypatch):
    def close(data, *arguments, **options):
        if "arm-2" in str(data):
            raise np.linalg.LinAlgError("Singular\nmatrix")
        return closed(data, *arguments, **options)

    closed = fleet_stage.close
    monkeypatch.setattr(fleet_stage, "close", close)
    broken = tmp_path / "broken"
    broken.mkdir()
    (broken / "dataset.json").write_text("{")
    found = fleet([broken, home / "data"], robot, tmp_path / "out", until="gap", jobs=1)
    assert [unit.name for unit in found.units if unit.status == "failed"] == ["broken", "arm-2"]
    path = tmp_path / "out" / "arm-2" / "failed.txt"
    assert found.units[2].reason == f"LinAlgError: Singular matrix; where it was raised stands in {path}"
    assert "in close" in path.read_text()
    monkeypatch.setattr(fleet_stage, "close", closed)
    found = fleet([home / "data"], robot, tmp_path / "out", until="gap", jobs=1, resume=True)
    assert {unit.status for unit in found.units} == {"measured"}
    assert not path.exists()


@pytest.mark.long
def test_a_unit_that_kills_its_process_is_listed(home, robot, tmp_path, monkeypatch):
    monkeypatch.setattr(fleet_stage, "_closed", fleet_errands.end_for_one)
    found = fleet([home / "data"], robot, tmp_path / "out", until="gap", jobs=2)
    assert [unit.status for unit in found.units] == ["measured", "failed", "measured", "measured", "measured"]
    assert "a worker process ended" in found.units[1].reason


def test_results_that_are_not_on_this_disk_are_said(home, robot, tmp_path, monkeypatch):
    """Workers of a cluster wrote them to their own."""

    def elsewhere(work, tasks, *, begin, **_):
        assert begin is go_to  # who has not even the folder says so
        return ((task, fleet_stage._Outcome(FleetUnit(task.name, task.name, "ok"))) for task in tasks)

    monkeypatch.setattr(fleet_stage, "spread", elsewhere)
    with pytest.raises(DataError, match="what was found of a unit is not in") as error:
        fleet([home / "data"], robot, tmp_path / "out", until="gap", jobs=1)
    assert "share" in error.value.hint
