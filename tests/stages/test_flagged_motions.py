"""Which motions are fitted and trained on: those that describe an unusual robot, but not those that were measured badly.

The robot is a pendulum on a servo, simulated in plain MuJoCo.
"""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from trueup.align import check_quality
from trueup.augment.config import preset
from trueup.core.episode import BROKEN_MEASUREMENT, Episode, EpisodeMeta, Flag
from trueup.core.quality import left_out
from trueup.core.timeseries import TimeSeries
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter
from trueup.errors import ConfigError, DataError
from trueup.identify import IdentifyConfig
from trueup.identify.config import DataChoice, SolverChoice
from trueup.identify.segments import usable
from trueup.robots import load_robot
from trueup.stages import augment, close, explain, fit, replay
from trueup.stages.importing import checked

MODEL = """<mujoco><option timestep="0.0025" integrator="implicitfast"/><worldbody><body name="l">
<joint name="j" axis="0 1 0" armature="{armature}" damping="0.05" frictionloss="{friction}" solreffriction="0.005 1"
 solimpfriction="0.99 0.999 0.001 0.5 2"/>
<inertial pos="0 0 -0.2" mass="0.3" diaginertia="0.004 0.004 0.0005"/></body></worldbody>
<actuator><position name="s" joint="j" kp="{kp}" kv="0.6" forcerange="-{most} {most}"/></actuator></mujoco>"""
ROBOT = "schema: trueup.robot/1\nname: pendulum\nmodel: model.xml\njoints: [{name: j}]\n"
ROBOT += "controller: {kind: model, command: position}\n"
# Follows badly in every motion, each in its own way.
SOFT = {"kp": 1.5, "most": 50.0, "armature": 0.03, "friction": 0.07}
SATURATING = {"kp": 14.0, "most": 0.6, "armature": 0.03, "friction": 0.07}
GOOD = {"kp": 40.0, "most": 50.0, "armature": 0.005, "friction": 0.01}


def recorded(name, truth, *, seed=0, seconds=5.0):
    """One motion at 200 Hz: a chirp with steps."""
    rng = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(MODEL.format(**truth))
    data = mujoco.MjData(model)
    time_s = np.arange(0.0, seconds, 0.005)
    rate = 1.6 * rng.uniform(0.7, 1.2)
    asked = 0.7 * rng.uniform(0.6, 1.0) * np.sin(2 * np.pi * (0.1 + rate * time_s / (2 * seconds)) * time_s)
    asked *= np.minimum(1.0, time_s / 0.5)
    for step_s in rng.uniform(1.0, seconds - 1.0, 3):
        asked[time_s >= step_s] += rng.uniform(-0.25, 0.25)
    position, torque = np.zeros(time_s.size), np.zeros(time_s.size)
    for row, target in enumerate(asked):
        position[row] = data.qpos[0]
        data.ctrl[0] = target
        mujoco.mj_step(model, data, 2)
        torque[row] = data.qfrc_actuator[0]
    position += 3e-4 * rng.standard_normal(time_s.size)
    return Episode(
        EpisodeMeta(name, split="train"),
        series(time_s, position=position, torque=torque),
        series(time_s, position=asked),
    )


def series(time_s, **signals):
    units = {"position": ("rad",), "torque": ("Nm",)}
    columns = {name: values[:, None] for name, values in signals.items()}
    return TimeSeries(time_s, ("j",), columns, {name: units[name] for name in columns})


def with_position(episode, change):
    signals = dict(episode.measured.signals)
    signals["position"] = change(signals["position"].copy())
    return replace(episode, measured=replace(episode.measured, signals=signals))


def stuck(values):
    values[300:600] = values[300]
    return values


def missing(values):
    values[300:400] = np.nan
    return values


def jumping(values):
    values[400:402] += 0.8
    return values


def late(episode, seed=0):
    """The same motion, read up to 6 ms late at random, and stamped when it was read."""
    stamps = episode.measured.time_s
    read = stamps + np.random.default_rng(seed).exponential(0.0015, stamps.size).clip(0.0, 0.006)
    read = np.maximum.accumulate(read) + 1e-6 * np.arange(stamps.size)
    signals = {name: np.interp(read, stamps, values[:, 0]) for name, values in episode.measured.signals.items()}
    return replace(episode, measured=series(read, **signals))


