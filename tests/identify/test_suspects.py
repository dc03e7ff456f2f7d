"""What a model lacks is named with its size, and nothing is where it lacks nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.identify.lacking_truth import Lack, arm_logs

from trueup.core.fit_result import FitResult
from trueup.core.time_limit import TimeLimit
from trueup.identify import IdentifyConfig, Nominal, Problem, SegmentRule, SolveSettings, identify, make_segments, solve
from trueup.identify.config import make_parameters
from trueup.identify.suspects import strange_masses, suspects_of


def searched(folder, lack, seed=0, *, masses=True):
    """A plain search of the default numbers: the problems of train and val, where it ended, and its settings."""
    robot, model, logs = arm_logs(folder, lack, seed=seed)
    nominal = Nominal(robot, model)
    fit = IdentifyConfig().resolved(nominal).fit
    parameters = make_parameters({name: own for name, own in fit.items() if masses or name != "mass"}, nominal)
    train, held_out = (
        Problem(nominal, parameters, make_segments(logs[split], nominal.simulator, SegmentRule())[0])
        for split in ("train", "val")
    )
    settings = SolveSettings(solver="gauss-newton")
    return train, held_out, solve(train, settings), settings


def fitted(folder, lack, seed=0, *, val=True, masses=True):
    """Suspects after a plain search, by name."""
    train, held_out, solution, settings = searched(folder, lack, seed, masses=masses)
    return {item.name: item for item in suspects_of(train, held_out if val else None, solution, settings)}


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_nothing_is_named_where_the_model_lacks_nothing(tmp_path, seed):
    assert fitted(tmp_path, Lack(), seed) == {}


NAMED = {
    "late-feedback": (Lack(late_s=0.012), ("a", "b"), 0.012, 0.3),
    "integral": (Lack(ki=80.0), ("a",), 80.0, 0.2),
    "backlash": (Lack(play=0.02), ("a",), 0.02, 0.4),
    "elastic-joint": (Lack(stiffness=150.0), ("a",), None, 0.0),
    "load-friction": (Lack(per_load=0.3), ("b",), 0.3, 0.4),
    "warming": (Lack(per_s=0.1), ("a", "b"), 0.1, 0.4),
    "speed-limit": (Lack(top_speed=2.0), ("b",), None, 0.0),
}


@pytest.mark.long
@pytest.mark.parametrize("name", NAMED)
def test_what_the_model_lacks_is_named_with_its_size(tmp_path, name):
    lack, joints, size, within = NAMED[name]
    found = fitted(tmp_path, lack)
    assert name in found
    suspect = found[name]
    assert set(joints) <= set(suspect.joints)
    assert next(iter(found)) == name
    assert suspect.train > 0.3
    assert suspect.val > 0.3
    assert f"{suspect.val:.0%}" in suspect.sentence
    if size is None:
        assert suspect.sizes == ()
    else:
        assert np.mean(suspect.sizes) == pytest.approx(size, rel=within)


@pytest.mark.long
def test_a_payload_shows_in_masses_that_nobody_could_have_weighed_so(tmp_path):
    train, _, solution, _ = searched(tmp_path, Lack(payload_kg=0.4))
    text = strange_masses(train.parameters, solution.values)
    assert "mass[fore] is" in text
    assert "above the model's" in text


@pytest.mark.long
def test_a_payload_is_named_where_masses_stay_as_they_are(tmp_path):
    found = fitted(tmp_path, Lack(payload_kg=0.4), masses=False)
    assert next(iter(found)) == "payload"
    assert "'fore'" in found["payload"].sentence


@pytest.mark.long
def test_a_mirrored_joint_is_named_and_what_looks_the_same(tmp_path):
    found = fitted(tmp_path, Lack(mirrored=True))
    assert "mirrored" in found
    # In a plane, an arm whose one joint is mirrored is one whose other joint is, seen from behind.
    assert "a or b" in found["mirrored"].sentence


@pytest.mark.long
def test_without_val_a_suspect_says_only_what_it_explains_of_the_fitted_motions(tmp_path):
    found = fitted(tmp_path, Lack(ki=80.0), val=False)
    assert found["integral"].val is None
    assert "val" not in found["integral"].sentence


def test_a_force_does_what_a_constant_torque_of_the_drive_does(tmp_path):
    robot, model, logs = arm_logs(tmp_path, Lack(), seconds=1.5)
    nominal = Nominal(robot, model)
    segments = make_segments(logs["train"], nominal.simulator, SegmentRule())[0]
    problem = Problem(nominal, make_parameters({"torque_offset": "all"}, nominal), segments)
    courses = problem.courses(problem.parameters.start)
    torque = {segment: np.tile([0.4, -0.2], (*own.position[:, 1:].shape[:2], 1)) for segment, own in courses.items()}
    force = {segment: np.stack([own, np.zeros_like(own)]) for segment, own in torque.items()}
    z = problem.parameters.at({"torque_offset[a]": 0.4, "torque_offset[b]": -0.2}).start
    (driven,) = problem.residuals(z[None])
    none = {key: np.zeros_like(own) for key, own in force.items()}
    pushed, free = problem.residuals(np.tile(problem.parameters.start, (2, 1)), [force, none])
    assert np.allclose(pushed, driven, atol=1e-9)
    assert np.linalg.norm(pushed - free) > 1e-3


def test_forces_and_a_moving_base_act_together(tmp_path):
    robot, model, logs = arm_logs(tmp_path, Lack(), seconds=1.5)
    nominal = Nominal(robot, model)
    (segment, *_), _ = make_segments(logs["train"], nominal.simulator, SegmentRule())
    request = segment.plan.request()
    force = np.full((*request.command["position"].shape[:2], 2), 0.3)
    at_rest = nominal.simulator.rollout_candidates(request, [nominal.model], force)
    pull = np.tile([0.0, 0.0, -9.81], (*force.shape[:2], 1))
    on_base = nominal.simulator.rollout_candidates(replace(request, gravity=pull), [nominal.model], force)
    assert np.allclose(at_rest.position, on_base.position, atol=1e-9)
    bare = nominal.simulator.rollout_candidates(request, [nominal.model])
    assert np.abs(bare.position - at_rest.position).max() > 1e-3


@pytest.mark.slow
def test_an_identification_with_a_suspect_is_not_ok_and_is_read_back(tmp_path):
    robot, model, logs = arm_logs(tmp_path, Lack(late_s=0.012))
    result = identify(logs, robot, model, config=IdentifyConfig(models={})).result
    assert result.status == "unexplained"
    assert result.suspects[0].name == "late-feedback"
    assert result.suspects[0].sentence in result.statements[0]
    result.save(tmp_path / "fit.json")
    assert FitResult.load(tmp_path / "fit.json").suspects == result.suspects


@pytest.mark.long
def test_a_logged_torque_shows_late_feedback_that_positions_hide(tmp_path):
    robot, model, logs = arm_logs(tmp_path, Lack(late_s=0.003, torque=True))
    result = identify(logs, robot, model, config=IdentifyConfig(models={})).result
    assert result.status == "unexplained"
    assert [item.name for item in result.suspects] == ["late-feedback"]
    assert np.mean(result.suspects[0].sizes) == pytest.approx(0.003, rel=0.3)


@pytest.mark.long
@pytest.mark.parametrize("torque", [pytest.param(False, marks=pytest.mark.slow), True])
def test_an_identification_of_a_right_model_is_ok(tmp_path, torque):
    robot, model, logs = arm_logs(tmp_path, Lack(torque=torque))
    result = identify(logs, robot, model, config=IdentifyConfig(models={})).result
    assert (result.status, result.suspects) == ("ok", ())


@pytest.mark.long
def test_without_time_nobody_looks_and_that_is_said(tmp_path):
    robot, model, logs = arm_logs(tmp_path, Lack(late_s=0.012), seconds=2.0)
    result = identify(logs, robot, model, limit=TimeLimit.after(0.0)).result
    assert result.suspects == ()
    assert any("no time was left to look for causes" in text for text in result.statements)


def test_a_mass_far_from_its_prior_is_told(tmp_path):
    robot, model, _ = arm_logs(tmp_path, Lack(), seconds=1.5)
    parameters = make_parameters({"mass": {"prior_std": 0.1}}, Nominal(robot, model))
    values = parameters.values(parameters.start)
    assert strange_masses(parameters, values) == ""
    assert strange_masses(parameters, {**values, "mass[fore]": 0.7 * 1.3}) == ""
    text = strange_masses(parameters, {**values, "mass[fore]": 1.4})
    assert "mass[fore] is 0.7 kg above" in text
    assert "payload" in text
