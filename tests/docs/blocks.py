"""What is known of the blocks of the pages, and which test runs those that are no commands."""

import torch

# Page -> beginning of a block, or [its language] for all of them -> the test that runs it.
ELSEWHERE = {
    "README": {"[python]": "tests/test_readme.py::test_the_python_example_runs_as_it_stands"},
    "architecture": {
        "core, errors": "tests/test_architecture.py::test_every_part_has_an_arrow_and_stands_in_the_architecture_page"
    },
    "augmentation": {"[python]": "tests/docs/test_augmentation_docs.py::test_the_python_of_the_page_runs"},
    "check": {
        "error: shoulder": "tests/stages/test_checking.py::test_the_page_shows_what_is_printed",
        "[json]": "tests/stages/test_checking.py::test_the_page_shows_what_is_printed",
    },
    "compensation-online": {"[python]": "tests/docs/test_compensation_online.py::test_the_python_of_the_page_runs"},
    "extending": {
        "[text]": "tests/docs/test_extending.py::test_the_format_is_detected_and_read",
        "[python]": "tests/docs/test_extending.py::test_each_takes_one_file_and_one_line",
        "[diff]": "tests/docs/test_extending.py::test_each_takes_one_file_and_one_line",
        "[sh]": "tests/docs/test_extending.py::test_every_command_does_what_the_page_says",
        "[yaml]": "tests/docs/test_extending_robot.py::test_a_robot_takes_no_code_and_a_law_one_file_and_one_line",
        "[xml]": "tests/docs/test_extending_robot.py::test_a_robot_takes_no_code_and_a_law_one_file_and_one_line",
    },
    "gallery": {
        "[text]": "tests/docs/test_gallery.py::test_it_shows_what_the_example_says_and_its_code",
        "[py]": "tests/docs/test_gallery.py::test_it_shows_what_the_example_says_and_its_code",
    },
    "identification": {
        "import yaml": "tests/docs/test_identification_docs.py::test_the_lines_for_isaac_lab_are_those_of_the_report"
    },
    "payload": {"payload by the motion": "tests/stages/test_weighing.py::test_the_page_shows_what_is_printed"},
    "policies": {"[python]": "tests/docs/test_policies.py::test_the_python_of_the_page_runs"},
    "realtime": {"[python]": "tests/deploy/test_realtime.py::test_the_python_of_the_page_runs"},
    "ros2": {
        "trueup deploy serve": "tests/ros2/test_page.py::test_three_terminals",
        "trueup deploy ros2 zoo": "tests/ros2/test_page.py::test_three_terminals",
        "note: joint states": "tests/ros2/test_page.py::test_three_terminals",
        "trueup record --hardware ros2 --robot panda --scale": "tests/ros2/test_page.py::test_three_terminals",
        "trueup deploy ros2 models/compensation": "tests/ros2/test_page.py::test_corrected_commands",
        "trueup record --hardware ros2 --robot panda --plan": "tests/ros2/test_page.py::test_a_robot_of_ros2_control",
        "[python]": "tests/ros2/test_page.py::test_the_python_of_the_page_runs",
    },
    "index": {"On 4 motions": "tests/docs/test_close_page.py::test_the_first_page_says_what_the_demo_ends_with"},
    "runtime": {"[python]": "tests/docs/test_runtime_docs.py::test_the_python_of_the_page_runs"},
    "start-here": {"│ parameter": "tests/docs/test_start_here.py::test_the_fitted_numbers_are_those_of_the_fit"},
}
# Their `trueup` commands, too.
COMMANDS_ELSEWHERE = ("extending", "ros2")

# The same, of tests of test_every_command.py.
_RUN = "test_the_commands_of_a_page_run_in_order"
HERE = {
    "augmentation": {"[yaml]": "test_a_configuration_of_a_network_is_trained_with", "[json]": _RUN},
    "cheat-sheet": {
        "schema: trueup.robot/1": "test_the_files_of_the_cheat_sheet_are_read",
        "joints: [shoulder, elbow]": "test_the_files_of_the_cheat_sheet_are_read",
    },
    "close": {"[json]": _RUN},
    "compensation": {"from trueup.stages import": "test_what_is_imported_can_be"},
    "dataset": {"data/arm/": "test_a_dataset_has_these_files"},
    "experiments": {"class MyRobot:": "test_a_robot_of_ones_own_has_what_an_experiment_needs"},
    "files": {"[json]": _RUN},
    "friction": {"friction:": "test_friction_is_read_from_the_description_of_a_robot"},
    "log-formats": {"command_joints:": _RUN},
    "policies": {"fit:": _RUN, "rate:": _RUN},
    "robot-yaml": {
        "schema: trueup.robot/1": "test_the_description_that_is_shown_is_read",
        "- {name: gripper": "test_the_jaw_of_the_so101_is_described_as_its_robot_has_it",
        "controller: {kind: torque}": "test_a_robot_that_takes_torques_is_described_so",
        "controller: {kind: position, kp: 0.7, kv: 0.02, kp_setting: 400}": "test_a_gain_that_differs_from_motion_to_motion_is_described_so",
        "base: held": "test_the_ways_to_hold_a_base_and_other_joints_are_read",
        "unlisted: lock": "test_the_ways_to_hold_a_base_and_other_joints_are_read",
    },
    "robots": {"schema: trueup.robot/1": "test_init_writes_the_description_that_is_shown"},
    "runtime": {"[cpp]": "test_the_states_of_a_network_are_named_as_in_cpp"},
}

# What is no command and no file, and why it is shown.
SHOWN = {
    "README": {"rung ": "the table of the command above it, from all of the recording"},
    "architecture": {"logs ──import──▶": "a drawing"},
    "logs": {"t_ms,yaw,shoulder,elbow": "the beginning of a file that the commands below it read"},
    "realtime": {"│ kernel": "what the command above it says of another machine"},
}

# Page -> files that its commands leave, which some page has an example of.
CONTRACTS = {
    "augmentation": ("runs/sweep/sweep.json",),
    "close": ("runs/first/close.json",),
    "identification": (
        "runs/arm-fit/fit.json",
        "runs/arm-fit/ladder.json",
        "runs/why/gap.json",
        "runs/why/explain.json",
    ),
}

# Of files whose format has changed since the first one.
VERSIONS = {"explain": 2}

# Page -> lines of output that come of all of the recording or all parameters, not of the few that are run here.
OTHER_DATA = {
    "first-hour": (
        r"(actuator_bandwidth|backlash_detection|velocity_ramp)  train",
        r"mujoco/fitted",
        r"warning: status",
    ),
    "logs": (r"splits: ",),
    "identification": (
        r"note: (\d+ of \d+ parameters are not determined|left as they are)",
        r"warning: status",
        r"  next: ",
    ),
    "selftest": (r"note: to determine", r"\d+ of \d+ numbers"),
}


# Without a GPU, what asks for one is refused.
NO_GPU = 0 if torch.cuda.is_available() else 2


def codes(line):
    """The exit codes that a line may end with."""
    text = " ".join(line.words)
    if "--device cuda" in text:
        return (NO_GPU,)
    return (0, 3) if "doctor --realtime" in text else (line.code,)
