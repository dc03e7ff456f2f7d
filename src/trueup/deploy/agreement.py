"""What a control loop has must be what the network was trained on: rate, joints, units."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from trueup.core.model_card import ModelCard
from trueup.errors import ConfigError, NameMismatch, UnitError

# Rates that differ by no more are the same: 1000 Hz and a clock that is a little off. It is one number for training,
# evaluation and control loops: what one takes as the network's rate must not be refused by the next.
RATE_TOLERANCE = 0.01


def check_causal(card: ModelCard) -> None:
    """A control loop cannot wait for the future.

    Raises:
        ConfigError: the network looks into it.
    """
    if not card.causal:
        raise ConfigError(
            f"model {card.name!r} ({card.method}) looks into the future and cannot run in a control loop",
            hint="Take a causal one, e.g. of the method realeasy-rt; or correct what was simulated so far: "
            "deploy.History (Algorithm 1), or whole motions: deploy.Predictor.",
        )


def check_rate(card: ModelCard, rate_hz: float) -> None:
    """The loop runs at the network's rate.

    Raises:
        ConfigError: it does not.
    """
    if not (math.isfinite(rate_hz) and abs(rate_hz / card.rate_hz - 1) <= RATE_TOLERANCE):
        raise ConfigError(
            f"model {card.name!r} was trained at another rate",
            got=f"{rate_hz:g} Hz",
            expected=f"{card.rate_hz:g} Hz",
            hint=f"Call it {card.rate_hz:g} times a second, or train one for your rate.",
        )


def check_joints(card: ModelCard, joints: Sequence[str]) -> None:
    """The loop has the network's joints, in its order.

    Raises:
        NameMismatch: it has others, or in another order; both lists are printed.
    """
    if tuple(joints) != card.joints:
        same = sorted(joints) == sorted(card.joints)
        raise NameMismatch(
            f"joints of model {card.name!r} are {'in another order' if same else 'others'}",
            left=joints,
            right=card.joints,
            left_name="the loop has",
            right_name="the model needs",
        )


def check_units(card: ModelCard, units: Mapping[str, str | Sequence[str]]) -> None:
    """The loop's signals are in the network's units.

    Args:
        card: of the network.
        units: signal -> unit of all joints, or one per joint.

    Raises:
        UnitError: a unit differs, or that of a signal is not given.
    """
    for channel in card.inputs:
        if channel.series == "condition":
            continue
        if channel.signal not in units:
            raise UnitError(f"model {card.name!r} reads {channel.signal!r}, whose unit is not given", available=units)
        given = units[channel.signal]
        unit = given if isinstance(given, str) else dict(zip(card.joints, given, strict=False)).get(channel.joint)
        if unit != channel.unit:
            raise UnitError(
                f"model {card.name!r}: {channel.signal} of {channel.joint!r}",
                got=unit,
                expected=channel.unit,
                hint="Convert before the stream: it takes SI only.",
            )
