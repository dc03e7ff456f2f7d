"""Logs and configurations that cannot work: a clear statement, no crash, no silent number."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from identify.recovery_cases import JOINTS, SERVO, TORQUE, Truth, arm, nominal_of
from trueup.core.parameters import Parameter, ParameterSet
from trueup.errors import ConfigError, DataError, NameMismatch, NotIdentifiable
from trueup.identify import IdentifyConfig, Problem, SegmentRule, SolveSettings, identify, make_segments, solve
from trueup.identify.config import SolverChoice, make_parameters
from trueup.identify.problem import Weights
from trueup.identify.solvers import GaussNewtonSettings

QUICK = SolverChoice(max_iterations=15)
FIT = {"damping": "all", "frictionloss": "all"}


def logs_of(truth, seeds=(1, 2), **options):
    logs = [truth.log(seed, name=f"log{seed}", seconds=4.0, **options) for seed in seeds]
    return {"train": logs[:1], "val": logs[1:]}


def config(**options):
    return IdentifyConfig(**{"fit": FIT, "models": {}, "solver": QUICK, **options})


@pytest.fixture
def servo(tmp_path):
    robot, nominal = nominal_of(tmp_path, SERVO)
    return Truth(robot, nominal, {"damping[shoulder]": 0.9, "damping[elbow]": 0.5, "frictionloss[elbow]": 0.3})


def changed(episode, *, command=None, measured=None, id=None):
    """The episode with other values of its position signals."""
    out = episode
    if command is not None:
        signals = {"position": command(episode.command["position"])}
        out = replace(out, command=replace(episode.command, signals=signals))
    if measured is not None:
        signals = {**episode.measured.signals, "position": measured(episode.measured["position"])}
        out = replace(out, measured=replace(episode.measured, signals=signals))
    return out if id is None else replace(out, meta=replace(out.meta, id=id))


@pytest.mark.long
def test_a_good_log_says_ok(servo, tmp_path):
    found = identify(logs_of(servo), servo.robot, tmp_path / "arm.xml", config=config())
    assert found.result.status == "ok", found.result.statements
    assert found.result.errors["fitted"]["val"].value < 0.5 * found.result.errors["nominal"]["val"].value


def test_a_constant_command_is_refused(servo, tmp_path):
    logs = logs_of(servo)
    still = {
        split: [changed(log, command=lambda q: np.ones_like(q), measured=lambda q: np.ones_like(q)) for log in own]
        for split, own in logs.items()
    }
    with pytest.raises(NotIdentifiable, match="no joint moves") as caught:
        identify(still, servo.robot, tmp_path / "arm.xml", config=config())
    assert "constant command" in str(caught.value)


def test_no_train_motion_is_refused(servo, tmp_path):
    with pytest.raises(NotIdentifiable, match="no motion to fit"):
        identify({"val": logs_of(servo)["val"]}, servo.robot, tmp_path / "arm.xml", config=config())


@pytest.mark.long
def test_a_frozen_joint_is_named_and_left_alone(servo, tmp_path):
    def stuck(q):
        out = q.copy()
        out[:, 1] = 0.2
        return out

    logs = {split: [changed(log, measured=stuck) for log in own] for split, own in logs_of(servo).items()}
    found = identify(logs, servo.robot, tmp_path / "arm.xml", config=config())
    assert any("elbow does not move although it is commanded" in line for line in found.result.statements)
    assert found.result["damping[elbow]"].frozen
    given, fitted = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml")), found.candidate().compile()
    assert fitted.dof_damping[1] == given.dof_damping[1] == 0.2
    assert fitted.dof_frictionloss[1] == given.dof_frictionloss[1] == 0.15
    assert fitted.dof_damping[0] != given.dof_damping[0]
    assert not found.result["damping[shoulder]"].frozen


@pytest.mark.long
def test_too_little_excitation_is_said_loudly(servo, tmp_path):
    def small(q):
        return 0.01 * q

    logs = {
        split: [changed(log, command=small, measured=lambda q: 0.01 * q) for log in own]
        for split, own in logs_of(servo, noise=2e-3).items()
    }
    found = identify(logs, servo.robot, tmp_path / "arm.xml", config=config(fit={"armature": "all", "kv": "all"}))
    assert found.result.status != "ok"
    assert any(found.result[f"armature[{joint}]"].identified == "no" for joint in JOINTS)
    lines = " ".join(found.result.statements)
    assert "not determined by these motions" in lines
    worst = next(item for item in found.result.parameters if item.identified == "no")
    assert "accelerate" in worst.sentence or "speed" in worst.sentence


@pytest.mark.long
def test_motions_that_no_arm_makes_determine_nothing(servo, tmp_path):
    rng = np.random.default_rng(0)

    def walk(q):
        return np.cumsum(rng.standard_normal(q.shape), axis=0) * 0.02

    logs = {split: [changed(log, measured=walk) for log in own] for split, own in logs_of(servo).items()}
    found = identify(logs, servo.robot, tmp_path / "arm.xml", config=config())
    # The nearest arm is one that sticks: nearer than the command or not by chance, and it has other velocities.
    assert found.result.status in ("no-better", "signal-worse"), found.result.statements
    assert {item.identified for item in found.result.parameters} == {"no"}
    assert any("4 of 4 parameters are not determined" in line for line in found.result.statements)


@pytest.mark.long
def test_a_fit_to_another_robot_is_no_better(servo, tmp_path):
    other = replace(servo, values={"damping[shoulder]": 6.0, "damping[elbow]": 4.0})
    own = replace(servo, values={"damping[shoulder]": 0.4, "damping[elbow]": 0.2})  # as the model has it
    logs = {"train": logs_of(other)["train"], "val": logs_of(own)["val"]}
    found = identify(logs, servo.robot, tmp_path / "arm.xml", config=config())
    assert found.result.status == "no-better", found.result.statements
    assert "another robot" in found.result.statements[0]
    assert found.result["damping[shoulder]"].value == pytest.approx(6.0, rel=0.1), "it does fit that other robot"


def test_joints_with_other_names_are_both_listed(servo, tmp_path):
    log = logs_of(servo)["train"][0]
    other = replace(
        log,
        measured=replace(log.measured, joints=("a", "b")),
        command=replace(log.command, joints=("a", "b")),
    )
    with pytest.raises(NameMismatch, match=r"shoulder, elbow.*\[a, b\]"):
        identify({"train": [other]}, servo.robot, tmp_path / "arm.xml", config=config())


@pytest.mark.parametrize("signal", ["velocity", "torque"])
def test_a_missing_sample_of_a_weighted_signal_is_left_out_and_no_more(servo, signal):
    def with_gap(log, rows):
        signals = {**log.measured.signals, signal: log.measured[signal].copy()}
        signals[signal][rows, 1] = np.nan
        return replace(log, measured=replace(log.measured, signals=signals))

    logs = [with_gap(logs_of(servo)["train"][0], [50]), with_gap(logs_of(servo)["val"][0], slice(1, None))]
    segments, refused = make_segments(logs, servo.nominal.simulator, SegmentRule())
    assert not refused
    parameters = make_parameters({"damping": "all"}, servo.nominal)
    problem = Problem(
        servo.nominal, parameters, segments, weights=Weights({"position": 1.0, signal: 0.01}, {"shoulder": 1.0})
    )
    samples = sum(len(log.measured) for log in logs)
    both = 2 * samples + 2 * (len(logs[0].measured) - 1) + 2
    assert problem.size == both, "positions all count, and what is there of the other signal"
    rows = [(segment.episode_id, name, values.shape) for segment, name, values in problem.by_segment(np.ones(both))]
    assert rows[1] == ("log1", signal, (len(logs[0].measured) - 1, 2))
    assert np.isfinite(problem.residuals(parameters.start[None])).all()
    shoulder = Weights({"position": 1.0, signal: 0.01}, {"elbow": 0.0})
    alone = Problem(servo.nominal, parameters, segments, weights=shoulder)
    assert alone.size == 2 * samples, "a joint that does not count takes nothing from those that do"
    assert solve(problem, SolveSettings()).values["damping[shoulder]"] == pytest.approx(0.9, abs=0.05)


@pytest.mark.long
def test_a_saturated_log_is_named(tmp_path):
    robot, path = arm(tmp_path, TORQUE)
    limited = replace(robot, joints=tuple(replace(joint, torque_limit=2.0) for joint in robot.joints))
    truth = Truth(limited, nominal_of(tmp_path, TORQUE)[1], {"damping[shoulder]": 0.9})
    logs = logs_of(truth, size=6.0)
    found = identify(logs, limited, path, config=config(fit={"damping": "all"}))
    assert any("beyond its torque limit" in line for line in found.result.statements)


@pytest.mark.parametrize(
    ("choice", "match"),
    [
        ({"damping": {"low": 2.0, "high": 1.0}}, "bounds contradict"),
        ({"damping": {"start": 5.0, "high": 1.0}}, "starts outside its bounds"),
        ({"damping": {"low": -1.0}}, "positive by nature"),
        ({"damping": ["wrist"]}, r"\['wrist'\] are not a joint of the robot"),
        ({"damping": {"lower": 1.0}}, "unknown keys"),
        ({"damping": {"low": "small"}}, "must be a number"),
    ],
)
def test_a_wrong_configuration_says_what_and_where(servo, choice, match):
    with pytest.raises(ConfigError, match=match):
        make_parameters(choice, servo.nominal)


def test_an_unknown_quantity_lists_those_that_there_are():
    with pytest.raises(ConfigError, match=r"no quantity 'dampening'.*damping"):
        IdentifyConfig(fit={"dampening": "all"})


def test_a_start_on_its_bound_is_not_a_trap(servo):
    logs = logs_of(replace(servo, values={"frictionloss[elbow]": 0.3}))["train"]
    segments, _ = make_segments(logs, servo.nominal.simulator, SegmentRule())
    start = make_parameters({"frictionloss": {"targets": ["elbow"], "low": 0.15, "start": 0.15}}, servo.nominal)
    solution = solve(Problem(servo.nominal, start, segments), SolveSettings())
    assert solution.values["frictionloss[elbow]"] == pytest.approx(0.3, abs=0.02)


def test_candidates_that_diverge_lose_and_the_fit_goes_on(servo):
    logs = logs_of(servo)["train"]
    segments, _ = make_segments(logs, servo.nominal.simulator, SegmentRule())
    # With a tenth of the armature and a thousand times the gain the simulation explodes at this time step.
    wild = ParameterSet(
        (
            Parameter("damping[shoulder]", 0.4, "Nm s/rad", 0.01, 10.0, "log", prior_std=2.0),
            Parameter("kp[shoulder]", 40.0, "Nm/rad", 1.0, 1e7, "log", prior_std=2.0),
        )
    )
    problem = Problem(servo.nominal, wild, segments)
    _, high = wild.bounds
    residuals = problem.residuals(np.array([wild.start, [wild.start[0], high[1]]]))
    assert np.isfinite(residuals[0]).all()
    assert np.isnan(residuals[1]).all()
    solution = solve(problem, SolveSettings(solver="cma-es", max_evaluations=300))
    assert solution.values["damping[shoulder]"] == pytest.approx(0.9, abs=0.05)


def test_a_start_that_diverges_is_an_error_of_gauss_newton_and_rescued_by_auto(servo):
    logs = logs_of(replace(servo, values={"damping[shoulder]": 0.4}))["train"]
    segments, _ = make_segments(logs, servo.nominal.simulator, SegmentRule())
    wild = ParameterSet((Parameter("kp[shoulder]", 5e6, "Nm/rad", 1.0, 1e7, "log", prior_std=10.0, prior_mean=40.0),))
    problem = Problem(servo.nominal, wild, segments)
    with pytest.raises(DataError, match="cannot be simulated at the start"):
        solve(problem, SolveSettings(solver="gauss-newton"))
    solution = solve(problem, SolveSettings(max_evaluations=200))
    assert solution.values["kp[shoulder]"] == pytest.approx(40.0, rel=0.1)
    assert "diverges at the start" in solution.solver["remark"]


class Interrupted(Exception):
    """Ctrl-C, in a form that a test can raise."""


@pytest.mark.parametrize("solver", ["auto", "gauss-newton", "cma-es", "evolution"])
def test_an_interrupted_fit_resumes_to_the_same_result(servo, tmp_path, solver):
    logs = logs_of(servo)["train"]
    segments, _ = make_segments(logs, servo.nominal.simulator, SegmentRule())
    parameters = make_parameters({"damping": "all"}, servo.nominal)
    settings = SolveSettings(
        solver=solver, max_evaluations=60, gauss_newton=GaussNewtonSettings(max_iterations=5, tolerance=1e-12)
    )
    whole = solve(Problem(servo.nominal, parameters, segments), settings)

    def interrupt(progress):
        if progress.iteration == 3:
            raise Interrupted

    checkpoint = tmp_path / "fit.json"
    with pytest.raises(Interrupted):
        solve(Problem(servo.nominal, parameters, segments), settings, checkpoint=checkpoint, on_progress=interrupt)
    resumed = solve(Problem(servo.nominal, parameters, segments), settings, checkpoint=checkpoint)
    np.testing.assert_array_equal(resumed.z, whole.z)
    assert resumed.solver["iterations"] == whole.solver["iterations"]


@pytest.mark.parametrize("solver", ["gauss-newton", "cma-es", "evolution", "auto"])
def test_a_finished_search_is_not_searched_again(servo, tmp_path, solver):
    segments, _ = make_segments(logs_of(servo)["train"], servo.nominal.simulator, SegmentRule())
    parameters = make_parameters({"damping": "all"}, servo.nominal)
    settings = SolveSettings(solver=solver, max_evaluations=40)
    checkpoint = tmp_path / "fit.json"
    whole = solve(Problem(servo.nominal, parameters, segments), settings, checkpoint=checkpoint)
    steps = []
    again = Problem(servo.nominal, parameters, segments)
    resumed = solve(again, settings, checkpoint=checkpoint, on_progress=steps.append)
    assert not steps
    np.testing.assert_array_equal(resumed.z, whole.z)
    assert resumed.solver["name"] == whole.solver["name"]


def test_a_checkpoint_of_another_problem_is_not_used(servo, tmp_path):
    logs = logs_of(servo)["train"]
    segments, _ = make_segments(logs, servo.nominal.simulator, SegmentRule())
    checkpoint = tmp_path / "fit.json"
    settings = SolveSettings(solver="gauss-newton")
    solve(
        Problem(servo.nominal, make_parameters({"damping": "all"}, servo.nominal), segments),
        settings,
        checkpoint=checkpoint,
    )
    other = Problem(servo.nominal, make_parameters({"frictionloss": "all"}, servo.nominal), segments)
    fresh = solve(other, settings)
    again = solve(other, settings, checkpoint=checkpoint)
    np.testing.assert_array_equal(again.z, fresh.z)
