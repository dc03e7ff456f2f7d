"""From a simulator's arrays to the flat vector that a network reads."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float, Float64

from trueup.core.model_card import ModelCard
from trueup.errors import DataError, MissingSignal


class Intake:
    """Copies signals, each an array over all joints, to where the network's input channels are.

    Args:
        card: of the network.
        x: the input channels, in the card's order, (I,); `fill` writes here.

    Attributes:
        conditions: signal -> its place in `x`, (1,); `fill` leaves it alone.
    """

    def __init__(self, card: ModelCard, x: Float64[np.ndarray, "I"]) -> None:
        self._card, self._x = card, x
        self._joints = len(card.joints)
        self.conditions: dict[str, np.ndarray] = {}
        groups: dict[tuple[str, str], list[tuple[int, int]]] = {}
        for row, channel in enumerate(card.inputs):
            if channel.series == "condition":
                self.conditions[channel.signal] = x[row : row + 1]
                continue
            group = groups.setdefault((channel.series, channel.signal), [])
            group.append((row, card.joints.index(channel.joint)))
        self._of: dict[str, list[tuple[str, np.ndarray]]] = {"simulated": [], "command": [], "measured": []}
        # Signals of which not every joint is read, or not in this order, pass through an array of their own.
        self._scattered: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        for (series, signal), pairs in groups.items():
            rows, joints = np.array(pairs).T
            if np.array_equal(joints, np.arange(self._joints)) and np.array_equal(rows, rows[0] + joints):
                place = x[rows[0] : rows[0] + self._joints]
            else:
                place = np.zeros(self._joints)
                self._scattered.append((place, rows, joints))
            self._of[series].append((signal, place))
        self._simulated, *self._others = self._of.values()

    def fill(
        self,
        simulated: Mapping[str, Float[np.ndarray, "J"]],
        command: Mapping[str, Float[np.ndarray, "J"]] | None = None,
        measured: Mapping[str, Float[np.ndarray, "J"]] | None = None,
    ) -> None:
        """Copy a sample.

        Raises:
            MissingSignal: a signal that the network reads is not there.
            DataError: an array has another shape than (J,), or holds no numbers.
        """
        count = self._joints
        try:
            for signal, place in self._simulated:
                values = simulated[signal]
                if len(values) != count:  # a single number would be spread over all joints
                    self._refuse_all(simulated, command, measured)
                place[...] = values
            for own, given in zip(self._others, (command, measured), strict=True):
                for signal, place in own:
                    values = given[signal]  # type: ignore[index]  # None is refused below
                    if len(values) != count:
                        self._refuse_all(simulated, command, measured)
                    place[...] = values
        except (LookupError, TypeError, ValueError):
            self._refuse_all(simulated, command, measured)
            raise
        for place, rows, joints in self._scattered:
            self._x[rows] = place[joints]

    def _refuse_all(self, *given: Mapping[str, Any] | None) -> None:
        for series, signals in zip(self._of, given, strict=True):
            self._refuse(series, signals)

    def _refuse(self, series: str, given: Mapping[str, Any] | None) -> None:
        """Raise what is wrong with the signals of a series, if anything is."""
        given = given or {}
        for signal, _ in self._of[series]:
            what = f"model {self._card.name!r} reads {series}.{signal}"
            if signal not in given:
                raise MissingSignal(f"{what}, which was not given", available=given)
            expected = f"one number for each of {self._joints} joints"
            try:
                shape = np.asarray(given[signal], np.float64).shape
            except (TypeError, ValueError) as error:
                raise DataError(what, got=error, expected=expected) from error
            if shape != (self._joints,):
                raise DataError(what, got=f"shape {shape}", expected=expected)
