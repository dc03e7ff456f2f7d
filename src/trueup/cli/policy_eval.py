"""`trueup policy eval`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table
from rich.text import Text

from trueup.cli import options
from trueup.cli.console import answer, out, status_line

if TYPE_CHECKING:
    from trueup.core.policy_evaluation import PolicyEvaluation
    from trueup.core.results import Estimate

_SHOWN = ("success", "distance_median", "overshoot", "smoothness", "torque_at_limit", "velocity_violation", "reward")
_COMPARED = ("success", "distance", "reward")


def register(app: typer.Typer) -> None:
    """Add the command to the group."""
    app.command("eval")(evaluate)


def evaluate(
    policies: Annotated[
        list[Path],
        typer.Argument(metavar="POLICY...", help="Folders of policies, or zoo:NAME; compared with the first."),
    ],
    robot: options.Robot = "panda_torque",
    places: Annotated[
        str, typer.Option("--on", help="mujoco, dart, lab (virtual hardware), or several: mujoco,lab.")
    ] = "mujoco",
    goals: Annotated[int, typer.Option("--goals", min=2, help="Goals, the same in all places.")] = 100,
    unit: Annotated[
        list[int] | None,
        typer.Option("--unit", min=0, help="Individual of the virtual hardware, 1 if not given; repeatable."),
    ] = None,
    out_dir: Annotated[
        Path | None, typer.Option("--out", help="Folder for evaluation.json, episodes.npz and report.html.")
    ] = None,
    model: options.Model = None,
    seed: options.Seed = 0,
    jobs: options.Jobs = None,
    overwrite: options.Overwrite = False,
) -> int:
    """Let policies reach for goals, and say how near they come.

    And how they get there, and what they demand.
    """
    import trueup.zoo
    from trueup.robots import load_robot
    from trueup.stages.policy_judging import judge_policies

    with status_line() as line:
        found = judge_policies(
            [trueup.zoo.folder_of(policy) for policy in policies],
            load_robot(robot),
            places=[place.strip() for place in places.split(",")],
            goals=goals,
            units=unit or (1,),
            model=model,
            seed=seed,
            jobs=jobs,
            out=out_dir,
            overwrite=overwrite,
            on_episodes=lambda label, place, done, count: line(f"{label}, {place}: {done} of {count} goals"),
        ).evaluation
    answer(found)
    out.print(_table(found))
    if found.differences:
        out.print(_differences(found))
    for item in found.policies:
        for place, own in item.places.items():
            if own.lost:
                who = place if len(found.policies) == 1 else f"{item.label}, {place}"
                said = "the engine or the policy said what is no number"
                out.print(f"{who}: {own.lost} arms were lost: {said}", markup=False)
    if out_dir is not None:
        from trueup.report import write_report

        out.print(f"report: {write_report(out_dir)}", markup=False)
    return 0


def _table(found: PolicyEvaluation) -> Table:
    several = any(len(group.policies) > 1 for group in found.groups)
    table = Table(title=f"reaching, mean over goals{' and seeds' if several else ''} with 95 % intervals")
    if len(found.groups) > 1:
        table.add_column("policy", overflow="fold")
    if several:
        table.add_column("seeds", justify="right")
    table.add_column("on")
    for heading in _SHOWN:
        table.add_column(heading.replace("_", " "), justify="right")
    for group in found.groups:
        for place, estimates in group.places.items():
            table.add_row(
                *([Text(group.label)] if len(found.groups) > 1 else []),
                *([str(len(group.policies))] if several else []),
                place,
                *_cells(estimates, _SHOWN),
            )
    return table


def _differences(found: PolicyEvaluation) -> Table:
    table = Table(title=Text(f"minus {found.differences[0].baseline}, on the same goals, with 95 % intervals"))
    table.add_column("policy", overflow="fold")
    table.add_column("on")
    for heading in _COMPARED:
        table.add_column(heading, justify="right")
    for group in found.groups[1:]:
        for place in found.places:
            own = {
                item.metric: item.difference
                for item in found.differences
                if item.run == group.label and item.split == place
            }
            table.add_row(Text(group.label), place, *_cells(own, _COMPARED))
    return table


def _cells(estimates: Mapping[str, Estimate], names: tuple[str, ...]) -> list[Text]:
    cells = []
    for name in names:
        own = estimates[name]
        factor, digits = (100.0, 1) if own.unit == "m" or name == "success" else (1.0, 3)
        ends = (
            ""
            if own.low is None or own.high is None
            else f" [{factor * own.low:.{digits}f}, {factor * own.high:.{digits}f}]"
        )
        unit = " cm" if own.unit == "m" else (" %" if name == "success" else "")
        cells.append(Text(f"{factor * own.value:.{digits}f}{ends}{unit}"))
    return cells
