"""Motions made by hand: tracks of keyframes for joints, and for sites of the robot, as animators draw them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float64

from trueup.errors import ConfigError
from trueup.record.motion import MotionSettings, as_plan
from trueup.record.plan import Plan
from trueup.record.posing import SiteKinematics
from trueup.record.profile import ClockSettings, Profile, averaged
from trueup.record.scene import Scene

# Inverse kinematics is solved so often; in between, joints follow a cubic spline.
_SOLVED_EVERY_S = 0.02
# Keyframes are smoothed over this time: their accelerations jump.
_SMOOTHED_S = 0.06
# A motion is slowed down to the limits so often: smoothing makes its speed no exact function of time.
_SLOWED = 8


@dataclass(frozen=True)
class Animation:
    """A motion from home to home through keyframes, smooth and without overshoot in between (PCHIP).

    Attributes:
        duration_s: from home to home [s].
        joints: joint -> keyframes (time [s], position [rad or m]).
        sites: site -> keyframes (time [s], x, y, z [m], and a rotation vector [rad]), relative to where it is at home,
            along the axes of the world. Other joints than those that lead the sites follow their own tracks.

    Raises:
        ConfigError: no track, or keyframes that are out of order.
    """

    duration_s: float
    joints: Mapping[str, tuple[tuple[float, float], ...]] = field(default_factory=dict)
    sites: Mapping[str, tuple[tuple[float, float, float, float, float, float, float], ...]] = field(
        default_factory=dict
    )

    def __post_init__(self) -> None:
        """Refuse what cannot be played."""
        if not self.joints and not self.sites:
            raise ConfigError("an animation needs joints or sites that move")
        for name, frames in {**self.joints, **self.sites}.items():
            wrong = [frame for frame in frames if not np.isfinite(frame).all()]
            if wrong:
                raise ConfigError(f"a keyframe of {name!r} is not finite", got=list(wrong[0]), expected="numbers")
            times = [0.0, *(frame[0] for frame in frames), self.duration_s]
            if not (np.diff(times) > 0).all():
                raise ConfigError(
                    f"keyframes of {name!r} are not in order",
                    got=[frame[0] for frame in frames],
                    expected=f"increasing times between 0 and {self.duration_s:g} s",
                )


def animated(
    scene: Scene,
    animation: Animation,
    *,
    speed: float = 1.0,
    amplitude: float = 1.0,
    settings: MotionSettings | None = None,
    id: str = "",
) -> Plan:
    """A plan of an animation.

    Args:
        scene: the robot; its home is where the animation begins and ends.
        animation: what to do.
        speed: as many times as fast as its keyframes say, less where a limit would be broken; the plan's details say
            what became of it.
        amplitude: as many times as far from home.
        settings: clock.
        id: of the plan.

    Raises:
        ConfigError: an unknown site, or a speed or an amplitude that is not positive.
        NameMismatch: an unknown joint.
        NoPlan: a position limit would be broken, a closed chain would open, or something is in the way.
    """
    if not (0 < speed < np.inf and 0 < amplitude < np.inf):
        raise ConfigError("speed and amplitude of an animation must be positive", got=(speed, amplitude))
    settings = settings or MotionSettings()
    clock = settings.clock
    moving = scene.joints if animation.sites or scene.model.neq else tuple(animation.joints)
    scene.limits.columns(moving)
    for _ in range(_SLOWED):
        profile = _played(scene, animation, speed, amplitude, clock)
        usage = profile.usage(scene.limits, clock.timestep_s)
        if usage <= 1:
            break
        speed /= 1.001 * usage
    details = {"speed": speed, "amplitude": amplitude}
    return as_plan(profile, scene, clock, kind="animation", moving=moving, id=id, details=details)


def _played(scene: Scene, animation: Animation, speed: float, amplitude: float, clock: ClockSettings) -> Profile:
    from scipy.interpolate import make_interp_spline

    duration_s = animation.duration_s / speed
    count = max(2, round(duration_s * clock.rate_hz))
    time_s = np.arange(count + 1) / count
    if animation.sites or scene.model.neq:
        solved = np.linspace(0, 1, max(8, round(duration_s / _SOLVED_EVERY_S)) + 1)
        poses = _led(scene, animation, solved, amplitude)
        position = make_interp_spline(solved, poses, k=3)(time_s)
        still = np.ptp(poses, axis=0) == 0
        position[:, still] = scene.home[still]
    else:
        position = np.tile(scene.home, (count + 1, 1))
        for name, column in zip(animation.joints, scene.limits.columns(tuple(animation.joints)), strict=True):
            position[:, column] += amplitude * _offsets(animation, name, scene.home[column])(time_s)
    nothing = np.zeros_like(position)
    steps = max(1, round(_SMOOTHED_S / speed * clock.rate_hz))
    # Averages of averages have velocities and accelerations of their own: differences of positions.
    once = averaged(Profile(position, nothing, nothing), steps, clock.timestep_s)
    return averaged(once, steps, clock.timestep_s)


def _led(
    scene: Scene, animation: Animation, where: Float64[np.ndarray, "K"], amplitude: float
) -> Float64[np.ndarray, "K J"]:
    """Poses at shares of the duration, by inverse kinematics."""
    from scipy.spatial.transform import Rotation

    solver = SiteKinematics(scene, tuple(animation.sites), turned=True)
    targets = {}
    for name, (position, rotation) in solver.poses(scene.home).items():
        offset = amplitude * _track(animation, np.array(animation.sites[name]), np.zeros(6))(where)
        targets[name] = np.tile(np.eye(4), (len(where), 1, 1))
        targets[name][:, :3, :3] = Rotation.from_rotvec(offset[:, 3:]).as_matrix() @ rotation
        targets[name][:, :3, 3] = position + offset[:, :3]
    home = dict(zip(scene.joints, scene.home, strict=True))
    hints = {
        name: home[name] + amplitude * np.asarray(_offsets(animation, name, home[name])(where))
        for name in animation.joints
    }
    poses = solver.follow(scene.home, targets, hints)
    poses[[0, -1]] = scene.home
    return poses


def _offsets(animation: Animation, joint: str, home: float) -> Any:
    """How far a joint is from home, over the share of the duration."""
    frames = np.array(animation.joints[joint])
    return _track(animation, frames - [0.0, home], np.zeros(1))


def _track(animation: Animation, frames: Float64[np.ndarray, "K D"], home: Float64[np.ndarray, "M"]) -> Any:
    from scipy.interpolate import PchipInterpolator

    times = np.concatenate([[0.0], frames[:, 0], [animation.duration_s]]) / animation.duration_s
    values = np.concatenate([home[None], frames[:, 1:], home[None]])
    return PchipInterpolator(times, values if len(home) > 1 else values[:, 0])
