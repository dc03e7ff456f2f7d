"""`trueup augment`: train and judge learned corrections."""

from __future__ import annotations

import typer

from trueup.cli import augment_eval
from trueup.cli.augment_train import train

app = typer.Typer(help="Learned corrections of a simulated run: train them, judge them.", no_args_is_help=True)
app.command("train")(train)
augment_eval.register(app)


def register(parent: typer.Typer) -> None:
    """Add the commands."""
    parent.add_typer(app, name="augment")
