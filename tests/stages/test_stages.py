import json
from dataclasses import replace

import numpy as np
import pytest

from dataset.store_cases import write_npz
from trueup.core.episode import Episode, EpisodeMeta, Flag
from trueup.core.results import Estimate, GapResult, MetricResult, Rung
from trueup.core.timeseries import TimeSeries
from trueup.dataset import Dataset, DatasetInfo, DatasetWriter, RunWriter
from trueup.dataset.importers.base import ImportOptions
from trueup.errors import ConfigError, DataError, MissingSignal, NameMismatch, OutputExists, TrueupError
from trueup.robots import ControllerSpec, JointSpec, find_model, load_robot
from trueup.sim import MujocoSimulator, ReplaySettings, replay_episode
from trueup.stages import close, gap, import_logs, replay
from trueup.stages.demonstrating import demo_dataset
from trueup.stages.importing import checked
from trueup.stages.ladder import choose, val_scores
from trueup.stages.replaying import replay_unless_same


@pytest.fixture
def demo(tmp_path):
    return Dataset(demo_dataset(tmp_path / "demo"))


def twin_dataset(folder, *, rename=None, scale=1.0, offset=0.0):
    """Logs that the demo arm's own simulator made, told in the words of another log."""
    robot = load_robot("demo_arm")
    simulator = MujocoSimulator.from_robot(robot, find_model(robot))
    time_s = np.arange(0, 4.0, 0.01)
    rename = rename or (lambda name: name)

    def told(series):
        position = (series["position"] - offset) / scale
        names = tuple(rename(name) for name in series.joints)
        return TimeSeries(series.time_s, names, {"position": position}, {"position": ("rad",) * len(names)})

    with DatasetWriter.create(folder, DatasetInfo(robot="demo_arm")) as writer:
        for index, split in enumerate(["train", "train", "val", "test"]):
            waves = 0.4 * np.sin((1.0 + index) * time_s[:, None] + np.arange(3))
            command = TimeSeries(time_s, robot.joint_names, {"position": waves}, {"position": ("rad",) * 3})
            measured = replay_episode(Episode(EpisodeMeta("x"), command, command), simulator, ReplaySettings())
            writer.append(Episode(EpisodeMeta(f"wave{index}", split=split), told(measured), told(command)))
    return Dataset(folder)


def test_a_robot_like_its_simulator_has_no_gap(tmp_path):
    closed = close(twin_dataset(tmp_path / "twin").path, load_robot("demo_arm"), tmp_path / "out", until="gap")
    runs = closed.measurement.gap.runs
    assert runs["mujoco/stock"]["test"]["position"]["rmse"].total.value < 1e-8
    assert runs["command"]["test"]["position"]["rmse"].total.value > 1e-3
    assert [rung.chosen for rung in closed.ladder.rungs] == [False, True]


def test_the_words_of_the_log_do_not_matter(tmp_path):
    """Other names, scales and zeros in the log, undone by the joint map, give the same gap of nothing."""
    data = twin_dataset(tmp_path / "twin", rename=lambda name: f"J_{name}", scale=0.5, offset=0.2)
    robot = load_robot("demo_arm")
    joints = tuple(JointSpec(joint.name, log=f"J_{joint.name}", scale=0.5, offset=0.2) for joint in robot.joints)
    closed = close(data.path, replace(robot, joints=joints), tmp_path / "out", until="gap")
    assert closed.measurement.gap.joints == ("yaw", "shoulder", "elbow")
    assert closed.measurement.gap.runs["mujoco/stock"]["test"]["position"]["rmse"].total.value < 1e-8
    with pytest.raises(NameMismatch, match=r"J_yaw.*yaw"):
        close(data.path, robot, tmp_path / "other", until="gap")


