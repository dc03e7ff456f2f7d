"""Recording as a whole: what is on disk afterwards, and that interruptions, processes and faults change nothing else."""

import contextlib
import errno
import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from trueup.dataset import Dataset, journal
from trueup.errors import ConfigError, DataError, NameMismatch, OutputExists, TrueupError
from trueup.lab import LabSpec, draw_truth
from trueup.lab.spec import Base
from trueup.record import (
    Box,
    ClockSettings,
    MotionGroup,
    MotionSettings,
    PathSettings,
    PlanSet,
    PlanSetSpec,
    RecordSettings,
    Workspace,
    load_plans,
    plan_all,
)
from trueup.robots import ControllerSpec, find_model, load_robot
from trueup.stages.recording import PLANS, record
from trueup.stages.rigs import EngineRig, LabRig, Rig, make_rig

PANDA = load_robot("panda")
# A slow clock: what is tested here does not depend on it.
RATES = RecordSettings(control_hz=200.0, record_hz=50.0)
MOTION = MotionSettings(clock=ClockSettings(rate_hz=200.0, rest_s=0.1))
GROUPS = (
    MotionGroup("multi", "joint", 2, velocity_share=(0.8, 1.0)),
    MotionGroup("single", "joint", 3, moving="single", velocity_share=(0.8, 1.0)),
    MotionGroup("line", "cartesian", 1, split="test"),
)
SPEC = PlanSetSpec("six", GROUPS, seed=3, motion=MOTION)
IDS = ["multi/00000", "multi/00001", "single/00000", "single/00001", "single/00002", "line/00000"]


def lab(**changes):
    return LabRig(LabSpec(), **{"seed": 3, **changes})


def recorded(out, plans=SPEC, *, rig=None, **options):
    return record(out, PANDA, lab() if rig is None else rig, plans, **{"settings": RATES, **options})


def contents(path):
    """Bytes of all files, without the times in the provenance."""
    files = {}
    for file in sorted(path.rglob("*")):
        if file.is_file():
            files[file.relative_to(path).as_posix()] = file.read_bytes()
    for name in ("dataset.json", "plans/plans.json"):
        if name in files:
            tree = json.loads(files[name])
            del tree["provenance"]["created"]
            files[name] = json.dumps(tree).encode()
    return files


def assert_same_files(one, other):
    left, right = contents(one), contents(other)
    assert left.keys() == right.keys()
    assert [name for name in left if left[name] != right[name]] == []


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("whole") / "data"
    summary = recorded(path)
    assert (summary.recorded, summary.kept, dict(summary.failed), dict(summary.skipped)) == (6, 0, {}, {})
    return path


def test_a_recording_is_a_dataset_of_its_plans(whole):
    dataset, plans = Dataset(whole), PlanSet(whole / PLANS)
    assert list(dataset.ids) == list(plans.ids()) == IDS
    assert plans.complete
    assert not (whole / "journal.bin").exists()
    info = dataset.info
    assert (info.robot, info.joints) == ("panda", PANDA.joint_names)
    assert info.provenance["complete"] is True
    assert info.provenance["seed"] == 3
    for episode in dataset:
        plan, meta = plans[episode.id], episode.meta
        assert (meta.robot, meta.unit, meta.payload_kg) == ("panda", "lab-1", 0.0)
        assert (meta.split, meta.condition) == (plan.split, plan.condition)
        assert meta.source == f"plans/{episode.id}"
        np.testing.assert_array_equal(episode.commanded()["position"], plan.position[::4])
        np.testing.assert_allclose(np.diff(episode.measured.time_s), 0.02, atol=1e-9)
        assert np.all(np.diff(episode.commanded().time_s) > 0)
        assert np.abs(episode.measured["position"][0] - plan.start).max() < 0.02
        assert np.abs(episode.measured["position"][-1] - plan.goal).max() < 0.05
    assert not any(meta.warned for meta in dataset.metas)


def test_the_truth_is_not_in_the_dataset(whole):
    truth = draw_truth(LabSpec(), unit=1)
    text = b"".join(file.read_bytes() for file in whole.rglob("*.json")).decode()
    for joint in truth.joints.values():
        for number in (joint.motor_inertia, joint.static_nm, joint.gravity_offset_nm, joint.stiffness):
            assert f"{number:.6g}" not in text
    assert set(Dataset(whole)[0].measured.signals) == {"position", "velocity", "torque"}


