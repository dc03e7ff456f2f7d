"""`python -m attack`: every parser against many damaged files, every writer killed; results go into benchmarks/results/attack.json."""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from attack.harness import HERE, Attacker, Tally, all_parsers, attack, reproduce, source_hash
from attack.kill import WRITERS, assaulted

RESULTS = HERE.parent.parent / "benchmarks" / "results" / "attack.json"
KILLS = 100
_EVERY = 200  # cases between two lines of progress


def main() -> int:
    """The command; 1 if there is a defect."""
    command = argparse.ArgumentParser(prog="python -m attack")
    command.add_argument("--parser", action="append", help="only this one; may be given several times")
    command.add_argument("--case", type=int, help="one case, in this process")
    command.add_argument("--mutations", type=int, default=int(os.environ.get("TRUEUP_MUTATIONS", "10000")))
    command.add_argument("--results", type=Path, default=RESULTS)
    chosen = command.parse_args()
    with tempfile.TemporaryDirectory(prefix="attack", dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as folder:
        base = Path(folder).resolve()
        if chosen.case is not None:
            reproduce(chosen.parser[0], chosen.case, base)
            return 0
        return _all(chosen, base)


def _all(chosen: argparse.Namespace, base: Path) -> int:
    found, source = 0, source_hash()
    attacker = Attacker(base / "work")
    for name in chosen.parser or [*all_parsers(), *(f"kill {writer}" for writer in WRITERS)]:
        count = KILLS if name.startswith("kill ") else chosen.mutations
        known = _read(chosen.results).get(name, {})
        if known.get("source") == source and known.get("mutations", 0) >= count and not known.get("defects"):
            print(f"{name}: done before")
            continue
        tally = _killed(name, base) if name.startswith("kill ") else _attacked(attacker, name, count)
        found += len(tally.defects)
        entry = {
            "mutations": tally.mutations,
            "cut_short": tally.cut_short,
            "outcomes": dict(sorted(tally.outcomes.items())),
            "defects": {str(number): what[:200] for number, what in list(tally.defects.items())[:20]},
            "seconds": round(tally.seconds, 1),
            "source": source,
        }
        # Read again: another attack may have written meanwhile.
        chosen.results.write_text(json.dumps({**_read(chosen.results), name: entry}, indent=1, sort_keys=True) + "\n")
        print(f"{name}: {entry['mutations']} times, {entry['outcomes']}, {len(tally.defects)} defects", flush=True)
    attacker.close()
    return 1 if found else 0


def _attacked(attacker: Attacker, name: str, count: int) -> Tally:
    seen: set[int] = set()
    for tally in attack(attacker, name, range(count)):
        for number in tally.defects.keys() - seen:
            print(f"{name} case {number}: {tally.defects[number]}", flush=True)
        seen = set(tally.defects)
        if tally.mutations % _EVERY == 0:
            print(f"{name} {tally.mutations}/{count} {tally.seconds:.0f} s", file=sys.stderr, flush=True)
    return tally


def _killed(name: str, base: Path) -> Tally:
    start = time.monotonic()
    wrong = assaulted(name.removeprefix("kill "), base / "killed", KILLS)
    for number, what in wrong.items():
        print(f"{name} {number}: {what}", flush=True)
    return Tally(KILLS, 0, Counter(completed=KILLS - len(wrong)), wrong, time.monotonic() - start)


def _read(path: Path) -> dict[str, dict[str, object]]:
    return dict(json.loads(path.read_text())) if path.exists() else {}


if __name__ == "__main__":
    sys.exit(main())
