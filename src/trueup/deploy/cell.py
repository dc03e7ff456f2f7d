"""A causal network on one stream: a graph in onnxruntime, or machine code where its folder has what that needs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import astuple
from importlib import import_module
from typing import Any

import numpy as np
from jaxtyping import Float32

from trueup.deploy.network import Network
from trueup.deploy.operator_weights import OperatorWeights
from trueup.deploy.sat_weights import SatWeights, padded
from trueup.errors import DataError

# onnxruntime plans its memory in the first run; the control loop shall not wait for that.
_REHEARSALS = 20


class Cell(ABC):
    """One sample in, one out, and no array made.

    Args:
        network: a causal network.

    Attributes:
        x: the input channels, to be written before a run, (I,); of a modular network joint after joint.
        y: the output channels of the last run, (K,).
    """

    def __init__(self, network: Network) -> None:
        card = network.card
        self.x: Float32[np.ndarray, "I"] = np.zeros(len(card.inputs), np.float32)
        self.y: Float32[np.ndarray, "K"] = np.zeros(len(card.outputs), np.float32)
        self._copies = card.copies
        self._finite = np.ones(len(card.outputs), bool)
        self._all = self._finite.tobytes()

    @staticmethod
    def of(network: Network, *, compiled: bool) -> Cell:
        """As machine code, where that is asked for and the network has it."""
        if compiled and network.step is not None:
            if isinstance(network.step, OperatorWeights):
                return OperatorCell(network, network.step)
            return MachineCell(network, network.step)
        return GraphCell(network)

    @abstractmethod
    def start(self) -> None:
        """Put the states to where they are before the first sample, which is in `x`."""

    @abstractmethod
    def run(self) -> bool:
        """From `x` and the states to `y` and the states after this sample; whether all of `y` is finite."""

    def rehearse(self, x: Float32[np.ndarray, "I"]) -> None:
        """Run a few times on a sample, and start anew.

        Raises:
            DataError: the network cannot be run, or its output is not finite.
        """
        self.x[:] = x
        self.start()
        try:
            finite = [self.run() for _ in range(_REHEARSALS)]
        except Exception as error:  # onnxruntime has a class of its own for each of its codes, with no common base
            raise DataError("the network cannot be run", got=error) from error
        if not all(finite):
            raise DataError("the network's output is not finite in the middle of its own training range")
        self.start()


class GraphCell(Cell):
    """By onnxruntime.

    A run reads one set of states and writes the other; the next run has them the other way around. Both ways are bound
    beforehand.
    """

    def __init__(self, network: Network) -> None:
        super().__init__(network)
        card = network.card
        self._specs = card.states
        first = np.zeros((self._copies, self.x.size // self._copies))
        # The bindings hold addresses only: these arrays, x and y must live as long as they do.
        self._states = [{state.name: state.initial(first) for state in card.states} for _ in range(2)]
        self._session = network.session
        self._bindings = [self._bound(*self._states), self._bound(*self._states[::-1])]
        self._turn = 0

    def start(self) -> None:
        """See `Cell.start`."""
        for state in self._specs:
            # Broadcast over the rows of a buffer that begins full of the first sample.
            first = self.x.reshape(self._copies, -1)
            self._states[0][state.name][...] = first if state.start == "first" else 0.0
        self._turn = 0

    def run(self) -> bool:
        """See `Cell.run`."""
        self._session.run_with_iobinding(self._bindings[self._turn])
        self._turn ^= 1
        np.isfinite(self.y, self._finite)
        # Comparing bytes takes a fifth of the time of `all()`.
        return self._finite.tobytes() == self._all

    def _bound(self, before: dict[str, np.ndarray], after: dict[str, np.ndarray]) -> Any:
        binding = self._session.io_binding()

        def bind(place: Any, name: str, tensor: np.ndarray, shape: tuple[int, ...]) -> None:
            place(name, "cpu", 0, np.float32, shape, tensor.ctypes.data)

        for place, name, values in ((binding.bind_input, "x", self.x), (binding.bind_output, "y", self.y)):
            bind(place, name, values, (1, self._copies, values.size // self._copies))
        for name, tensor in before.items():
            bind(binding.bind_input, name, tensor, tensor.shape)
            bind(binding.bind_output, f"{name}_out", after[name], tensor.shape)
        return binding


class MachineCell(Cell):
    """A state augmentation transformer by `sat_machine`: keys and values of the past stay where they are.

    The first one on a machine waits until the code is compiled; the next processes find it on disk.
    """

    def __init__(self, network: Network, weights: SatWeights) -> None:
        super().__init__(network)
        sizes, copies = weights.sizes, self._copies
        inner = sizes.width // sizes.heads
        self._advance = import_module("trueup.deploy.sat_machine").advance
        self._history = sizes.history
        shapes = (
            (copies, sizes.outputs),
            (copies, sizes.inputs + sizes.stops),
            (2, copies, sizes.width),
            (copies, sizes.heads, inner, padded(sizes.history)),
            (copies, padded(sizes.history), inner),
        )
        self._states = tuple(np.zeros(shape, np.float32) for shape in shapes)
        rows = (self.x.reshape(copies, -1), self.y.reshape(copies, -1))
        self._given = (*rows, weights.flat, astuple(sizes))
        self._place = 0

    def start(self) -> None:
        """See `Cell.start`."""
        for values in self._states:
            values.fill(0.0)
        self._place = 0

    def run(self) -> bool:
        """See `Cell.run`."""
        place = self._place
        self._advance(*self._given, place, *self._states)
        self._place = place + 1 if place + 1 < self._history else 0
        np.isfinite(self.y, self._finite)
        return self._finite.tobytes() == self._all


class OperatorCell(Cell):
    """An operator network by `operator_machine`; compiled and kept as the code of `MachineCell`."""

    def __init__(self, network: Network, weights: OperatorWeights) -> None:
        super().__init__(network)
        machine = import_module("trueup.deploy.operator_machine")
        self._advance = machine.advance
        self._seen = np.zeros(weights.branch[0], np.float32)
        widths = (np.array(weights.branch), np.array(weights.trunk))
        self._given = (weights.flat, *widths, np.array(network.card.base), machine.buffers_for(*widths))

    def start(self) -> None:
        """See `Cell.start`."""
        self._seen.reshape(-1, self.x.size)[:] = self.x

    def run(self) -> bool:
        """See `Cell.run`."""
        self._advance(self.x, self.y, self._seen, *self._given)
        np.isfinite(self.y, self._finite)
        return self._finite.tobytes() == self._all
