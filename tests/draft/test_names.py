"""Names of joints in logs find those of the model, or nobody is told which."""

import pytest

from trueup.draft import match_names

UR = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint")
SO101 = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
LEGS = tuple(f"{leg}_{part}_joint" for leg in ("FL", "FR", "RL", "RR") for part in ("hip", "thigh", "calf"))


def numbered(name, count=7, first=1):
    return tuple(name.format(number) for number in range(first, first + count))


# Names as drivers write them, in the order of the model's.
@pytest.mark.parametrize(
    ("log", "model", "how"),
    [
        (("Rotation", "Pitch", "Elbow", "Wrist_Pitch", "Wrist_Roll", "Jaw"), SO101, {"name"}),
        (("base", "shoulder", "elbow", "wrist1", "wrist2", "wrist3"), UR, {"name"}),
        (("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"), UR, {"name"}),
        (tuple(name.upper() for name in UR), UR, {"name"}),
        (numbered("fr3_joint{}"), numbered("panda_joint{}"), {"number"}),
        (numbered("q{}", first=0), numbered("joint{}"), {"number"}),
        (numbered("lbr_A{}"), numbered("iiwa_joint_{:02d}"), {"number"}),
        (numbered("joint_{}", first=0), numbered("joint_{}"), {"number"}),
        (numbered("joint_{}", 6), UR, {"order"}),
        (("a", "b"), ("hip", "knee"), {"order"}),
        (
            tuple(f"{leg}_{part}" for leg in ("LF", "RF", "LH", "RH") for part in ("HAA", "HFE", "KFE")),
            LEGS,
            {"name"},
        ),
        (("LeftHipYaw", "LeftKnee", "RightHipYaw"), ("l_hip_yaw", "l_knee", "r_hip_yaw"), {"name"}),
    ],
)
def test_joints_are_found_whatever_the_order_of_the_log(log, model, how):
    found = match_names(log, model)
    assert found.pairs == dict(zip(model, log, strict=True))
    assert set(found.how.values()) == how
    if how == {"name"}:
        assert match_names(log[::-1], model).pairs == found.pairs


def test_fingers_are_no_part_of_a_numbered_arm():
    log = (*numbered("panda_joint{}"), "panda_finger_joint1", "panda_finger_joint2")
    found = match_names(log, numbered("joint{}"))
    assert found.pairs == dict(zip(numbered("joint{}"), numbered("panda_joint{}"), strict=True))
    assert found.strangers == ("panda_finger_joint1", "panda_finger_joint2")


def test_numbers_behind_those_of_an_arm_are_its_gripper():
    model = ("shoulder_pan", "shoulder_lift", "elbow")
    found = match_names(("joint_1", "joint_2", "joint_3", "joint_4"), model)
    assert found.pairs == dict(zip(model, ("joint_1", "joint_2", "joint_3"), strict=True))
    assert set(found.how.values()) == {"order"}
    assert found.strangers == ("joint_4",)
    assert match_names(numbered("joint_{}"), model).pairs == {}


@pytest.mark.parametrize(
    "log",
    [
        ("Basis", "Schulter", "Ellbogen", "Handgelenk 1", "Handgelenk 2"),
        ("Base", "Épaule", "Coude", "Poignet 1", "Poignet 2"),
    ],
)
def test_joints_in_other_languages(log):
    model = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2")
    assert match_names(log, model).pairs == dict(zip(model, log, strict=True))


def test_what_could_be_one_joint_or_another_is_not_matched():
    found = match_names(("knee", "hip"), ("left_knee", "right_knee", "left_hip", "right_hip"))
    assert found.pairs == {}
    assert found.missing == ("left_knee", "right_knee", "left_hip", "right_hip")


def test_left_is_not_right():
    found = match_names(("left_knee", "left_hip"), ("right_knee", "left_hip"))
    assert found.pairs["left_hip"] == "left_hip"
    assert found.how.get("right_knee") in (None, "order")
