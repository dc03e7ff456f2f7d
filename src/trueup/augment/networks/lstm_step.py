"""One step of an LSTM whose states are at hand: in torch, as nodes of a graph, and as weights for machine code.

torch's own runs over whole motions and keeps the last cell only; a SAT's decoder begins at each sample with the
encoder's.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from trueup.augment.graph import Graph
from trueup.augment.networks.recurrent import onnx_weights


def gates(lstm: nn.LSTM, x: Tensor, hidden: Tensor) -> tuple[Tensor, ...]:
    """Input gate, forget gate, candidate and output gate of samples (T, B, W) after these hidden states."""
    weights = nn.functional.linear(x, lstm.get_parameter("weight_ih_l0"), lstm.get_parameter("bias_ih_l0"))
    weights = weights + nn.functional.linear(
        hidden, lstm.get_parameter("weight_hh_l0"), lstm.get_parameter("bias_hh_l0")
    )
    # With mixed precision, the sum over a whole motion that a cell is would lose what is small.
    weights = weights.to(torch.promote_types(weights.dtype, torch.float32))
    entry, forget, candidate, out = weights.chunk(4, dim=-1)
    return entry.sigmoid(), forget.sigmoid(), candidate.tanh(), out.sigmoid()


def stepped(lstm: nn.LSTM, x: Tensor, hidden: Tensor, cell: Tensor) -> tuple[Tensor, Tensor]:
    """Hidden states and cells one sample later; each of the T samples for itself."""
    entry, forget, candidate, out = gates(lstm, x, hidden)
    cell = forget * cell + entry * candidate
    return out * cell.tanh(), cell


def draw_step(graph: Graph, lstm: nn.LSTM, x: str, hidden: str, cell: str) -> tuple[str, str]:
    """Hidden state and cell (1, B, W) after one sample (B, W)."""
    given = [graph.floats(part.numpy()[None]) for part in onnx_weights(lstm, "lstm")]
    row = graph.add("Unsqueeze", x, graph.integers([0]))
    made = graph.add_many("LSTM", [row, *given, "", hidden, cell], 3, hidden_size=lstm.hidden_size)
    return made[1], made[2]


def step_weights_of(lstm: nn.LSTM) -> dict[str, Tensor]:
    """As the machine code of `deploy.sat_machine` reads them."""
    given, again, first, second = (
        lstm.get_parameter(name) for name in ("weight_ih_l0", "weight_hh_l0", "bias_ih_l0", "bias_hh_l0")
    )
    return {"given": given.T, "again": again.T, "bias": (first.double() + second.double())[None]}
