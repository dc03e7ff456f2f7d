"""Run all benchmarks, or those named: `python -m benchmarks replay pipeline`."""

import argparse
import sys
from importlib import import_module
from pathlib import Path

from benchmarks.table import print_table, write_rows

NAMES = (
    "dataset_io",
    "import_sage",
    "import_mcap",
    "replay",
    "references",
    "planning",
    "friction",
    "engines",
    "lab",
    "alignment",
    "recording",
    "papers_tenth",
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
    "sat",
    "sat_so101",
    "streaming",
    "sat_speed",
    "sat_bodies",
    "sat_robustness",
    "sat_training",
    "compensation",
    "compensation_ablations",
    "compensation_robot",
    "compensation_ways",
    "compensate_env",
    "whole_body",
    "compensate_speed",
    "policy_env",
    "policy_loop",
    "policy_transfer",
    "policy_going_on",
    "policy_algorithms",
    "policy_grid",
    "ros2_bridge",
    "ros2_hour",
    "fleet",
)


def main() -> None:
    """Print one table per benchmark; leave with 1 if a figure misses its limit."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="of a benchmark; all of them without a name")
    parser.add_argument("--rows", type=Path, metavar="FILE", help="also store the figures as JSON")
    options = parser.parse_args()
    rows = {}
    for name in options.names or NAMES:
        rows[name] = import_module(f"benchmarks.{name}").run()
        print_table(rows[name], name)
    if options.rows:
        write_rows(rows, options.rows)
    missed = [row.name for own in rows.values() for row in own if not row.ok]
    if missed:
        sys.exit(f"missed: {', '.join(missed)}")


if __name__ == "__main__":
    main()
