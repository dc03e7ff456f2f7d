import pytest

from trueup.errors import ConfigError
from trueup.robots import JointFriction, find_model, load_robot, shipped_robots

GOOD = """
schema: trueup.robot/1
name: arm
model: arm.xml
joints: [{name: a, log: A}, {name: b, sign: -1}]
"""


@pytest.mark.parametrize("path", shipped_robots(), ids=lambda path: path.stem)
def test_every_shipped_robot_loads_by_its_name(path):
    robot = load_robot(path.stem)
    assert robot.name == path.stem
    assert set(robot.scored_joints) <= set(robot.joint_names)


def test_a_robot_of_ones_own(tmp_path):
    (tmp_path / "arm.yaml").write_text(GOOD)
    robot = load_robot(tmp_path / "arm.yaml")
    assert robot.joint_names == robot.scored_joints == ("a", "b")
    rules = robot.joint_rules()["joints"]
    assert {name: (rule["log"], rule["sign"]) for name, rule in rules.items()} == {"a": ("A", 1), "b": ("b", -1)}


def test_friction_delays_and_gravity_compensation_are_read(tmp_path):
    (tmp_path / "arm.yaml").write_text(
        GOOD
        + "controller: {kind: torque, delay_s: 0.02, per_joint: {b: {delay_s: 0.05}}}\n"
        + "simulation: {gravity_compensation: true}\n"
        + "friction: {b: {stribeck: 0.2, sigmoid_shift: -0.01, asymmetry: -0.5}}\n"
    )
    robot = load_robot(tmp_path / "arm.yaml")
    assert robot.delay_s == (0.02, 0.05)
    assert robot.simulation.gravity_compensation
    assert robot.friction == {"b": JointFriction(stribeck=0.2, sigmoid_shift=-0.01, asymmetry=-0.5)}


def test_without_a_line_there_is_no_friction_no_delay_and_the_plain_weight(tmp_path):
    (tmp_path / "arm.yaml").write_text(GOOD + "controller: {kind: torque}\n")
    robot = load_robot(tmp_path / "arm.yaml")
    assert (robot.friction, robot.delay_s, robot.simulation.gravity_compensation) == ({}, (0.0, 0.0), False)


def test_a_delay_of_zero_for_one_joint_is_not_the_common_one(tmp_path):
    (tmp_path / "arm.yaml").write_text(
        GOOD + "controller: {kind: torque, delay_s: 0.02, per_joint: {a: {delay_s: 0}}}\n"
    )
    assert load_robot(tmp_path / "arm.yaml").delay_s == (0.0, 0.02)


def test_a_measured_torque_stands_for_the_command_where_that_is_asked_for(tmp_path):
    (tmp_path / "arm.yaml").write_text(GOOD + "controller: {kind: torque, source: measured}\n")
    robot = load_robot(tmp_path / "arm.yaml")
    assert robot.joint_rules()["measured_command"] == "torque"
    assert robot.to_dict()["controller"]["source"] == "measured"
    (tmp_path / "arm.yaml").write_text(GOOD + "controller: {kind: torque, source: commanded}\n")
    robot = load_robot(tmp_path / "arm.yaml")
    assert "measured_command" not in robot.joint_rules()
    assert "source" not in robot.to_dict()["controller"]  # runs of before there was one are still of this robot


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("controller: {kind: position, kp: 1, source: measured}", "Only a torque can be followed as it was measured"),
        ("controller: {kind: torque, source: guessed}", "controller: source is not a choice"),
        ("scored: [c]", r"\['c'\] are not joints.*available: a, b"),
        ("controller: {kind: magic}", r"controller: kind is not a choice.*pid"),
        ("controller: {kind: torque, delay_s: -0.1}", "delay_s must be >= 0"),
        ("controller: {kind: torque, delay_s: 1.0e+12}", "0 to 3600 s"),
        ("replay: {settle_s: 1.0e+12}", "settle_s: got 1e\\+12; expected 0 to 3600 s"),
        ("controller: {kind: model}", "needs to know what it is told"),
        ("controller: {kind: pd, kp: 1, command: torque}", "'pd' follows position"),
        ("controller: {kind: position, kv: 2}", r"gains of joint 'a'.*kp > 0"),
        ("controller: {kind: position, kp: 2, per_joint: {b: {kp: -1}}}", r"gains of joint 'b'"),
        ("controller: {kind: position, kp: 2, per_joint: {b: {Kp: 1}}}", r"unknown keys \['Kp'\]"),
        ("simulation: {timestep_s: 0}", "timestep_s must be positive"),
        ("controller: {kind: torque, per_joint: {b: {delay_s: -0.1}}}", "delay_s must be >= 0"),
        (
            "controller: {kind: torque, delay_s: .inf}",
            r"not plain YAML: got \.inf in line \d+, which is no finite number",
        ),
        ("controller: {kind: torque, delay_s: .nan}", r"got \.nan in line \d+, which is no finite number"),
        ("controller: {kind: torque, per_joint: {b: {delay: 0.1}}}", r"unknown keys \['delay'\].*delay_s"),
        ("simulation: {gravity_compensation: 3}", "gravity_compensation"),
        ("friction: {c: {load: 0.1}}", r"\['c'\] are not joints.*available: a, b"),
        ("friction: {a: {load: -0.1}}", r"friction: load.*got -0.1.*>= 0"),
        ("friction: {a: {stribek: 0.1}}", r"unknown keys \['stribek'\].*stribeck"),
        ("friction: {a: {asymmetry: 1.0}}", "asymmetry must lie between -1 and 1"),
        ("friction: {a: {load: much}}", "load"),
        ("replay: {window_s: 0.0}", "window_s must be positive"),
        ("gains: {}", r"unknown keys \['gains'\].*controller"),
        ("schema: trueup.robot/7", "schema is not a choice"),
    ],
)
def test_a_wrong_line_is_named(tmp_path, line, message):
    text = GOOD.replace("schema: trueup.robot/1\n", "") if line.startswith("schema") else GOOD
    (tmp_path / "arm.yaml").write_text(text + line)
    with pytest.raises(ConfigError, match=message):
        load_robot(tmp_path / "arm.yaml")


def test_an_unknown_robot_is_answered_with_the_shipped_ones():
    with pytest.raises(ConfigError, match=r"'so99'.*demo_arm.*so101"):
        load_robot("so99")


def test_the_model_is_looked_for_beside_the_data_first(tmp_path):
    robot = load_robot("demo_arm")
    assert find_model(robot).name == "demo_arm.xml"
    (tmp_path / "model").mkdir()
    (tmp_path / "model" / "demo_arm.xml").write_text("<mujoco/>")
    assert find_model(robot, folder=tmp_path / "model") == tmp_path / "model" / "demo_arm.xml"
    with pytest.raises(ConfigError, match="no model at"):
        find_model(robot, given=tmp_path / "other.xml")


def test_a_model_that_is_nowhere_says_where_it_was_looked_for(tmp_path):
    with pytest.raises(ConfigError, match=r"(?s)so101\.xml.*not found in .*--model"):
        find_model(load_robot("so101"), folder=tmp_path)


def test_a_model_that_is_a_link_out_of_the_dataset_is_not_followed(tmp_path):
    (tmp_path / "elsewhere.xml").write_text("<mujoco/>")
    (tmp_path / "model").mkdir()
    (tmp_path / "model" / "so101.xml").symlink_to(tmp_path / "elsewhere.xml")
    with pytest.raises(ConfigError, match="was not found"):
        find_model(load_robot("so101"), folder=tmp_path / "model")
