"""A set-up that is wrong is named, with the lines that mend it; one that is right, or only imprecise, is let alone."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from check.arm_logs import arm, changed, logs, look, mirrored, scaled, swapped
from trueup.align import JointRule
from trueup.check import mended
from trueup.check.reading import units_of
from trueup.core.check_result import CheckResult, Finding, Mend
from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.timeseries import TimeSeries
from trueup.draft import draft_robot

SIDES = {"both": (True, True), "measured": (True, False), "command": (False, True)}
NAMES = ("yaw", "lift", "elbow")
SIGNALS = ("position", "velocity", "torque")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Signal and seed -> robot, model, logs; made once."""
    folder, known = tmp_path_factory.mktemp("arm"), {}

    def make(signal, seed=0):
        if (signal, seed) not in known:
            robot, path = arm(folder, signal)
            known[signal, seed] = robot, path, logs(robot, path, np.random.default_rng([seed, 3]))
        return known[signal, seed]

    return make


def certain(findings):
    return [(finding.kind, finding.joints) for finding in findings if finding.severity == "certain"]


def assert_named(robot, path, episodes, kind, joints):
    """It is certain, alone, and its first lines mend it."""
    findings = look(robot, path, episodes)
    assert [(what, set(names)) for what, names in certain(findings)] == [(kind, set(joints))], findings
    first = next(finding for finding in findings if finding.severity == "certain")
    assert first.evidence.endswith(".")
    assert first.mends[0].where == "robot.yaml"
    robot = mended(robot, first.mends[0].lines)
    assert certain(look(robot, path, episodes)) == []
    return robot


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("signal", SIGNALS)
def test_a_set_up_that_is_right_raises_nothing(made, signal, seed):
    assert look(*made(signal, seed)) == ()


@pytest.mark.long
@pytest.mark.parametrize(
    ("signal", "joint", "side"),
    [
        *(("position", 1, side) for side in SIDES),
        *(("velocity", 1, side) for side in SIDES),
        *(("torque", 2, side) for side in SIDES),
        *((signal, 0, "command") for signal in SIGNALS),
    ],
)
def test_a_mirrored_joint_is_named(made, signal, joint, side):
    robot, path, episodes = made(signal)
    measured, command = SIDES[side]
    wrong = changed(episodes, mirrored(joint), measured=measured, command=command)
    right = assert_named(robot, path, wrong, "sign", [NAMES[joint]])
    if joint:  # of a vertical axis nobody can tell which of the two it was
        rule = right.joints[joint]
        sign = rule.sign if rule.command is None or rule.command.sign is None else rule.command.sign
        assert (rule.sign, sign) == (-1 if measured else 1, -1 if command else 1)


@pytest.mark.long
@pytest.mark.parametrize("signal", ["position", "velocity"])
def test_two_joints_of_which_one_mirrored_alone_explains_nothing_are_named_together(made, signal):
    robot, path, episodes = made(signal)
    wrong = changed(changed(episodes, mirrored(1)), mirrored(2))
    findings = look(robot, path, wrong)
    assert certain(findings) == [("sign", ("lift", "elbow"))], findings
    mended_robot = mended(robot, findings[0].mends[0].lines)
    assert [rule.sign for rule in mended_robot.joints] == [1, -1, -1]
    assert certain(look(mended_robot, path, wrong)) == []


@pytest.mark.long
@pytest.mark.parametrize("side", ["measured", "command"])
def test_a_whole_robot_that_counts_the_other_way_round_is_named_by_one_finding(made, side):
    robot, path, episodes = made("position")
    measured, command = SIDES[side]
    wrong = changed(episodes, lambda _, values: -values, measured=measured, command=command)
    assert_named(robot, path, wrong, "sign", NAMES)


@pytest.mark.long
@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("signal", SIGNALS)
def test_swapped_joints_are_named(made, signal, side):
    robot, path, episodes = made(signal)
    measured, command = SIDES[side]
    wrong = changed(episodes, swapped(1, 2), measured=measured, command=command)
    right = assert_named(robot, path, wrong, "swap", ["lift", "elbow"])
    assert {joint.log for joint in right.joints if joint.log} == ({"lift", "elbow"} if measured else set())


