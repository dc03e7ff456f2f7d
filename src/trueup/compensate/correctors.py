"""Networks between SI values before training: commands in, corrected commands out."""

from __future__ import annotations

import numpy as np
import torch

from trueup.augment.corrector import Corrector
from trueup.augment.networks import build_network
from trueup.augment.scaling import Scaling
from trueup.compensate.config import CompensateConfig
from trueup.compensate.windows import Windows

# Of delta actions, before any training [rad or m].
SIZE = 0.02
# An input that never changes in training must not be blown up when it does.
_STILL = 1e-6


def blank(config: CompensateConfig, joints: int, rate_hz: float, seed: int = 0, *, sensed: int = 0) -> Corrector:
    """A network with random weights, between numbers of size one; its inputs are those of `compensation.channels`.

    After them come those of sensors that are asked, where an operator does not predict what they say.
    """
    inputs, base = 3 * joints + 1 + sensed, np.arange(2 * joints, 3 * joints)
    before = torch.get_rng_state()
    torch.manual_seed(seed)
    network = build_network(config.network, inputs=inputs, base=base.tolist(), rate_hz=rate_hz)
    torch.set_rng_state(before)
    ones, zeros = np.ones(inputs), np.zeros(inputs)
    relative = np.full(inputs, -1)
    if config.relative:
        relative[base] = np.arange(joints)
    scaling = Scaling(zeros, ones, zeros[:joints], ones[:joints], ones[:joints])
    return Corrector(network, scaling, base, target="residual", relative=relative)


def scale(corrector: Corrector, config: CompensateConfig, windows: Windows, size: float = SIZE) -> None:
    """Put a network on the scales of the train motions, and of delta actions of this size [rad or m]."""
    state, command, payload = windows.samples()
    ahead = command - state[:, : command.shape[1]] if config.relative else command
    rows = torch.cat([state, ahead, payload], dim=1).double()
    spread = rows.std(0)
    read = rows.shape[1]
    corrector.center[:read] = rows.mean(0)
    corrector.scale[:read] = torch.where(spread > _STILL, spread, 1.0)
    corrector.out_scale.fill_(size)
    corrector.loss_scale.fill_(size)


def corrector_for(
    config: CompensateConfig, windows: Windows, *, rate_hz: float, size: float, seed: int = 0
) -> Corrector:
    """`blank`, on the scales of the train motions; for callers that know how far back the network looks."""
    corrector = blank(config, windows.samples()[1].shape[1], rate_hz, seed)
    scale(corrector, config, windows, size)
    return corrector
