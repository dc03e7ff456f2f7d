"""The weights of an operator network as its machine code reads them: scaled, merged, one layer after another."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

from trueup.core.model_card import ModelCard
from trueup.deploy.step_file import StepFile, packed, refusing
from trueup.errors import DataError


@dataclass(frozen=True, eq=False)
class OperatorWeights:
    """All that the machine code needs.

    Attributes:
        branch: units of its layers, the first of which reads all samples of the history and the present one.
        trunk: likewise, of the present one; its last layer is as wide as the branch's.
        flat: weight (rows are inputs) and bias of each layer of the branch, then of the trunk; last, what the sum of
            products of each output is multiplied by, (N,).
    """

    branch: tuple[int, ...]
    trunk: tuple[int, ...]
    flat: Float32[np.ndarray, "N"]

    @staticmethod
    def of(layers: Mapping[str, Sequence[tuple[np.ndarray, np.ndarray]]], scales: np.ndarray) -> OperatorWeights:
        """From the layers of `branch` and `trunk`, each a weight (in, out) and a bias."""
        widths = {name: (own[0][0].shape[0], *(weight.shape[1] for weight, _ in own)) for name, own in layers.items()}
        parts = [part.ravel() for name in ("branch", "trunk") for layer in layers[name] for part in layer]
        flat = np.concatenate([*parts, scales]).astype(np.float32)
        return OperatorWeights(widths["branch"], widths["trunk"], flat)

    def to_bytes(self) -> bytes:
        """The content of the file; the same for the same weights."""
        return packed({"branch": np.array(self.branch), "trunk": np.array(self.trunk), "flat": self.flat})

    @staticmethod
    def of_file(file: StepFile, card: ModelCard) -> OperatorWeights:
        """Those of a model folder.

        Raises:
            DataError: the file holds something else, or is of another network than the card's.
        """
        path = file.path
        with refusing(path):
            branch, trunk = (tuple(int(width) for width in file.arrays[name]) for name in ("branch", "trunk"))
            flat = file.arrays["flat"]
        inputs, outputs = len(card.inputs), len(card.outputs)
        samples = card.states[0].shape[0] + 1 if card.states else 1
        fits = (
            min(len(branch), len(trunk)) >= 2
            and min(*branch, *trunk) > 0
            and (branch[0], trunk[0]) == (samples * inputs, inputs)
            and branch[-1] == trunk[-1]
            and branch[-1] % outputs == 0
            and len(card.states) <= 1
            and all(state.start == "first" and state.shape[1:] == (1, inputs) for state in card.states)
        )
        if not fits:  # machine code does not look
            raise DataError(f"{path} is of another network than the card beside it", got=(branch, trunk))
        count = sum(before * after + after for own in (branch, trunk) for before, after in itertools.pairwise(own))
        if flat.dtype != np.float32 or flat.shape != (count + outputs,) or not np.isfinite(flat).all():
            raise DataError(f"{path} holds other weights than it says", got=flat.shape, expected=(count + outputs,))
        return OperatorWeights(branch, trunk, flat)
