"""Training: what a network must add to commands so that the simulator moves like the robot, or the robot like it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from trueup.augment.corrector import Corrector
from trueup.augment.networks import build_network
from trueup.augment.networks.operator import Operator
from trueup.augment.scaling import Scaling
from trueup.compensate.config import CompensateConfig, LossConfig
from trueup.compensate.windows import Batch, Windows

# Share of the updates after which windows have their full length.
_GROWN = 0.4
_SHORTEST = 8
_WARM = 0.01
_CLIP = 1.0


@dataclass(frozen=True)
class Progress:
    """Where a training stands.

    Attributes:
        update: number of the update, from 1.
        loss: of its batch.
        seconds: since the beginning [s].
    """

    update: int
    loss: float
    seconds: float


def corrector_for(config: CompensateConfig, windows: Windows, *, rate_hz: float, size: float) -> Corrector:
    """A network with random weights on the scales of the data; its inputs are those of `channels`.

    Args:
        config: kind and sizes.
        windows: the train motions.
        rate_hz: of control [Hz].
        size: typical size of a delta action [rad or m].
    """
    state, command, payload = windows.samples()
    joints = command.shape[1]
    read = command - state[:, :joints] if config.relative else command
    rows = torch.cat([state, read, payload], dim=1).double()
    center, scale = rows.mean(0).numpy(), rows.std(0).numpy()
    scale = np.where(scale > 1e-6, scale, 1.0)
    base = np.arange(2 * joints, 3 * joints)
    relative = np.full(3 * joints + 1, -1)
    if config.relative:
        relative[base] = np.arange(joints)
    network = build_network(config.network, inputs=3 * joints + 1, base=base.tolist(), rate_hz=rate_hz)
    out = np.full(joints, size)
    scaling = Scaling(center, scale, np.zeros(joints), out, out)
    return Corrector(network, scaling, base, target="residual", relative=relative)


def delta_of(corrector: Corrector, window: Tensor) -> Tensor:
    """Delta actions of the last of (past + 1, B, I) samples, (B, J)."""
    out: Tensor = corrector.network.run(corrector.read(window), (), None)[0][-1]
    return out * corrector.out_scale


def unrolled(corrector: Corrector, batch: Batch, start: Tensor, twin: Corrector | None = None) -> tuple[Tensor, Tensor]:
    """Errors and delta actions of a window in which the simulator goes its own way.

    Args:
        corrector: the network that is trained.
        batch: B windows of L control steps.
        start: how far from the measured states they begin, (B, 2J).
        twin: what makes the simulator the robot, whose commands are corrected then.

    Returns:
        simulated minus measured states, or minus those to follow, after each step, (L, B, 2J), and delta actions
        (L, B, J).
    """
    steps = len(batch.error)
    past = len(batch.command) - steps - 1
    earlier = max(past, twin.network.past if twin else 0)
    assert earlier == past, "windows hold the history of the network that looks back farthest"
    error, before = start, torch.zeros_like(batch.command[0])
    # Samples as the networks see them: state, command, payload. A twin sees commands as they have been corrected.
    seen = [torch.cat([batch.state[k], batch.command[k], batch.payload], -1) for k in range(past)]
    told = list(seen)
    errors, deltas = [], []
    for step in range(steps):
        row = past + step
        state = batch.state[row] + error
        seen.append(torch.cat([state, batch.command[row], batch.payload], -1))
        own = corrector.network.past
        delta = delta_of(corrector, torch.stack(seen[-own - 1 :]))
        moved = delta
        if twin is not None:
            told.append(torch.cat([state, batch.command[row] + delta, batch.payload], -1))
            moved = delta + delta_of(twin, torch.stack(told[-twin.network.past - 1 :]))
        push = torch.einsum("bsj,bj->bs", batch.c[step], moved)
        if batch.before is not None:
            push = push + torch.einsum("bsj,bj->bs", batch.before[step], before)
        error = batch.error[step] + torch.einsum("bst,bt->bs", batch.a[step], error) + push
        before = moved
        if batch.reference is None:
            errors.append(error)
        else:
            errors.append(batch.state[row + 1] + error - batch.reference[step + 1])
        deltas.append(delta)
    return torch.stack(errors), torch.stack(deltas)


def loss_of(errors: Tensor, deltas: Tensor, config: LossConfig) -> Tensor:
    """The mean over a window."""
    joints = deltas.shape[-1]
    sizes = errors.new_tensor([config.position_rad] * joints + [config.velocity_rad_s] * joints)
    far = config.linear_from
    scaled = errors / sizes
    # Squares near zero, straight lines far away: no motion in which a joint hits something decides for all others.
    cost = 2 * far**2 * ((1 + (scaled / far) ** 2).sqrt() - 1)
    total = cost.mean()
    if len(deltas) > 1:
        total = total + config.smoothness * ((deltas[1:] - deltas[:-1]) / config.position_rad).pow(2).mean()
    return total + config.size * (deltas / config.position_rad).pow(2).mean()


def train(
    corrector: Corrector,
    windows: Windows,
    config: CompensateConfig,
    *,
    seed: int = 0,
    twin: Corrector | None = None,
    wanted: Tensor | None = None,
    every: int = 100,
    report: Callable[[Progress], None] = lambda _: None,
) -> None:
    """Train in place.

    Args:
        corrector: with random weights, or those of an earlier training.
        windows: the train motions.
        config: loss and training.
        seed: of all draws.
        twin: see `unrolled`.
        wanted: delta actions of all samples of the windows, (M, J); for the way `delta`.
        every: how often `report` is called [updates].
        report: is told where it stands.
    """
    training, loss = config.training, config.loss
    generator = torch.Generator().manual_seed(seed)
    optimizer = torch.optim.Adam(corrector.parameters(), training.rate)
    joints = corrector.network.outputs
    sizes = torch.tensor([loss.position_rad] * joints + [loss.velocity_rad_s * 0.1] * joints)
    began = time.perf_counter()
    corrector.train()
    for update in range(training.updates):
        share = update / training.updates
        rate = (
            training.rate * min(1.0, (update + 1) / (_WARM * training.updates)) * 0.5 * (1 + math.cos(math.pi * share))
        )
        for group in optimizer.param_groups:
            group["lr"] = rate
        horizon = 1
        if training.way == "direct":
            horizon = round(min(training.horizon, _SHORTEST + (training.horizon - _SHORTEST) * share / _GROWN))
        size = training.batch * (1 if training.way == "direct" else training.horizon)
        starts = windows.starts(horizon)
        starts = starts[torch.randint(len(starts), (size,), generator=generator)]
        batch = windows.batch(starts, horizon)
        jolt = training.jolt * torch.randn(size, 2 * joints, generator=generator) * sizes
        if training.way == "delta":
            assert wanted is not None
            seen = torch.cat([batch.state, batch.command, batch.payload.expand(len(batch.state), -1, -1)], dim=-1)[
                : corrector.network.past + 1
            ]
            off = (delta_of(corrector, seen) - wanted[starts]) / loss.position_rad
            cost = nn.functional.huber_loss(off, torch.zeros_like(off), delta=loss.linear_from)
        else:
            cost = loss_of(*unrolled(corrector, batch, jolt.to(batch.error.device), twin), loss)
        if batch.sensors is not None and isinstance(corrector.network, Operator) and corrector.network.sensed:
            cost = cost + loss.sensors * _sensor_loss(corrector, batch)
        optimizer.zero_grad()
        cost.backward()
        nn.utils.clip_grad_norm_(corrector.parameters(), _CLIP)
        optimizer.step()
        if (update + 1) % every == 0:
            report(Progress(update + 1, float(cost), time.perf_counter() - began))
    corrector.eval()


def _sensor_loss(corrector: Corrector, batch: Batch) -> Tensor:
    """Eq. 7, on the measured states of one step of each window; sensors come in units of their spread."""
    network = corrector.network
    assert isinstance(network, Operator)
    assert batch.sensors is not None
    seen = torch.cat([batch.state, batch.command, batch.payload.expand(len(batch.state), -1, -1)], dim=-1)
    said = network.sensors(corrector.read(seen[: network.past + 1]))[-1]
    return (said - batch.sensors[0]).pow(2).mean()
