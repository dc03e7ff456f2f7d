"""Networks over a dataset: runs that are made and kept, tables, warnings, files, and the command."""

import json
from dataclasses import replace

import numpy as np
import pytest

from augment.augment_cases import JOINTS, RATE_HZ, make_dataset
from augment.evaluation_cases import card_of, shift_folder
from augment.sat_cases import HEADS, SAMPLES, sat_of
from trueup.cli.main import main
from trueup.core.augment_result import ALL_JOINTS, ANY_CONDITION, AugmentResult
from trueup.core.model_card import ModelCard
from trueup.core.results import GapResult, Ladder
from trueup.core.step_times import StepTimes
from trueup.dataset import Dataset, DatasetWriter
from trueup.errors import ConfigError, DataError, MissingSignal, NameMismatch, OutputExists
from trueup.report import build_report
from trueup.robots import load_robot
from trueup.stages import evaluate, gap, replay
from trueup.stages.correcting import correct_unless_same
from trueup.stages.demonstrating import demo_dataset

pytestmark = pytest.mark.long

ARM = ("yaw", "shoulder", "elbow")
LABEL = "mujoco/stock+shift"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """The demo arm's dataset with its stock run."""
    path = demo_dataset(tmp_path_factory.mktemp("demo") / "data")
    replay(Dataset(path), load_robot("demo_arm"))
    return path


@pytest.fixture
def data(recorded, tmp_path):
    import shutil

    return Dataset(shutil.copytree(recorded, tmp_path / "data"))


@pytest.fixture
def make(tmp_path, recorded):
    """Folders of networks that add constants to the position."""
    rate_hz = float(round(Dataset(recorded)[0].measured.rate_hz))

    def folder(name="shift", shift=(0.0, 0.0, 0.0), **changes):
        card = card_of(name, **{"joints": ARM, "signals": ("position",), "rate_hz": rate_hz, **changes})
        return shift_folder(tmp_path / "models" / name, card, shift)

    return folder


def test_a_correction_is_a_run_that_everything_else_can_use(data, make, tmp_path):
    shift = np.array([0.01, -0.02, 0.0])
    found = evaluate(data, [make(shift=shift)], tmp_path / "out", draws=200)
    name = data.select(split="test")[0]
    episode = data.episode(name, runs=["mujoco/stock", LABEL])
    before, after = episode.run("mujoco/stock"), episode.run(LABEL)
    assert after["position"] - before["position"] == pytest.approx(np.broadcast_to(shift, (len(after), 3)), abs=1e-6)
    assert np.array_equal(after["velocity"], before["velocity"])
    base, info = data.run_info("mujoco/stock"), data.run_info(LABEL)
    for key in ("joint_map", "joints", "scored_joints", "settings", "torque_limits"):
        assert info[key] == base[key]
    assert info["inputs"]["network"]["files"] == dict(ModelCard.load(make(shift=shift)).files)
    assert set(data.run_ids(LABEL)) == set(data.select(split="test"))
    rung = Ladder.load(tmp_path / "out" / "ladder.json").rungs[-1]
    assert rung.name == "stock+shift"
    assert rung.splits["test"] == GapResult.load(tmp_path / "out" / "gap.json").runs[LABEL]["test"]
    assert [item.name for item in found.ladder.rungs] == ["command", "stock", "stock+shift"]
    assert gap(data, runs=[LABEL], split="test").gap.settings["robot"] == "demo_arm"


def test_the_tables_are_the_errors_of_the_runs(data, make, tmp_path):
    found = evaluate(data, [make(), make("other", (0.5, 0.5, 0.5))], tmp_path / "out", draws=200)
    assert AugmentResult.load(tmp_path / "out" / "augment.json").to_json() == found.result.to_json()
    nothing, worse = (model.cuts[ANY_CONDITION]["position"] for model in found.result.models)
    assert {cut.verdict for cut in nothing.values()} == {"undecided"}
    assert {cut.factor.value for cut in nothing.values()} == {1.0}
    squares, samples = np.zeros(3), 0
    for episode in data.episodes(data.select(split="test"), runs=["mujoco/stock+other"]):
        run = episode.run("mujoco/stock+other")
        rows = np.isin(episode.measured.time_s, run.time_s)
        error = episode.measured["position"][rows] - run["position"][: rows.sum()]
        squares, samples = squares + (error**2).sum(axis=0), samples + rows.sum()
    assert [worse[joint].mse.value for joint in ARM] == pytest.approx((squares / samples).tolist(), rel=1e-6)
    assert worse[ALL_JOINTS].verdict == "worse"
    assert [(item.model, item.baseline, item.verdict) for item in found.result.pairs if item.signal == "position"] == [
        ("other", "shift", "worse")
    ]


