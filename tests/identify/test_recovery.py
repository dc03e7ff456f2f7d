"""A known truth, a noisy log, a wrong start: the fit must come back, and its interval must hold what it says."""

import mujoco
import numpy as np
import pytest

from identify.recovery_cases import JOINTS, SERVO, TORQUE, Truth, fit, nominal_of
from trueup.identify import Problem, SegmentRule, make_segments
from trueup.identify.config import make_parameters
from trueup.identify.start import off_bounds

# What is true of the shoulder (the elbow has 0.8 of it), by what is fitted; the fit starts from the model's values.
SERVO_CASES = {
    "viscous and Coulomb": {"damping": 0.9, "frictionloss": 0.6},
    "tanh": {"tanh_coulomb": 0.4, "tanh_velocity": 0.1},
    "sigmoid": {"sigmoid_level": 0.8, "sigmoid_slope": 6.0, "sigmoid_shift": 0.05},
    "Stribeck": {"stribeck": 0.4, "stribeck_velocity": 0.2},
    "load": {"load": 0.15},
    "direction": {"asymmetry": 0.2, "damping": 0.8},
    "dead band": {"dead_band": 0.02},
    "gain and armature": {"armature": 0.1, "kp": 60.0},
    "delay and offset": {"delay_s": 0.023, "torque_offset": 0.4},
    "encoder zero": {"joint_offset": 0.05},
    "velocity gain": {"kv": 2.5},
}
TORQUE_CASES = {
    "friction": {"damping": 0.8, "frictionloss": 0.5, "armature": 0.09},
    "delay": {"delay_s": 0.017, "torque_gain": 1.2},
}
BODY_CASES = {
    "mass": {"mass[upper]": 0.9, "mass[lower]": 0.8},
    "centre of mass": {"com_x[upper]": 0.11, "com_x[lower]": 0.16, "com_z[lower]": 0.03},
    "inertia": {"inertia_d1[lower]": 0.3, "inertia_d3[lower]": -0.2},
    "payload": {"payload_mass": 0.4, "payload_x": -0.03},
}


def truth_of(nominal, case):
    return {
        f"{quantity}[{joint}]": value * (1.0 if joint == "shoulder" else 0.8)
        for quantity, value in case.items()
        for joint in JOINTS
    }


def check(got, true, *, least_identified="yes"):
    """Close in terms of its own interval: six standard deviations would be a wrong answer, not bad luck."""
    for name, value in true.items():
        item = got[name]
        low, high = item.interval
        middle, half = (low + high) / 2, (high - low) / 2
        assert abs(value - middle) < 3 * half, f"{name}: {item.value} {item.interval}, true {value}"
        assert not item.at_bound, name
        assert item.identified == least_identified, f"{name}: {item.sentence}"


@pytest.mark.parametrize("case", SERVO_CASES)
def test_a_position_servo_log_gives_back(case, tmp_path):
    robot, nominal = nominal_of(tmp_path, SERVO)
    true = truth_of(nominal, SERVO_CASES[case])
    truth = Truth(robot, nominal, true)
    logs = [truth.log(seed, name=f"log{seed}", top_hz=2.5 if case == "velocity gain" else 1.5) for seed in (1, 2)]
    quantities = dict.fromkeys(SERVO_CASES[case], "all")
    start = off_bounds(make_parameters(quantities, nominal))
    got, _ = fit(truth, logs, quantities, start={item.name: item.value for item in start})
    check(got, true)


@pytest.mark.parametrize("case", TORQUE_CASES)
def test_a_torque_driven_log_gives_back(case, tmp_path):
    robot, nominal = nominal_of(tmp_path, TORQUE)
    true = truth_of(nominal, TORQUE_CASES[case])
    truth = Truth(robot, nominal, true)
    logs = [truth.log(seed, name=f"log{seed}", size=6.0, noise=2e-4, seconds=6.0) for seed in (1, 2)]
    quantities = dict.fromkeys(TORQUE_CASES[case], "all")
    start = off_bounds(make_parameters(quantities, nominal))
    got, _ = fit(truth, logs, quantities, start={item.name: item.value for item in start}, window_s=0.3)
    check(got, true)


def ramps(time_s):
    """Torque ramps in turns of direction, with rests between."""
    turn, phase = np.divmod(time_s, 2.0)
    ramp = np.where(phase < 1.5, phase / 1.5, 0.0) * np.where(turn % 2 == 0, 1.2, -1.2)
    return np.stack([ramp, 0.8 * ramp], axis=1)


