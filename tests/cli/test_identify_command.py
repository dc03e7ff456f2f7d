"""`trueup identify` and `trueup gap --explain` as their users meet them."""

import json

import pytest

from report.run_folders import make_attribution, make_fit
from trueup.cli.main import main
from trueup.core.attribution import Attribution
from trueup.core.fit_result import FitResult
from trueup.core.results import Ladder
from trueup.dataset import Dataset, DatasetWriter
from trueup.errors import NotIdentifiable
from trueup.stages.demonstrating import demo_dataset

QUICK = """
schema: trueup.identify/1
fit: {kp: all, damping: all, frictionloss: all}
models: {}
data: {budget_s: 15}
solver: {max_iterations: 12, tolerance: 0.01}
"""


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    return demo_dataset(tmp_path_factory.mktemp("demo") / "data")


@pytest.fixture
def run(capsys):
    def call(*arguments):
        with pytest.raises(SystemExit) as left:
            main([str(argument) for argument in arguments])
        printed = capsys.readouterr()
        return left.value.code, printed.out, printed.err

    return call


@pytest.fixture
def quick(tmp_path):
    path = tmp_path / "quick.yaml"
    path.write_text(QUICK)
    return path


@pytest.mark.slow
def test_identify_climbs_a_rung(run, demo, quick, tmp_path):
    out = tmp_path / "fit"
    code, printed, said = run("identify", demo, "--robot", "demo_arm", "--config", quick, "--out", out, "--jobs", "1")
    assert code == 0, said
    assert "fitted" in printed
    assert "kp" in printed
    assert "status:" in printed + said
    names = {"fit.json", "model.fitted.xml", "robot.fitted.yaml", "isaac.actuators.yaml", "fit.samples.npz"}
    assert names | {"gap.json", "ladder.json", "report.html", "graybox.json"} <= {path.name for path in out.iterdir()}
    assert not (out / "checkpoints").exists(), "nothing is left of the search"
    ladder = Ladder.load(out / "ladder.json")
    assert [rung.name for rung in ladder.rungs] == ["command", "stock", "fitted"]
    assert ladder.rungs[-1].chosen
    fit = FitResult.load(out / "fit.json")
    rung = ladder.rungs[-1].splits["test"]["position"]["rmse"].total.value
    assert fit.errors["fitted"]["test"].value == pytest.approx(rung, rel=1e-3), "both judge the same model"
    stock = ladder.rungs[1].splits["test"]["position"]["rmse"].total.value
    assert fit.errors["nominal"]["test"].value == pytest.approx(stock, rel=1e-6)
    assert rung < 0.7 * stock
    assert Dataset(demo).runs == ("mujoco/fitted", "mujoco/stock")

    code, _, said = run("identify", demo, "--robot", "demo_arm", "--config", quick, "--out", out)
    assert code == 2
    assert "--overwrite" in said

    # The fitted robot is a robot like any other.
    code, _, said = run("replay", demo, "--robot", out / "robot.fitted.yaml", "--label", "mujoco/again")
    assert code == 0, said
    code, printed, _ = run("gap", demo, "--runs", "mujoco/fitted,mujoco/again", "--split", "test")
    assert code == 0
    assert "mujoco/again" in printed


@pytest.mark.slow
def test_an_unsure_fit_is_loud_and_a_useless_one_fails(run, demo, tmp_path):
    config = tmp_path / "weak.yaml"
    config.write_text("fit: {payload_z: all, kv: all}\nmodels: {}\ndata: {budget_s: 8}\nsolver: {max_iterations: 1}\n")
    code, _, said = run("identify", demo, "--robot", "demo_arm", "--config", config, "--out", tmp_path / "fit")
    assert code == 3
    assert "status: not-converged" in said
    assert "next:" in said
    assert json.loads((tmp_path / "fit" / "fit.json").read_text())["status"] == "not-converged"


@pytest.mark.long
@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("fit: {stiffness: all}", "no quantity 'stiffness'"),
        ("fit: {kp: [wrist]}", "are not a joint of the robot"),
        ("solver: {name: newton}", "not a choice"),
        ("data: {budget: 3}", "unknown keys ['budget']"),
        ("fit: {kp: {low: 9, high: 2}}", "contradict"),
        ("signals: {velocity: 1.0}", "must weigh position"),
    ],
)
def test_a_wrong_configuration_is_one_line(run, demo, tmp_path, text, expected):
    config = tmp_path / "wrong.yaml"
    config.write_text(text + "\n")
    code, _, said = run("identify", demo, "--robot", "demo_arm", "--config", config, "--out", tmp_path / "fit")
    assert code == 2
    assert expected in said
    assert len(said.removeprefix("looking for a start\n").strip().splitlines()) <= 2