def stop_after(count, what):
    """A track that is interrupted by Ctrl-C when so many items of one bar are done."""

    def track(items, name, total=None):
        for done, item in enumerate(items):
            if name == what and done == count:
                raise KeyboardInterrupt
            yield item

    return track


@pytest.mark.long
@pytest.mark.parametrize(("what", "counts"), [("plan", (0, 5)), ("record", (0, 1, 3, 5))])
def test_ctrl_c_and_the_same_again_make_the_same_files(whole, tmp_path, what, counts):
    for count in counts:
        with pytest.raises(KeyboardInterrupt):
            recorded(tmp_path / "data", track=stop_after(count, what))
        assert Dataset(tmp_path / "data").info.provenance["complete"] is False
        if what == "record":  # each call went on where the one before it was: counts add up
            break
    # Interruptions of interruptions: one motion a call.
    done = len(Dataset(tmp_path / "data"))
    while done < 5:
        with pytest.raises(KeyboardInterrupt):
            recorded(tmp_path / "data", track=stop_after(1, "record"))
        assert len(Dataset(tmp_path / "data")) == done + 1
        done += 1
    summary = recorded(tmp_path / "data")
    assert (summary.recorded, summary.kept) == (1, 5)
    assert_same_files(tmp_path / "data", whole)


@pytest.mark.slow
def test_two_processes_make_the_same_files(whole, tmp_path):
    assert recorded(tmp_path / "data", jobs=2).recorded == 6
    assert_same_files(tmp_path / "data", whole)


YAML = """
name: six
motion: {clock: {rate_hz: 200.0, rest_s: 0.1}}
groups:
  - {name: multi, kind: joint, count: 2, velocity_share: [0.8, 1.0]}
  - {name: single, kind: joint, count: 3, moving: single, velocity_share: [0.8, 1.0]}
  - {name: line, kind: cartesian, count: 1, split: test}
"""
# Not done before somebody gets to stop it.
LONG = YAML.replace("count: 3", "count: 60")
COMMAND = ("-m", "trueup.cli.main", "record", "--control-hz", "200", "--record-hz", "50")


def start(folder, out, *, jobs, plan=YAML):
    """`trueup record` in a process group of its own."""
    (folder / "six.yaml").write_text(plan)
    command = [
        sys.executable,
        *COMMAND,
        "--plan",
        folder / "six.yaml",
        "--out",
        out,
        "--seed",
        "3",
        "--jobs",
        str(jobs),
    ]
    return subprocess.Popen(
        [str(word) for word in command],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


MOMENTS = {
    "dataset begun": lambda out: (out / "dataset.json").exists(),
    "planning": lambda out: (out / "plans" / "blocks").exists(),
    "planned": lambda out: (out / "plans" / "blocks" / "00000.json").exists(),
    "recording": lambda out: size(out / "journal.bin") > 100,
    "some recorded": lambda out: size(out / "journal.bin") > 60_000,
}


def size(path):
    with contextlib.suppress(OSError):
        return path.stat().st_size
    return 0


def alive(group):
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def wait_for(moment, out, process):
    deadline = time.monotonic() + 60
    while not moment(out) and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.001)


@pytest.mark.slow
def test_kill_9_at_any_moment_and_the_same_again_make_the_same_files(whole, tmp_path):
    """One dataset, killed again and again: motions are neither lost nor doubled."""
    out = tmp_path / "data"
    for jobs, moment in zip((1, 1, 1, 1, 2), MOMENTS.values(), strict=True):
        process = start(tmp_path, out, jobs=jobs)
        wait_for(moment, out, process)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        with contextlib.suppress(TrueupError):
            assert list(Dataset(out).ids) == IDS[: len(Dataset(out))]
    process = start(tmp_path, out, jobs=1)
    printed, problems = process.communicate(timeout=120)
    if process.returncode:  # the last kill came too late
        assert "--resume adds what is missing" in problems
    else:
        assert "motions recorded" in printed
    assert_same_files(out, whole)


