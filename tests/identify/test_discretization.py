"""Two ways to simulate the same logs are compared by steps that stay in the valley of what the data determine."""

import numpy as np
import pytest

from trueup.core.parameters import Parameter, ParameterSet
from trueup.identify.discretization import Discretization, alternative, finer
from trueup.identify.problem import Problem
from trueup.identify.search import Search, Stopwatch
from trueup.identify.solution import SolveSettings
from trueup.identify.uncertainty import noise_of

NOISE = 1e-3


class Valley(Problem):
    """A residual that shows the sum of two numbers well, and each of them next to not at all, as kv and damping."""

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
