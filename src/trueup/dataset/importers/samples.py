"""Samples of joint signals as messages carry them: rows that share their joints, with both of a message's clocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64

from trueup.errors import ConfigError, DataError

NS_PER_S = 1_000_000_000


@dataclass(frozen=True, eq=False)
class Samples:
    """N messages with the same joints in the same order.

    Attributes:
        joints: names of the J columns.
        index: number of each message on its topic, (N,), increasing.
        stamp_ns: header stamps, (N,) [ns], 0 where not set.
        log_ns: time at which the recorder got the message, (N,) [ns].
        signals: signal -> values, (N, J); a signal whose arrays were empty is not there.
    """

    joints: tuple[str, ...]
    index: Int64[np.ndarray, "N"]
    stamp_ns: Int64[np.ndarray, "N"]
    log_ns: Int64[np.ndarray, "N"]
    signals: dict[str, Float64[np.ndarray, "N J"]]


class Collector:
    """Gathers samples by joint list; the joints of each row come from its own message.

    Args:
        source: file and topic, for error messages.
        joints: names for messages that carry none, as the user stated them.
    """

    def __init__(self, source: str, joints: Sequence[str] = ()) -> None:
        self._source = source
        self._stated = tuple(joints)
        self._groups: dict[tuple[tuple[str, ...], tuple[str, ...]], list[tuple[Any, ...]]] = {}

    def keep(
        self,
        names: Sequence[str],
        arrays: dict[str, Float64[np.ndarray, "N _"]],
        index: Int64[np.ndarray, "N"],
        stamp_ns: Int64[np.ndarray, "N"],
        log_ns: Int64[np.ndarray, "N"],
    ) -> None:
        """Add N rows with the same joints.

        Raises:
            DataError: an array is neither empty nor as long as the list of names, or a name occurs twice.
            ConfigError: there are values without names and none were stated.
        """
        present = {signal: values for signal, values in arrays.items() if values.shape[1]}
        if not present:
            return
        joints = tuple(names) or self._stated
        message = f"message {int(index[0]) + 1} of {self._source}"
        if not joints:
            raise ConfigError(
                f"{message} has values but no joint names",
                got=f"{next(iter(present.values())).shape[1]} values",
                hint="State them in the file given with --mapping, in the message's order: `joints: [a, b, ...]`.",
            )
        if len(set(joints)) < len(joints):
            raise DataError(f"{message} names a joint twice", got=list(joints))
        for signal, values in present.items():
            if values.shape[1] != len(joints):
                raise DataError(
                    f"{message} is ragged",
                    got=f"{values.shape[1]} values of {signal} for the {len(joints)} joints {list(joints)}",
                )
        self._groups.setdefault((joints, tuple(present)), []).append((index, stamp_ns, log_ns, *present.values()))

    def samples(self) -> list[Samples]:
        """All rows, one entry per joint list and set of signals, in the order of their first message."""
        result = []
        for (joints, signals), rows in self._groups.items():
            index, stamp_ns, log_ns, *values = (np.concatenate(column) for column in zip(*rows, strict=True))
            order = np.argsort(index, kind="stable")
            if np.any(order[1:] < order[:-1]):
                index, stamp_ns, log_ns, *values = (column[order] for column in (index, stamp_ns, log_ns, *values))
            result.append(Samples(joints, index, stamp_ns, log_ns, dict(zip(signals, values, strict=True))))
        return sorted(result, key=lambda group: int(group.index[0]))


def stamp_ns(header: Any) -> int:
    """A header's stamp [ns]; 0 if it is not set."""
    return int(header.stamp.sec) * NS_PER_S + int(header.stamp.nanosec)
