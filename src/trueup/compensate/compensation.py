"""A trained compensation: its card, its weights, its folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from safetensors import SafetensorError
from safetensors.torch import load as load_tensors
from safetensors.torch import save as save_tensors

from trueup.augment.corrector import Corrector
from trueup.compensate.config import CompensateConfig
from trueup.compensate.correctors import blank
from trueup.compensate.windows import Windows
from trueup.core.atomic import make_folder, write_bytes
from trueup.core.config import build
from trueup.core.model_card import ONNX_NAME, STEP_NAME, WEIGHTS_NAME, Input, ModelCard, Output
from trueup.core.provenance import provenance
from trueup.errors import DataError

# `simulator`: added to commands in the simulator, which then moves like the robot. `robot`: added to commands of the
# robot, which then moves like the simulator.
Direction = Literal["simulator", "robot"]
PAYLOAD = "payload"
# Compensation changes where states go; those of training are where they went without.
_MARGIN = 0.25


def channels(
    joints: Sequence[str], units: Sequence[str], signal: str = "position", commanded: Sequence[str] | None = None
) -> tuple[Input, ...]:
    """What a compensation reads: position, velocity and command of J joints, then the payload.

    `commanded` are the commands' units, those of the positions if None.

    In a network for the robot's own loop, what is called simulated is what the robot's sensors say.
    """
    return (
        *(Input("position", joint, unit) for joint, unit in zip(joints, units, strict=True)),
        *(Input("velocity", joint, f"{unit}/s") for joint, unit in zip(joints, units, strict=True)),
        *(Input(signal, joint, unit, "command") for joint, unit in zip(joints, commanded or units, strict=True)),
        Input(PAYLOAD, "", "kg", "condition"),
    )


@dataclass(frozen=True, eq=False)
class Compensation:
    """A network that says what commands lack.

    Attributes:
        card: what it says of itself.
        corrector: the network between SI values, in torch.
        config: what it was trained with.
    """

    card: ModelCard
    corrector: Corrector
    config: CompensateConfig

    @property
    def direction(self) -> Direction:
        """Whose commands it corrects."""
        return "robot" if self.card.provenance.get("direction") == "robot" else "simulator"

    @staticmethod
    def of(
        corrector: Corrector,
        config: CompensateConfig,
        windows: Windows,
        *,
        name: str,
        robot: str,
        joints: Sequence[str],
        units: Sequence[str],
        run: str,
        rate_hz: float,
        direction: Direction,
        signal: str = "position",
        commanded: Sequence[str] | None = None,
        provenance_of: Mapping[str, Any],
        description: str = "",
    ) -> Compensation:
        """What training has left, with the ranges of its data."""
        state, command, payload = (part.numpy() for part in windows.samples())
        count = len(joints)
        read = command - state[:, :count] if config.relative else command
        rows = np.concatenate([state, read, payload], axis=1)
        inputs = tuple(
            replace(
                channel,
                low=float(low),
                high=float(high),
                relative=config.relative and channel.series == "command",
            )
            for channel, low, high in zip(
                channels(joints, units, signal, commanded), rows.min(axis=0), rows.max(axis=0), strict=True
            )
        )
        outputs = tuple(
            Output(signal, joint, unit, "command", base=2 * count + number)
            for number, (joint, unit) in enumerate(zip(joints, commanded or units, strict=True))
        )
        made = {**provenance_of, "direction": direction, "config": asdict(config)}
        card = ModelCard(
            name=name,
            method=config.method,
            robot=robot,
            joints=tuple(joints),
            run=run,
            rate_hz=rate_hz,
            causal=True,
            inputs=inputs,
            outputs=outputs,
            states=corrector.states,
            margin=_MARGIN,
            description=description,
            provenance=made,
        )
        return Compensation(card, corrector, config)

    def save(self, folder: Path) -> Compensation:
        """Write weights, graph and card; the card last."""
        make_folder(folder)
        self.corrector.eval()
        state = {name: value.detach().cpu().contiguous() for name, value in self.corrector.state_dict().items()}
        write_bytes(folder / WEIGHTS_NAME, save_tensors(state))
        graph = self.corrector.exported({"name": self.card.name, "method": self.card.method, "by": "trueup"})
        write_bytes(folder / ONNX_NAME, graph)
        step = self.corrector.step_weights()
        (folder / STEP_NAME).unlink(missing_ok=True)
        if step is not None:
            write_bytes(folder / STEP_NAME, step.to_bytes())
        return Compensation(self.card.save(folder), self.corrector, self.config)

    @staticmethod
    def load(folder: Path) -> Compensation:
        """Read a model folder back, with the weights in torch.

        Raises:
            DataError: a file is missing, truncated or changed, or is no compensation.
            FormatError: of another version.
        """
        card = ModelCard.load(folder)
        if not card.outputs or card.outputs[0].series != "command":
            raise DataError(
                f"{folder} corrects no commands", got=card.method, hint="`trueup compensate train` makes one."
            )
        try:
            state = load_tensors(card.verified(folder, WEIGHTS_NAME))
            config = build(CompensateConfig, card.provenance.get("config"), f"{folder}: config")
            corrector = blank(config, len(card.joints), card.rate_hz)
            corrector.load_state_dict(state)
        except (SafetensorError, KeyError, TypeError, RuntimeError) as error:  # torch's error for shapes is the last
            raise DataError(f"{folder / WEIGHTS_NAME} holds no weights of this network", got=error) from error
        corrector.eval()
        return Compensation(card, corrector, config)


def made(seed: int, data_hash: str, config: CompensateConfig) -> dict[str, Any]:
    """Provenance of a training."""
    return provenance(config=asdict(config), seed=seed, data_hash=data_hash)
