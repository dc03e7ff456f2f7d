"""Windows of motions and of their linear models, as tensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from trueup.compensate.linear import Linear
from trueup.errors import DataError


@dataclass(frozen=True, eq=False)
class Batch:
    """B windows of `past` samples of history and L control steps, J joints.

    Attributes:
        state: measured, (past + L + 1, B, 2J).
        command: (past + L + 1, B, J).
        payload: [kg], (B, 1).
        error: (L, B, 2J); see `linear.Linear`.
        a: (L, B, 2J, 2J).
        before: (L, B, 2J, J), or None where commands act at once.
        c: (L, B, 2J, J).
        reference: states that are to be followed in place of the measured ones, (L + 1, B, 2J), or None.
        gravity: see `tracks.Track`, (L, B, 3), or None.
    """

    state: Tensor
    command: Tensor
    payload: Tensor
    error: Tensor
    a: Tensor
    before: Tensor | None
    c: Tensor
    reference: Tensor | None = None
    gravity: Tensor | None = None


class Windows:
    """All windows of a set of motions.

    Args:
        parts: motions with their linear models.
        past: samples of history that a network reads besides the current one.
        device: where batches are made.
        references: of each motion what is to be followed, (T, 2J).
    """

    def __init__(
        self,
        parts: Sequence[Linear],
        past: int,
        *,
        device: str = "cpu",
        references: Sequence[np.ndarray] | None = None,
    ) -> None:
        self.past = past
        self.device = device
        self._lengths = np.array([len(part.error) for part in parts])
        # One row more than there are transitions: the last state of a motion.
        self._first = np.concatenate([[0], np.cumsum(self._lengths + 1)])[:-1]

        def rows(values: Sequence[np.ndarray]) -> Tensor:
            whole = [
                part if len(part) == count + 1 else np.concatenate([part, part[-1:]])
                for part, count in zip(values, self._lengths, strict=True)
            ]
            return torch.from_numpy(np.concatenate(whole).astype(np.float32)).to(device)

        self._state = rows([part.track.state for part in parts])
        self._command = rows([part.track.command for part in parts])
        self._error = rows([part.error for part in parts])
        self._a = rows([part.state for part in parts])
        self._c = rows([part.command for part in parts])
        late = any(part.before.any() for part in parts)
        self._before = rows([part.before for part in parts]) if late else None
        payload = [np.full(len(part.error) + 1, part.track.payload_kg, np.float32) for part in parts]
        self._payload = torch.from_numpy(np.concatenate(payload)).to(device)
        self._reference = None if references is None else rows(references)
        pulls = [part.track.gravity for part in parts if part.track.gravity is not None]
        self._gravity = rows(pulls) if pulls else None

    def starts(self, horizon: int) -> Tensor:
        """Where windows of so many control steps may begin."""
        found = [
            np.arange(first + self.past, first + count - horizon + 1)
            for first, count in zip(self._first, self._lengths, strict=True)
        ]
        starts = np.concatenate(found)
        if starts.size == 0:
            raise DataError(
                "no motion is as long as a window",
                got=f"at most {self._lengths.max()} control steps",
                expected=f"{horizon} and {self.past} before",
                hint="training: {horizon: ...} in the configuration.",
            )
        return torch.from_numpy(starts)

    def batch(self, starts: Tensor, horizon: int) -> Batch:
        """The windows that begin there."""
        steps = torch.arange(horizon)[:, None] + starts
        around = torch.arange(-self.past, horizon + 1)[:, None] + starts

        def at(values: Tensor | None, rows: Tensor) -> Tensor | None:
            return None if values is None else values[rows]

        return Batch(
            state=self._state[around],
            command=self._command[around],
            payload=self._payload[starts][:, None],
            error=self._error[steps],
            a=self._a[steps],
            before=at(self._before, steps),
            c=self._c[steps],
            reference=at(self._reference, torch.arange(horizon + 1)[:, None] + starts),
            gravity=at(self._gravity, steps),
        )

    def samples(self) -> tuple[Tensor, Tensor, Tensor]:
        """All states, commands and payloads, (M, 2J), (M, J), (M, 1)."""
        return self._state, self._command, self._payload[:, None]
