"""Two ways to simulate the same logs are compared by steps that stay in the valley of what the data determine."""

from dataclasses import replace

import numpy as np
import pytest

from identify.plain_truth import pendulum_logs
from trueup.core.parameters import Parameter, ParameterSet
from trueup.identify import IdentifyConfig, Nominal
from trueup.identify.discretization import Discretization, alternative, coarser, extrapolated, finer
from trueup.identify.model_search import ModelSearch
from trueup.identify.problem import Problem
from trueup.identify.search import Search, Stopwatch
from trueup.identify.solution import SolveSettings
from trueup.identify.uncertainty import noise_of

NOISE = 1e-3


class Valley(Problem):
    """A residual that shows the sum of two numbers well, and each of them next to not at all, as kv and damping."""

    evaluations, seconds = 0, 0.0

    def __init__(self, total):
        self.total, self.columns = total, np.array([0])
        self.coarse, self.starts = None, {}
        self.parameters = ParameterSet(
            tuple(
                Parameter(name, value, "1", 1e-3, 1e3, transform="log", prior_std=2.0)
                for name, value in (("kv", 1.7), ("damping", 0.3))
            )
        )
        time = np.arange(400) / 400
        self._shapes = np.sin(7 * time), 1e-4 * np.cos(5 * time)
        noise = NOISE * np.random.default_rng(0).standard_normal(400)
        shapes = np.stack(self._shapes, axis=1)
        # What is left at the minimum tells nothing of either number.
        self._noise = noise - shapes @ np.linalg.lstsq(shapes, noise, rcond=None)[0]

    def residuals(self, z):
        one, other = np.exp(z).T
        total = np.outer(one + other - self.total, self._shapes[0])
        return total + np.outer(one - 1.7, self._shapes[1]) + self._noise

    def colors(self):
        return np.arange(2)

    def by_segment(self, residual):
        yield None, "position", residual.reshape(-1, 1)

    def jacobian(self, z):
        steps = 1e-6 * np.eye(2)
        return (self.residuals(z + steps) - self.residuals(z - steps)) / 2e-6


def search(problem):
    return Search(problem, SolveSettings(), Stopwatch(), checkpoint=None, on_progress=None)


def compared(now, other):
    z = now.parameters.start
    weight = noise_of(now, now.residuals(z[None])[0]).weight
    ends = [search(problem).polished(z, now.jacobian(z), weight) for problem in (now, other)]
    return alternative(now, other, *ends, weight, finer(Discretization()))


@pytest.mark.parametrize("there", [2.2, 1.8, 2.4])
def test_numbers_that_make_up_for_each_other_do_not_hide_what_a_finer_step_finds(there):
    now, fine = Valley(2.0), Valley(there)
    z = now.parameters.start
    found = compared(now, fine)
    assert abs(found.gain) < 10.0  # both explain the data
    assert np.exp(z + found.shift).sum() == pytest.approx(there, abs=0.01)
    assert found.matters(Discretization(), np.array([0.05, 0.3]))


def test_a_way_that_cannot_explain_the_data_is_seen():
    now, other = Valley(2.0), Valley(2.0)
    other._noise = other._noise + 5 * NOISE * np.sin(40 * np.arange(400))
    found = compared(now, other)
    assert found.gain < -100.0
    assert not found.matters(Discretization(), np.array([1e-6, 1e-6]))


@pytest.mark.long
def test_a_delay_that_was_taken_for_damping_is_given_back(tmp_path):
    pendulum = pendulum_logs(tmp_path)
    late_s = 0.03
    logs = {
        split: [replace(log, command=replace(log.command, time_s=log.command.time_s - late_s)) for log in own]
        for split, own in pendulum.episodes.items()
    }
    fit = dict.fromkeys(("delay_s", "kp", "kv", "frictionloss", "armature"), "all")
    config = IdentifyConfig(fit=fit, models={})
    search = ModelSearch(
        Nominal(pendulum.robot, pendulum.model), logs, config, jobs=1, seed=0, checkpoints=None, on_progress=None
    )
    best = search._try("base", fit)
    found = best.solution
    assert found.values["delay_s[j]"] == pytest.approx(late_s, abs=0.003)
    # As far along the valley as a search gets that takes all of it for damping, and for the inertia that belongs to it.
    kp, total = found.values["kp[j]"], found.values["kv[j]"] + 0.1
    changed = {
        "delay_s": 0.0,
        "kv": found.values["kv[j]"] + kp * late_s,
        "armature": found.values["armature[j]"] + kp * late_s**2 / 2 + total * late_s,
    }
    valley = at(search, best, **changed)
    back = search._exchanged(valley, fit, rough=False, limit=None)
    assert back.solution.rms < 1.01 * found.rms
    assert back.solution.values["delay_s[j]"] == pytest.approx(late_s, abs=0.003)


def at(search, item, **changed):
    """A fit that has ended elsewhere."""
    found = item.solution
    z = found.parameters.at({**found.values, **{f"{name}[j]": value for name, value in changed.items()}}).start
    (row,) = search.problem_of(item).residuals(z[None])
    return replace(item, solution=replace(found, z=z, residual=row, rms=float(np.linalg.norm(row))))


