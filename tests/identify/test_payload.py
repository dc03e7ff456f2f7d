"""Fits of motions with several payloads: each is simulated with what it carries."""

import re
from dataclasses import replace

import numpy as np
import pytest

from identify.lacking_truth import Lack, arm_logs
from identify.recovery_cases import JOINTS, SERVO, arm, wave
from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.timeseries import TimeSeries, same_units
from trueup.identify import IdentifyConfig, Nominal, Problem, SegmentRule, SolveSettings, identify, make_segments, solve
from trueup.identify.config import make_parameters
from trueup.identify.solution import fingerprint_of
from trueup.robots import PayloadSpec, Setup
from trueup.sim import MujocoSimulator, ReplaySettings, replay_episode


def carrying(folder, payloads):
    """An arm that says where it holds things, and what it does with each of them."""
    robot, path = arm(folder, SERVO)
    robot = replace(robot, payload=PayloadSpec(("payload",)))
    logs = []
    for seed, payload_kg in enumerate(payloads):
        time_s, target = wave(3.0, 100.0, seed)
        command = TimeSeries(time_s, JOINTS, {"position": target}, same_units({"position": "rad"}, JOINTS))
        meta = EpisodeMeta(f"log{seed}", payload_kg=payload_kg, split="train")
        simulator = MujocoSimulator.from_robot(robot, path, setup=Setup(payload_kg))
        logs.append(
            Episode(meta, replay_episode(Episode(meta, command, command), simulator, ReplaySettings()), command)
        )
    return Nominal(robot, path, hard_friction=False), logs


def problem_of(nominal, logs):
    segments, _ = make_segments(logs, nominal.simulator, SegmentRule())
    return Problem(nominal, make_parameters({"damping": "all"}, nominal), segments)


def test_the_true_model_has_no_residual_whatever_is_carried(tmp_path):
    nominal, logs = carrying(tmp_path, (0.0, 1.5, 0.0, 0.4))
    problem = problem_of(nominal, logs)
    start = problem.parameters.start[None]
    assert np.abs(problem.residuals(start)).max() < 1e-9
    # The same motions in a simulator whose hand is empty: what is carried is no small thing.
    empty = Nominal(replace(nominal.given, payload=None), nominal.path, hard_friction=False)
    assert np.sqrt(np.sum(problem_of(empty, logs).residuals(start) ** 2)) > 0.01


def test_damping_is_recovered_from_loaded_and_unloaded_motions(tmp_path):
    nominal, logs = carrying(tmp_path, (0.0, 1.5))
    problem = problem_of(nominal, logs)
    truth = {parameter.name: parameter.value for parameter in problem.parameters}
    wrong = {"damping": {"targets": "all", "start": 1.0}}
    found = solve(problem.with_parameters(make_parameters(wrong, nominal)), SolveSettings())
    values = found.parameters.values(found.z)
    assert values == pytest.approx(truth, rel=0.02)


def test_what_is_carried_decides_whether_a_search_is_gone_on_with(tmp_path):
    nominal, logs = carrying(tmp_path, (0.0, 1.5))
    other = [replace(log, meta=replace(log.meta, payload_kg=2 * log.meta.payload_kg)) for log in logs]
    one, same, heavier = (fingerprint_of(problem_of(nominal, own), SolveSettings()) for own in (logs, logs, other))
    assert one == same != heavier


def test_a_payload_is_looked_for_amid_what_carries_it_or_at_its_site(tmp_path):
    robot, path = arm(tmp_path, SERVO)
    assert Nominal(robot, path).payload_start == (0.0, 0.0, 0.0)
    path.write_text(re.sub("<site[^>]*>", "", path.read_text()))
    assert Nominal(robot, path).payload_start == pytest.approx((0.12, 0.0, 0.0))
    # A flange, as they have one, weighs nothing and is turned: the link before it is what carries.
    flange = '<body name="flange" pos="0.25 0 0" quat="0.70710678 0 0 0.70710678"/></body>'
    path.write_text(path.read_text().replace("</body>", flange, 1))
    assert Nominal(robot, path).payload_start == pytest.approx((0.0, 0.13, 0.0))


@pytest.mark.slow
def test_a_payload_that_nobody_has_described_is_found_and_masses_stay_where_they_are(tmp_path):
    robot, model, logs = arm_logs(tmp_path, Lack(payload_kg=0.4), seconds=3.0)
    models = {"payload": IdentifyConfig().resolved(Nominal(robot, model)).models["payload"]}
    some = {"train": logs["train"][:2], "val": logs["val"][:1]}
    found = identify(some, robot, model, config=IdentifyConfig(models=models)).result
    assert next(row.name for row in found.models if row.chosen) == "payload"
    payload = found["payload_mass"]
    assert payload.interval[0] < 0.4 < payload.interval[1]
    assert payload.value == pytest.approx(0.4, rel=0.1)
    assert [found[name].value for name in ("mass[upper]", "mass[fore]")] == pytest.approx([1.2, 0.7], rel=0.05)
    assert found["payload_z"].value == pytest.approx(0.0, abs=0.01)
    assert any(text.startswith("the robot carries a payload") for text in found.statements)
