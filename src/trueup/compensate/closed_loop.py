"""Motions in a simulator whose commands are compensated at every control step, from the first one on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float32, Float64, Int

from trueup.augment.corrector import Corrector
from trueup.compensate.sensors import Sensors
from trueup.compensate.tracks import Track
from trueup.compensate.training import delta_of
from trueup.errors import DataError
from trueup.sim.transitions import Transitions

# Motions begin at rest: the first command is held until the simulator is, too.
_SETTLE_S = 1.0


@dataclass(frozen=True, eq=False)
class Run:
    """One motion.

    Attributes:
        state: positions, then velocities, when each command is given, (T, 2J).
        delta: what was added to each command, (T, J).
    """

    state: Float64[np.ndarray, "T S"]
    delta: Float64[np.ndarray, "T J"]


def closed_loop(
    tracks: Sequence[Track],
    transitions: Callable[[float], Transitions],
    corrector: Corrector | None,
    *,
    twin: Corrector | None = None,
    sensors: Sensors | None = None,
    settle_s: float = _SETTLE_S,
) -> list[Run]:
    """Simulate motions from their first measured positions, all of one payload side by side.

    Args:
        tracks: their commands are followed.
        transitions: the simulator with a payload [kg].
        corrector: says what commands lack; None for commands as they are.
        twin: makes the simulator the robot, whose commands are corrected then; see `training.unrolled`.
        sensors: of an operator that asks the simulator itself what they say.
        settle_s: for so long the first command is held before the motion begins [s]; torques are not held, and motions
            begin with the measured velocity.

    Raises:
        DataError: the simulation diverged.
    """
    found: dict[int, Run] = {}
    for payload_kg in sorted({track.payload_kg for track in tracks}):
        numbers = [number for number, track in enumerate(tracks) if track.payload_kg == payload_kg]
        own = [tracks[number] for number in numbers]
        found |= dict(
            zip(numbers, _together(own, transitions(payload_kg), corrector, twin, sensors, settle_s), strict=True)
        )
    return [found[number] for number in range(len(tracks))]


def _together(
    tracks: Sequence[Track],
    transitions: Transitions,
    corrector: Corrector | None,
    twin: Corrector | None,
    sensors: Sensors | None,
    settle_s: float,
) -> list[Run]:
    """Motions of one payload; short ones hold their last command until the longest has ended."""
    torques = transitions.signal == "torque"
    settling = 0 if torques else round(settle_s / transitions.control_s)
    longest = max(len(track) for track in tracks)
    rows = np.clip(np.arange(-settling, longest), 0, None)
    command = np.stack([track.command[np.minimum(rows, len(track) - 1)] for track in tracks], axis=1).astype(float)
    joints = command.shape[2]
    gravity = _gravity(tracks, rows)
    state = np.stack([track.state[0].astype(float) for track in tracks])
    if not torques:  # they begin at rest
        state[:, joints:] = 0.0
    payload = np.full((len(tracks), 1), tracks[0].payload_kg)
    own, other = _Eyes(corrector, payload), _Eyes(twin, payload)
    states, deltas, before = [], [], command[0]
    for step, wanted in enumerate(command):
        sensed = None if sensors is None else sensors.simulated(transitions, state, before)
        delta = own.delta(state, wanted, sensed)
        sent = wanted + delta + other.delta(state, wanted + delta)
        states.append(state)
        deltas.append(delta)
        pull = None if gravity is None else gravity[step]
        state, before = transitions.next(state, before, sent, gravity=pull), sent
        if not np.isfinite(state).all():
            raise DataError("the compensated simulation diverged", got=f"{len(states)} control steps after its start")
    whole, added = np.stack(states)[settling:], np.stack(deltas)[settling:]
    return [Run(whole[: len(track), k], added[: len(track), k]) for k, track in enumerate(tracks)]


def _gravity(tracks: Sequence[Track], rows: Int[np.ndarray, "N"]) -> Float64[np.ndarray, "N B 3"] | None:
    """What pulls on B motions in each step; None where their bases are at rest."""
    pulls = [track.gravity for track in tracks if track.gravity is not None]
    if not pulls:
        return None
    assert len(pulls) == len(tracks), "all motions say how their bases moved, or none does"
    return np.stack([pull[np.minimum(rows, len(pull) - 1)] for pull in pulls], axis=1).astype(np.float64)


class _Eyes:
    """What a network has seen of B motions; nobody's adds nothing."""

    def __init__(self, corrector: Corrector | None, payload: Float64[np.ndarray, "B 1"]) -> None:
        self._corrector = corrector
        self._payload = payload
        self._seen: list[torch.Tensor] = []

    def delta(
        self,
        state: Float64[np.ndarray, "B S"],
        command: Float64[np.ndarray, "B J"],
        sensed: Float32[np.ndarray, "B V"] | None = None,
    ) -> np.ndarray:
        """What the current commands lack, (B, J)."""
        if self._corrector is None:
            return np.zeros_like(command)
        parts = [state, command, self._payload, *([] if sensed is None else [sensed])]
        sample = torch.from_numpy(np.concatenate(parts, axis=1).astype(np.float32))
        past = self._corrector.network.past
        self._seen = [*(self._seen or [sample] * past), sample][-past - 1 :]
        with torch.no_grad():
            return np.asarray(delta_of(self._corrector, torch.stack(self._seen)).double().numpy())