def test_a_second_replay_needs_a_word(demo):
    robot = load_robot("demo_arm")
    assert replay(demo, robot).replayed == 12
    with pytest.raises(OutputExists):
        replay(demo, robot)
    again = replay(demo, robot, resume=True)
    assert (again.replayed, again.kept) == (0, 12)
    with pytest.raises(OutputExists, match="settings"):
        replay(demo, robot, delay_s=0.02, resume=True)
    assert replay(demo, robot, delay_s=0.02, overwrite=True).replayed == 12


@pytest.mark.long
def test_a_replay_of_some_goes_on_with_the_rest(demo):
    robot = load_robot("demo_arm")
    assert replay(demo, robot, ids=demo.ids[:5]).replayed == 5
    partial = gap(demo)
    assert partial.gap.runs["mujoco/stock"]["all"]["position"]["rmse"].episodes == 5
    assert partial.gap.runs["command"]["all"]["position"]["rmse"].episodes == 12
    rest = replay(demo, robot, resume=True)
    assert (rest.replayed, rest.kept) == (7, 5)


@pytest.mark.long
def test_a_delay_closer_to_the_hardware_is_better_and_the_pairing_says_so(demo):
    robot = load_robot("demo_arm")
    replay(demo, robot)
    replay(demo, robot, label="mujoco/delayed", delay_s=0.024)
    measured = gap(demo).gap
    pair = next(
        item
        for item in measured.paired
        if (item.run, item.baseline) in (("mujoco/delayed", "mujoco/stock"), ("mujoco/stock", "mujoco/delayed"))
        and item.split == "all"
        and item.signal == "position"
        and item.metric == "rmse"
    )
    better = pair.run == "mujoco/delayed"
    assert (pair.difference.value < 0) == better
    assert pair.verdict == ("better" if better else "worse")


@pytest.mark.long
def test_runs_that_do_not_belong_together_are_refused(demo):
    robot = load_robot("demo_arm")
    replay(demo, robot)
    replay(demo, robot, label="mujoco/windows", window_s=0.5)
    with pytest.raises(ConfigError, match="different windows"):
        gap(demo)
    assert gap(demo, runs=["mujoco/windows"]).analysis.horizon


def test_what_is_not_there_is_answered_with_what_is(demo):
    replay(demo, load_robot("demo_arm"))
    with pytest.raises(MissingSignal, match="mujoco/stock"):
        gap(demo, runs=["mujoco/fitted"])
    with pytest.raises((DataError, MissingSignal), match="train"):
        gap(demo, split="holdout")


@pytest.mark.long
def test_without_a_run_the_command_is_measured(demo):
    assert set(gap(demo, robot=load_robot("demo_arm")).gap.runs) == {"command"}


def test_one_bad_motion_does_not_stop_a_close(tmp_path):
    data = twin_dataset(tmp_path / "twin")
    episode = data[0]
    broken = episode.measured["position"].copy()
    broken[0] = np.nan
    with DatasetWriter.resume(data.path) as writer:
        writer.append(
            replace(
                episode,
                meta=EpisodeMeta("bad", split="test"),
                measured=replace(episode.measured, signals={"position": broken}),
            )
        )
    closed = close(data.path, load_robot("demo_arm"), tmp_path / "out", until="gap")
    assert set(closed.replayed.failed) == {"bad"}
    assert closed.measurement.gap.runs["mujoco/stock"]["test"]["position"]["rmse"].episodes == 1


@pytest.mark.long
def test_the_same_inputs_give_the_same_results(tmp_path):
    results = []
    for name in ("a", "b"):
        data = demo_dataset(tmp_path / name / "data")
        close(data, load_robot("demo_arm"), tmp_path / name / "out", jobs=2, until="gap")
        gap_json = (tmp_path / name / "out" / "gap.json").read_text()
        results.append([line for line in gap_json.splitlines() if '"created"' not in line])
    assert results[0] == results[1]


