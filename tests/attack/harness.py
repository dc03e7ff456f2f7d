"""Every parser reads thousands of damaged files in a process of its own: a clear answer, or a defect with its number.

A parser is one entry of `PARSERS` in a module `parsers_*.py` of this folder. `python -m attack` attacks all of them,
`python -m attack --parser NAME --case NUMBER` one case, here and now, with its traceback.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import multiprocessing
import os
import random
import re
import resource
import shutil
import sys
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from attack.mutations import mutate

HERE = Path(__file__).resolve().parent
SECONDS = 10.0  # of a processor, for one small folder
HANG_SECONDS = 40.0  # on a wall of a busy machine
GIGABYTE = 1 << 30
LONGEST_MESSAGE = 4000
CASES_PER_WORKER = 2500
CUT_SHORT = "changes that ended with"
UNCHANGED = -1  # the number of a case in which nothing is changed


class Unsound(Exception):
    """What was read without an error makes no sense."""


@dataclass(frozen=True)
class Parser:
    """Something that reads files.

    Attributes:
        name: e.g. `npz`.
        make: writes good files into an empty folder; small ones.
        read: reads everything in the folder; yields errors of trueup.errors that do not stop it, raises one that does,
            and Unsound for nonsense.
        edit: a change of its own to the folder, in place of those of `mutations`, in every third case.
        refuses: whether there is something to refuse in the good files, too.
    """

    name: str
    make: Callable[[Path], None]
    read: Callable[[Path], Iterable[Exception]]
    edit: Callable[[Path, random.Random], str] | None = None
    refuses: bool = False


@dataclass(frozen=True)
class Writer:
    """Something that writes, and may be killed.

    Attributes:
        name: e.g. `import`.
        write: from the base folder; may be called again after it was killed.
        check_part: what must hold after a kill.
        check_whole: what must hold after a call that was not killed.
        prepare: what is there before it; a small dataset if None.
        slow: whether a call takes seconds.
    """

    name: str
    write: Callable[[Path], object]
    check_part: Callable[[Path], None]
    check_whole: Callable[[Path], None]
    prepare: Callable[[Path], None] | None = None
    slow: bool = False


@dataclass
class Tally:
    """What came of many cases.

    Attributes:
        outcomes: `read`, or the class of the error, and how often.
        cut_short: cases whose damage ended with an error, mostly on what an earlier change had done.
        defects: number of the case -> what went wrong.
        seconds: wall-clock time [s].
    """

    mutations: int = 0
    cut_short: int = 0
    outcomes: Counter[str] = field(default_factory=Counter)
    defects: dict[int, str] = field(default_factory=dict)
    seconds: float = 0.0


def all_parsers() -> dict[str, Parser]:
    """Every parser of every `parsers_*.py`, by name."""
    modules = [importlib.import_module(f"attack.{path.stem}") for path in sorted(HERE.glob("parsers_*.py"))]
    return {parser.name: parser for module in modules for parser in module.PARSERS}


def sandbox(base: Path) -> None:
    """A place where it shows when something is written outside of the folder that is read."""
    shutil.rmtree(base, ignore_errors=True)
    (base / "cwd").mkdir(parents=True)
    (base / "seeds").mkdir()
    (base / "kept").mkdir()


def prepare(parser: Parser, number: int, base: Path) -> tuple[Path, str]:
    """The folder of a case, changed, and what was done to it."""
    seed = base / "seeds" / re.sub(r"\W+", "_", parser.name)
    if not seed.exists():
        seed.mkdir()
        parser.make(seed)
    case = base / "case"
    shutil.rmtree(case, ignore_errors=True)
    (case / "outside").mkdir(parents=True)
    (case / "outside" / "sentinel").write_text("untouched")
    shutil.copytree(seed, case / "logs", symlinks=True)
    if number == UNCHANGED:
        return case / "logs", "nothing"
    rng = random.Random(f"{parser.name} {number}")
    edit = parser.edit if parser.edit is not None and rng.random() < 1 / 3 else mutate
    try:
        return case / "logs", edit(case / "logs", rng)
    except Exception as error:  # as far as it came
        return case / "logs", f"{CUT_SHORT} {error!r}"


def _listing(base: Path) -> list[tuple[str, int, int]]:
    return sorted(
        (str(path), path.lstat().st_size, path.lstat().st_mtime_ns)
        for place in (base / "cwd", base / "case" / "outside")
        for path in (place, *place.rglob("*"))
        if not path.is_dir()
    ) + [(str(path), 0, 0) for path in sorted((base / "case").iterdir())]


def _unreadable(error: Exception, base: Path) -> str:
    """What is wrong with a message, or nothing."""
    text = str(error).replace(str(base), "")
    lines = text.split("\n")
    if len(lines) > 20 or "\n" in getattr(error, "summary", ""):  # a hint may show what to write into a file
        return f"message of {len(lines)} lines"
    if len(text) > LONGEST_MESSAGE:
        return f"message of {len(text)} characters"
    if not all(line.isprintable() for line in lines) or any("\ud800" <= letter <= "\udfff" for letter in text):
        return "message that cannot be printed"
    if text.count("\\x") > 8 or not text.strip():
        return "message of raw bytes"
    return ""


def attempt(parser: Parser, folder: Path, base: Path) -> tuple[str, str]:
    """Outcome and defect of reading a folder; the defect is empty for a clear answer."""
    from trueup.errors import TrueupError

    before = _listing(base)
    Path("/proc/self/clear_refs").write_text("5")  # the peak starts anew
    used = _memory("VmRSS")
    start = time.process_time()
    outcome, wrong = "read", ""
    try:
        for error in parser.read(folder):
            outcome = f"{type(error).__name__}"
            wrong = wrong or _unreadable(error, base)
    except TrueupError as error:
        outcome, wrong = type(error).__name__, wrong or _unreadable(error, base)
        if wrong:
            wrong += f": {str(error)[:300]!r}"
    except BaseException as error:
        frames = [line.strip() for line in traceback.format_tb(error.__traceback__) if "/trueup/" in line]
        outcome = "Unsound" if isinstance(error, Unsound) else "crash"
        wrong = f"{type(error).__name__}: {str(error)[:300]} | {' | '.join(frames[-2:])}"
    if time.process_time() - start > SECONDS:
        wrong = wrong or f"took {time.process_time() - start:.1f} s"
    if _memory("VmHWM") - used > GIGABYTE:
        wrong = wrong or f"took {(_memory('VmHWM') - used) / GIGABYTE:.1f} GB of memory"
    if _listing(base) != before:
        wrong = wrong or f"wrote outside of its folder: {sorted(set(_listing(base)) ^ set(before))[:3]}"
    return outcome, wrong


def _memory(key: str) -> int:
    found = re.search(rf"{key}:\s+(\d+) kB", Path("/proc/self/status").read_text())
    return 1024 * int(found[1]) if found else 0


def _work(connection: Connection, base: Path) -> None:
    """A process that does what it is told until it is told nothing."""
    os.chdir(base / "cwd")
    with (base / "output").open("a") as output:  # libraries speak of their own accord
        os.dup2(output.fileno(), 1)
        os.dup2(output.fileno(), 2)
    warnings.simplefilter("error")
    warnings.filterwarnings("ignore", category=UserWarning)  # what MuJoCo thinks of an inertia
    warnings.filterwarnings("ignore", "invalid value", RuntimeWarning)  # a NaN of which a processor complains
    parsers = all_parsers()
    connection.send(None)
    limit = _memory("VmSize") + 6 * GIGABYTE
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for name, number in iter(connection.recv, None):
        folder, said = prepare(parsers[name], number, base)
        connection.send(("prepared", said))
        connection.send(attempt(parsers[name], folder, base))


def forking() -> Any:
    """Makes children of a process that has loaded everything and done nothing: a new one costs next to nothing."""
    os.environ["PYTHONPATH"] = os.pathsep.join(sys.path)
    context = multiprocessing.get_context("forkserver")
    names = [path.stem for pattern in ("parsers_*.py", "kill.py") for path in sorted(HERE.glob(pattern))]
    context.set_forkserver_preload([f"attack.{name}" for name in names])
    return context


def apart(what: Callable[..., Any], *arguments: Any) -> Any:
    """What it returns, called in a process that is free to be forked."""
    context = forking()
    mine, other = context.Pipe()
    process = context.Process(target=_answer, args=(other, what, arguments))
    process.start()
    other.close()
    answer = mine.recv()
    process.join()
    return answer


def _answer(connection: Connection, what: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    connection.send(what(*arguments))


class Attacker:
    """Runs cases in a worker process, and a new one when that dies or hangs."""

    def __init__(self, base: Path) -> None:
        self.base = base
        sandbox(base)
        self._process: Any = None
        self._connection: Any = None
        self._cases = 0
        self.cut_short = 0  # so far

    def case(self, name: str, number: int) -> tuple[str, str]:
        """Outcome and defect of one case."""
        if self._process is None or self._cases >= CASES_PER_WORKER:
            self.close()
            self._start()
        self._cases += 1
        self._connection.send((name, number))
        said = "?"
        try:
            _, said = self._connection.recv()
            if not self._connection.poll(HANG_SECONDS):
                outcome, wrong = "hang", f"no answer after {HANG_SECONDS:g} s"
                self.close(kill=True)
            else:
                outcome, wrong = self._connection.recv()
        except (EOFError, ConnectionError):
            self._process.join()
            outcome, wrong = "died", f"process ended with {self._process.exitcode}"
            self.close(kill=True)
        self.cut_short += said.startswith(CUT_SHORT)
        return outcome, f"{wrong} ({said})" if wrong else ""

    def _start(self) -> None:
        context = forking()
        self._connection, other = context.Pipe()
        self._process = context.Process(target=_work, args=(other, self.base), daemon=True)
        self._process.start()
        other.close()
        self._connection.recv()
        self._cases = 0

    def close(self, *, kill: bool = False) -> None:
        """End the worker."""
        if self._process is None:
            return
        if kill:
            self._process.kill()
        with contextlib.suppress(OSError):
            self._connection.send(None)
        self._process.join(5)
        self._connection.close()
        self._process = None


def attack(attacker: Attacker, name: str, numbers: Iterable[int]) -> Iterator[Tally]:
    """The tally of a parser, after every case."""
    tally = Tally()
    start, before = time.monotonic(), attacker.cut_short
    outcome, wrong = attacker.case(name, UNCHANGED)
    if wrong or (outcome != "read" and not all_parsers()[name].refuses):
        tally.defects[UNCHANGED] = f"the good files are not read: {outcome} {wrong}"
    for number in numbers:
        outcome, wrong = attacker.case(name, number)
        tally.mutations += 1
        tally.cut_short = attacker.cut_short - before
        tally.outcomes[outcome] += 1
        if wrong:
            tally.defects[number] = wrong
        tally.seconds = time.monotonic() - start
        yield tally


def source_hash() -> str:
    """Of the package and of this harness: a result of other code is no result."""
    import trueup

    digest = hashlib.sha256()
    for folder in (Path(trueup.__file__).parent, HERE):
        for path in sorted(folder.rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def reproduce(name: str, number: int, base: Path) -> None:
    """One case in this process; what it raises ends it with its traceback."""
    sandbox(base)
    parser = all_parsers()[name]
    folder, said = prepare(parser, number, base)
    print(f"{said}; the files are in {folder}", file=sys.stderr)
    for error in parser.read(folder):
        print(f"refused: {type(error).__name__}: {error}", file=sys.stderr)
    print("read", file=sys.stderr)
