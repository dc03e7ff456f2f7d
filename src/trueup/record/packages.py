"""The packages of the extra `plan`, loaded when they are needed."""

from __future__ import annotations

import importlib
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from trueup.errors import needing

_ompl = threading.Lock()


def load(name: str) -> Any:
    """A module of the extra `plan`.

    Raises:
        MissingDependency: it is not installed.
    """
    with needing("planning", "plan"):
        return importlib.import_module(name)


@contextmanager
def quiet_ompl(seed: int) -> Iterator[tuple[Any, Any]]:
    """OMPL's `base` and `geometric`, silent, their draws a function of the seed.

    OMPL has one source of seeds for the whole process and complains when it is set twice; it obeys all the same. So one
    planner at a time, and planners must be made inside of the block.

    Args:
        seed: 0 to 2^32 - 1.
    """
    util, base, geometric = load("ompl.util"), load("ompl.base"), load("ompl.geometric")
    with _ompl:
        level = util.getLogLevel()
        util.setLogLevel(util.LogLevel.LOG_NONE)
        try:
            util.RNG.setSeed(seed + 1)  # zero would mean: of your own choice
            yield base, geometric
        finally:
            util.setLogLevel(level)