def test_a_motion_far_from_the_simulation_is_noted(tmp_path):
    twin = twin_dataset(tmp_path / "twin")
    with DatasetWriter.create(tmp_path / "noisy", DatasetInfo(robot="demo_arm")) as writer:
        for index in range(8):
            episode = twin[index % 4]
            noise = 1e-3 * np.random.default_rng(index).standard_normal(episode.measured["position"].shape)
            pushed = 0.3 * (index == 5)  # as if something had held the arm aside
            position = {
                "position": episode.measured["position"] + noise + pushed * (episode.measured.time_s > 1)[:, None]
            }
            measured = replace(episode.measured, signals=position)
            writer.append(replace(episode, meta=EpisodeMeta(f"motion{index}"), measured=measured))
    closed = close(tmp_path / "noisy", load_robot("demo_arm"), tmp_path / "out", until="gap")
    flags = {name: item.flags for name, item in closed.measurement.quality.episodes.items()}
    assert {name for name, found in flags.items() if "far_from_simulation" in {flag.kind for flag in found}} == {
        "motion5"
    }


def test_the_limits_of_the_robot_hold_in_the_words_of_the_log(tmp_path):
    """A joint that stands at the limit that robot.yaml states is flagged, whatever the log calls and scales it."""
    robot = load_robot("demo_arm")
    data = twin_dataset(tmp_path / "twin", rename=lambda name: f"J_{name}", scale=-0.5, offset=0.2)
    told = {"log": "J_yaw", "sign": -1, "scale": 0.5, "offset": 0.2}
    joints = (JointSpec("yaw", **told, position_limits=(-9.0, 0.25)), JointSpec("shoulder"), JointSpec("elbow"))
    flags = [checked(item, replace(robot, joints=joints)).meta.flags for item in data]
    assert not any(flag.kind == "position_limit" for found in flags for flag in found)  # other names: not this robot
    joints = (
        JointSpec("yaw", **told, position_limits=(-9.0, 0.25)),
        *(JointSpec(name, **{**told, "log": f"J_{name}"}) for name in ("shoulder", "elbow")),
    )
    flags = [checked(item, replace(robot, joints=joints)).meta.flags for item in data]
    assert {flag.joint for found in flags for flag in found if flag.kind == "position_limit"} <= {"J_yaw"}
    assert any(flag.kind == "position_limit" for found in flags for flag in found)


@pytest.mark.long
def test_a_torque_without_its_sign_is_said_to_say_little(demo):
    robot = load_robot("demo_arm")
    replay(demo, robot)
    assert gap(demo).gap.settings["warnings"] == []
    with DatasetWriter.create(demo.path.parent / "unsigned", DatasetInfo(robot="demo_arm")) as writer:
        for episode in demo:
            signals = {**episode.measured.signals, "torque": np.abs(episode.measured["torque"])}
            writer.append(replace(episode, measured=replace(episode.measured, signals=signals)))
    unsigned = Dataset(demo.path.parent / "unsigned")
    replay(unsigned, robot)
    (warning,) = gap(unsigned).gap.settings["warnings"]
    assert "yaw, shoulder, elbow" in warning


def test_an_import_of_which_nothing_can_be_read_leaves_nothing_behind(tmp_path):
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "motion.npz").write_bytes(b"PK\x03\x04 broken")
    with pytest.raises(TrueupError, match="motion"):
        import_logs(tmp_path / "logs", tmp_path / "data")
    assert not (tmp_path / "data").exists()


def test_a_replay_of_another_robot_leaves_nothing_behind(tmp_path):
    data = twin_dataset(tmp_path / "twin", rename=lambda name: f"J_{name}")
    with pytest.raises(NameMismatch):
        replay(data, load_robot("demo_arm"))
    assert data.runs == ()


