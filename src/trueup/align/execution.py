"""Executions that failed: the robot did something else than it was asked to."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueup.align.quality_config import QualityConfig, per_radian
from trueup.align.resample import resample
from trueup.align.tracks import tracks
from trueup.core.episode import Episode, Flag
from trueup.errors import DataError, MissingSignal


def position_mse(episode: Episode, *, run: str | None = None) -> float:
    """Mean square of the position residual over joints and time [rad^2].

    Joints in other units count as `QualityConfig` says (0.1 m, half a range for one radian).

    Args:
        episode: measured against its command, held between its stamps.
        run: label of a simulated run to compare with instead.

    Raises:
        MissingSignal: no joint has both positions, or there is no such run.
        DataError: the run covers none of the measured time.
    """
    if run is None:
        errors = [track.position - track.command for track in tracks(episode) if track.command is not None]
        if not errors:
            raise MissingSignal(f"episode {episode.id!r} commands no positions to follow")
        return float(np.mean(np.square(errors)))
    simulated = episode.run(run)
    measured = episode.measured
    joints = [name for name in measured.joints if name in simulated.joints]
    if not joints or "position" not in simulated or "position" not in measured:
        raise MissingSignal(f"no joint of run {run!r} has measured and simulated positions", available=measured.joints)
    simulated = resample(simulated.select(joints), measured.time_s, clip=True)
    rows = np.searchsorted(measured.time_s, simulated.time_s)
    radian = np.array(
        [[per_radian(unit) for unit in one.select(joints).units["position"]] for one in (measured, simulated)]
    )
    residual = measured.select(joints)["position"][rows] / radian[0] - simulated["position"] / radian[1]
    known = residual[np.isfinite(residual)]
    if not known.size:
        raise DataError(f"episode {episode.id!r} and run {run!r} have no finite positions in common")
    return float(np.mean(known**2))


def robust_threshold(values: Sequence[float]) -> float:
    """MSE above which an episode is an outlier among its like.

    Errors of good executions spread over a factor, not over a sum, so the spread is taken of their logarithms:
    median plus six scaled median absolute deviations, and at least four times the median, so that a set of
    nearly equal errors loses nobody. Half of the episodes may be bad.

    Raises:
        DataError: fewer than five values, or one is not finite.
    """
    errors = np.asarray(values, dtype=np.float64)
    if errors.size < 5 or not np.all(np.isfinite(errors)):
        raise DataError("a threshold from the data needs five finite errors", got=f"{errors.size} values")
    logs = np.log(np.maximum(errors, 1e-12))
    center = float(np.median(logs))
    spread = 1.4826 * float(np.median(np.abs(logs - center)))
    return float(np.exp(center + max(6.0 * spread, np.log(4.0))))


def failed_execution(episode: Episode, config: QualityConfig) -> Flag | None:
    """The flag `failed_execution` if the position MSE is too large, as in the LSTM thesis, 4.2.

    Too large is more than half of the commanded motion's variance (a robot that never moved has at least all of it),
    and an RMSE of more than 0.1 rad. A warning, but where torques are commanded a note: they drive the robot, and its
    path is only a wish.

    Args:
        episode: with commanded positions.
        config: where those two numbers are.

    Raises:
        MissingSignal: there are no commanded positions to compare with.
    """
    error = position_mse(episode)
    asked = float(np.mean([np.var(track.command) for track in tracks(episode) if track.command is not None]))
    threshold = max(config.failed_rad**2, config.failed_share * asked)
    if error <= threshold:
        return None
    return Flag(
        kind="failed_execution",
        signal="position",
        detail=(
            f"position MSE against the command is {error:.3g} rad^2 (RMSE {error**0.5:.3g} rad), above {threshold:.3g}"
        ),
        severity="note" if episode.command is not None and "torque" in episode.command else "warning",
        start_s=float(episode.measured.time_s[0]),
        end_s=float(episode.measured.time_s[-1]),
    )