@pytest.fixture
def looker(tmp_path, recorded):
    """The folder of a SAT that looks at its oldest sample only."""
    rate_hz = float(round(Dataset(recorded)[0].measured.rate_hz))
    lags = np.full((HEADS, SAMPLES + 1), -40.0)
    lags[:, 0] = 0.0
    sat_of(ARM, lags=lags, rate_hz=rate_hz).save(tmp_path / "models" / "looker")
    return tmp_path / "models" / "looker"


def test_where_a_network_looks_is_in_the_file_and_in_the_report(data, make, looker, tmp_path):
    found = evaluate(data, [looker, make()], tmp_path / "out", draws=50)
    profile, nothing = (model.attention for model in AugmentResult.load(tmp_path / "out" / "augment.json").models)
    assert (profile, nothing) == (found.result.models[0].attention, None)
    assert profile.motions == len(data.select(split="test"))
    assert (profile.mean[-1], profile.oldest.value) == (pytest.approx(1.0), pytest.approx(1.0))
    assert not any("looks in the past" in line for line in found.notes)
    page = build_report(tmp_path / "out")
    assert "Where it looks in the past" in page
    assert "a longer history is worth a try" in page


def test_where_it_looks_is_left_out_without_its_weights(data, looker, tmp_path):
    (looker / "weights.safetensors").unlink()
    found = evaluate(data, [looker], tmp_path / "out", draws=50)
    assert found.result.models[0].attention is None
    (note,) = (line for line in found.notes if "looks in the past" in line)
    assert note.startswith("where looker looks in the past is not shown: ")
    assert "Where it looks in the past" not in build_report(tmp_path / "out")


def test_a_correction_is_kept_until_something_that_made_it_changes(data, make, tmp_path):
    folder = make(shift=(0.1, 0.0, 0.0))

    def made():
        (summary,) = evaluate(data, [folder], tmp_path / "out", overwrite=True, draws=50).corrected
        return summary.corrected, summary.kept

    count = len(data.select(split="test"))
    assert made() == (count, 0)
    assert made() == (0, count)
    make(shift=(0.2, 0.0, 0.0))
    assert made() == (count, 0)
    values = data.episode(data.run_ids(LABEL)[0], runs=["mujoco/stock", LABEL])
    added = values.run(LABEL)["position"] - values.run("mujoco/stock")["position"]
    assert added[:, 0] == pytest.approx(0.2, abs=1e-6)
    replay(data, load_robot("demo_arm"), delay_s=0.05, overwrite=True)
    assert made() == (count, 0)
    (summary,) = evaluate(data, [folder], tmp_path / "out", split="val", overwrite=True, draws=50).corrected
    assert (summary.corrected, summary.kept) == (len(data.select(split="val")), 0)
    assert len(data.run_ids(LABEL)) == count + summary.corrected


def test_a_network_for_other_joints_is_refused_before_anything_is_written(data, make, tmp_path):
    with pytest.raises(NameMismatch, match=r"it needs \[hip, knee\], there are \[yaw, shoulder, elbow\]"):
        evaluate(data, [make(joints=("hip", "knee"), shift=(0.0, 0.0))], tmp_path / "out")
    assert data.runs == ("mujoco/stock",)


def test_rates_below_that_of_the_network_are_refused_and_above_it_noted(data, make, tmp_path):
    rate_hz = float(round(data[0].measured.rate_hz))
    with pytest.raises(DataError, match="too few samples per second"):
        evaluate(data, [make("fast", rate_hz=2 * rate_hz)], tmp_path / "out")
    found = evaluate(data, [make("slow", (0.1, 0.1, 0.1), rate_hz=rate_hz / 2)], tmp_path / "out", draws=50)
    (line,) = [line for line in found.notes if "samples per second" in line]
    assert f"stock+slow: mujoco/stock has {rate_hz:g} samples per second, and the network sees {rate_hz / 2:g} " in line
    assert line in found.result.notes


