"""Networks with random weights, written as the model folders that training exports; for benchmarks and tests."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import onnx
import torch

from trueup.augment.config import NetworkConfig
from trueup.augment.corrector import Corrector
from trueup.augment.networks import build_network
from trueup.augment.networks.operator import OperatorConfig
from trueup.augment.scaling import Scaling
from trueup.compensate.compensation import Compensation, channels
from trueup.compensate.config import METHODS
from trueup.compensate.correctors import blank
from trueup.core.model_card import CARD_NAME, ONNX_NAME, Channel, Input, ModelCard, Output

JOINTS = tuple(f"joint{number + 1}" for number in range(7))
UNITS = {"position": "rad", "velocity": "rad/s", "torque": "Nm"}
REACH = {"position": 2.5, "velocity": 2.0, "torque": 50.0}
RATE_HZ = 1000.0
# Units of the layers of Realeasy's networks (IV-C): 21 -> 100 -> 21.
HIDDEN = (100, 21)


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


@dataclass(frozen=True)
class Made:
    """A folder with a network in it, and its card as written; the same network in torch, if it is one of ours."""

    folder: Path
    card: ModelCard
    corrector: Corrector | None = None


def written(folder: Path, card: ModelCard, model: bytes) -> Made:
    """The model folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / ONNX_NAME).write_bytes(model)
    return Made(folder, card.save(folder))


def corrector_of(card: ModelCard, config: NetworkConfig, seed: int = 0) -> Corrector:
    """A network with random weights, as large in its output as a fifth of what its inputs reach."""
    torch.manual_seed(seed)
    low, high = np.array([(channel.low, channel.high) for channel in card.inputs]).T
    corrected = high[card.base]
    scaling = Scaling((low + high) / 2, (high - low) / 2, np.zeros(corrected.size), 0.2 * corrected, corrected)
    network = build_network(config, inputs=len(card.inputs), base=card.base.tolist(), rate_hz=card.rate_hz)
    return Corrector(network, scaling, card.base, target="residual").eval()


def real_time(folder: Path, *, hidden: Sequence[int] = HIDDEN, seed: int = 0, **changes: object) -> Made:
    """Two LSTM layers and a dense one, as Realeasy's real-time network."""
    return _made(folder, NetworkConfig("lstm", tuple(hidden)), seed, **changes)


def window(folder: Path, *, past: int = 4, hidden: Sequence[int] = (16,), seed: int = 0, **changes: object) -> Made:
    """Dense layers over the current sample and the `past` ones before it, which it keeps as a buffer of inputs."""
    config = NetworkConfig("mlp", tuple(hidden), history=past + 1)
    return _made(folder, config, seed, **{"warmup_steps": past, "method": "mlp", **changes})


def bidirectional(folder: Path, *, hidden: Sequence[int] = (16,), seed: int = 0, **changes: object) -> Made:
    """A network that reads the motion both ways; it has no states."""
    config = NetworkConfig("lstm", tuple(hidden), bidirectional=True)
    return _made(folder, config, seed, **{"causal": False, "warmup_steps": 0, "method": "realeasy", **changes})


def _made(folder: Path, config: NetworkConfig, seed: int, **changes: object) -> Made:
    card = card_of(**changes)
    corrector = corrector_of(card, config, seed)
    made = written(folder, replace(card, states=corrector.states), corrector.exported({}))
    return replace(made, corrector=corrector)


def compensation(
    folder: Path,
    joints: Sequence[str] = JOINTS,
    *,
    rate_hz: float = RATE_HZ,
    size: float = 0.05,
    seed: int = 0,
    reach: float = 2.0,
    payload: tuple[float, float] = (0.0, 3.0),
    network: OperatorConfig | None = None,
    direction: str = "robot",
    relative: bool = True,
) -> Compensation:
    """A network for commands, saved; its corrections are of about `size`, and vary with all that it reads.

    Args:
        folder: of the model.
        joints: that it corrects.
        rate_hz: of its commands.
        size: of corrections [rad].
        seed: of its weights.
        reach: commands, from where the joints are if `relative`, that it knows [rad].
        payload: masses that it knows [kg].
        network: its layers; those of the default operator if None.
        direction: what it is for, as its card says.
        relative: whether commands are read from where the joints are.
    """
    base = METHODS["operator"]
    config = replace(base, network=network or base.network, relative=relative)
    corrector = blank(config, len(joints), rate_hz, seed)
    torch.manual_seed(seed)
    for parameter in corrector.network.parameters():
        torch.nn.init.normal_(parameter, std=0.5 if parameter.ndim == 1 else parameter[0].numel() ** -0.5)
    corrector.out_scale.fill_(size)
    ends = {"velocity": (-4.0, 4.0), "payload": payload}
    command = (-reach, reach) if relative else (-3.0, 3.0)
    inputs = tuple(
        replace(channel, low=low, high=high, relative=relative and channel.series == "command")
        for channel in channels(joints, ["rad"] * len(joints))
        for low, high in [command if channel.series == "command" else ends.get(channel.signal, (-3.0, 3.0))]
    )
    outputs = tuple(
        Output("position", joint, "rad", "command", base=2 * len(joints) + number)
        for number, joint in enumerate(joints)
    )
    card = ModelCard(
        name="random-operator",
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
    model = onnx.load_from_string((made.folder / ONNX_NAME).read_bytes())
    change(model.graph)
    onnx.checker.check_model(model)
    written(made.folder, made.card, model.SerializeToString())


def spoiled_card(made: Made, old: str, new: str) -> None:
    """Change model.json as somebody with an editor would."""
    path = made.folder / CARD_NAME
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