@pytest.mark.slow
@pytest.mark.parametrize("who", ["all", "the first"])
def test_no_process_stays_behind(tmp_path, who):
    """Ctrl-C reaches all processes, `kill -9` only one; both end all of them."""
    out = tmp_path / "data"
    process = start(tmp_path, out, jobs=2, plan=LONG)
    wait_for(MOMENTS["recording"], out, process)
    if who == "all":
        os.killpg(process.pid, signal.SIGINT)
    else:
        process.kill()
    _, problems = process.communicate(timeout=120)
    deadline = time.monotonic() + 30
    while alive(process.pid) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not alive(process.pid)
    if who == "all":
        assert process.returncode == 130
        assert "Traceback" not in problems
        assert "What was finished is kept" in problems
    ids = [*IDS[:2], *(f"single/{number:05d}" for number in range(60)), IDS[-1]]
    assert list(Dataset(out).ids) == ids[: len(Dataset(out))]
    assert len(Dataset(out)) < len(ids)


def full_disk(*_, **__):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.long
def test_a_full_disk_keeps_what_was_recorded(whole, tmp_path, monkeypatch):
    out, appended, original = tmp_path / "data", [], journal.Journal.append

    def filling(self, pieces):
        appended.append(1)
        if len(appended) > 3:
            with monkeypatch.context() as patch:
                patch.setattr(os, "write", full_disk)
                return original(self, pieces)
        return original(self, pieces)

    with monkeypatch.context() as patch:
        patch.setattr(journal.Journal, "append", filling)
        with pytest.raises(DataError, match="No space left"):
            recorded(out)
    assert list(Dataset(out).ids) == IDS[:3]
    with monkeypatch.context() as patch:
        patch.setattr("pyarrow.parquet.ParquetWriter.write_table", full_disk)
        with pytest.raises(DataError, match="No space left"):
            recorded(out)
    assert list(Dataset(out).ids) == IDS
    assert recorded(out).kept == 6
    assert_same_files(out, whole)


def test_no_room_for_plans(whole, tmp_path, monkeypatch):
    out = tmp_path / "data"
    with monkeypatch.context() as patch:
        patch.setattr("trueup.record.planstore.write_shard", full_disk_as_data_error)
        with pytest.raises(DataError, match="No space left"):
            recorded(out)
    assert len(Dataset(out)) == 0
    assert recorded(out).recorded == 6
    assert_same_files(out, whole)


def full_disk_as_data_error(path, *_):
    raise DataError(f"cannot write {path}", got=os.strerror(errno.ENOSPC))


@pytest.mark.long
def test_a_complete_recording_is_not_begun_again_unasked(whole, tmp_path):
    out = tmp_path / "data"
    recorded(out)
    before = contents(out)
    with pytest.raises(OutputExists, match="exists"):
        recorded(out)
    summary = recorded(out, resume=True)
    assert (summary.recorded, summary.kept) == (0, 6)
    assert contents(out) == before
    assert recorded(out, overwrite=True).recorded == 6
    assert contents(out) == before
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("years of work")
    for options in ({}, {"overwrite": True}, {"resume": True}):
        with pytest.raises(OutputExists, match="no trueup dataset"):
            recorded(tmp_path / "mine", **options)
    assert [file.name for file in (tmp_path / "mine").iterdir()] == ["thesis.tex"]


@pytest.mark.long
def test_other_settings_are_refused_by_name(whole, tmp_path):
    model = tmp_path / "panda.xml"
    model.write_bytes(find_model(PANDA).read_bytes() + b"<!-- a change -->")
    rough = replace(LabSpec(), payload_limit_kg=2.0)
    others = {
        "settings": {"settings": replace(RATES, record_hz=100.0)},
        "payloads_kg": {"payloads_kg": (1.0,)},
        "plans": {"plans": replace(SPEC, seed=4)},
        "rig": {"rig": lab(number=2)},
        "model": {"model": model},
    }
    before = contents(whole)
    for name, change in others.items():
        for resume in (False, True):
            with pytest.raises(OutputExists, match=rf"other settings \({name}\)"):
                recorded(whole, **{"resume": resume, **change})
    for rig in (lab(seed=1), lab(fault_share=0.1), LabRig(rough)):
        with pytest.raises(OutputExists, match=r"other settings \(rig\)"):
            recorded(whole, rig=rig)
    with pytest.raises(OutputExists, match="payloads_kg, plans"):
        recorded(whole, replace(SPEC, seed=4), payloads_kg=(1.0,))
    assert contents(whole) == before


