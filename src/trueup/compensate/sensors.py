"""What a simulator would do under each of k fixed commands: the sensors of an operator (GapONet, eq. 2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float32, Float64
from torch import Tensor

from trueup.compensate.windows import Batch, Windows
from trueup.sim.transitions import Transitions

# How far the fixed commands are from the joints' positions [rad or m]: about as far as commands run ahead.
_REACH = 0.1
_SAMPLES = 4096


@dataclass(frozen=True, eq=False)
class Sensors:
    """Fixed commands, and the scales of what they do.

    Attributes:
        offsets: the commands, from where the joints are, (k, J) [rad or m].
        center: mean of the changes of positions and velocities in one control step, (k 2J,).
        scale: their standard deviation, (k 2J,).
    """

    offsets: Tensor
    center: Tensor
    scale: Tensor

    @staticmethod
    def of(windows: Windows, count: int, joints: int, *, seed: int = 0) -> Sensors:
        """Draw `count` commands, and look at what they do in motions."""
        offsets = torch.from_numpy(
            np.random.default_rng([seed, 20]).normal(0.0, _REACH, (count, joints)).astype(np.float32)
        )
        starts = windows.starts(1)
        starts = starts[:: max(1, len(starts) // _SAMPLES)]
        batch = windows.batch(starts, 1)
        values = responses(batch, 0, batch.state[windows.past], torch.zeros_like(batch.error[0]), offsets)
        return Sensors(offsets, values.mean(0), values.std(0).clamp_min(1e-9))

    def values(self, batch: Batch, step: int, state: Tensor, error: Tensor) -> Tensor:
        """What they say in a step of windows, in units of their spread, (B, k 2J)."""
        return (responses(batch, step, state, error, self.offsets) - self.center) / self.scale

    def simulated(
        self, transitions: Transitions, state: Float64[np.ndarray, "B S"], before: Float64[np.ndarray, "B J"]
    ) -> Float32[np.ndarray, "B V"]:
        """What they say if the simulator itself is asked, likewise: k control steps for each of B states.

        Args:
            transitions: the simulator.
            state: positions, then velocities.
            before: what was commanded one control step ago.
        """
        count, joints = self.offsets.shape
        command = (state[:, None, :joints] + self.offsets.numpy()).reshape(-1, joints)
        here = np.repeat(state, count, axis=0)
        moved = transitions.next(here, np.repeat(before, count, axis=0), command) - here
        values = (moved.reshape(len(state), -1) - self.center.numpy()) / self.scale.numpy()
        return np.asarray(values, np.float32)


def responses(batch: Batch, step: int, state: Tensor, error: Tensor, offsets: Tensor) -> Tensor:
    """Changes of positions and velocities in one control step under fixed commands, (B, k 2J), by the linear model.

    Args:
        batch: windows.
        step: number of the control step.
        state: of the simulator, (B, 2J).
        error: how far that is from the measured one, (B, 2J).
        offsets: the commands, from where the joints are, (k, J).
    """
    past = len(batch.command) - len(batch.error) - 1
    row = past + step
    joints = offsets.shape[1]
    drift = batch.state[row + 1] + batch.error[step] + torch.einsum("bst,bt->bs", batch.a[step], error) - state
    ahead = state[:, None, :joints] + offsets - batch.command[row][:, None]
    moved: Tensor = drift[:, None] + torch.einsum("bsj,bkj->bks", batch.c[step], ahead)
    return moved.flatten(1)
