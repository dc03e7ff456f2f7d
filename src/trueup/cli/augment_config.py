"""What commands that train networks have in common: options, and the configuration that they make."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from trueup.errors import ConfigError

if TYPE_CHECKING:
    from trueup.augment import AugmentConfig

Datasets = Annotated[list[Path], typer.Argument(help="Datasets with the run in them; several for several units.")]
Run = Annotated[str, typer.Option("--run", help="Label of the run that is corrected.")]
Signals = Annotated[
    list[str] | None,
    typer.Option("--signal", help="Signal to correct; all that both sides have if none; repeatable."),
]
Command = Annotated[list[str] | None, typer.Option("--command", help="Commanded signal to read besides; repeatable.")]
Epochs = Annotated[
    int | None, typer.Option("--epochs", min=0, help="Most epochs, over those of the method or the file.")
]
Robot = Annotated[str | None, typer.Option("--robot", help="Robot whose limits normalize.")]
Device = Annotated[Literal["cpu", "cuda"], typer.Option("--device", help="cpu or cuda.")]
TrainMotions = Annotated[
    int | None, typer.Option("--train-motions", min=1, help="Train on so many motions only, drawn from train.")
]


def configured(
    method: str | None, config: str | None, signals: list[str] | None, command: list[str] | None, epochs: int | None
) -> AugmentConfig:
    """The configuration that the options ask for.

    Raises:
        ConfigError: there is no such method, or the file does not fit it.
    """
    from trueup.augment import AugmentConfig, preset

    if config in (None, "default", "paper"):
        chosen = preset(method or "realeasy-rt", paper=config == "paper")
    elif method is not None:
        raise ConfigError("--method and a YAML file", got=(method, config), hint="Write method: into the file.")
    else:
        chosen = AugmentConfig.load(Path(str(config)))
    data = replace(
        chosen.data,
        signals=tuple(signals) if signals else chosen.data.signals,
        # What is not corrected is not read either, unless the file says so.
        blind=tuple(name for name in chosen.data.blind if not signals or name in signals),
        command=tuple(command) if command else chosen.data.command,
    )
    return replace(chosen, data=data, epochs=chosen.epochs if epochs is None else epochs)
