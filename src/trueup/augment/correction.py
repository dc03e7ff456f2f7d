"""A simulated run after correction by a network, on the run's own clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32, Float64

from trueup.augment.channels import Grid, gather
from trueup.augment.components import ROTATION, number_of
from trueup.augment.rotations import rotation_of, six_of
from trueup.core.episode import Episode
from trueup.core.model_card import Channel, ModelCard
from trueup.core.timeseries import TimeSeries
from trueup.deploy.agreement import RATE_TOLERANCE
from trueup.errors import DataError, NameMismatch


@runtime_checkable
class Predict(Protocol):
    """Whole motions in SI through a network: N samples, B motions side by side, I inputs, K outputs."""

    def __call__(self, x: Float32[np.ndarray, "N B I"], /) -> Float32[np.ndarray, "N B K"]:
        """The corrected output channels, in the card's order."""
        ...


def corrected(episode: Episode, run: str, card: ModelCard, network: Predict) -> TimeSeries:
    """A run of an episode with the card's outputs corrected; everything else is as it was.

    What is added to the run's own values is the difference between output and corrected input, interpolated linearly
    where the network sees the motion on a clock of its own. A correction of zero changes no bit. What is added to the
    six numbers of a body's rotation makes a rotation again by Gram-Schmidt (SAT, V-A).

    Args:
        episode: with the run in it, in the joint names of the run.
        run: label.
        card: what the network takes and gives, on the joints or bodies of this run.
        network: maps the inputs to the corrected outputs.

    Raises:
        MissingSignal: the run, the command or a signal is not there.
        NameMismatch: joints of the network are missing.
        UnitError: a channel has another unit.
        DataError: the run has fewer samples per second than the network needs, or an input or output is not finite.
    """
    series = episode.run(run)
    refuse_other_joints((*series.joints, *series.bodies), card, f"the run {run!r}")
    refuse_slower(series, card, f"episode {episode.id!r}, {run}")
    grid = Grid.of(series.time_s, card.rate_hz)
    x = gather(episode, run, card.inputs, grid.time_s)
    _refuse_not_finite(x, card.inputs, grid, f"episode {episode.id!r}: an input of {card.name!r}")
    y = network(x[:, None, :])
    if y.shape != (len(x), 1, len(card.outputs)):
        raise DataError(
            f"the network {card.name!r} gives another number of values than its card says",
            got=y.shape,
            expected=(len(x), 1, len(card.outputs)),
        )
    y = y[:, 0]
    _refuse_not_finite(y, card.outputs, grid, f"episode {episode.id!r}: an output of {card.name!r}")
    added = grid.back(y - x[:, card.base], series.time_s)
    signals = dict(series.signals)
    for name in {output.quantity for output in card.outputs}:
        signals[name] = signals[name].copy()
    turned: dict[int, Float64[np.ndarray, "T 6"]] = {}
    for number, output in enumerate(card.outputs):
        values = signals[output.quantity]
        if not output.of_body:
            values[:, series.joints.index(output.joint)] += added[:, number]
            continue
        body, place = series.bodies.index(output.joint), number_of(output.signal)
        if output.quantity == ROTATION:
            turned.setdefault(body, np.zeros((len(series), 6)))[:, place] = added[:, number]
        else:
            values[:, body, place] += added[:, number]
    for body, six in turned.items():
        own = signals[ROTATION][:, body]
        rows = six.any(axis=1)
        own[rows] = rotation_of(six_of(own[rows]) + six[rows])
    return replace(series, signals=signals)


def refuse_other_joints(joints: Sequence[str], card: ModelCard, where: str) -> None:
    """Raise NameMismatch, with both lists, unless all joints of the network are there."""
    needed = dict.fromkeys(channel.joint for channel in (*card.inputs, *card.outputs))
    if not needed.keys() <= set(joints):
        raise NameMismatch(
            f"the network {card.name!r} is for other joints than {where}",
            left=needed,
            right=joints,
            left_name="it needs",
            right_name="there are",
            hint="A network corrects the kind of robot that it was trained for; train one for this robot.",
        )


def refuse_slower(series: TimeSeries, card: ModelCard, where: str) -> None:
    """Raise DataError if the network would see samples that nobody simulated."""
    if series.rate_hz < card.rate_hz * (1.0 - RATE_TOLERANCE):
        raise DataError(
            f"{where} has too few samples per second for the network {card.name!r}",
            got=f"{series.rate_hz:g} Hz",
            expected=f"at least {card.rate_hz:g} Hz",
            hint="Values between the samples would be guessed. Record faster, or train a network at this rate.",
        )


def _refuse_not_finite(values: Float32[np.ndarray, "N C"], channels: Sequence[Channel], grid: Grid, what: str) -> None:
    bad = ~np.isfinite(values)
    if bad.any():
        row, column = (int(index) for index in np.argwhere(bad)[0])
        time_s: Float64[np.ndarray, "N"] = grid.time_s
        raise DataError(f"{what} is not finite", got=f"{channels[column].name} at {time_s[row]:.3f} s")
