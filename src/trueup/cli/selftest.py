"""`trueup selftest`."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table

from trueup.cli import options
from trueup.cli.console import answer, iterations, note, out, problem, track
from trueup.core.parameters import split_name
from trueup.core.selftest_result import SELFTEST_VERDICTS, DrawnNumber, DrawnRobot, SelftestResult
from trueup.errors import OutputExists

_STYLE = {"recovered": "", "open": "yellow", "missed": "red"}
# Of 95 % intervals so many miss by chance.
_CHANCE = 0.05
_MOST_NAMES = 8


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("selftest")(selftest)


def selftest(
    robot: options.Robot,
    data: Annotated[
        Path | None,
        typer.Argument(help="Dataset, or logs of any known format, whose commands are given; designed if left out."),
    ] = None,
    config: Annotated[
        Path | None, typer.Option("--config", help="YAML that says what to fit; see docs/identification.md.")
    ] = None,
    noise: Annotated[
        float | None,
        typer.Option(
            "--noise", help="Standard deviation of a measured position [rad or m]; that of the logs, or 3e-4."
        ),
    ] = None,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Robots that are drawn.")] = 1,
    budget: Annotated[
        str, typer.Option("--budget", help="Time for each of them, e.g. 60s, 5m; `none` for no limit.")
    ] = "60s",
    out_file: Annotated[Path | None, typer.Option("--out", help="JSON file for the result.")] = None,
    model: options.Model = None,
    format: options.Format = None,
    mapping: options.Mapping = None,
    unit: options.Units = None,
    command_topic: options.CommandTopic = None,
    measured_topic: options.MeasuredTopic = None,
    seed: options.Seed = 0,
    jobs: options.Jobs = None,
    overwrite: options.Overwrite = False,
) -> int:
    """Try a fit on robots whose numbers are known.

    They are drawn around the model, moved by the commands of your logs (or designed ones), logged with noise, and
    fitted as identify would: what these motions can tell about this robot, before anything is believed.

    Exit code 3 if a number is missed: said to be determined, and outside its interval.
    """
    from trueup.identify import IdentifyConfig
    from trueup.robots import load_robot
    from trueup.stages import selftest as run

    if out_file is not None and out_file.exists() and not overwrite:
        raise OutputExists(f"{out_file} exists", hint="Give --overwrite, or choose another --out.")
    with iterations() as (begin, on_progress):
        begin()
        result = run(
            load_robot(robot),
            data,
            model=model,
            config=IdentifyConfig.load(config) if config else None,
            noise=noise,
            budget_s=options.budget_s(budget),
            seeds=seeds,
            format=format,
            options=options.reading(mapping, unit, command_topic, measured_topic, robot),
            seed=seed,
            jobs=jobs,
            track=track,
            on_progress=on_progress,
        )
    show(result)
    if out_file is not None:
        result.save(out_file)
        out.print(f"result: {out_file}", markup=False)
    return 3 if result.missed else 0


def show(result: SelftestResult) -> None:
    """The numbers, what was cut, and how many would be recovered."""
    answer(result)
    out.print(robot_table(result.truths[0]) if len(result.truths) == 1 else robots_table(result.truths))
    for line in result.notes:
        note(line)
    for line in what_to_record(result):
        note(line)
    levels = sorted({1e3 * level for level in result.noise.values()})
    spread = f"{levels[0]:.2g}" if levels[0] == levels[-1] else f"{levels[0]:.2g} to {levels[-1]:.2g}"
    seconds = sum(truth.seconds for truth in result.truths)
    fitted = f"{result.motion_s:.0f} s of {result.motions} motions were fitted"
    out.print(f"{fitted}, encoders with noise of {spread} mrad (or mm); {seconds:.0f} s", markup=False)
    out.print(summary(result), markup=False)
    if result.missed:
        sure = result.missed + sum(len(truth.of("recovered")) for truth in result.truths)
        problem(
            f"{result.missed} {'number is' if result.missed == 1 else 'numbers are'} missed: said to be determined, "
            f"and outside of the interval; of {sure} intervals of 95 % about {_CHANCE * sure:.1f} miss by chance",
            "Take numbers like these with more room than their intervals have; docs/selftest.md says what to look at.",
        )


def summary(result: SelftestResult) -> str:
    """How many numbers would be recovered, which not, and which are wrong."""
    numbers = [item for truth in result.truths for item in truth.numbers]
    count = Counter(item.verdict for item in numbers)
    robots = "" if len(result.truths) == 1 else f", in {len(result.truths)} drawn robots"
    parts = [f"{count['recovered']} of {len(numbers)} numbers would be recovered from these motions{robots}"]
    if count["open"]:
        parts.append(f"{count['open']} are not determined: {_named(numbers, 'open')}")
    if count["missed"]:
        parts.append(f"{count['missed']} are missed: {_named(numbers, 'missed')}")
    return "; ".join(parts)


def what_to_record(result: SelftestResult) -> list[str]:
    """For each kind of number that stays open, of which joints or bodies, and which motion would show it."""
    targets: dict[tuple[str, str], dict[str, None]] = {}
    for truth in result.truths:
        for item in truth.of("open"):
            name, target = split_name(item.name)
            targets.setdefault((name, item.excite), {})[target or "the robot"] = None
    return [
        f"to determine {name}: {excite.format(target=_listed(list(own)))}" for (name, excite), own in targets.items()
    ]


def _named(numbers: list[DrawnNumber], verdict: str) -> str:
    return _listed(list(dict.fromkeys(item.name for item in numbers if item.verdict == verdict)))


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
    return ", ".join(names[:_MOST_NAMES]) + more


def robot_table(truth: DrawnRobot) -> Table:
    """One row per number of a drawn robot."""
    table = Table(title=f"a robot drawn around the model (seed {truth.seed}) [95 % interval]", title_justify="left")
    table.add_column("parameter")
    for name in ("truth", "model said", "fitted", "interval"):
        table.add_column(name, justify="right")
    table.add_column("unit")
    table.add_column("verdict")
    table.add_column("what the fit says", overflow="fold")
    for item in truth.numbers:
        table.add_row(
            escape(item.name),
            f"{item.truth:.4g}",
            "none" if item.nominal is None else f"{item.nominal:.4g}",
            "" if item.value is None else f"{item.value:.4g}",
            "" if item.interval is None else f"[{item.interval[0]:.3g}, {item.interval[1]:.3g}]",
            item.unit,
            item.verdict,
            escape(_remark(item)),
            style=_STYLE[item.verdict],
        )
    return table


def _remark(item: DrawnNumber) -> str:
    if item.verdict == "missed" and item.off is not None:
        return f"{item.off:.2g} half intervals from the truth"
    # The motion that shows it is said once, below.
    return item.sentence.partition(": ")[0]


def robots_table(truths: tuple[DrawnRobot, ...]) -> Table:
    """One row per number, over several drawn robots."""
    table = Table(title=f"{len(truths)} robots drawn around the model", title_justify="left")
    table.add_column("parameter")
    table.add_column("model said", justify="right")
    table.add_column("unit")
    for verdict in SELFTEST_VERDICTS:
        table.add_column(verdict, justify="right")
    for rows in zip(*(truth.numbers for truth in truths), strict=True):
        first, count = rows[0], Counter(item.verdict for item in rows)
        worst = max(count, key=SELFTEST_VERDICTS.index)
        table.add_row(
            escape(first.name),
            "none" if first.nominal is None else f"{first.nominal:.4g}",
            first.unit,
            *(str(count[verdict]) if count[verdict] else "" for verdict in SELFTEST_VERDICTS),
            style=_STYLE[worst],
        )
    return table
