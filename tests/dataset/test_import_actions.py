"""Goals and feedback of FollowJointTrajectory are commands and measurements, and what is not read is named."""

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from dataset.test_import_rosbag import (
    JOINT_STATE,
    JOINTS,
    LATE_NS,
    ROS1,
    ROS2,
    START_NS,
    STEP_NS,
    TRAJECTORY,
    fill,
    flags,
    header,
    load,
    motion,
    states,
    trajectory,
    write_bag,
)
from trueup.dataset.importers import rosbag
from trueup.dataset.importers.base import ImportOptions
from trueup.errors import ConfigError

LINE = "=" * 80
ACTION = "control_msgs/action/FollowJointTrajectory_FeedbackMessage"
FEEDBACK = "control_msgs/msg/FollowJointTrajectoryActionFeedback"
GOAL = "control_msgs/msg/FollowJointTrajectoryActionGoal"
STATE = "control_msgs/msg/JointTrajectoryControllerState"
BODY = """std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint desired
trajectory_msgs/JointTrajectoryPoint actual
trajectory_msgs/JointTrajectoryPoint error
"""
MORE = """string[] multi_dof_joint_names
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_desired
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_actual
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error
"""
GOAL_TEXT = f"""std_msgs/Header header
actionlib_msgs/GoalID goal_id
control_msgs/FollowJointTrajectoryGoal goal
{LINE}
MSG: control_msgs/FollowJointTrajectoryGoal
trajectory_msgs/JointTrajectory trajectory
JointTolerance[] path_tolerance
JointTolerance[] goal_tolerance
duration goal_time_tolerance
{LINE}
MSG: control_msgs/JointTolerance
string name
float64 position
float64 velocity
float64 acceleration
"""


def ros2_text(more):
    text = "unique_identifier_msgs/UUID goal_id\ncontrol_msgs/action/FollowJointTrajectory_Feedback feedback\n"
    return f"{text}{LINE}\nMSG: control_msgs/action/FollowJointTrajectory_Feedback\n{BODY}{more}"


def ros2_store(more):
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(ros2_text(more), ACTION))
    return store


def ros1_store():
    text = "std_msgs/Header header\nactionlib_msgs/GoalStatus status\ncontrol_msgs/FollowJointTrajectoryFeedback feedback\n"
    text += f"{LINE}\nMSG: control_msgs/FollowJointTrajectoryFeedback\n{BODY}"
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg(text, FEEDBACK))
    store.register(get_types_from_msg(GOAL_TEXT, GOAL))
    return store


def ros1_header(store, stamp_ns):
    time = store.types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return store.types["std_msgs/msg/Header"](seq=7, stamp=time, frame_id="base")


def points(store, rows):
    """JointTrajectoryPoints: (due [s], positions)."""
    point = store.types["trajectory_msgs/msg/JointTrajectoryPoint"]
    duration, none = store.types["builtin_interfaces/msg/Duration"], np.array([])
    return [
        point(
            positions=np.array(position, dtype=np.float64),
            velocities=none,
            accelerations=none,
            effort=none,
            time_from_start=duration(sec=int(due_s), nanosec=round(due_s % 1 * 1e9)),
        )
        for due_s, position in rows
    ]


def desired(k):
    return [k + 0.5, 1.0, 2.0]


def feedback2(store, more, k):
    own = points(store, [(0, desired(k)), (0, [k, 1.25, 2.5]), (0, [0.5, 0, 0])])
    rest = {}
    if more:
        none = points(store, [(0, [])])[0].time_from_start
        several = store.types["trajectory_msgs/msg/MultiDOFJointTrajectoryPoint"]([], [], [], none)
        rest = dict.fromkeys(("multi_dof_desired", "multi_dof_actual", "multi_dof_error"), several)
        rest["multi_dof_joint_names"] = []
    if "index" in more:
        rest |= {"index": 3, "multi_dof_index": 4}
    inner = store.types["control_msgs/action/FollowJointTrajectory_Feedback"](
        header=header(store, START_NS + k * STEP_NS),
        joint_names=list(JOINTS),
        desired=own[0],
        actual=own[1],
        error=own[2],
        **rest,
    )
    goal = store.types["unique_identifier_msgs/msg/UUID"](uuid=np.arange(16, dtype=np.uint8))
    return bytes(store.serialize_cdr(store.types[ACTION](goal_id=goal, feedback=inner), ACTION))


def write_ros2(path, store, topics, storage=StoragePlugin.MCAP, text=""):
    """text: definition of the actions' messages, which the library's writer does not make."""
    with Writer2(path, version=9, storage_plugin=storage) as writer:
        for name, (kind, items) in topics.items():
            if kind == ACTION:
                connection = writer.add_connection(name, kind, msgdef=text, rihs01="x")
                for log_ns, raw in items:
                    writer.write(connection, log_ns, raw)
        fill(writer, {name: topic for name, topic in topics.items() if topic[0] != ACTION}, store)
    return path


