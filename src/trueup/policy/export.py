"""A policy's network as an ONNX graph with a card, for `deploy.Policy`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from torch import nn

from trueup.augment.graph import Graph
from trueup.core.atomic import make_folder, replacing
from trueup.core.policy_card import POLICY_GRAPH, PolicyCard
from trueup.errors import ConfigError, needing
from trueup.policy.reaching import Reaching

with needing("exporting a policy", "rl"):
    from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm


def export(
    learner: OffPolicyAlgorithm,
    reaching: Reaching,
    folder: Path,
    *,
    name: str,
    robot: str,
    provenance: Mapping[str, Any],
    description: str = "",
) -> PolicyCard:
    """Write a policy's folder; the card last.

    Args:
        learner: with the trained networks.
        reaching: the episodes that it was trained in.
        folder: of the policy.
        name: of the policy.
        robot: name of the kind of robot.
        provenance: versions, seed, configuration, and what the training did.
        description: for people.

    Raises:
        ConfigError: the policy's network has a layer that is not known here.
        DataError: the folder cannot be written.
    """
    make_folder(folder)
    graph = graph_of(learner, reaching.most)
    with replacing(folder / POLICY_GRAPH) as temporary:
        temporary.write_bytes(graph)
    return PolicyCard(
        name=name,
        robot=robot,
        joints=reaching.arms.joints,
        rate_hz=reaching.config.control_hz,
        torque_nm=tuple(float(torque) for torque in reaching.most),
        kinematics=reaching.workspace.chain.kinematics,
        site=reaching.config.site,
        description=description,
        provenance=provenance,
    ).save(folder)


def graph_of(learner: OffPolicyAlgorithm, most: np.ndarray) -> bytes:
    """The policy without its draws: what is seen (N, O) -> torques (N, J) [Nm]."""
    actor: Any = learner.policy.actor
    # SAC and TQC have a head for the mean, whose draws are squashed; TD3 and DDPG end in a tanh themselves.
    drawn = hasattr(actor, "latent_pi")
    layers = [*actor.latent_pi, actor.mu, nn.Tanh()] if drawn else [*actor.mu]
    graph = Graph()
    width = next(layer.in_features for layer in layers if isinstance(layer, nn.Linear))
    value = graph.input("seen", ("N", width))
    value = graph.add("Mul", value, graph.floats(actor.features_extractor.scale.detach().cpu().numpy()))
    for layer in layers:
        match layer:
            case nn.Linear():
                weight, bias = (graph.floats(part.detach().cpu().numpy()) for part in (layer.weight.T, layer.bias))
                value = graph.add("Add", graph.add("MatMul", value, weight), bias)
            case nn.ReLU():
                value = graph.add("Relu", value)
            case nn.Tanh():
                value = graph.add("Tanh", value)
            case _:
                raise ConfigError("a layer of a policy that is not known here", got=type(layer).__name__)
    graph.output(graph.add("Mul", value, graph.floats(most)), "torque", ("N", len(most)))
    return graph.serialized({})
