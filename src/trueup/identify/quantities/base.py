"""What a fit can change in a model: one `Quantity` per kind of number."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from trueup.core.parameters import Parameter
from trueup.identify.candidate import Candidate, Nominal

# Where a part of the gap comes from; the order in which attribution takes them away.
Cause = Literal["delay", "gains", "friction", "gravity", "inertia"]


def motion_target(motion: str, joint: str) -> str:
    """The target of what belongs to one joint in one motion."""
    return f"{motion}:{joint}"


@dataclass(frozen=True)
class Quantity:
    """A kind of number that a fit can change.

    Attributes:
        name: as in `fit:` of the configuration and before the bracket of a parameter's name.
        unit: of the value, for a hinge.
        of: whether there is one per joint, one per body, one per robot, or one per joint of each motion (what differs
            from recording to recording, and is no part of the model).
        cause: the part of the gap that it explains.
        read: the nominal value for a target.
        write: sets the value for a target.
        transform: `log` for what is positive by nature.
        start: where the fit starts if the model says zero.
        low: smallest lower bound.
        high: largest upper bound.
        span: bounds reach from nominal / span to nominal * span, `log` only.
        scale: what counts as a large change, `linear` only.
        prior_std: width of the default prior, in z.
        excite: what kind of motion shows it; `{target}` is filled in.
        changes_controller: whether it can be fitted only for joints with a servo.
    """

    name: str
    unit: str
    of: Literal["joint", "body", "robot", "motion"]
    cause: Cause
    read: Callable[[Nominal, str], float]
    write: Callable[[Candidate, str, float], None]
    excite: str
    transform: Literal["linear", "log"] = "linear"
    start: float = 0.0
    low: float = 1e-9
    high: float = 1e9
    span: float = 100.0
    scale: float = 1.0
    prior_std: float = 2.0
    changes_controller: bool = False

    def targets(self, nominal: Nominal, motions: Sequence[str] = ()) -> tuple[str, ...]:
        """Names of what it can be fitted for."""
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

    def places(self, nominal: Nominal, target: str) -> tuple[str, ...]:
        """What a parameter is written to: its target; all of them for one that the whole robot shares."""
        return (target,) if target else self.targets(nominal)

    def parameter(self, nominal: Nominal, target: str) -> Parameter:
        """The parameter for one target, or for all together (empty), started from what the model says of the first."""
        value = self.read(nominal, self.places(nominal, target)[0])
        low, high = self.low, self.high
        if self.transform == "log":
            value = max(value, self.start, low)
            low, high = max(low, value / self.span), min(high, value * self.span)
        value = min(max(value, low), high)
        name = f"{self.name}[{target}]" if target else self.name
        return Parameter(
            name=name,
            value=value,
            unit=self.unit,
            low=low,
            high=high,
            transform=self.transform,
            scale=self.scale,
            prior_std=self.prior_std,
        )
