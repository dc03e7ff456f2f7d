"""MuJoCo's step as a function that compiled code can call: loops around the engine without Python in them."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path
from typing import Any

import mujoco

from trueup.errors import ConfigError

_LIBRARIES = ("libmujoco.so*", "libmujoco*.dylib", "mujoco.dll")


@cache
def engine_step() -> Any:
    """`mj_step` of the library that the Python package has loaded; takes the addresses of model and data.

    Raises:
        ConfigError: the library is not where the package keeps it.
    """
    folder = Path(mujoco.__file__).parent
    found = [path for pattern in _LIBRARIES for path in sorted(folder.glob(pattern))]
    if not found:
        raise ConfigError(f"there is no MuJoCo library in {folder}", expected=" or ".join(_LIBRARIES))
    step = ctypes.CDLL(str(found[0])).mj_step
    # Addresses as plain integers, which numba passes as they are.
    step.argtypes, step.restype = [ctypes.c_int64, ctypes.c_int64], None
    return step


def addresses(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[int, int]:
    """Where model and data lie; valid as long as both live."""
    return int(model._address), int(data._address)  # noqa: SLF001 - the bindings have no public name for it
