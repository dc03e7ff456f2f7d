"""Information that is real: directions in which nothing changes hold none, others all of it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from scipy.linalg import eigh

from identify.plain_truth import MODEL, pendulum_logs
from identify.recovery_cases import Truth, arm
from trueup.core.fit_result import ModelRow
from trueup.core.parameters import Parameter, ParameterSet
from trueup.core.time_limit import TimeLimit
from trueup.identify import IdentifyConfig, identify
from trueup.identify.candidate import Nominal
from trueup.identify.config import make_parameters
from trueup.identify.discretization import Alternative, Discretization, probability
from trueup.identify.model_search import ModelSearch, TriedModel
from trueup.identify.problem import Problem, Weights
from trueup.identify.search import Search, Stopwatch
from trueup.identify.segments import SegmentRule, make_segments
from trueup.identify.sensitivity import agreed, invariant, jitter_of, split_shifts, verified
from trueup.identify.solution import Solution, SolveSettings
from trueup.identify.uncertainty import noise_level, noise_of, precision_of, resolution_of

SCALED = ("kp", "kv", "damping", "frictionloss", "armature", "mass")


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory):
    return pendulum_logs(tmp_path_factory.mktemp("pendulum"))


def fitted(pendulum, fit):
    return identify(pendulum.episodes, pendulum.robot, pendulum.model, config=IdentifyConfig(fit=fit, models={})).result


def problem_of(pendulum, fit):
    nominal = Nominal(pendulum.robot, pendulum.model)
    segments, _ = make_segments(pendulum.episodes["train"], nominal.simulator, SegmentRule())
    parameters = make_parameters(dict.fromkeys(fit, "all"), nominal).at(pendulum.truth)
    return Problem(nominal, parameters, segments)


def test_torques_and_masses_times_a_factor_are_the_same_motion_and_hold_no_information(pendulum):
    problem = problem_of(pendulum, SCALED)
    z = problem.parameters.start
    (scale, *_) = invariant(problem.parameters, z)
    far = problem.residuals(np.array([z, z + 0.5 * scale]))
    assert np.abs(far[1] - far[0]).max() < 1e-6 * np.abs(far[0]).max()
    search = Search(problem, SolveSettings(), Stopwatch(), checkpoint=None, on_progress=None)
    jacobian = search.certain_jacobian(z)
    weight = noise_of(problem, far[0]).weight
    real = verified(problem, z, jacobian, weight)
    assert np.linalg.norm(scale @ real) ** 2 / weight < 0.1
    # What the data do show, of a delay or a ratio of gains, stays.
    other = np.zeros_like(z)
    other[0] = 1.0
    assert np.linalg.norm(other @ real) == pytest.approx(np.linalg.norm(other @ jacobian), rel=0.1)


@pytest.mark.long
def test_the_split_of_damping_between_servo_and_joint_is_not_known(pendulum):
    problem = problem_of(pendulum, SCALED)
    z = problem.parameters.at({"kv[j]": 0.999, "damping[j]": 0.001}).start
    weight = noise_of(problem, problem.residuals(z[None])[0]).weight
    search = Search(problem, SolveSettings(), Stopwatch(), checkpoint=None, on_progress=None)
    real = verified(problem, z, search.certain_jacobian(z), weight)
    (shift,) = split_shifts(problem, z, real, weight)
    names = [item.name for item in problem.parameters.free]
    assert shift[names.index("kv[j]")] == pytest.approx(-1.0 / np.sqrt(12.0), rel=0.01)
    moved = problem.parameters.values(z + shift)
    assert moved["damping[j]"] == pytest.approx(0.001 + 1.0 / np.sqrt(12.0), rel=0.01)
    # A time step may tell the two apart, which says nothing of the robot; a torque may, too, and is believed.
    apart = np.zeros_like(real)
    apart[names.index("kv[j]"), 0] = 1000.0 * np.sqrt(weight)
    (same,) = split_shifts(problem, z, apart, weight)
    np.testing.assert_allclose(same, shift)
    weighed = Problem(
        problem.nominal, problem.parameters, problem.segments, weights=Weights({"position": 1.0, "torque": 1.0}, {})
    )
    (shift,) = split_shifts(weighed, z, apart, weight)
    assert shift[names.index("kv[j]")] == pytest.approx(-1e-3, rel=0.01)


def test_errors_of_derivatives_are_no_information_where_the_true_ones_cancel():
    rng = np.random.default_rng(3)
    true = rng.standard_normal((6, 4000))
    true[5] = -true[4]
    one, other = (true + 0.01 * rng.standard_normal(true.shape) for _ in range(2))
    nothing = np.array([0.0, 0, 0, 0, 1, 1])
    real = agreed(one, other)
    assert np.linalg.norm(nothing @ one) > 0.8
    assert np.linalg.norm(nothing @ real) < 0.1 * np.linalg.norm(nothing @ one)
    for direction in np.eye(6):
        assert np.linalg.norm(direction @ real) == pytest.approx(np.linalg.norm(direction @ true), rel=0.01)
    np.testing.assert_allclose(agreed(true[:5], true[:5]), true[:5], atol=1e-6)
    # What one of them does not show at all is not known.
    other[0] = 0.0
    assert not agreed(one, other)[0].any()


class Kinked(Problem):
    """Thirty numbers of which motions show some combinations alone, with kinks all over."""

    def __init__(self, shown, seed):
        rng = np.random.default_rng(seed)
        self.coarse, self.starts = None, {}
        self.parameters = ParameterSet(
            tuple(Parameter(f"com_x[{number}]", 0.0, "m", -10.0, 10.0, prior_std=1.0) for number in range(30))
        )
        self.true = rng.standard_normal((30, shown)) @ rng.standard_normal((shown, 400)) / 20
        self._kinks = 5e-6 * rng.standard_normal((30, 400)) * np.linalg.norm(self.true, axis=1)[:, None]
        self._phase = rng.uniform(0.0, 6.0, 30)

    def residuals(self, z):
        return z @ self.true + np.sin(700.0 * z + self._phase) @ self._kinks


# Where more than half of all directions show nothing, not all of them are looked at.
@pytest.mark.parametrize(("shown", "share"), [(12, 1.3), (18, 0.4), (24, 0.4)])
@pytest.mark.parametrize("seed", range(3))
def test_to_look_along_a_direction_adds_no_information_that_is_not_there(shown, share, seed):
    """Directions of one round are nearly those of the one before; their difference was none that was simulated."""
    problem, weight = Kinked(shown, seed), 1e-6
    z = problem.parameters.start
    moves = 0.002 * np.eye(z.size)
    jacobian = (problem.residuals(moves) - problem.residuals(-moves)) / 0.004
    true = problem.true @ problem.true.T / weight + precision_of(problem.parameters)

    def too_much(own):
        """By how much information is more than it can be, in the direction where it is most."""
        return eigh(own @ own.T / weight + precision_of(problem.parameters), true, eigvals_only=True)[-1]

    real = verified(problem, z, jacobian, weight)
    assert too_much(jacobian) > 1000.0
    assert too_much(real) < share * too_much(jacobian)
    assert np.linalg.norm(real - problem.true) < 0.05 * np.linalg.norm(problem.true)


class Jittering(Kinked):
    """Four strong numbers whose common factor shows next to nothing, eight weak ones, and a simulation that jitters."""

    OBSERVATION = 1e-3

    def __init__(self, seed):
        rng = np.random.default_rng(seed)
        self.coarse, self.starts, self.seed = None, {}, seed
        self.parameters = ParameterSet(
            tuple(Parameter(f"com_x[{number}]", 0.0, "m", -10.0, 10.0, prior_std=1.0) for number in range(12))
        )
        self.true = self._rows(rng, 12, np.geomspace(5.0, 0.02, 12)[:, None])
        self.true[:3] = self._rows(rng, 3, 5000.0)
        self.true[3] = self._rows(rng, 1, 2.0)[0] - self.true[:3].sum(axis=0)

    def _rows(self, rng, count, size):
        drawn = rng.standard_normal((count, 400))
        return size * self.OBSERVATION * drawn / np.linalg.norm(drawn, axis=1, keepdims=True)

    def residuals(self, z):
        jitter = [self._rows(np.random.default_rng([self.seed, *row.view(np.uint32)]), 1, 0.05)[0] for row in z]
        return z @ self.true + np.array(jitter)


@pytest.mark.parametrize("seed", range(6))
def test_the_jitter_of_a_simulation_is_no_information(seed):
    """A direction in which a number moves that hardly counts is a tiny step for the others: jitter over it is huge."""
    problem, weight = Jittering(seed), Jittering.OBSERVATION**2
    z = problem.parameters.start

    def central(step):
        moves = step * np.eye(12)
        return (problem.residuals(moves) - problem.residuals(-moves)) / (2.0 * step)

    real = verified(problem, z, agreed(central(0.01), central(0.002)), weight)
    factor = np.array([1.0] * 4 + [0.0] * 8)
    assert np.linalg.norm(factor @ real) < 15.0 * Jittering.OBSERVATION
    # What counts is seen as it is.
    sizes = np.linalg.norm(real, axis=1) / np.linalg.norm(problem.true, axis=1)
    assert sizes[:4] == pytest.approx(1.0, rel=0.02)
    # What hardly counts is not called known.
    assert np.linalg.norm(real[4:], axis=1).max() < 4.0 * Jittering.OBSERVATION


def test_a_slope_at_a_bound_is_no_jitter():
    problem = Jittering(0)
    problem.residuals = lambda z: z @ problem.true
    z = problem.parameters.start.copy()
    z[:3] = problem.parameters.bounds[1][:3]
    assert jitter_of(problem, z) < 1e-9 * Jittering.OBSERVATION
    assert 0.02 < jitter_of(Jittering(0), z) / Jittering.OBSERVATION < 0.1


def test_with_masses_that_are_known_the_scale_is_seen(pendulum):
    problem = problem_of(pendulum, SCALED[:-1])
    z = problem.parameters.start
    search = Search(problem, SolveSettings(), Stopwatch(), checkpoint=None, on_progress=None)
    weight = noise_of(problem, problem.residuals(z[None])[0]).weight
    real = verified(problem, z, search.certain_jacobian(z), weight)
    (scale, *_) = invariant(problem.parameters, z)
    assert np.linalg.norm(scale @ real) ** 2 / weight > 1000.0


def test_the_scale_of_a_joint_that_moves_next_to_nothing_is_not_known(tmp_path):
    """The last joint's own armature and friction are all that its servo feels: any factor of them is the same motion."""
    robot, path = arm(tmp_path)
    light = path.read_text().replace(
        'mass="0.6" diaginertia="0.001 0.005 0.004"', 'mass="1e-5" diaginertia="1e-8 1e-8 1e-8"'
    )
    path.write_text(light)
    nominal = Nominal(robot, path)
    segments, _ = make_segments([Truth(robot, nominal, {}).log(1, seconds=4.0)], nominal.simulator, SegmentRule())
    fit = dict.fromkeys(("delay_s", "kp", "kv", "damping", "frictionloss", "armature"), "all")
    problem = Problem(nominal, make_parameters(fit, nominal), segments)
    z = problem.parameters.start
    weight = noise_of(problem, problem.residuals(z[None])[0]).weight
    search = Search(problem, SolveSettings(), Stopwatch(), checkpoint=None, on_progress=None)
    exact = search.certain_jacobian(z)
    # One part of a hundred is what kinks of dry friction do to derivatives.
    errors = np.random.default_rng(0).standard_normal(exact.shape)
    errors *= 0.01 * np.linalg.norm(exact, axis=1, keepdims=True) / np.sqrt(exact.shape[1])
    names = [item.name for item in problem.parameters.free]
    shoulder, elbow = (
        np.array([name.endswith(f"[{joint}]") and not name.startswith("delay") for name in names], dtype=float)
        for joint in robot.joint_names
    )
    assert np.linalg.norm(elbow @ (exact + errors)) ** 2 / weight > 10.0
    real = verified(problem, z, exact + errors, weight, quick=True)
    assert np.linalg.norm(elbow @ real) ** 2 / weight < 0.01
    assert np.linalg.norm(shoulder @ real) == pytest.approx(np.linalg.norm(shoulder @ exact), rel=0.01)


