"""What is suspicious in an episode, as flags."""

from __future__ import annotations

from collections.abc import Mapping

from trueup.align.blocked import blocked_flags
from trueup.align.execution import failed_execution
from trueup.align.quality_clock import clock_flags, clock_mismatch_flags, repeated_sample_flags
from trueup.align.quality_config import QualityConfig
from trueup.align.quality_signal import frozen_flags, nan_flags, position_limit_flags, saturation_flags, spike_flags
from trueup.align.tracks import tracks
from trueup.core.episode import Episode, Flag

KINDS = (
    "gap",
    "jittering_stamps",
    "clock_mismatch",
    "repeated_samples",
    "nan",
    "spike",
    "frozen",
    "limit_hit",
    "blocked",
    "saturation",
    "position_limit",
    "failed_execution",
)


def check_quality(
    episode: Episode,
    *,
    limits: Mapping[str, tuple[float, float] | None] | None = None,
    torque_limits: Mapping[str, float] | None = None,
    config: QualityConfig | None = None,
) -> tuple[Flag, ...]:
    """Everything suspicious in an episode: the flags that its importer set, and those of `KINDS` found here.

    Looks at one episode alone and reads the log's own units. A `warning` says that the data are wrong
    (`Flag.broken`), or that the robot did something that a model without contacts and limits cannot do; all else is a
    `note`. Joints that are driven by torques are not expected to follow anything.

    Args:
        episode: measured series, and the command if there is one.
        limits: joint -> lowest and highest position, in the unit of the log; None if unknown. Without them limits
            are found by the load with which a joint stops at the end of its travel.
        torque_limits: joint -> torque limit, in the unit of the log.
        config: thresholds.

    Returns:
        Flags, ordered by kind and joint; running it again on an episode that carries them gives the same.
    """
    config = config or QualityConfig()
    measured, command = episode.measured, episode.command
    flags = [flag for flag in episode.meta.flags if flag.kind not in KINDS]
    seen = tracks(episode)
    flags += clock_flags(measured, seen, config)
    flags += clock_mismatch_flags(episode, config)
    flags += repeated_sample_flags(measured, config)
    flags += nan_flags(measured, config)
    if command is not None:
        flags += nan_flags(command, config, name="command")
    followed = False
    for track in seen:
        followed = followed or track.command is not None
        blocked = blocked_flags(track, config)
        flags += blocked
        flags += spike_flags(track, config)
        # A blocked joint stands still, too, but its encoder is not to blame.
        if not any(flag.severity == "warning" for flag in blocked):
            flags += frozen_flags(track, config)
        flags += position_limit_flags(track, limits or {}, config)
    flags += saturation_flags(measured, torque_limits, command, config)
    failed = failed_execution(episode, config) if followed else None
    return tuple(flags if failed is None else [*flags, failed])
