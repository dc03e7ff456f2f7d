"""A graph is run once within bounds, before it is run in earnest.

Plain operators can fill a memory, too: a constant of a hundred billion zeros, a column times a row, forty doublings.
How large a result is follows from the shapes of the inputs (`operators`), so one run tells. It must be one that folds
no constants beforehand, which onnxruntime does in memory that nobody bounds.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from trueup.errors import DataError

# A network for a control loop takes a few MB; one that takes 512 with its weights is none.
MOST_BYTES = 1 << 29
MOST_SECONDS = 10.0
# Of axes without a size of their own: one sample of one robot, and a few of a few.
_LENGTHS = (1, 16)
_NO_MEMORY = ("memory", "bad_alloc", "allocat", " bytes")


def tried(runtime: Any, graph: bytes, where: str) -> None:
    """Run a graph on zeros.

    Args:
        runtime: the module onnxruntime.
        graph: that `operators.check_operators` has seen.
        where: for messages.

    Raises:
        DataError: it cannot be run, takes too much memory, or too long.
    """
    session = runtime.InferenceSession(graph, _bounded(runtime), providers=["CPUExecutionProvider"])
    for length in _LENGTHS:
        given = {item.name: _zeros(item, length, where) for item in session.get_inputs()}
        settings = runtime.RunOptions()
        settings.log_severity_level = 4
        settings.add_run_config_entry("memory.enable_memory_arena_shrinkage", "cpu:0")
        with _ended_after(MOST_SECONDS, settings) as late:
            try:
                session.run(None, given, settings)
            except Exception as error:  # onnxruntime has a class of its own for each of its codes, with no common base
                _refuse(error, where, late=late.is_set())
                raise


def _bounded(runtime: Any) -> Any:
    """Settings of a session whose memory is bounded: all that it takes comes from one allocator.

    That allocator is made anew each time, since a program may have put another into its place.
    """
    place = runtime.OrtMemoryInfo("Cpu", runtime.OrtAllocatorType.ORT_ARENA_ALLOCATOR, 0, runtime.OrtMemType.DEFAULT)
    runtime.create_and_register_allocator(place, runtime.OrtArenaCfg({"max_mem": MOST_BYTES}))
    options = session_options(runtime)
    options.graph_optimization_level = runtime.GraphOptimizationLevel.ORT_DISABLE_ALL
    options.add_session_config_entry("session.use_env_allocators", "1")
    options.log_severity_level = 4
    return options


def session_options(runtime: Any) -> Any:
    """One thread, and what the bytes are is said: else onnxruntime takes other formats by their first letters."""
    options = runtime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.execution_mode = runtime.ExecutionMode.ORT_SEQUENTIAL
    options.add_session_config_entry("session.load_model_format", "ONNX")
    return options


def _zeros(tensor: Any, length: int, where: str) -> np.ndarray:
    kinds = {"tensor(float)": np.float32, "tensor(double)": np.float64, "tensor(int64)": np.int64}
    shape = [size if isinstance(size, int) and size >= 0 else length for size in tensor.shape]
    if tensor.type not in kinds:
        raise DataError(f"{where} takes what no network takes", got=tensor.type, expected=list(kinds))
    if np.prod(shape, dtype=float) * 8 > MOST_BYTES:
        raise DataError(f"{where} takes too much memory", got=f"an input {tensor.name!r} of {shape}")
    return np.zeros(shape, kinds[tensor.type])


@contextmanager
def _ended_after(seconds: float, settings: Any) -> Iterator[threading.Event]:
    """A run with these settings ends at the next node after that time; whether it was ended."""
    late = threading.Event()

    def end() -> None:
        late.set()
        settings.terminate = True

    timer = threading.Timer(seconds, end)
    timer.daemon = True
    timer.start()
    try:
        yield late
    finally:
        timer.cancel()


def _refuse(error: Exception, where: str, *, late: bool) -> None:
    if late:
        raise DataError(
            f"{where} is not run: it takes too long", got=f"more than {MOST_SECONDS:g} s", expected="milliseconds"
        ) from error
    if any(word in str(error) for word in _NO_MEMORY):
        raise DataError(
            f"{where} is not run: it takes too much memory", got=error, expected=f"at most {MOST_BYTES >> 20} MB"
        ) from error