@pytest.mark.long
def test_everything_free_is_not_determined_and_not_ok(tmp_path):
    pendulum = pendulum_logs(tmp_path, kv=MODEL["kv"], damping=0.4)  # kv is not fitted
    fit = dict.fromkeys(("kp", "damping", "frictionloss", "armature", "mass"), "all")
    found = fitted(pendulum, fit)
    assert found.status != "ok"
    for name, true in pendulum.truth.items():
        if name in found.values:
            low, high = found[name].interval
            assert low < true < high, found[name]
    assert found["kp[j]"].identified != "yes"


@pytest.mark.long
def test_a_finer_truth_is_found_and_its_numbers_lie_in_their_intervals(pendulum):
    """The truth has a twentieth of the model's time step, as a robot has none."""
    assert mujoco.MjModel.from_xml_path(str(pendulum.model)).opt.timestep == pytest.approx(0.005)
    fit = dict.fromkeys(("delay_s", "kp", "kv", "frictionloss", "armature"), "all")
    found = fitted(pendulum, fit)
    assert found.data["timestep_s"] < 0.005
    assert any("time step" in line for line in found.statements)
    for name in ("kp[j]", "frictionloss[j]", "armature[j]"):
        low, high = found[name].interval
        assert low < pendulum.truth[name] < high, found[name]
        assert found[name].value == pytest.approx(pendulum.truth[name], rel=0.1)


