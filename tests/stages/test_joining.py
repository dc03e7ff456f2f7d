"""How far corrected bodies are apart at their joints, over many motions."""

import numpy as np
import pytest

from sim.test_projection import bodies_at, poses, robot_of, with_signals
from trueup.core.augment_result import ALL_JOINTS
from trueup.stages.joining import GapTally


def test_repetitions_of_a_motion_are_drawn_together():
    robot, model, bodies = robot_of("kickbot_a")
    rng, once, twice = np.random.default_rng(0), GapTally(model), GapTally(model)
    for number in range(4):
        series = bodies_at(model, robot.joint_names, bodies, poses(robot.joint_names, 5))
        moved = series["body.position"] + 1e-3 * (1 + number) * rng.normal(size=series["body.position"].shape)
        runs = {"net": with_signals(series, body_position=moved)}
        once.add(runs, f"m{number}")
        for _ in range(2):
            twice.add(runs, f"m{number}")
    expected, found = (tally.of("net", draws=300, seed=1)[ALL_JOINTS].apart for tally in (once, twice))
    assert expected.low < expected.value < expected.high
    assert (found.value, found.low, found.high) == pytest.approx((expected.value, expected.low, expected.high))
