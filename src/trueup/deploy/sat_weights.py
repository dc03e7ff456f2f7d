"""The weights of a state augmentation transformer as its machine code reads them: merged, scaled, one after another."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple, dataclass

import numpy as np
from jaxtyping import Float32

from trueup.core.model_card import ModelCard
from trueup.deploy.step_file import StepFile, packed, refusing
from trueup.errors import DataError

# Columns that the machine code takes at once.
_AT_ONCE = 16


def padded(columns: int) -> int:
    """So many columns that the machine code has no rest to do one by one; those that are too many are zero."""
    return -(-columns // _AT_ONCE) * _AT_ONCE


@dataclass(frozen=True)
class Sizes:
    """What decides about the shapes.

    Attributes:
        inputs: channels, I.
        stops: limits that are felt; the network reads `inputs + stops` numbers.
        outputs: channels, K.
        width: of all layers, W.
        heads: of the attention.
        history: samples that are seen besides the present one.
        own: 1 if the encoder is told what was predicted, 0 if nothing.
    """

    inputs: int
    stops: int
    outputs: int
    width: int
    heads: int
    history: int
    own: int

    @property
    def shapes(self) -> dict[str, tuple[int, int]]:
        """Shape of each matrix, in the order in which the machine code reads them."""
        width, inner, reads = self.width, self.width // self.heads, self.inputs + self.stops
        gate = {"weight": (width, 2 * width), "bias": (1, 2 * width), "norm": (2, width)}
        lstm = {"given": (width, 4 * width), "again": (width, 4 * width), "bias": (1, 4 * width)}
        groups: dict[str, dict[str, tuple[int, int]]] = {
            "read": {"scaling": (3, self.inputs), "stops": (3, self.stops)},
            "select_past": _selection(reads + self.outputs, width),
            "select_now": _selection(reads, width),
            "encoder": lstm,
            "decoder": lstm,
            "after_encoder": gate,
            "after_decoder": gate,
            "kept": {"weight": (width, width + inner), "bias": (1, width + inner)},
            "query": {"weight": (width, width), "bias": (1, width)},
            "attention": {"lag": (self.heads, self.history + 1)},
            "after_attention": {**gate, "weight": (inner, 2 * width)},
            "first": {"weight": (width, width), "bias": (1, width)},
            "process": gate,
            "last": gate,
            "dense": {"weight": (width, padded(self.outputs)), "bias": (1, padded(self.outputs))},
            "write": {"sum": (4, self.outputs)},
        }
        return {f"{group}.{name}": shape for group, own in groups.items() for name, shape in own.items()}


def _selection(variables: int, width: int) -> dict[str, tuple[int, int]]:
    return {
        "first": (variables, width),
        "first_bias": (1, width),
        "weigh": (width, 2 * padded(variables)),
        "weigh_bias": (1, 2 * padded(variables)),
        "weigh_norm": (2, variables),
        "spread": (variables, width),
        "offset": (variables, width),
        "inner": (variables * width, 2 * width),
        "inner_bias": (variables, 2 * width),
        "norm": (2, width),
    }


@dataclass(frozen=True, eq=False)
class SatWeights:
    """All that the machine code needs.

    Attributes:
        sizes: of the network.
        flat: the matrices of `sizes.shapes`, one after another, (N,).
    """

    sizes: Sizes
    flat: Float32[np.ndarray, "N"]

    @staticmethod
    def of(sizes: Sizes, parts: Mapping[str, np.ndarray]) -> SatWeights:
        """From matrices by their names.

        Raises:
            ValueError: names or shapes are others than those of `sizes.shapes`, or a number is not finite.
        """
        shapes = sizes.shapes
        found = {name: tuple(values.shape) for name, values in parts.items()}
        if found != shapes:
            wrong = sorted(name for name in {*found, *shapes} if found.get(name) != shapes.get(name))
            raise ValueError(f"the shapes of {wrong}")
        flat = np.concatenate([parts[name].ravel() for name in shapes]).astype(np.float32)
        if not np.isfinite(flat).all():
            raise ValueError("numbers that are not finite")
        return SatWeights(sizes, flat)

    def to_bytes(self) -> bytes:
        """The content of the file; the same for the same weights."""
        return packed({"sizes": np.array(astuple(self.sizes)), "flat": self.flat})

    @staticmethod
    def of_file(file: StepFile, card: ModelCard) -> SatWeights:
        """Those of a model folder.

        Raises:
            DataError: the file holds something else, or is of another network than the card's.
        """
        path = file.path
        with refusing(path):
            sizes, flat = Sizes(*(int(number) for number in file.arrays["sizes"])), file.arrays["flat"]
            count = sum(rows * columns for rows, columns in sizes.shapes.values())
        if flat.dtype != np.float32 or flat.shape != (count,) or not np.isfinite(flat).all():
            raise DataError(f"{path} holds other weights than it says", got=flat.shape, expected=(count,))
        if (
            min(astuple(sizes)) < 0
            or sizes.width % sizes.heads
            or not sizes.history
            or (sizes.inputs, sizes.outputs) != (len(card.inputs), len(card.outputs))
        ):
            raise DataError(
                f"{path} is of another network than the card beside it",
                got=f"{sizes.inputs} inputs, {sizes.outputs} outputs",
                expected=f"{len(card.inputs)} inputs, {len(card.outputs)} outputs",
            )
        made = SatWeights(sizes, flat)
        if not made.reads_what_is_there:  # machine code does not look
            raise DataError(f"{path} reads inputs that are not there", expected=f"0 to {sizes.inputs - 1}")
        return made

    @property
    def reads_what_is_there(self) -> bool:
        """Whether the channels that are read by number exist."""
        count = self.sizes.inputs
        other, stop, base = self._part("read.scaling")[2], self._part("read.stops")[0], self._part("write.sum")[0]
        return bool(
            np.all((other >= -1) & (other < count))
            and np.all((stop >= 0) & (stop < count))
            and np.all((base >= 0) & (base < count))
        )

    def _part(self, name: str) -> Float32[np.ndarray, "R C"]:
        at = 0
        for known, (rows, columns) in self.sizes.shapes.items():
            if known == name:
                return self.flat[at : at + rows * columns].reshape(rows, columns)
            at += rows * columns
        raise KeyError(name)
