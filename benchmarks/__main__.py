"""Run the benchmarks and print one table of all figures: `python -m benchmarks`; or those named: `replay pipeline`.

Trainings take a day. Their results are kept (benchmarks/results), and stand in the table with the date and the commit
that they are of; `--anew` makes them again, too. `--kept` goes on with what has no figures yet, and `--table` measures
nothing.
"""

import argparse
import sys
import traceback
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from benchmarks.figures import keep, known, measured, print_all
from benchmarks.table import Row, print_table, write_rows

# Minutes each.
SHORT = (
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
    "training",
    "streaming",
    "sat_speed",
    "compensate_env",
    "compensate_speed",
    "policy_env",
    "policy_loop",
    "ros2_bridge",
    "fleet",
    "drafting",
    "first_look",
    "xl330",
)
# Hours each, or one hour at least: measured when they are named, or with --anew.
LONG = (
    "fresh_clone",
    "thesis",
    "real_robots",
    "panda",
    "augment",
    "papers_error",
    "sat",
    "sat_so101",
    "sat_bodies",
    "sat_robustness",
    "sat_training",
    "compensation",
    "compensation_ablations",
    "compensation_robot",
    "compensation_ways",
    "whole_body",
    "policy_transfer",
    "policy_going_on",
    "policy_algorithms",
    "policy_grid",
    "ros2_hour",
    "close",
    "foreign",
    "foreign_logs",
    "foreign_models",
)
NAMES = SHORT + LONG
# What has options of its own, which stand behind its name.
WITH_OPTIONS = ("drafting", "foreign", "foreign_logs", "foreign_models")


def main() -> None:
    """Print one table per benchmark as it ends, then one of all; leave with 1 if a figure misses its limit."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description=__doc__,
        epilog="foreign has options of its own: --cases A,B --seeds 0,1 --jobs N --oracle --again.",
        allow_abbrev=False,
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help="of a benchmark; without one, all but trainings")
    parser.add_argument("--anew", action="store_true", help="trainings, too: a day")
    parser.add_argument("--rows", type=Path, metavar="FILE", help="also store the figures as JSON")
    parser.add_argument("--kept", action="store_true", help="measure only what has no figures yet")
    parser.add_argument("--table", action="store_true", help="measure nothing: the table of what is there")
    options, own = parser.parse_known_args()
    if own and (len(options.names) != 1 or options.names[0] not in WITH_OPTIONS):
        parser.error(f"unrecognized arguments: {' '.join(own)}")
    if unknown := sorted(set(options.names) - set(NAMES)):
        parser.error(f"no benchmark {', '.join(unknown)}; there are {', '.join(NAMES)}")
    if options.table:
        print_all(options.names or NAMES)
        return
    names = options.names or (NAMES if options.anew else SHORT)
    rows: dict[str, list[Row]] = {}
    broken = []
    for name in names:
        if options.kept and known(name) is not None:
            continue
        try:
            rows[name] = _run(name, *own)
        except Exception:  # the others are worth their hours all the same
            traceback.print_exc()
            broken.append(name)
        else:
            if rows[name]:
                keep(name, rows[name])
                print_table(rows[name], name)
    if not options.names:
        print_all(NAMES)
    if options.rows:
        write_rows(rows, options.rows)
    missed = [row.name for own in rows.values() for row in own if not row.ok]
    said = [f"missed: {', '.join(missed)}"] * bool(missed) + [f"broke off: {', '.join(broken)}"] * bool(broken)
    if said:
        sys.exit("; ".join(said))


def _run(name: str, *own: str) -> list[Row]:
    """In a process of its own: threads, cores and memory that one benchmark has settled are not those of the next."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(measured, name, own).result()


if __name__ == "__main__":
    main()
