"""How a simulated robot differs from motion to motion: what it carries, and how its position gains were set."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from trueup.core.episode import EpisodeMeta
from trueup.errors import ConfigError
from trueup.robots.spec import RobotSpec


@dataclass(frozen=True, order=True)
class Setup:
    """The robot in one motion.

    Attributes:
        payload_kg: what it carries in simulations [kg].
        kp_factor: position gain of every drive per that of the robot's description.
    """

    payload_kg: float = 0.0
    kp_factor: float = 1.0


AS_DESCRIBED = Setup()


def setup_of(robot: RobotSpec, meta: EpisodeMeta) -> Setup:
    """The robot in one motion; see `refuse_unknown_gains` for what this leaves alone."""
    stated, own = robot.controller.kp_setting, meta.kp_setting
    return Setup(robot.carried_kg(meta.payload_kg), 1.0 if stated is None or own is None else own / stated)


def refuse_unknown_gains(robot: RobotSpec, metas: Iterable[EpisodeMeta]) -> None:
    """Refuse motions with several settings of the position gain where nobody has said at which of them kp holds.

    Robots whose commands go around the position gains of their drives may have them as they like.

    Raises:
        ConfigError: there are several.
    """
    if robot.controller.kp_setting is not None or not robot.controller.has_kp:
        return
    settings = sorted({meta.kp_setting for meta in metas if meta.kp_setting is not None})
    if len(settings) > 1:
        raise ConfigError(
            f"robot {robot.name!r}: the position gains of the drives were set differently from motion to motion",
            got="kp_setting " + ", ".join(f"{setting:g}" for setting in settings),
            expected="one, or robot.yaml says at which of them its kp (or its model's) holds",
            hint="Write the setting at which kp holds into robot.yaml: "
            f"controller: {{kp_setting: {settings[len(settings) // 2]:g}}}, for instance.",
        )


def refuse_other_gains(robot: RobotSpec, metas: Iterable[EpisodeMeta], *, what: str) -> None:
    """Refuse motions that were recorded with other position gains than the description has.

    Args:
        robot: its description.
        metas: of the motions.
        what: does not know of other gains.

    Raises:
        ConfigError: there are some, or see `refuse_unknown_gains`.
    """
    metas = list(metas)
    refuse_unknown_gains(robot, metas)
    others = sorted({meta.kp_setting for meta in metas if meta.kp_setting and setup_of(robot, meta).kp_factor != 1.0})
    if others:
        raise ConfigError(
            f"{what} simulates every motion with the same position gains",
            got="kp_setting " + ", ".join(f"{setting:g}" for setting in others),
            expected=f"motions recorded at controller.kp_setting, {robot.controller.kp_setting:g}",
            hint="Leave the others out, or split the recordings by setting.",
        )


def with_kp_factor(robot: RobotSpec, factor: float) -> RobotSpec:
    """The description with every kp of its controller times a factor."""
    if factor == 1.0:
        return robot
    own = {
        name: gains if gains.kp is None else replace(gains, kp=factor * gains.kp)
        for name, gains in robot.controller.per_joint.items()
    }
    return replace(robot, controller=replace(robot.controller, kp=factor * robot.controller.kp, per_joint=own))
