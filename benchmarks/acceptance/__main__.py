"""Measure every line on one commit, write `benchmarks/results/acceptance.json` and the pages: two hours on two cores.

What is measured is kept under runs/acceptance/COMMIT: an interrupted table is continued by the same command.
"""

from __future__ import annotations

import json
import re
import subprocess
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks.acceptance.lines import LINES, Line, reason
from benchmarks.acceptance.sources import ROOT, Source
from benchmarks.pages.__main__ import main as write_pages
from trueup.core.atomic import make_folder, write_json
from trueup.core.provenance import provenance

RESULT = ROOT / "benchmarks" / "results" / "acceptance.json"
# What the measuring itself writes.
_WRITTEN = ("benchmarks/results", "docs")


def main() -> None:
    """Measure what is not measured yet, write the table."""
    commit = _commit()
    kept = ROOT / "runs" / "acceptance" / commit
    make_folder(kept)
    measured: dict[str, dict[str, Any]] = {}
    for source in dict.fromkeys(line.source for line in LINES):
        measured[source.command] = own = _measured(source, kept)
        for line in LINES:
            if line.source == source:
                _line(line, own)  # what lacks a figure is said before the next hour
    lines = [_line(line, measured[line.source.command]) for line in LINES]
    seconds = sum(own["seconds"] for own in measured.values())
    made = provenance(config={"seconds": round(seconds)}, seed=0) | {"git": commit}
    write_json(RESULT, {"schema": "trueup.acceptance/1", "lines": lines, "provenance": made})
    write_pages()
    missed = [row["name"] for line in lines for row in line["rows"] if not row["ok"]]
    print(f"{len(lines)} lines on {commit}; missed: {', '.join(missed) or 'nothing'}")


def _commit() -> str:
    """The commit that is measured; a changed source would make the table a lie."""
    changed = _git("status", "--porcelain", "--", ".", *(f":!{path}" for path in _WRITTEN))
    if changed:
        raise SystemExit(f"commit first: the table is of one commit, and these are changed:\n{changed}")
    return _git("rev-parse", "--short=10", "HEAD")


def _git(*command: str) -> str:
    return subprocess.run(["git", *command], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()


def _measured(source: Source, kept: Path) -> dict[str, Any]:
    file = kept / (re.sub(r"\W+", "-", source.command) + ".json")
    if not file.is_file():
        print(f"--- {source.command}", flush=True)
        began = time.perf_counter()
        rows = source.measure()
        write_json(file, {"rows": [asdict(row) for row in rows], "seconds": time.perf_counter() - began})
    found: dict[str, Any] = json.loads(file.read_text())
    return found


def _line(line: Line, measured: dict[str, Any]) -> dict[str, Any]:
    names = [row["name"] for row in measured["rows"]]
    absent = [start for start in line.rows if not any(name.startswith(start) for name in names)]
    if absent:
        raise LookupError(f"{line.source.command} has no figure that begins with {', '.join(absent)}")
    rows = [row for row in measured["rows"] if not line.rows or row["name"].startswith(line.rows)]
    return {
        "part": line.part,
        "kind": line.kind,
        "asks": line.asks,
        "command": line.source.command,
        "rows": [row | {"reason": "" if row["ok"] else reason(row["name"])} for row in rows],
    }


if __name__ == "__main__":
    main()