@pytest.mark.long
@pytest.mark.parametrize(
    ("signal", "side", "factor", "zero", "rule"),
    [
        ("position", "both", 180 / math.pi, 0.0, ("deg", 1.0)),
        ("position", "measured", 180 / math.pi, 0.0, ("deg", 1.0)),
        ("position", "command", 1000.0, 0.0, (None, 1.0)),
        ("position", "both", 4096 / (2 * math.pi), 2048.0, ("1", 2 * math.pi / 4096)),
        ("velocity", "measured", 180 / math.pi, 0.0, ("deg", 1.0)),
        ("torque", "measured", 0.5 / math.pi, 0.0, ("rev", 1.0)),
    ],
)
def test_units_are_named(made, signal, side, factor, zero, rule):
    robot, path, episodes = made(signal)
    measured, command = SIDES[side]
    wrong = changed(episodes, scaled(1, factor, zero), measured=measured, command=command)
    right = assert_named(robot, path, wrong, "unit", ["lift"])
    assert (right.joints[1].log_unit, right.joints[1].scale) == (rule[0], pytest.approx(rule[1], rel=1e-5))
    if side == "command":
        assert right.joints[1].command.log_unit == "mrad"


@pytest.mark.long
@pytest.mark.parametrize("signal", SIGNALS)
def test_a_whole_log_in_degrees_is_named_by_one_finding(made, signal):
    robot, path, episodes = made(signal)
    wrong = changed(episodes, lambda name, values: np.degrees(values) if name == "position" else values)
    right = assert_named(robot, path, wrong, "unit", NAMES)
    assert [joint.log_unit for joint in right.joints] == ["deg"] * 3


@pytest.mark.long
@pytest.mark.parametrize("side", ["measured", "command"])
def test_one_series_in_degrees_is_named_by_one_finding(made, side):
    robot, path, episodes = made("position")
    measured, command = SIDES[side]
    wrong = changed(episodes, lambda _, values: np.degrees(values), measured=measured, command=command)
    right = assert_named(robot, path, wrong, "unit", NAMES)
    units = [(joint.log_unit, joint.command and joint.command.log_unit) for joint in right.joints]
    assert units == ([("deg", "rad")] if side == "measured" else [(None, "deg")]) * 3


@pytest.mark.long
def test_an_offset_is_told_without_what_the_servo_sags(made):
    robot, path, episodes = made("position")
    wrong = changed(episodes, scaled(1, 1.0, 0.7), command=False)
    right = assert_named(robot, path, wrong, "offset", ["lift"])
    assert right.joints[1].offset == pytest.approx(-0.7, abs=0.01)


@pytest.mark.long
@pytest.mark.parametrize(("signal", "side"), [("position", "both"), ("position", "measured"), ("torque", "measured")])
def test_a_zero_that_is_a_quarter_turn_off_is_named(made, signal, side):
    robot, path, episodes = made(signal)
    measured, command = SIDES[side]
    wrong = changed(episodes, scaled(1, 1.0, 0.5 * math.pi), measured=measured, command=command)
    right = assert_named(robot, path, wrong, "offset", ["lift"])
    assert right.joints[1].offset == pytest.approx(-0.5 * math.pi, abs=1e-5)


def assert_likely(robot, path, episodes, kind, joint):
    """It is the first finding, certain or likely; the robot as its lines mend it."""
    first = next(finding for finding in look(robot, path, episodes) if finding.severity in ("certain", "likely"))
    assert (first.kind, first.joints) == (kind, (joint,))
    right = mended(robot, first.mends[0].lines)
    assert certain(look(right, path, episodes)) == []
    return right


@pytest.mark.long
@pytest.mark.parametrize("factor", [2.0, 100.0])
def test_both_series_on_the_motors_side_of_a_gear_are_named(made, factor):
    robot, path, episodes = made("position")
    wrong = changed(episodes, scaled(1, factor, rates=True))
    right = assert_likely(robot, path, wrong, "scale", "lift")
    assert right.joints[1].scale == pytest.approx(1.0 / factor, rel=0.3)
    assert right.joints[1].command is None


@pytest.mark.long
@pytest.mark.parametrize("zero", [0.7, -0.5])
def test_a_zero_that_is_off_by_any_angle_in_both_series_is_named(made, zero):
    robot, path, episodes = made("position")
    right = assert_likely(robot, path, changed(episodes, scaled(1, 1.0, zero)), "offset", "lift")
    assert right.joints[1].offset == pytest.approx(-zero, abs=0.15)