def interrupted(episode, gap_s=0.4):
    """Nothing was logged while the joint moved."""
    stamps = episode.measured.time_s
    rows = np.flatnonzero((stamps < 3.0) | (stamps >= 3.0 + gap_s))
    return replace(episode, measured=episode.measured.rows(rows))


KINDS = {
    "soft": (lambda: recorded("a", SOFT), "failed_execution", False),
    "saturating": (lambda: recorded("a", SATURATING), "failed_execution", False),
    "late stamps": (lambda: late(recorded("a", GOOD)), "jittering_stamps", False),
    "stuck": (lambda: with_position(recorded("a", GOOD), stuck), "frozen", True),
    "missing": (lambda: with_position(recorded("a", GOOD), missing), "nan", True),
    "jumping": (lambda: with_position(recorded("a", GOOD), jumping), "spike", True),
    "interrupted": (lambda: interrupted(recorded("a", GOOD)), "gap", True),
}


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_measured_badly_is_told_from_what_is_done_badly(kind):
    make, flag, broken = KINDS[kind]
    episode = checked(make())
    assert flag in {item.kind for item in episode.meta.flags}
    assert {item.kind for item in episode.meta.flags if item.broken} == ({flag} if broken else set())
    assert bool(episode.meta.why_dropped(drop_flagged=None)) == broken
    assert episode.meta.why_dropped(drop_flagged=False) == ()
    kept, why = usable({"val": [episode]}, drop_flagged=None)
    assert (kept == {}) == broken
    assert (why == {"val": {"a": flag}}) == broken


def test_a_warning_about_the_motion_still_is_one():
    episode = checked(recorded("a", SATURATING))
    assert episode.meta.warned
    assert "failed_execution" in episode.meta.why_dropped(drop_flagged=True)


def test_missing_torques_are_no_reason_to_leave_positions_out():
    episode = recorded("a", GOOD)
    episode.measured["torque"][100:400] = np.nan
    flags = check_quality(episode)
    assert [(flag.kind, flag.signal, flag.severity, flag.broken) for flag in flags] == [
        ("nan", "torque", "warning", False)
    ]
    command = Flag("nan", series="command", signal="torque")
    assert command.broken, "without its command a motion cannot be simulated"


def test_a_signal_without_a_value_is_left_out_with_a_note():
    episode = recorded("a", GOOD)
    episode.measured["torque"][:] = np.nan
    done = checked(episode)
    assert set(done.measured.signals) == {"position"}
    assert [(flag.kind, flag.signal, flag.severity) for flag in done.meta.flags] == [("empty_signal", "torque", "note")]
    nothing = recorded("b", GOOD)
    nothing.measured["position"][:] = np.nan
    assert "position" in checked(nothing).measured
    assert checked(nothing).meta.why_dropped(drop_flagged=None) == ("nan",)


def test_a_joint_without_a_torque_sensor_is_a_note():
    episode = recorded("a", GOOD)
    two = TimeSeries(
        episode.measured.time_s,
        ("j", "k"),
        {name: np.hstack([values, values]) for name, values in episode.measured.signals.items()},
        {"position": ("rad", "rad"), "torque": ("Nm", "Nm")},
    )
    two["torque"][:, 1] = np.nan
    flags = check_quality(replace(episode, measured=two))
    assert [(flag.kind, flag.joint, flag.severity) for flag in flags] == [("nan", "k", "note")]


def test_only_kinds_about_the_measurement_are_broken():
    assert not Flag("far_from_simulation").broken
    assert not Flag("blocked").broken
    for kind in BROKEN_MEASUREMENT:
        assert Flag(kind, signal="position").broken
        assert not Flag(kind, signal="position", severity="note").broken


