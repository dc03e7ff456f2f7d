"""Networks with random weights, written as the model folders that training exports; for benchmarks and tests."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from trueup.core.model_card import CARD_NAME, ONNX_NAME, Channel, Input, ModelCard, Output, State

JOINTS = tuple(f"joint{number + 1}" for number in range(7))
UNITS = {"position": "rad", "velocity": "rad/s", "torque": "Nm"}
REACH = {"position": 2.5, "velocity": 2.0, "torque": 50.0}
RATE_HZ = 1000.0
HIDDEN = 100


def inputs_of(joints: Sequence[str] = JOINTS, *, command: bool = False) -> tuple[Input, ...]:
    """Position, velocity and torque of each joint, and the commanded position if asked for."""
    simulated = [
        Input(signal, joint, unit, low=-REACH[signal], high=REACH[signal])
        for signal, unit in UNITS.items()
        for joint in joints
    ]
    commanded = [Input("position", joint, "rad", "command", low=-2.5, high=2.5) for joint in joints]
    return (*simulated, *(commanded if command else []))


def outputs_of(joints: Sequence[str] = JOINTS) -> tuple[Output, ...]:
    """Every simulated signal of `inputs_of` is corrected; the intervals differ from output to output."""
    channels = [Channel(signal, joint, unit) for signal, unit in UNITS.items() for joint in joints]
    return tuple(
        Output(
            *(channel.signal, channel.joint, channel.unit, channel.series),
            base=number,
            interval=(0.1 + 0.01 * number, 0.5),
            far=1.0,
            far_correction=(0.0, 0.5, 2.0),
            far_probability=(0.0, 0.2, 1.0),
        )
        for number, channel in enumerate(channels)
    )


def card_of(**changes: object) -> ModelCard:
    """The card of a real-time network of the Panda."""
    card = ModelCard(
        name="random-rt",
        method="realeasy-rt",
        robot="panda",
        joints=JOINTS,
        run="mujoco/stock",
        rate_hz=RATE_HZ,
        causal=True,
        inputs=inputs_of(),
        outputs=outputs_of(),
        warmup_steps=5,
    )
    return replace(card, **changes)


class Graph:
    """Nodes and weights of an ONNX graph whose result is `x + gate * correction`, everything in SI."""

    def __init__(self, card: ModelCard, seed: int, states: Sequence[State]) -> None:
        self.rng = np.random.default_rng(seed)
        self.card = card
        self.nodes: list[onnx.NodeProto] = []
        self.weights: list[onnx.TensorProto] = []
        ranges = np.array([(channel.low, channel.high) for channel in card.inputs], np.float32)
        self.add("Sub", ["x", self.constant("center", ranges.mean(axis=1))], "offset")
        self.add("Mul", ["offset", self.constant("scale", 2 / np.ptp(ranges, axis=1))], "normal")
        self.states = tuple(states)

    def constant(self, name: str, value: np.ndarray) -> str:
        """A named constant."""
        kind = np.int64 if value.dtype.kind == "i" else np.float32
        self.weights.append(numpy_helper.from_array(np.ascontiguousarray(value, kind), name))
        return name

    def random(self, name: str, *shape: int, size: float = 0.3) -> str:
        """A constant of normal draws."""
        return self.constant(name, size * self.rng.standard_normal(shape))

    def add(self, kind: str, inputs: Sequence[str], *outputs: str, **attributes: object) -> str:
        """A node; returns its first output."""
        self.nodes.append(helper.make_node(kind, list(inputs), list(outputs), **attributes))
        return outputs[0]

    def finish(self, hidden: str, width: int) -> onnx.ModelProto:
        """Dense layer, scale to SI, and the sum with what is corrected."""
        bases = self.card.base
        self.add("MatMul", [hidden, self.random("dense", width, len(bases))], "product")
        self.add("Add", ["product", self.random("bias", len(bases))], "sum")
        reach = np.array([self.card.inputs[base].high for base in bases])
        self.add("Mul", ["sum", self.constant("gate", 0.2 * reach)], "correction")
        self.add("Gather", ["x", self.constant("bases", bases)], "base", axis=2)
        self.add("Add", ["base", "correction"], "y")

        def tensor(name: str, shape: Sequence[int | str]) -> onnx.ValueInfoProto:
            return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)

        shapes = {
            state.name: ["B" if axis == state.batch_axis else size for axis, size in enumerate(state.shape)]
            for state in self.states
        }
        graph = helper.make_graph(
            self.nodes,
            "network",
            [tensor("x", ["T", "B", len(self.card.inputs)]), *(tensor(*item) for item in shapes.items())],
            [
                tensor("y", ["T", "B", len(bases)]),
                *(tensor(f"{name}_out", shape) for name, shape in shapes.items()),
            ],
            self.weights,
        )
        return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)


@dataclass(frozen=True)
class Made:
    """A folder with a network in it, and its card as written."""

    folder: Path
    card: ModelCard


def written(folder: Path, card: ModelCard, model: onnx.ModelProto) -> Made:
    """The model folder."""
    onnx.checker.check_model(model)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / ONNX_NAME).write_bytes(model.SerializeToString())
    return Made(folder, card.save(folder))


def real_time(folder: Path, *, hidden: int = HIDDEN, seed: int = 0, **changes: object) -> Made:
    """Two LSTM layers and a dense one, as Realeasy's real-time network."""
    states = [State(name, (1, 1, hidden)) for name in ("h0", "c0", "h1", "c1")]
    card = card_of(states=tuple(states), **changes)
    graph = Graph(card, seed, states)
    below, width = "normal", len(card.inputs)
    for layer in range(2):
        weights = [
            graph.random(f"W{layer}", 1, 4 * hidden, width, size=0.2),
            graph.random(f"R{layer}", 1, 4 * hidden, hidden, size=0.1),
            graph.random(f"B{layer}", 1, 8 * hidden, size=0.1),
        ]
        sequence = graph.add(
            *("LSTM", [below, *weights, "", f"h{layer}", f"c{layer}"]),
            *(f"all{layer}", f"h{layer}_out", f"c{layer}_out"),
            hidden_size=hidden,
        )
        below = graph.add("Squeeze", [sequence, graph.constant(f"axis{layer}", np.array([1]))], f"hidden{layer}")
        width = hidden
    return written(folder, card, graph.finish(below, hidden))


