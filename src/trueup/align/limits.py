"""Limits of the robot's joints in the words of a log."""

from __future__ import annotations

from collections.abc import Mapping

from trueup.align.joints import JointMap
from trueup.core.timeseries import TimeSeries


def limits_in_log(
    joint_map: JointMap,
    measured: TimeSeries,
    *,
    positions: Mapping[str, tuple[float, float]],
    torques: Mapping[str, float],
) -> tuple[dict[str, tuple[float, float]], dict[str, float]]:
    """What the robot's limits are in the names and units of a log, for `check_quality`.

    Args:
        joint_map: from the log to the robot.
        measured: a series of the log, for its names and units.
        positions: robot joint -> lowest and highest position [rad or m].
        torques: robot joint -> largest torque [Nm or N].

    Returns:
        Log joint -> position limits, log joint -> torque limit; joints that the log lacks are left out.
    """
    found: dict[str, tuple[float, float]] = {}
    largest: dict[str, float] = {}
    for rule in joint_map.rules:
        if rule.log not in measured.joints or "position" not in measured:
            continue
        column = measured.joints.index(rule.log)
        unit = measured.units["position"][column]
        if rule.joint in positions:
            factor, _ = rule.factor("position", unit, unit)
            low, high = sorted((end - rule.offset) / factor for end in positions[rule.joint])
            found[rule.log] = (low, high)
        if rule.joint in torques and "torque" in measured:
            factor, _ = rule.factor("torque", measured.units["torque"][column], unit)
            largest[rule.log] = abs(torques[rule.joint] / factor)
    return found, largest
