"""Episodes in, GapResult out."""

import math

import numpy as np
import pytest

from trueup.core.episode import EpisodeMeta
from trueup.core.results import GapResult
from trueup.core.timeseries import TimeSeries, same_units
from trueup.errors import ConfigError, DataError, MissingSignal, NameMismatch, UnitError
from trueup.measure import COMMAND_RUN, Comparison, measure_gap

JOINTS = ("pan", "lift", "jaw")
UNITS = {"position": "rad", "velocity": "rad/s", "torque": "Nm"}


def series(position, time_s=None, joints=JOINTS, **signals):
    values = {"position": np.asarray(position, float), **{k: np.asarray(v, float) for k, v in signals.items()}}
    clock = np.arange(len(values["position"])) * 0.02 if time_s is None else time_s
    return TimeSeries(clock, joints, values, same_units({name: UNITS[name] for name in values}, joints))


def episode(number, errors, *, rows=50, split="train", command_error=None, **meta):
    """Joint j of run r is off by `errors[r] * (j + 1)` everywhere, so that its RMSE is that number."""
    rng = np.random.default_rng(number)
    position = np.cumsum(rng.normal(size=(rows, 3)), axis=0)
    offset = np.arange(1.0, 4.0)
    return Comparison(
        EpisodeMeta(id=f"e{number}", split=split, **meta),
        series(position),
        {label: series(position - error * offset) for label, error in errors.items()},
        None if command_error is None else series(position + command_error * offset),
    )


def test_value_is_the_mean_over_episodes_of_the_mean_over_scored_joints():
    # pan and lift are off by e and 2 e: mean 1.5 e; jaw (3 e) is not scored. e = 0.1 and 0.3: mean 0.3.
    items = [episode(0, {"stock": 0.1}), episode(1, {"stock": 0.3}, rows=500)]  # longer episodes weigh no more
    result = measure_gap(items, scored_joints=("pan", "lift"))
    found = result.runs["stock"]["all"]["position"]["rmse"]
    assert found.total.value == pytest.approx(1.5 * 0.2)
    assert {name: item.value for name, item in found.per_joint.items()} == pytest.approx(
        {"pan": 0.2, "lift": 0.4, "jaw": 0.6}
    )
    assert found.total.unit == "rad"
    assert found.episodes == 2
    # two episodes: Student's t with one degree of freedom, 12.706 * s / sqrt(2), s = 1.5 * 0.2 / sqrt(2): cut at 0
    assert found.total.high == pytest.approx(0.3 + 12.706 * 0.15, abs=1e-3)
    assert found.total.low == 0.0
    assert result.episodes["stock"]["e1"]["position"]["rmse"] == pytest.approx({"pan": 0.3, "lift": 0.6, "jaw": 0.9})
    assert result.joints == JOINTS
    assert result.scored_joints == ("pan", "lift")


def test_one_episode_has_no_interval():
    found = measure_gap([episode(0, {"stock": 0.1})]).runs["stock"]["all"]["position"]["rmse"]
    assert (found.total.low, found.total.high) == (None, None)
    assert found.per_joint["pan"].low is None


def test_splits_all_is_always_there():
    items = [episode(k, {"a": 0.1 * (k + 1)}, split=split) for k, split in enumerate(("test", "train", "", "train"))]
    runs = measure_gap(items, metrics=["rmse"]).runs["a"]
    assert set(runs) == {"train", "test", "all"}
    values = {split: metrics["position"]["rmse"].total.value for split, metrics in runs.items()}
    assert values == pytest.approx({"test": 2 * 0.1, "train": 2 * 0.3, "all": 2 * 0.25})
    assert runs["all"]["position"]["rmse"].episodes == 4
    assert set(measure_gap([episode(0, {"a": 0.1}, split="")]).runs["a"]) == {"all"}