def test_payloads(tmp_path):
    two = replace(SPEC, groups=(replace(GROUPS[0], count=1), replace(GROUPS[1], count=1), GROUPS[2]))
    summary = recorded(tmp_path / "data", two, payloads_kg=(0.0, 2.5))
    assert summary.recorded == 6
    dataset = Dataset(tmp_path / "data")
    names = ["multi/00000", "single/00000", "line/00000"]
    assert list(dataset.ids) == [f"{name}/{load}" for load in ("0kg", "2.5kg") for name in names]
    for name in names:
        bare, loaded = dataset[f"{name}/0kg"], dataset[f"{name}/2.5kg"]
        assert (bare.meta.payload_kg, loaded.meta.payload_kg) == (0.0, 2.5)
        assert bare.meta.split == loaded.meta.split
        assert bare.meta.source == loaded.meta.source
        np.testing.assert_array_equal(bare.commanded()["position"], loaded.commanded()["position"])
    # It hangs on the arm: the second joint feels 2.5 kg on a lever of a few decimeters, to one side or the other.
    bare, loaded = dataset["multi/00000/0kg"], dataset["multi/00000/2.5kg"]
    lever_m = (loaded.measured["torque"][0, 1] - bare.measured["torque"][0, 1]) / (2.5 * 9.81)
    assert 0.05 < abs(lever_m) < 0.9


@pytest.mark.long
def test_rigs_take_turns_and_each_motion_is_that_of_its_rig_alone(tmp_path):
    """Other individuals and other bases, in the order of the motions, the same for every payload."""
    walking = replace(LabSpec(), base=Base(condition="gait"))
    rigs = (lab(), LabRig(walking, 2, seed=3))
    three = replace(SPEC, groups=(replace(GROUPS[0], count=1), replace(GROUPS[1], count=2)))
    recorded(tmp_path / "data", three, rig=rigs, payloads_kg=(0.0, 1.0))
    data = Dataset(tmp_path / "data")
    said = {meta.id: (meta.unit, meta.condition) for meta in data.metas}
    for load in ("0kg", "1kg"):
        assert said[f"multi/00000/{load}"] == said[f"multi/00000/{load}"] == ("lab-1", "multi")
        assert said[f"single/00000/{load}"] == ("lab-2", "single gait")
        assert said[f"single/00001/{load}"] == ("lab-1", "single")
    for place, rig in enumerate(rigs):
        alone = Dataset(recorded(tmp_path / f"alone{place}", three, rig=rig, payloads_kg=(0.0, 1.0)).path)
        own = [meta.id for meta in data.metas if meta.unit == rig.unit]
        assert own
        for id in own:
            np.testing.assert_array_equal(data[id].measured["torque"], alone[id].measured["torque"])
    recorded(tmp_path / "again", three, rig=rigs, payloads_kg=(0.0, 1.0), jobs=2)
    assert_same_files(tmp_path / "again", tmp_path / "data")
    with pytest.raises(ConfigError, match="one individual"):
        recorded(tmp_path / "true", three, rig=rigs, truth=tmp_path / "truth.json")
    with pytest.raises(ConfigError, match="needs a rig"):
        recorded(tmp_path / "none", three, rig=())


def test_a_motion_is_the_same_whatever_is_recorded_besides(whole, tmp_path):
    """A motion depends on its number and payload, not on what the robot did before."""
    stored = PlanSet(whole / PLANS)
    recorded(tmp_path / "data", PlanSet(whole / PLANS), rig=lab())
    # The plans are copied: the dataset is whole when it is moved.
    assert contents(tmp_path / "data").keys() == contents(whole).keys()
    again, first = Dataset(tmp_path / "data"), Dataset(whole)
    assert again.hash == first.hash
    assert list(again.ids) == list(stored.ids())
    rig = lab()
    alone = rig.session(3, 0.0)
    for number in (0, 3, 1):
        rig.session(number, 0.0).wait_until_s(0.05)
    third = rig.session(3, 0.0)
    fresh = lab().session(3, 0.0)
    assert alone is third
    for robot in (third, fresh):
        robot.write({"position": robot.read()["position"]})
        robot.wait_until_s(0.1)
    np.testing.assert_array_equal(third.read()["torque"], fresh.read()["torque"])


@pytest.mark.parametrize("payloads", [(3.5,), (0.0, 3.5), (0.0, np.inf)])
def test_payloads_out_of_range_write_nothing(tmp_path, payloads):
    with pytest.raises(ConfigError, match="payload"):
        recorded(tmp_path / "data", payloads_kg=payloads)
    assert not (tmp_path / "data").exists()


