import numpy as np
import pytest

from trueup.align import JointMap, JointRule, limits_in_log
from trueup.core.timeseries import TimeSeries


def log(joints, position_units, torque_units):
    zeros = np.zeros((2, len(joints)))
    units = {"position": position_units, "torque": torque_units}
    return TimeSeries(np.array([0.0, 1.0]), joints, {"position": zeros, "torque": zeros}, units)


def test_limits_are_told_in_the_units_signs_and_zeros_of_the_log():
    joint_map = JointMap(
        (
            JointRule("elbow", "E", sign=-1, offset=0.5),
            JointRule("slide", "S"),
            JointRule("jaw", "J", scale=2.0, offset=-0.25, log_unit="1"),
            JointRule("absent", "A"),
        )
    )
    measured = log(("E", "S", "J"), ("deg", "mm", "rad"), ("mNm", "N", "Nm"))
    positions, torques = limits_in_log(
        joint_map,
        measured,
        positions={"elbow": (-1.0, 2.0), "slide": (0.0, 0.1), "jaw": (-0.25, 1.75), "absent": (0.0, 1.0)},
        torques={"elbow": 3.0, "slide": 40.0},
    )
    # elbow = -x + 0.5: -1 rad is at x = 1.5 rad, 2 rad at -1.5 rad
    assert positions["E"] == pytest.approx((np.degrees(-1.5), np.degrees(1.5)))
    assert positions["S"] == pytest.approx((0.0, 100.0))
    assert positions["J"] == pytest.approx((0.0, 1.0))  # the numbers of the log, whatever unit it claims
    assert torques == pytest.approx({"E": 3000.0, "S": 40.0})
    assert "A" not in positions


def test_a_log_that_reaches_its_limits_reaches_them_in_the_words_of_the_robot():
    joint_map = JointMap((JointRule("elbow", "E", sign=-1, scale=0.5, offset=0.2),))
    measured = log(("E",), ("deg",), ("Nm",))
    positions, _ = limits_in_log(joint_map, measured, positions={"elbow": (-1.0, 0.7)}, torques={})
    ends = TimeSeries(measured.time_s, ("E",), {"position": np.array([positions["E"]]).T}, {"position": ("deg",)})
    assert sorted(joint_map.apply(ends)["position"][:, 0]) == pytest.approx([-1.0, 0.7])
