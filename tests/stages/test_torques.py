"""`trueup torque`: torques of motions that were not fitted, of drives of all kinds, and currents as torques."""

import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from stages import torque_truth as truth
from trueup.cli.main import main
from trueup.cli.torque import verdicts
from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.graybox_result import GrayboxResult, Score
from trueup.core.results import Estimate
from trueup.core.timeseries import TimeSeries, same_units
from trueup.core.torque_result import TorqueResult
from trueup.errors import ConfigError, MissingSignal, NotIdentifiable, OutputExists
from trueup.identify.regression import (
    GrayboxSettings,
    InverseDynamicsFit,
    InverseDynamicsSettings,
    fit_graybox,
    fit_inverse_dynamics,
    torque_models,
)
from trueup.identify.regression.torque_models import TorqueRobot, held_out_predictions
from trueup.robots import JointSpec
from trueup.robots.written import robot_yaml
from trueup.stages import import_logs, torque

UNITS = same_units({"position": "rad", "velocity": "rad/s", "torque": "Nm"}, truth.JOINTS)
FACTORS = {"lift": 2.5, "elbow": 0.4}
PER_AMPERE = np.array([FACTORS[name] for name in truth.JOINTS])


@pytest.fixture(scope="module")
def episodes():
    """Motions of the servo for positions, noiseless."""
    found = []
    for number in range(4):
        time_s, position, velocity, measured, command = truth.motion("position", number)
        signals = {"position": position, "velocity": velocity, "torque": measured}
        told = TimeSeries(time_s, truth.JOINTS, {"position": command}, same_units({"position": "rad"}, truth.JOINTS))
        found.append(Episode(EpisodeMeta(f"m{number}"), TimeSeries(time_s, truth.JOINTS, signals, UNITS), told))
    return found


def known(numbers=truth.MODEL, **more):
    model = mujoco.MjModel.from_xml_string(truth.ARM.format(**numbers))
    return TorqueRobot(model, truth.JOINTS, truth.JOINTS, **more)


def explained(folder, drive, *, factors=None, methods=("graybox", "dynamics"), **how):
    (folder / "robot").mkdir()
    logs = truth.write_logs(folder / "logs", drive, **how)
    return torque(logs, truth.robot(folder / "robot", drive, factors), folder / "out", methods=methods)


@pytest.mark.long
@pytest.mark.parametrize("drive", ["position", "velocity", "torque"])
def test_both_methods_are_nearer_than_the_rivals_for_each_kind_of_drive(drive, tmp_path):
    result = explained(tmp_path, drive, count=3).result
    assert (result.source, result.follows, result.held_out, result.motions) == ("torque", drive, "folds", 3)
    assert result.any_nearer
    assert result.total["graybox"].rmse.value < 0.05
    assert result.total["dynamics"].rmse.value < 0.15
    assert result.rival == min(("model", "simple", "mean"), key=lambda name: result.total[name].rmse.value)
    loaded = TorqueResult.load(tmp_path / "out" / "torque.json")
    assert replace(loaded, provenance={}) == replace(result, provenance={})
    coefficients = GrayboxResult.load(tmp_path / "out" / "graybox.json").joints
    for number, joint in enumerate(truth.JOINTS):
        found = {name: item.value for name, item in coefficients[joint].block("pd").coefficients.items()}
        if drive == "position":
            assert found["K_p"] == pytest.approx(truth.KP[number], rel=0.02)
        elif drive == "velocity":
            assert found["K_d"] == pytest.approx(4 * truth.KV[number], rel=0.05)
        else:
            assert found["K_u"] == pytest.approx(truth.GAIN[number], rel=0.02)
            assert found["tau_0"] == pytest.approx(truth.OFFSET[number], abs=0.05)
    bodies = InverseDynamicsFit.load(tmp_path / "out" / "dynamics.json").bodies
    # The fore arm's first moment about the elbow is a base parameter.
    moment = bodies["fore"].mass_kg * bodies["fore"].com_m[2]
    assert moment == pytest.approx(truth.TRUE["fore"] * -0.11, rel=0.1)


