"""Everything that is printed goes through here: tables and messages on the terminal, progress on stderr."""

from __future__ import annotations

import contextlib
import json
import sys
import tempfile
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, runtime_checkable

from rich.console import Console, ConsoleOptions, RenderableType
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TaskProgressColumn,
    TextColumn,
    TimeRemainingColumn,
)
from rich.segment import Segment
from rich.status import Status
from rich.text import Text

if TYPE_CHECKING:
    from trueup.identify import OnModel
    from trueup.identify import Progress as SearchProgress

T = TypeVar("T")

# A file or pipe has no width of its own: tables take what they need, up to this.
_FILE_WIDTH = 160


class _Console(Console):
    """Names and paths may hold control characters, wherever they stand; a terminal must not obey them."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """What is printed, piece by piece."""
        for segment in super().render(renderable, options):
            if segment.control or segment.text.isprintable():
                yield segment
            else:
                yield Segment(_plain_text(segment.text), segment.style)


def _plain_text(text: str) -> str:
    return "".join(character if character.isprintable() or character == "\n" else "\ufffd" for character in text)


out = _Console(highlight=False, soft_wrap=True)
if not out.is_terminal:
    out = _Console(highlight=False, soft_wrap=True, width=_FILE_WIDTH)
err = _Console(stderr=True, highlight=False, soft_wrap=True)


@dataclass
class Volume:
    """How much is said besides results, warnings and errors.

    Attributes:
        quiet: no notes, and not where long work stands.
        verbose: all notes.
        json: the result as JSON, and nothing else, on the standard output.
        answered: whether it was printed.
    """

    quiet: bool = False
    verbose: bool = False
    json: bool = False
    answered: bool = False

    def set(self, *, quiet: bool, verbose: bool, json: bool) -> None:
        """For one command."""
        self.quiet, self.verbose, self.json, self.answered = quiet, verbose, json, False
        out.quiet = json


@runtime_checkable
class Saved(Protocol):
    """A result with a file of its own."""

    def save(self, path: Path) -> None:
        """Write it."""


volume = Volume()


def answer(result: Saved | Mapping[str, Any] | Sequence[Any]) -> None:
    """With --json, print a result as its file has it; without, nothing."""
    if not volume.json:
        return
    volume.answered = True
    if isinstance(result, Mapping | Sequence):
        text = json.dumps(result, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
    else:
        with tempfile.TemporaryDirectory() as folder:
            result.save(Path(folder) / "result.json")
            text = (Path(folder) / "result.json").read_text(encoding="utf-8")
    sys.stdout.write(text)


# Seconds between lines where no terminal redraws a bar, e.g. in a log of CI.
_PLAIN_EVERY_S = 5.0


class _Rate(ProgressColumn):
    """Items per second."""

    def render(self, task: Task) -> Text:
        return Text(f"{task.speed:.3g}/s" if task.speed else "", style="progress.data.speed")


def track(items: Iterable[T], what: str, total: int | None = None) -> Generator[T]:
    """A `stages.progress.Track`: a bar on a terminal, a line now and then elsewhere."""
    if volume.quiet:
        yield from items
        return
    if not err.is_terminal:
        yield from _plain(items, what, total)
        return
    columns = (
        TextColumn("{task.description:>8}"),
        BarColumn(),
        TaskProgressColumn(),
        MofNCompleteColumn(),
        _Rate(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=err, transient=True) as progress:
        task = progress.add_task(what, total=total)
        for item in items:
            yield item
            progress.advance(task)


def _plain(items: Iterable[T], what: str, total: int | None) -> Generator[T]:
    first = last = time.monotonic()
    for done, item in enumerate(items, start=1):
        yield item
        now = time.monotonic()
        if done == 1:  # before the first one come processes that start and models that are loaded
            first = last = now
        elif now - last >= _PLAIN_EVERY_S:
            last = now
            rate = (done - 1) / (now - first)
            left = f", {(total - done) / rate:.0f} s left" if total else ""
            err.print(f"{what}: {done}{f'/{total}' if total else ''}, {rate:.3g}/s{left}")


@contextlib.contextmanager
def status_line() -> Iterator[Callable[[str], None]]:
    """Shows where long work stands: a line that is rewritten on a terminal, a line now and then elsewhere."""
    with contextlib.ExitStack() as stack:
        status: list[Status] = []
        last = -_PLAIN_EVERY_S

        def show(text: str) -> None:
            nonlocal last
            if volume.quiet:
                return
            if err.is_terminal:
                # Only now: two displays at once, this one and the bar of a reading, are refused by older versions.
                if not status:
                    status.append(stack.enter_context(err.status("")))
                status[0].update(Text(text))
            elif time.monotonic() - last >= _PLAIN_EVERY_S:
                last = time.monotonic()
                err.print(text, markup=False)

        yield show


@contextlib.contextmanager
def iterations() -> Iterator[tuple[Callable[[], None], OnModel]]:
    """Shows that a search begins, and where it stands."""
    with status_line() as show:

        def on_model(model: str, progress: SearchProgress) -> None:
            show(search_line(model, progress))

        yield lambda: show("looking for a start"), on_model


def search_line(model: str, progress: SearchProgress) -> str:
    """Where the search of one model stands."""
    return (
        f"{model}: {progress.phase} {progress.iteration}, residual {progress.rms:.4g}, "
        f"{progress.evaluations} candidates, {progress.evaluations / max(progress.seconds, 1e-9):.3g}/s, "
        f"{progress.seconds:.0f} s"
    )


def problem(message: str, hint: str | None = None) -> None:
    """An error in one or two lines."""
    err.print(Text("error: ", style="bold red") + Text(" ".join(message.split())))
    if hint:  # lines are kept: a hint may be a file to copy
        err.print(Text("  next: ", style="bold") + Text(hint.strip()))


def begins(message: str) -> None:
    """What is done from now on, or is done by now, on stderr."""
    if not volume.quiet:
        err.print(message, markup=False)


def note(message: str) -> None:
    """A remark on stderr."""
    if not volume.quiet:
        err.print(Text("note: ", style="bold yellow") + Text(message))


def warning(message: str, hint: str | None = None) -> None:
    """What must not be overlooked although the exit code is 0."""
    err.print(Text("warning: ", style="bold yellow") + Text(message))
    if hint:
        err.print(Text("  next: ", style="bold") + Text(hint))
