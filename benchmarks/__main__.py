"""Run all benchmarks, or those named: `python -m benchmarks replay pipeline`."""

import sys
from importlib import import_module

from benchmarks.table import print_table

NAMES = (
    "dataset_io",
    "import_sage",
    "import_mcap",
    "replay",
    "planning",
    "friction",
    "engines",
    "lab",
    "alignment",
    "recording",
    "pipeline",
    "identify_servo",
    "identify_torque",
    "identify_jobs",
    "identify_pace",
    "thesis",
    "real_robots",
    "panda",
    "training",
    "augment",
    "streaming",
)


def main() -> None:
    """Print one table per benchmark; leave with 1 if a figure misses its limit."""
    missed = []
    for name in sys.argv[1:] or NAMES:
        rows = import_module(f"benchmarks.{name}").run()
        print_table(rows, name)
        missed += [row.name for row in rows if not row.ok]
    if missed:
        sys.exit(f"missed: {', '.join(missed)}")


if __name__ == "__main__":
    main()
