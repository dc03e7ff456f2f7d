"""Plain functions of numbers and arrays as machine code, for loops in which Python's own time counts."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any


def machine_code(function: Callable[..., Any], **rules: Any) -> Any:
    """The function compiled by numba when it is first called, and kept on disk where there is a folder for it.

    Args:
        function: of numbers and arrays, without closures.
        **rules: of `numba.njit`.
    """
    import numba  # takes a while to load

    plain = inspect.unwrap(function)  # where a type checker of the tests has wrapped it
    try:
        return numba.njit(cache=True, **rules)(plain)
    except RuntimeError:  # there is no folder that can be written: each process then compiles anew
        return numba.njit(**rules)(plain)