def test_a_run_that_came_with_the_logs_speaks_their_language(tmp_path):
    """A simulation in the log's signs and zeros, on a clock of its own, that equals the measurement: no gap."""
    twin = twin_dataset(tmp_path / "twin", scale=-0.5, offset=0.2)
    with DatasetWriter.create(tmp_path / "logs", DatasetInfo(robot="demo_arm")) as writer:
        for episode in twin:
            fine = np.arange(-0.05, 4.05, 0.002)
            values = np.stack(
                [np.interp(fine, episode.measured.time_s, column) for column in episode.measured["position"].T], 1
            )
            foreign = replace(episode.measured, time_s=fine, signals={"position": values})
            writer.append(replace(episode, simulated={"isaac/run": foreign}))
    data = Dataset(tmp_path / "logs")
    robot = load_robot("demo_arm")
    told = tuple(JointSpec(joint.name, sign=-1, scale=0.5, offset=0.2) for joint in robot.joints)
    robot = replace(robot, joints=told)
    replay(data, robot)
    runs = gap(data).gap.runs
    assert runs["isaac/run"]["all"]["position"]["rmse"].total.value < 1e-9
    assert runs["mujoco/stock"]["all"]["position"]["rmse"].total.value < 1e-8


@pytest.mark.long
def test_a_simulation_recorded_apart_is_shifted_to_the_start_of_the_motion(demo, tmp_path):
    """The same motion on a clock that began 0.37 s earlier, as if somebody had started two recordings by hand."""
    with DatasetWriter.create(tmp_path / "apart", DatasetInfo(robot="demo_arm")) as writer:
        for episode in demo:
            late = replace(episode.measured, time_s=episode.measured.time_s + 0.37)
            writer.append(replace(episode, simulated={"gazebo/run": late}))
    data = Dataset(tmp_path / "apart")
    apart, aligned = (
        gap(data, align=choice).gap.runs["gazebo/run"]["all"]["position"]["rmse"] for choice in (False, True)
    )
    assert apart.total.value > 0.02
    assert aligned.total.value < 1e-6


@pytest.mark.long
def test_what_was_left_out_is_what_was_flagged(tmp_path):
    data = Dataset(demo_dataset(tmp_path / "demo"))
    replay(data, load_robot("demo_arm"))
    data.set_flags({data.ids[0]: [Flag("saturation", detail="a test")]})
    everything, rest = gap(data), gap(data, drop_flagged=True)
    assert not any(item.dropped for item in everything.quality.episodes.values())
    assert [name for name, item in rest.quality.episodes.items() if item.dropped] == [data.ids[0]]
    assert rest.gap.runs["mujoco/stock"]["all"]["position"]["rmse"].episodes == 11
    test_only = gap(data, split="test")
    assert set(test_only.quality.episodes) == {name for name, split in data.splits.items() if split == "test"}
    assert not any(item.dropped for item in test_only.quality.episodes.values())


@pytest.mark.long
def test_resting_ends_can_be_cut(demo):
    replay(demo, load_robot("demo_arm"))
    whole, cut = gap(demo), gap(demo, cut_resting=True)
    left, right = (item.traces.episodes["reach_a"].traces[0].time_s[-1] for item in (whole, cut))
    assert right <= left
    assert cut.gap.runs["mujoco/stock"]["all"]["position"]["rmse"].episodes == 12


def test_a_changed_included_file_makes_a_stale_run(tmp_path):
    data = Dataset(demo_dataset(tmp_path / "demo"))
    robot = load_robot("demo_arm")
    text = find_model(robot).read_text()
    (tmp_path / "part.xml").write_text('<mujoco><default><joint damping="0.4"/></default></mujoco>')
    (tmp_path / "arm.xml").write_text(
        text.replace("<option", '<include file="part.xml"/><option').replace('damping="0.4"', "", 1)
    )
    assert replay(data, robot, model=tmp_path / "arm.xml").replayed == 12
    assert replay(data, robot, model=tmp_path / "arm.xml", resume=True).kept == 12
    (tmp_path / "part.xml").write_text('<mujoco><default><joint damping="4"/></default></mujoco>')
    with pytest.raises(OutputExists, match="model_sha256"):
        replay(data, robot, model=tmp_path / "arm.xml", resume=True)


