"""Run all benchmarks, or those named: `python -m benchmarks replay pipeline`."""

import json
import sys
from dataclasses import asdict
from importlib import import_module
from pathlib import Path

from benchmarks.table import print_table
from trueup.core.provenance import provenance

NAMES = ("dataset_io", "import_sage", "import_mcap", "replay", "pipeline")
RESULTS = Path(__file__).parent / "results"


def main() -> None:
    """Print one table per benchmark and keep the figures as JSON."""
    missed = []
    for name in sys.argv[1:] or NAMES:
        rows = import_module(f"benchmarks.{name}").run()
        print_table(rows, name)
        missed += [row.name for row in rows if not row.ok]
        RESULTS.mkdir(exist_ok=True)
        tree = {"rows": [asdict(row) for row in rows], "provenance": provenance(config={"benchmark": name})}
        (RESULTS / f"{name}.json").write_text(json.dumps(tree, indent=2) + "\n")
    if missed:
        sys.exit(f"missed: {', '.join(missed)}")


if __name__ == "__main__":
    main()
