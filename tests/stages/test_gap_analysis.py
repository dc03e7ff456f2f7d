"""One command, six parts: what `gap` says of a robot whose payload, lag, conditions and torque are known."""

from dataclasses import replace

import numpy as np
import pytest

from trueup.core.engines import EngineComparison
from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.graybox_result import HELD_OUT, GrayboxResult
from trueup.core.timeseries import TimeSeries, same_units
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter, RunWriter
from trueup.report import build_report
from trueup.stages import gap

JOINTS = ("shoulder", "elbow")
UNITS = {"position": "rad", "velocity": "rad/s", "torque": "Nm"}
LOADS = (0.0, 1.0, 2.0, 3.0)
STEP_S, SECONDS = 0.01, 4.5
DELAY_S, PER_KG_S = 0.03, 0.01
LIMIT = 4.0
PARTS = {"payload", "lag", "saturation", "conditions", "engines", "blocks"}


def wave(number, at):
    """Position and velocity of a motion that begins and ends at rest, (T, 2) each."""
    rng = np.random.default_rng(number)
    w, phase, size = 2 * np.pi * rng.uniform(0.2, 0.6, 2), rng.uniform(0, 6, 2), rng.uniform(0.5, 0.8, 2)
    at = np.clip(at, 0.0, SECONDS)[:, None]
    angle, swell = at * w + phase, np.sin(np.pi * at / SECONDS) ** 2
    rate = np.pi / SECONDS * np.sin(2 * np.pi * at / SECONDS)
    return swell * size * np.sin(angle), size * (swell * w * np.cos(angle) + rate * np.sin(angle))


def series(signals):
    time_s = STEP_S * np.arange(len(signals["position"]))
    return TimeSeries(time_s, JOINTS, signals, same_units({name: UNITS[name] for name in signals}, JOINTS))


def episode(number, load, condition):
    """The robot lags by 30 ms and 10 ms per kilogram; its torque is a servo's with friction, and clipped."""
    rng = np.random.default_rng([number, int(load), len(condition)])
    at = STEP_S * np.arange(500)
    command, _ = wave(number, at)
    q, dq = wave(number, at - DELAY_S - PER_KG_S * load)
    tau = 40.0 * (command - q) - 1.0 * dq - 0.6 * np.tanh(dq / 0.05) + 0.1 * rng.normal(size=q.shape)
    measured = {
        "position": q + 0.0002 * rng.normal(size=q.shape),
        "velocity": dq,
        "torque": np.clip(tau, -LIMIT, LIMIT),
    }
    meta = EpisodeMeta(
        f"{condition}/{number}/{load:g}kg", payload_kg=load, condition=condition, source=f"plans/{number}"
    )
    near = {"position": q + 0.01 + 0.02 * load, "torque": 0.9 * measured["torque"]}
    far = {"position": q + 0.02 + 0.02 * load, "torque": 0.8 * measured["torque"]}
    runs = {"mujoco/stock": series(near), "dart/stock": series(far)}
    return Episode(meta, series(measured), series({"position": command}), simulated=runs)


EPISODES = [
    episode(number, load, condition) for number in range(5) for load in LOADS for condition in ("stand", "walk")
]


def dataset_of(folder, episodes, runs=("mujoco/stock", "dart/stock")):
    with DatasetWriter.create(folder, DatasetInfo(robot="arm")) as writer:
        for item in episodes:
            writer.append(replace(item, simulated={}))
    limits = dict.fromkeys(JOINTS, LIMIT)
    for label in runs:
        info = {"engine": label.split("/")[0], "scored_joints": list(JOINTS), "torque_limits": limits, "inputs": {}}
        with RunWriter(folder, label, run_info=info) as writer:
            for item in episodes:
                writer.append(item.id, item.simulated[label])
    return Dataset(folder)


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    folder = tmp_path_factory.mktemp("twins")
    measurement = gap(dataset_of(folder / "data", EPISODES), draws=500)
    measurement.save(folder / "out")
    return measurement, folder / "out"


def test_nothing_is_missing_and_the_files_are_read_back(found):
    measurement, folder = found
    assert measurement.engines.missing == {}
    assert EngineComparison.load(folder / "engines.json") == measurement.engines
    assert GrayboxResult.load(folder / "graybox.json").total[0].splits.keys() == {"train", HELD_OUT}
    assert build_report(folder).count('<section id="engines"') == 1


def test_a_linear_trend_is_called_straight(found):
    item = found[0].engines.trends["mujoco/stock"]["position"]["rmse"][""]
    assert (item.verdict, item.shape) == ("grows", "straight")
    assert item.slope.value == pytest.approx(0.02, abs=1e-4)
    assert item.slope.low <= 0.02 + 1e-5
    assert item.bend.low <= 1e-5