def test_most_of_the_train_motions_are_never_left_out_unasked():
    good = [checked(replace(recorded("x", GOOD), meta=EpisodeMeta(f"good{k}"))) for k in range(2)]
    bad = [checked(replace(with_position(recorded("x", GOOD), stuck), meta=EpisodeMeta(f"bad{k}"))) for k in range(3)]
    kept, why = usable({"train": good + bad[:2], "val": bad}, drop_flagged=None)
    assert [log.id for log in kept["train"]] == ["good0", "good1"]
    assert "val" not in kept
    assert left_out(why)[0].startswith("2 motions of train left out: bad0 (frozen)")
    with pytest.raises(DataError, match="3 of 5: frozen in 3") as caught:
        usable({"train": good + bad}, drop_flagged=None)
    assert "keep_flagged: true" in str(caught.value)
    assert caught.value.exit_code == 2
    kept, why = usable({"train": good + bad}, drop_flagged=False)
    assert (len(kept["train"]), why) == (5, {})
    kept, why = usable({"train": good + bad}, drop_flagged=True)  # whoever asks for it gets it
    assert len(kept["train"]) == 2


def test_keeping_and_dropping_exclude_each_other():
    with pytest.raises(ConfigError, match="exclude each other"):
        DataChoice(keep_flagged=True, drop_flagged=True)


def written(folder, episodes):
    with DatasetWriter.create(folder, DatasetInfo(robot="pendulum")) as writer:
        for episode in episodes:
            writer.append(checked(episode))
    return Dataset(folder)


@pytest.fixture
def robot(tmp_path):
    (tmp_path / "model.xml").write_text(MODEL.format(**GOOD))
    (tmp_path / "robot.yaml").write_text(ROBOT)
    return load_robot(tmp_path / "robot.yaml")


@pytest.mark.long
def test_a_servo_that_saturates_is_fitted(tmp_path, robot):
    logs = [recorded(f"m{seed}", SATURATING, seed=seed, seconds=4.0) for seed in range(3)]
    data = written(
        tmp_path / "data", [*logs, with_position(replace(logs[0], meta=EpisodeMeta("z", split="train")), stuck)]
    )
    assert all(meta.warned for meta in data.metas)
    # The model knows the limit, and nothing else of this servo.
    (tmp_path / "model.xml").write_text(MODEL.format(**(GOOD | {"most": SATURATING["most"]})))
    config = IdentifyConfig(
        fit=dict.fromkeys(("kp", "armature", "frictionloss"), "all"),
        models={},
        data=DataChoice(budget_s=15.0),
        solver=SolverChoice(max_iterations=15),
    )
    found = fit(data, robot, tmp_path / "fit", config=config, jobs=1)
    assert found.fit.data["flagged"] == {"train": {"z": "frozen"}}
    assert found.fit["kp[j]"].value == pytest.approx(SATURATING["kp"], rel=0.05)
    assert found.fit["armature[j]"].value == pytest.approx(SATURATING["armature"], rel=0.1)


@pytest.mark.long
def test_broken_motions_stop_what_learns_from_them_unless_kept(tmp_path, robot):
    logs = [with_position(recorded(f"m{seed}", GOOD, seed=seed), stuck) for seed in range(3)]
    logs[0] = recorded("m0", GOOD)
    val = replace(recorded("val", GOOD, seed=7), meta=EpisodeMeta("val", split="val"))
    data = written(tmp_path / "data", [*logs, val])
    replay(data, robot)
    for learn in (
        lambda: fit(data, robot, tmp_path / "fit"),
        lambda: explain(data, robot),
        lambda: augment([data], tmp_path / "net", run="mujoco/stock"),
    ):
        with pytest.raises(DataError, match="2 of 3: frozen in 2"):
            learn()
    made = augment([data], tmp_path / "net", run="mujoco/stock", config=preset("moving-average"), drop_flagged=False)
    assert not [note for note in made.notes if "left out" in note]
    closed = close(data.path, robot, tmp_path / "closed", methods=["moving-average"], jobs=1, until="explain")
    assert [step.name for step in closed.result.failed] == ["explain"]
    assert "frozen in 2" in closed.result.failed[0].what


def test_a_training_says_what_it_leaves_out(tmp_path, robot):
    logs = [recorded(f"m{seed}", GOOD, seed=seed) for seed in range(3)]
    logs[1] = interrupted(logs[1])
    val = replace(recorded("val", GOOD, seed=7), meta=EpisodeMeta("val", split="val"))
    data = written(tmp_path / "data", [*logs, val])
    replay(data, robot)
    made = augment([data], tmp_path / "net", run="mujoco/stock", config=preset("moving-average"))
    assert "1 motion of train left out: m1 (gap)" in made.notes