def feedbacks(store, more, count=40):
    return [(START_NS + k * STEP_NS + LATE_NS, feedback2(store, more, k)) for k in range(count)]


NEWEST = "int32 index\n" + MORE + "int32 multi_dof_index\n"


@pytest.mark.parametrize("more", ["", MORE, NEWEST], ids=["old", "humble", "newest"])
def test_feedback_of_an_action_has_command_and_measurement(tmp_path, more):
    store = ros2_store(more)
    topics = {"/arm/follow_joint_trajectory/_action/feedback": (ACTION, feedbacks(store, more))}
    episode = load(write_ros2(tmp_path / "arm", store, topics, text=ros2_text(more)))
    np.testing.assert_array_equal(episode.command.select(JOINTS)["position"], [desired(k) for k in range(40)])
    np.testing.assert_array_equal(episode.measured.select(JOINTS)["position"], [[k, 1.25, 2.5] for k in range(40)])
    np.testing.assert_allclose(episode.command.time_s, 0.01 * np.arange(40), atol=1e-9)
    np.testing.assert_array_equal(episode.measured.time_s, episode.command.time_s)
    assert "header stamps" in flags(episode, "clock")[0].detail


def test_feedback_without_definitions_is_what_it_is_since_humble(tmp_path):
    store = ros2_store(MORE)
    values = motion()
    topics = {
        "/arm/follow_joint_trajectory/_action/feedback": (ACTION, feedbacks(store, MORE)),
        "/joint_states": (JOINT_STATE, states(ROS2, values)),
    }
    episode = load(write_ros2(tmp_path / "arm", store, topics, StoragePlugin.SQLITE3))
    np.testing.assert_array_equal(episode.measured["position"], values[0])
    np.testing.assert_array_equal(episode.command.select(JOINTS)["position"], [desired(k) for k in range(40)])


def goal1(store, sent_ns, rows, stamp_ns=0):
    body = store.types["trajectory_msgs/msg/JointTrajectory"](ros1_header(store, stamp_ns), list(JOINTS), [])
    body.points.extend(points(store, rows))
    tolerance = store.types["control_msgs/msg/JointTolerance"]("elbow", 0.1, 0.2, 0.3)
    duration = store.types["builtin_interfaces/msg/Duration"](sec=1, nanosec=5)
    goal = store.types["control_msgs/msg/FollowJointTrajectoryGoal"](body, [tolerance], [tolerance] * 2, duration)
    time = store.types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    name = store.types["actionlib_msgs/msg/GoalID"](stamp=time, id="goal")
    message = store.types[GOAL](ros1_header(store, sent_ns), name, goal)
    return bytes(store.serialize_ros1(message, GOAL))


def feedback1(store, k):
    own = points(store, [(0, desired(k)), (0, [k, 1.25, 2.5]), (0, [0.5, 0, 0])])
    inner = store.types["control_msgs/msg/FollowJointTrajectoryFeedback"](
        ros1_header(store, START_NS + k * STEP_NS), list(JOINTS), *own
    )
    time = store.types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    status = store.types["actionlib_msgs/msg/GoalStatus"](
        goal_id=store.types["actionlib_msgs/msg/GoalID"](stamp=time, id="goal"), status=1, text="active"
    )
    message = store.types[FEEDBACK](ros1_header(store, 5), status, inner)
    return bytes(store.serialize_ros1(message, FEEDBACK))


def write_ros1(path, store, topics):
    with Writer1(path) as writer:
        fill(writer, topics, store)
    return path


@pytest.mark.parametrize("stamped", [False, True])
def test_goals_of_ros_1_are_planned_trajectories(tmp_path, stamped):
    store = ros1_store()
    first = goal1(store, START_NS, [(k * 0.1, [k, 10 + k, 20 + k]) for k in range(5)])
    # Sent early, begins 50 ms later; or begins when it was sent.
    later_ns = START_NS + 250_000_000
    second = goal1(store, later_ns - 50_000_000 * stamped, [(0.1, [7, 8, 9])], later_ns if stamped else 0)
    topics = {
        "/joint_states": (JOINT_STATE, states(ROS1, motion())),
        "/arm/follow_joint_trajectory/goal": (
            GOAL,
            [(START_NS + LATE_NS, first), (later_ns - 50_000_000 * stamped + LATE_NS, second)],
        ),
    }
    episode = load(write_ros1(tmp_path / "arm.bag", store, topics))
    command = episode.command.select(JOINTS)
    np.testing.assert_allclose(command.time_s, [0.0, 0.1, 0.2, 0.35], atol=1e-9)
    np.testing.assert_array_equal(command["position"], [[0, 10, 20], [1, 11, 21], [2, 12, 22], [7, 8, 9]])
    assert "2 points were superseded" in flags(episode, "trajectory")[0].detail