@pytest.mark.long
def test_a_finer_step_that_could_not_be_finished_is_not_begun(pendulum, monkeypatch):
    """What it would change is in the intervals."""
    monkeypatch.setattr("trueup.identify.model_search._TO_FINISH", 1e9)
    config = IdentifyConfig(fit=dict.fromkeys(("kp", "kv", "frictionloss", "armature"), "all"), models={})
    limit = TimeLimit.after(600.0)
    found = identify(pendulum.episodes, pendulum.robot, pendulum.model, config=config, limit=limit).result
    assert found.data["timestep_s"] == pytest.approx(0.005)
    assert not found.solver.get("short_of_time")
    for name in ("kp[j]", "frictionloss[j]", "armature[j]"):
        low, high = found[name].interval
        assert low < pendulum.truth[name] < high, found[name]


def in_intervals(found, truth):
    """The numbers that are called determined, and which of them do not hold the truth."""
    known = [item for item in found.parameters if item.identified == "yes" and item.name in truth]
    return known, [item for item in known if not item.interval[0] <= truth[item.name] <= item.interval[1]]


@pytest.mark.long
def test_a_logged_torque_tells_the_scale_of_all_torques(tmp_path):
    pendulum = pendulum_logs(tmp_path, torque=True, mass=0.6)
    fit = dict.fromkeys(("kp", "kv", "frictionloss", "armature"), "all") | {"mass": {"prior_std": 0.1}}
    found = fitted(pendulum, fit)
    known, missed = in_intervals(found, pendulum.truth)
    assert {"kp[j]", "mass[link]"} <= {item.name for item in known}
    assert not missed
    assert found["mass[link]"].value == pytest.approx(0.6, rel=0.02)
    assert any("torque is fitted too" in line for line in found.statements)
    mirrored = [
        replace(
            log, measured=replace(log.measured, signals={**log.measured.signals, "torque": -log.measured["torque"]})
        )
        for log in pendulum.episodes["train"]
    ]
    logs = {"train": mirrored, "val": pendulum.episodes["val"]}
    other = identify(logs, pendulum.robot, pendulum.model, config=IdentifyConfig(fit=fit, models={})).result
    assert any("torque is not used" in line for line in other.statements)
    assert other["kp[j]"].identified != "yes" or in_intervals(other, pendulum.truth)[1] == []


