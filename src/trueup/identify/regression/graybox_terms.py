"""The terms of GapONet's gray-box torque model (section 3.1, eq. 1), and which of them some data can tell.

tau = K_p (q_cmd - q) + K_d (dq_cmd - dq) + K_v dq + K_c tanh(dq / eps) + K_payload P + K_Psin P sin q + K_Pcos P cos q
      + K_Pdq P dq + K_Pddq P ddq + tau_0

The constant tau_0 belongs to the first block and stays in all that follow: what a later block is worth is then its own
and not that of a mean torque.

That is a servo for positions. In its place a servo for velocities has K_d (dq_cmd - dq) + K_i (integral of the same),
and a drive for torques K_u tau_cmd.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from jaxtyping import Bool, Float64

from trueup.core.units import joint_unit
from trueup.robots.spec import CommandSignal

BLOCKS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "pd": ("tau_0", "K_p", "K_d"),
        "friction": ("K_v", "K_c"),
        "payload": ("K_payload",),
        "posture": ("K_Psin", "K_Pcos"),
        "coupling": ("K_Pdq", "K_Pddq"),
    }
)
# The drive's own block, by what it follows.
_DRIVES: Mapping[CommandSignal, tuple[str, ...]] = MappingProxyType(
    {"position": BLOCKS["pd"], "velocity": ("tau_0", "K_d", "K_i"), "torque": ("tau_0", "K_u")}
)
_HINGE_UNITS: Mapping[str, str] = MappingProxyType(
    {
        "tau_0": "Nm",
        "K_p": "Nm/rad",
        "K_i": "Nm/rad",
        "K_u": "1",
        "K_d": "Nm s/rad",
        "K_v": "Nm s/rad",
        "K_c": "Nm",
        "K_payload": "Nm/kg",
        "K_Psin": "Nm/kg",
        "K_Pcos": "Nm/kg",
        "K_Pdq": "Nm s/(rad kg)",
        "K_Pddq": "Nm s^2/(rad kg)",
    }
)
_PAYLOAD_BLOCKS = ("payload", "posture", "coupling")
_LEAST_MOTION = {"rad": 0.01, "m": 0.001}  # a joint that stays within this shows sensor noise, not friction
_DEPENDENT = 1e-8  # share of a column's square that the other columns must leave over
_NEARLY_DEPENDENT = 1e-2


@dataclass(frozen=True, eq=False)
class JointRows:
    """The N complete rows of one joint.

    Attributes:
        error: commanded minus measured position, by how much more the gain was set to than where `K_p` holds; of a
            servo for velocities the integral of its error [rad or m], 0 where torques are followed.
        velocity_error: commanded minus measured velocity; 0 where torques are followed.
        command: commanded position, integrated commanded velocity, or commanded torque.
        command_velocity: commanded velocity.
        position: measured position.
        velocity: measured velocity.
        acceleration: measured acceleration.
        payload_kg: payload.
        torque: what is predicted.
        length_unit: `rad` or `m`.
        follows: what the drive is told.
    """

    error: Float64[np.ndarray, "N"]
    velocity_error: Float64[np.ndarray, "N"]
    command: Float64[np.ndarray, "N"]
    command_velocity: Float64[np.ndarray, "N"]
    position: Float64[np.ndarray, "N"]
    velocity: Float64[np.ndarray, "N"]
    acceleration: Float64[np.ndarray, "N"]
    payload_kg: Float64[np.ndarray, "N"]
    torque: Float64[np.ndarray, "N"]
    length_unit: str
    follows: CommandSignal = "position"

    def where(self, mask: Bool[np.ndarray, "N"]) -> JointRows:
        """The rows at which the mask is true."""
        return replace(self, **{name: own[mask] for name, own in vars(self).items() if isinstance(own, np.ndarray)})

    @property
    def told(self) -> Float64[np.ndarray, "N"]:
        """What the torque of the drive should grow with."""
        return {"position": self.error, "velocity": self.velocity_error, "torque": self.command}[self.follows]


_COLUMNS: Mapping[str, Callable[[JointRows, float], Float64[np.ndarray, "N"]]] = MappingProxyType(
    {
        "tau_0": lambda rows, _: np.ones_like(rows.position),
        "K_p": lambda rows, _: rows.error,
        "K_d": lambda rows, _: rows.velocity_error,
        "K_i": lambda rows, _: rows.error,
        "K_u": lambda rows, _: rows.command,
        "K_v": lambda rows, _: rows.velocity,
        "K_c": lambda rows, epsilon: np.tanh(rows.velocity / epsilon),
        "K_payload": lambda rows, _: rows.payload_kg,
        "K_Psin": lambda rows, _: rows.payload_kg * np.sin(rows.position),
        "K_Pcos": lambda rows, _: rows.payload_kg * np.cos(rows.position),
        "K_Pdq": lambda rows, _: rows.payload_kg * rows.velocity,
        "K_Pddq": lambda rows, _: rows.payload_kg * rows.acceleration,
    }
)


COLUMNS: tuple[str, ...] = tuple(_COLUMNS)


def blocks_of(follows: CommandSignal) -> dict[str, tuple[str, ...]]:
    """Block -> coefficients, for a drive that follows this."""
    return {**BLOCKS, "pd": _DRIVES[follows]}


def columns(rows: JointRows, epsilon: float) -> Float64[np.ndarray, "N 12"]:
    """All terms without their coefficients, in the order of `COLUMNS`.

    Args:
        rows: the rows of one joint.
        epsilon: width of the smoothed Coulomb step [rad/s or m/s].
    """
    return np.stack([term(rows, epsilon) for term in _COLUMNS.values()], axis=1)


def term_names(blocks: tuple[str, ...], follows: CommandSignal = "position") -> tuple[str, ...]:
    """The coefficients of these blocks, in order."""
    own = blocks_of(follows)
    return tuple(name for block in blocks for name in own[block])


def unit(name: str, length_unit: str) -> str:
    """The unit of a coefficient for a joint in rad or m."""
    return joint_unit(_HINGE_UNITS[name], length_unit)


def unusable(rows: JointRows) -> str:
    """Why no term at all can be fitted to these rows; empty if some can."""
    if rows.torque.size < 50:
        return f"only {rows.torque.size} complete samples"
    if np.ptp(rows.torque) == 0.0:
        return f"the torque never changes ({rows.torque[0]:.4g})"
    what = {"position": "position error", "velocity": "velocity error", "torque": "commanded torque"}[rows.follows]
    return unsigned(rows.torque, rows.told, what)


def unsigned(torque: Float64[np.ndarray, "N"], told: Float64[np.ndarray, "N"], what: str) -> str:
    """Why a torque looks like an absolute value; empty if it does not.

    Args:
        torque: as measured.
        told: what it should grow with.
        what: what that is called.
    """
    one_sided = torque.min() >= 0.0 or torque.max() <= 0.0
    sides = min(np.mean(told > 0.0), np.mean(told < 0.0))
    size = np.abs(torque)
    if not one_sided or sides <= 0.05 or abs(_correlation(np.abs(told), size)) <= abs(_correlation(told, size)):
        return ""
    return f"the torque never changes its sign while the {what} does: it looks like an absolute value"


def missing_evidence(rows: JointRows, payload_motions: Mapping[float, int]) -> dict[str, str]:
    """Coefficients that these data cannot tell by construction, each with the reason.

    Args:
        rows: the rows of one joint that are fitted.
        payload_motions: payload [kg] -> number of fitted motions that carry it.
    """
    reasons: dict[str, str] = {}
    travel = float(np.subtract(*np.percentile(rows.position, [99.5, 0.5])))
    frozen = travel < _LEAST_MOTION[rows.length_unit]
    constant_command = np.ptp(rows.command) == 0.0
    if frozen:
        why = f"the joint hardly moved ({travel:.2g} {rows.length_unit})"
        reasons |= dict.fromkeys(("K_v", "K_c", "K_Psin", "K_Pcos", "K_Pdq", "K_Pddq"), why)
        if np.ptp(rows.command_velocity) == 0.0:
            reasons["K_d"] = why
        if constant_command:
            reasons["K_p"] = "neither the command nor the joint moved"
    elif rows.follows != "torque" and not rows.command_velocity.any():
        reasons["K_v"] = "the commanded velocity is zero throughout, so K_d holds both: K_d stands for K_d - K_v"
    if rows.length_unit != "rad":
        reasons |= dict.fromkeys(("K_Psin", "K_Pcos"), "posture terms are for joints that rotate")
    if len(payload_motions) == 1:
        carried = next(iter(payload_motions))
        why = f"all episodes carry {carried:g} kg"
        reasons |= dict.fromkeys(term_names(_PAYLOAD_BLOCKS), why)
    return reasons


def dependent(scaled: Float64[np.ndarray, "N K"], names: tuple[str, ...]) -> dict[str, str]:
    """Coefficients whose column is a combination of those before it, each with the reason.

    Args:
        scaled: columns of the terms that have evidence, or anything with the same inner products, (N, K).
        names: their names, the ones to prefer first.
    """
    reasons: dict[str, str] = {}
    kept: list[int] = []
    for number, name in enumerate(names):
        column = scaled[:, number]
        size = float(column @ column)
        if size == 0.0:
            reasons[name] = "its term is zero throughout"
            continue
        basis = scaled[:, kept]
        left = column - basis @ np.linalg.lstsq(basis, column, rcond=None)[0] if kept else column
        if float(left @ left) < _DEPENDENT * size:
            reasons[name] = f"cannot be told from {_partner(scaled, kept, number, names)}"
            continue
        kept.append(number)
    return reasons


def weak_points(
    scaled: Float64[np.ndarray, "N K"], names: tuple[str, ...], rows: JointRows, payload_motions: Mapping[float, int]
) -> dict[str, str]:
    """Coefficients that hang on little, each with the reason: nearly dependent terms, a single loaded motion.

    Args:
        scaled: columns of the terms that are fitted, or anything with the same inner products, (N, K).
        names: their names.
        rows: the rows that are fitted.
        payload_motions: payload [kg] -> number of fitted motions that carry it.
    """
    reasons: dict[str, str] = {}
    norms = np.linalg.norm(scaled, axis=0)
    inverse = np.linalg.inv(scaled.T @ scaled / np.outer(norms, norms))
    for number, name in enumerate(names):
        if 1.0 / inverse[number, number] < _NEARLY_DEPENDENT:
            others = [other for other in range(len(names)) if other != number]
            reasons[name] = f"nearly the same as {_partner(scaled, others, number, names)} in these motions"
    if "K_p" in names and np.ptp(rows.command) == 0.0:
        reasons["K_p"] = "the command is constant: stiffness cannot be told from a torque that depends on the posture"
    loaded = sum(count for payload, count in payload_motions.items() if payload != 0.0)
    if loaded == 1:
        why = "one single motion carries a payload: what is special about it counts as payload"
        reasons |= {name: why for name in term_names(_PAYLOAD_BLOCKS) if name in names}
    return reasons


def _partner(scaled: Float64[np.ndarray, "N K"], others: list[int], number: int, names: tuple[str, ...]) -> str:
    """The other term whose share in explaining a column is largest."""
    weights = np.linalg.lstsq(scaled[:, others], scaled[:, number], rcond=None)[0]
    shares = np.abs(weights) * np.linalg.norm(scaled[:, others], axis=0)
    return names[others[int(shares.argmax())]]


def _correlation(first: Float64[np.ndarray, "N"], second: Float64[np.ndarray, "N"]) -> float:
    first, second = first - first.mean(), second - second.mean()
    size = float(np.sqrt((first @ first) * (second @ second)))
    return float(first @ second) / size if size > 0.0 else 0.0
