"""Training: what a network must add to commands so that the simulator moves like the robot, or the robot like it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from torch import Tensor, nn

from trueup.augment.corrector import Corrector
from trueup.augment.networks.operator import Operator
from trueup.compensate.config import CompensateConfig, LossConfig
from trueup.compensate.sensors import Sensors
from trueup.compensate.windows import Batch, Windows
from trueup.errors import DataError

# Share of the updates after which windows have their full length.
_GROWN = 0.4
_SHORTEST = 8
_WARM = 0.01
_CLIP = 1.0
# Velocities are known better than they must be met.
_JOLT = 0.1
# A linear model says nothing about states that are further from the measured ones [rad or m; per second].
_FARTHEST = (1.0, 20.0)


def delta_of(corrector: Corrector, window: Tensor) -> Tensor:
    """Delta actions of the last of (past + 1, B, I) samples, (B, J)."""
    out: Tensor = corrector.network.run(corrector.read(window), (), None)[0][-1]
    return out * corrector.out_scale


@runtime_checkable
class Simulate(Protocol):
    """B robots one control step on."""

    def __call__(
        self, payload: Tensor, state: Tensor, before: Tensor, command: Tensor, gravity: Tensor | None, /
    ) -> Tensor:
        """States one control step later, (B, 2J).

        Payloads (B, 1), states (B, 2J), commands (B, J) and those before; what pulls, (B, 3), None for a base at rest.
        """
        ...


def unrolled(
    corrector: Corrector,
    batch: Batch,
    start: Tensor,
    *,
    simulate: Simulate | None = None,
    twin: Corrector | None = None,
    sensors: Sensors | None = None,
) -> tuple[Tensor, Tensor]:
    """Errors and delta actions of a window in which the simulator goes its own way.

    Args:
        corrector: the network that is trained.
        batch: B windows of L control steps.
        start: how far from the measured states they begin, (B, 2J).
        simulate: where it goes; if None, the linear model says it. That model says in either case what changes of
            commands and states do to it: a simulator with dry friction moves by jumps, which nothing learns from.
        twin: what makes the simulator the robot, whose commands are corrected then.
        sensors: of an operator that is told what they say, by the linear model.

    Returns:
        simulated minus measured states, or minus those to follow, after each step, (L, B, 2J), and delta actions
        (L, B, J).
    """
    steps = len(batch.error)
    past = len(batch.command) - steps - 1
    earlier = max(past, twin.network.past if twin else 0)
    assert earlier == past, "windows hold the history of the network that looks back farthest"
    error, before = start, torch.zeros_like(batch.command[0])
    sent = batch.command[past - 1] if past else batch.command[0]
    most = torch.tensor(_FARTHEST, device=start.device).repeat_interleave(before.shape[-1])
    # Samples as the networks see them: state, command, payload. A twin sees commands as they have been corrected.
    told = [torch.cat([batch.state[k], batch.command[k], batch.payload], -1) for k in range(past)]
    # Of the past, an operator that is told what sensors say reads nothing.
    nothing = [] if sensors is None else [before.new_zeros(len(before), sensors.center.numel())]
    seen = [torch.cat([sample, *nothing], -1) for sample in told]
    errors, deltas = [], []
    for step in range(steps):
        row = past + step
        state = batch.state[row] + error
        said = [] if sensors is None else [sensors.values(batch, step, state, error)]
        seen.append(torch.cat([state, batch.command[row], batch.payload, *said], -1))
        own = corrector.network.past
        delta = delta_of(corrector, torch.stack(seen[-own - 1 :]))
        moved = delta
        if twin is not None:
            told.append(torch.cat([state, batch.command[row] + delta, batch.payload], -1))
            moved = delta + delta_of(twin, torch.stack(told[-twin.network.past - 1 :]))
        change = torch.einsum("bst,bt->bs", batch.a[step], error) + torch.einsum("bsj,bj->bs", batch.c[step], moved)
        if batch.before is not None:
            change = change + torch.einsum("bsj,bj->bs", batch.before[step], before)
        if simulate is None:
            error = batch.error[step] + change
        else:
            with torch.no_grad():
                command = batch.command[row] + moved
                pull = None if batch.gravity is None else batch.gravity[step]
                there = simulate(batch.payload, state, sent, command, pull) - batch.state[row + 1]
                sent = command
            error = there + change - change.detach()
        error, before = torch.clamp(error, -most, most), moved
        if batch.reference is None:
            errors.append(error)
        else:
            errors.append(batch.state[row + 1] + error - batch.reference[step + 1])
        deltas.append(delta)
    return torch.stack(errors), torch.stack(deltas)


def loss_of(errors: Tensor, deltas: Tensor, config: LossConfig, signal: str = "position") -> Tensor:
    """The mean over a window; delta actions are of commanded positions or torques."""
    action = config.action(signal)
    joints = deltas.shape[-1]
    sizes = errors.new_tensor([config.position_rad] * joints + [config.velocity_rad_s] * joints)
    total = config.cost((errors / sizes / config.linear_from) ** 2).mean()
    if len(deltas) > 1:
        total = total + config.smoothness * ((deltas[1:] - deltas[:-1]) / action).pow(2).mean()
    return total + config.size * (deltas / action).pow(2).mean()


@dataclass(frozen=True, eq=False)
class Teacher:
    """What a network learns from.

    Attributes:
        windows: the train motions.
        config: loss and training.
        simulate: see `unrolled`.
        twin: likewise.
        sensors: what an operator's sensor predictor learns.
        told: what an operator that has none is told, window by window.
        wanted: delta actions of all samples of the windows, (M, J); for the way `delta`.
        signal: of the commands, `position` or `torque`.
    """

    windows: Windows
    config: CompensateConfig
    simulate: Simulate | None = None
    twin: Corrector | None = None
    sensors: Sensors | None = None
    told: Sensors | None = None
    wanted: Tensor | None = None
    signal: str = "position"

    def train(
        self, corrector: Corrector, optimizer: torch.optim.Optimizer, *, done: int, count: int, seed: Sequence[int]
    ) -> float:
        """Some updates in place; returns the mean loss, NaN if the simulator diverged in all of them.

        Args:
            corrector: the network.
            optimizer: of its weights.
            done: updates before these.
            count: number of updates.
            seed: of their draws.
        """
        generator = torch.Generator().manual_seed(int(np.random.SeedSequence(seed).generate_state(1)[0]))
        corrector.train()
        total: list[float] = []
        for update in range(done, done + count):
            for group in optimizer.param_groups:
                group["lr"] = self._rate(update)
            try:
                cost = self._cost(corrector, update, generator)
            except DataError:  # what the network has added blew the simulation up; other windows teach it better
                continue
            optimizer.zero_grad()
            cost.backward()  # type: ignore[no-untyped-call]
            if torch.isfinite(nn.utils.clip_grad_norm_(corrector.parameters(), _CLIP)):
                optimizer.step()
            total.append(float(cost.detach()))
        corrector.eval()
        return float(np.mean(total)) if total else math.nan

    def sensor_cost(self, corrector: Corrector, generator: torch.Generator) -> Tensor:
        """Eq. 7 alone, over one draw of samples; zero where nothing is predicted."""
        if self.sensors is None:
            return torch.zeros(())
        starts = self.windows.starts(1)
        batch = self.windows.batch(
            starts[torch.randint(len(starts), (self.config.training.batch,), generator=generator)], 1
        )
        return self._sensor_cost(corrector, batch)

    def _sensor_cost(self, corrector: Corrector, batch: Batch) -> Tensor:
        if self.sensors is None:
            return torch.zeros(())
        return self.config.loss.sensors * _sensor_loss(corrector, batch, self.sensors)

    def _rate(self, update: int) -> float:
        training = self.config.training
        share = update / training.updates
        rise = min(1.0, (update + 1) / (_WARM * training.updates))
        return training.rate * rise * 0.5 * (1 + math.cos(math.pi * share))

    def _cost(self, corrector: Corrector, update: int, generator: torch.Generator) -> Tensor:
        training, loss, joints = self.config.training, self.config.loss, corrector.network.outputs
        # As many samples in each batch, whichever way.
        horizon, count = 1, training.batch * training.horizon
        if training.way == "direct":
            grown = min(1.0, update / (_GROWN * training.updates))
            horizon = round(min(training.horizon, _SHORTEST) + max(0, training.horizon - _SHORTEST) * grown)
            count = training.batch
        starts = self.windows.starts(horizon)
        starts = starts[torch.randint(len(starts), (count,), generator=generator)]
        batch = self.windows.batch(starts, horizon)
        if training.way == "delta":
            assert self.wanted is not None
            seen = _seen(batch)[: corrector.network.past + 1]
            off = (delta_of(corrector, seen) - self.wanted[starts]) / loss.action(self.signal)
            cost = nn.functional.huber_loss(off, torch.zeros_like(off), delta=loss.linear_from)
        else:
            sizes = torch.tensor([loss.position_rad] * joints + [_JOLT * loss.velocity_rad_s] * joints)
            start = training.jolt * torch.randn(count, 2 * joints, generator=generator) * sizes
            if batch.reference is not None:
                # A robot that is compensated is somewhere between where it was without and where it should be.
                way = torch.rand(count, 1, generator=generator)
                start = start + way * (batch.reference[0] - batch.state[self.windows.past])
            errors, deltas = unrolled(
                corrector,
                batch,
                start.to(batch.error.device),
                simulate=self.simulate,
                twin=self.twin,
                sensors=self.told,
            )
            cost = loss_of(errors, deltas, loss, self.signal)
        return cost + self._sensor_cost(corrector, batch)


def _sensor_loss(corrector: Corrector, batch: Batch, sensors: Sensors) -> Tensor:
    """Eq. 7, on the measured state that each window begins with."""
    network = corrector.network
    assert isinstance(network, Operator)
    said = network.sensors(corrector.read(_seen(batch)[: network.past + 1]))[-1]
    true = sensors.values(batch, 0, batch.state[network.past], torch.zeros_like(batch.error[0]))
    return (said - true).pow(2).mean()


def _seen(batch: Batch) -> Tensor:
    """Measured samples as networks read them, (past + L + 1, B, I)."""
    payload = batch.payload.expand(len(batch.state), -1, -1)
    return torch.cat([batch.state, batch.command, payload], dim=-1)