@pytest.mark.long
def test_the_shape_of_a_link_is_no_better_known_than_its_mass(tmp_path):
    """Its mass grew by a fifth and its inertia did not, which the armature makes up for."""
    pendulum = pendulum_logs(tmp_path, torque=True, mass=0.6, shaped=False)
    fit = dict.fromkeys(("kp", "kv", "frictionloss", "armature"), "all") | {"mass": {"prior_std": 0.1}}
    found = fitted(pendulum, fit)
    known, missed = in_intervals(found, pendulum.truth)
    assert {"kp[j]", "mass[link]"} <= {item.name for item in known}
    assert not missed
    assert found["armature[j]"].value != pytest.approx(pendulum.truth["armature[j]"], rel=0.015)


@pytest.mark.long
def test_a_bound_that_nobody_asked_for_is_moved_where_it_is_hit(tmp_path):
    pendulum = pendulum_logs(tmp_path, logged_late_s=0.04)
    fit = dict.fromkeys(("delay_s", "kp", "kv", "frictionloss", "armature"), "all")
    found = fitted(pendulum, fit)
    assert found["delay_s[j]"].value == pytest.approx(-0.04, abs=1e-3)  # the catalogue ends at -0.02
    assert found["delay_s[j]"].at_bound == ""
    asked = {**fit, "delay_s": {"low": -0.02}}
    kept = fitted(pendulum, asked)
    assert kept["delay_s[j]"].at_bound == "low"
    assert kept["delay_s[j]"].value == -0.02


