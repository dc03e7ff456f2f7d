"""`trueup gap`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from trueup.cli import options
from trueup.cli.console import answer, iterations, note, out, track
from trueup.cli.convert import show_flags
from trueup.cli.fit_tables import attribution_table
from trueup.cli.tables import gap_table, verdicts
from trueup.core.atomic import make_folder
from trueup.core.results import GapResult
from trueup.core.sole_writer import writes_alone
from trueup.errors import BarNotMet, ConfigError, OutputExists

if TYPE_CHECKING:
    from trueup.measure import Bar


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("gap")(gap)


@writes_alone("out_dir")
def gap(
    dataset: Annotated[Path, typer.Argument(help="Folder of a dataset with runs.")],
    out_dir: Annotated[Path | None, typer.Option("--out", help="Folder for gap.json and report.html.")] = None,
    runs: Annotated[str | None, typer.Option("--runs", help="Labels, comma-separated; all if not given.")] = None,
    robot: Annotated[
        str | None,
        typer.Option("--robot", help="Which joints are scored, instead of what the runs say; needed by --explain."),
    ] = None,
    explain: Annotated[
        bool,
        typer.Option("--explain", help="Fit, and tell how much is delay, gains, friction, gravity, inertia."),
    ] = False,
    config: Annotated[
        Path | None, typer.Option("--config", help="YAML that says what --explain fits; see docs/identification.md.")
    ] = None,
    model: options.Model = None,
    jobs: options.Jobs = None,
    split: Annotated[str | None, typer.Option("--split", help="Measure only train, val or test.")] = None,
    signals: Annotated[str | None, typer.Option("--signals", help="Comma-separated, e.g. position,torque.")] = None,
    metrics: Annotated[str | None, typer.Option("--metrics", help="Comma-separated; see docs/metrics.md.")] = None,
    tau_rad: Annotated[float, typer.Option("--tau-rad", help="Threshold of the large-gap ratio [rad].")] = 0.5,
    drop_flagged: options.DropFlagged = False,
    cut_rest: Annotated[bool, typer.Option("--cut-rest", help="Leave out the resting ends of each motion.")] = False,
    align_starts: Annotated[
        bool, typer.Option("--align-starts", help="Shift runs that came with the logs to the start of the motion.")
    ] = False,
    fail_above: options.FailAbove = None,
    seed: options.Seed = 0,
    overwrite: options.Overwrite = False,
) -> int:
    """Measure the gap between robot and simulation.

    With 95 % intervals; writes gap.json and a report.
    """
    from trueup.dataset import Dataset
    from trueup.identify import IdentifyConfig
    from trueup.measure import parse_bar, refuse_unknown
    from trueup.report import write_report
    from trueup.report.body_units import gap_for_people
    from trueup.stages import explain as attribute
    from trueup.stages import folder
    from trueup.stages import gap as measure

    if explain and robot is None:
        raise ConfigError(
            "--explain simulates, so it needs to know the robot", hint="Give --robot NAME or a robot.yaml."
        )
    if config is not None and not explain:
        raise ConfigError("--config says what --explain fits", got="no --explain", hint="Give --explain, too.")
    chosen = IdentifyConfig.load(config) if config else None
    bars = [parse_bar(text) for text in fail_above or []]
    if out_dir is not None and (out_dir / "gap.json").exists() and not overwrite:
        raise OutputExists(f"{out_dir / 'gap.json'} exists", hint="Give --overwrite, or choose another --out.")
    data = Dataset(dataset)
    described = options.robot_of(robot, dataset) if robot else None
    refuse_unknown(
        bars, runs=_list(runs) or data.runs, splits=[split] if split else sorted({*data.splits.values()} - {""})
    )
    if out_dir is not None:
        make_folder(out_dir)  # what cannot be written to is said before an hour of fits
        folder.refuse_other_fit(out_dir, data.hash)
    measurement = measure(
        data,
        runs=_list(runs),
        robot=described,
        split=split,
        drop_flagged=drop_flagged,
        cut_resting=cut_rest,
        align=align_starts,
        signals=_list(signals),
        metrics=_list(metrics),
        tau_rad=tau_rad,
        seed=seed,
        track=track,
    )
    answer(measurement.gap)
    shown = _list(metrics) or ["rmse"]
    show_flags(measurement.quality, only_dropped=True)
    people = gap_for_people(measurement.gap)
    out.print(gap_table(people, metric="rmse" if "rmse" in shown else shown[0]))
    for line in verdicts(people):
        out.print(line, markup=False)
    for why in measurement.engines.missing.values() if measurement.engines is not None else ():
        note(why)
    for line in measurement.gap.settings["warnings"]:
        note(line)
    if out_dir is not None:  # before the fit of --explain, which may fail
        folder.forget_explanation(out_dir)
        measurement.save(out_dir)
        folder.forget_other_ladder(out_dir)
        report = write_report(out_dir)
    if explain and described is not None:
        with iterations() as (begin, on_progress):
            begin()
            attribution = attribute(
                data, described, model=model, config=chosen, seed=seed, jobs=jobs, on_progress=on_progress
            )
        out.print(attribution_table(attribution))
        for line in attribution.statements:
            note(line)
        if out_dir is not None:
            attribution.save(out_dir / "explain.json")
            report = write_report(out_dir)
    if out_dir is not None:
        out.print(f"report: {report}", markup=False)
    hold_bars(measurement.gap, bars)
    return 0


def hold_bars(gap: GapResult, bars: Sequence[Bar]) -> None:
    """Raise BarNotMet, naming every bar that was not met."""
    from trueup.measure import check_bars

    failures = check_bars(gap, bars)
    if failures:
        raise BarNotMet("bar not met: " + "; ".join(map(str, failures)))


def _list(text: str | None) -> list[str] | None:
    return None if text is None else [item.strip() for item in text.split(",") if item.strip()]
