"""Does a plan do what it should, and nothing else?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from trueup.errors import NameMismatch, NoPlan
from trueup.record.limits import JointLimits
from trueup.record.plan import Plan
from trueup.record.scene import Scene

# Rounding, relative to a limit; second differences of positions at 1 kHz lose six digits more.
_TOLERANCE = 1e-6
_STILL = 1e-9


@dataclass(frozen=True)
class Violation:
    """One thing that is wrong with a plan.

    Attributes:
        kind: `moves`, `position`, `velocity`, `acceleration`, `inconsistent`, `rest`, or `collision`.
        what: one sentence with numbers.
        time_s: where in the plan [s].
    """

    kind: str
    what: str
    time_s: float


def check_plan(plan: Plan, limits: JointLimits, scene: Scene | None = None) -> tuple[Violation, ...]:
    """All that is wrong with a plan, sample by sample.

    Limits are held against what the plan says and against the differences of its positions, so that a velocity that
    is not the derivative of its position cannot pass.

    Args:
        plan: any plan.
        limits: what the robot can do.
        scene: the obstacles; without it, collisions are not looked for.

    Raises:
        NameMismatch: the plan is for other joints.
    """
    for joints in (limits.joints, *([scene.joints] if scene else [])):
        if joints != plan.joints:
            raise NameMismatch("the plan is for another robot", left=plan.joints, right=joints, left_name="plan has")
    found = [*_still(plan), *_limits(plan, limits), *_rest(plan)]
    if scene is not None:
        row = scene.first_collision(plan.position)
        if row is not None:
            touching = scene.touching(plan.position[row])
            found.append(Violation("collision", f"{touching} touch", float(plan.time_s[row])))
    return tuple(found)


def require_valid(plan: Plan, limits: JointLimits, scene: Scene | None = None) -> Plan:
    """The plan, if nothing is wrong with it.

    Raises:
        NoPlan: something is wrong.
    """
    found = check_plan(plan, limits, scene)
    if found:
        more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
        raise NoPlan(f"plan {plan.id!r} is refused: {found[0].what} at {found[0].time_s:.3f} s{more}")
    return plan


def _still(plan: Plan) -> list[Violation]:
    found = []
    for column, joint in enumerate(plan.joints):
        if joint in plan.moving:
            continue
        offset = np.abs(plan.position[:, column] - plan.position[0, column])
        # A velocity beside a constant position counts, too: a controller would follow it.
        drift = np.maximum(offset, np.abs(plan.velocity[:, column]))
        if drift.max() > _STILL:
            row = int(np.argmax(drift))
            what = f"joint {joint!r} moves by {offset.max():.2g}, and must not"
            found.append(Violation("moves", what, float(plan.time_s[row])))
    return found


def _limits(plan: Plan, limits: JointLimits) -> list[Violation]:
    step = plan.timestep_s
    slack = _TOLERANCE * (limits.high - limits.low)
    below, above = limits.low - slack - plan.position, plan.position - limits.high - slack
    found = _worst(plan, "position", np.maximum(below, above), np.zeros_like(limits.low))
    first = np.diff(plan.position, axis=0) / step
    second = np.diff(plan.position, n=2, axis=0) / step**2
    rounding = 16 * np.finfo(float).eps * np.abs(plan.position).max() / step**2
    for kind, values in (("velocity", plan.velocity), ("velocity", first)):
        found += _worst(plan, kind, np.abs(values), limits.velocity * (1 + _TOLERANCE))
    for kind, values in (("acceleration", plan.acceleration), ("acceleration", second)):
        found += _worst(plan, kind, np.abs(values), limits.acceleration * (1 + _TOLERANCE) + rounding)
    # A trapezoid of velocities is as wrong as the velocity is curved: at most by a jump of the acceleration.
    gap = np.abs(first - (plan.velocity[1:] + plan.velocity[:-1]) / 2)
    return found + _worst(plan, "inconsistent", gap, limits.acceleration * step * 0.5 + rounding * step)


def _worst(
    plan: Plan, kind: str, values: Float64[np.ndarray, "N J"], limit: Float64[np.ndarray, "J"]
) -> list[Violation]:
    over = values - limit
    if not values.size or over.max() <= 0:
        return []
    row, column = np.unravel_index(int(np.argmax(over)), over.shape)
    joint, time_s = plan.joints[int(column)], float(plan.time_s[int(row)])
    words = {
        "position": f"joint {joint!r} is {values[row, column]:.4g} beyond its range",
        "inconsistent": f"the velocity of joint {joint!r} is not the derivative of its position",
    }
    default = f"joint {joint!r} has {kind} {values[row, column]:.4g}, its limit is {limit[column]:.4g}"
    return [Violation(kind, words.get(kind, default), time_s)]


def _rest(plan: Plan) -> list[Violation]:
    found = []
    before = plan.time_s <= plan.start_s + 1e-9
    after = plan.time_s >= plan.end_s - 1e-9
    for name, rows, pose in (("before", before, plan.position[0]), ("after", after, plan.position[-1])):
        restless = np.maximum(np.abs(plan.position - pose), np.abs(plan.velocity)).max(axis=1)
        restless = np.where(rows, restless, 0.0)
        if restless.max() > _STILL:
            row = int(np.argmax(restless))
            found.append(Violation("rest", f"the robot does not rest {name} the motion", float(plan.time_s[row])))
    return found