def test_ramps_show_the_static_threshold_of_a_torque_controlled_arm(tmp_path):
    robot, nominal = nominal_of(tmp_path, TORQUE, floating=True)
    case = {"static_positive": 0.8, "static_negative": 0.6}
    true = truth_of(nominal, case)
    logs = [Truth(robot, nominal, true).log(1, command=ramps)]
    got, _ = fit(Truth(robot, nominal, true), logs, dict.fromkeys(case, "all"), start=dict.fromkeys(true, 0.3))
    for name, value in true.items():
        # Between two commands nothing changes: the threshold is known to the step of the torque.
        assert got[name].value == pytest.approx(value, abs=0.02), name


@pytest.mark.parametrize("case", BODY_CASES)
def test_bodies_and_payload_are_found_by_torque(case, tmp_path):
    robot, nominal = nominal_of(tmp_path, TORQUE)
    true = BODY_CASES[case]
    truth = Truth(robot, nominal, true)
    logs = [truth.log(seed, name=f"log{seed}", size=6.0, noise=2e-4, seconds=6.0) for seed in (1, 2, 3)]
    quantities = {}
    for name in true:
        quantity, _, target = name.partition("[")
        quantities.setdefault(quantity, []).append(target.removesuffix("]"))
    got, _ = fit(
        truth, logs, {name: "all" if targets == [""] else targets for name, targets in quantities.items()}, window_s=0.3
    )
    if case != "inertia":
        check(got, true)
        return
    # A planar motion sees one number of a body's inertia, and must say that it cannot tell the two apart.
    assert any(got[name].identified != "yes" for name in true)
    total = sum(np.exp(2 * got[f"inertia_{axis}[lower]"].value) * moment for axis, moment in moments(nominal).items())
    expected = sum(np.exp(2 * true[f"inertia_{axis}[lower]"]) * moment for axis, moment in moments(nominal).items())
    assert total == pytest.approx(expected, rel=0.05)


def moments(nominal):
    second = nominal.inertial("lower").second_moment
    return {"d1": second[0, 0], "d3": second[2, 2]}


def test_a_law_acts_in_a_fit_although_nothing_has_switched_laws_on(tmp_path):
    robot, nominal = nominal_of(tmp_path, SERVO)
    log = Truth(robot, nominal, {}).log(1)
    mujoco.set_mjcb_control(None)
    mujoco.set_mjcb_passive(None)
    laws = ("stribeck", "load", "tanh_coulomb", "sigmoid_level", "dead_band")
    parameters = make_parameters({law: ["shoulder"] for law in laws}, nominal)
    segments, _ = make_segments([log], nominal.simulator, SegmentRule())
    problem = Problem(nominal, parameters, segments)
    without = problem.residuals(parameters.start[None])[0]
    for index, law in enumerate(laws):
        z = parameters.start.copy()
        z[index] = parameters.free[index].to_z(0.2)
        assert np.abs(problem.residuals(z[None])[0] - without).max() > 1e-6, law  # a law that sleeps moves nothing


@pytest.mark.slow
@pytest.mark.parametrize("memory", [0.0, 0.9], ids=["white noise", "noise with a memory"])
def test_intervals_cover_the_truth_at_about_their_level(memory, tmp_path):
    robot, nominal = nominal_of(tmp_path, SERVO)
    case = {"damping": 0.8, "frictionloss": 0.5, "armature": 0.08, "kp": 55.0, "delay_s": 0.013}
    true = truth_of(nominal, case)
    truth = Truth(robot, nominal, true)
    quantities = dict.fromkeys(case, "all")
    parameters = off_bounds(make_parameters(quantities, nominal))
    start = {item.name: item.value for item in parameters}
    hits, scores = [], []
    for seed in range(40):
        got, _ = fit(truth, [truth.log(seed, seconds=6.0, memory=memory)], quantities, start=start)
        hits.append([got[name].interval[0] <= value <= got[name].interval[1] for name, value in true.items()])
        for item in parameters:
            low, high, value, aim = map(item.to_z, (*got[item.name].interval, got[item.name].value, true[item.name]))
            scores.append((value - aim) / (high - low) * 2 * 1.96)
    covered = np.mean(hits, axis=0)
    message = f"by parameter {dict(zip(true, covered, strict=True))}"
    assert 0.85 <= covered.mean() <= 1.0, message
    # 40 draws at 95 %: fewer than 32 hits would happen to one parameter in 30,000.
    assert covered.min() >= 0.8, message
    # Intervals that are much too wide would cover as well.
    assert 0.5 < np.sqrt(np.mean(np.square(scores))) < 1.5