@pytest.mark.slow
def test_windows_begin_where_the_motion_that_follows_says(tmp_path):
    pendulum = pendulum_logs(tmp_path, driven=True)
    fit = dict.fromkeys(("damping", "frictionloss", "armature"), "all") | {"mass": {"prior_std": 0.1}}
    found = fitted(pendulum, fit)
    assert found.whiteness["j"].rms < 1.3 * 3e-4  # of the encoder; with starts as they are measured it is 1 mrad
    known, missed = in_intervals(found, pendulum.truth)
    assert known
    assert not missed


@pytest.mark.long
def test_friction_that_creeps_is_told_from_friction_that_holds(tmp_path):
    fit = dict.fromkeys(("kp", "kv", "frictionloss", "armature"), "all")
    for soft in (True, False):
        pendulum = pendulum_logs(tmp_path, soft=soft, frictionloss=0.4)
        found = fitted(pendulum, fit)
        assert any("creeps" in line for line in found.statements) == soft
        assert found["frictionloss[j]"].value == pytest.approx(0.4, rel=0.03)


def test_third_differences_show_the_noise_and_not_what_moves_slowly():
    rng = np.random.default_rng(0)
    slow = 3.0 * np.sin(np.arange(4000) / 60.0)
    assert noise_level([slow + 0.1 * rng.standard_normal(4000)]) == pytest.approx(0.1, rel=0.05)
    assert noise_level([np.zeros(2)]) == 0.0


def test_what_a_model_lacks_from_time_to_time_is_not_taken_for_noise():
    rng = np.random.default_rng(1)
    pieces = [0.1 * rng.standard_normal(500) for _ in range(6)]
    for piece in pieces:
        for begin in range(50, 500, 100):
            piece[begin : begin + 40] += 0.5 * rng.standard_normal(40)
    assert np.sqrt(np.mean(np.concatenate(pieces) ** 2)) > 3 * 0.1
    assert 0.1 < noise_level(pieces) < 0.13  # half of the stretches have a part of a burst