def test_a_velocity_servo_with_an_integral_has_its_gains():
    rng, clock = np.random.default_rng(5), np.arange(600) / 200
    angle = 2 * np.pi * np.array([[0.5, 0.9]]) * clock[:, None] + rng.uniform(0, 6, 2)
    velocity, position = 0.8 * np.cos(angle), 0.8 * np.sin(angle) / (2 * np.pi * np.array([[0.5, 0.9]]))
    wanted = velocity + rng.normal(0, 0.3, velocity.shape)
    steps = np.concatenate([np.zeros((1, 2)), np.cumsum(wanted[:-1] / 200, axis=0)])
    integral = position[0] + steps - position
    measured = TimeSeries(
        clock, truth.JOINTS, {"position": position, "velocity": velocity, "torque": 3 * (wanted - velocity) + 7 * integral},
        UNITS,
    )  # fmt: skip
    command = TimeSeries(clock, truth.JOINTS, {"velocity": wanted}, same_units({"velocity": "rad/s"}, truth.JOINTS))
    found = fit_graybox(
        [Episode(EpisodeMeta("m"), measured, command)], settings=GrayboxSettings(follows="velocity", cutoff_hz=90.0)
    )
    for joint in truth.JOINTS:
        values = {name: item.value for name, item in found.joints[joint].block("pd").coefficients.items()}
        assert values == pytest.approx({"tau_0": 0.0, "K_d": 3.0, "K_i": 7.0}, abs=0.05)


def test_a_drive_without_the_command_that_it_follows_is_refused(episodes):
    with pytest.raises(MissingSignal, match="no commanded velocity"):
        fit_graybox(episodes, settings=GrayboxSettings(follows="velocity"))


def test_noiseless_torques_give_the_base_parameters_of_the_true_mechanism():
    """Against MuJoCo's inverse dynamics of the true model, on states that were not fitted."""
    rng = np.random.default_rng(0)
    states = rng.normal(0, [[[1.0]], [[1.5]], [[4.0]]], (3, 400, 2))
    true = known(truth.TRUE).model

    def inverse(rows):
        data, out = mujoco.MjData(true), []
        for q, dq, ddq in zip(*rows, strict=True):
            data.qpos[:], data.qvel[:], data.qacc[:] = q, dq, ddq
            mujoco.mj_inverse(true, data)
            # MuJoCo's own dry friction is a constraint, which depends on more than the velocity.
            out.append(data.qfrc_inverse + data.qfrc_constraint + truth.TRUE["dry"] * np.tanh(dq / 0.05))
        return np.array(out)

    found = fit_inverse_dynamics(known().model, *states, inverse(states), settings=InverseDynamicsSettings())
    values = {item.name: item.value for item in found.base}
    mass = truth.TRUE["fore"]
    assert found.rank == found.structural_rank
    assert values["fore.mx"] == pytest.approx(mass * 0.02, rel=1e-6)
    assert values["fore.mz"] == pytest.approx(mass * -0.11, rel=1e-6)
    assert values["upper.mx"] == pytest.approx(truth.TRUE["upper"] * 0.02, rel=1e-5)
    assert values["elbow.frictionloss"] == pytest.approx(truth.TRUE["dry"], rel=1e-6)
    assert values["lift.damping"] == pytest.approx(truth.TRUE["damping"], rel=1e-6)


@pytest.mark.parametrize("name", ["graybox", "dynamics", "model", "simple", "mean"])
def test_a_prediction_never_depends_on_the_torque_that_it_predicts(name, episodes):
    learner = {
        "graybox": torque_models.learn_graybox(known(), GrayboxSettings()),
        "dynamics": torque_models.learn_dynamics(known(), InverseDynamicsSettings()),
        "model": torque_models.learn_model(known()),
        "simple": torque_models.learn_simple(known()),
        "mean": torque_models.learn_mean(known()),
    }[name]
    last = episodes[-1]
    strange = {**last.measured.signals, "torque": 40 + 3 * last.measured["torque"] ** 2}
    other = [*episodes[:-1], replace(last, measured=replace(last.measured, signals=strange))]
    ids = {item.meta.id for item in episodes}
    folds = [(ids - {"m3"}, {"m3"}), (ids - {"m0"}, {"m0"})]
    before, after = (held_out_predictions(items, folds, learner) for items in (episodes, other))
    assert np.array_equal(before["m3"], after["m3"], equal_nan=True)
    if name != "model":  # which learns of torques how much to filter, at most
        assert not np.allclose(before["m0"], after["m0"], equal_nan=True)