@pytest.mark.long
@pytest.mark.parametrize("signal", SIGNALS)
def test_a_gear_is_named(made, signal):
    robot, path, episodes = made(signal)
    wrong = changed(episodes, scaled(2, 10.0, rates=True), measured=False)
    right = assert_named(robot, path, wrong, "scale", ["elbow"])
    # Torques of the motor's side go the other way than its positions.
    exponent = 1.0 if signal == "torque" else -1.0
    assert right.joints[2].command.scale == pytest.approx(10.0**exponent, rel=0.05)


@pytest.mark.long
@pytest.mark.parametrize(
    ("factor", "scale"), [(4.0, pytest.approx(0.25, rel=1e-12)), (2.2, pytest.approx(1 / 2.2, rel=0.02))]
)
def test_a_scaled_action_has_the_round_factor_that_it_is_nearly(made, factor, scale):
    robot, path, episodes = made("position")
    wrong = changed(episodes, scaled(2, factor, -0.3 * factor), measured=False)
    assert assert_named(robot, path, wrong, "scale", ["elbow"]).joints[2].command.scale == scale


@pytest.mark.long
def test_commands_of_motors_behind_gears_that_are_alike_are_named_by_one_finding(made):
    robot, path, episodes = made("position")
    wrong = changed(episodes, lambda _, values: 100.0 * values, measured=False)
    right = assert_named(robot, path, wrong, "scale", NAMES)
    assert [joint.command.scale for joint in right.joints] == pytest.approx([0.01] * 3, rel=0.05)


@pytest.mark.long
@pytest.mark.parametrize("direction", [(0, 0, 1), (1, 0, 0)])
@pytest.mark.parametrize("signal", ["position", "torque"])
def test_gravity_that_pulls_elsewhere_is_named(tmp_path, signal, direction):
    robot, path = arm(tmp_path, signal)
    episodes = logs(robot, path, np.random.default_rng(5), gravity=9.81 * np.array(direction))
    findings = look(robot, path, episodes)
    assert certain(findings) == [("gravity", ())]
    line = findings[0].mends[0].lines
    path.write_text(
        re.sub(r' gravity="[^"]*"', "", path.read_text()).replace("<option ", line.removesuffix("/>") + " ")
    )
    assert certain(look(robot, path, episodes)) == []


@pytest.mark.long
def test_weight_that_something_else_carries_is_named(tmp_path):
    robot, path = arm(tmp_path, "torque")
    episodes = logs(robot, path, np.random.default_rng(5), gravity=np.zeros(3))
    right = assert_named(robot, path, episodes, "gravity-compensation", [])
    assert right.simulation.gravity_compensation


@pytest.mark.long
@pytest.mark.parametrize(
    ("signal", "late_s"), [("position", -0.4), ("torque", 0.3), ("torque", -0.15), ("velocity", -0.3)]
)
def test_clocks_that_are_apart_are_named(made, signal, late_s):
    robot, path, episodes = made(signal)
    wrong = [
        replace(episode, command=replace(episode.command, time_s=episode.command.time_s - late_s))
        for episode in episodes
    ]
    right = assert_named(robot, path, wrong, "delay", [])
    # A servo's own lag is no part of it.
    assert right.controller.delay_s + right.clock.command_shift_s == pytest.approx(late_s, abs=0.1)


@pytest.mark.long
@pytest.mark.parametrize(("signal", "factor"), [("position", 1000.0), ("torque", 1000.0), ("torque", 0.5)])
def test_stamps_in_another_unit_are_named(made, signal, factor):
    robot, path, episodes = made(signal)
    wrong = [
        replace(
            episode,
            measured=replace(episode.measured, time_s=factor * episode.measured.time_s),
            command=replace(episode.command, time_s=factor * episode.command.time_s),
        )
        for episode in episodes
    ]
    assert assert_named(robot, path, wrong, "clock", []).clock.scale == pytest.approx(1.0 / factor)


@pytest.mark.long
def test_positions_in_torque_motors_are_named(made, tmp_path):
    _, path, episodes = made("position")
    robot, _ = arm(tmp_path, "torque")
    wrong = [
        replace(
            episode,
            command=replace(
                episode.command, signals={"torque": episode.command["position"]}, units={"torque": ("Nm",) * 3}
            ),
        )
        for episode in episodes
    ]
    (found,) = [finding for finding in look(robot, path, wrong) if finding.severity == "certain"]
    assert found.kind == "control-mode"
    controller = mended(robot, found.mends[0].lines).controller
    assert controller.kind == "position"
    assert controller.kp == pytest.approx(60.0, rel=0.3)
    assert certain(look(mended(robot, found.mends[0].lines), path, episodes)) == []