@pytest.mark.long
def test_no_search_is_announced_that_does_not_begin(run, demo, tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").write_text("mine")
    for data, out in ((tmp_path / "empty", tmp_path / "fit"), (demo, tmp_path / "file")):
        code, _, said = run("identify", data, "--robot", "demo_arm", "--out", out)
        assert code == 2
        assert said.startswith("error: ")


@pytest.mark.long
def test_a_budget_ends_the_fit_and_says_so(run, demo, quick, tmp_path):
    given = ("identify", demo, "--robot", "demo_arm", "--config", quick, "--out", tmp_path / "fit")
    code, _, said = run(*given, "--budget", "30")
    assert code == 2
    assert "--budget has no unit" in said
    code, _, said = run(*given, "--budget", "1s")
    assert code == 3
    assert "stopped at the time limit" in said
    assert "Give it more time (--budget)" in said
    assert FitResult.load(tmp_path / "fit" / "fit.json").status == "not-converged"


def test_an_unknown_solver_lists_the_known(run, demo, tmp_path):
    code, _, said = run("identify", demo, "--robot", "demo_arm", "--solver", "bfgs", "--out", tmp_path / "fit")
    assert code == 2
    assert "gauss-newton" in said


def test_logs_without_motion_cannot_be_identified(run, demo, tmp_path):
    still = Dataset(demo)
    with DatasetWriter.create(tmp_path / "still", still.info) as writer:
        for name in still.ids:
            episode = still.episode(name)
            for series in (episode.measured, episode.command):
                series.signals["position"][:] = 0.1
            writer.append(episode)
    code, _, said = run("identify", tmp_path / "still", "--robot", "demo_arm", "--out", tmp_path / "fit")
    assert code == 3
    assert "no joint moves" in said


def test_explain_needs_a_robot(run, demo):
    code, _, said = run("gap", demo, "--explain")
    assert code == 2
    assert "--robot" in said


@pytest.fixture
def measured(run, demo):
    """The demo with a run of its stock model."""
    assert run("replay", demo, "--robot", "demo_arm", "--label", "mujoco/stock", "--overwrite")[0] == 0
    return demo


@pytest.mark.long
def test_a_measurement_outlives_an_explanation_that_fails(run, measured, tmp_path, monkeypatch):
    def fails(*_, **__):
        raise NotIdentifiable("no joint moves in these motions")

    monkeypatch.setattr("trueup.stages.explain", fails)
    out = tmp_path / "why"
    code, _, said = run("gap", measured, "--explain", "--robot", "demo_arm", "--out", out)
    assert code == 3
    assert "no joint moves" in said
    assert (out / "gap.json").is_file()
    assert (out / "report.html").is_file()


@pytest.mark.long
def test_a_new_gap_stands_beside_nothing_old(run, measured, tmp_path):
    out = tmp_path / "gap"
    out.mkdir()
    make_attribution(("yaw", "shoulder", "elbow")).save(out / "explain.json")
    assert run("gap", measured, "--out", out, "--runs", "mujoco/stock")[0] == 0
    assert not (out / "explain.json").exists()

    # A ladder of the same measurement stays, that of another goes.
    gap = json.loads((out / "gap.json").read_text())
    Ladder([], provenance=gap["provenance"]).save(out / "ladder.json")
    run("gap", measured, "--out", out, "--runs", "mujoco/stock", "--overwrite")
    assert (out / "ladder.json").exists()
    run("gap", measured, "--out", out, "--runs", "mujoco/stock", "--split", "test", "--overwrite")
    assert not (out / "ladder.json").exists()

    make_fit(("yaw", "shoulder", "elbow")).save(out / "fit.json")
    code, _, said = run("gap", measured, "--out", out, "--overwrite")
    assert code == 2
    assert "fit of another dataset" in said
    assert (out / "fit.json").exists()
    (out / "model.fitted.xml").write_text("<mujoco/>")
    code, _, said = run("close", measured, "--until", "gap", "--robot", "demo_arm", "--out", out, "--overwrite")
    assert code == 0, said
    assert not [name for name in ("fit.json", "model.fitted.xml") if (out / name).exists()]


@pytest.mark.slow
def test_explain_says_where_the_gap_comes_from(run, demo, tmp_path):
    run("replay", demo, "--robot", "demo_arm", "--label", "mujoco/stock", "--overwrite")
    code, printed, said = run("gap", demo, "--explain", "--robot", "demo_arm", "--out", tmp_path / "why")
    assert code == 0, said
    assert "where the gap comes from" in printed
    found = Attribution.load(tmp_path / "why" / "explain.json")
    assert found.split == "test"
    assert set(found.labels) == {"delay", "gains", "friction", "gravity", "inertia", "unexplained"}
    for shares in (*found.shares.values(), found.shares_total):
        assert sum(shares.values()) == pytest.approx(1.0)
    # The demo's hardware has other gains, friction and delay than its model; little is left without a reason.
    assert found.shares_total["unexplained"] < 0.2
    assert found.shares_total["gains"] + found.shares_total["delay"] + found.shares_total["friction"] > 0.5
    assert found.after.value < found.before.value
