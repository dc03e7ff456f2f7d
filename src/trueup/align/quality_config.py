"""Thresholds of the quality checks, each with what it means physically."""

from __future__ import annotations

from dataclasses import dataclass

from trueup.core.units import si_factor

# One radian of a joint in other units: a lever of 0.1 m, and a ratio that spans about two radians.
_PER_RADIAN = {"rad": 1.0, "rad/s": 1.0, "m": 0.1, "m/s": 0.1, "1": 0.5, "1/s": 0.5}


@dataclass(frozen=True)
class QualityConfig:
    """What counts as suspicious.

    Angles hold for revolute joints; for a position in m one radian stands for 0.1 m, for a ratio (a gripper in 0..1)
    for 0.5.
    """

    jitter_share: float = 0.25
    """A step of the clock that differs from the median by more than this share is jitter (a note)."""
    jitter_s: float = 0.01
    """A step that is longer than the period by no more than this is jitter, too: operating systems that do not run in
    real time wake a logger late by some milliseconds, and no robot turns unseen in them."""
    gap_steps: float = 3.0
    """A longer step is a gap if it lasts more than this many periods: at least two samples are missing."""
    gap_share: float = 0.1
    """A gap in which a joint can have left the straight line between its ends by this share of its travel in the
    recording is a warning: motion that nobody saw."""
    gap_rad: float = 0.03
    """So is one in which it can have done so by this much, however far it travels."""
    gap_least_rad: float = 0.01
    """Less than this does no harm: a joint that hardly moves has a small travel."""
    clock_share: float = 0.02
    """Command and measurement of equal row count whose durations differ by more than this have wrong stamps."""

    repeated_share: float = 0.5
    """A signal of which at least this share of the changes is followed by an unchanged row is fed more slowly."""
    repeated_changes: int = 30
    """Fewer changes of at least two encoder steps than this prove nothing about the feed."""

    nan_warning_share: float = 0.01
    """More missing samples than this are a warning."""
    nan_warning_s: float = 0.1
    """A longer run of missing samples is a warning."""
    spike_rad: float = 0.05
    """Smallest jump there and back within three samples that is a spike: well above encoder noise."""
    spike_factor: float = 4.0
    """A spike's jumps also exceed this many times the 99th percentile of the joint's steps."""

    frozen_s: float = 0.5
    """A position must be unchanged for longer than this to be called frozen."""
    frozen_travel_rad: float = 0.2
    """It is frozen if the command, or the integrated velocity, went this far meanwhile: far beyond stiction (0.1)."""
    response_s: float = 0.2
    """Time in which a working joint has answered to a step of its command; earlier changes are not held against it."""

    still_rad: float = 0.004
    """A joint that moved less than this (or two and a half encoder steps) in `still_s` stands."""
    still_s: float = 0.2
    """Window for standing: longer than the turning point of a fast motion."""
    push_rad: float = 0.12
    """A command this far (7 deg) from a standing joint pushes it; cheap servos stand 1 to 5 deg off by stiction."""
    push_factor: float = 2.0
    """It must also be this many times the lower quartile of the joint's own standing errors: soft joints sag more."""
    load_factor: float = 4.0
    """While pushed the load must exceed this many times its 95th percentile elsewhere: friction at most doubles it."""
    unanswered_rad: float = 0.05
    """If the command went this far while the joint stood, it is blocked; else it may only carry too much."""
    astray_rad: float = 0.3
    """A standing error this large (17 deg) is a warning whatever the reason, with the load far above the usual."""
    end_of_travel_rad: float = 0.03
    """A joint blocked this close to the end of its travel hit a limit; stops give way by 1 to 2 deg."""

    saturated_share: float = 0.98
    """A torque above this share of its limit is saturated: drives regulate to about 2 %."""
    saturated_s: float = 0.1
    """For at least this long: shorter peaks are noise of the estimate."""
    saturated_warning_share: float = 0.01
    """Saturation in more than this share of the recording is a warning."""
    limit_rad: float = 0.01
    """Distance to a known position limit within which a joint is at it."""

    failed_rad: float = 0.1
    """Position RMSE below which no execution is called failed."""
    failed_share: float = 0.5
    """Position MSE above this share of the commanded motion's variance: the robot did something else."""


def per_radian(unit: str) -> float:
    """How much of `unit` stands for one radian (or rad/s) in the thresholds; 1 for units of something else.

    Raises:
        UnitError: the unit is unknown.
    """
    si, factor = si_factor(unit)
    return _PER_RADIAN.get(si, 1.0) / factor
