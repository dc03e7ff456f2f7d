"""What the verdict of `trueup identify` is worth: fits of robots whose numbers are known, made by nothing of trueup's.

Each case and seed of `foreign_cases.py` is a cell: its truth is simulated, `trueup close --until identify` is given the
logs as a user would, and what it says is kept beside the truth. Cells are kept one by one in
`benchmarks/results/foreign.json`, from which docs/verdict-worth.md is made; one that is there is not measured again, so
an interrupted call is continued by the same command. A day for all of them on two cores.

`python -m benchmarks foreign --cases demo_arm,ur5e --seeds 0 --jobs 2` measures some. `--oracle` adds the narrowest
intervals that there can be (`foreign_oracle.py`) for seed 1 of group A, a minute or two for each cell that is there.
Cells that are measured side by side share the cores, but each has the budget of its command for itself: with more jobs
than one, a large robot may be cut short where it would not be alone. `--budget 40m` gives each more, and the
page says so.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import trueup
from benchmarks import foreign_verdicts as verdicts
from benchmarks.foreign_cases import CASES, Case
from benchmarks.foreign_robots import ROBOTS, foreign_folder
from benchmarks.foreign_verdicts import Cell
from benchmarks.table import Row
from trueup.core.atomic import make_folder, read_json, write_json
from trueup.core.check_result import CHECK_NAME, CheckResult
from trueup.core.close_result import CLOSE_NAME, CloseResult
from trueup.core.fit_result import FitResult
from trueup.core.provenance import provenance
from trueup.stages.timing import machine_name

RESULT = Path(__file__).parent / "results" / "foreign.json"
FOLDER = Path("runs") / "foreign"
SEEDS, ORACLE_SEED = (0, 1, 2), 1
SPLITS = "70/15/15"
BY_NAME = {case.name: case for case in CASES}
# Longer than any budget: what takes this long hangs [s].
_LONGEST_S = 3600.0
# Exit code of `trueup` after Ctrl-C.
_INTERRUPTED = 130
# Lines of what a command printed that are kept where it left no fit.
_LAST_LINES = 12


@dataclass(frozen=True)
class Wanted:
    """What a call is asked for.

    Attributes:
        cases: names of cases.
        seeds: of each.
        jobs: cells at a time.
        oracle: also the narrowest intervals that there can be.
        again: measure also what is there.
        budget: of each command, where the machine has other work, too; its default if empty.
    """

    cases: tuple[str, ...] = tuple(BY_NAME)
    seeds: tuple[int, ...] = SEEDS
    jobs: int = 1
    oracle: bool = False
    again: bool = False
    budget: str = ""


def run() -> list[Row]:
    """Measure every cell that is not there yet."""
    return measure(Wanted())


def run_with(arguments: Sequence[str]) -> list[Row]:
    """The same for what the command line asks for."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks foreign", description=__doc__)
    parser.add_argument("--cases", metavar="A,B", default=",".join(BY_NAME), help="names of cases; all if not given")
    parser.add_argument("--seeds", metavar="0,1", default=",".join(map(str, SEEDS)), help="of each case; 0,1,2")
    parser.add_argument("--jobs", type=int, default=1, help="cells at a time, which share the cores; 1")
    parser.add_argument("--oracle", action="store_true", help="also the narrowest intervals that there can be")
    parser.add_argument("--again", action="store_true", help="measure also what is there")
    parser.add_argument("--budget", default="", help="time for each command; its default if not given")
    options = parser.parse_args(arguments)
    cases = tuple(options.cases.split(","))
    if unknown := [name for name in cases if name not in BY_NAME]:
        parser.error(f"no case {', '.join(unknown)}; there are {', '.join(BY_NAME)}")
    if not all(seed.isdecimal() for seed in options.seeds.split(",")) or options.jobs < 1:
        parser.error("seeds are numbers such as 0,1,2, and jobs at least 1")
    seeds = tuple(map(int, options.seeds.split(",")))
    return measure(Wanted(cases, seeds, options.jobs, options.oracle, options.again, options.budget))


def rows(result: Mapping[str, Any]) -> list[Row]:
    """The figures of a result."""
    return verdicts.rows(result)


