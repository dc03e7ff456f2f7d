"""`trueup.fit` on datasets with bad motions, on torque-driven robots, and after interruptions."""

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml

from identify.recovery_cases import SERVO, TORQUE, Truth, nominal_of
from trueup.core.episode import Flag
from trueup.core.fit_result import FitResult
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter
from trueup.errors import OutputExists
from trueup.identify import IdentifyConfig, Nominal, model_search
from trueup.identify.config import DataChoice, SolverChoice
from trueup.robots import load_robot
from trueup.sim import ReplaySettings, replay_episode
from trueup.stages import identifying
from trueup.stages.identifying import FITTED, explain, fit
from trueup.stages.replaying import STOCK

pytestmark = pytest.mark.long

QUICK = SolverChoice(max_iterations=8, tolerance=1e-2)
CONFIG = IdentifyConfig(fit={"damping": "all"}, models={}, solver=QUICK)
SPLITS = ("train", "train", "val", "test")


@pytest.fixture
def rig(tmp_path):
    robot, nominal = nominal_of(tmp_path, SERVO)
    return Truth(robot, nominal, {"damping[shoulder]": 0.9, "damping[elbow]": 0.5}), tmp_path / "arm.xml"


@pytest.fixture
def pendulum(tmp_path):
    robot, nominal = nominal_of(tmp_path, TORQUE)
    return Truth(robot, nominal, {"damping[shoulder]": 0.9, "damping[elbow]": 0.5}), tmp_path / "arm.xml"


def logs_of(truth, splits=SPLITS, **options):
    options = {"seconds": 4.0, **options}
    logs = [truth.log(seed + 1, name=f"log{seed}", **options) for seed in range(len(splits))]
    return [replace(log, meta=replace(log.meta, split=split)) for log, split in zip(logs, splits, strict=True)]


def stored(folder, logs):
    with DatasetWriter.create(folder, DatasetInfo(robot="arm")) as writer:
        for log in logs:
            writer.append(log)
    return Dataset(folder)


def test_a_robot_driven_by_torque_is_judged_by_the_windows_of_the_fit(pendulum, tmp_path):
    truth, model = pendulum
    logs = logs_of(truth, size=3.0)
    data = stored(tmp_path / "data", logs)
    assert truth.robot.replay.window_s is None
    found = fit(data, truth.robot, tmp_path / "fit", model=model, config=CONFIG, jobs=1)
    fitted = load_robot(tmp_path / "fit" / "robot.fitted.yaml")
    assert fitted.replay.window_s == 0.5
    assert {data.run_info(label)["settings"]["window_s"] for label in (STOCK, FITTED)} == {0.5}
    assert any("windows of 0.5 s" in note for note in found.notes)

    soft = Nominal(truth.robot, model, hard_friction=False).simulator
    test = logs[3]
    simulated = replay_episode(test, soft, ReplaySettings(window_s=0.5))["position"]
    per_joint = np.sqrt(np.mean((simulated - test.measured["position"]) ** 2, axis=0))
    assert found.fit.errors["nominal"]["test"].value == pytest.approx(per_joint.mean(), rel=1e-6)
    ladder = {rung.name: rung.splits["test"]["position"]["rmse"].total.value for rung in found.ladder.rungs}
    assert ladder["stock"] == pytest.approx(per_joint.mean(), rel=1e-6)
    assert ladder["fitted"] == pytest.approx(found.fit.errors["fitted"]["test"].value, rel=1e-3)
    why = explain(data, truth.robot, model=model, config=CONFIG, jobs=1)
    assert why.before.value == pytest.approx(per_joint.mean(), rel=1e-6)


def test_a_window_that_the_robot_states_is_the_one_that_judges(pendulum, tmp_path):
    truth, model = pendulum
    robot = replace(truth.robot, replay=replace(truth.robot.replay, window_s=1.0))
    config = replace(CONFIG, data=DataChoice(window_s=0.25))
    data = stored(tmp_path / "data", logs_of(truth, size=3.0))
    found = fit(data, robot, tmp_path / "fit", model=model, config=config, jobs=1)
    assert found.fit.data["window_s"] == 0.25
    assert data.run_info(FITTED)["settings"]["window_s"] == 1.0
    assert not any("window" in note for note in found.notes)


def test_a_servo_is_judged_on_whole_motions(rig, tmp_path):
    truth, model = rig
    data = stored(tmp_path / "data", logs_of(truth))
    found = fit(data, truth.robot, tmp_path / "fit", model=model, config=CONFIG, jobs=1)
    assert data.run_info(FITTED)["settings"]["window_s"] is None
    assert found.fit.data["replay_window_s"] is None