@pytest.mark.parametrize("payloads", [(), (-1.0,), (1.0, 1.0), (np.nan,), (1.0, 1.0 + 1e-9)])
def test_payloads_that_are_none_are_refused(tmp_path, payloads):
    with pytest.raises(ConfigError, match="different masses"):
        recorded(tmp_path / "data", payloads_kg=payloads)
    assert not (tmp_path / "data").exists()


def test_splits_are_those_of_the_papers():
    """80/15/5 by whole motions, lines for testing only; 1 % of the papers' set is recorded by the command."""
    counts = Counter()
    spec = replace(SPEC, groups=(replace(GROUPS[0], count=100), replace(GROUPS[2], count=20)))
    for number in range(len(spec)):
        counts[(spec.place(number)[0].name, spec.split(number))] += 1
    assert counts == {("multi", "train"): 80, ("multi", "val"): 15, ("multi", "test"): 5, ("line", "test"): 20}


@pytest.mark.long
def test_faults_are_flagged_or_named_and_no_motion_is_forgotten(tmp_path):
    spec = replace(SPEC, groups=(replace(GROUPS[1], count=14),))
    rig = lab(fault_share=1.0)
    summary = recorded(tmp_path / "data", spec, rig=rig)
    dataset = Dataset(tmp_path / "data")
    assert sorted([*dataset.ids, *summary.failed]) == [spec.id(number) for number in range(14)]
    assert summary.recorded == len(dataset)
    warned = {meta.id for meta in dataset.metas if meta.warned}
    assert set(summary.flagged) == warned
    kinds = {kind for flags in summary.flagged.values() for kind in flags}
    assert len(kinds & {"stopped", "silent", "goal_missed"}) >= 2
    for name, error in summary.failed.items():
        assert any(name in text and error.summary in text for text in dataset.info.notes)
    stops = [flag for meta in dataset.metas for flag in meta.flags if flag.kind == "stopped"]
    for flag in stops:
        assert flag.start_s is not None
    healthy = recorded(tmp_path / "none", spec, rig=lab())
    assert not healthy.flagged


def test_nothing_but_failures_is_an_error_that_says_why(tmp_path, monkeypatch):
    class Broken(LabRig):
        def session(self, number, payload_kg):
            robot = super().session(number, payload_kg)
            robot.recover = lambda: None
            robot.stop()
            return robot

    with pytest.raises(DataError, match="nothing was recorded") as caught:
        recorded(tmp_path / "data", rig=Broken(LabSpec()))
    assert "given up" in str(caught.value)
    assert len(Dataset(tmp_path / "data").info.notes) == 6


@pytest.mark.long
def test_units_differ_and_the_same_unit_and_seed_do_not(tmp_path, whole):
    plans = PlanSet(whole / PLANS)
    hashes = {}
    for name, rig in {
        "again": lab(),
        "other unit": lab(number=2),
        "other seed": lab(seed=1),
    }.items():
        recorded(tmp_path / name, plans, rig=rig)
        hashes[name] = Dataset(tmp_path / name).hash
    assert hashes["again"] == Dataset(whole).hash
    assert len(set(hashes.values())) == 3
    first, other = Dataset(whole)[0], Dataset(tmp_path / "other unit")[0]
    assert other.meta.unit == "lab-2"
    np.testing.assert_array_equal(first.commanded()["position"], other.commanded()["position"])
    assert np.abs(first.measured["torque"] - other.measured["torque"]).max() > 0.3


def test_stored_plans_must_be_whole_and_of_this_robot(whole, tmp_path):
    arm = load_robot("demo_arm")
    with pytest.raises(NameMismatch, match=r"joint1.*yaw"):
        record(tmp_path / "data", arm, lab(), PlanSet(whole / PLANS), settings=RATES)

    def stop(done, total, skipped):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        plan_all(replace(SPEC, groups=(replace(GROUPS[1], count=20),)), PANDA, tmp_path / "half", progress=stop)
    with pytest.raises(DataError, match="not complete"):
        recorded(tmp_path / "data", PlanSet(tmp_path / "half"))
    assert not (tmp_path / "data").exists()