def two_timings(folder):
    """A search on the logs of a pendulum, what it fits, and both ways in which commands act between their stamps."""
    pendulum = pendulum_logs(folder)
    fit = dict.fromkeys(("delay_s", "kp", "kv", "frictionloss", "armature"), "all")
    search = ModelSearch(
        Nominal(pendulum.robot, pendulum.model),
        pendulum.episodes,
        IdentifyConfig(fit=fit, models={}),
        jobs=1,
        seed=0,
        checkpoints=None,
        on_progress=None,
    )
    held, linear = (replace(search.logs.way, command=command) for command in ("held", "linear"))
    return search, fit, held, linear


@pytest.mark.long
def test_two_timings_are_compared_at_their_minima_once_a_payload_was_found(tmp_path):
    """Wherever searches have ended, and in whichever of the two: a held command is late by half of 10 ms."""
    search, fit, held, linear = two_timings(tmp_path)
    best = search._try("held", fit)
    search.logs.way = linear
    moving = search._try("linear", fit)
    assert moving.solution.values["delay_s[j]"] == pytest.approx(0.005, abs=1e-3)
    for way, other, item in ((held, linear, best), (linear, held, moving)):
        search.logs.way = way
        early = at(search, item, kv=0.9 * item.solution.values["kv[j]"])
        assert early.solution.rms > 1.05 * item.solution.rms
        search._undecided.clear()
        search._rival = (item, other.command)  # it has no payload
        found = search._certain(replace(early, row=replace(early.row, quantities=(*fit, "payload_mass"))))
        assert found.solution.rms == pytest.approx(min(best.solution.rms, moving.solution.rms), rel=1e-3)
        late_s = 0.0 if search.logs.way == held else 0.005
        assert found.solution.values["delay_s[j]"] == pytest.approx(late_s, abs=0.003)
        # A motion that is as smooth as this one does not tell them apart.
        (undecided,) = search._undecided
        assert abs(undecided["delay_s[j]"]) * 0.02 > 0.001  # in z, of 20 ms


@pytest.mark.long
def test_the_other_timing_begins_where_this_one_has_ended_if_its_own_search_went_astray(tmp_path):
    """More than noise is left, and the held command, which is right, was far worse where its search had ended."""
    search, fit, held, linear = two_timings(tmp_path)
    right = search._try("held", fit)
    astray = at(search, right, kp=3.0 * right.solution.values["kp[j]"])
    search.logs.way = linear
    moving = search._try("linear", fit)
    for kept in (None, astray):
        search.logs.way = linear
        worse = (
            at(search, moving, kv=share * moving.solution.values["kv[j]"]) for share in (0.999, 0.998, 0.995, 0.99)
        )
        best = next(item for item in worse if not search._explained(item))
        search._undecided.clear()
        search._rival = (kept, "held")
        found = search._retimed(best, fit, rough=False, limit=None)
        assert search.logs.way == held
        assert found.solution.rms == pytest.approx(right.solution.rms, rel=1e-2)
        assert found.solution.values["delay_s[j]"] == pytest.approx(0.0, abs=0.003)
    # What is explained to its noise is not searched once more where the other one was hopeless.
    search.logs.way, search._rival = linear, (None, "held")
    assert search._retimed(moving, fit, rough=False, limit=None) is moving


def test_a_step_of_zero_is_told_from_two_others():
    """Where the error of numbers and of residuals is proportional to the square of the step, without simulating it."""
    problem, rng = Valley(2.0), np.random.default_rng(3)
    z, by_step = problem.parameters.start, 0.1 * rng.normal(size=2)
    (left,), more = problem.residuals(z[None]), 0.01 * NOISE * rng.normal(size=400)
    ends = {divisor: (z + by_step / divisor**2, left + 0.3 * (left + more) / divisor**2) for divisor in (1, 2, 4)}
    for larger, now in ((1, 2), (2, 4)):
        told = extrapolated(problem, problem, ends[now], ends[larger], way(now))
        real = alternative(problem, problem, ends[now], (z, left), 1e-300, way(2 * now))
        assert told.way == real.way
        np.testing.assert_allclose(told.shift, real.shift)
        assert told.gain == pytest.approx(real.gain, rel=0.2)
        assert told.lowers == pytest.approx(real.lowers, rel=0.2)
    # What jumps from step to step says nothing for or against half of it.
    jumps = [0.1 * NOISE * rng.normal(size=400) for _ in range(2)]
    told = extrapolated(problem, problem, *((z, left + own) for own in jumps), way(2))
    assert abs(told.gain) < 5.0


def way(divisor):
    return Discretization(divisor, trapezoidal=True)


def test_ways_follow_each_other():
    assert finer(Discretization()) == way(1)
    for divisor in (1, 2, 4):
        assert coarser(finer(way(divisor))) == way(divisor)
    # Outside of the fit, MuJoCo's own damping needs a smaller step; a model that is simulated as it came keeps its own.
    assert way(2).plain == Discretization(8)
    assert Discretization(command="linear").plain == Discretization(command="linear")