@pytest.mark.long
def test_two_mistakes_are_named_one_after_the_other(made):
    robot, path, episodes = made("torque")
    wrong = changed(changed(episodes, mirrored(1)), scaled(2, 180 / math.pi), command=False)
    findings = look(robot, path, wrong)
    assert sorted(certain(findings)) == [("sign", ("lift",)), ("unit", ("elbow",))]
    for finding in findings:
        if finding.severity == "certain":
            robot = mended(robot, finding.mends[0].lines)
    assert certain(look(robot, path, wrong)) == []


def test_the_same_column_twice_is_named(made):
    robot, path, episodes = made("position")
    wrong = [
        replace(
            episode, measured=replace(episode.measured, signals={**episode.measured.signals, **episode.command.signals})
        )
        for episode in episodes
    ]
    assert certain(look(robot, path, wrong)) == [("command-is-measurement", NAMES)]


def test_a_log_without_its_command_is_named(made):
    robot, path, episodes = made("velocity")
    wrong = replace(robot, controller=replace(robot.controller, kind="position", kp=50.0))
    (found,) = look(wrong, path, episodes)
    assert (found.kind, found.severity) == ("no-command", "certain")
    assert "kind: velocity" in found.mends[0].lines
    (none,) = look(robot, path, [replace(episode, command=None) for episode in episodes])
    assert "have no command" in none.evidence


def loaded(model):
    model.body_mass[-1] += 1.0


def test_a_payload_is_likely_and_weighed(tmp_path):
    robot, path = arm(tmp_path, "torque")
    (found,) = look(robot, path, logs(robot, path, np.random.default_rng(6), change=loaded))
    assert (found.kind, found.severity) == ("payload", "likely")
    assert found.numbers["mass_kg"] == pytest.approx(1.0, rel=0.3)
    assert "sites: [tool]" in found.mends[0].lines


def weightless(model):
    model.opt.gravity[:] = 0


def test_a_servo_that_stands_where_the_model_sags_is_likely(tmp_path):
    robot, path = arm(tmp_path, "position")
    findings = look(robot, path, logs(robot, path, np.random.default_rng(6), change=weightless, still=True))
    assert certain(findings) == []
    assert {"integral", "gravity-compensation"} & {finding.kind for finding in findings}


@pytest.mark.long
def test_joints_that_never_move_are_said(made):
    robot, path, episodes = made("position")

    def held(name, values):
        values[:, 0] = 0.3 if name == "position" else 0.0
        return values

    (dead,) = look(robot, path, changed(episodes, held, command=False))
    assert (dead.kind, dead.severity, dead.joints) == ("idle-joint", "likely", ("yaw",))
    (quiet,) = look(robot, path, changed(episodes, held))
    assert (quiet.kind, quiet.severity) == ("idle-joint", "note")


def imprecise(rng):
    """Another robot of the kind: other gains, masses, friction, and drives that are weak."""

    def change(model):
        model.body_mass[:] *= rng.uniform(0.7, 1.5)
        model.body_mass[-1] += rng.uniform(0.0, 0.4)
        model.dof_frictionloss[:] *= rng.uniform(0.0, 6.0)
        model.dof_damping[:] *= rng.uniform(0.3, 4.0)
        stiffer = np.exp(rng.uniform(np.log(0.25), np.log(4.0), model.nu))
        if model.actuator_biasprm[0, 1]:
            model.actuator_gainprm[:, 0] *= stiffer
            model.actuator_biasprm[:, 1] *= stiffer
            model.actuator_biasprm[:, 2] *= np.sqrt(stiffer)
            model.actuator_forcelimited[:] = 1
            model.actuator_forcerange[:] = np.array([-1.0, 1.0]) * rng.uniform(2.0, 20.0)

    return change


@pytest.mark.long
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("signal", SIGNALS)
def test_a_model_that_is_imprecise_is_no_wrong_set_up(tmp_path, signal, seed):
    robot, path = arm(tmp_path, signal)
    rng = np.random.default_rng([seed, 9])
    episodes = logs(robot, path, rng, change=imprecise(rng), still=signal == "position" and seed == 1)
    step = 0.003

    def coarse(name, values):
        return step * np.round(values / step) if name == "position" else values

    assert certain(look(robot, path, changed(episodes, coarse, command=False))) == []


