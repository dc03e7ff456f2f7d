"""The latest figures of every benchmark, in one table.

A benchmark that keeps a result of its own, `results/NAME.json`, has a function `rows` that reads its figures from it.
Those of the others are kept together, in `results/figures.json`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.table import Row, bound, rounded
from trueup.core.atomic import read_json, write_json
from trueup.core.provenance import provenance
from trueup.stages.timing import machine_name

PATH = Path(__file__).parent / "results" / "figures.json"


def stored(path: Path = PATH) -> dict[str, dict[str, Any]]:
    """Benchmark without a result of its own -> its rows, and when, where and on which commit they were measured."""
    found: dict[str, dict[str, Any]] = read_json(path) if path.is_file() else {}
    return found


def keep(name: str, rows: Sequence[Row], path: Path = PATH) -> None:
    """Put the rows of a benchmark in the place of those that were measured before, if it keeps no result of its own."""
    if own_result(name, path).is_file():
        return
    made = provenance(config={}, seed=0)
    entry = {
        "created": made["created"],
        "git": made["git"],
        "machine": machine_name(),
        "rows": [rounded(asdict(row)) for row in rows],
    }
    # Read again: another benchmark may have ended meanwhile.
    write_json(path, {**stored(path), name: entry})


def own_result(name: str, path: Path = PATH) -> Path:
    """Where a benchmark keeps its own result, if it does."""
    return path.with_name(f"{name}.json")


def known(name: str, path: Path = PATH) -> dict[str, Any] | None:
    """What was last measured: its rows, when and on which commit; None if it never was."""
    own = own_result(name, path)
    if not own.is_file():
        return stored(path).get(name)
    result = read_json(own)
    found = import_module(f"benchmarks.{name}").rows(result)
    made = result["provenance"]
    return {"created": made["created"], "git": made["git"], "rows": [asdict(row) for row in found]}


def measured(name: str, options: Sequence[str] = ()) -> list[Row]:
    """Run a benchmark, with options if it has any."""
    module = import_module(f"benchmarks.{name}")
    rows: list[Row] = module.run_with(options) if options else module.run()
    return rows


def rows_of(entry: Mapping[str, Any]) -> list[Row]:
    """The rows as they were measured."""
    return [Row(**row) for row in entry["rows"]]


def cells(name: str, entry: Mapping[str, Any]) -> Iterable[tuple[str, ...]]:
    """One line for each figure: benchmark, what, figure, limit, ratio, unit, verdict, when."""
    for row in rows_of(entry):
        ratio = f"{row.value / row.limit:.2f}" if row.limit else ""
        verdict = "" if row.limit is None else "ok" if row.ok else "MISSED"
        yield (
            name,
            row.name,
            f"{row.value:.4g}",
            bound(asdict(row)),
            ratio,
            row.unit,
            verdict,
            f"{entry['created'][:10]} {entry['git']}",
        )


def print_all(names: Iterable[str], path: Path = PATH) -> None:
    """One table of all that is known, and what was never measured."""
    table = Table(title="all benchmarks")
    for heading in ("benchmark", "what", "figure", "limit", "ratio", "unit", "", "measured"):
        table.add_column(heading, justify="right" if heading in ("figure", "limit", "ratio") else "left")
    unknown, held, missed = [], 0, 0
    for name in names:
        entry = known(name, path)
        if entry is None:
            unknown.append(name)
            continue
        for line in cells(name, entry):
            colored = {"ok": "[green]ok[/]", "MISSED": "[bold red]MISSED[/]"}.get(line[6], "")
            table.add_row(*(part.replace("[", "\\[") for part in line[:6]), colored, line[7])
            held, missed = held + (line[6] == "ok"), missed + (line[6] == "MISSED")
        table.add_section()
    Console(width=200).print(table)
    print(f"{held} limits kept, {missed} missed")
    if unknown:
        print(f"never measured here: {', '.join(unknown)}")
