"""The quality checks on real recordings: the limit that was hit is found, good motions pass."""

from pathlib import Path

import pytest

from trueup.align import check_quality
from trueup.core.episode import Episode
from trueup.dataset.importers import sage, table
from trueup.dataset.importers.base import ImportOptions


def load(importer, folder: Path, wanted) -> dict[str, Episode]:
    plan = importer.scan(folder, ImportOptions())
    return {source.id: source.load() for source in plan.episodes if any(name in source.id for name in wanted)}


def shown(flags):
    return {(flag.kind, flag.severity, flag.joint) for flag in flags}


def test_so101_hit_its_limit_once(so101_logs):
    (episode,) = load(sage, so101_logs, ["single_joint_wrist_roll"]).values()
    flags = check_quality(episode)
    assert shown(flags) == {("limit_hit", "warning", "Wrist_Roll")}
    # Two light contacts from 43 s on, two hard ones until 71 s.
    assert flags[0].start_s == pytest.approx(43.6, abs=0.5)
    assert flags[0].end_s == pytest.approx(71.0, abs=0.5)


def test_so101_pushed_against_something_halfway(so101_logs):
    # Pitch, Rotation and Wrist_Pitch are pushed off their constant commands while Elbow stands under 4 Nm.
    (episode,) = load(sage, so101_logs, ["workspace_sweep"]).values()
    assert shown(check_quality(episode)) == {("blocked", "warning", "Elbow")}


def test_so101_good_motions_have_no_flags(so101_logs):
    # The largest standing errors, the largest lags, the highest torque peaks and the longest rests of the set.
    names = ["single_joint_elbow", "random_waypoints", "chirp_sweep", "static_holding", "gripper_cycles"]
    episodes = load(sage, so101_logs, names)
    assert len(episodes) == len(names)
    for name, episode in episodes.items():
        assert check_quality(episode) == (), name


def test_double_pendulum_has_notes_only(double_pendulum_logs):
    episodes = load(table, double_pendulum_logs, ["trajectory_00", "trajectory_11"])
    assert len(episodes) == 2
    for episode in episodes.values():
        flags = check_quality(episode)
        assert "jittering_stamps" in {flag.kind for flag in flags}
        assert {flag.severity for flag in flags} == {"note"}


def test_simple_pendulum_rests_on_its_encoder_and_swings_far_from_its_goal(simple_pendulum_logs):
    for episode in load(table, simple_pendulum_logs, ["gravity_compensation", "energy_shaping"]).values():
        assert {flag.kind for flag in check_quality(episode)} <= {"gap", "jittering_stamps"}
        assert {flag.severity for flag in check_quality(episode)} <= {"note"}


def test_simple_pendulum_with_two_clocks(simple_pendulum_logs):
    (episode,) = load(table, simple_pendulum_logs, ["direct_collocation"]).values()
    assert ("clock_mismatch", "warning", "") in shown(check_quality(episode))