@pytest.mark.slow
def test_drawn_mistakes_are_named(made):
    """Of mistakes drawn at random at least 95 in 100 are named, and mended by their first lines."""
    rng, total, named = np.random.default_rng(11), 0, 0
    for _ in range(20):
        signal, side = rng.choice(SIGNALS), rng.choice(list(SIDES))
        robot, path, episodes = made(str(signal), int(rng.integers(2)))
        joint = int(rng.integers(1, 3))
        draws = {
            "sign": (mirrored(joint), {NAMES[joint]}),
            "swap": (swapped(joint, 0), {NAMES[joint], NAMES[0]}),
            "unit": (scaled(joint, float(rng.choice([180 / math.pi, 1000.0]))), {NAMES[joint]}),
        }
        kind = str(rng.choice(list(draws)))
        change, joints = draws[kind]
        measured, command = SIDES["measured" if kind == "unit" and signal != "position" else str(side)]
        wrong = changed(episodes, change, measured=measured, command=command)
        findings = look(robot, path, wrong)
        total += 1
        if [(what, set(names)) for what, names in certain(findings)] == [(kind, joints)]:
            first = next(finding for finding in findings if finding.severity == "certain")
            named += certain(look(mended(robot, first.mends[0].lines), path, wrong)) == []
    assert named >= 0.95 * total


def test_a_result_is_read_back(tmp_path):
    finding = Finding(
        "sign",
        "certain",
        "Lift counts the other way round.",
        ("lift",),
        (Mend("robot.yaml", "joints: []", "so"),),
        {"left": 0.1},
    )
    result = CheckResult((finding,), motions=3, unseen=("Whether …",), seconds=0.5, provenance={"seed": None})
    result.save(tmp_path / "check.json")
    assert CheckResult.load(tmp_path / "check.json") == result
    assert result.certain == (finding,)


@pytest.mark.parametrize("limits", [(-1.0, 2.0), (-np.inf, np.inf)])
@pytest.mark.parametrize("kind", ["rad", "m"])
def test_what_is_written_for_a_unit_is_that_unit(kind, limits):
    for unit in units_of(kind, *limits):
        rule = JointRule("joint", "joint", scale=unit.scale, log_unit=unit.log_unit, unit=kind)
        assert rule.factor("position", "1", "1")[0] == pytest.approx(unit.si), unit.name


# Readings of the logs that nothing but the motion speaks for.
OF_READING = {"sign", "swap", "offset", "unit", "relation", "gear", "gravity", "clock", "delay", "control-mode"}


@pytest.mark.long
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("name", ["arm", "ur5e"])
def test_a_robot_that_follows_by_itself_is_read_as_it_is(tmp_path, request, name, seed):
    """Industrial drives carry the weight themselves: they follow late and a little less, whatever a model says."""
    rng = np.random.default_rng([seed, 11])
    if name == "arm":
        robot, path = arm(tmp_path, "position")
        home, moved = np.array([0.0, 0.2, 0.9]), 0.5
    else:
        path = request.getfixturevalue("foreign_models") / "ur5e.xml"
        robot = draft_robot(path).robot
        home, moved = np.array([0.3, -1.3, 1.5, -1.7, -1.6, 0.6]), 0.4
    count = len(robot.joints)
    rate, phase = rng.uniform(0.5, 5.0, (count, 3)), rng.uniform(0.0, 6.28, (count, 3))
    size = rng.dirichlet(np.ones(3), count) * rng.uniform(0.3, 1.0, (count, 1)) * moved

    def told(time_s):
        return home + np.sum(size * np.sin(rate * np.atleast_1d(time_s)[:, None, None] + phase), axis=2)

    time_s = np.arange(0.0, 8.0, 0.01)
    less, late_s = rng.uniform(0.96, 1.0, count), rng.uniform(0.03, 0.05, count)
    done = np.column_stack([told(time_s - late)[:, joint] for joint, late in enumerate(late_s)])
    done = home + less * (done - home) + rng.normal(0.0, 3e-4, done.shape)
    names, units = robot.joint_names, {"position": ("rad",) * count}
    episode = Episode(
        EpisodeMeta("m"),
        TimeSeries(time_s, names, {"position": done}, units),
        TimeSeries(time_s, names, {"position": told(time_s)}, units),
    )
    findings = look(robot, path, [episode])
    assert [finding for finding in findings if finding.severity != "note" and finding.kind in OF_READING] == []
