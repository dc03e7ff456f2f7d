"""The narrowest intervals: their readings are those of the truth, and their widths those of simpler derivations."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.foreign_cases import CASES
from benchmarks.foreign_motions import POSITION_NOISE, simulate
from benchmarks.foreign_oracle import Truth, intervals
from benchmarks.foreign_truth import make, numbers

from trueup.core.parameters import Parameter

SHORT = {"engine": "mujoco", "motions": 2, "duration_s": 3.0, "velocity": True}
ARM, PANDA = (replace(next(case for case in CASES if case.name == name), **SHORT) for name in ("demo_arm", "panda"))
DRIVES = {"position": replace(ARM, torque=True), "velocity": PANDA, "torque": replace(ARM, drive="torque")}


@pytest.fixture(scope="module", params=list(DRIVES))
def made(request, tmp_path_factory):
    """A case of each drive, and where it was written."""
    import mujoco

    case, folder = DRIVES[request.param], tmp_path_factory.mktemp("made")
    make(case, 0, folder)
    _, true, _ = numbers(case, mujoco.MjModel.from_xml_path(str(folder / "model.xml")), 0)
    return case, folder, true


@pytest.mark.long
def test_readings_are_those_of_the_truth(made):
    case, folder, true = made
    run = simulate(case, folder / "model.xml", true, 0, cause={})
    truth = Truth(case, 0, folder, [1])
    read, windows = truth._readings({}), truth._windows
    rows = windows.begin[:, None] + np.arange(windows.readings)
    # What a loop has commanded before the first reading is not known to it.
    skipped = {"position": 0, "velocity": 0, "torque": 1}[case.drive]
    near = {"position": 2e-6, "velocity": 1e-3, "torque": 2e-6}[case.drive]
    found = read[skipped:, :, : len(case.joints)] * POSITION_NOISE
    np.testing.assert_allclose(found, run.position[rows, 1][skipped:], atol=near)
    if case.torque:
        rms = np.sqrt((run.torque[:, 1] ** 2).mean(axis=0))
        np.testing.assert_allclose(read[0, :, 3:] * 0.02 * rms, run.torque[:, 1], atol=2e-3 * rms.max())


@pytest.mark.long
@pytest.mark.parametrize("made", ["position"], indirect=True)  # commands of the others answer to what the robot does
def test_derivatives_are_those_of_another_truth(made):
    case, folder, true = made
    item = Parameter("armature[elbow]", 0.1, "kg m2", 1e-4, 10.0, transform="log")
    slope = Truth(case, 0, folder, [0]).slope(item).reshape(-1, 6)[:, :3]
    more = replace(true, armature=true.armature * np.array([1.0, 1.0, 1.02]))
    less = replace(true, armature=true.armature / np.array([1.0, 1.0, 1.02]))
    up, down = (simulate(case, folder / "model.xml", own, 0, cause={}).position[:, 0] for own in (more, less))
    expected = (up - down) / (2 * np.log(1.02)) / POSITION_NOISE
    assert np.linalg.norm(slope - expected) < 0.1 * np.linalg.norm(expected)


@pytest.mark.slow
def test_more_motions_tell_more_and_unknown_states_less(made):
    case, folder, _ = made
    names = [f"{name}[{joint}]" for name in ("damping", "armature") for joint in case.joints[::2]]
    one, two = (intervals(case, 0, folder, motions, names) for motions in ([0], [0, 1]))
    for few, many in zip(one, two, strict=True):
        assert few["low"] < many["low"] < many["truth"] < many["high"] < few["high"]
    truth = Truth(case, 0, folder, [0])
    slopes = np.random.default_rng(0).normal(size=(3, truth._readings({}).size))
    lost = truth.lost(slopes)
    if case.drive == "torque":
        assert np.linalg.eigvalsh(lost).min() > 0
        assert np.linalg.eigvalsh(slopes @ slopes.T - lost).min() > 0
    else:
        assert not lost.any()


@pytest.mark.slow
@pytest.mark.parametrize("made", ["velocity"], indirect=True)
@pytest.mark.parametrize("share", [20.0, 0.5])
def test_a_largest_torque_that_is_known_to_a_tenth_tells_less_where_a_drive_saturates(made, share, monkeypatch):
    """With limits at half of what the motions ask for, and with some that none reaches."""
    case, folder, true = made
    full = replace(
        true, limit=share * np.abs(simulate(case, folder / "model.xml", true, 0, cause={}).torque).max((0, 1)) * 1.01
    )
    monkeypatch.setattr("benchmarks.foreign_oracle.numbers", lambda *_: (None, full, None))
    names = [f"{name}[{joint}]" for name in ("kv", "frictionloss") for joint in case.joints]

    def widths():
        rows = intervals(case, 0, folder, [0], names)
        assert [row["name"] for row in rows] == names
        return np.log([row["high"] / row["low"] for row in rows])

    now = widths()
    monkeypatch.setattr("benchmarks.foreign_oracle._LIMIT", 1e-6)
    ratio = now / widths()
    assert ratio.min() > 0.999
    assert (ratio.max() > 2.0) == (share < 1.0)