def test_motions_that_are_not_found_are_skipped_and_counted(tmp_path):
    """In a cage that hardly leaves room, some motions are not found; the others are recorded."""
    walls = Workspace(
        boxes=(Box("wall", (0.0, 0.75, 0.5), (2.0, 0.9, 2.0)), Box("other", (0.75, 0.0, 0.5), (0.6, 0.5, 2.0)))
    )
    spec = replace(
        SPEC,
        groups=(replace(GROUPS[0], count=8),),
        workspace=walls,
        motion=replace(MOTION, attempts=1, path=PathSettings(checks=1)),
    )
    summary = recorded(tmp_path / "data", spec)
    assert summary.skipped
    assert summary.recorded >= 1
    assert summary.recorded + len(summary.failed) + len(summary.skipped) == 8
    assert not set(Dataset(tmp_path / "data").ids) & set(summary.skipped)
    assert all(any(name in note for note in Dataset(tmp_path / "data").info.notes) for name in summary.skipped)


def test_a_robot_that_is_not_free_at_all(tmp_path):
    cage = replace(SPEC, workspace=Workspace(boxes=(Box("block", (0.0, 0.0, 0.6), (2.0, 2.0, 1.0)),)))
    cage = replace(cage, motion=replace(MOTION, attempts=2))
    with pytest.raises(DataError, match="nothing was recorded"):
        recorded(tmp_path / "data", cage)


@pytest.mark.long
def test_an_engine_plays_the_robot(tmp_path):
    twin = replace(PANDA, controller=ControllerSpec(kind="pd", kp=2000.0, kv=60.0))
    rig = make_rig("mujoco", twin, find_model(twin), control_hz=200.0)
    assert isinstance(rig, Rig)
    one = replace(SPEC, groups=(replace(GROUPS[1], count=2),))
    assert record(tmp_path / "data", twin, rig, one, settings=RATES).recorded == 2
    dataset = Dataset(tmp_path / "data")
    assert {meta.unit for meta in dataset.metas} == {"mujoco"}
    # The second motion is the same when it is the first.
    rig.session(1, 0.0)
    from trueup.record import Recorder

    fresh = make_rig("mujoco", twin, find_model(twin), control_hz=200.0)
    scene = one.scene(twin)
    plan = PlanSet(tmp_path / "data" / PLANS)[one.id(1)]
    alone = Recorder(fresh.session(1, 0.0), scene, RATES).record(plan)
    np.testing.assert_array_equal(alone.measured["position"], dataset[one.id(1)].measured["position"])


def test_a_robot_that_cannot_be_recorded_is_refused_before_anything_is_written(tmp_path):
    torque = EngineRig(load_robot("panda_torque"), "mujoco", find_model(PANDA), 200.0)
    with pytest.raises(ConfigError, match="commands positions"):
        recorded(tmp_path / "data", rig=torque)
    twin = replace(PANDA, controller=ControllerSpec(kind="pd", kp=2000.0, kv=60.0))
    with pytest.raises(ConfigError, match="no payload"):
        recorded(tmp_path / "data", rig=EngineRig(twin, "mujoco", find_model(twin), 200.0), payloads_kg=(0.0, 1.0))
    with pytest.raises(ConfigError, match="200 and 1000 Hz"):
        recorded(tmp_path / "data", settings=RecordSettings())
    with pytest.raises(ConfigError, match="jobs"):
        recorded(tmp_path / "data", jobs=0)
    with pytest.raises(ConfigError, match="share"):
        lab(fault_share=1.5)
    # The papers' set has lines of an end effector, and two arms have two ends.
    body = load_robot("upper_body")
    with pytest.raises(ConfigError, match="no site for the end effector"):
        record(tmp_path / "data", body, make_rig("mujoco", body, find_model(body)), load_plans("paper").scaled(0.001))
    assert not (tmp_path / "data").exists()


def test_hardware_by_name():
    path = find_model(PANDA)
    assert isinstance(make_rig("lab", PANDA, path), LabRig)
    with pytest.raises(ConfigError, match="lab, mujoco, dart"):
        make_rig("gazebo", PANDA, path)
    with pytest.raises(NameMismatch, match="--lab"):
        make_rig("lab", load_robot("demo_arm"), path)
    assert make_rig("lab", PANDA, path).condition == make_rig("lab", PANDA, path, base="fixed").condition == ""
    assert make_rig("lab", PANDA, path, base="squat").condition == "squat"
    with pytest.raises(ConfigError, match=r"condition.*fixed, stance, squat, gait"):
        make_rig("lab", PANDA, path, base="run")
    for wrong in ({"fault_share": 0.1}, {"lab": LabSpec()}, {"base": "gait"}):
        with pytest.raises(ConfigError, match="no faults"):
            make_rig("mujoco", PANDA, path, **wrong)
