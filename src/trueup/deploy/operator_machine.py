"""One sample through an operator network, as machine code; see `sat_machine`, whose layers these are."""

from __future__ import annotations

from typing import Any

import numpy as np

from trueup.deploy.sat_machine import _bend, _f, _layer, _machine, _taken


@_machine
def _chain(x: Any, flat: Any, at: Any, widths: Any, one: Any, two: Any) -> Any:
    """Dense layers with ELU between them, in two buffers that take turns; their output, and where their weights end."""
    for layer in range(1, widths.size):
        width = widths[layer]
        made = (one if layer % 2 else two)[:width].reshape((1, width))
        if layer > 1:
            _bend(x)
        at = _layer(x, flat, at, made)
        x = made
    return x, at


@_machine
def advance(raw: Any, corrected: Any, seen: Any, flat: Any, branch: Any, trunk: Any, base: Any, buffers: Any) -> Any:
    """One sample.

    Args:
        raw: inputs, SI, (I,).
        corrected: outputs, SI, (K,).
        seen: samples of the history, the oldest first, then the latest, one after another; this one is added, ((past +
            1) I,).
        flat: see `operator_weights`.
        branch: units of its layers.
        trunk: likewise.
        base: number of the input that each output corrects, (K,).
        buffers: for two layers of either, (4, widest).
    """
    inputs, outputs = raw.size, corrected.size
    before = seen.size - inputs
    for j in range(before):
        seen[j] = seen[j + inputs]
    for j in range(inputs):
        seen[before + j] = raw[j]
    one, at = _chain(seen.reshape((1, seen.size)), flat, 0, branch, buffers[0], buffers[1])
    two, at = _chain(raw.reshape((1, inputs)), flat, at, trunk, buffers[2], buffers[3])
    scales, at = _taken(flat, at, 1, outputs)
    features = one.shape[1] // outputs
    for k in range(outputs):
        total = _f(0.0)
        for j in range(k * features, (k + 1) * features):
            total += one[0, j] * two[0, j]
        corrected[k] = raw[base[k]] + scales[0, k] * total
    return at


def buffers_for(branch: Any, trunk: Any) -> Any:
    """Room for the layers."""
    return np.zeros((4, max(*branch[1:], *trunk[1:])), np.float32)