def window(folder: Path, *, past: int = 4, hidden: int = 16, seed: int = 0, **changes: object) -> Made:
    """A layer over the current sample and the `past` ones before it, which it keeps as a buffer of inputs."""
    width = len(changes.get("inputs", inputs_of()))
    state = State("buffer", (past, 1, width), start="first")
    card = card_of(**{"states": (state,), "warmup_steps": past, "method": "mlp", **changes})
    graph = Graph(card, seed, [state])
    offset = graph.add("Sub", ["buffer", "center"], "buffer_offset")
    normal = graph.add("Mul", [offset, "scale"], "buffer_normal")
    graph.add("Concat", [normal, "normal"], "seen", axis=0)
    graph.add("Transpose", ["seen"], "columns", perm=[1, 2, 0])
    graph.add("Conv", ["columns", graph.random("kernel", hidden, width, past + 1)], "features")
    graph.add("Tanh", ["features"], "bent")
    graph.add("Transpose", ["bent"], "rows", perm=[2, 0, 1])
    graph.add("Concat", ["buffer", "x"], "both", axis=0)
    ends = [graph.constant(name, np.array([value])) for name, value in (("from", -past), ("to", 2**40), ("along", 0))]
    graph.add("Slice", ["both", *ends], "buffer_out")
    return written(folder, card, graph.finish("rows", hidden))


def bidirectional(folder: Path, *, hidden: int = 16, seed: int = 0, **changes: object) -> Made:
    """A network that reads the motion both ways; it has no states."""
    card = card_of(**{"causal": False, "warmup_steps": 0, "method": "realeasy", **changes})
    graph = Graph(card, seed, [])
    weights = [
        graph.random("W", 2, 4 * hidden, len(card.inputs), size=0.2),
        graph.random("R", 2, 4 * hidden, hidden, size=0.1),
        graph.random("B", 2, 8 * hidden, size=0.1),
    ]
    graph.add("LSTM", ["normal", *weights], "both_ways", hidden_size=hidden, direction="bidirectional")
    graph.add("ReduceSum", ["both_ways", graph.constant("ways", np.array([1]))], "hidden", keepdims=0)
    return written(folder, card, graph.finish("hidden", hidden))


def motion(card: ModelCard, steps: int, *, copies: int = 1, seed: int = 0) -> np.ndarray:
    """A smooth random motion inside of the training range, (T, B, I) float32."""
    rng = np.random.default_rng(seed)
    count = len(card.inputs)
    reach = np.array([channel.high for channel in card.inputs])
    phase, pace = rng.uniform(0, 6, (copies, count)), rng.uniform(0.5, 20, (copies, count))
    seconds = np.arange(steps)[:, None, None] / card.rate_hz
    return (0.9 * reach * np.sin(phase + pace * seconds)).astype(np.float32)


def by_signal(card: ModelCard, x: np.ndarray, series: str = "simulated") -> dict[str, np.ndarray]:
    """One sample (I,) as the arrays (J,) that a simulator returns."""
    names = dict.fromkeys(channel.signal for channel in card.inputs if channel.series == series)
    return {
        name: np.array([
            x[number]
            for number, channel in enumerate(card.inputs)
            if (channel.series, channel.signal) == (series, name)
        ], np.float64)
        for name in names
    }  # fmt: skip


def changed(made: Made, change: Callable[[onnx.GraphProto], object]) -> None:
    """Change the graph, and write it and a card that vouches for it."""
    path = made.folder / ONNX_NAME
    model = onnx.load_from_string(path.read_bytes())
    change(model.graph)
    written(made.folder, made.card, model)


def spoiled_card(made: Made, old: str, new: str) -> None:
    """Change model.json as somebody with an editor would."""
    path = made.folder / CARD_NAME
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
