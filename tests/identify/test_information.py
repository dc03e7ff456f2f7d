"""The information of a planned motion: against derivatives by hand, and against what fits then find."""

from dataclasses import replace

import numpy as np
import pytest

from identify.design_cases import CLOCK, commanded, episode, random_plan, ranged, samples
from identify.recovery_cases import TORQUE, Truth, fit
from trueup.core.fit_result import FitResult
from trueup.errors import ConfigError, DataError, NameMismatch, NotIdentifiable
from trueup.identify import IdentifyConfig, Knowledge, Nominal, PlannedInformation, deviations, identify, uncertainty
from trueup.identify.config import make_parameters
from trueup.identify.information import PLANNED
from trueup.record import DesignSettings, Information, MotionSettings, design_excitation
from trueup.sim import MujocoSimulator, ReplaySettings, replay_episode

NOISE = 1e-3
FIT = {"kp": "all", "damping": "all", "frictionloss": "all", "armature": "all", "torque_offset": "all"}
SHORT = DesignSettings(duration_s=4.0, harmonics=5, evaluations=90)


@pytest.fixture
def case(tmp_path):
    return ranged(tmp_path)


def by_hand(nominal, change, episode_):
    """Positions of the arm with numbers changed in the MjSpec itself."""
    spec = nominal.spec.copy()
    change(spec)
    simulator = MujocoSimulator(spec.compile(), nominal.robot, nominal.simulator.channels)
    return replay_episode(episode_, simulator, ReplaySettings())


def scaled_gain(factor):
    def change(spec):
        actuator = next(own for own in spec.actuators if own.target == "elbow" and own.biasprm[1])
        actuator.gainprm[0] *= factor
        actuator.biasprm[1] *= factor

    return change


def scaled_damping(factor):
    def change(spec):
        spec.joint("shoulder").damping[0] *= factor

    return change


def shifted_torque(offset):
    def change(spec):
        actuator = next(own for own in spec.actuators if own.target == "elbow" and own.biasprm[1])
        actuator.biasprm[0] = offset

    return change


def test_the_matrix_is_that_of_derivatives_by_hand(case):
    _, nominal, scene = case
    plan = random_plan(scene, 1, 4.0)
    wanted = {"kp": ["elbow"], "damping": ["shoulder"], "torque_offset": ["elbow"]}
    parameters = make_parameters(wanted, nominal)
    std = {"position": {"shoulder": 2e-3, "elbow": 5e-4}, "velocity": 0.03}
    information = PlannedInformation(nominal, parameters, noise=std)
    assert isinstance(information, Information)
    found = information(*samples(plan))

    time_s, position = commanded(plan)
    settled = by_hand(nominal, scaled_gain(1.0), episode("settled", time_s, position))
    begun = settled.rows(slice(100, None))
    log = episode("log", time_s, position, begun)
    scale = parameters["torque_offset[elbow]"].scale
    h = 1e-3
    pairs = [
        (scaled_gain(np.exp(h)), scaled_gain(np.exp(-h))),
        (scaled_damping(np.exp(h)), scaled_damping(np.exp(-h))),
        (shifted_torque(h * scale), shifted_torque(-h * scale)),
    ]
    rows = []
    for up, down in pairs:
        more, less = by_hand(nominal, up, log), by_hand(nominal, down, log)
        slopes = {name: (more[name] - less[name]) / (2 * h) for name in ("position", "velocity")}
        weighted = [slopes["position"] / np.array([2e-3, 5e-4]), slopes["velocity"] / 0.03]
        rows.append(np.concatenate([part.ravel() for part in weighted]))
    jacobian = np.array(rows)
    expected = jacobian @ jacobian.T
    unit = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(found / np.outer(unit, unit), expected / np.outer(unit, unit), atol=0.03)


def test_information_adds_up_and_scales_with_the_noise(case):
    _, nominal, scene = case
    motion = samples(random_plan(scene, 2, 4.0))
    parameters = make_parameters(FIT, nominal)
    one = PlannedInformation(nominal, parameters, noise={"position": NOISE})(*motion)
    half = PlannedInformation(nominal, parameters, noise={"position": NOISE / 2})(*motion)
    np.testing.assert_allclose(half, 4 * one, rtol=1e-9)
    with_speed = PlannedInformation(nominal, parameters, noise={"position": NOISE, "velocity": 0.05})(*motion)
    assert np.linalg.eigvalsh(with_speed - one).min() > -1e-6 * np.trace(one)
    two = PlannedInformation(nominal, parameters, noise={"position": NOISE}, jobs=2)(*motion)
    np.testing.assert_array_equal(two, one)