def test_uneven_stamps_are_not_called_another_rate(make, tmp_path):
    data = Dataset(demo_dataset(tmp_path / "data"))
    with DatasetWriter.create(tmp_path / "uneven", data.info) as writer:
        for name in data.ids:
            episode = data.episode(name)
            stamps = episode.measured.time_s.copy()
            stamps[10:] += 0.4 * (stamps[1] - stamps[0])  # a message that was late once
            writer.append(replace(episode, measured=replace(episode.measured, time_s=stamps)))
    uneven = Dataset(tmp_path / "uneven")
    replay(uneven, load_robot("demo_arm"))
    found = evaluate(uneven, [make(shift=(0.1, 0.1, 0.1))], tmp_path / "out", draws=50)
    (line,) = [line for line in found.notes if "interpolated" in line]
    assert "mujoco/stock has samples at uneven times, and the network sees" in line


def test_numbers_that_say_something_else_than_the_training_are_warned_of(data, make, tmp_path):
    replay(data, load_robot("demo_arm"), label="mujoco/other", delay_s=0.05)
    foreign = make(robot="panda")
    assert evaluate(data, [make("own")], tmp_path / "own", draws=50).warnings == ()
    found = evaluate(data, [foreign], tmp_path / "out", run="mujoco/other", split="val", draws=50)
    assert found.result.notes[:2] == found.warnings
    here, seen = found.warnings
    assert here == "trained to correct mujoco/stock of panda, used here on mujoco/other of demo_arm: shift"
    assert seen.startswith("'val' may hold motions that a network was trained or chosen on")
    assert found.ladder.rungs[-1].name == "other+shift"


def test_intervals_that_promise_nothing_are_noted(make, tmp_path):
    """Few val motions, or none of the kind that is evaluated; cards that do not say are not accused."""
    data = make_dataset(tmp_path / "arm")
    assert {data.meta(name).condition for name in data.select(split="test")} == {"fast", "slow"}

    def network(name, conditions=None, half=(0.1, 0.1), **changes):
        said = {} if conditions is None else {"provenance": {"training": {"val_conditions": conditions}}}
        outputs = {("position", joint): {"interval": half} for joint in JOINTS}
        shift = {"joints": JOINTS, "rate_hz": RATE_HZ, "robot": "arm", "shift": (0.0, 0.0)}
        return make(name, outputs=outputs, **shift, **said, **changes)

    folders = [
        network("few", coverage_note="2 val motions; 9 are needed to promise 90 % coverage"),
        network("same", ["fast", "other", "slow"]),
        network("foreign", ["other", "slow"]),
        network("stranger", ["other"]),
        network("old"),
        network("unnamed", ["", "other"]),
        network("bare", ["other"], half=None),
    ]
    found = evaluate(data, folders, tmp_path / "out", draws=50)
    assert [line for line in found.result.notes if "intervals" in line] == [
        "few: its intervals promise nothing: 2 val motions; 9 are needed to promise 90 % coverage",
        "fast motions: no such motions chose the intervals of foreign, stranger; they may cover less",
        "slow motions: no such motions chose the intervals of stranger; they may cover less",
    ]
    assert set(found.result.notes) <= set(found.notes)


def test_which_run_is_corrected_must_be_clear(data, make, tmp_path):
    stranger = make("stranger", run="dart/stock")
    with pytest.raises(ConfigError, match=r"trained for dart/stock; available: mujoco/stock"):
        evaluate(data, [stranger], tmp_path / "out")
    with pytest.raises(ConfigError, match="trained for mujoco/stock, dart/stock"):
        evaluate(data, [make(), stranger], tmp_path / "out")
    with pytest.raises(MissingSignal, match="mujoco/stock"):
        evaluate(data, [make()], tmp_path / "out", run="mujoco/fitted")


def test_what_is_wrong_with_the_question_is_said(data, make, tmp_path):
    with pytest.raises(ConfigError, match="no network"):
        evaluate(data, [], tmp_path / "out")
    twin = shift_folder(tmp_path / "twin", ModelCard.load(make()), (0.0, 0.0, 0.0))
    with pytest.raises(ConfigError, match="two networks are called 'shift'"):
        evaluate(data, [make(), twin], tmp_path / "out")
    with pytest.raises(MissingSignal, match=r"no split 'tset': did you mean 'test'\? available: test, train, val, all"):
        evaluate(data, [make()], tmp_path / "out", split="tset")
    with pytest.raises(ConfigError, match="no label"):
        evaluate(data, [make("a b")], tmp_path / "out")
    evaluate(data, [make()], tmp_path / "out", draws=50)
    with pytest.raises(OutputExists):
        evaluate(data, [make()], tmp_path / "out")
    with pytest.raises(ConfigError, match="--project is for networks that correct bodies"):
        evaluate(data, [make()], tmp_path / "projected", project=True)
    assert not (tmp_path / "projected" / "gap.json").exists()


