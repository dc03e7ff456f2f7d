"""Inertial sensors of a bag: what they read, as signals of the body that they sit on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial.transform import Rotation, Slerp

from trueup.core.episode import Flag
from trueup.core.interpolation import columns_at
from trueup.core.timeseries import TimeSeries
from trueup.core.units import SI_UNIT
from trueup.dataset.importers.clock import seconds
from trueup.dataset.importers.samples import NS_PER_S, stamp_ns

FORCE, ROTATION = "body.specific_force", "body.rotation"
# A quaternion that is as long as this is one; sensors that know no orientation send zeros.
_SHORTEST = 0.5


@dataclass(frozen=True, eq=False)
class Readings:
    """N readings of a sensor, in the order of their recording.

    Attributes:
        topic: where they come from.
        body: the frame that they are of, or what the topic is called.
        stamp_ns: header stamps, (N,) [ns], 0 where not set.
        log_ns: time at which the recorder got the message, (N,) [ns].
        force: specific force in the axes of the sensor, (N, 3) [m/s^2].
        orientation: of the sensor in the world, (N, 4) as x, y, z, w; None where the sensor knows none.
    """

    topic: str
    body: str
    stamp_ns: Int64[np.ndarray, "N"]
    log_ns: Int64[np.ndarray, "N"]
    force: Float64[np.ndarray, "N 3"]
    orientation: Float64[np.ndarray, "N 4"] | None


def readings(topic: str, messages: Sequence[tuple[int, Any]]) -> Readings | None:
    """Messages of type `sensor_msgs/Imu`; None if there are none, or they hold no acceleration.

    By the convention of the type, -1 in the first place of a covariance says that the quantity is not measured.

    Args:
        topic: their topic.
        messages: time of recording [ns] and message.
    """
    whole = [item for item in messages if item[1].linear_acceleration_covariance[0] != -1]
    if not whole:
        return None
    first = whole[0][1]
    force = np.array([[getattr(message.linear_acceleration, axis) for axis in "xyz"] for _, message in whole])
    turned = np.array([[getattr(message.orientation, axis) for axis in "xyzw"] for _, message in whole])
    known = first.orientation_covariance[0] != -1 and np.linalg.norm(turned, axis=1).min() > _SHORTEST
    return Readings(
        topic,
        first.header.frame_id.strip("/") or topic.strip("/"),
        np.array([stamp_ns(message.header) for _, message in whole]),
        np.array([log_ns for log_ns, _ in whole]),
        force,
        turned if known else None,
    )


def with_sensors(
    series: TimeSeries, sensors: Sequence[Readings], origin: int, *, stamped: bool
) -> tuple[TimeSeries, tuple[Flag, ...]]:
    """A series with what sensors read at its stamps: interpolated, and NaN where they were not recorded.

    Args:
        series: measured signals of the joints.
        sensors: their readings.
        origin: of its stamps [ns].
        stamped: whether its stamps are those of the headers, and not of the recorder.
    """
    if not sensors:
        return series, ()
    forces, rotations = [], []
    for own in sensors:
        ticks = own.stamp_ns if stamped and own.stamp_ns.all() else own.log_ns
        ticks, rows = np.unique(ticks, return_index=True)
        time_s = seconds(ticks, origin=origin, per_second=NS_PER_S)
        inside = (series.time_s >= time_s[0]) & (series.time_s <= time_s[-1])
        force = np.full((len(series), 3), np.nan)
        force[inside] = columns_at(series.time_s[inside], time_s, own.force[rows])
        rotation = np.full((len(series), 3, 3), np.nan)
        if own.orientation is not None and len(rows) > 1 and inside.any():
            turned = Slerp(time_s, Rotation.from_quat(own.orientation[rows]))
            rotation[inside] = turned(series.time_s[inside]).as_matrix()
        forces.append(force)
        rotations.append(rotation)
    names = [own.body for own in sensors]
    bodies = tuple(
        name if names.count(name) == 1 else own.topic.strip("/") for name, own in zip(names, sensors, strict=True)
    )
    signals = {FORCE: np.stack(forces, axis=1), ROTATION: np.stack(rotations, axis=1)}
    if all(own.orientation is None for own in sensors):
        del signals[ROTATION]
    what = ", ".join(f"{own.topic} as {body}" for own, body in zip(sensors, bodies, strict=True))
    units = {name: (SI_UNIT[name],) * len(bodies) for name in signals}
    return (
        replace(series, signals={**series.signals, **signals}, units={**series.units, **units}, bodies=bodies),
        (Flag(kind="sensors", series="measured", detail=f"inertial sensors: {what}", severity="note"),),
    )
