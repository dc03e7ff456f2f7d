"""From a virtual robot with markers to corrected bodies, how far they come apart, and the nearest robot."""

from dataclasses import replace

import numpy as np
import pytest

from lab.test_servo_robot import lab, wave
from trueup.augment import AugmentConfig
from trueup.augment.config import DataConfig, NetworkConfig, OptimizerConfig, WindowConfig
from trueup.cli.augment_eval import show
from trueup.core.augment_result import AugmentResult
from trueup.core.episode import Episode, EpisodeMeta
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter
from trueup.lab import VirtualRobot, draw_truth
from trueup.lab.spec import Markers, Mounting
from trueup.record.following import follow
from trueup.report import write_report
from trueup.report.body_units import evaluation_for_people, gap_for_people
from trueup.robots import load_robot
from trueup.stages import augment, evaluate, replay

BODIES = ("left_hip", "left_thigh", "left_shank", "left_foot")
CONFIG = AugmentConfig(
    "bodies",
    NetworkConfig("lstm", (12,)),
    data=DataConfig(
        signals=("body.position", "body.rotation"),
        reads=("body.velocity", "body.force"),
        stops=False,
        modular=True,
    ),
    window=WindowConfig("fixed", samples=50, draws=2),
    optimizer=OptimizerConfig(rate=1e-2),
    epochs=12,
)


def recorded(folder):
    spec = lab("kickbot_a", "mounting", mounting=Mounting(position_m=2e-3, rotation_rad=0.02))
    robot = VirtualRobot(draw_truth(replace(spec, markers=Markers(BODIES))))
    rng = np.random.default_rng(0)
    with DatasetWriter.create(folder, DatasetInfo(robot="kickbot_a")) as writer:
        for split, count in (("train", 6), ("val", 3), ("test", 3)):
            for number in range(count):
                robot.restart(seed=number)
                command = wave(900, size=0.3) * rng.uniform(-1, 1, 12)
                done = follow(robot, {"position": command}, step_s=0.001, every=10, silent_s=1.0)
                meta = EpisodeMeta(f"{split}{number}", robot="kickbot_a", split=split)
                writer.append(Episode(meta, done.measured, done.command))
    return Dataset(folder)


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bodies")
    data = recorded(folder / "data")
    description = load_robot("kickbot_a")
    replay(data, replace(description, simulation=replace(description.simulation, bodies=BODIES)), jobs=1)
    augment([data], folder / "model", run="mujoco/stock", config=CONFIG, name="net", jobs=1)
    return folder, data, evaluate(data, [folder / "model"], folder / "out", project=True, draws=200)


@pytest.mark.long
def test_bodies_come_apart_and_the_nearest_robot_does_not(evaluated):
    _, _, found = evaluated
    result = found.result
    assert [model.name for model in result.models] == ["net", "net-projected"]
    joints = ["left_hip_roll", "left_hip_pitch", "left_knee", "left_ankle", ""]
    assert list(result.gaps) == joints
    corrected, projected = (model.gaps for model in result.models)
    for joint in joints:
        assert result.gaps[joint].apart_max.value < 1e-6
        assert 1e-5 < corrected[joint].apart.value < corrected[joint].apart_max.value < 0.02
        assert corrected[joint].turned.value > 1e-4
        assert projected[joint].apart_max.value < 1e-6
        assert projected[joint].turned_max.value < 1e-5
    # What is measured is of a robot whose parts sit elsewhere, by 2 mm in each axis.
    assert result.measured_gaps[""].apart.value == pytest.approx(2e-3 * np.sqrt(8 / np.pi), rel=0.5)
    assert corrected[""].apart.low < corrected[""].apart.value < corrected[""].apart.high


def test_a_projection_is_a_run_of_its_own_and_is_kept(evaluated):
    folder, data, found = evaluated
    label = "mujoco/stock+net-projected"
    assert label in data.runs
    assert data.run_info(label)["inputs"]["projects"]["run"] == "mujoco/stock+net"
    gap = found.measurement.gap.runs
    for run in ("mujoco/stock+net", label):
        after, before = (
            gap[name]["test"]["body.position"]["position_norm"].total.value for name in (run, "mujoco/stock")
        )
        assert after < 0.95 * before
    again = evaluate(data, [folder / "model"], folder / "out", project=True, draws=200, overwrite=True)
    assert [(item.corrected, item.kept) for item in again.corrected] == [(0, 3), (0, 3)]
    assert AugmentResult.load(folder / "out" / "augment.json") == again.result


