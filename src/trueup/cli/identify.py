"""`trueup identify`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from trueup.cli import options
from trueup.cli.check import show_findings
from trueup.cli.console import answer, iterations, note, out, problem, track, warning
from trueup.cli.fit_tables import model_table, parameter_table, status_line
from trueup.cli.tables import ladder_table, verdicts

if TYPE_CHECKING:
    from trueup.stages import Identified

# A fit with one of these is no result to build on; everything else is loud but usable.
UNUSABLE = ("no-better", "not-converged")


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("identify")(identify)


def identify(
    dataset: Annotated[Path, typer.Argument(help="Folder of a dataset.")],
    robot: options.Robot,
    out_dir: options.Results = None,
    config: Annotated[
        Path | None, typer.Option("--config", help="YAML that says what to fit; see docs/identification.md.")
    ] = None,
    solver: Annotated[
        str | None, typer.Option("--solver", help="auto, gauss-newton, cma-es or evolution; over the configuration.")
    ] = None,
    model: options.Model = None,
    budget: Annotated[
        str, typer.Option("--budget", help="Time for the fit, e.g. 90s, 10m, 1h; `none` for no limit.")
    ] = "none",
    seed: options.Seed = 0,
    jobs: options.Jobs = None,
    ray: Annotated[
        str | None,
        typer.Option(
            "--ray", help="Search from the starts on a Ray cluster: its HOST:PORT, or local for one on this machine."
        ),
    ] = None,
    overwrite: options.Overwrite = False,
    resume: options.Resume = False,
    force: options.Force = False,
) -> int:
    """Find what the simulator has wrong, and how sure that is.

    Writes a fitted model, a robot.yaml and a report.

    Exit code 3 if the set-up is certainly wrong, the search did not converge, or the fitted model is no better on
    motions that it was not fitted to.
    """
    from dataclasses import replace

    from trueup.core.config import build
    from trueup.core.time_limit import TimeLimit
    from trueup.dataset import Dataset
    from trueup.identify import IdentifyConfig
    from trueup.identify.config import SolverChoice
    from trueup.stages import check_setup, refuse_wrong
    from trueup.stages import fit as run

    out_dir, budget_s = options.folder_for(out_dir, dataset, of="fit"), options.budget_s(budget)
    chosen = IdentifyConfig.load(config) if config else IdentifyConfig()
    if solver is not None:
        name = build(SolverChoice, {"name": solver}, "--solver").name
        chosen = replace(chosen, solver=replace(chosen.solver, name=name))
    data, description = Dataset(dataset), options.robot_of(robot, dataset)
    if not force:
        checked = check_setup(data, description, model=model)
        show_findings(checked, only=("certain", "likely"))
        refuse_wrong(checked)
    with iterations() as (begin, on_progress):
        identified = run(
            data,
            description,
            out_dir,
            model=model,
            config=chosen,
            seed=seed,
            jobs=jobs,
            ray=ray,
            overwrite=overwrite,
            resume=resume,
            track=track,
            on_begin=begin,
            on_progress=on_progress,
            limit=None if budget_s is None else TimeLimit.after(budget_s),
        )
    show(identified, out_dir)
    return 3 if identified.fit.status in UNUSABLE else 0


def show(identified: Identified, out_dir: Path) -> None:
    """Parameters, models, ladder, what must be said, and where everything is."""
    from trueup.report import write_report

    fit = identified.fit
    answer(fit)
    out.print(parameter_table(fit))
    if len(fit.models) > 1:
        out.print(model_table(fit))
        out.print("* chosen", markup=False)
    out.print(ladder_table(identified.ladder))
    for line in verdicts(identified.measurement.gap):
        out.print(line, markup=False)
    for line in (*fit.statements, *identified.notes):
        note(line)
    text, hint = status_line(fit)
    if fit.status == "ok":
        out.print(text, markup=False)
    elif fit.status in UNUSABLE:
        problem(text, hint)
    else:
        warning(text, hint)
    out.print(f"fitted model: {out_dir / 'model.fitted.xml'}", markup=False)
    out.print(f"fitted robot: {out_dir / 'robot.fitted.yaml'}", markup=False)
    out.print(f"report: {write_report(out_dir)}", markup=False)
