"""Several starts on a Ray cluster: the same result as here, whoever is killed."""

import dataclasses
import json

import numpy as np
import pytest

from core.ray_cases import NEEDS_RAY, QUIET, local_cluster, one_worker_killed
from identify.recovery_cases import Truth, arm
from trueup.cli.main import main
from trueup.core.ray_workers import Cluster
from trueup.core.time_limit import TimeLimit
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter
from trueup.errors import ConfigError
from trueup.identify import (
    IdentifyConfig,
    Nominal,
    Problem,
    SegmentRule,
    SolveSettings,
    make_segments,
    many_starts,
    solve,
)
from trueup.identify.config import SolverChoice, make_parameters
from trueup.robots import load_robot
from trueup.stages import fit

pytestmark = [*QUIET, NEEDS_RAY]
CLUSTER = Cluster("local")
CONFIG = IdentifyConfig(fit={"kp": "all", "damping": "all"}, models={}, solver=SolverChoice(starts=4))


@pytest.fixture(scope="module", autouse=True)
def cluster():
    with local_cluster():
        yield


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """A robot with its model, and three motions of it."""
    home = tmp_path_factory.mktemp("home")
    spec, model = arm(home)
    (home / "robot.yaml").write_text(json.dumps(dataclasses.replace(spec, folder=None).to_dict()))
    truth = Truth(spec, Nominal(spec, model), {"kp[shoulder]": 44.0, "kp[elbow]": 37.0, "damping[shoulder]": 0.9})
    with DatasetWriter.create(home / "data", DatasetInfo(robot="arm")) as writer:
        for number, split in enumerate(("train", "val", "test")):
            log = truth.log(number, seconds=2.5, name=split)
            writer.append(dataclasses.replace(log, meta=dataclasses.replace(log.meta, robot="arm", split=split)))
    return home


@pytest.fixture(scope="module")
def problem(home):
    robot = load_robot(home / "robot.yaml")
    nominal = Nominal(robot, home / "arm.xml")
    log = Dataset(home / "data").episode("train")
    segments, _ = make_segments([log], nominal.simulator, SegmentRule())
    return Problem(nominal, make_parameters({"kp": "all", "damping": "all"}, nominal), segments)


def same(one, other, *, but=("seconds",)):
    """Bit by bit, but for the time that it took."""
    for name in ("z", "residual", "jacobian"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert {**one.solver, **dict.fromkeys(but)} == {**other.solver, **dict.fromkeys(but)}
    assert (one.rms, one.agreement.text) == (other.rms, other.agreement.text)


@pytest.mark.long
@pytest.mark.parametrize("solver", ["auto", "cma-es"])
def test_the_result_is_the_same(problem, solver):
    settings = SolveSettings(solver=solver, starts=3, seed=2, max_evaluations=24)
    told = []
    here = solve(problem.with_parameters(problem.parameters), settings)
    there = solve(problem.with_parameters(problem.parameters), settings, cluster=CLUSTER, on_progress=told.append)
    same(here, there)
    assert [item.iteration for item in told] == [1, 2, 3]
    assert told[-1].evaluations == there.solver["evaluations"]


@pytest.mark.long
def test_what_was_begun_here_is_ended_there(problem, tmp_path):
    """Checkpoints say the same wherever they were written; finished starts are not searched from again."""
    settings = SolveSettings(solver="gauss-newton", starts=3)
    here = solve(problem.with_parameters(problem.parameters), settings, checkpoint=tmp_path / "base.json")
    files = {path: path.stat().st_mtime_ns for path in tmp_path.glob("base.start*.json")}
    assert len(files) == 3
    (tmp_path / "base.start1.gauss-newton.json").unlink()
    path = tmp_path / "base.json"
    there = solve(problem.with_parameters(problem.parameters), settings, checkpoint=path, cluster=CLUSTER)
    same(here, there, but=("seconds", "evaluations"))  # the derivatives at the end were simulated again
    again = {path: path.stat().st_mtime_ns for path in files}
    assert [path.name for path in files if files[path] != again[path]] == ["base.start1.gauss-newton.json"]


@pytest.mark.slow
def test_a_limit_ends_all_of_them(problem):
    settings = SolveSettings(solver="gauss-newton", starts=3)
    there = solve(problem.with_parameters(problem.parameters), settings, limit=TimeLimit.after(1e-6), cluster=CLUSTER)
    assert there.solver["stop"] == "time"


@pytest.mark.slow
def test_a_worker_that_is_killed_loses_nothing(home, tmp_path):
    robot = load_robot(home / "robot.yaml")
    data = Dataset(home / "data")
    here = fit(data, robot, tmp_path / "here", config=CONFIG, jobs=1)
    out = tmp_path / "there"
    with one_worker_killed(lambda: any(out.glob("checkpoints/*.start?.*"))) as killed:
        there = fit(data, robot, out, config=CONFIG, ray="local")
    assert killed
    one, other = here.fit.to_json(), there.fit.to_json()
    for tree in (one, other):
        tree["solver"].pop("seconds")
        tree["solver"].pop("evaluations")  # what was simulated when the worker was killed, was simulated again
        tree.pop("provenance")
        for row in tree["models"]:
            row.pop("seconds")
    assert one == other
    assert "starts end in the same best place" in one["solver"]["starts"]
    assert not (out / "checkpoints").exists()


@pytest.mark.long
def test_one_start_has_nothing_to_share(home, tmp_path, capsys):
    (tmp_path / "fit.yaml").write_text("fit: {kp: all}\n")
    options = ("--robot", home / "robot.yaml", "--config", tmp_path / "fit.yaml", "--ray", "local")
    with pytest.raises(SystemExit) as left:
        main([str(item) for item in ("identify", home / "data", *options, "--out", tmp_path / "out")])
    assert left.value.code == 2
    printed = capsys.readouterr().err
    assert "got solver: {starts: 1}; expected 2 or more" in printed
    assert "solver: {starts: 8}" in printed
    assert not (tmp_path / "out").exists()


@pytest.mark.long
def test_the_command(home, tmp_path, capsys):
    (tmp_path / "fit.yaml").write_text("fit: {kp: all, damping: all}\nmodels: {}\nsolver: {starts: 2}\n")
    options = ("--robot", home / "robot.yaml", "--config", tmp_path / "fit.yaml", "--ray", "local", "--jobs", 2)
    with pytest.raises(SystemExit) as left:
        main([str(item) for item in ("identify", home / "data", *options, "--out", tmp_path / "out")])
    printed = capsys.readouterr()
    assert left.value.code == 0, printed.err
    assert "2 of 2 starts end in the same best place" in printed.out + printed.err


def test_a_worker_with_another_model_is_refused(problem, tmp_path, monkeypatch):
    older = tmp_path / "older.xml"
    older.write_text(problem.nominal.path.read_text().replace('mass="0.6"', 'mass="0.7"'))

    def there(work, starts, *, begin, with_args, **_):
        (given,) = with_args
        begin(given)  # the same is the same
        begin(dataclasses.replace(given, problem=dataclasses.replace(given.problem, model=older)))

    monkeypatch.setattr(many_starts, "on_ray", there)
    with pytest.raises(ConfigError, match=r"makes of .*older\.xml is not that of the command"):
        solve(problem.with_parameters(problem.parameters), SolveSettings(starts=2), cluster=CLUSTER)
