"""Networks, by the names that a configuration gives them."""

from collections.abc import Sequence

from trueup.augment.config import NetworkConfig
from trueup.augment.networks.base import Network as Network
from trueup.augment.networks.recurrent import Recurrent as Recurrent
from trueup.augment.networks.windowed import MovingAverage as MovingAverage
from trueup.augment.networks.windowed import Perceptron as Perceptron
from trueup.augment.networks.windowed import Transformer as Transformer

__all__ = ["MovingAverage", "Network", "Perceptron", "Recurrent", "Transformer", "build_network"]


def build_network(config: NetworkConfig, *, inputs: int, base: Sequence[int], rate_hz: float = 100.0) -> Network:
    """The network of a configuration, with random weights.

    Args:
        config: kind and sizes.
        inputs: number of input channels.
        base: for each output channel the input that it corrects.
        rate_hz: samples per second, for windows that are given in seconds.
    """
    history = config.samples(rate_hz)
    tanh = config.output_activation == "tanh"
    if config.kind in ("lstm", "gru"):
        return Recurrent(
            inputs,
            len(base),
            cell="lstm" if config.kind == "lstm" else "gru",
            hidden=config.hidden,
            bidirectional=config.bidirectional,
            input_dropout=config.input_dropout,
            recurrent_dropout=config.recurrent_dropout,
            tanh=tanh,
        )
    if config.kind == "moving-average":
        return MovingAverage(inputs, base, history=history, centered=config.bidirectional)
    if config.kind == "transformer":
        return Transformer(
            inputs,
            len(base),
            width=config.hidden[0],
            depth=len(config.hidden),
            heads=config.heads,
            history=history,
            input_dropout=config.input_dropout,
            tanh=tanh,
        )
    return Perceptron(
        inputs,
        len(base),
        hidden=config.hidden,
        history=history,
        input_dropout=config.input_dropout,
        tanh=tanh,
    )