def test_a_dataset_that_grows_keeps_what_was_replayed(tmp_path):
    data = twin_dataset(tmp_path / "twin")
    robot = load_robot("demo_arm")
    first = replay(data, robot)
    with DatasetWriter.resume(data.path) as writer:
        writer.append(replace(data[0], meta=EpisodeMeta("new")))
    grown = Dataset(data.path)
    again = replay(grown, robot, resume=True)
    assert (again.replayed, again.kept) == (1, 4)
    assert again.seconds > first.seconds
    assert replay(grown, robot, resume=True).seconds == again.seconds


def npz_logs(folder, twin):
    folder.mkdir()
    for episode in twin:
        write_npz(episode, folder / f"{episode.id}.npz")
    return folder


def test_an_import_goes_on_with_the_same_settings_only(tmp_path):
    logs = npz_logs(tmp_path / "logs", twin_dataset(tmp_path / "twin"))
    import_logs(logs, tmp_path / "data")
    assert import_logs(logs, tmp_path / "data", resume=True).kept == 4
    with pytest.raises(OutputExists, match="options"):
        import_logs(logs, tmp_path / "data", resume=True, options=ImportOptions(units={"position": "deg"}))


def test_a_split_that_is_given_is_the_only_one(tmp_path):
    logs = npz_logs(tmp_path / "logs", twin_dataset(tmp_path / "twin"))
    (logs / "split.json").write_text('{"test": ["wave0", "wave1", "wave2", "wave3"]}')
    (tmp_path / "mine.json").write_text('{"train": ["wave1.npz"], "val": ["wave9"]}')
    summary = import_logs(logs, tmp_path / "data", splits=tmp_path / "mine.json")
    assert Dataset(tmp_path / "data").splits == {"wave1": "train"}
    assert any("wave9" in note for note in summary.notes)
    assert set(import_logs(logs, tmp_path / "other") and Dataset(tmp_path / "other").splits.values()) == {"test"}


def test_results_carry_their_origin(tmp_path):
    close(twin_dataset(tmp_path / "twin").path, load_robot("demo_arm"), tmp_path / "out", until="gap")
    for name in ("gap", "ladder", "analysis", "quality", "traces"):
        origin = json.loads((tmp_path / "out" / f"{name}.json").read_text())["provenance"]
        assert all(origin[key] for key in ("data_hash", "trueup", "config"))


def test_a_rung_without_a_number_is_not_chosen():
    nothing = MetricResult(Estimate(np.nan, "rad"), {}, 1)
    something = MetricResult(Estimate(0.1, "rad"), {}, 1)
    rungs = [
        Rung(name, 0.0, {"val": {"position": {"rmse": item}}})
        for name, item in (("command", nothing), ("stock", something))
    ]
    assert [rung.chosen for rung in choose(rungs, [None, 0.1])] == [False, True]
    assert not any(rung.chosen for rung in choose(rungs[:1], [None]))


def test_a_rung_that_fails_on_a_motion_is_not_chosen_for_it():
    """Its mean over the motions that it has is the lowest, its error on each of them is not."""
    errors = {
        "command": {"easy": 0.3, "hard": 0.9},
        "mujoco/stock": {"easy": 0.1, "hard": 0.5},
        "mujoco/fitted": {"easy": 0.2},
        "mujoco/lost": {},
    }
    episodes = {
        label: {name: {"position": {"rmse": {"a": error, "b": np.nan, "c": 9.0}}} for name, error in own.items()}
        for label, own in errors.items()
    }
    found = GapResult({}, ("a", "b", "c"), ("a", "b"), episodes=episodes, splits={"easy": "val", "hard": "val"})
    assert val_scores(found, list(errors)) == [0.3, 0.1, 0.2, None]
    assert val_scores(found, ["command", "mujoco/stock"]) == pytest.approx([0.6, 0.3])
    assert val_scores(replace(found, splits={"easy": "train"}), list(errors)) == [None] * 4


