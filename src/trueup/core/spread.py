"""The same work on many items: here, in processes, or on a Ray cluster."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, TypeVar

from trueup.core.ray_workers import on_ray
from trueup.core.workers import as_they_end
from trueup.errors import ConfigError, DataError

Item = TypeVar("Item")
Result = TypeVar("Result")


def spread(
    work: Callable[[Item], Result],
    items: Iterable[Item],
    *,
    jobs: int | None,
    ray: str | None,
    gpus: int = 0,
    begin: Callable[..., None],
    with_args: tuple[Any, ...] = (),
    lost: Callable[[Item, ConfigError], Result] | None = None,
) -> Iterator[tuple[Item, Result]]:
    """Each item with what `work` makes of it, as it ends: for items that take seconds or hours.

    Args:
        work: a function of a module; what goes in and comes out can be pickled. Where it was interrupted, by the end of
            its process or of this one, it may be called again for the same item.
        items: taken one by one, none before there is room for it.
        jobs: items that are under way at a time; the number of cores, of the cluster if there is one, if None. One
            item at a time is worked on in this process.
        ray: address of a Ray cluster, or `local`; processes of this machine if None.
        gpus: what each item needs on a cluster.
        begin: called in each other process before its first item.
        with_args: its arguments.
        lost: makes, here, the result of an item whose process was killed again and again; without it, that ends all. Of
            one item at a time, the process is this one.

    Raises:
        ConfigError: there is no such cluster, it has too few GPUs, or a process was killed (on a cluster, again and
            again).
        MissingDependency: Ray is not installed.
    """
    if ray is not None:
        return on_ray(work, items, address=ray, jobs=jobs, gpus=gpus, begin=begin, with_args=with_args, lost=lost)
    jobs = jobs or os.cpu_count() or 1
    if jobs == 1:
        return ((item, work(item)) for item in items)
    return as_they_end(work, items, jobs=jobs, begin=begin, with_args=with_args, lost=lost)


def go_to(folder: str) -> None:
    """A `begin`: paths are as the caller sees them.

    Raises:
        DataError: the folder is not on this machine.
    """
    try:
        os.chdir(folder)
    except OSError as error:
        raise DataError(
            f"a worker cannot go to {folder}",
            got=error.strerror,
            hint="Machines of a Ray cluster share the file system that the command is given on.",
        ) from error


def here() -> tuple[str]:
    """What `go_to` is given."""
    return (str(Path.cwd()),)
