"""Whether a simulator that repeats itself has stalled or rests."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32, Float64, Int

from trueup.core.model_card import Input
from trueup.deploy.span import index_of


class Unrest:
    """What says that a simulator cannot stay where it is: its velocities, or, if none is read, the command.

    A network that reads neither leaves nothing that could say it.

    Args:
        inputs: the network's, I channels.
        moving_speed: speed from which on a joint moves [rad/s or m/s].
    """

    def __init__(self, inputs: Sequence[Input], moving_speed: float) -> None:
        simulated = simulated_channels(inputs)
        self._speeds = np.array([row for row in simulated if inputs[row].signal == "velocity"], int)
        self._commands = np.array([row for row, channel in enumerate(inputs) if channel.series == "command"], int)
        self._moving_speed = moving_speed
        self._urged = False

    def repeated(self, before: Float32[np.ndarray, "I"], now: Float64[np.ndarray, "I"], *, first: bool) -> None:
        """Look at the command of a sample in which the simulator repeats itself.

        Args:
            before: the latest sample that the network has seen, as it saw it.
            now: this sample, likewise, but for its precision.
            first: whether the simulator was still another in the sample before.
        """
        changed = not np.array_equal(before[self._commands], now[self._commands].astype(before.dtype))
        self._urged = changed or (self._urged and not first)

    def moves(self, raw: Float64[np.ndarray, "I"]) -> bool:
        """Whether it must be moving: in this sample, or, by the command, since it began to repeat itself."""
        if self._speeds.size == 0:
            return self._urged
        return float(np.abs(raw[self._speeds]).max()) > self._moving_speed


class Scattered:
    """Channels that do not stand beside each other, with what is asked of a view of those that do."""

    def __init__(self, raw: Float64[np.ndarray, "I"], rows: Int[np.ndarray, "N"]) -> None:
        self._raw, self._rows = raw, rows

    def tobytes(self) -> bytes:
        """What they are now."""
        values: Float64[np.ndarray, "N"] = self._raw[self._rows]
        return values.tobytes()


def simulated_part(inputs: Sequence[Input], raw: Float64[np.ndarray, "I"]) -> Float64[np.ndarray, "N"] | Scattered:
    """What a stalled simulator repeats, as it is when its bytes are asked for; the command may go on meanwhile."""
    rows = simulated_channels(inputs)
    place = index_of(rows)
    return raw[place] if isinstance(place, slice) else Scattered(raw, rows)


def simulated_channels(inputs: Sequence[Input]) -> Int[np.ndarray, "N"]:
    """Numbers of the channels that come from the simulator; of all, should there be none."""
    rows = [number for number, channel in enumerate(inputs) if channel.series == "simulated"]
    return np.array(rows or range(len(inputs)))
