"""Joint maps: what they do to every signal, and that they can be undone."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from align.align_cases import make_episode, make_series
from trueup.align import JointMap, JointRule
from trueup.core.timeseries import TimeSeries
from trueup.errors import ConfigError, MissingSignal, NameMismatch, UnitError

FACTORS = ("sign", "scale", "offset")
SO101_JAW = JointRule("gripper", "Jaw", scale=1.92, offset=-0.17, log_unit="1")

rules = st.builds(
    lambda sign, scale, offset: (sign, scale, offset),
    st.sampled_from([1, -1]),
    st.floats(0.01, 100.0),
    st.floats(-10.0, 10.0),
)


def random_series(seed, joints):
    rng = np.random.default_rng(seed)
    values = {
        name: rng.normal(size=(7, len(joints)))
        for name in ("position", "velocity", "acceleration", "torque", "current")
    }
    return make_series(np.arange(7.0), joints, **values)


def back(joint_map, robot):
    """The values of each signal in the log's joints, in its order, by the equations of `JointRule` solved for the log."""
    sign, scale, offset = (np.array([getattr(rule, name) for rule in joint_map.rules]) for name in FACTORS)
    shares = {"torque": sign * scale, "current": sign}
    return {
        name: (values - offset * (name == "position")) * shares.get(name, sign / scale)
        for name, values in robot.signals.items()
    }


@given(st.lists(rules, min_size=1, max_size=4), st.integers(0, 99), st.randoms(use_true_random=False))
def test_what_a_map_does_can_be_undone(choices, seed, shuffle):
    log_names = [f"log{i}" for i in range(len(choices))]
    joint_map = JointMap(
        tuple(
            JointRule(f"robot{i}", f"log{i}", sign=sign, scale=scale, offset=offset)
            for i, (sign, scale, offset) in enumerate(choices)
        )
    )
    shuffle.shuffle(log_names)
    series = random_series(seed, log_names)
    robot = joint_map.apply(series)
    assert robot.joints == joint_map.joints
    log = series.select(joint_map.log_joints)
    for name, values in back(joint_map, robot).items():
        assert robot.units[name] == log.units[name]
        np.testing.assert_allclose(values, log[name], rtol=1e-9, atol=1e-9)


@given(rules, st.integers(0, 99))
def test_power_is_the_same_on_both_sides(choice, seed):
    sign, scale, offset = choice
    series = random_series(seed, ("x",))
    robot = JointMap((JointRule("r", "x", sign=sign, scale=scale, offset=offset),)).apply(series)
    np.testing.assert_allclose(robot["torque"] * robot["velocity"], series["torque"] * series["velocity"], rtol=1e-9)


def test_each_signal_by_hand():
    units = {
        "position": ("deg",),
        "velocity": ("deg/s",),
        "acceleration": ("deg/s^2",),
        "torque": ("mNm",),
        "current": ("mA",),
    }
    log = make_series(
        [0.0],
        ("x",),
        units=units,
        position=[90.0],
        velocity=[180.0],
        acceleration=[-360.0],
        torque=[500.0],
        current=[250.0],
    )
    robot = JointMap((JointRule("r", "x", sign=-1, scale=2.0, offset=0.5),)).apply(log)
    assert robot.joints == ("r",)
    assert robot["position"][0, 0] == pytest.approx(-2.0 * np.pi / 2 + 0.5)
    assert robot["velocity"][0, 0] == pytest.approx(-2.0 * np.pi)
    assert robot["acceleration"][0, 0] == pytest.approx(2.0 * 2.0 * np.pi)
    assert robot["torque"][0, 0] == pytest.approx(-0.25)
    assert robot["current"][0, 0] == pytest.approx(-0.25)
    assert robot.units == {
        k: (v,)
        for k, v in {
            "position": "rad",
            "velocity": "rad/s",
            "acceleration": "rad/s^2",
            "torque": "Nm",
            "current": "A",
        }.items()
    }


def test_gripper_in_shares_of_its_range_whose_rates_are_already_the_joints():
    log = make_series(
        [0.0, 1.0], ("Jaw",), units={"position": ("1",)}, position=[0.0, 0.5], velocity=[1.0, -1.0], torque=[0.3, 0.4]
    )
    robot = JointMap((SO101_JAW,)).apply(log)
    np.testing.assert_allclose(robot["position"][:, 0], [-0.17, -0.17 + 0.96])
    np.testing.assert_allclose(robot["velocity"], log["velocity"])
    np.testing.assert_allclose(robot["torque"], log["torque"])
    assert robot.units["position"] == ("rad",)


def test_a_log_that_is_the_robots_passes_unchanged_gripper_included():
    log = make_series([0.0], ("Jaw",), units={"position": ("1",)}, position=[0.5], velocity=[1.0], torque=[0.3])
    same = JointMap.identity(("Jaw",)).apply(log)
    assert {name: same[name].tolist() for name in same.signals} == {name: log[name].tolist() for name in log.signals}
    assert same.units == log.units


