"""Processes that share the terminal with the one that started them."""

import functools
import signal

from trueup.core.workers import in_processes


def test_a_process_does_not_hear_ctrl_c_from_its_first_instant():
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    blocked = functools.partial(signal.pthread_sigmask, signal.SIG_BLOCK)
    # A mask outlives exec, a handler does not: what is blocked in the process was blocked when it began to import.
    (mask,) = in_processes(blocked, [()], jobs=1, begin=dict)
    assert signal.SIGINT in mask
    assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == before