def test_command_is_a_run_of_its_own_for_motion_only():
    base = episode(0, {"stock": 0.1})
    torque = np.ones((50, 3))
    measured = series(base.measured["position"], torque=torque)
    item = Comparison(
        base.meta,
        measured,
        {"stock": series(base.simulated["stock"]["position"], torque=torque)},
        series(base.measured["position"] + 0.2, torque=5.0 * torque),
    )
    result = measure_gap([item])
    assert list(result.runs) == ["stock", COMMAND_RUN]
    assert set(result.runs[COMMAND_RUN]["all"]) == {"position"}
    assert set(result.runs["stock"]["all"]) == {"position", "torque"}
    assert result.runs[COMMAND_RUN]["all"]["position"]["rmse"].total.value == pytest.approx(0.2)
    only_torque = TimeSeries(measured.time_s, JOINTS, {"torque": torque}, same_units({"torque": "Nm"}, JOINTS))
    without = Comparison(base.meta, measured, item.simulated, only_torque)
    assert list(measure_gap([without]).runs) == ["stock"]


def test_paired_comparisons_each_pair_once():
    rng = np.random.default_rng(0)
    items = [
        episode(k, {"stock": e, "fitted": 0.5 * e, "other": e}, command_error=0.9 * e, split="train")
        for k, e in enumerate(rng.uniform(0.1, 0.3, 12))
    ]
    result = measure_gap(items, metrics=["rmse", "mae"])
    pairs = [(item.run, item.baseline) for item in result.paired if item.split == "all"]
    assert sorted(pairs) == sorted(
        [("stock", "command"), ("fitted", "command"), ("other", "command"), ("fitted", "stock"), ("other", "stock")]
    )
    verdicts = {(i.run, i.baseline): (i.verdict, i.relative) for i in result.paired if i.split == "all"}
    assert verdicts["fitted", "stock"] == ("better", pytest.approx(-0.5))
    assert verdicts["stock", "command"] == ("worse", pytest.approx(1.0 / 0.9 - 1.0))
    assert verdicts["other", "stock"] == ("undecided", pytest.approx(0.0, abs=1e-12))
    assert {item.metric for item in result.paired} == {"rmse"}
    first = measure_gap(items, metrics=["rmse"], runs=["fitted", "stock"]).paired
    assert {(item.run, item.baseline) for item in first} == {("stock", "fitted")}


def test_runs_on_different_episodes_are_paired_on_their_intersection():
    items = [
        episode(0, {"a": 1.0, "b": 0.5}),
        episode(1, {"a": 9.0}),
        episode(2, {"a": 1.0, "b": 0.6}),
        episode(3, {"b": 0.1}),
    ]
    result = measure_gap(items, metrics=["rmse"])
    (pair,) = [item for item in result.paired if item.split == "all"]
    assert pair.difference.value == pytest.approx(2.0 * (0.55 - 1.0))
    assert result.settings["missing_episodes"] == {"a": ["e3"], "b": ["e1"]}
    assert result.runs["a"]["all"]["position"]["rmse"].episodes == 3
    assert set(result.episodes["b"]) == {"e0", "e2", "e3"}


def test_groups_only_where_more_than_one_value_was_recorded():
    items = [
        episode(0, {"a": 0.1}, payload_kg=0.0, unit="left"),
        episode(1, {"a": 0.3}, payload_kg=1.5, unit="left"),
        episode(2, {"a": 0.5}, payload_kg=1.5),
        episode(3, {"a": 9.0}),
    ]
    groups = measure_gap(items, metrics=["rmse"]).groups
    assert list(groups) == ["payload_kg"]
    assert list(groups["payload_kg"]) == ["0", "1.5"]
    assert groups["payload_kg"]["1.5"]["a"]["position"]["rmse"].total.value == pytest.approx(2.0 * 0.4)
    assert groups["payload_kg"]["0"]["a"]["position"]["rmse"].total.value == pytest.approx(2.0 * 0.1)


def test_joints_are_matched_by_name():
    base = episode(0, {"stock": 0.1})
    order = ("jaw", "pan", "lift")
    turned = Comparison(base.meta, base.measured, {"stock": base.simulated["stock"].select(order)})
    assert measure_gap([turned]).to_json() == measure_gap([base]).to_json()
    # another order of the measured joints in a later episode
    later = episode(1, {"stock": 0.2})
    other = Comparison(later.meta, later.measured.select(order), {"stock": later.simulated["stock"]})
    assert measure_gap([base, other]).to_json() == measure_gap([base, later]).to_json()