def test_gripper_rate_in_shares_is_scaled():
    log = make_series([0.0], ("Jaw",), units={"position": ("1",), "velocity": ("1/s",)}, position=[0.0], velocity=[0.5])
    robot = JointMap((SO101_JAW,)).apply(log)
    assert robot["velocity"][0, 0] == pytest.approx(0.96)
    assert robot.units["velocity"] == ("rad/s",)


def test_log_unit_goes_before_what_the_log_claims():
    log = make_series([0.0], ("x",), position=[180.0])
    assert JointMap((JointRule("x", "x", log_unit="deg"),)).apply(log)["position"][0, 0] == pytest.approx(np.pi)


def test_spindle_turns_angle_into_length_and_torque_into_force():
    log = make_series([0.0], ("motor",), position=[2.0], velocity=[4.0], torque=[1.0])
    robot = JointMap((JointRule("slide", "motor", scale=0.01, unit="m"),)).apply(log)
    assert (robot["position"][0, 0], robot["velocity"][0, 0], robot["torque"][0, 0]) == pytest.approx(
        (0.02, 0.04, 100.0)
    )
    assert [robot.units[name][0] for name in ("position", "velocity", "torque")] == ["m", "m/s", "N"]


def test_order_is_the_robots_and_bodies_pass():
    log = make_series([0.0], ("b", "a"), position=[[1.0, 2.0]])
    log = TimeSeries(
        log.time_s,
        log.joints,
        {**log.signals, "body.position": np.full((1, 1, 3), 5.0, dtype=np.float32)},
        {**log.units, "body.position": ("mm",)},
        bodies=("hand",),
    )
    robot = JointMap.identity(("a", "b")).apply(log)
    assert robot["position"].tolist() == [[2.0, 1.0]]
    np.testing.assert_allclose(robot["body.position"], 0.005)
    assert robot["body.position"].dtype == np.float32
    assert robot.units["body.position"] == ("m",)


@pytest.mark.parametrize(("joints", "unknown", "missing"), [(("a", "b", "c"), "c", ""), (("a",), "", "b")])
def test_names_that_do_not_agree_are_printed_in_full(joints, unknown, missing):
    series = make_series([0.0], joints, position=[[0.0] * len(joints)])
    with pytest.raises(NameMismatch) as caught:
        JointMap.identity(("a", "b")).apply(series)
    message = str(caught.value)
    assert f"log has [{', '.join(joints)}]" in message
    assert "map expects [a, b]" in message
    assert (f"unknown: ['{unknown}']" in message) if unknown else (f"missing: ['{missing}']" in message)


def test_ignored_joints_may_be_there_or_not():
    joint_map = JointMap(JointMap.identity(("a",)).rules, ignore=("extra",))
    for joints in (("extra", "a"), ("a",)):
        series = make_series([0.0], joints, position=[[float(name == "a") for name in joints]])
        assert joint_map.apply(series)["position"].tolist() == [[1.0]]


def test_for_series_tells_log_and_robot_apart():
    joint_map = JointMap((SO101_JAW,))
    log = make_series([0.0], ("Jaw",), units={"position": ("1",)}, position=[0.5])
    robot = joint_map.apply(log)
    assert joint_map.for_series(log) is joint_map
    assert joint_map.for_series(robot).apply(robot)["position"].tolist() == robot["position"].tolist()
    with pytest.raises(NameMismatch):
        joint_map.for_series(make_series([0.0], ("jaw",), position=[0.5]))
    unconverted = make_series([0.0], ("gripper",), units={"position": ("1",)}, position=[0.5])
    with pytest.raises(UnitError, match="gripper"):
        joint_map.for_series(unconverted)


def test_for_series_takes_a_robot_log_in_degrees():
    joint_map = JointMap((JointRule("r", "x", sign=-1),))
    series = make_series([0.0], ("r",), units={"position": ("deg",)}, position=[180.0])
    assert joint_map.for_series(series).apply(series)["position"][0, 0] == pytest.approx(np.pi)


def test_an_unquoted_1_of_yaml_is_a_ratio():
    assert JointMap.from_dict({"joints": {"a": {"log_unit": 1}}}).rules[0].log_unit == "1"


def test_dictionary_round_trip_is_plain_json():
    joint_map = JointMap((SO101_JAW, JointRule("pan", "Rotation", sign=-1)), ignore=("extra",))
    data = json.loads(json.dumps(joint_map.to_dict()))
    assert JointMap.from_dict(data) == joint_map
    assert data["joints"]["pan"] == {"log": "Rotation", "sign": -1}
    assert JointMap.from_dict({"joints": {"a": {}}}) == JointMap.identity(("a",))