def test_motions_that_are_left_out_are_said_whatever_their_split(rig, tmp_path):
    truth, model = rig
    logs = logs_of(truth, ("train", "train", "train", "val", "val", "test", "test"))
    logs[0] = replace(logs[0], command=None)  # the first one: all that looks at one motion only meets it
    logs[3] = replace(logs[3], meta=replace(logs[3].meta, flags=(Flag("frozen", severity="warning"),)))
    lost = {**logs[5].measured.signals, "position": np.full_like(logs[5].measured["position"], np.nan)}
    logs[5] = replace(logs[5], measured=replace(logs[5].measured, signals=lost))
    data = stored(tmp_path / "data", logs)
    found = fit(data, truth.robot, tmp_path / "fit", model=model, config=CONFIG, jobs=1)
    kept = json.loads((tmp_path / "fit" / "fit.json").read_text())["data"]
    assert kept["episodes"] == ["log1", "log2"]
    assert kept["flagged"] == {"val": {"log3": "frozen"}}
    assert {split: list(own) for split, own in kept["refused"].items()} == {"train": ["log0"], "test": ["log5"]}
    assert "command" in kept["refused"]["train"]["log0"]
    assert "not finite" in kept["refused"]["test"]["log5"]
    for said in ("1 motion of train left out: log0", "1 motion of val left out: log3", "1 motion of test left out"):
        assert any(said in note for note in found.notes), found.notes
    why = explain(data, truth.robot, model=model, config=CONFIG, jobs=1)
    assert "log0" in why.statements[0]
    assert any("log5" in line for line in why.statements)


class Killed(BaseException):
    """Ctrl-C, in a form that a test can raise."""


def test_a_fit_that_was_killed_after_its_search_is_not_searched_again(rig, tmp_path, monkeypatch):
    truth, model = rig
    data, out = stored(tmp_path / "data", logs_of(truth)), tmp_path / "fit"
    plain = identifying.replay_unless_same

    def killed(*args, label, **options):
        if label == FITTED:
            raise Killed
        return plain(*args, label=label, **options)

    monkeypatch.setattr(identifying, "replay_unless_same", killed)
    with pytest.raises(Killed):
        fit(data, truth.robot, out, model=model, config=CONFIG, jobs=1)
    before = (out / "fit.json").read_bytes()
    monkeypatch.undo()
    steps = []
    resume = {"model": model, "jobs": 1, "resume": True, "on_progress": lambda *step: steps.append(step)}
    found = fit(data, truth.robot, out, config=CONFIG, **resume)
    assert not steps
    assert (out / "fit.json").read_bytes() == before
    assert [rung.name for rung in found.ladder.rungs][-2:] == ["stock", "fitted"]
    assert not (out / "checkpoints").exists()

    again = fit(data, truth.robot, out, config=CONFIG, **resume)
    assert not steps, "what is finished is kept"
    assert again.replayed[0].replayed == again.replayed[1].replayed == 0
    other = replace(CONFIG, fit={"frictionloss": "all"})
    with pytest.raises(OutputExists, match="configuration"):
        fit(data, truth.robot, out, config=other, **resume)
    assert (out / "fit.json").read_bytes() == before, "a good fit is not replaced by --resume"

    kept = FitResult.load(out / "fit.json")
    replace(kept, provenance={**kept.provenance, "trueup": "0.0.1"}).save(out / "fit.json")
    notes = fit(data, truth.robot, out, config=CONFIG, **resume).notes
    assert any("fit.json was made by trueup 0.0.1" in note for note in notes)


def test_a_fit_that_was_killed_between_two_models_goes_on_with_the_second(rig, tmp_path):
    truth, model = rig
    braked = {f"frictionloss[{joint}]": 0.6 for joint in truth.robot.joint_names}
    truth = Truth(truth.robot, truth.nominal, {**truth.values, **braked})
    data, out = stored(tmp_path / "data", logs_of(truth)), tmp_path / "fit"
    config = replace(CONFIG, models={"friction": ("frictionloss",)})

    def kill(name, progress):
        if name == "friction" and progress.iteration == 1:
            raise Killed

    with pytest.raises(Killed):
        fit(data, truth.robot, out, model=model, config=config, jobs=1, on_progress=kill)
    steps = []
    fit(
        data,
        truth.robot,
        out,
        model=model,
        config=config,
        jobs=1,
        resume=True,
        on_progress=lambda name, progress: steps.append((name, progress.iteration)),
    )
    assert {name for name, _ in steps} == {"friction", "friction, to the end", "friction, with torque"}
    assert steps[0][1] == 2
    whole = fit(data, truth.robot, tmp_path / "whole", model=model, config=config, jobs=1)
    resumed = json.loads((out / "fit.json").read_text())
    values = {item["name"]: item["value"] for item in resumed["parameters"]}
    assert values == pytest.approx(whole.fit.values, rel=1e-9)
    assert yaml.safe_load((out / "robot.fitted.yaml").read_text())["model"] == "model.fitted.xml"


def test_what_a_search_took_before_an_interruption_is_part_of_what_the_fit_took(rig, tmp_path, monkeypatch):
    truth, model = rig
    plain = model_search.solve

    def resumed(*args, **options):
        found = plain(*args, **options)
        return replace(found, solver={**found.solver, "seconds": found.solver["seconds"] + 1000.0})

    monkeypatch.setattr(model_search, "solve", resumed)
    found = fit(stored(tmp_path / "data", logs_of(truth)), truth.robot, tmp_path / "fit", model=model, config=CONFIG)
    assert [row.seconds > 1000.0 for row in found.fit.models] == [True]
    assert found.ladder.rungs[-1].seconds > 1000.0
