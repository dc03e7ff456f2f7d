"""Processes that share the terminal with the one that started them."""

import functools
import importlib
import operator
import signal
import time

import pytest
from threadpoolctl import threadpool_info

from core import errands
from trueup.core.workers import as_they_end, in_processes
from trueup.errors import ConfigError


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


def test_results_come_as_work_ends_and_no_item_is_taken_too_soon():
    taken = []

    def items():
        for number in range(4):
            taken.append(number)
            yield number

    found = []
    for item, result in as_they_end(errands.square_slowly, items(), jobs=2, begin=dict):
        assert len(taken) <= len(found) + 2
        found.append((item, result))
    assert sorted(found) == [(0, 0), (1, 1), (2, 4), (3, 9)]
    assert found[-1] == (0, 0)


def test_who_stops_does_not_wait_for_what_is_under_way():
    began = time.monotonic()
    working = as_they_end(errands.wait_a_minute_but_for_nothing, [0, 1, 2], jobs=2, begin=dict)
    assert next(working) == (0, None)
    working.close()  # the second item is under way
    assert time.monotonic() - began < 30
    with pytest.raises(ConfigError, match="a worker process ended"):
        list(as_they_end(errands.end, [1], jobs=1, begin=dict))


def test_whose_process_is_killed_again_is_lost_and_the_others_are_not(tmp_path):
    told = []

    def lost(item, error):
        told.append((item, error.summary))
        return -item

    found = list(as_they_end(errands.square_but_end_for_two, range(6), jobs=2, begin=dict, lost=lost))
    assert sorted(found) == [(0, 0), (1, 1), (2, -2), (3, 9), (4, 16), (5, 25)]
    ((item, said),) = told
    assert item == 2
    assert "a worker process ended" in said
    # Killed once, an item is done after all.
    items = [(number, tmp_path / "killed" if number == 1 else None) for number in range(3)]
    found = dict(as_they_end(errands.square_or_end_once, items, jobs=2, begin=dict, lost=pytest.fail))
    assert found == {item: item[0] ** 2 for item in items}
