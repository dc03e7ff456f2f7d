"""A local Ray cluster for tests, and an end for one of its workers in the middle of its work."""

import contextlib
import importlib.util
import os
import signal
import threading

import psutil
import pytest

NEEDS_RAY = pytest.mark.skipif(
    importlib.util.find_spec("ray") is None, reason="Ray is not installed: pip install '.[ray]'"
)
# Ray's own: files and sockets of processes that it has ended, and what future versions will do.
QUIET = [
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::FutureWarning:ray"),
]


@contextlib.contextmanager
def local_cluster(processes=2):
    """A cluster on this machine that all calls with `ray="local"` share meanwhile; its start takes seconds."""
    import ray

    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    ray.init(
        address="local",
        num_cpus=processes,
        include_dashboard=False,
        log_to_driver=False,
        object_store_memory=100_000_000,
        _node_ip_address="127.0.0.1",
    )
    try:
        yield
    finally:
        ray.shutdown()


@contextlib.contextmanager
def one_worker_killed(begun):
    """Kills (SIGKILL) one worker that is at work, as soon as `begun()` is true; yields a list that gets its process."""
    killed, left = [], threading.Event()

    def kill():
        while not killed and not left.wait(0.002):
            if not begun():
                continue
            for child in psutil.Process().children(recursive=True):
                with contextlib.suppress(psutil.Error, ProcessLookupError, IndexError):
                    if child.cmdline()[0].startswith("ray::_done"):  # an idle one is called ray::IDLE
                        os.kill(child.pid, signal.SIGKILL)
                        killed.append(child.pid)
                        return

    thread = threading.Thread(target=kill, daemon=True)
    thread.start()
    try:
        yield killed
    finally:
        left.set()
        thread.join(5.0)
