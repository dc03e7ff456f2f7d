"""Small SATs whose attention is known."""

from dataclasses import replace

import numpy as np
import torch

from augment.evaluation_cases import card_of
from trueup.augment import Augmentation, preset
from trueup.augment.corrector import Corrector
from trueup.augment.networks import build_network
from trueup.augment.networks.sat import SatConfig
from trueup.augment.scaling import Scaling, Stops

SAMPLES, HEADS = 8, 2


def sat_of(joints, *, lags=None, rate_hz=100.0, name="looker", **options):
    """A network that corrects the positions of these joints by next to nothing.

    Args:
        joints: names.
        lags: the score of each sample in each head, the oldest first, (HEADS, SAMPLES + 1), whatever the samples are;
            of attention that depends on samples if None.
        rate_hz: samples per second.
        name: of the network.
        options: of `SatConfig`.
    """
    network = SatConfig(**{"hidden": (8,), "heads": HEADS, "history": SAMPLES, "feedback": "zero", **options})
    config = preset("sat")
    config = replace(
        config,
        network=network,
        data=replace(config.data, modular=False, reads=(), command=(), blind=(), mirrored=False),
    )
    count = len(joints)
    torch.manual_seed(0)
    made = build_network(network, inputs=count, base=list(range(count)), rate_hz=rate_hz).eval()
    with torch.no_grad():
        made.dense.weight.normal_(std=0.01)
        if lags is not None:
            for part in (made.attention.query.weight, made.attention.query.bias):
                part.zero_()
            made.attention.lag.copy_(torch.as_tensor(np.asarray(lags)))
    zero, one = np.zeros(count), np.ones(count)
    blank = Scaling(zero, one, zero, one, one)
    corrector = Corrector(made, blank, np.arange(count), target="residual", stops=Stops.none())
    card = card_of(
        name,
        joints=joints,
        signals=("position",),
        rate_hz=rate_hz,
        method="sat",
        states=corrector.states,
        provenance={"config": config.to_json()},
    )
    return Augmentation(card, corrector.eval(), config)