@pytest.mark.long
def test_with_splits_the_test_motions_touch_no_coefficient(tmp_path):
    split = tmp_path / "split.json"
    split.write_text(json.dumps({"train": ["m0", "m1"], "test": ["m2"]}))
    (tmp_path / "robot").mkdir()
    description = truth.robot(tmp_path / "robot", "position")
    saved = []
    for number, factor in enumerate((1.0, -5.0)):
        logs = truth.write_logs(
            tmp_path / f"logs{number}",
            "position",
            count=3,
            change=lambda at, tau, f=factor: tau * (f if at == 2 else 1),
        )
        import_logs(logs, tmp_path / f"data{number}", robot=description, splits=split)
        saved.append(torque(tmp_path / f"data{number}", description, tmp_path / f"out{number}"))
    one, other = saved
    assert one.result.held_out == "test"
    assert one.result.motions == 1
    assert other.result.total["dynamics"].rmse.value > 5 * one.result.total["dynamics"].rmse.value
    assert one.dynamics == other.dynamics
    for joint in truth.JOINTS:
        pairs = zip(one.graybox.joints[joint].blocks, other.graybox.joints[joint].blocks, strict=True)
        assert all(a.coefficients == b.coefficients for a, b in pairs)


@pytest.mark.long
def test_currents_with_a_known_factor_are_torques(tmp_path):
    for name in ("torque", "current"):
        (tmp_path / name).mkdir()
    plain = explained(tmp_path / "torque", "position", count=3).result
    amperes = explained(
        tmp_path / "current",
        "position",
        count=3,
        factors=FACTORS,
        signal="current",
        change=lambda _, tau: tau / PER_AMPERE,
    ).result
    assert amperes.source == "current"
    assert [own.factor_from for own in amperes.joints.values()] == ["robot", "robot"]
    for joint, own in plain.joints.items():
        assert amperes.joints[joint].unit == own.unit == "Nm"
        for name, score in own.errors.items():
            assert amperes.joints[joint].errors[name].rmse.value == pytest.approx(score.rmse.value, rel=1e-6)


@pytest.mark.long
def test_currents_without_a_factor_keep_the_ratios_and_are_scaled_to_the_models_masses(tmp_path):
    masses = {**truth.TRUE, "upper": truth.MODEL["upper"], "fore": truth.MODEL["fore"]}
    for name in ("torque", "current"):
        (tmp_path / name).mkdir()
    plain = explained(tmp_path / "torque", "position", count=3, numbers=masses)
    amperes = explained(
        tmp_path / "current",
        "position",
        count=3,
        numbers=masses,
        signal="current",
        change=lambda _, tau: tau / PER_AMPERE,
    )
    for joint in truth.JOINTS:
        own = amperes.result.joints[joint]
        assert (own.unit, own.factor_from) == ("A", "model")
        assert own.factor == pytest.approx(FACTORS[joint], rel=0.1)
        of_torque, of_current = (item.graybox.joints[joint].block("friction").coefficients for item in (plain, amperes))
        assert of_current["K_p"].unit == "A/rad"
        for name in ("K_p", "K_d", "K_c", "tau_0"):
            assert of_current[name].value * FACTORS[joint] == pytest.approx(of_torque[name].value, rel=1e-6)
        share = own.errors["graybox"].rmse.value / own.rms
        assert share == pytest.approx(
            plain.result.joints[joint].errors["graybox"].rmse.value / plain.result.joints[joint].rms, rel=0.2
        )
    assert any("only ratios within a joint are known" in line for line in amperes.result.notes)
    assert any("weigh what the model says" in line for line in amperes.dynamics.notes)
    for joint in truth.JOINTS:
        low, high = amperes.result.joints[joint].factor_interval
        assert low < FACTORS[joint] < high
        found, expected = (item.dynamics.joints[joint].frictionloss for item in (amperes, plain))
        assert found == pytest.approx(expected, rel=0.1)
    shares = [item.result.total["dynamics"].rmse.value for item in (amperes, plain)]
    assert shares[0] == pytest.approx(shares[1], rel=0.1)


def test_a_torque_without_a_sign_is_said_to_be_one(tmp_path):
    def unsigned(_, tau):
        return np.abs(tau) * [1, 0] + tau * [0, 1]

    result = explained(tmp_path, "position", count=2, change=unsigned, methods=("graybox",)).result
    assert list(result.joints) == ["elbow"]
    assert "absolute value" in result.left_out["lift"]


