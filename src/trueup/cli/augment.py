"""`trueup augment`: learned corrections."""

from __future__ import annotations

import typer

from trueup.cli import augment_eval, augment_robustness, augment_sweep, augment_time, augment_train

app = typer.Typer(
    help="Networks that correct what a simulator says. They turn it into what the robot would have measured.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
for module in (augment_train, augment_sweep, augment_eval, augment_robustness, augment_time):
    module.register(app)


def register(parent: typer.Typer) -> None:
    """Add the group of commands."""
    parent.add_typer(app, name="augment")