def test_a_pure_delay_is_the_lag_payload_by_payload_and_joint_by_joint(found):
    measurement = found[0]
    for load in LOADS:
        lag = measurement.gap.groups["payload_kg"][f"{load:g}"]["command"]["position"]["phase_lag"]
        for joint in JOINTS:
            assert lag.per_joint[joint].value == pytest.approx(DELAY_S + PER_KG_S * load, abs=2e-3)
    trend = measurement.engines.trends["command"]["position"]["phase_lag"][""]
    assert trend.slope.value == pytest.approx(PER_KG_S, abs=5e-4)
    assert trend.verdict == "grows"


def test_saturation_is_counted_on_both_sides_by_payload(found):
    for load in LOADS:
        metrics = found[0].gap.groups["payload_kg"][f"{load:g}"]["dart/stock"]["torque"]
        own = [np.abs(item.measured["torque"]) >= LIMIT for item in EPISODES if item.meta.payload_kg == load]
        assert metrics["saturation_measured"].total.value == pytest.approx(np.mean(own))
        assert metrics["saturation_simulated"].total.value == 0.0


def test_conditions_that_change_nothing_are_retraced(found):
    shift = next(item for item in found[0].engines.shifts if item.by == "condition")
    assert (shift.first, shift.second, shift.motions) == ("stand", "walk", 5)
    assert shift.share.high < 0.02
    assert shift.lag.low <= 0.0 <= shift.lag.high
    assert set(found[0].engines.inside) == {"stand", "walk"}


def test_the_nearer_engine_is_named_at_every_payload(found):
    for items in found[0].engines.nearer.values():
        position = next(item for item in items if (item.signal, item.metric) == ("position", "rmse"))
        run, verdict = position.run, position.verdict
        assert verdict == ("worse" if run == "dart/stock" else "better")
        assert abs(position.difference.value) == pytest.approx(0.01, rel=0.01)


@pytest.mark.long
def test_only_the_blocks_that_are_in_the_torque_are_worth_something(found):
    gained = {block.block: block.splits[HELD_OUT].reduction for block in found[0].graybox.total}
    assert found[0].graybox.settings["delay_s"] < 0.01
    assert gained["pd"].low > 0.0
    assert gained["friction"].low > 0.0
    for name in ("payload", "posture", "coupling"):
        assert gained[name].low <= 0.0


@pytest.mark.long
@pytest.mark.parametrize(
    ("change", "runs", "missing"),
    [
        ({"payload_kg": None}, None, {"payload"}),
        ({"payload_kg": 1.0}, None, {"payload"}),
        ({"condition": ""}, None, {"conditions"}),
        ({}, ("mujoco/stock",), {"engines"}),
    ],
)
def test_what_data_cannot_say_is_said(tmp_path, change, runs, missing):
    episodes = [replace(item, meta=replace(item.meta, **change)) for item in EPISODES[:16]]
    measurement = gap(dataset_of(tmp_path / "data", episodes, runs or ("mujoco/stock", "dart/stock")), draws=100)
    measurement.save(tmp_path)
    assert set(measurement.engines.missing) == missing
    page = build_report(tmp_path)
    for text in measurement.engines.missing.values():
        assert text.split("`")[0] in page


@pytest.mark.parametrize("kind", ["nan", "none"])
def test_without_torque_the_other_parts_are_there(tmp_path, kind):
    def mute(one):
        signals = {name: values for name, values in one.signals.items() if name != "torque"}
        if kind == "nan":
            signals["torque"] = np.full_like(one["torque"], np.nan)
        return series(signals)

    episodes = [replace(item, measured=mute(item.measured)) for item in EPISODES[:16]]
    measurement = gap(dataset_of(tmp_path / "data", episodes), draws=100)
    assert set(measurement.engines.missing) == {"saturation", "blocks"}
    assert "needs measured torque" in measurement.engines.missing["blocks"]
    assert measurement.graybox is None
    assert measurement.gap.settings["warnings"] == []
    (tmp_path / "graybox.json").write_text("of an earlier measurement")
    measurement.save(tmp_path)
    assert not (tmp_path / "graybox.json").exists()
    assert "Torque was not taken apart" in build_report(tmp_path)


@pytest.mark.long
def test_a_measurement_without_blocks_leaves_those_of_the_same_motions(found, tmp_path):
    """Of other motions they would say nothing true."""
    measurement, folder = found
    (tmp_path / "graybox.json").write_bytes((folder / "graybox.json").read_bytes())
    later = replace(measurement, graybox=None, blocks=False)
    later.save(tmp_path)
    assert GrayboxResult.load(tmp_path / "graybox.json").total == measurement.graybox.total
    origin = {**measurement.gap.provenance, "data_hash": "of other data"}
    replace(later, gap=replace(later.gap, provenance=origin)).save(tmp_path)
    assert not (tmp_path / "graybox.json").exists()