def test_all_torques_without_a_sign_leave_nothing_to_explain(tmp_path):
    with pytest.raises(NotIdentifiable, match="absolute value") as raised:
        explained(tmp_path, "position", count=2, change=lambda _, tau: np.abs(tau))
    assert raised.value.exit_code == 3


def test_commanded_torques_stand_for_torques_that_nobody_measured(tmp_path):
    result = explained(tmp_path, "torque", count=3, signal="temperature").result
    assert (result.source, result.methods) == ("command", ("dynamics",))
    assert "no torque was measured" in result.left_out["graybox"]
    assert any("commanded one is explained" in line for line in result.notes)


def test_no_torque_and_no_current_is_said(tmp_path):
    with pytest.raises(MissingSignal, match="no motion has a measured torque or current"):
        explained(tmp_path, "position", count=2, signal="temperature")


def test_one_motion_leaves_nothing_to_hold_out(tmp_path):
    with pytest.raises(NotIdentifiable, match="no motion can be held out"):
        explained(tmp_path, "position", count=1)


def test_a_factor_that_is_none_is_refused():
    with pytest.raises(ConfigError, match="torque_constant_nm_a"):
        JointSpec("lift", torque_constant_nm_a=0.0)


@pytest.fixture
def command(tmp_path, capsys):
    """Run the command on logs with changed torques; returns exit code and what was printed."""

    def call(change, *words):
        (tmp_path / "robot").mkdir(exist_ok=True)
        description = truth.robot(tmp_path / "robot", "position")
        (tmp_path / "robot" / "robot.yaml").write_text(robot_yaml(description))
        if not (tmp_path / "logs").exists():
            truth.write_logs(tmp_path / "logs", "position", count=3, change=change)
        robot = tmp_path / "robot" / "robot.yaml"
        with pytest.raises(SystemExit) as left:
            main(["torque", str(tmp_path / "logs"), "--robot", str(robot), "--out", str(tmp_path / "out"), *words])
        printed = capsys.readouterr()
        return left.value.code, " ".join((printed.out + printed.err).split())

    return call


@pytest.mark.long
def test_the_command_prints_a_row_per_joint_and_speaks_of_the_best_rival(command, tmp_path):
    code, printed = command(None)
    assert code == 0, printed
    result = TorqueResult.load(tmp_path / "out" / "torque.json")
    assert all(f"│ {joint}" in printed for joint in truth.JOINTS)
    rival = 100 * (result.total["dynamics"].rmse.value + result.total["dynamics"].reduction.value)
    assert rival == pytest.approx(100 * result.total[result.rival].rmse.value)
    assert f"{rival:.3g} %" in printed
    assert "(3 motions cannot tell)" in printed
    code, printed = command(None)
    assert code == 2
    assert "--overwrite" in printed
    code, printed = command(None, "--method", "graybox", "--overwrite")
    assert code == 0
    assert not (tmp_path / "out" / "dynamics.json").exists()


@pytest.mark.long
def test_torques_that_nothing_explains_are_admitted(command, tmp_path):
    code, printed = command(lambda number, tau: np.random.default_rng(number).normal(0, 2, tau.shape))
    assert code == 3, printed
    assert "nothing is nearer to the torques than" in printed
    assert "(better)" not in printed


def test_results_are_not_replaced_unasked(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "torque.json").write_text("{}")
    with pytest.raises(OutputExists):
        explained(tmp_path, "position", count=2)


def test_what_is_said_of_a_method_depends_on_the_interval():
    def scored(low, value, high):
        rmse, less = Estimate(0.2, "1"), Estimate(value, "1", low=low, high=high)
        return Score(rmse, less, motions=8, samples=800)

    def result(*interval):
        score = scored(*interval)
        total = {"graybox": score, "simple": replace(score, rmse=Estimate(0.2 + interval[1], "1"))}
        return TorqueResult("torque", "position", "folds", ("graybox",), "simple", {}, total, motions=8)

    for interval, better, word in (
        ((0.1, 0.2, 0.3), True, "50 % less (better)"),
        ((-0.1, 0.2, 0.3), None, "50 % less (8 motions cannot tell)"),
        ((-0.15, -0.1, -0.05), False, "100 % more (worse)"),
    ):
        found = result(*interval)
        assert found.better("graybox") is better
        assert found.any_nearer is (interval[1] > 0)
        assert word in verdicts(found)[0]
        assert "least squares on velocity" in verdicts(found)[0]