def test_a_motion_that_cannot_be_corrected_is_left_out_of_all_tables(data, make, tmp_path, monkeypatch):
    from trueup.stages import correcting

    bad = data.select(split="test")[0]
    original = correcting.corrected

    def failing(episode, run, card, network):
        if episode.id == bad and card.name == "shift":
            raise DataError("it is cursed")
        return original(episode, run, card, network)

    monkeypatch.setattr(correcting, "corrected", failing)
    found = evaluate(data, [make(), make("other")], tmp_path / "out", draws=50)
    count = len(data.select(split="test"))
    assert found.result.motions[ANY_CONDITION] == count - 1
    assert bad not in found.result.conditions_of
    assert any("it is cursed" in line for line in found.notes)
    assert any(f"1 of {count} motions are not in the tables" in line for line in found.notes)


def test_a_correction_of_which_nothing_comes_leaves_the_run_alone(data, make):
    class Broken:
        card = ModelCard.load(make(shift=(0.1, 0.0, 0.0)))

        def run(self, x):
            return np.full_like(x, np.nan)

    with pytest.raises(DataError, match="not finite"):
        correct_unless_same(data, Broken(), run="mujoco/stock", ids=data.ids)
    assert data.runs == ("mujoco/stock",)


def test_a_new_measurement_forgets_the_evaluation_of_an_old_one(data, make, tmp_path):
    evaluate(data, [make()], tmp_path / "out", draws=50)
    assert (tmp_path / "out" / "augment.json").is_file()
    gap(data, runs=["mujoco/stock"]).save(tmp_path / "out")
    assert not (tmp_path / "out" / "augment.json").exists()


def test_times_of_a_step_beside_a_network_come_with_it(data, make, tmp_path):
    loop = {
        "rate_hz": 1000.0,
        "overran_by_step": 1,
        "step": {
            "count": 3,
            "p50_us": 1.0,
            "p99_us": 2.0,
            "p999_us": 2.0,
            "max_us": 2.5,
            "bins": [[0.5, 1.5, 2], [1.5, 2.5, 1]],
        },
    }
    folder = make()
    own = ModelCard.load(folder).files["model.onnx"]
    StepTimes.of_loop(loop, machine="here", network=own).save(folder / "latency.json")
    found = evaluate(data, [folder], tmp_path / "out", draws=50)
    (model,) = found.result.models
    assert (model.latency.period_us, model.latency.missed, model.latency.machine) == (1000.0, 1, "here")
    assert not any("latency" in line for line in found.notes)
    for other in ("", "0" * 64):
        StepTimes.of_loop(loop, machine="here", network=other).save(folder / "latency.json")
        found = evaluate(data, [folder], tmp_path / "out", draws=50, overwrite=True)
        assert found.result.models[0].latency is None
        (line,) = [line for line in found.result.notes if "latency.json is not about this network" in line]
        assert line in found.notes
        assert line.endswith(f"trueup augment time {folder}")
    (folder / "latency.json").write_text(json.dumps({"schema": "trueup.latency/1", "count": "three"}))
    with pytest.raises(DataError, match=r"latency.json is broken"):
        evaluate(data, [folder], tmp_path / "other")


def command(*arguments):
    with pytest.raises(SystemExit) as left:
        main([str(item) for item in arguments])
    return left.value.code


def test_the_command_prints_tables_and_writes_a_report(data, make, tmp_path, capsys):
    gated = make("gated")
    card = ModelCard.load(gated)
    off = tuple(replace(item, gate=0.0, reason="no better on val") for item in card.outputs[:2])
    replace(card, outputs=(*off, card.outputs[2])).save(gated)
    harm = make("harm", (0.5, 0.5, 0.5))
    options = ["--model", gated, "--model", harm, "--out", tmp_path / "out"]
    assert command("augment", "eval", data.path, *options) == 0
    printed = capsys.readouterr()
    assert "position MSE [rad^2]" in printed.out
    assert " worse" in printed.out
    assert "gated leaves position of yaw, shoulder as simulated: no better on val" in printed.err
    assert "velocity [rad/s]" in printed.out
    assert (tmp_path / "out" / "report.html").is_file()
    assert command("augment", "eval", data.path, *options) == 2
    bar = ["--overwrite", "--fail-above", "mujoco/stock+harm:test:position.rmse=0.01"]
    assert command("augment", "eval", data.path, *options, *bar) == 3