def test_a_run_of_another_version_is_not_gone_on_with(demo):
    robot = load_robot("demo_arm")
    replay(demo, robot)
    file = demo.path / "simulated" / "mujoco" / "stock" / "run.json"
    tree = json.loads(file.read_text())

    def noted(origin):
        file.write_text(json.dumps({**tree, "info": {**tree["info"], "provenance": origin}}))
        return Dataset(demo.path)

    origin = tree["info"]["provenance"]
    for other in ({"packages": {**origin["packages"], "mujoco": "2.3.7"}}, {"trueup": "0.0.1"}):
        given = noted({**origin, **other})
        with pytest.raises(OutputExists, match=r"made from other inputs \((mujoco 2\.3\.7|trueup 0\.0\.1)\)"):
            replay(given, robot, resume=True)
    done = replay_unless_same(given, robot, model=None, label="mujoco/stock", jobs=1)
    assert (done.replaced, done.replayed, done.kept) == (True, 12, 0)
    # Runs of which nothing is known are kept.
    assert replay(noted({}), robot, resume=True).kept == 12


def test_a_replay_of_which_nothing_comes_leaves_the_run_that_is_there(demo):
    """A robot whose simulation diverges must not cost the good run, nor leave one that is empty."""
    robot = load_robot("demo_arm")
    replay(demo, robot)
    wild = replace(robot, controller=ControllerSpec(kind="position", kp=1e9))
    for label, overwrite in (("mujoco/stock", True), ("mujoco/wild", False)):
        with pytest.raises(DataError, match="diverged"):
            replay(demo, wild, label=label, overwrite=overwrite)
    demo.reload()
    assert demo.runs == ("mujoco/stock",)
    assert len(demo.run_ids("mujoco/stock")) == 12


@pytest.mark.long
def test_a_run_that_is_half_done_is_said_to_be(demo):
    replay(demo, load_robot("demo_arm"), ids=demo.ids[:5])
    (warning,) = gap(demo).gap.settings["warnings"]
    assert "lacks 7 of 12 motions" in warning
    with pytest.raises(MissingSignal, match="none of the motions"):
        gap(demo, split="test")


@pytest.mark.long
def test_a_run_that_was_interrupted_before_its_first_motion_blocks_no_other(demo):
    replay(demo, load_robot("demo_arm"))
    with RunWriter(demo.path, "mujoco/begun", run_info=demo.run_info("mujoco/stock")):
        pass
    demo.reload()
    measured = gap(demo).gap
    assert {run for run in measured.runs if run != "command"} == {"mujoco/stock"}
    assert measured.settings["warnings"] == ["the run mujoco/begun has none of these motions and is left out"]
    with pytest.raises(MissingSignal, match="none of the motions"):
        gap(demo, runs=["mujoco/begun"])


@pytest.mark.long
def test_an_import_that_is_half_done_is_said_to_be(demo, tmp_path):
    assert gap(demo).gap.settings["warnings"] == []
    logs = npz_logs(tmp_path / "logs", demo)
    import_logs(logs, tmp_path / "data")
    data = Dataset(tmp_path / "data")
    assert data.info.provenance["complete"]
    replace(data.info, provenance={**data.info.provenance, "complete": False}).save(data.path)  # as kill -9 leaves it
    assert "interrupted" in gap(Dataset(data.path)).gap.settings["warnings"][0]
    import_logs(logs, tmp_path / "data", resume=True)
    assert gap(Dataset(data.path)).gap.settings["warnings"] == []


def test_a_motion_that_is_too_short_to_differ_is_left_out(tmp_path):
    data = twin_dataset(tmp_path / "twin")
    with DatasetWriter.resume(data.path) as writer:
        writer.append(replace(data[0], meta=EpisodeMeta("stub"), measured=data[0].measured.rows(slice(0, 2))))
    closed = close(data.path, load_robot("demo_arm"), tmp_path / "out", until="gap")
    assert closed.measurement.gap.runs["command"]["all"]["position"]["rmse"].episodes == 4
    assert any("stub" in warning for warning in closed.measurement.gap.settings["warnings"])


@pytest.mark.long
def test_a_command_is_not_held_against_a_simulation_that_is_restarted(demo):
    replay(demo, load_robot("demo_arm"), window_s=0.2)
    assert set(gap(demo).gap.runs) == {"mujoco/stock"}