def measure(wanted: Wanted, path: Path = RESULT) -> list[Row]:
    """Measure what is wanted and not there; every cell is kept as soon as it ends."""
    result = stored(path)
    tasks: dict[str, Callable[[], dict[str, Any]]] = {}
    threads = max(1, (os.cpu_count() or 1) // wanted.jobs)
    for name in wanted.cases:
        if not (ROBOTS[BY_NAME[name].robot].own or foreign_folder().is_dir()):
            print(f"{name}: left out, its model is not here: set TRUEUP_SHARED", flush=True)
            continue
        for seed in wanted.seeds:
            tasks[f"{name}/{seed}"] = partial(closed, name, seed, threads=threads, budget=wanted.budget)
    left = {key: work for key, work in tasks.items() if wanted.again or key not in result["cells"]}
    print(f"{len(tasks) - len(left)} of {len(tasks)} cells are there", flush=True)
    # Threads: what takes long is a process of its own, and Ctrl-C ends those and no more.
    with ThreadPoolExecutor(wanted.jobs) as pool:
        running: dict[Future[dict[str, Any]], str] = {pool.submit(work): key for key, work in left.items()}
        try:
            for number, future in enumerate(as_completed(running), 1):
                key = running[future]
                try:
                    cell = future.result()
                except Exception:  # the other cells are worth their minutes all the same
                    traceback.print_exc()
                    print(f"{key}: no cell", flush=True)
                    continue
                keep(path, "cells", key, cell)
                print(f"{number} of {len(left)}: {in_words(key, cell)}", flush=True)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    if wanted.oracle and ORACLE_SEED in wanted.seeds:
        _measure_oracles(wanted, path)
    return rows(stored(path))


def _measure_oracles(wanted: Wanted, path: Path) -> None:
    """Those of cells that are there, one after the other: each takes all cores."""
    result = stored(path)
    for name in wanted.cases:
        key = f"{name}/{ORACLE_SEED}"
        cell = result["cells"].get(key)
        if BY_NAME[name].group == "A" and cell and cell["numbers"] and (wanted.again or key not in result["oracles"]):
            began = time.perf_counter()
            keep(path, "oracles", key, known(name, ORACLE_SEED, cell))
            print(f"{key}: narrowest intervals, {time.perf_counter() - began:.0f} s", flush=True)


def stored(path: Path = RESULT) -> dict[str, dict[str, Any]]:
    """What is kept: `cells` and `oracles`, each by CASE/SEED in the order of the cases."""
    result = read_json(path) if path.is_file() else {}
    order = {name: number for number, name in enumerate(BY_NAME)}

    def place(key: str) -> tuple[int, int]:
        name, _, seed = key.partition("/")
        return order.get(name, len(order)), int(seed)

    kinds = {kind: result.get(kind, {}) for kind in ("cells", "oracles")}
    return {kind: {key: own[key] for key in sorted(own, key=place)} for kind, own in kinds.items()}


def keep(path: Path, kind: str, key: str, cell: Mapping[str, Any]) -> None:
    """Put one cell beside those that are there; another call may have ended meanwhile."""
    result = stored(path)
    result[kind][key] = dict(cell)
    make_folder(path.parent)
    made = provenance(config={"seeds": list(SEEDS), "splits": SPLITS, "machine": {"name": machine_name()}}, seed=0)
    write_json(path, {"schema": "trueup.foreign/1", **result, "provenance": made})


def in_words(key: str, cell: Mapping[str, Any]) -> str:
    """A cell in one line."""
    own = verdicts.judged(cell["numbers"])
    held = sum(map(verdicts.holds, own))
    return f"{key}: {cell['status']}, {held} of {len(own)} determined numbers hold the truth, {cell['seconds']:.0f} s"


def closed(name: str, seed: int, *, threads: int, budget: str = "") -> dict[str, Any]:
    """One cell: the truth, `trueup close --until identify` with its defaults, and what came of it."""
    case, folder = BY_NAME[name], FOLDER / f"{name}-{seed}"
    truth, load = _made(case, seed, folder), os.getloadavg()[0]
    command = ("close", "logs", "--robot", "robot.yaml", "--out", "out", "--until", "identify", "--splits", SPLITS)
    ended = _ran(folder, (*command, *(("--budget", budget) if budget else ())), threads, _LONGEST_S)
    found = {**found_in(folder / "out", truth, ended.code), **({"budget": budget} if budget else {})}
    return {**about(case, truth), **found, **ended.to_json(), **_made_by(load)}


def known(name: str, seed: int, cell: Cell) -> dict[str, Any]:
    """The narrowest intervals of what a cell has fitted, from the same motions."""
    from benchmarks.foreign_oracle import intervals

    folder, load = FOLDER / f"{name}-{seed}-known", os.getloadavg()[0]
    _made(BY_NAME[name], seed, folder)
    motions = [int(motion.removeprefix("m")) for motion in cell["fit"]["episodes"]]
    free = [row["name"] for row in cell["numbers"] if not row["frozen"]]
    return {"numbers": intervals(BY_NAME[name], seed, folder, motions, free), **_made_by(load)}


def about(case: Case, truth: Mapping[str, Any]) -> dict[str, Any]:
    """What a cell is of."""
    return {
        "case": case.name,
        "group": case.group,
        "robot": case.robot,
        "drive": case.drive,
        "commands": case.commands,
        "engine": case.engine,
        "seed": truth["seed"],
        "joints": list(case.joints),
        "cause": dict(truth["cause"]),
        "noise": truth["noise"]["position"],
        "saturated": {joint: share for joint, share in truth["saturated"].items() if share},
    }


def found_in(out: Path, truth: Mapping[str, Any], code: int) -> dict[str, Any]:
    """What a command left in its folder, beside the truth.

    `status` is that of the fit; `stopped` where the check was certain that the set-up is wrong, so that nothing was
    fitted; `failed` where there is no fit for another reason.
    """
    check = CheckResult.load(out / CHECK_NAME) if (out / CHECK_NAME).is_file() else None
    steps = CloseResult.load(out / CLOSE_NAME).steps if (out / CLOSE_NAME).is_file() else ()
    findings = [
        {"kind": item.kind, "severity": item.severity, "joints": list(item.joints), "evidence": item.evidence}
        for item in (check.findings if check else ())
    ]
    found = {
        "code": code,
        "findings": findings,
        "steps": {step.name: {"seconds": round(step.seconds, 1), "status": step.status} for step in steps},
    }
    if not (out / "fit.json").is_file():
        status = "stopped" if check is not None and check.certain else "failed"
        return {**found, "status": status, "statements": [], "numbers": [], "sums": [], "left": {}, "fit": {}}
    fit = FitResult.load(out / "fit.json")
    with np.load(out / "fit.samples.npz", allow_pickle=False) as file:
        draws = {name: file[name] for name in file.files}
    return {
        **found,
        "status": fit.status,
        "statements": list(fit.statements),
        "numbers": verdicts.numbers(fit, truth),
        "sums": verdicts.sums(fit, draws, truth),
        "left": {joint: {"rms": item.rms, "noise": item.noise} for joint, item in fit.whiteness.items()},
        "fit": {
            "model": next((row.name for row in fit.models if row.chosen), None),
            "solver": fit.solver["name"],
            "stop": fit.solver["stop"],
            "short_of_time": fit.short_of_time,
            **{key: fit.data.get(key) for key in ("episodes", "seconds", "timestep_s", "command", "window_s")},
        },
    }


@dataclass(frozen=True)
class Ended:
    """How a command ended: exit code, wall-clock time [s], and the last of what it printed."""

    code: int
    seconds: float
    said: str

    def to_json(self) -> dict[str, Any]:
        """As cells have it."""
        return {"code": self.code, "seconds": round(self.seconds, 1), "said": self.said if self.code else ""}


def _made(case: Case, seed: int, folder: Path) -> dict[str, Any]:
    """The truth in an empty folder."""
    from benchmarks.foreign_truth import make

    shutil.rmtree(folder, ignore_errors=True)
    make(case, seed, folder)
    truth: dict[str, Any] = read_json(folder / "truth.json")
    return truth


def _ran(folder: Path, command: Sequence[str], threads: int, longest_s: float) -> Ended:
    """`trueup` as a process of its own in a folder, with all cores unless cells share them."""
    shared = ("--jobs", str(threads)) if threads != os.cpu_count() else ()
    package = str(Path(trueup.__file__).parents[1])  # this one, wherever the process begins
    began = time.perf_counter()
    try:
        done = subprocess.run(
            [sys.executable, "-m", "trueup", *command, *shared],
            cwd=folder,
            env={**os.environ, "COLUMNS": "200", "PYTHONPATH": package},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=longest_s,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return Ended(124, time.perf_counter() - began, f"took more than {longest_s:g} s")
    if done.returncode < 0 or done.returncode == _INTERRUPTED:
        raise RuntimeError(f"trueup {command[0]} was ended from outside ({done.returncode}): that says nothing of it")
    printed = done.stdout.replace(str(folder.resolve()), ".")
    (folder / f"{command[0]}.txt").write_text(printed)
    lines = [line for line in printed.splitlines() if line.strip()]
    return Ended(done.returncode, time.perf_counter() - began, "\n".join(lines[-_LAST_LINES:]))


def _made_by(load: float) -> dict[str, Any]:
    """Where a cell comes from."""
    made = provenance(config={}, seed=0)
    keys = ("created", "git", "trueup", "python", "packages")
    return {"made": {**{key: made[key] for key in keys}, "machine": machine_name(), "load_before": round(load, 1)}}