def test_an_encoder_s_tick_is_seen_in_its_readings():
    rng = np.random.default_rng(2)
    moved = np.cumsum(rng.standard_normal(2000)) * 1e-3
    assert resolution_of(np.round(moved / 2e-3) * 2e-3) == pytest.approx(2e-3)
    assert resolution_of(moved) == 0.0
    assert resolution_of(np.zeros(10)) == 0.0


def test_what_is_unknown_of_a_change_by_the_step_is_what_is_left():
    shift = np.array([0.3, -0.1])
    now, way = Discretization(4, trapezoidal=True), Discretization(8, trapezoidal=True)
    open_ = Alternative(way, shift, gain=0.0)
    np.testing.assert_allclose(open_.unknown(now), shift)
    np.testing.assert_allclose(Alternative(way, shift, gain=-100.0).unknown(now), shift)
    assert Alternative(way, shift, gain=-100.0).unknown(Discretization()) == 0.0
    assert Alternative(Discretization(trapezoidal=True), shift, gain=0.0).matters(
        Discretization(), np.array([0.1, 1.0])
    )
    assert not Alternative(Discretization(trapezoidal=True), shift, gain=0.0).matters(
        Discretization(), np.array([1.0, 1.0])
    )
    assert not Alternative(Discretization(trapezoidal=True), shift, gain=-100.0).matters(
        Discretization(), np.array([0.1, 1.0])
    )
    assert probability(0.0) == 0.5
    assert probability(20.0) + probability(-20.0) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("finer", "kept"), [("settled", False), ("matters", True), ("no time", True), ("exact", False)]
)
def test_timings_that_were_compared_with_a_large_step_alone_are_both_possible(finer, kept):
    free = ParameterSet((Parameter("mass[a]", 1.0, "kg", 0.1, 10.0, "log"),))
    here, there = (Solution(free, np.array([z]), np.zeros(3), np.ones((1, 3)), 0.0, {}) for z in (0.0, 0.4))
    rival = TriedModel(ModelRow("base", ("mass",), 1, 0.0, {}), there, None)
    shift = np.array([0.0 if finer == "settled" else 1.0])
    search = SimpleNamespace(
        _rival=(rival, "held"),
        _of_this_step=finer == "exact",
        _finer=None
        if finer in ("no time", "exact")
        else Alternative(Discretization(trapezoidal=True), shift, gain=0.0),
        logs=SimpleNamespace(way=Discretization()),
    )
    found = ModelSearch._compared_too_early(search, here, np.array([0.1]))
    assert found == ([{"mass[a]": pytest.approx(0.4)}] if kept else [])
    search._rival = None
    assert not ModelSearch._compared_too_early(search, here, np.array([0.1]))


def test_logs_are_a_simulation_s_only_in_the_way_in_which_that_was_found():
    """Friction that creeps, or another timing of commands, explains what looked like the error of a large step."""
    found = Discretization()
    search = SimpleNamespace(_simulated=None, logs=SimpleNamespace(way=found))
    assert not ModelSearch._of_this_step.fget(search)
    search._simulated = found
    assert ModelSearch._of_this_step.fget(search)
    for other in ({"rigid": False}, {"command": "linear"}, {"trapezoidal": True}):
        search.logs.way = replace(found, **other)
        assert not ModelSearch._of_this_step.fget(search)


@pytest.mark.parametrize(("gain", "better", "kept"), [(-100.0, False, False), (0.0, False, True), (100.0, True, False)])
def test_what_the_data_do_not_decide_is_kept_for_the_intervals(gain, better, kept):
    free = ParameterSet((Parameter("mass[a]", 1.0, "kg", 0.1, 10.0, "log"),))
    solution = Solution(free, np.zeros(1), np.zeros(3), np.ones((1, 3)), 0.0, {})
    best = TriedModel(ModelRow("base", ("mass",), 1, 0.0, {}), solution, None)
    search = SimpleNamespace(_undecided=[])
    assert ModelSearch._better(search, Alternative(Discretization(), np.array([0.4]), gain), best) is better
    assert search._undecided == ([{"mass[a]": pytest.approx(0.4 * 0.5**0.5)}] if kept else [])
