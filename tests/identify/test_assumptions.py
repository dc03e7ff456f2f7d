"""What the shapes of links take from the certainty of masses, and what no joint shows."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from identify.recovery_cases import JOINTS, SERVO, TORQUE, Truth, arm, nominal_of
from trueup.core.parameters import ParameterSet
from trueup.identify import Nominal, Problem, SegmentRule, SolveSettings, make_segments, solve
from trueup.identify.assumptions import assumption_shifts, unseen
from trueup.identify.config import make_parameters
from trueup.identify.inertial import COMPONENTS
from trueup.identify.regression.equation import mechanism_structure
from trueup.identify.regression.linkage import Linkage
from trueup.identify.search import Search, Stopwatch
from trueup.identify.solution import fingerprint_of
from trueup.identify.uncertainty import noise_of, posterior_of

INERTIAL = ("mass", "com_x", "com_y", "com_z", *(f"inertia_{name}" for name in COMPONENTS))


def test_what_is_unseen_changes_no_torque_in_other_states(tmp_path):
    _, nominal = nominal_of(tmp_path, TORQUE)
    problem = Problem(nominal, make_parameters(dict.fromkeys((*INERTIAL, "armature"), "all"), nominal), ())
    z = problem.parameters.start
    directions = unseen(problem, z)
    np.testing.assert_allclose(directions @ directions.T, np.eye(len(directions)), atol=1e-9)
    rng = np.random.default_rng(5)
    states = [(rng.uniform(-3, 3, 2), rng.normal(size=2), 5 * rng.normal(size=2)) for _ in range(20)]

    def torques(place):
        model = problem.candidate(problem.parameters.values(place)).compile()
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        model.dof_damping[:], data, rows = 0.0, mujoco.MjData(model), []
        for data.qpos[:], data.qvel[:], data.qacc[:] in states:
            mujoco.mj_inverse(model, data)
            rows.append(data.qfrc_inverse.copy())
        return np.concatenate(rows)

    def slope(direction):
        return np.linalg.norm(torques(z + 1e-4 * direction) - torques(z - 1e-4 * direction)) / 2e-4

    usual = slope(np.eye(z.size)[0])
    assert all(slope(direction) < 1e-4 * usual for direction in directions)


def test_as_many_combinations_are_seen_as_the_mechanism_has_base_parameters(tmp_path):
    _, nominal = nominal_of(tmp_path, TORQUE)
    problem = Problem(nominal, make_parameters(dict.fromkeys(INERTIAL, "all"), nominal), ())
    known = mechanism_structure(Linkage(nominal.model, JOINTS), inertial_only=True).rank
    assert len(INERTIAL) * 2 - len(unseen(problem, problem.parameters.start)) == known


def test_single_masses_are_no_more_certain_than_shapes_are_known(tmp_path):
    """Of a link that turns about one axis, inertia shows a sum of its own and of what its place makes of its mass."""
    robot, nominal = nominal_of(tmp_path, TORQUE)
    truth = Truth(robot, nominal, {})
    logs = [truth.log(seed, name=f"log{seed}", size=6.0, noise=5e-6, seconds=4.0) for seed in (1, 2)]
    segments, _ = make_segments(logs, nominal.simulator, SegmentRule(window_s=0.3))
    fit = dict.fromkeys(("mass", "com_x", "inertia_scale"), "all")
    problem = Problem(nominal, make_parameters(fit, nominal), segments)
    found = solve(problem, SolveSettings())
    sharp = posterior_of(problem, found.z, found.residual, found.jacobian)
    weight = noise_of(problem, found.residual).weight
    wide = sharp.widened(assumption_shifts(problem, found.z, found.jacobian, weight))
    names = [item.name for item in problem.parameters.free]
    assert np.all(wide.std >= sharp.std * (1 - 1e-9))
    lower = names.index("mass[lower]")
    assert wide.std[lower] > 3 * sharp.std[lower]
    # Gravity shows the mass times its place, which is as certain as ever.
    values, place = problem.parameters.values(found.z), names.index("com_x[lower]")
    moment = np.zeros(len(names))
    moment[lower], moment[place] = 1.0, problem.parameters.free[place].scale / values["com_x[lower]"]
    assert float(np.sqrt(moment @ wide.covariance @ moment)) < 0.01 * wide.std[lower]


@pytest.mark.long
@pytest.mark.parametrize("limit", [9.0, 500.0])
def test_a_drive_that_saturates_for_moments_does_not_tell_the_scale_of_all_torques(tmp_path, limit):
    robot, path = arm(tmp_path, SERVO)
    limits = f'name="shoulder" actuatorfrcrange="-{limit} {limit}" actuatorfrclimited="true"'
    path.write_text(path.read_text().replace('name="shoulder"', limits))
    nominal = Nominal(robot, path)
    logs = [Truth(robot, nominal, {}).log(seed, noise=3e-4, size=0.6, seconds=6.0, top_hz=3.0) for seed in (1, 2)]
    segments, _ = make_segments(logs, nominal.simulator, SegmentRule())
    fit = dict.fromkeys(("kp", "kv", "armature", "damping", "frictionloss", "mass"), "all")
    problem = Problem(nominal, make_parameters(fit, nominal), segments)
    search = Search(problem, SolveSettings(), Stopwatch(), checkpoint=None, on_progress=None)
    found = search.certain(solve(problem, SolveSettings()).z)
    sharp = posterior_of(problem, found["z"], found["residual"], found["jacobian"])
    weight = noise_of(problem, found["residual"]).weight
    wide = sharp.widened(assumption_shifts(problem, found["z"], found["jacobian"], weight))
    place = [item.name for item in problem.parameters.free].index("kp[elbow]")
    assert (sharp.std[place] < 0.05) == (limit < 100.0)
    assert wide.std[place] > 0.08


def test_a_number_at_its_bound_is_unseen_as_it_is_inside(tmp_path):
    _, nominal = nominal_of(tmp_path, TORQUE)
    inside = make_parameters(dict.fromkeys((*INERTIAL, "armature"), "all"), nominal)
    ends = ParameterSet(
        tuple(replace(item, high=item.value) if item.quantity == "armature" else item for item in inside)
    )
    one, other = (unseen(Problem(nominal, own, ()), own.start) for own in (inside, ends))
    np.testing.assert_allclose(one.T @ one, other.T @ other, atol=1e-3)


def test_a_search_does_not_go_on_from_one_with_other_damping(tmp_path):
    robot, nominal = nominal_of(tmp_path, TORQUE)
    segments, _ = make_segments([Truth(robot, nominal, {}).log(1, seconds=2.0)], nominal.simulator, SegmentRule())
    parameters = make_parameters({"mass": "all"}, nominal)
    plain, other = (Problem(nominal, parameters, segments, trapezoidal=own) for own in (False, True))
    assert fingerprint_of(plain, SolveSettings()) != fingerprint_of(other, SolveSettings())
