"""Links of a URDF with a mass or an inertia that no body has, and a copy of the file in which they have possible ones.

The principal moments A <= B <= C of a body are positive, and C <= A + B.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

# Of a solid ball in place of a body that has a mass and no size [kg/m3], and of one that has neither [kg].
_DENSITY, _LEAST_KG = 1000.0, 1e-3
# Files round: a violation of this share is none.
_ROUNDED = 1e-6
# Shares of the largest moment: what is below the first is none, or lost when it is written; a rod has the second.
_NONE, _ROD = 1e-9, 1e-3
_ENTRIES = (("ixx", 0, 0), ("iyy", 1, 1), ("izz", 2, 2), ("ixy", 0, 1), ("ixz", 0, 2), ("iyz", 1, 2))


@dataclass(frozen=True, eq=False)
class Fault:
    """What is impossible about a link.

    Attributes:
        link: its name.
        wrong: what no body has.
        done: what a repair puts in its place.
        mass: kg, repaired.
        inertia: kg m2 about the center of mass, repaired, (3, 3).
    """

    link: str
    wrong: str
    done: str
    mass: float
    inertia: Float64[np.ndarray, "3 3"]


def faults(urdf: Path) -> list[Fault]:
    """Impossible links of a URDF that move, in the order of the file."""
    return [fault for _, fault in _faulty(ET.parse(urdf).getroot())]  # noqa: S314 - looked at by `extent` before


def unweighed(urdf: Path) -> list[str]:
    """Links of a URDF that a joint moves and whose mass the file does not say, nor that of what is fixed to them."""
    root = ET.parse(urdf).getroot()  # noqa: S314
    weighs = _weighing(root)
    return [child for _, child, fixed in _ends(root) if not fixed and not weighs(child)]


def repaired(urdf: Path) -> tuple[str, list[Fault]]:
    """The text of a URDF without impossible links, and what was repaired.

    Two moments that are too small for the largest one are raised by the same amount, until they add up to it. A
    moment that is not positive becomes the smallest that is possible beside the others. Where there are no two to go
    by, the link becomes a solid ball of the density of water.
    """
    tree = ET.parse(urdf)  # noqa: S314
    found = _faulty(tree.getroot())
    for link, fault in found:
        inertial = link.find("inertial")
        inertial = ET.SubElement(link, "inertial") if inertial is None else inertial
        for tag, said in (("mass", {"value": fault.mass}), ("inertia", _said(fault.inertia))):
            element = inertial.find(tag)
            element = ET.SubElement(inertial, tag) if element is None else element
            for key, value in said.items():
                element.set(key, f"{value:.9g}")
    return ET.tostring(tree.getroot(), encoding="unicode"), [fault for _, fault in found]


def drop_static(root: ET.Element) -> None:
    """Take impossible masses from links that never move, where they mean nothing."""
    static = _static(root)
    for link in root.iter("link"):
        inertial, name = link.find("inertial"), link.get("name", "")
        if inertial is not None and name in static and _fault(name, inertial, moves=False) is not None:
            link.remove(inertial)


def _static(root: ET.Element) -> set[str]:
    """The root of the robot, and what is fixed to it."""
    children = {child for _, child, _ in _ends(root)}
    static = {name for link in root.iter("link") if (name := link.get("name", "")) not in children}
    while more := {child for parent, child, fixed in _ends(root) if fixed and parent in static} - static:
        static |= more
    return static


def _ends(root: ET.Element) -> list[tuple[str, str, bool]]:
    """Parent, child, and whether nothing moves between them, of each joint."""
    return [
        (parent.get("link", ""), child.get("link", ""), joint.get("type") == "fixed")
        for joint in root.iter("joint")
        if (parent := joint.find("parent")) is not None and (child := joint.find("child")) is not None
    ]


def _faulty(root: ET.Element) -> list[tuple[ET.Element, Fault]]:
    """Links, and what is wrong with them."""
    links, weighs = {link.get("name", ""): link for link in root.iter("link")}, _weighing(root)
    moving, static = {child for _, child, fixed in _ends(root) if not fixed}, _static(root)
    found = []
    for name, link in links.items():
        inertial = link.find("inertial")
        massless = name in moving and not weighs(name)
        if name in static or (inertial is None and not massless):
            continue
        if (
            fault := _fault(name, ET.Element("inertial") if inertial is None else inertial, moves=massless)
        ) is not None:
            found.append((link, fault))
    return found


def _weighing(root: ET.Element) -> Callable[[str], bool]:
    """Says whether a link has a mass, or something that is fixed to it."""
    links = {link.get("name", ""): link for link in root.iter("link")}
    carried: dict[str, list[str]] = {}
    for above, below, fixed in _ends(root):
        if fixed:
            carried.setdefault(above, []).append(below)

    def weighs(name: str) -> bool:
        own = name in links and _number(links[name].find("inertial/mass"), "value") > 0.0
        return own or any(weighs(child) for child in carried.get(name, ()))

    return weighs


def _fault(link: str, inertial: ET.Element, *, moves: bool) -> Fault | None:
    mass, inertia = _number(inertial.find("mass"), "value"), np.zeros((3, 3))
    for name, row, column in _ENTRIES:
        inertia[row, column] = inertia[column, row] = _number(inertial.find("inertia"), name)
    if not (np.isfinite(mass) and np.isfinite(inertia).all()):
        mass, inertia = 0.0, np.zeros((3, 3))
    if mass <= 0.0:
        if not moves and not inertia.any():
            return None  # a frame
        return Fault(link, f"a mass of {mass:g} kg", "1 g, as a ball of water", _LEAST_KG, _ball(_LEAST_KG))
    moments, axes = np.linalg.eigh(inertia)
    low, middle, high = (float(value) for value in moments)
    if middle <= max(_NONE * high, _ROUNDED * _ball(mass)[0, 0]):
        size = ", ".join(f"{value:.3g}" for value in moments)
        return Fault(link, f"principal moments of {size} kg m2", "those of a ball of water", mass, _ball(mass))
    if low + middle >= (1.0 - _ROUNDED) * high and low > _NONE * high:
        return None
    if low <= _NONE * high:
        moments = np.array([max(high - middle, _ROD * high), middle, high])
        wrong, done = f"a principal moment of {low:.3g} kg m2", f"{moments[0]:.3g} kg m2"
    else:
        more = 0.5 * (high - middle - low)
        moments = np.array([low + more, middle + more, high])
        wrong = (
            f"principal moments of {low:.3g}, {middle:.3g} and {high:.3g} kg m2, the last above the sum of the others"
        )
        done = f"{moments[0]:.3g} and {moments[1]:.3g} kg m2 for the first two"
    return Fault(
        link, wrong, done, mass, np.asarray((axes * (moments * (1.0 + _ROUNDED * np.array([1, 1, 0])))) @ axes.T)
    )


def _ball(mass: float) -> Float64[np.ndarray, "3 3"]:
    radius = (3.0 * mass / (4.0 * np.pi * _DENSITY)) ** (1.0 / 3.0)
    return np.asarray(0.4 * mass * radius**2 * np.eye(3))


def _said(inertia: Float64[np.ndarray, "3 3"]) -> dict[str, float]:
    return {name: float(inertia[row, column]) for name, row, column in _ENTRIES}


def _number(element: ET.Element | None, name: str) -> float:
    """NaN where it is none."""
    try:
        return float("0" if element is None else element.get(name, "0"))
    except ValueError:
        return float("nan")