def test_undefined_joints_are_left_out_of_means():
    rng = np.random.default_rng(0)
    position = rng.normal(size=(60, 3))
    position[:, 2] = 0.1  # rests: no correlation
    item = Comparison(EpisodeMeta(id="a"), series(position), {"s": series(position + np.array([0.0, 0.0, 0.3]))})
    found = measure_gap([item, episode(1, {"s": 0.1})]).runs["s"]["all"]["position"]["pearson"]
    assert found.total.value == pytest.approx(1.0)
    assert found.per_joint["jaw"].value == pytest.approx(1.0)  # of the one episode in which it moves
    alone = measure_gap([item]).runs["s"]["all"]["position"]["pearson"]
    assert math.isnan(alone.per_joint["jaw"].value)
    assert alone.total.value == pytest.approx(1.0)


def test_a_joint_that_rests_is_not_related_to_its_noise():
    rng = np.random.default_rng(0)
    position = np.cumsum(rng.normal(size=(60, 3)), axis=0)
    position[:, 1] = 0.00153 * rng.integers(0, 3, 60)  # an encoder that flickers
    velocity = rng.normal(size=(60, 3))
    measured = series(position, velocity=velocity, torque=velocity)
    simulated = series(position + 0.02, velocity=velocity + 0.1, torque=velocity + 0.1)
    found = measure_gap([Comparison(EpisodeMeta(id="a"), measured, {"s": simulated})]).runs["s"]["all"]
    for signal in ("position", "velocity"):
        for name in ("nrmse", "r2", "pearson", "ccc"):
            values = {joint: item.value for joint, item in found[signal][name].per_joint.items()}
            assert math.isnan(values["lift"]), (signal, name)
            assert math.isfinite(values["pan"])
            assert found[signal][name].total.value == pytest.approx((values["pan"] + values["jaw"]) / 2.0)
        assert math.isfinite(found[signal]["rmse"].per_joint["lift"].value)
    assert math.isfinite(found["torque"]["nrmse"].per_joint["lift"].value)  # a joint at rest bears changing loads


def test_restarts_reach_the_metrics():
    time_s = np.arange(100) * 0.02
    position = np.tile(np.sin(3.0 * time_s)[:, None], (1, 3))
    starts = np.array([0, 50])
    jump = (np.arange(100) >= 50)[:, None] * 1.0
    items = [Comparison(EpisodeMeta(id="a"), series(position), {"s": series(position + jump)}, starts=starts)]
    assert measure_gap(items).runs["s"]["all"]["position"]["smoothness"].total.value == pytest.approx(0.0, abs=1e-9)


def test_large_gap_ratio_uses_tau_and_only_angles():
    item = episode(0, {"s": 0.2})  # off by 0.2, 0.4, 0.6
    units = {"position": ("rad", "rad", "m")}
    mixed = Comparison(
        item.meta,
        TimeSeries(item.measured.time_s, JOINTS, item.measured.signals, units),
        {"s": TimeSeries(item.measured.time_s, JOINTS, item.simulated["s"].signals, units)},
    )
    found = measure_gap([item]).runs["s"]["all"]["position"]["large_gap_ratio"]
    assert [entry.value for entry in found.per_joint.values()] == [0.0, 0.0, 1.0]
    result = measure_gap([mixed], tau_rad=0.3, scored_joints=("pan", "lift"))
    found = result.runs["s"]["all"]["position"]["large_gap_ratio"]
    assert [entry.value for entry in found.per_joint.values()] == [0.0, 1.0, pytest.approx(math.nan, nan_ok=True)]
    assert found.total.value == 0.5
    assert result.settings["tau_rad"] == 0.3
    rmse = result.runs["s"]["all"]["position"]["rmse"]
    assert [entry.unit for entry in rmse.per_joint.values()] == ["rad", "rad", "m"]
    with pytest.raises(UnitError, match=r"different units for position.*m, rad"):
        measure_gap([mixed])


