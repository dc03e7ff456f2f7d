"""`trueup policy grid`: a policy at each point of a grid of settings, and which of them is best."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from trueup.cli import options
from trueup.cli import policy_config as trained
from trueup.cli.console import answer, out, status_line, warning

if TYPE_CHECKING:
    from trueup.stages.policy_grid import GridResult, GridTrial

# Trials that the table shows.
_SHOWN = 10


def grid(
    out_dir: Annotated[Path, typer.Option("--out", help="Folder for the database, the policies and grid.json.")],
    robot: options.Robot = "panda_torque",
    config: trained.Config = "laptop",
    algorithm: trained.Algorithm = None,
    axes: Annotated[
        Path | None,
        typer.Option("--grid", help="YAML file: names and values to try; the thesis's for the algorithm if not given."),
    ] = None,
    randomize: trained.Randomize = None,
    steps: trained.Steps = None,
    start: trained.Start = None,
    model: options.Model = None,
    device: trained.Device = "cpu",
    force: trained.Force = False,
    seed: options.Seed = 0,
    jobs: Annotated[
        int | None,
        typer.Option("--jobs", min=1, help="Trials at a time, of one thread each; the number of cores if not given."),
    ] = None,
    ray: Annotated[
        str | None,
        typer.Option("--ray", help="Train on a Ray cluster: its HOST:PORT, or local for one on this machine."),
    ] = None,
    overwrite: options.Overwrite = False,
    resume: options.Resume = False,
) -> int:
    """Train a policy at each point of a grid of settings. Says which of them is best."""
    from trueup.core.atomic import read_json
    from trueup.core.config import read_yaml
    from trueup.policy.grid import read_grid
    from trueup.robots import load_robot
    from trueup.stages.policy_grid import GRID_FILE, search_grid

    chosen = trained.configured(config, algorithm, randomize, steps, start)
    with status_line() as line:
        found = search_grid(
            load_robot(robot),
            out_dir,
            config=chosen,
            grid=None if axes is None else read_grid(read_yaml(axes), str(axes)),
            model=model,
            seed=seed,
            jobs=jobs,
            ray=ray,
            device=device,
            force=force,
            overwrite=overwrite,
            resume=resume,
            on_trial=_standing(line),
        )
    answer(read_json(out_dir / GRID_FILE))
    best = found.ranking[0]
    out.print(_table(found))
    failed = [trial for trial in found.trials if trial.reason]
    if failed:
        warning(
            f"{len(failed)} of {len(found.trials)} trials failed: {failed[0].reason}", "All reasons are in grid.json."
        )
    folder = out_dir / best.folder.relative_to(found.folder)
    out.print(f"{len(found.trials)} trials, all in {out_dir / 'grid.json'}; best policy: {folder}", markup=False)
    out.print(f"next: trueup policy eval {folder} --robot {robot} --on mujoco,dart,lab", markup=False)
    return 0


def _standing(line: Callable[[str], None]) -> Callable[[int, int, GridTrial | None], None]:
    """Says how far the search is; the time that is left is that of trials since the command was given."""
    began: list[tuple[float, int]] = []

    def show(done: int, count: int, best: GridTrial | None) -> None:
        began.append((time.monotonic(), done))
        (start, before), now = began[0], began[-1][0]
        text = f"grid: {done}/{count} trials"
        if best is not None and best.best is not None:
            text += f", best {best.point.id} {100 * best.best.distance_m:.1f} cm from the goal"
        if done > before:
            text += f", {(count - done) * (now - start) / (done - before):.0f} s left"
        line(text)

    return show


def _table(found: GridResult) -> Table:
    table = Table(title=f"best of {len(found.trials)} trials, each by its best round")
    table.add_column("trial")
    names = list(found.trials[0].point.values)
    for heading in (
        *(name.removeprefix("learner.") for name in names),
        "reward",
        "distance",
        "nine of ten below",
        "time",
    ):
        table.add_column(heading, justify="right")
    for trial in found.ranking[:_SHOWN]:
        best = trial.best
        assert best is not None
        table.add_row(
            trial.point.id,
            *(str(trial.point.values[name]) for name in names),
            f"{best.reward:.3f}",
            f"{100 * best.distance_m:.1f} cm",
            f"{100 * best.worst_m:.1f} cm",
            f"{trial.rounds[-1].seconds / 60:.1f} min",
        )
    return table