def test_what_the_controller_was_told_comes_before_what_was_planned(tmp_path):
    store = ros1_store()
    items = [(START_NS + k * STEP_NS + LATE_NS, feedback1(store, k)) for k in range(40)]
    goal = goal1(store, START_NS, [(0, [0, 0, 0]), (1, [1, 1, 1])])
    names = [f"/arm/follow_joint_trajectory/{part}" for part in ("feedback", "goal")]
    topics = {names[0]: (FEEDBACK, items), names[1]: (GOAL, [(START_NS, goal)])}
    path = write_ros1(tmp_path / "arm.bag", store, topics)
    episode = load(path)
    np.testing.assert_array_equal(episode.command.select(JOINTS)["position"], [desired(k) for k in range(40)])
    np.testing.assert_array_equal(episode.measured.select(JOINTS)["position"][:, 0], np.arange(40))
    asked = load(path, command_topic=names[1])
    np.testing.assert_array_equal(asked.command.select(JOINTS)["position"], [[0, 0, 0], [1, 1, 1]])


def test_feedback_of_two_controllers_is_a_choice(tmp_path):
    store = ros2_store(MORE)
    topics = {
        f"/{side}/follow_joint_trajectory/_action/feedback": (ACTION, feedbacks(store, MORE))
        for side in ("left", "right")
    }
    topics["/joint_states"] = (JOINT_STATE, states(ROS2, motion()))
    path = write_ros2(tmp_path / "arms", store, topics)
    with pytest.raises(ConfigError, match=r"(?s)command topic is not clear.*/left/.*/right/.*--command-topic"):
        load(path)
    chosen = load(path, command_topic="/right/follow_joint_trajectory/_action/feedback")
    assert chosen.command.joints == JOINTS


def test_a_state_with_joints_of_many_axes_is_read(tmp_path):
    """As ros2_control publishes it since Jazzy."""
    names = ("reference", "feedback", "error", "output")
    text = "std_msgs/Header header\nstring[] joint_names\n"
    text += "\n".join(f"trajectory_msgs/JointTrajectoryPoint {name}" for name in names)
    text += "\nstring[] multi_dof_joint_names\n"
    text += "\n".join(f"trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_{name}" for name in names)
    text += "\nfloat64 speed_scaling_factor\n"
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(text, STATE))
    due = points(store, [(0, [])])[0].time_from_start
    several = store.types["trajectory_msgs/msg/MultiDOFJointTrajectoryPoint"]([], [], [], due)
    items = []
    for k in range(5):
        own = points(store, [(0, desired(k)), (0, [k, 1, 2]), (0, [0, 0, 0]), (0, [])])
        head = header(store, START_NS + k * STEP_NS)
        message = store.types[STATE](head, list(JOINTS), *own, [], *[several] * 4, 1.0)
        items.append((START_NS + k * STEP_NS, bytes(store.serialize_cdr(message, STATE))))
    episode = load(write_ros2(tmp_path / "arm", store, {"/arm/controller_state": (STATE, items)}))
    np.testing.assert_array_equal(episode.command.select(JOINTS)["position"], [desired(k) for k in range(5)])


def test_a_state_without_its_definition_does_not_spoil_the_rest_of_the_bag(tmp_path):
    values = motion()
    goal = trajectory(START_NS, JOINTS, [(0.0, [0, 0, 0]), (0.3, [1, 1, 1])])
    topics = {
        "/joint_states": (JOINT_STATE, states(ROS2, values)),
        "/arm/joint_trajectory": (TRAJECTORY, [(START_NS, goal)]),
    }
    with Writer2(tmp_path / "arm", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        writer.add_connection("/arm/controller_state", STATE, msgdef="", rihs01="x")
        fill(writer, topics, ROS2)
    np.testing.assert_array_equal(load(tmp_path / "arm").measured["position"], values[0])


def test_a_bag_with_the_status_of_an_action_alone_says_what_to_record(tmp_path):
    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = "action_msgs/msg/GoalStatusArray"
    raw = bytes(store.serialize_cdr(store.types[kind](status_list=[]), kind))
    name = "/arm/follow_joint_trajectory/_action/status"
    topics = {"/joint_states": (JOINT_STATE, states(ROS2, motion())), name: (kind, [(START_NS, raw)])}
    plan = rosbag.scan(write_bag(tmp_path / "arm", topics), ImportOptions())
    (note,) = [note for note in plan.notes if note.startswith("command:")]
    assert (
        f"none found in the bag; of types that are not read: {name} (action_msgs/GoalStatusArray, 1 messages)" in note
    )
    assert "record the action's feedback" in note