def test_a_torque_driven_arm_follows_the_plan_and_its_encoders_zeros_cost_information(tmp_path):
    _, nominal, scene = ranged(tmp_path, TORQUE)
    motion = samples(random_plan(scene, 3, 4.0))
    model_only = {"armature": "all", "mass": "all", "damping": "all"}
    both = make_parameters({**model_only, "encoder_zero": "all"}, nominal, (PLANNED,))
    noise = {"position": NOISE}
    information = PlannedInformation(nominal, both, noise=noise, window_s=0.5)
    assert all("encoder_zero" not in item.name for item in information.parameters)
    expected = information._expected(*motion)
    done = replay_episode(expected, nominal.simulator, ReplaySettings(0.5))
    np.testing.assert_allclose(done["position"], motion[0], atol=0.02)
    assert np.ptp(motion[0]) > 0.5
    unknown = information(*motion)
    known = PlannedInformation(nominal, make_parameters(model_only, nominal), noise=noise, window_s=0.5)(*motion)
    lost = np.linalg.eigvalsh(known - unknown)
    assert lost.min() > -1e-6 * lost.max()
    assert lost.max() > 0.01 * np.trace(known)


def designed_plans(nominal, scene, design):
    known = Knowledge.of_config(IdentifyConfig(fit=FIT), nominal, noise=NOISE)
    information = PlannedInformation(nominal, known.parameters, noise=known.noise)
    total, plans = known.precision, []
    for number in range(2):
        before = total

        def summed(position, velocity, acceleration, before=before):
            return before + information(position, velocity, acceleration)

        found = design_excitation(scene, summed, seed=number, design=design, settings=MotionSettings(clock=CLOCK))
        plans.append(found.plan)
        total = total + information(*samples(found.plan))
    return information, known, plans, total


@pytest.mark.long
def test_designed_motions_promise_more_than_random_ones(case):
    _, nominal, scene = case
    information, known, plans, designed = designed_plans(nominal, scene, replace(SHORT, evaluations=30))
    means = []
    for seed in range(3):
        random = known.precision
        for number in range(2):
            plan = random_plan(scene, [seed, number], SHORT.duration_s)
            assert plan.duration_s == pytest.approx(plans[0].duration_s)
            random = random + information(*samples(plan))
        means.append(np.log(deviations(random) / deviations(designed)).mean())
    assert min(means) > 0.0
    assert np.mean(means) > 0.2
    assert np.all(deviations(designed) < known.std)


def recorded(truth, plan, name, rng):
    """What the true arm makes of a plan, with noise on every position but the one that it rests in at first."""
    time_s, position = commanded(plan)
    simulator, _ = truth.simulator()
    seen = replay_episode(episode(name, time_s, position), simulator, ReplaySettings()).rows(slice(100, None))
    noise = NOISE * rng.standard_normal(seen["position"].shape)
    noise[0] = 0.0
    seen = replace(seen, signals={**seen.signals, "position": seen["position"] + noise})
    return episode(name, time_s, position, seen)


