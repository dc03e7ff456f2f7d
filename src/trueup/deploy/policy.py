"""A trained policy beside a robot: from positions, velocities and a goal to torques."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Float64

from trueup.core.policy_card import POLICY_GRAPH, Kinematics, PolicyCard
from trueup.deploy.looking import compiled
from trueup.deploy.network import session_of
from trueup.errors import ConfigError, DataError, NameMismatch

_RATE_TOLERANCE = 0.02


@dataclass(frozen=True, eq=False)
class PolicyStep:
    """What a policy says.

    Attributes:
        torque: within the largest ones, (J,) [Nm]; zero if it says nothing.
        distance_m: of the end of the arm from the goal [m].
        sound: whether what it was told and what it says are numbers.
    """

    torque: Float64[np.ndarray, "J"]
    distance_m: float
    sound: bool


class Policy:
    """A policy for one robot.

    Args:
        card: what it says of itself.
        session: onnxruntime's, over its graph.
    """

    def __init__(self, card: PolicyCard, session: Any) -> None:
        self.card = card
        self._session = session
        self._input = session.get_inputs()[0].name
        joints = len(card.joints)
        self._most = np.array(card.torque_nm)
        self._chain = arrays_of(card.kinematics)
        self._places, self._look, *_ = compiled()
        self._place, self._seen = np.zeros((1, 3)), np.zeros((1, 3 * joints + 3))
        self._nothing = np.zeros((1, joints)), np.ones(1), np.zeros(4), np.zeros(1)
        self._distance_m = np.zeros(1)

    @staticmethod
    def load(folder: Path | str, *, joints: Sequence[str], rate_hz: float) -> Policy:
        """Open a policy's folder, for a robot with these joints that is controlled at this rate.

        Raises:
            NameMismatch: it is of a robot with other joints.
            ConfigError: it was trained at another rate.
            DataError: a file is missing, truncated or changed.
            FormatError: the card is of another version.
            MissingDependency: onnxruntime is not installed.
        """
        folder = Path(folder)
        card = PolicyCard.load(folder)
        if card.joints != tuple(joints):
            raise NameMismatch(
                f"the policy {card.name!r} is of another robot",
                left=card.joints,
                right=joints,
                left_name="it has",
                right_name="robot has",
            )
        if abs(rate_hz / card.rate_hz - 1) > _RATE_TOLERANCE:
            raise ConfigError(
                f"the policy {card.name!r} was trained at another rate",
                got=f"{rate_hz:g} Hz",
                expected=f"{card.rate_hz:g} Hz",
            )
        session = session_of(card.graph(folder), str(folder / POLICY_GRAPH))
        wide, joint_count = 3 * len(card.joints) + 3, len(card.joints)
        shapes = [tuple(part.shape[1:]) for part in (*session.get_inputs(), *session.get_outputs())]
        if shapes != [(wide,), (joint_count,)]:
            raise DataError(
                f"{folder / POLICY_GRAPH} is no policy of its card", got=shapes, expected=[wide, joint_count]
            )
        return Policy(card, session)

    def act(self, seen: Float[np.ndarray, "N O"]) -> Float64[np.ndarray, "N J"]:
        """Torques of N arms for what is seen of each, as `looking` makes it [Nm]; NaN where the network says so."""
        said = self._session.run(None, {self._input: np.asarray(seen, np.float32)})[0]
        return np.clip(np.asarray(said, np.float64), -self._most, self._most)

    def place(self, position: Float64[np.ndarray, "J"]) -> Float64[np.ndarray, "3"]:
        """Where the end of the arm is [m]; the array is written anew by the next call.

        Args:
            position: (J,) [rad or m].
        """
        self._places(position[None], *self._chain, self._place)
        return np.asarray(self._place[0])

    def step(
        self, position: Float[np.ndarray, "J"], velocity: Float[np.ndarray, "J"], goal: Float[np.ndarray, "3"]
    ) -> PolicyStep:
        """Torques for the next control step.

        Args:
            position: measured [rad or m].
            velocity: measured [rad/s or m/s].
            goal: [m].

        Raises:
            DataError: not one number per joint, or a goal that is no place.
        """
        joints = len(self._most)
        given = [np.asarray(values, np.float64) for values in (position, velocity, goal)]
        if [values.shape for values in given] != [(joints,), (joints,), (3,)]:
            raise DataError("a step of a policy", got=[values.shape for values in given], expected=[joints, joints, 3])
        if not all(np.isfinite(values).all() for values in given):
            return PolicyStep(np.zeros(joints), float("nan"), sound=False)
        q, dq, place = (values[None] for values in given)
        before, start_m, costs, reward = self._nothing
        self.place(given[0])
        self._look(q, dq, before, self._place, place, start_m, 1.0, costs, self._seen, reward, self._distance_m)
        said = self.act(self._seen)[0]
        sound = bool(np.isfinite(said).all())
        return PolicyStep(said if sound else np.zeros(joints), float(self._distance_m[0]), sound)


def arrays_of(kinematics: Kinematics) -> tuple[np.ndarray, ...]:
    """As `looking.compiled` takes them."""
    return (
        np.array(kinematics.columns, np.int64),
        np.array(kinematics.axes, np.float64),
        np.array(kinematics.hinges, bool),
        np.array(kinematics.turns, np.float64).reshape(-1, 3, 3),
        np.array(kinematics.shifts, np.float64),
    )
