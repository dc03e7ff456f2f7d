"""How far a real whole body is from the simulated one on the same motion."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float64

from trueup.errors import DataError
from trueup.measure import robustness, smoothness, trajectory_consistency
from trueup.whole_body.driving import Trajectory

# Figure -> unit; the smaller the better. Those of GapONet's Table 2 are of the arms' joints, of the base's place on the
# floor and of its two tilts.
UNITS: Mapping[str, str] = {
    "drift_mean": "m",
    "drift_end": "m",
    "tilt_max": "deg",
    "tilt_rms": "deg",
    "arms_mae": "rad",
    "arms_max": "rad",
    **{
        f"{part}_{metric}": f"{unit}/s^2" if metric != "robustness" else unit
        for part, unit in (("arms", "rad"), ("base", "m"), ("tilt", "rad"))
        for metric in ("trajectory_consistency", "smoothness", "robustness")
    },
}


def body_gap(real: Trajectory, simulated: Trajectory) -> dict[str, float]:
    """The figures of `UNITS`; all NaN if the real body fell, which is to be counted.

    `drift_mean` and `drift_end`: how far the middle of the axle is from where the simulated one is, on the floor, if
    both begin the motion in one place (GapONet, A.6.2: a fixed start pose and heading). `tilt_max` and `tilt_rms`: the
    angle between the two uprights, each seen in its own heading. `arms_mae` and `arms_max`: of the joints of the arms.

    Args:
        real: what the real body did.
        simulated: what the simulated one did on the same motion.

    Raises:
        DataError: the simulated body fell, or the motions are not the same.
    """
    if simulated.fallen_s is not None:
        raise DataError("the simulated body fell: nothing can be compared with it", got=f"{simulated.fallen_s:g} s")
    if real.fallen_s is not None:
        return dict.fromkeys(UNITS, np.nan)
    if real.arms.shape != simulated.arms.shape:
        raise DataError("these are trajectories of two motions", got=real.arms.shape, expected=simulated.arms.shape)
    drift = np.linalg.norm(real.way - simulated.way, axis=1)
    tilt = np.degrees(np.linalg.norm(real.tilt - simulated.tilt, axis=1))
    apart = np.abs(real.arms - simulated.arms)
    figures = {
        "drift_mean": float(drift.mean()),
        "drift_end": float(drift[-1]),
        "tilt_max": float(tilt.max()),
        "tilt_rms": float(np.sqrt(np.square(tilt).mean())),
        "arms_mae": float(apart.mean()),
        "arms_max": float(apart.max()),
    }
    for part, own, other in (
        ("arms", real.arms, simulated.arms),
        ("base", real.way, simulated.way),
        ("tilt", real.tilt, simulated.tilt),
    ):
        figures |= _table_2(part, own, other, real.time_s)
    return figures


def _table_2(
    part: str, own: Float64[np.ndarray, "T C"], other: Float64[np.ndarray, "T C"], time_s: Float64[np.ndarray, "T"]
) -> dict[str, float]:
    return {
        f"{part}_trajectory_consistency": float(trajectory_consistency(own, other, time_s).mean()),
        f"{part}_smoothness": float(smoothness(own, other, time_s).mean()),
        f"{part}_robustness": float(robustness(own, other).mean()),
    }
