"""Cards, networks and motions whose evaluation is known."""

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.model_card import ONNX_NAME, Input, ModelCard, Output
from trueup.core.timeseries import TimeSeries
from trueup.measure import Comparison

JOINTS = ("a", "b")
UNITS = {"position": "rad", "torque": "Nm"}
RUN = "mujoco/stock"


def card_of(name="net", joints=JOINTS, signals=("position", "torque"), rate_hz=100.0, outputs=None, **changes):
    """A network that corrects every input; `outputs` maps (signal, joint) to what its output says more."""
    channels = [(signal, joint, UNITS[signal]) for signal in signals for joint in joints]
    more = outputs or {}
    return ModelCard(
        **{
            "name": name,
            "method": "linear",
            "robot": "demo_arm",
            "joints": tuple(joints),
            "run": RUN,
            "rate_hz": rate_hz,
            "causal": True,
            "inputs": tuple(Input(*channel) for channel in channels),
            "outputs": tuple(
                Output(*channel, base=number, **more.get(channel[:2], {})) for number, channel in enumerate(channels)
            ),
            **changes,
        }
    )


def shift_folder(folder, card, shift):
    """A model folder whose network adds a constant to each input."""
    shift = np.asarray(shift, np.float32)
    width = len(card.inputs)
    tensors = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, ["T", "B", size])
        for name, size in (("x", width), ("y", len(card.outputs)))
    ]
    nodes = [
        helper.make_node("Gather", ["x", "base"], ["picked"], axis=2),
        helper.make_node("Add", ["picked", "shift"], ["y"]),
    ]
    weights = [
        numpy_helper.from_array(np.asarray(card.base, np.int64), "base"),
        numpy_helper.from_array(shift, "shift"),
    ]
    graph = helper.make_graph(nodes, "shift", tensors[:1], tensors[1:], weights)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    folder.mkdir(parents=True, exist_ok=True)
    onnx.save(model, folder / ONNX_NAME)
    card.save(folder)
    return folder


def series_of(time_s, joints=JOINTS, **signals):
    """A series with the units of `UNITS`."""
    return TimeSeries(time_s, tuple(joints), signals, {name: (UNITS[name],) * len(joints) for name in signals})


def episode_of(rng, rate_hz=100.0, samples=200, joints=JOINTS):
    """Random measured, commanded and simulated motion on one clock."""
    time_s = 3.0 + np.arange(samples) / rate_hz
    draw = lambda: rng.normal(size=(samples, len(joints)))  # noqa: E731
    return Episode(
        EpisodeMeta("m"),
        series_of(time_s, joints, position=draw(), torque=draw()),
        series_of(time_s, joints, position=draw()),
        {RUN: series_of(time_s, joints, position=draw(), torque=draw())},
    )


def comparison_of(number, measured, runs, *, condition="", units=None, rate_hz=100.0, source=""):
    """A motion in which only torque is compared: arrays (T, 2) of the robot and of each run."""
    time_s = np.arange(len(measured)) / rate_hz
    joints, units = JOINTS, units or ("Nm", "Nm")
    series = lambda values: TimeSeries(time_s, joints, {"torque": values}, {"torque": units})  # noqa: E731
    meta = EpisodeMeta(f"motion{number}", condition=condition, split="test", source=source)
    return Comparison(meta, series(measured), {label: series(values) for label, values in runs.items()})
