"""`trueup augment robustness`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table
from rich.text import Text

from trueup.cli import options
from trueup.cli.console import answer, note, out, track
from trueup.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from trueup.core.robustness_result import RobustnessResult, RobustnessRow
    from trueup.sim import Perturbation

_ALL = "all of these"


def register(app: typer.Typer) -> None:
    """Add the command to the group."""
    app.command("robustness")(robustness)


def robustness(
    datasets: Annotated[
        list[Path], typer.Argument(metavar="DATASET...", help="Folders of datasets, e.g. the same motions at speeds.")
    ],
    model: Annotated[Path, typer.Option("--model", help="Folder of a trained network, or zoo:NAME.")],
    robot: options.Robot,
    out_dir: Annotated[Path, typer.Option("--out", help="Folder for robustness.json and report.html.")],
    mass: Annotated[
        float, typer.Option("--mass", help="Masses are off by this share, as a standard deviation, e.g. 0.5.")
    ] = 0.0,
    com_m: Annotated[float, typer.Option("--com", help="Centers of mass are off by so much in each axis [m].")] = 0.0,
    joint_m: Annotated[
        float, typer.Option("--joint-position", help="Joints sit off by so much in each axis [m].")
    ] = 0.0,
    resistance: Annotated[
        float, typer.Option("--resistance", help="The motors' resistance is off by this share.")
    ] = 0.0,
    shares: Annotated[
        str, typer.Option("--shares", help="Shares of these sizes to look at, with commas between.")
    ] = "0.5,1",
    draws: Annotated[int, typer.Option("--draws", min=1, help="Simulators that are drawn per size.")] = 3,
    split: Annotated[str, typer.Option("--split", help="train, val, test, or all.")] = "test",
    motions: Annotated[
        int | None, typer.Option("--motions", min=1, help="At most so many motions of each dataset, the first ones.")
    ] = None,
    drop_flagged: options.DropFlagged = False,
    jobs: options.Jobs = None,
    seed: options.Seed = 0,
    overwrite: options.Overwrite = False,
    resume: options.Resume = False,
) -> int:
    """Say when a correction no longer helps.

    How far off a simulator, and how different motions may be.

    Datasets are only read: what is simulated for this is not stored. Writes robustness.json and a report.
    """
    from trueup.dataset import Dataset
    from trueup.report import write_report
    from trueup.report.robustness_words import lead, sentences
    from trueup.robots import load_robot
    from trueup.sim import Perturbation
    from trueup.stages import robustness as measure
    from trueup.zoo import folder_of

    result = measure(
        [Dataset(folder) for folder in datasets],
        load_robot(robot),
        folder_of(model),
        out_dir,
        perturbations=perturbations_of(Perturbation(mass, com_m, joint_m, resistance)),
        shares=shares_of(shares),
        draws=draws,
        split=split,
        motions=motions,
        drop_flagged=drop_flagged,
        jobs=jobs,
        seed=seed,
        overwrite=overwrite,
        resume=resume,
        track=track,
    )
    answer(result)
    show(result)
    for line in (lead(result), *sentences(result)):
        out.print(line, markup=False)
    for line in result.notes:
        note(line)
    out.print(f"report: {write_report(out_dir)}", markup=False)
    return 0


def perturbations_of(largest: Perturbation) -> dict[str, Perturbation]:
    """Each quantity that is off by itself, and all of them together if there are several."""
    from trueup.report.robustness_words import OFF
    from trueup.sim import Perturbation

    found = {OFF[name]: Perturbation(**{name: size}) for name, size in vars(largest).items() if size}
    return found if len(found) < 2 else {**found, _ALL: largest}


def shares_of(text: str) -> list[float]:
    """`0.5,1` as numbers.

    Raises:
        ConfigError: they are none.
    """
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise ConfigError("--shares", got=text, expected="numbers with commas between, such as 0.5,1") from None


def show(result: RobustnessResult) -> None:
    """Datasets, then simulators that are off, each with its errors and what is gone of them."""
    from trueup.report.body_units import robustness_for_people

    result = robustness_for_people(result)
    out.print(_table(f"{result.network}, the simulator as it is", "dataset", result.datasets))
    if result.perturbed:
        rows = [row for own in result.perturbed.values() for row in own]
        out.print(_table(f"{result.network} on {rows[0].dataset}, simulators that are off", "off in", rows))


def _table(title: str, first: str, rows: Sequence[RobustnessRow]) -> Table:
    from trueup.report.robustness_words import gone_words, size_words

    unit = rows[0].errors["mae"].simulated.unit
    head = f"{title}: position error [{unit}], and what is gone of it (95 % interval)"
    table = Table(title=Text(head), title_justify="left")
    table.add_column(first)
    for column in ("motions", "mean", "corrected", "gone", "largest", "corrected", "gone"):
        table.add_column(column, justify="right")
    for row in rows:
        cells = [str(row.motions)]
        for item in row.errors.values():
            cells += [f"{item.simulated.value:.3g}", f"{item.corrected.value:.3g}", gone_words(item.gone)]
        table.add_row(Text(size_words(row.size) if row.perturbation else row.dataset), *cells)
    return table
