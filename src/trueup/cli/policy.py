"""`trueup policy`: torque-controlled reaching, trained in a simulator and judged wherever there is an arm."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from trueup.cli import options, policy_curves, policy_eval, policy_grid
from trueup.cli import policy_config as trained
from trueup.cli.console import out, status_line

app = typer.Typer(
    help="Policies that reach for goals by torques. Trained in a simulator, judged there and on hardware.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


def register(parent: typer.Typer) -> None:
    """Add the group of commands."""
    app.command("train")(train)
    app.command("grid")(policy_grid.grid)
    policy_eval.register(app)
    policy_curves.register(app)
    parent.add_typer(app, name="policy")


def train(
    out_dir: Annotated[Path, typer.Option("--out", help="Folder for the policy.")],
    robot: options.Robot = "panda_torque",
    config: trained.Config = "laptop",
    algorithm: trained.Algorithm = None,
    randomize: trained.Randomize = None,
    steps: trained.Steps = None,
    start: trained.Start = None,
    name: Annotated[str, typer.Option("--name", help="Name of the policy; robot and algorithm if not given.")] = "",
    model: options.Model = None,
    device: trained.Device = "cpu",
    force: trained.Force = False,
    seed: options.Seed = 0,
    jobs: options.Jobs = None,
    overwrite: options.Overwrite = False,
    resume: options.Resume = False,
) -> int:
    """Train a policy that reaches for goals by torques. It is exported for a robot."""
    from trueup.robots import load_robot
    from trueup.stages.policy_training import train_policy

    chosen = trained.configured(config, algorithm, randomize, steps, start)
    with status_line() as line:
        made = train_policy(
            load_robot(robot),
            out_dir,
            config=chosen,
            model=model,
            name=name,
            seed=seed,
            jobs=jobs,
            device=device,
            force=force,
            overwrite=overwrite,
            resume=resume,
            on_round=lambda done, count: line(
                f"train: round {done.number}/{count}, {100 * done.distance_m:.1f} cm from the goal, "
                f"{(count - done.number) * done.seconds / done.number:.0f} s left"
            ),
        )
    best = max(made.history, key=lambda item: item.reward)
    out.print(
        f"{made.card.name}: median distance at the end {100 * best.distance_m:.1f} cm, nine of ten below "
        f"{100 * best.worst_m:.1f} cm (round {best.number} of {len(made.history)}, "
        f"{made.history[-1].seconds / 60:.1f} min); policy: {made.folder}",
        markup=False,
    )
    out.print(f"next: trueup policy eval {made.folder} --robot {robot} --on mujoco,dart,lab", markup=False)
    return 0