def test_commands_may_be_spoken_of_otherwise_than_measurements():
    """A joint that counts the other way round in commands only, in degrees, under the name of another."""
    data = {
        "joints": {
            "lift": {"log": "a", "command": {"log": "b", "sign": -1, "log_unit": "deg"}},
            "elbow": {"log": "b", "sign": -1, "offset": 0.5, "command": {"log": "a", "offset": 0.0}},
        }
    }
    joint_map = JointMap.from_dict(json.loads(json.dumps(data)))
    assert joint_map.to_dict() == data
    assert JointMap.from_dict(joint_map.to_dict()) == joint_map
    series = make_series(np.arange(2.0), ("a", "b"), position=[[0.1, 0.2], [0.3, 0.4]])
    episode = joint_map.of_episode(make_episode(series, series))
    assert episode.measured["position"] == pytest.approx(np.array([[0.1, 0.3], [0.3, 0.1]]))
    radian = np.pi / 180.0
    assert episode.command["position"] == pytest.approx(np.array([[-0.2 * radian, -0.1], [-0.4 * radian, -0.3]]))
    data["joints"]["lift"]["command"]["log"] = "a"
    with pytest.raises(NameMismatch, match="command joint occurs twice"):
        JointMap.from_dict(data)


def test_stamps_are_scaled_and_those_of_commands_shifted():
    data = {"joints": {"a": {"log": "a"}}, "clock": {"scale": 0.001, "command_shift_s": -0.3}}
    joint_map = JointMap.from_dict(data)
    assert joint_map.to_dict() == data
    series = make_series(np.array([0.0, 10.0, 20.0]), ("a",), position=[[0.1], [0.2], [0.3]])
    episode = joint_map.of_episode(make_episode(series, series))
    assert episode.measured.time_s == pytest.approx([0.0, 0.01, 0.02])
    assert episode.command.time_s == pytest.approx([-0.3, -0.29, -0.28])
    for clock, word in (({"scale": 0.0}, "scale > 0"), ({"scale": "1"}, "numbers"), ({"skew": 1.0}, "unknown keys")):
        with pytest.raises(ConfigError, match=word):
            JointMap.from_dict({**data, "clock": clock})


def test_what_was_measured_stands_for_a_command_that_was_not_recorded():
    rules = (JointRule("a", "x", sign=-1), JointRule("b", "y"))
    measured = make_series([0.0, 0.1], ("y", "x"), position=[[0, 1], [2, 3]], torque=[[4.0, 5.0], [6.0, 7.0]])
    plan = make_series([0.0, 0.3], ("y", "x"), torque=[[1.0, 1.0], [1.0, 1.0]])
    episode = make_episode(measured, plan)
    joint_map = JointMap(rules, measured_command="torque")
    data = json.loads(json.dumps(joint_map.to_dict()))
    assert JointMap.from_dict(data) == joint_map
    for log in (episode, replace(episode, command=None)):
        command = joint_map.of_episode(log).command
        assert (command.joints, tuple(command.signals)) == (("a", "b"), ("torque",))
        assert command["torque"].tolist() == [[-5.0, 4.0], [-7.0, 6.0]]
        assert command.time_s.tolist() == [0.0, 0.1]
    assert JointMap(rules).of_episode(episode).command["torque"].tolist() == [[-1.0, 1.0], [-1.0, 1.0]]
    without = replace(episode, measured=make_series([0.0], ("x", "y"), position=[[0, 1]]))
    with pytest.raises(MissingSignal, match="'one': no torque was measured, which stands for the command"):
        joint_map.of_episode(without)


@pytest.mark.parametrize(
    ("entry", "word"),
    [
        ({"logs": "x"}, "logs"),
        ({"sign": 2}, "sign"),
        ({"sign": True}, "sign"),
        ({"scale": 0.0}, "scale"),
        ({"scale": -1.0}, "scale"),
        ({"scale": "2"}, "scale"),
        ({"offset": float("nan")}, "offset"),
        ({"log_unit": 2}, "log_unit"),
        ({"log": 1}, "log"),
        ({"sign": 0.5}, "sign"),
        ({"unit": "deg"}, "unit"),
        ("x", "mapping"),
    ],
)
def test_bad_rules_are_refused(entry, word):
    with pytest.raises(ConfigError, match=word):
        JointMap.from_dict({"joints": {"a": entry}})


@pytest.mark.parametrize(
    "data",
    [
        {},
        {"joints": []},
        {"joints": {}, "ignore": "a"},
        {"joints": {}, "measured_command": 1},
        {"joints": {}, "other": 1},
        [],
    ],
)
def test_bad_maps_are_refused(data):
    with pytest.raises(ConfigError):
        JointMap.from_dict(data)


def test_units_that_do_not_fit_are_refused():
    with pytest.raises(UnitError):
        JointRule("a", "a", log_unit="Nm")
    for units in ({"velocity": ("Nm",)}, {"torque": ("A",)}, {"position": ("furlong",)}):
        signal = next(iter(units))
        with pytest.raises(UnitError):
            JointMap.identity(("a",)).apply(make_series([0.0], ("a",), units=units, **{signal: [1.0]}))


def test_a_joint_twice_is_refused():
    with pytest.raises(NameMismatch):
        JointMap((JointRule("a", "x"), JointRule("b", "x")))
    with pytest.raises(NameMismatch):
        JointMap((JointRule("a", "x"),), ignore=("x",))
