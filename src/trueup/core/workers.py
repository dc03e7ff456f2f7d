"""Work on many items in processes, in order or as it ends, with bounded memory; the one place that starts any."""

from __future__ import annotations

import contextlib
import itertools
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection
from multiprocessing.connection import wait as hear
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

from trueup.errors import ConfigError

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
# So often does a thread of OpenMP look for the others before it gives its core away: some ten microseconds, longer than
# threads of one training wait for each other. As libgomp has it, these are milliseconds.
_SPINS = "2000"

Item = TypeVar("Item")
Result = TypeVar("Result")


def wait_briefly() -> None:
    """Let OpenMP's threads, torch's, that wait for each other give their cores away soon.

    As libgomp has it, they keep them, and where other programs want these cores, too, trainings take up to a hundred
    times as long. It counts for a library that has not been loaded yet; what the environment says wins.
    """
    if "OMP_WAIT_POLICY" not in os.environ:
        os.environ.setdefault("GOMP_SPINCOUNT", _SPINS)


def in_processes(
    work: Callable[[Item], Result],
    items: Iterable[Item],
    *,
    jobs: int,
    begin: Callable[..., None],
    with_args: tuple[Any, ...] = (),
) -> Iterator[Result]:
    """What `work` makes of each item, in order; few items are under way at a time.

    Args:
        work: a function of a module; what goes in and comes out can be pickled.
        items: taken one by one.
        jobs: processes.
        begin: called in each process before its first item.
        with_args: its arguments.

    Raises:
        ConfigError: the processes could not start, or one of them was killed.
    """
    waiting: deque[Future[Result]] = deque()
    # Not forked: other threads may hold locks at that moment.
    pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=_begin, initargs=(begin, with_args))
    try:
        for item in items:
            with _deaf():
                waiting.append(pool.submit(work, item))
            if len(waiting) > 2 * jobs:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    except BrokenProcessPool as error:
        raise _ended(error) from error
    finally:
        pool.shutdown(cancel_futures=True)


def as_they_end(
    work: Callable[[Item], Result],
    items: Iterable[Item],
    *,
    jobs: int,
    begin: Callable[..., None],
    with_args: tuple[Any, ...] = (),
    lost: Callable[[Item, ConfigError], Result] | None = None,
) -> Iterator[tuple[Item, Result]]:
    """Each item with what `work` makes of it, in the order in which work ends: for items that take minutes or hours.

    No item is taken before a process is free for it. Where the caller stops, by an error, Ctrl-C or because it has seen
    enough, processes end at once, in the middle of what they do.

    Args:
        work: a function of a module; what goes in and comes out can be pickled.
        items: taken one by one.
        jobs: processes.
        begin: called in each process before its first item.
        with_args: its arguments.
        lost: makes, here, the result of an item whose process was killed; without it, that ends all. One death ends all
            processes, and does not say whose it was: the items under way are begun anew one by one, each alone, and
            that of a process which is killed again is lost.

    Raises:
        ConfigError: the processes could not start, or one of them was killed.
    """
    source = iter(items)
    while True:
        under_way: dict[int, Item] = {}
        try:
            yield from _of_one_pool(work, source, under_way, jobs, begin, with_args)
        except BrokenProcessPool as error:
            if lost is None:
                raise _ended(error) from error
        else:
            return
        for item in under_way.values():
            try:
                yield from _of_one_pool(work, iter((item,)), {}, 1, begin, with_args)
            except BrokenProcessPool as error:
                yield item, lost(item, _ended(error))


def _of_one_pool(
    work: Callable[[Item], Result],
    source: Iterator[Item],
    under_way: dict[int, Item],
    jobs: int,
    begin: Callable[..., None],
    with_args: tuple[Any, ...],
) -> Iterator[tuple[Item, Result]]:
    """As `as_they_end`; `under_way` are, by number, the items that were taken and have not ended.

    Raises:
        BrokenProcessPool: the processes could not start, or one of them was killed.
    """
    context = get_context("spawn")
    heard, held = context.Pipe(duplex=False)
    pool = ProcessPoolExecutor(jobs, mp_context=context, initializer=_begin_while, initargs=(heard, begin, with_args))
    futures: dict[Future[Result], int] = {}
    numbers = itertools.count()
    try:
        while True:
            for number, item in zip(numbers, itertools.islice(source, jobs - len(under_way)), strict=False):
                under_way[number] = item
                with _deaf():
                    futures[pool.submit(work, item)] = number
            if not futures:
                break
            ended, _ = wait(futures, return_when=FIRST_COMPLETED)
            # What is done is told before an error ends the rest.
            for future in sorted(ended, key=lambda future: (future.exception() is not None, futures[future])):
                result = future.result()
                yield under_way.pop(futures.pop(future)), result
        pool.shutdown()
    finally:
        held.close()
        pool.shutdown(cancel_futures=True)
        heard.close()


def _ended(error: BrokenProcessPool) -> ConfigError:
    return ConfigError(
        "a worker process ended",
        got=str(error),
        hint='In a script, call this below `if __name__ == "__main__":`, or give jobs=1. '
        "If a process was killed, perhaps for want of memory, repeat with fewer jobs.",
    )


@contextlib.contextmanager
def _deaf() -> Iterator[None]:
    """Processes that start meanwhile never hear Ctrl-C, not even while they import; this one hears it afterwards."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin(begin: Callable[..., None], arguments: tuple[Any, ...]) -> None:
    _begin_while(None, begin, arguments)


def _begin_while(held: Connection | None, begin: Callable[..., None], arguments: tuple[Any, ...]) -> None:
    # Ctrl-C reaches all processes; the one that was asked says so, and the others end with it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, args=(held,), daemon=True).start()
    one_thread()
    begin(*arguments)


def one_thread() -> None:
    """Matrices are small here, and other processes want their cores.

    Libraries that are loaded already are told so, and those that are not yet read it when they are.
    """
    threadpool_limits(1)
    os.environ.update(dict.fromkeys(_THREADS, "1"))


def _end_with_parent(held: Connection | None) -> None:
    """A parent that is killed says nothing; its processes would wait for more work as long as the machine runs.

    So would those of one that has stopped: it lets go of the other end of `held`.
    """
    parent = parent_process()
    if parent is not None:
        hear([parent.sentinel] if held is None else [parent.sentinel, held])
        os._exit(1)