@pytest.mark.long
def test_pairs_say_whether_largest_distances_fall(evaluated):
    gap = evaluated[2].measurement.gap
    found = {
        pair.metric: pair
        for pair in gap.paired
        if (pair.run, pair.baseline, pair.split) == ("mujoco/stock+net", "mujoco/stock", "test")
        and pair.signal.startswith("body.")
    }
    assert set(found) == {"position_norm", "position_norm_max", "rotation_distance", "rotation_distance_max"}
    assert found["position_norm"].relative < -0.1


@pytest.mark.long
def test_people_are_told_millimeters_and_degrees(evaluated, capsys):
    folder, _, found = evaluated
    result, gap = evaluation_for_people(found.result), gap_for_people(found.measurement.gap)
    own, shown = found.result.gaps["left_knee"], result.models[0].gaps["left_knee"]
    assert (own.apart.unit, shown.apart.unit, shown.turned.unit) == ("m", "mm", "deg")
    before, after = (item.simulated[""]["body.position"]["left_foot"] for item in (found.result, result))
    assert after.rmse.value == pytest.approx(1e3 * before.rmse.value)
    assert (after.rmse.unit, after.mse.unit) == ("mm", "mm^2")
    assert after.mse.value == pytest.approx(1e6 * before.mse.value)
    turned = gap.runs["mujoco/stock"]["test"]["body.rotation"]["rotation_distance"].total
    plain = found.measurement.gap.runs["mujoco/stock"]["test"]["body.rotation"]["rotation_distance"].total
    assert turned.value == pytest.approx(np.degrees(plain.value))
    assert turned.unit == "deg"
    assert result.simulated[""]["position"]["left_knee"].rmse.unit == "rad"
    show(found.result)
    text = capsys.readouterr().out
    assert "body.position MSE [mm^2]" in text
    assert "all bodies" in text
    assert "bodies apart at their joints" in text
    page = write_report(folder / "out").read_text()
    for words in ("Where bodies are joined", "net-projected", "[mm", "all bodies"):
        assert words in page


def test_without_its_model_the_gaps_are_not_known(evaluated, tmp_path, monkeypatch):
    folder, data, _ = evaluated
    monkeypatch.setattr("trueup.stages.robot_model.find_model", lambda *_, **__: tmp_path / "none.xml")
    found = evaluate(data, [folder / "model"], tmp_path / "out", draws=100)
    assert found.result.gaps == {}
    assert any("at their joints is not known" in line for line in found.notes)


def some_measured(data, folder):
    """The same recording with fewer bodies seen, in another order, and one lost for a while."""
    bodies = ("left_foot", "left_thigh", "left_shank")
    with DatasetWriter.create(folder, DatasetInfo(robot="kickbot_a")) as writer:
        for episode in data.episodes():
            measured = episode.measured.select_bodies(bodies)
            signals = {name: np.array(values) for name, values in measured.signals.items()}
            for name in ("body.position", "body.rotation"):
                signals[name][10:30, 1] = np.nan
            writer.append(replace(episode, measured=replace(measured, signals=signals)))
    return Dataset(folder)


@pytest.mark.long
def test_fewer_bodies_may_be_measured_than_simulated(evaluated, tmp_path):
    folder, data, whole = evaluated
    fewer = some_measured(data, tmp_path / "data")
    description = load_robot("kickbot_a")
    replay(fewer, replace(description, simulation=replace(description.simulation, bodies=BODIES)), jobs=1)
    found = evaluate(fewer, [folder / "model"], tmp_path / "out", draws=200)
    assert found.result.joints_of("", "body.position") == ["left_foot", "left_thigh", "left_shank", ""]
    own, all_of_it = (item.result.simulated[""]["body.position"]["left_foot"].rmse.value for item in (found, whole))
    assert own == pytest.approx(all_of_it)
    assert list(found.result.gaps) == list(whole.result.gaps)
    assert list(found.result.measured_gaps) == ["left_knee", "left_ankle", ""]
    knee, before = (item.result.measured_gaps["left_knee"].apart.value for item in (found, whole))
    assert knee == pytest.approx(before, rel=0.05)
    assert found.result.models[0].gaps == whole.result.models[0].gaps