@pytest.mark.slow
def test_fits_of_designed_motions_are_nearer_to_the_truth_and_as_sure_as_was_predicted(case, monkeypatch):
    robot, nominal, scene = case
    # How far pieces of motions pull a fit apart only makes it less sure: by chance where noise is white, by a tenth.
    monkeypatch.setattr(uncertainty, "_disagreement", lambda *_: 0.0)
    parameters = make_parameters(FIT, nominal)
    values = {"kp[shoulder]": 44.0, "damping[elbow]": 0.3, "frictionloss[shoulder]": 0.36, "armature[elbow]": 0.04}
    truth = Truth(robot, nominal, {**{item.name: item.value for item in parameters}, **values})
    _, known, designed, _ = designed_plans(nominal, scene, SHORT)
    at_truth = PlannedInformation(nominal, parameters.at(truth.values), noise={"position": NOISE})
    error, width = {}, {}
    for kind, plans in {
        "designed": designed,
        "random": [random_plan(scene, [9, number], SHORT.duration_s) for number in range(2)],
    }.items():
        predicted = deviations(known.precision + sum(at_truth(*samples(plan)) for plan in plans))
        errors, widths = [], []
        for seed in range(5):
            rng = np.random.default_rng([seed, 3])
            found, _ = fit(truth, [recorded(truth, plan, f"log{row}", rng) for row, plan in enumerate(plans)], FIT)
            ends = [[item.to_z(end) for end in found[item.name].interval] for item in parameters]
            errors.append(
                [item.to_z(found[item.name].value) - item.to_z(truth.values[item.name]) for item in parameters]
            )
            widths.append([(high - low) / (2 * 1.96) for low, high in ends])
        error[kind], width[kind] = np.sqrt(np.mean(np.square(errors), axis=0)), np.mean(widths, axis=0)
        np.testing.assert_allclose(width[kind], predicted, rtol=0.15)
        # Fifty errors that are each as large as predicted: their mean square is 1, give or take 0.2.
        assert 0.4 < np.mean(np.square(error[kind] / predicted)) < 2.0
    assert np.log(width["random"] / width["designed"]).mean() > 0.2
    assert np.log(error["random"] / error["designed"]).mean() > 0.1


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fitted")
    robot, nominal, _ = ranged(folder)
    logs = [
        Truth(robot, nominal, {"damping[shoulder]": 0.5}).log(seed, seconds=4.0, name=f"log{seed}") for seed in (1, 2)
    ]
    config = IdentifyConfig(
        fit={"damping": "all", "kp": "all", "frictionloss": "all"}, signals={"position": 1.0, "velocity": 0.1}
    )
    found = identify({"train": logs}, robot, nominal.path, config=config)
    path = folder / "fit.json"
    found.result.save(path)
    return robot, nominal, FitResult.load(path), found


@pytest.mark.long
def test_a_fit_says_what_is_known(fitted):
    _, nominal, result, found = fitted
    known = Knowledge.of_fit(result, nominal)
    assert {item.name: item.value for item in known.parameters.free} == {item.name: item.value for item in result.free}
    np.testing.assert_allclose(known.std, found.posterior.std, rtol=0.05)
    joint = result.whiteness["shoulder"]
    std = joint.rms * np.sqrt(1 + joint.correlation_s * 100.0)
    assert known.noise["position"]["shoulder"] == pytest.approx(std)
    assert known.noise["velocity"]["shoulder"] == pytest.approx(10 * std)
    louder = Knowledge.of_fit(result, nominal, noise=0.01)
    assert louder.noise["position"] == {"shoulder": 0.01, "elbow": 0.01}


def test_fits_of_other_robots_and_models_are_refused(fitted, tmp_path):
    robot, nominal, result, _ = fitted
    with pytest.raises(NameMismatch, match="another robot"):
        Knowledge.of_fit(result, Nominal(replace(robot, name="leg"), nominal.path))
    other = nominal.path.with_name("model.fitted.xml")
    other.write_text(nominal.path.read_text())
    with pytest.raises(ConfigError, match="another model"):
        Knowledge.of_fit(result, Nominal(robot, other))
    with pytest.raises(DataError, match="what it was made with"):
        Knowledge.of_fit(replace(result, provenance={}), nominal)


def test_bad_questions_are_refused(case):
    _, nominal, _ = case
    parameters = make_parameters({"kp": "all"}, nominal)
    for wrong in ({}, {"position": 0.0}, {"current": 1.0}, {"position": {"wrist": 1e-3}}, {"position": {}}):
        with pytest.raises(ConfigError):
            PlannedInformation(nominal, parameters, noise=wrong)
    with pytest.raises(ConfigError, match="rate_hz"):
        PlannedInformation(nominal, parameters, noise={"position": NOISE}, rate_hz=0.0)
    with pytest.raises(NotIdentifiable, match="no parameter"):
        PlannedInformation(nominal, parameters.hold(parameters.names), noise={"position": NOISE})
    with pytest.raises(ConfigError, match="no quantity"):
        IdentifyConfig(fit={"stiffness": "all"})
    with pytest.raises(ConfigError, match="not a joint"):
        Knowledge.of_config(IdentifyConfig(fit={"kp": ["wrist"]}), nominal)
