"""Processes that share the terminal with the one that started them."""

import functools
import importlib
import operator
import signal

from threadpoolctl import threadpool_info

from trueup.core.workers import in_processes


def test_a_process_does_not_hear_ctrl_c_from_its_first_instant():
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    blocked = functools.partial(signal.pthread_sigmask, signal.SIG_BLOCK)
    # A mask outlives exec, a handler does not: what is blocked in the process was blocked when it began to import.
    (mask,) = in_processes(blocked, [()], jobs=1, begin=dict)
    assert signal.SIGINT in mask
    assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == before


def test_a_process_has_one_thread_for_its_matrices_whenever_a_library_is_loaded():
    for module in ("numpy", "scipy.linalg"):
        begin = {"begin": importlib.import_module, "with_args": (module,)}
        (libraries,) = in_processes(operator.call, [threadpool_info], jobs=1, **begin)
        assert libraries
        assert {library["num_threads"] for library in libraries} == {1}
