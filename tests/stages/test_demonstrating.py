"""What a demo says at its end is what its runs are."""

import numpy as np
import pytest

from trueup.core.close_result import CloseResult
from trueup.core.results import Estimate, Ladder, MetricResult, Rung
from trueup.core.timeseries import TimeSeries
from trueup.dataset import Dataset, RunWriter
from trueup.lab import record_demo
from trueup.robots import load_robot
from trueup.stages import demo_dataset
from trueup.stages.close_steps import Closed
from trueup.stages.demonstrating import told

# Of the tool, at the first pose of each joint's zero: 25 and 22 cm of links, and 12 + 5 cm of column above the base.
LINKS_M = (0.25, 0.22)


def with_run(folder, label, turned_rad):
    """A run that is the measured motion, turned about the upright axis, of all motions."""
    data = Dataset(folder)
    info = {"engine": "mujoco", "scored_joints": list(data[0].measured.joints), "torque_limits": {}, "inputs": {}}
    with RunWriter(folder, label, run_info=info) as writer:
        for episode in data:
            position = episode.measured["position"] + np.array([turned_rad, 0.0, 0.0])
            units = {"position": ("rad",) * 3}
            writer.append(
                episode.id, TimeSeries(episode.measured.time_s, episode.measured.joints, {"position": position}, units)
            )


def rung(name, value):
    return Rung(name, 0.0, {"test": {"position": {"rmse": MetricResult(Estimate(value, "rad"), {}, 4)}}})


def tool_mm(folder, turned_rad):
    """By the law of cosines in the plane of the arm, in which the upright axis turns nothing."""
    squares = []
    for episode in Dataset(folder):
        if episode.meta.split == "test":
            _, shoulder, elbow = episode.measured["position"].T
            out = LINKS_M[0] * np.cos(shoulder) + LINKS_M[1] * np.cos(shoulder + elbow)
            squares.append((2 * out * np.sin(turned_rad / 2)) ** 2)
    return 1000 * np.sqrt(np.mean(np.concatenate(squares)))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    data = demo_dataset(tmp_path_factory.mktemp("demo") / "data", loads=False)
    with_run(data, "mujoco/stock", 0.1)
    with_run(data, "mujoco/fitted", 0.01)
    return data


def test_the_sentence_says_degrees_and_millimeters(folder):
    result = CloseResult((), "identify")
    closed = Closed(Dataset(folder), result, ladder=Ladder([rung("stock", 0.1), rung("fitted", 0.01)]))
    (line,) = told(closed, load_robot("demo_arm"))
    assert "On 4 motions that the fit has not seen" in line
    assert f"off by 5.7° per joint and {tool_mm(folder, 0.1):.2g} mm at the tool" in line
    assert f"by 0.57° per joint and {tool_mm(folder, 0.01):.2g} mm at the tool: 90 % less." in line


def test_a_fit_that_is_worse_says_so(folder):
    closed = Closed(
        Dataset(folder), CloseResult((), "identify"), ladder=Ladder([rung("stock", 0.01), rung("fitted", 0.02)])
    )
    (line,) = told(closed, load_robot("demo_arm"))
    assert line.endswith(": 100 % more.")


def test_without_a_fit_there_is_nothing_to_say(folder):
    closed = Closed(Dataset(folder), CloseResult((), "gap"), ladder=Ladder([rung("stock", 0.1)]))
    assert told(closed, load_robot("demo_arm")) == ()


def test_only_loads_are_left_out(folder):
    plain = list(Dataset(folder))
    assert {episode.meta.payload_kg for episode in plain} == {0.0}
    for one, other in zip(plain, record_demo(), strict=True):
        np.testing.assert_array_equal(one.command["position"], other.command["position"])
        if other.meta.payload_kg == 0.0:
            np.testing.assert_array_equal(one.measured["position"], other.measured["position"])
