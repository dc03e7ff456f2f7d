"""`trueup demo` as a newcomer meets it: how long it takes, whether the fit is ok, and what its last lines say."""

import os
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.table import Row, at_least, at_most
from trueup.core.atomic import write_json
from trueup.core.fit_result import FitResult
from trueup.core.provenance import provenance
from trueup.stages.timing import machine_name

RESULT = Path(__file__).parent / "results" / "first_look.json"
_LONGEST_S, _LEAST = 90.0, 90.0
_SENTENCES = 3


def run() -> list[Row]:
    """Run it once, and keep what it says."""
    with TemporaryDirectory() as place:
        out, began = Path(place) / "demo", time.monotonic()
        line = [sys.executable, "-m", "trueup", "demo", "--out", str(out)]
        done = subprocess.run(line, capture_output=True, text=True, env={**os.environ, "COLUMNS": "400"}, check=False)
        seconds = time.monotonic() - began
        fit = FitResult.load(out / "fit.json")
        result: dict[str, Any] = {
            "schema": "trueup.first_look/1",
            "seconds": round(seconds, 1),
            "code": done.returncode,
            "status": fit.status,
            "said": done.stdout.strip().splitlines()[-_SENTENCES:],
            "errors": {name: fit.errors[name]["test"].value for name in ("nominal", "fitted")},
            "provenance": provenance(config={"machine": {"name": machine_name()}}, seed=0),
        }
    write_json(RESULT, result)
    return rows(result)


def rows(result: Mapping[str, Any]) -> list[Row]:
    """The figures of a result."""
    before, after = (result["errors"][name] for name in ("nominal", "fitted"))
    fine = result["code"] == 0 and result["status"] == "ok"
    return [
        at_most("trueup demo, from the command to its last line", result["seconds"], _LONGEST_S, "s"),
        at_least("trueup demo: error on motions not seen, less by", 100 * (1 - after / before), _LEAST, "%"),
        at_least("trueup demo: the fit is ok, and the exit code 0", float(fine), 1.0, ""),
    ]