def test_saturation_needs_limits():
    torque = np.array([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [-3.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    measured, simulated = series(np.zeros((4, 3)), torque=torque), series(np.zeros((4, 3)), torque=torque / 2.0)
    item = Comparison(EpisodeMeta(id="a"), measured, {"s": simulated})
    found = measure_gap([item], torque_limits={"pan": 1.5}).runs["s"]["all"]["torque"]
    assert found["saturation_measured"].per_joint["pan"].value == 0.5
    assert found["saturation_simulated"].per_joint["pan"].value == 0.25
    assert math.isnan(found["saturation_measured"].per_joint["lift"].value)
    assert "saturation_measured" not in measure_gap([item]).runs["s"]["all"]["torque"]
    with pytest.raises(ConfigError, match="saturation_measured needs torque limits"):
        measure_gap([item], metrics=["saturation_measured"])
    with pytest.raises(NameMismatch, match="elbow"):
        measure_gap([item], torque_limits={"elbow": 1.0})
    with pytest.raises(ConfigError, match="positive"):
        measure_gap([item], torque_limits={"pan": 0.0})


def test_bodies():
    rng = np.random.default_rng(0)
    clock = np.arange(20) * 0.01
    position, rotation = rng.normal(size=(20, 2, 3)), np.tile(np.eye(3), (20, 2, 1, 1))
    units = {"body.position": ("m", "m"), "body.rotation": ("1", "1")}

    def bodies(shift, angle):
        turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
        signals = {"body.position": position + shift, "body.rotation": rotation @ turn}
        return TimeSeries(clock, (), signals, units, ("hand", "foot"))

    item = Comparison(EpisodeMeta(id="a"), bodies(0.0, 0.0), {"s": bodies(np.array([0.0, 3.0, 4.0]), 0.2)})
    result = measure_gap([item])
    found = result.runs["s"]["all"]
    assert found["body.position"]["position_norm"].total.value == pytest.approx(5.0)
    assert found["body.position"]["position_norm"].total.unit == "m"
    assert found["body.rotation"]["rotation_distance"].per_joint["foot"].value == pytest.approx(0.2)
    assert found["body.rotation"]["rotation_distance"].total.unit == "rad"
    assert result.episodes["s"]["a"]["body.position"]["position_norm"]["hand"] == pytest.approx(5.0)


def test_round_trip_and_order_of_runs(tmp_path):
    items = [episode(k, {"z": 0.1, "a": 0.2}, command_error=0.3, payload_kg=float(k)) for k in range(3)]
    result = measure_gap(items, seed=7, draws=300, window_s=0.5, provenance={"trueup": "x"})
    result.save(tmp_path / "gap.json")
    assert GapResult.load(tmp_path / "gap.json").to_json() == result.to_json()
    assert result.settings["runs"] == ["z", "a", "command"]
    assert (result.settings["window_s"], result.settings["seed"], result.settings["bootstrap_draws"]) == (0.5, 7, 300)
    assert measure_gap(items, seed=7, draws=300).runs == measure_gap(iter(items), seed=7, draws=300).runs


def test_only_what_was_asked_for():
    items = [episode(0, {"a": 0.1, "b": 0.2}, command_error=0.1)]
    result = measure_gap(items, runs=["b"], metrics=["mae", "position_norm"], signals=["position"])
    assert list(result.runs) == ["b"]
    assert list(result.runs["b"]["all"]["position"]) == ["mae"]


def test_names_that_are_not_there():
    item = episode(0, {"a": 0.1})
    with pytest.raises(MissingSignal, match=r"'e0' has no signal 'velocity' in measured: available: position"):
        measure_gap([item], signals=["velocity"])
    with pytest.raises(MissingSignal, match=r"no metric 'rsme'"):
        measure_gap([item], metrics=["rsme"])
    with pytest.raises(MissingSignal, match=r"the run 'b'.*available: a"):
        measure_gap([item], runs=["a", "b"])
    with pytest.raises(NameMismatch, match=r"elbow.*pan, lift, jaw"):
        measure_gap([item], scored_joints=["elbow"])
    with pytest.raises(DataError, match="no episodes"):
        measure_gap([])
    with pytest.raises(DataError, match="'e0' occurs twice"):
        measure_gap([item, item])
    with pytest.raises(MissingSignal, match="no episode has a run"):
        measure_gap([Comparison(item.meta, item.measured)])
    units = same_units({"torque": "Nm"}, JOINTS)
    torque = TimeSeries(item.measured.time_s, JOINTS, {"torque": np.ones((50, 3))}, units)
    with pytest.raises(MissingSignal, match="no signal in common"):
        measure_gap([Comparison(item.meta, item.measured, {"a": torque})])
    moving = Comparison(item.meta, series(item.measured["position"], velocity=np.ones((50, 3))), item.simulated)
    with pytest.raises(MissingSignal, match=r"'velocity' in a: available: position"):
        measure_gap([moving], signals=["velocity"])


def test_episodes_must_agree():
    first = episode(0, {"a": 0.1})
    joints = ("pan", "lift", "gripper")
    other = Comparison(EpisodeMeta(id="x"), series(np.zeros((5, 3)), joints=joints), {})
    with pytest.raises(NameMismatch, match=r"gripper.*jaw"):
        measure_gap([first, other])
    degrees = {"position": ("deg",) * 3}
    measured = TimeSeries(first.measured.time_s, JOINTS, first.measured.signals, degrees)
    with pytest.raises(UnitError, match="another unit"):
        measure_gap([first, Comparison(EpisodeMeta(id="y"), measured, {"a": measured})])


def test_comparison_refuses_what_does_not_fit():
    measured = series(np.zeros((5, 3)))
    meta = EpisodeMeta(id="m")
    with pytest.raises(NameMismatch, match=r"'m', stock.*gripper.*jaw"):
        Comparison(meta, measured, {"stock": series(np.zeros((5, 3)), joints=("pan", "lift", "gripper"))})
    with pytest.raises(DataError, match=r"'m', stock: the clock.*got 4 samples"):
        Comparison(meta, measured, {"stock": series(np.zeros((4, 3)))})
    with pytest.raises(DataError, match="command: the clock"):
        Comparison(meta, measured, {}, series(np.zeros((5, 3)), np.arange(5) * 0.021))
    mixed = TimeSeries(measured.time_s, JOINTS, measured.signals, {"position": ("rad", "rad", "m")})
    with pytest.raises(UnitError, match=r"position differs.*jaw.*got m; expected rad"):
        Comparison(meta, measured, {"stock": mixed})
    for starts in ([], [1], [0, 0], [0, 5], [0, 3, 2]):
        with pytest.raises(DataError, match="starts"):
            Comparison(meta, measured, {"stock": measured}, starts=np.array(starts, dtype=np.int64))
    with pytest.raises(NameMismatch, match="reserved"):
        Comparison(meta, measured, {"command": measured})


@pytest.mark.long
def test_episodes_are_forgotten_as_they_are_reduced():
    import gc
    import weakref

    alive: list[weakref.ref] = []

    def stream():
        for number in range(4):
            item = episode(number, {"a": 0.1})
            alive.append(weakref.ref(item))
            yield item
            del item
            gc.collect()
            assert sum(ref() is not None for ref in alive) <= 1  # the one that the loop variable holds

    assert measure_gap(stream(), metrics=["rmse"]).runs["a"]["all"]["position"]["rmse"].episodes == 4


def test_repetitions_of_a_motion_count_as_one_motion():
    """Six motions with two payloads each: the intervals are those of six, and the settings say so."""
    rng = np.random.default_rng(5)
    errors = rng.uniform(0.1, 0.5, 6)

    def measured(*, repeated):
        return measure_gap(
            [
                episode(2 * k + again, {"stock": e, "fitted": 0.9 * e}, source=f"plans/{k}" if repeated else "")
                for k, e in enumerate(errors)
                for again in range(2)
            ],
            metrics=["rmse"],
        )

    once = measure_gap([episode(k, {"stock": e, "fitted": 0.9 * e}) for k, e in enumerate(errors)], metrics=["rmse"])
    found, blind = measured(repeated=True), measured(repeated=False)

    def width(result):
        total = result.runs["stock"]["all"]["position"]["rmse"].total
        return total.high - total.low

    assert width(found) == pytest.approx(width(once))
    assert width(blind) < 0.8 * width(found)
    assert found.runs["stock"]["all"]["position"]["rmse"].episodes == 12
    pairs = [next(item for item in result.paired if item.split == "all") for result in (found, once)]
    assert pairs[0].difference.low == pytest.approx(pairs[1].difference.low)
    assert "over motions" in found.settings["interval"]
    assert "over episodes" in blind.settings["interval"]
