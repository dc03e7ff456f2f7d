"""What a URDF says that MuJoCo does not keep."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

from trueup.core.atomic import regular
from trueup.errors import DataError


def urdf_velocity_limits(path: Path) -> dict[str, float]:
    """Joint -> largest speed from `<limit velocity="...">` [rad/s or m/s]; empty if the file is no URDF.

    Joints without a limit are left out, and so are those whose limit is no positive number: exporters write 0 where
    nobody has said one.
    """
    try:
        regular(path)
        if next(ET.iterparse(path, events=("start",)))[1].tag != "robot":  # noqa: S314 - expat caps entity expansion
            return {}
        root = ET.parse(path).getroot()  # noqa: S314 - as above
    except (ET.ParseError, StopIteration, OSError, LookupError, ValueError, DataError):
        return {}  # MuJoCo reads some files that are no proper XML; what it cannot read, it refuses itself
    found = {}
    for joint in root.findall("joint"):
        limit = joint.find("limit")
        speed = _number(limit.get("velocity", "")) if limit is not None else 0.0
        if 0 < speed < float("inf"):
            found[joint.get("name", "")] = speed
    return found


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return 0.0
