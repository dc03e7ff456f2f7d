"""`trueup policy`: torque-controlled reaching, trained in a simulator and judged wherever there is an arm."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from trueup.cli import options
from trueup.cli.console import out, status_line
from trueup.errors import ConfigError

if TYPE_CHECKING:
    from trueup.policy.config import PolicyConfig
    from trueup.policy.evaluation import Episodes

app = typer.Typer(
    help="Policies that reach for goals by torques: trained in a simulator, judged there and on hardware.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
# `--config` that is no file.
_PAPER = "paper"
_SHOWN = ("success", "distance_median", "overshoot", "smoothness", "torque_at_limit", "velocity_violation", "reward")


def register(parent: typer.Typer) -> None:
    """Add the group of commands."""
    app.command("train")(train)
    app.command("eval")(evaluate)
    parent.add_typer(app, name="policy")


def train(
    out_dir: Annotated[Path, typer.Option("--out", help="Folder for the policy.")],
    robot: options.Robot = "panda_torque",
    config: Annotated[str | None, typer.Option("--config", help="paper, or a YAML file; see docs/policies.md.")] = None,
    algorithm: Annotated[str, typer.Option("--algorithm", help="ddpg, sac, td3 or tqc.")] = "tqc",
    randomize: Annotated[
        str | None,
        typer.Option(
            "--randomize", help="none, thesis, or the folder of an identification; the configuration's if not given."
        ),
    ] = None,
    steps: Annotated[int | None, typer.Option("--steps", min=1, help="Control steps of all arms together.")] = None,
    name: Annotated[str, typer.Option("--name", help="Name of the policy; robot and algorithm if not given.")] = "",
    model: options.Model = None,
    device: Annotated[str, typer.Option("--device", help="Where networks learn: cpu or cuda.")] = "cpu",
    force: Annotated[
        bool, typer.Option("--force", help="Randomize by an identification whose status is not ok, too.")
    ] = False,
    seed: options.Seed = 0,
    jobs: options.Jobs = None,
    overwrite: options.Overwrite = False,
    resume: options.Resume = False,
) -> int:
    """Train a policy that reaches for goals by torques, and export it for a robot."""
    from trueup.robots import load_robot
    from trueup.stages.policy_training import train_policy

    chosen = _configured(config, algorithm, randomize, steps)
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


def evaluate(
    policy: Annotated[Path, typer.Argument(help="Folder of a policy.")],
    robot: options.Robot = "panda_torque",
    places: Annotated[
        str, typer.Option("--on", help="mujoco, dart, lab (virtual hardware), or several: mujoco,lab.")
    ] = "mujoco",
    goals: Annotated[int, typer.Option("--goals", min=2, help="Goals, the same in all places.")] = 100,
    unit: Annotated[
        list[int] | None,
        typer.Option("--unit", min=0, help="Individual of the virtual hardware, 1 if not given; repeatable."),
    ] = None,
    out_file: Annotated[Path | None, typer.Option("--out", help="JSON file for what was found.")] = None,
    model: options.Model = None,
    seed: options.Seed = 0,
    jobs: options.Jobs = None,
) -> int:
    """Let a policy reach for goals, and say how near it comes, how it gets there and what it demands."""
    from trueup.robots import load_robot
    from trueup.stages.policy_training import evaluate_policy

    with status_line() as line:
        found = evaluate_policy(
            policy,
            load_robot(robot),
            places=[place.strip() for place in places.split(",")],
            goals=goals,
            units=unit or (1,),
            model=model,
            seed=seed,
            jobs=jobs,
            out=out_file,
            on_episodes=lambda label, done, count: line(f"{label}: {done} of {count} goals"),
        )
    out.print(_table(found))
    lost = {label: int(episodes.lost.sum()) for label, episodes in found.items() if episodes.lost.any()}
    for label, count in lost.items():
        out.print(f"{label}: {count} arms were lost: the engine or the policy said what is no number", markup=False)
    return 0


def _configured(config: str | None, algorithm: str, randomize: str | None, steps: int | None) -> PolicyConfig:
    from trueup.core.config import build, read_yaml
    from trueup.policy.config import ALGORITHMS, PAPER, PolicyConfig
    from trueup.policy.randomization import THESIS, RandomizationConfig

    if algorithm not in ALGORITHMS:
        raise ConfigError("there is no such algorithm", got=algorithm, available=ALGORITHMS)
    if config is None:
        chosen = PolicyConfig(algorithm=algorithm)
    elif config == _PAPER:
        chosen = PolicyConfig(algorithm=algorithm, learner=PAPER[algorithm])
    else:
        chosen = build(PolicyConfig, {"algorithm": algorithm, **read_yaml(Path(config))}, config)
    if randomize is not None:
        named = {"none": RandomizationConfig(), "thesis": THESIS}
        chosen = replace(chosen, randomization=named.get(randomize) or RandomizationConfig(posterior=randomize))
    return chosen if steps is None else replace(chosen, steps=steps)


def _table(found: Mapping[str, Episodes]) -> Table:
    table = Table(title="reaching, mean over goals with 95 % intervals")
    table.add_column("on")
    for heading in _SHOWN:
        table.add_column(heading.replace("_", " "), justify="right")
    for label, episodes in found.items():
        cells = []
        for name in _SHOWN:
            own = episodes.estimates()[name]
            factor, digits = (100.0, 1) if own.unit == "m" or name == "success" else (1.0, 3)
            ends = (
                ""
                if own.low is None or own.high is None
                else (f" [{factor * own.low:.{digits}f}, {factor * own.high:.{digits}f}]")
            )
            unit = " cm" if own.unit == "m" else (" %" if name == "success" else "")
            cells.append(f"{factor * own.value:.{digits}f}{ends}{unit}")
        table.add_row(label, *cells)
    return table
