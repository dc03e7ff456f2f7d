"""What a fit can change in a model: one `Quantity` per kind of number."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from trueup.core.parameters import Parameter, SearchRange
from trueup.core.units import joint_unit
from trueup.identify.candidate import Candidate, JointSize, Nominal

# Where a part of the gap comes from; the order in which attribution takes them away.
Cause = Literal["delay", "gains", "friction", "gravity", "inertia"]

# Bounds of what is sized: a share of the start, and a multiple of what is large.
_LEAST, _MOST = 1e-3, 30.0


def motion_target(motion: str, joint: str) -> str:
    """The target of what belongs to one joint in one motion."""
    return f"{motion}:{joint}"


def split_motion_target(target: str) -> tuple[str, str]:
    """The motion and the joint of such a target: no id of a motion has a colon, names of joints may."""
    motion, _, joint = target.partition(":")
    return motion, joint


@dataclass(frozen=True)
class Quantity:
    """A kind of number that a fit can change.

    Attributes:
        name: as in `fit:` of the configuration and before the bracket of a parameter's name.
        label: what it is, in the report.
        unit: of the value for a hinge; `parameter` gives a slide its own.
        of: whether there is one per joint, one per body, one per robot, or one per joint of each motion (what differs
            from recording to recording, and is no part of the model).
        cause: the part of the gap that it explains.
        read: the nominal value for a target; None if the model has no such number there.
        write: sets the value for a target.
        excite: what kind of motion shows it; `{target}` is filled in.
        search: its default start, bounds, scale and prior.
        needs: what a joint must have, or a body must be, to be read, in words.
        addable: whether a start from the user puts it into a model that has none.
        brakes: whether more of it makes a joint slower, whatever else is the case.
        relative: whether it is a change of what the model says, so that a fitted model says it no longer.
        sized: what is large for a joint of this size [its unit]; start, bounds and scale follow it. None where the
            catalogue's own hold for robots of any size.
        optional: whether a robot may have none of it, as of friction: the search may go down to next to nothing.
    """

    name: str
    label: str
    unit: str
    of: Literal["joint", "body", "robot", "motion"]
    cause: Cause
    read: Callable[[Nominal, str], float | None]
    write: Callable[[Candidate, str, float], None]
    excite: str
    search: SearchRange
    needs: str = ""
    addable: bool = False
    brakes: bool = False
    relative: bool = False
    sized: Callable[[JointSize], float] | None = None
    optional: bool = False

    def targets(self, nominal: Nominal, motions: Sequence[str] = ()) -> tuple[str, ...]:
        """Names of all joints, bodies or joints in motions, whether the model has the number there or not."""
        match self.of:
            case "motion":
                return tuple(
                    motion_target(motion, joint) for motion in motions for joint in nominal.robot.scored_joints
                )
            case "joint":
                return nominal.robot.joint_names
            case "body":
                return nominal.bodies
            case _:
                return ("",)

    def holders(self, nominal: Nominal, motions: Sequence[str] = ()) -> tuple[str, ...]:
        """Those targets whose number the model has: what it can be fitted for."""
        return tuple(name for name in self.targets(nominal, motions) if self.read(nominal, name) is not None)

    def places(self, nominal: Nominal, target: str) -> tuple[str, ...]:
        """What a parameter is written to: its target; all of them for one that the whole robot shares."""
        if target:
            return (target,)
        return (() if self.addable else self.holders(nominal)) or self.targets(nominal)

    def parameter(self, nominal: Nominal, target: str, *, start: float | None = None) -> Parameter:
        """The parameter for one target, or for all together (empty).

        Args:
            nominal: the model as it came; of several targets, the first one says where to start, and the parameter
                has no nominal value if they differ.
            target: one of `targets`, or empty.
            start: where to start if the model has no such number.
        """
        places = self.places(nominal, target)
        said = self.read(nominal, places[0])
        alike = all(self.read(nominal, place) == said for place in places)
        search = self._search(nominal, places[0])
        value = said if said is not None else start or 0.0
        low, high = search.low, search.high
        if search.transform == "log":
            value = max(value, search.start, low)
            # A model may say much more than a joint of this size can have.
            least = min(value, search.start) if self.sized is not None and search.start > 0 else value
            low, high = max(low, least / search.span), min(high, value * search.span)
        if said is not None and (said > 0.0 or search.transform == "linear"):
            low, high = min(low, said), max(high, said)
        return Parameter(
            name=f"{self.name}[{target}]" if target else self.name,
            value=value,
            unit=self._unit(nominal, places),
            low=low,
            high=high,
            transform=search.transform,
            scale=search.scale,
            prior_std=search.prior_std,
            nominal=said if alike else None,
        )

    def _search(self, nominal: Nominal, place: str) -> SearchRange:
        """The range for a joint of its size: a start of a few percent of what is large, and room beyond it."""
        search = self.search
        if self.sized is None or not place:
            return search
        large = self.sized(nominal.size(split_motion_target(place)[1] if self.of == "motion" else place))
        if search.transform == "log":
            start = search.start * large
            return replace(search, start=start, low=_LEAST * start, high=_MOST * large, span=1.0 / _LEAST)
        return replace(search, low=-_MOST * large, high=_MOST * large, scale=search.scale * large)

    def _unit(self, nominal: Nominal, places: Sequence[str]) -> str:
        if self.of not in ("joint", "motion"):
            return self.unit
        joints = [split_motion_target(place)[1] if self.of == "motion" else place for place in places]
        units = {joint_unit(self.unit, nominal.length_unit(joint)) for joint in joints}
        return units.pop() if len(units) == 1 else "mixed"
