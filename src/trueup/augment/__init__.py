"""Learned corrections: networks that turn simulated signals into what the robot would have measured.

Everything that needs torch or onnxruntime is loaded when it is first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from trueup.augment.channels import Grid, gather
from trueup.augment.config import AugmentConfig, preset
from trueup.augment.networks import METHODS

if TYPE_CHECKING:
    from trueup.augment.augmentation import Augmentation as Augmentation
    from trueup.augment.augmentation import Task as Task
    from trueup.augment.simulator import ResidualSimulator as ResidualSimulator
    from trueup.augment.training import Progress as Progress

_LATER = {
    "Augmentation": "trueup.augment.augmentation",
    "Progress": "trueup.augment.training",
    "ResidualSimulator": "trueup.augment.simulator",
    "Task": "trueup.augment.augmentation",
}

__all__ = [
    "METHODS",
    "AugmentConfig",
    "Augmentation",
    "Grid",
    "Progress",
    "ResidualSimulator",
    "Task",
    "gather",
    "preset",
]


def __getattr__(name: str) -> Any:
    """Import a name that needs torch on first use."""
    if name not in _LATER:
        raise AttributeError(f"module 'trueup.augment' has no attribute {name!r}")
    return getattr(import_module(_LATER[name]), name)
