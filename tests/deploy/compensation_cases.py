"""Compensations with random weights, in model folders."""

from dataclasses import replace

import numpy as np
import torch

from trueup.augment.networks.operator import OperatorConfig
from trueup.compensate.compensation import Compensation, channels
from trueup.compensate.config import METHODS
from trueup.compensate.correctors import blank
from trueup.core.model_card import Input, ModelCard, Output

SMALL = OperatorConfig(hidden=(8, 8), features=3, trunk=(6, 6), sensors=2, predictor=(6,))


def compensation(
    folder,
    joints=("a", "b"),
    *,
    rate_hz=50.0,
    size=0.05,
    seed=0,
    reach=0.4,
    payload=(0.0, 3.0),
    network=SMALL,
    direction="robot",
    relative=True,
):
    """Saved; its corrections are of about `size`, and vary with all that it reads."""
    config = replace(METHODS["operator"], network=network, relative=relative)
    corrector = blank(config, len(joints), rate_hz, seed)
    torch.manual_seed(seed)
    for parameter in corrector.network.parameters():
        torch.nn.init.normal_(parameter, std=0.5 if parameter.ndim == 1 else parameter[0].numel() ** -0.5)
    corrector.out_scale.fill_(size)
    ends = {"velocity": (-4.0, 4.0), "payload": payload}
    command = (-reach, reach) if relative else (-3.0, 3.0)
    inputs = tuple(
        Input(
            channel.signal,
            channel.joint,
            channel.unit,
            channel.series,
            *(command if channel.series == "command" else ends.get(channel.signal, (-3.0, 3.0))),
            relative=relative and channel.series == "command",
        )
        for channel in channels(joints, ["rad"] * len(joints))
    )
    outputs = tuple(
        Output("position", joint, "rad", "command", base=2 * len(joints) + number)
        for number, joint in enumerate(joints)
    )
    card = ModelCard(
        name="made-up",
        method="operator",
        robot="made-up",
        joints=tuple(joints),
        run="mujoco/stock",
        rate_hz=rate_hz,
        causal=True,
        inputs=inputs,
        outputs=outputs,
        states=corrector.states,
        margin=0.25,
        provenance={"direction": direction, "config": {}},
    )
    folder.mkdir(parents=True, exist_ok=True)
    return Compensation(card, corrector, config).save(folder)


def asked(made, state, command, payload_kg):
    """What the network says of a whole motion, by torch: corrected commands, (T, J)."""
    rows = np.concatenate([state, command, np.full((len(state), 1), payload_kg)], axis=1).astype(np.float32)
    with torch.no_grad():
        return made.corrector(torch.from_numpy(rows)[:, None])[:, 0].numpy()
