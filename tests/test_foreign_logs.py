"""Logs of other programs are judged by what was written, not by whether something was read."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.foreign_logs import KINDS, tried
from benchmarks.recorded import Kind, Recorded

from check.arm_logs import arm, logs

# Of those whose writers are there anyway.
OURS = (
    "json: steps with vectors",
    "numpy: npz",
    "scipy: a struct",
    "h5py: groups",
    "rosbags: ROS 2, sqlite3, an array",
)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    robot, model = arm(tmp_path_factory.mktemp("arm"), "position")
    episode = logs(robot, model, np.random.default_rng(1))[0]
    time_s, told = episode.measured.time_s, episode.command
    rows = np.maximum(np.searchsorted(told.time_s, time_s + 1e-9, side="right") - 1, 0)
    return model, Recorded(episode.measured.joints, time_s, episode.measured["position"], told["position"][rows])


def outcome(kind, recorded, folder):
    model, truth = recorded
    (folder / "logs").mkdir()
    kind.write(folder / "logs", truth)
    return tried(kind, model, folder / "logs", truth, folder)


@pytest.mark.parametrize("name", OURS)
def test_what_was_written_is_read(recorded, tmp_path, name):
    assert outcome(KINDS[name], recorded, tmp_path)["tries"] == 1


def test_other_numbers_are_found_out(recorded, tmp_path):
    kind = KINDS["numpy: npz"]

    def write(folder, truth):
        kind.write(folder, replace(truth, done=truth.done + 1e-4))

    found = outcome(replace(kind, write=write), recorded, tmp_path)
    assert found["wrong"].startswith("measured: 0.0001 rad away")


def test_a_second_try_needs_a_message_that_leads_to_it(recorded, tmp_path):
    def write(folder, truth):
        rows = np.column_stack([truth.time_s, truth.done, truth.told])
        np.savetxt(folder / "run.csv", rows, delimiter=",")

    names = recorded[1].joints
    columns = [f"{word}{number}" for word in "qu" for number in range(1, 1 + len(names))]
    mapping = f"""joints: [{", ".join(names)}]
header: [time, {", ".join(columns)}]
series:
  measured: {{time: time, signals: {{position: {{columns: "q{{n}}", unit: rad}}}}}}
  command: {{time: time, signals: {{position: {{columns: "u{{n}}", unit: rad}}}}}}
"""
    kind = Kind(write, second={"mapping": mapping}, named=("header: [time",))
    assert outcome(kind, recorded, tmp_path)["tries"] == 2
    (tmp_path / "again").mkdir()
    assert outcome(replace(kind, named=("another word",)), recorded, tmp_path / "again")["tries"] is None
