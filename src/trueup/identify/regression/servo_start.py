"""Start values for fitting servos: gains, friction and armature by one small least-squares problem per joint.

Along the measured motion, what a servo does is linear in its gains, and what it moves is known from the masses: no
simulation is needed, and nothing diverges. From values that are several times too large or too small, a search over
simulations may end in a place that is not the best one.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Bool, Float64
from scipy.optimize import lsq_linear

from trueup.core.episode import Episode
from trueup.core.hold import held_rows
from trueup.errors import DataError
from trueup.identify.regression.smoothing import smooth

_DELAYS_S = np.concatenate([np.arange(-0.02, 0.06, 0.004), np.arange(0.06, 0.2, 0.01)])
_CUTOFFS_HZ = (6.0, 12.0, 25.0)
# A joint that is slower than this share of its rms speed may stick, where friction is anything.
_STICKS = 0.1
_FEWEST_ROWS = 50
_SATURATED = 0.95
# So many samples count as one, and a gain is seen if it is so many standard deviations from none.
_MEMORY, _SEEN = 25.0, 8.0


@dataclass(frozen=True)
class ServoStart:
    """Where to start; numbers of a joint that could not be regressed are missing.

    Attributes:
        kp: joint -> torque per position error [Nm/rad or N/m], of position servos.
        kv: joint -> torque per velocity of a position servo, its viscous friction included, or per velocity error of a
            velocity servo [Nm s/rad or N s/m].
        damping: joint -> viscous friction of velocity servos [Nm s/rad or N s/m].
        frictionloss: joint -> [Nm or N], >= 0.
        armature: joint -> [kg m^2 or kg], >= 0.
        delay_s: joint -> how much later commands act [s].
    """

    kp: Mapping[str, float]
    kv: Mapping[str, float]
    damping: Mapping[str, float]
    frictionloss: Mapping[str, float]
    armature: Mapping[str, float]
    delay_s: Mapping[str, float]


def servo_start(
    episodes: Iterable[Episode],
    model: mujoco.MjModel,
    *,
    joints: Sequence[str],
    signal: str,
    gains: Mapping[str, float],
    limits: Mapping[str, float],
    kp_factors: Sequence[float] | None = None,
) -> ServoStart:
    """Regress the error of the servo on what makes it.

    For one joint, with u the commanded position, d its delay, and t the torque that moves the masses (inverse
    dynamics of the bodies, without rotors and friction):

        u(time - d) - q = (t + kv dq + friction sign(dq) + armature ddq - offset) / kp,

    with kp times its factor where the gain of a log was set otherwise; or du(time - d) - dq on the left, and kv for kp,
    of a velocity servo, where the second term is viscous friction. All signals are behind the same zero-phase low-pass;
    delays and cutoffs are tried one by one, and the best is taken by the share of the left side that is explained. Rows
    at which the joint may stick, or the servo is at its torque limit, are left out. Where t is too small to show
    1 / kp, as of a last joint behind a heavy rotor, the model's gain is taken: it is the scale of the other numbers.

    Args:
        episodes: position- or velocity-driven logs in the joint names and units of the robot.
        model: with the nominal bodies.
        joints: that are regressed.
        signal: `position` or `velocity`: of the command.
        gains: joint -> the model's kp of position servos, kv of velocity servos.
        limits: joint -> largest torque [Nm or N], where known.
        kp_factors: of each log, its position gain per the kp that is looked for; all the same if None.

    Raises:
        DataError: there are too few rows.
        TrueupError: what reading the logs raises.
    """
    logs = list(episodes)
    factors = [1.0] * len(logs) if kp_factors is None or signal != "position" else kp_factors
    best: dict[str, tuple[float, Float64[np.ndarray, "K"], float]] = {}
    for cutoff_hz in _CUTOFFS_HZ:
        parts = [_smoothed(log, model, joints, cutoff_hz) for log in logs]
        commands = [_commanded(log, joints, signal, cutoff_hz) for log in logs]
        for number, delay_s in enumerate(_DELAYS_S):
            told = [own[number] for own in commands]
            for column, joint in enumerate(joints):
                found = _regressed(parts, told, factors, column, signal, gains[joint], limits.get(joint))
                if found is not None and (joint not in best or found[0] < best[joint][0]):
                    best[joint] = (*found, float(delay_s))
    if not best:
        raise DataError("too few rows to regress servos on", expected=f"{_FEWEST_ROWS} of a moving joint")
    gain, damped, friction, rotor = (
        {joint: float(values[place]) for joint, (_, values, _) in best.items()} for place in range(4)
    )
    of_position = signal == "position"
    return ServoStart(
        kp=gain if of_position else {},
        kv=damped if of_position else gain,
        damping={} if of_position else damped,
        frictionloss=friction,
        armature=rotor,
        delay_s={joint: delay for joint, (_, _, delay) in best.items()},
    )


@dataclass(frozen=True, eq=False)
class _Moved:
    """A motion behind the low-pass, and the torque that it takes, (T, J) each."""

    position: Float64[np.ndarray, "T J"]
    velocity: Float64[np.ndarray, "T J"]
    acceleration: Float64[np.ndarray, "T J"]
    torque: Float64[np.ndarray, "T J"]


def _smoothed(log: Episode, model: mujoco.MjModel, joints: Sequence[str], cutoff_hz: float) -> _Moved:
    measured = log.measured
    known = [joint for joint in measured.joints if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint) >= 0]
    series = measured.select(known)
    q, dq, ddq = smooth(np.asarray(series["position"], np.float64), series.time_s, cutoff_hz=cutoff_hz)
    ids = [model.joint(joint).id for joint in known]
    places, dofs = model.jnt_qposadr[ids], model.jnt_dofadr[ids]
    data = mujoco.MjData(model)
    torque = np.full(q.shape, np.nan)
    force = np.zeros(model.nv)
    for row in np.flatnonzero(np.isfinite(ddq).all(axis=1)):
        data.qpos[places], data.qvel[dofs], data.qacc[dofs] = q[row], dq[row], ddq[row]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        # The bodies alone: without rotors, damping and dry friction.
        mujoco.mj_rne(model, data, 1, force)
        torque[row] = (force - data.qfrc_gravcomp - data.qfrc_spring)[dofs]
    own = [known.index(joint) for joint in joints]
    return _Moved(q[:, own], dq[:, own], ddq[:, own], torque[:, own])


def _commanded(log: Episode, joints: Sequence[str], signal: str, cutoff_hz: float) -> Float64[np.ndarray, "D T J"]:
    """The command at the measured stamps, behind the low-pass, for each of the delays."""
    command = log.commanded().select(joints)
    stamps = log.measured.time_s
    rows = np.maximum([held_rows(command.time_s, stamps - delay_s) for delay_s in _DELAYS_S], 0)
    values = np.asarray(command[signal], np.float64)[rows]
    # All of them are filtered at once.
    side_by_side = np.moveaxis(values, 0, 1).reshape(stamps.size, -1)
    smoothed = smooth(side_by_side, stamps, cutoff_hz=cutoff_hz).value
    return np.asarray(np.moveaxis(smoothed.reshape(stamps.size, _DELAYS_S.size, -1), 1, 0))


def _regressed(
    parts: Sequence[_Moved],
    told: Sequence[Float64[np.ndarray, "_ J"]],
    factors: Sequence[float],
    column: int,
    signal: str,
    gain: float,
    limit: float | None,
) -> tuple[float, Float64[np.ndarray, "K"]] | None:
    """Unexplained share of the error, and gain, damping, friction, armature and offset; None with too few rows."""
    q, dq, ddq, torque = (
        np.concatenate([getattr(part, name)[:, column] for part in parts])
        for name in ("position", "velocity", "acceleration", "torque")
    )
    error = np.concatenate([own[:, column] for own in told]) - (q if signal == "position" else dq)
    known = np.isfinite(ddq) & np.isfinite(torque) & np.isfinite(error)
    speed = float(np.sqrt(np.mean(dq[known] ** 2))) if known.any() else 0.0
    moving: Bool[np.ndarray, "T"] = known & (np.abs(dq) > _STICKS * speed)
    factor = np.repeat(factors, [len(part.position) for part in parts])
    terms = np.stack([torque, dq, np.sign(dq), ddq, np.ones_like(q)], axis=1) / factor[:, None]
    low = np.array([0.0, 0.0, 0.0, 0.0, -np.inf])
    rows, found = moving, None
    for _ in range(1 if limit is None else 3):
        if np.count_nonzero(rows) < _FEWEST_ROWS or speed <= 0:
            break
        used, wanted = terms[rows], error[rows]
        size = np.linalg.norm(used, axis=0) + 1e-12
        scaled = used / size
        values = lsq_linear(scaled, wanted, bounds=(low, np.inf), method="bvls").x
        left = wanted - scaled @ values
        variance = _MEMORY * float(left @ left) / np.count_nonzero(rows)
        deviation = np.sqrt(variance * np.linalg.pinv(scaled.T @ scaled, hermitian=True)[0, 0])
        seen = values[0] > _SEEN * deviation
        if not seen:
            right = wanted - used[:, 0] / gain
            rest = lsq_linear(scaled[:, 1:], right, bounds=(low[1:], np.inf), method="bvls").x
            values = np.append(size[0] / gain, rest)
            left = wanted - scaled @ values
        values = values / size
        share = float(left @ left / max(float(np.sum((wanted - wanted.mean()) ** 2)), 1e-300))
        found = share, np.append(1.0, values[1:]) / values[0]
        if limit is None:
            break
        # Where the servo asks for more than it has, its law does not hold.
        free = moving & (np.abs(found[1][0] * factor * error) < _SATURATED * limit)
        if np.array_equal(free, rows):
            break
        rows = free
    return found
