"""Work on many items on the machines of a Ray cluster, as it ends."""

from __future__ import annotations

import contextlib
import itertools
import logging
import os
import socket
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from trueup.core.workers import one_thread
from trueup.errors import ConfigError, needing

# Times that an item is taken up again after its worker was killed.
_RETRIES = 3
# What goes between processes here is small; Ray would take a third of the memory for it [bytes].
_STORE = 100_000_000
# How long a cluster may take to answer [s].
_PATIENCE_S = 5.0

Item = TypeVar("Item")
Result = TypeVar("Result")

# Of which call this process has begun the work: one process serves several, one after the other.
_begun: list[int] = []
_calls = itertools.count()


@dataclass(frozen=True)
class Cluster:
    """A Ray cluster, and how much of it is used.

    Attributes:
        address: `HOST:PORT`, or `local` for one on this machine.
        jobs: items that are under way at a time; as many as it has processors if None.
    """

    address: str
    jobs: int | None = None


def on_ray(
    work: Callable[[Item], Result],
    items: Iterable[Item],
    *,
    address: str,
    jobs: int | None = None,
    gpus: int = 0,
    gpu_if_there: bool = False,
    begin: Callable[..., None],
    with_args: tuple[Any, ...] = (),
    lost: Callable[[Item, ConfigError], Result] | None = None,
) -> Iterator[tuple[Item, Result]]:
    """Each item with what `work` makes of it, in the order in which work ends, as `workers.as_they_end` does it.

    An item has one processor of the cluster. If its worker is killed, or the machine of it goes away, it begins anew
    elsewhere, up to three times; `work` has to bear that. An error of `work` ends all.

    Args:
        work: a function of a module that the cluster has, too; what goes in and comes out can be pickled.
        items: taken one by one.
        address: of the cluster; `local` starts one here, of `jobs` processors, and ends it afterwards.
        jobs: items that are under way at a time; as many as the cluster has processors if None.
        gpus: what each item needs besides its processor; Ray hides them from an item that asks for none.
        gpu_if_there: whether each item takes one GPU of a cluster that has some, and does without one elsewhere.
        begin: called in each process before its first item.
        with_args: its arguments; each machine gets them once, so that they may be large.
        lost: makes, here, the result of an item whose worker was killed that often; without it, that ends all.

    Raises:
        ConfigError: there is no such cluster, it has too few GPUs, or the worker of an item was killed again and again.
        MissingDependency: Ray is not installed.
    """
    with connected(address, jobs):
        import ray
        from ray.exceptions import NodeDiedError, OutOfMemoryError, RayError, RayTaskError, WorkerCrashedError

        has = int(ray.cluster_resources().get("GPU", 0))
        if has < gpus:  # an item would wait for one as long as the command runs
            raise ConfigError("the Ray cluster has too few GPUs", got=has, expected=f"at least {gpus}")
        if gpu_if_there:
            gpus = max(gpus, min(has, 1))
        task = ray.remote(_done).options(num_cpus=1, num_gpus=gpus, max_retries=_RETRIES)
        under_way: dict[Any, Item] = {}
        source = iter(items)
        try:
            call, given = next(_calls), ray.put(with_args)
            while True:
                room = jobs or max(int(ray.cluster_resources().get("CPU", 1)), 1)
                for item in itertools.islice(source, max(room - len(under_way), 0)):
                    under_way[task.remote(work, item, begin, given, call)] = item
                if not under_way:
                    break
                ended, _ = ray.wait([*under_way])
                for reference in ended:
                    item = under_way.pop(reference)  # of an error, too: what has ended must not be cancelled
                    try:
                        result: Result = ray.get(reference)
                    except (WorkerCrashedError, OutOfMemoryError, NodeDiedError) as error:
                        if lost is None:
                            raise
                        result = lost(item, _worker_ended(error))
                    yield item, result
        except RayTaskError as error:
            if not isinstance(error.cause, RayError):
                raise error.cause from error
            raise ConfigError(
                "a worker of the Ray cluster cannot read what it is to do",
                got=str(error.cause).split("\n")[0],
                hint="Install the same trueup on all machines of the cluster.",
            ) from error
        except RayError as error:
            raise _worker_ended(error) from error
        finally:
            for reference in under_way:
                ray.cancel(reference, force=True)


def _worker_ended(error: Exception) -> ConfigError:
    return ConfigError(
        "a worker of the Ray cluster ended",
        got=f"{type(error).__name__} after {_RETRIES} more attempts",
        hint="If it was killed for want of memory, repeat with fewer --jobs.",
    )


@contextlib.contextmanager
def connected(address: str | None, jobs: int | None = None) -> Iterator[None]:
    """Connected to a cluster, unless no address is given or this process is connected to one already.

    For several calls of `on_ray`, and for commands before they write: an address that nobody answers at leaves nothing.

    Raises:
        ConfigError: there is no such cluster.
        MissingDependency: Ray is not installed.
    """
    if address is None:
        yield
        return
    with needing("work on a Ray cluster", "ray"):
        import ray

    if ray.is_initialized():
        yield
        return
    own: dict[str, Any] = {}
    if address == "local":
        own = {"num_cpus": jobs, "object_store_memory": _STORE, "include_dashboard": False}
        own["_node_ip_address"] = "127.0.0.1"
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # what it tells its makers is for those who asked for it
    elif address != "auto" and "://" not in address:
        _refuse_silent(address)
    try:
        ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR, **own)
    except (OSError, RuntimeError, ValueError) as error:
        raise ConfigError(
            "no Ray cluster answers", got=f"{address}: {error}", expected="local, or HOST:PORT"
        ) from error
    try:
        yield
    finally:
        ray.shutdown()


def _refuse_silent(address: str) -> None:
    """Ray itself waits for minutes for somebody who is not there."""
    host, _, port = address.rpartition(":")
    if not (host and port.isascii() and port.isdigit() and int(port) < 2**16):
        raise ConfigError(
            "no Ray cluster has such an address",
            got=repr(address),
            expected="HOST:PORT, or local",
            hint="`ray start --head` says the address of a cluster; 6379 is its usual port.",
        )
    try:
        with socket.create_connection((host.strip("[]"), int(port)), timeout=_PATIENCE_S):
            return
    except (OSError, ValueError) as error:
        raise ConfigError(
            "no Ray cluster answers",
            got=f"{address}: {error}",
            hint="Start one by `ray start --head` and give its HOST:PORT, or give local for one on this machine.",
        ) from error


def _done(
    work: Callable[[Item], Result], item: Item, begin: Callable[..., None], with_args: tuple[Any, ...], call: int
) -> Result:
    if _begun != [call]:
        one_thread()
        begin(*with_args)
        _begun[:] = [call]
    return work(item)


def refuse_other_model(path: Path, found: str, expected: str) -> None:
    """What a worker computes goes under the name of the model of the machine that it was asked by.

    Args:
        path: of the model's file.
        found: fingerprint of the model, as compiled by the worker.
        expected: as compiled where the command was given.

    Raises:
        ConfigError: they are not the same.
    """
    if found != expected:
        raise ConfigError(
            f"the model that {socket.gethostname()} makes of {path} is not that of the command",
            got=found[:12],
            expected=expected[:12],
            hint="Give all machines of the cluster the same file, with all that it includes, and install the same "
            "versions of trueup and its engines on them.",
        )