def test_a_window_without_samples_and_stamps_in_nanoseconds_are_refused(demo, tmp_path):
    with pytest.raises(DataError, match="holds too few samples"):
        replay(demo, load_robot("demo_arm"), window_s=0.01)
    with pytest.raises(ConfigError, match="command"):
        replay(demo, load_robot("demo_arm"), label="command")
    episode = demo[0]
    slow = {
        name: replace(getattr(episode, name), time_s=episode.measured.time_s * 1e9) for name in ("measured", "command")
    }
    with pytest.raises(DataError, match=r"(?s)lasts.*seconds\?"):
        import_logs(npz_logs(tmp_path / "logs", [replace(episode, **slow)]), tmp_path / "data")


@pytest.mark.long
def test_a_joint_map_that_is_not_applied_is_said_to_be(demo):
    robot = load_robot("demo_arm")
    joints = (JointSpec("yaw", log="J1", sign=-1), JointSpec("shoulder", log="J2"), JointSpec("elbow", log="J3"))
    replay(demo, replace(robot, joints=joints))
    (warning,) = gap(demo).gap.settings["warnings"]
    assert "sign, scale and offset of yaw were not applied" in warning


@pytest.mark.long
def test_a_foreign_run_decides_nothing_about_the_robot(demo, tmp_path):
    """A torque-driven robot stays one beside a run of another simulator, whatever their labels."""
    with DatasetWriter.create(tmp_path / "both", DatasetInfo(robot="demo_arm")) as writer:
        for episode in demo:
            signals = {**episode.commanded().signals, "torque": np.zeros_like(episode.commanded()["position"])}
            units = {**episode.commanded().units, "torque": ("Nm",) * 3}
            told = replace(episode.commanded(), signals=signals, units=units)
            writer.append(replace(episode, command=told, simulated={"another/run": episode.measured}))
    data = Dataset(tmp_path / "both")
    robot = load_robot("demo_arm")
    replay(data, replace(robot, controller=ControllerSpec(kind="torque")), label="mujoco/torque")
    measured = gap(data).gap
    assert set(measured.runs) == {"another/run", "mujoco/torque"}
    assert measured.settings["robot"] == "demo_arm"


@pytest.mark.long
def test_two_engines_or_two_payloads_are_compared(demo, tmp_path):
    robot = load_robot("demo_arm")
    replay(demo, robot)
    replay(demo, robot, label="dart/stock")  # what made it does not matter here
    both = gap(demo, runs=["mujoco/stock", "dart/stock"])
    both.save(tmp_path)
    assert (tmp_path / "engines.json").is_file()
    loads = {"0", "0.4", ""}
    assert set(both.engines.plane.envelopes["dart/stock"]) == loads
    assert set(both.engines.trends) == {"mujoco/stock", "dart/stock", "command"}
    slope = both.engines.trends["dart/stock"]["position"]["rmse"][""]
    by_payload = both.gap.groups["payload_kg"]
    means = [by_payload[load]["dart/stock"]["position"]["rmse"].total.value for load in ("0", "0.4")]
    # With two payloads the line goes through both means.
    assert slope.slope.value == pytest.approx((means[1] - means[0]) / 0.4)
    assert slope.at_zero == pytest.approx(means[0])


def test_one_engine_and_one_payload_are_not(tmp_path):
    closed = close(twin_dataset(tmp_path / "twin").path, load_robot("demo_arm"), tmp_path / "out", until="gap")
    assert closed.measurement.engines is None
    (tmp_path / "out" / "engines.json").write_text("{}")
    closed.measurement.save(tmp_path / "out")
    assert not (tmp_path / "out" / "engines.json").exists()


def test_a_dataset_without_episodes_is_not_replayed(tmp_path):
    DatasetWriter.create(tmp_path / "empty", DatasetInfo(robot="demo_arm")).close()
    with pytest.raises(DataError, match="has no episodes"):
        replay(Dataset(tmp_path / "empty"), load_robot("demo_arm"))
