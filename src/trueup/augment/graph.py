"""ONNX graphs, node by node.

A traced export freezes what it saw (lengths of time axes, sizes of batches) without a word, and a step of a control
loop pays for every node of it. Graphs written by hand are small and mean the same at every length.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import onnx
from onnx import helper, numpy_helper

from trueup.deploy.operators import check_operators

_OPSET = 17
_IR_VERSION = 9  # read by every onnxruntime since 1.15


class Graph:
    """A graph under construction; values are known by their names."""

    def __init__(self) -> None:
        self._nodes: list[onnx.NodeProto] = []
        self._constants: list[onnx.TensorProto] = []
        self._inputs: list[onnx.ValueInfoProto] = []
        self._outputs: list[onnx.ValueInfoProto] = []

    def input(self, name: str, shape: Sequence[int | str]) -> str:
        """A float32 input; named axes may have any length."""
        self._inputs.append(helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, list(shape)))
        return name

    def output(self, value: str, name: str, shape: Sequence[int | str]) -> None:
        """Make a value a float32 output."""
        self._nodes.append(helper.make_node("Identity", [value], [name]))
        self._outputs.append(helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, list(shape)))

    def floats(self, values: Any) -> str:
        """A float32 constant."""
        return self._constant(np.asarray(values, np.float32))

    def integers(self, values: Any) -> str:
        """An int64 constant."""
        return self._constant(np.asarray(values, np.int64))

    def _constant(self, array: np.ndarray) -> str:
        name = f"constant{len(self._constants)}"
        self._constants.append(numpy_helper.from_array(np.ascontiguousarray(array), name))
        return name

    def add(self, operator: str, *inputs: str, **attributes: Any) -> str:
        """Append a node with one output."""
        return self.add_many(operator, inputs, 1, **attributes)[0]

    def add_many(self, operator: str, inputs: Sequence[str], outputs: int, **attributes: Any) -> tuple[str, ...]:
        """Append a node with several outputs."""
        names = tuple(f"value{len(self._nodes)}_{number}" for number in range(outputs))
        self._nodes.append(helper.make_node(operator, list(inputs), list(names), **attributes))
        return names

    def serialized(self, metadata: Mapping[str, str]) -> bytes:
        """The checked model.

        Raises:
            DataError: it has operators that are not run, see `deploy.operators`.
        """
        graph = helper.make_graph(self._without_identities(), "trueup", self._inputs, self._outputs, self._constants)
        model = helper.make_model(
            graph, opset_imports=[helper.make_opsetid("", _OPSET)], ir_version=_IR_VERSION, producer_name="trueup"
        )
        helper.set_model_props(model, dict(metadata))
        onnx.checker.check_model(model, full_check=True)
        data = bytes(model.SerializeToString())
        check_operators(data, "the exported graph")  # now, and not when somebody wants to run it
        return data

    def _without_identities(self) -> list[onnx.NodeProto]:
        """Outputs named at the node that makes them, where that node makes nothing else's output."""
        renamed: dict[str, str] = {}
        given = {value.name for value in self._inputs} | {constant.name for constant in self._constants}
        kept = []
        for node in self._nodes:
            if node.op_type == "Identity" and node.input[0] not in given and node.input[0] not in renamed:
                renamed[node.input[0]] = node.output[0]
            else:
                kept.append(node)
        for node in kept:
            for values in (node.input, node.output):
                for place, name in enumerate(values):
                    values[place] = renamed.get(name, name)
        return kept
